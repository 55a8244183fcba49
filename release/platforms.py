"""`make platforms`: compile the core for every platform with a wheel, and compare the functions in the libraries.

The compiler of the package `ziglang` builds for Linux, macOS and Windows on any of these systems. A function that is
missing from a library, such as one that is visible on Linux alone, would otherwise be noticed only when somebody calls
it. Nothing built here is installed: hosted CI builds and tests the wheels on their own platforms.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from release import ROOT, tools

PLATFORMS = (("linux", "x86_64"), ("linux", "aarch64"), ("darwin", "arm64"), ("darwin", "x86_64"), ("win32", "AMD64"))
BUILD = """\
import platform, runpy, sys
path, sys.platform, machine, out = sys.argv[1:]
platform.machine = lambda: machine
build = runpy.run_path(path)
print(build["build"](out=build["Path"](out), levels=build["LEVELS"]))
"""
EXPORTS = """\
import sys
import lief

for path in sys.argv[1:]:
    library = lief.parse(path)
    prefix = "_" if path.endswith(".dylib") else ""
    print(path, *(one.name.removeprefix(prefix) for one in library.exported_functions), *(
        one.name.removeprefix(prefix) for one in getattr(library, "exported_symbols", ())))
"""
OF_TOOLS = {"_CRT_INIT", "__mingw_module_is_dll", "atexit", "_dso_handle", "__dso_handle", "_mh_dylib_header"}


def exported(python: Path, libraries: list[Path]) -> dict[Path, set[str]]:
    """Functions of this package in each library, by its path."""
    call = [python, "-c", EXPORTS, *libraries]
    lines = subprocess.run([*map(str, call)], check=True, capture_output=True, text=True).stdout.splitlines()
    return {Path(path): set(names) - OF_TOOLS for path, *names in map(str.split, lines)}


def main() -> None:
    """Build the libraries of all platforms, and print the functions that they lack or have in addition."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python = tools(folder / "tools") / "python"
        for system, machine in PLATFORMS:
            path, out = ROOT / "src/stickslip/_core/build.py", folder / f"{system}-{machine}"
            call = [python, "-c", BUILD, path, system, machine, out]
            run = subprocess.run(
                [*map(str, call)], capture_output=True, text=True, env={"CXX": "ziglang", "HOME": name}
            )
            if run.returncode:
                raise SystemExit(f"{system} {machine}: {(run.stderr or run.stdout).strip().splitlines()[-1]}")
            print(f"{system} {machine}: {run.stdout.strip()}", flush=True)
        found = exported(python, sorted(folder.glob("*/core-[!p]*.*")))
    wanted = next(names for path, names in found.items() if path.parent.name == "linux-x86_64")
    for path, names in found.items():
        differ = [f"lacks {', '.join(sorted(wanted - names))}"] if wanted - names else []
        differ += [f"also has {', '.join(sorted(names - wanted))}"] if names - wanted else []
        print(f"{path.parent.name} {path.name}: {len(names)} functions {'; '.join(differ)}".rstrip())
    if any(names != wanted for names in found.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
