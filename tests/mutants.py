"""Faults put into copies of the tree, to see whether a test notices: `make mutants` prints the share that is noticed.

The faults are in mutants.toml. Each names a file, a line by its text, and the faulty line. The tests are those of the
room of the file (see `rooms.py`), without slow ones; for the compiled core they are those of `CORE`. A fault whose line
is not found, or found more than once, is an error of the list.

python -m tests.mutants [--room solve] [--sample 20] [--workers 2] [--check]
"""

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from tests import rooms
from tests.durations import stored

ROOT = rooms.ROOT
LIST, RESULTS = Path(__file__).with_name("mutants.toml"), ROOT / "results" / "mutants.json"
CORE = (
    "tests/derivatives",
    "tests/laws",
    "tests/properties",
    "tests/orders",
    "tests/unit",
    "tests/device",
    "tests/friction",
)
COPIED = ("src", "tests", "docs", "examples", "benchmarks", "release", "paper")
LONGEST = 1800  # seconds for the tests of one fault


class Mutant(NamedTuple):
    """A fault."""

    file: str
    was: str  # text of the line, without leading space
    now: str
    why: str = ""

    @property
    def room(self) -> str:
        """First folder below the package, or the name of a module at its top."""
        return Path(self.file).parts[2].removesuffix(".py")

    def apply(self, root: Path) -> None:
        """Put the fault into a copy of the tree.

        Raises
        ------
        ValueError
            If the line is not there, or there more than once.
        """
        path = root / self.file
        lines = path.read_text(encoding="utf-8").split("\n") if path.is_file() else []
        found = [k for k, line in enumerate(lines) if line.strip() == self.was.strip()]
        if len(found) != 1:
            raise ValueError(f"{self.file} has {len(found)} lines {self.was!r}: the list needs exactly one")
        line = lines[found[0]]
        lines[found[0]] = line[: len(line) - len(line.lstrip())] + self.now.strip()
        path.write_text("\n".join(lines), encoding="utf-8")


def read() -> list[Mutant]:
    """Return all faults of the list."""
    return [Mutant(**table) for table in tomllib.loads(LIST.read_text(encoding="utf-8"))["mutant"]]


def tests_of(room: str) -> list[str]:
    """Files of tests, those that take the least time first."""
    if room == "_core":
        files = [path for name in CORE for path in sorted((ROOT / name).glob("test_*.py"))]
    else:
        files = rooms.files(room)
    spent: dict[str, float] = {}
    for name, seconds in stored().items():
        file = name.partition("::")[0]
        spent[file] = spent.get(file, 0.0) + seconds
    names = [path.relative_to(ROOT).as_posix() for path in files]
    return sorted(names, key=lambda name: spent.get(name, 0.0))


def is_noticed(mutant: Mutant) -> str:
    """Return the first test that fails with the fault and passes without it, or what else stops them; "" if none."""
    with tempfile.TemporaryDirectory(prefix="mutant-") as name:
        root, broken = Path(name), []
        for part in COPIED:
            shutil.copytree(ROOT / part, root / part, ignore=shutil.ignore_patterns("__pycache__", "_build"))
        for path in ROOT.iterdir():
            if path.is_file():
                shutil.copy2(path, root)
        mutant.apply(root)
        env = os.environ | {"PYTHONPATH": str(root / "src"), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        if mutant.room == "_core" and mutant.file.endswith((".h", ".cpp")):
            build = [sys.executable, root / "src/stickslip/_core/build.py", "--all"]
            if subprocess.run(build, cwd=root, env=env, capture_output=True).returncode:
                return "the compiler"
        while "::" in (failed := _first_failure(root, env, [*tests_of(mutant.room), *broken])):
            if _first_failure(ROOT, env | {"PYTHONPATH": str(ROOT / "src")}, [failed]) != failed:
                break
            broken.append(f"--deselect={failed}")  # without the fault as well
        return failed


def _first_failure(root: Path, env: dict[str, str], tests: list[str]) -> str:
    """Name of the first test that fails, or how the tests ended; "" if all pass."""
    call = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(call, cwd=root, env=env, capture_output=True, text=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return "too slow"
    failed = re.findall(r"(?m)^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout)
    return failed[-1] if failed else f"exit code {done.returncode}" if done.returncode else ""


def main() -> None:
    """Run faults and print those that no test notices."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--room", help="only faults of this room")
    parser.add_argument("--sample", type=int, help="this many faults, drawn at random")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--check", action="store_true", help="only check that every fault applies")
    given = parser.parse_args()
    chosen = [mutant for mutant in read() if given.room in (None, mutant.room)]
    for mutant in chosen:
        with tempfile.TemporaryDirectory() as name:
            (Path(name) / mutant.file).parent.mkdir(parents=True)
            shutil.copy2(ROOT / mutant.file, Path(name) / mutant.file)
            mutant.apply(Path(name))
    if given.check:
        return print(f"all {len(chosen)} faults apply")
    if given.sample:
        chosen = random.Random(given.seed).sample(chosen, min(given.sample, len(chosen)))
    found = []
    with ThreadPoolExecutor(given.workers) as pool:
        for mutant, noticed in zip(chosen, pool.map(is_noticed, chosen), strict=True):
            found.append((mutant, noticed))
            print(f"{'noticed' if noticed else 'MISSED '}  {mutant.file}: {mutant.now}  {noticed}", flush=True)
    share = sum(bool(noticed) for _, noticed in found) / max(1, len(found))
    print(f"{share:.1%} of {len(found)} faults are noticed")
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps([mutant._asdict() | {"noticed": noticed} for mutant, noticed in found], indent=1))
    return None


if __name__ == "__main__":
    main()
