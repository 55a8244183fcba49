"""Faults in copies of the tree, to check if tests notice them: `make mutants` prints the share that is noticed.

The faults are in mutants.toml. Each names a file, the text of a line, and the faulty line; a line that is not found, or
found more than once, is an error of the list. `--record` runs the suite once and stores the lines executed by each
test. The tests of a fault are those that execute its statement, and those that are newer than the record. Without a
record, they are the tests of the room of the file (see `rooms.py`); for the compiled core, those of `CORE`. The test
that noticed a fault the last time, which is stored in mutants.json, runs before all others, then the fastest; slow
tests not at all. Faults with few tests come first.

python -m tests.mutants [--record] [--room solve] [--sample 20] [--missing] [--workers 2] [--check]
"""

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

from coverage import CoverageData

from stickslip._core import build
from tests import rooms

ROOT = rooms.ROOT
LIST, RESULTS = Path(__file__).with_name("mutants.toml"), Path(__file__).with_name("mutants.json")
RECORD = ROOT / "results" / "mutants.coverage"
CORE = (  # folders with tests of the compiled core; those most likely to notice a fault come first
    ("tests/derivatives", "tests/laws", "tests/orders", "tests/device", "tests/properties", "tests/wings/faults"),
    ("tests/unit",),
)
CORE_FOLDER = Path("src/stickslip/_core")
COPIED = ("src", "tests", "docs", "examples", "benchmarks", "release", "paper")
MANY = 100  # assumed number of tests in a file
LONGEST = 1800  # limit for the tests of one fault [s]
EXIT = "exit code "  # prefix of the outcome of tests that were not run


class Mutant(NamedTuple):
    """A fault."""

    file: str
    was: str  # text of the line, without leading space
    now: str
    why: str = ""

    @property
    def name(self) -> str:
        """Name in the stored results."""
        return f"{self.file}: {self.was} → {self.now}"

    @property
    def room(self) -> str:
        """Room or wing, or the name of a module at the top of the package."""
        return rooms.room_of(".".join(Path(self.file).parts[2:])).removesuffix(".py")

    @property
    def is_compiled(self) -> bool:
        """Return True for a fault of the compiled core."""
        return self.file.endswith((".h", ".cpp"))

    def line(self, root: Path) -> int:
        """Number of the line, counted from 0.

        Raises
        ------
        ValueError
            If the line is missing or occurs more than once.
        """
        path = root / self.file
        lines = path.read_text(encoding="utf-8").split("\n") if path.is_file() else []
        found = [k for k, line in enumerate(lines) if line.strip() == self.was.strip()]
        if len(found) != 1:
            raise ValueError(f"{self.file} has {len(found)} lines {self.was!r}: the list needs exactly one")
        return found[0]

    @contextmanager
    def applied(self, root: Path):
        """Put the fault into a copy of the tree temporarily."""
        place, path = self.line(root), root / self.file
        right = path.read_text(encoding="utf-8")
        lines = right.split("\n")
        line = lines[place]
        lines[place] = line[: len(line) - len(line.lstrip())] + self.now.strip()
        path.write_text("\n".join(lines), encoding="utf-8")
        try:
            yield
        finally:
            path.write_text(right, encoding="utf-8")


def read() -> list[Mutant]:
    """Return all faults of the list."""
    return [Mutant(**table) for table in tomllib.loads(LIST.read_text(encoding="utf-8"))["mutant"]]


def record() -> None:
    """Run the suite, and store the lines executed by each test."""
    RECORD.parent.mkdir(exist_ok=True)
    words = "-n", str(os.cpu_count()), "--dist", "loadfile", "--timeout", "600"
    cover = "--cov", "--cov-context=test", "--cov-report="
    env = os.environ | {"COVERAGE_FILE": str(RECORD)}
    subprocess.run([sys.executable, "-m", "pytest", *words, *cover], cwd=ROOT, env=env)


def _spans(tree: ast.AST, line: int) -> list[range]:
    """Lines of the statement at a line (from 1), without its body, and bodies of the functions around it."""
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.stmt) and node.lineno <= line <= node.end_lineno]
    nodes.sort(key=lambda node: node.end_lineno - node.lineno)  # the innermost first
    spans = []
    for node in nodes:
        body = getattr(node, "body", None)
        if isinstance(node, ast.FunctionDef):
            spans.append(range(body[0].lineno, node.end_lineno + 1))
        elif node is nodes[0] and not isinstance(node, ast.ClassDef):
            spans.append(range(node.lineno, body[0].lineno if body else node.end_lineno + 1))
    return spans


def tests_of(mutant: Mutant) -> list[list[str]]:
    """Groups of tests that may notice a fault: those that execute its statement, or those of its room."""
    if mutant.is_compiled:
        groups = [[path for name in names for path in sorted((ROOT / name).glob("test_*.py"))] for names in CORE]
    else:
        if RECORD.exists():
            contexts = _recorded().contexts_by_lineno(str(ROOT / mutant.file))
            tree = ast.parse((ROOT / mutant.file).read_text(encoding="utf-8"))
            for span in _spans(tree, mutant.line(ROOT) + 1):
                names = {name.rpartition("|")[0] for line in span for name in contexts.get(line, ())} - {""}
                if names := {name if name in _collected() else name.partition("::")[0] for name in names}:
                    return [sorted(name for name in names if "::" in name or (ROOT / name).exists()), _newer()]
        groups = [rooms.files(mutant.room)]
    return [[path.relative_to(ROOT).as_posix() for path in files] for files in groups]


@cache
def _recorded() -> CoverageData:
    data = CoverageData(str(RECORD))
    data.read()
    return data


@cache
def _newer() -> list[str]:
    """Names of the tests of behaviour that the record does not contain."""
    found = _collected() - {name.rpartition("|")[0] for name in _recorded().measured_contexts()}
    return sorted(name for name in found if not name.startswith("tests/structure/"))


@cache
def _collected() -> set[str]:
    """Names of all tests; since the record was made, some may have been renamed."""
    done = subprocess.run([sys.executable, "-m", "pytest", "--collect-only"], cwd=ROOT, capture_output=True)
    return {line for line in done.stdout.decode().splitlines() if "::" in line}


def _copy(folder: Path) -> Path:
    """Copy the tree, with only the core of this machine."""
    for part in COPIED:
        shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__", "_build"))
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy2(path, folder)
    for level in set(build.LEVELS) - {build.best_level()}:
        build.library_path(level, folder / CORE_FOLDER).unlink(missing_ok=True)
    return folder


def _environment(root: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(root / "src"), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def is_noticed(mutant: Mutant, root: Path, groups: list[list[str]], right: Path) -> str:
    """Return the first test that fails only with the fault, or another reason for an early end; "" if there is none."""
    broken: list[str] = []
    try:
        with mutant.applied(root):
            if mutant.is_compiled and not _compiles(root):
                return "the compiler"
            for tests in groups:
                while "::" in (failed := _first_failure(root, [*tests, *broken])):
                    if _first_failure(right, [failed]) != failed:
                        break
                    broken.append(f"--deselect={failed}")  # it fails without the fault as well
                if failed and ("::" in failed or _first_failure(right, tests) != failed):
                    return failed
            return ""
    finally:
        if mutant.is_compiled:
            _restore_core(root, right)


def _restore_core(root: Path, right: Path) -> None:
    """Copy the correct core with its objects, so that the next fault compiles only the sources that it changes."""
    shutil.rmtree(root / CORE_FOLDER)
    shutil.copytree(right / CORE_FOLDER, root / CORE_FOLDER)


def _compiles(root: Path, *options: str) -> bool:
    call = [sys.executable, root / CORE_FOLDER / "build.py", *options]
    return not subprocess.run(call, cwd=root, env=_environment(root), capture_output=True).returncode


def _first_failure(root: Path, tests: list[str]) -> str:
    """Name of the first test that fails, or the outcome of the tests; "" if all pass."""
    call = [sys.executable, "-m", "pytest", "-x", "--fastest-first", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(call, cwd=root, env=_environment(root), capture_output=True, text=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return "too slow"
    failed = re.findall(r"(?m)^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout)
    return failed[-1] if failed else f"{EXIT}{done.returncode}" if done.returncode else ""


def main() -> None:
    """Run faults, and print those that no test notices."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--room", help="only faults of this room")
    parser.add_argument("--sample", type=int, help="this many faults, drawn at random")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--check", action="store_true", help="only check that every fault applies")
    parser.add_argument("--record", action="store_true", help="run the suite first, and store the lines of each test")
    parser.add_argument("--missing", action="store_true", help="only faults not noticed so far, as after ctrl-C")
    given = parser.parse_args()
    chosen = [mutant for mutant in read() if given.room in (None, mutant.room)]
    for mutant in chosen:
        mutant.line(ROOT)
    known = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    if given.check:
        if stray := sorted(known.keys() - {mutant.name for mutant in read()}):
            raise ValueError(f"{RESULTS.name} has results of faults that are not in the list: {stray[0]}")
        return print(f"all {len(chosen)} faults apply")
    if given.sample:
        chosen = random.Random(given.seed).sample(chosen, min(given.sample, len(chosen)))
    if given.record:
        record()
    left = [mutant for mutant in chosen if not (given.missing and known.get(mutant.name))]
    tests = {mutant: tests_of(mutant) for mutant in left}
    left.sort(key=lambda one: sum(1 if "::" in name else MANY for names in tests[one] for name in names))
    roots: SimpleQueue[Path] = SimpleQueue()

    def run(mutant: Mutant) -> str:
        root = roots.get()
        try:
            last = known.get(mutant.name, "")
            if "::" in last and "::" in (noticed := is_noticed(mutant, root, [[last]], right)):
                return noticed
            return is_noticed(mutant, root, tests[mutant], right)
        finally:
            roots.put(root)

    with tempfile.TemporaryDirectory(prefix="mutants-") as name, ThreadPoolExecutor(given.workers) as pool:
        right = _copy(Path(name) / "right")
        if any(mutant.is_compiled for mutant in left):
            _compiles(right, "--force")
        for k in range(given.workers):
            roots.put(root := _copy(Path(name) / str(k)))
            _restore_core(root, right)
        jobs = {pool.submit(run, mutant): mutant for mutant in left}
        for job in as_completed(jobs):
            mutant = jobs[job]
            known[mutant.name] = noticed = job.result()
            print(f"{'noticed' if noticed else 'MISSED '}  {mutant.file}: {mutant.now}  {noticed}", flush=True)
            RESULTS.write_text(json.dumps(dict(sorted(known.items())), indent=1, ensure_ascii=False) + "\n", "utf-8")
    share = sum(bool(known[mutant.name]) for mutant in chosen) / max(1, len(chosen))
    print(f"{share:.1%} of {len(chosen)} faults are noticed")
    return None


if __name__ == "__main__":
    main()
