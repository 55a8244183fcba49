"""Build the compiled core: one shared library for each processor level, next to the sources.

    python src/stickslip/_core/build.py [--all | --level base] [--force] [--verbose]
    python src/stickslip/_core/build.py --sanitize address,undefined --out DIR

The library for this machine is built unless others are requested. The C++ compiler is the machine's own, or else that
of the package `ziglang`. A small library, the probe, finds the level of a processor. Each library holds a stamp with
the digest of its sources, and is rebuilt only if the digest has changed. This file needs only the standard library,
because it also runs before the package is installed.
"""

import argparse
import ctypes
import hashlib
import importlib.util
import json
import os
import platform
import re
import shlex
import shutil
import struct
import subprocess
import sys
import sysconfig
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

HERE = Path(__file__).resolve().parent
SUFFIX = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")
MACHINE = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
MACOS, GLIBC = "11.0", "2.28"  # oldest systems on which the libraries run, if the compiler supports them
ZIGLANG = "ziglang>=0.17"  # package that contains a C++ compiler
NO_COMPILER = (
    "no C++ compiler works here: install GCC or Clang (Debian: apt install g++; macOS: xcode-select --install), "
    f"or run {shlex.join([sys.executable, '-m', 'pip', 'install', ZIGLANG])}"
)
_X86 = {
    "base": ["-march=x86-64"],
    "avx2": ["-march=x86-64-v3"],
    "avx512": ["-march=x86-64-v4", "-mprefer-vector-width=512"],
}
_MARCH = _X86 if MACHINE == "x86_64" else {"base": []}
LEVELS = tuple(_MARCH)  # lowest first
OBJECTS = ".objects"  # folder of compiled sources beside the libraries
PROBE, PROBE_SOURCE = "probe", "level.cpp"  # library that finds the level, compiled for the lowest one
FLAGS = [
    "-std=c++17", "-O3", "-fPIC", "-fvisibility=hidden", "-fno-exceptions", "-fno-rtti", "-fno-threadsafe-statics",
    "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off",
    "-Wall", "-Wextra", "-Wno-psabi", "-Wno-bitwise-instead-of-logical", "-Werror=return-type",
]  # fmt: skip
_SANITIZE = ["-O1", "-g", "-fno-omit-frame-pointer", "-fno-sanitize-recover=all"]
_PROBE = '#include <math.h>\nextern "C" double probe(double x) { return exp(x); }\n'
_MARK = "stickslip core "  # beginning of the stamp in a library
_STAMP = """\
extern "C" __attribute__((visibility("default"))) const char core_stamp[];
const char core_stamp[] = {};
"""


class BuildError(RuntimeError):
    """The core cannot be built or used. The message is one sentence that includes the remedy."""


class Compiler(NamedTuple):
    """A C++ compiler."""

    command: list[str]
    version: str

    @property
    def is_zig(self) -> bool:
        """Return True for the compiler of the package `ziglang`."""
        return Path(self.command[0]).stem == "zig"

    def compile(self, level: str) -> list[str]:
        """Return the command and flags that compile a source for a level."""
        if not self.is_zig:
            return [*self.command, *_apple(), *FLAGS, *_MARCH[level]]
        march = [re.sub("^-march=x86-64-?", "-mcpu=x86_64_", flag).rstrip("_") for flag in _MARCH[level]]
        own = ["-D_USE_MATH_DEFINES"] if sys.platform == "win32" else []  # defines M_PI
        # without a target, zig compiles for this processor
        return [*self.command, "c++", "-target", _zig_target(), *march, *FLAGS, *own, "-fno-sanitize=undefined", "-g0"]

    def link(self, sanitize: str = "") -> list[str]:
        """Return the command and flags that link objects into a library, without flags that change floating point."""
        if not self.is_zig:
            strict = ["-Wl,--no-undefined,--as-needed"] if sys.platform == "linux" and not sanitize else []
            return [*self.command, *_apple(), "-shared", "-pthread", *strict]
        if sys.platform == "linux":  # `cc` first compiles a runtime library, for 17 s; Python has loaded libc and libm
            return [*self.command, "ld.lld", "-shared"]
        return [*self.command, "cc", "-target", _zig_target(), "-shared", "-pthread"]


def _apple() -> list[str]:
    return ["-arch", platform.machine(), f"-mmacosx-version-min={MACOS}"] if sys.platform == "darwin" else []


def _zig_target() -> str:
    linux = f"linux-gnu.{GLIBC}" if platform.libc_ver()[0] == "glibc" else "linux-musl"
    return f"{MACHINE}-" + {"darwin": f"macos.{MACOS}", "win32": "windows-gnu"}.get(sys.platform, linux)


def _ziglang() -> list[list[str]]:
    spec = importlib.util.find_spec("ziglang")
    return [[str(Path(spec.origin).with_name("zig"))]] if spec and spec.origin else []


def find_compiler() -> Compiler | None:
    """Find the first working C++ compiler: from CXX, from the search path, or from the package `ziglang`.

    CXX=ziglang selects the last one. On Windows, compilers on the search path are not tried.
    """
    text = os.environ.get("CXX", "")
    try:
        asked = shlex.split(text)
    except ValueError:  # an unclosed quotation mark
        asked = [text]
    if asked == ["ziglang"]:
        candidates = _ziglang()
    else:
        names = () if sys.platform == "win32" else ("c++", "g++", "clang++")
        candidates = [*([asked] if asked else []), *([name] for name in names), *_ziglang()]
    for command in candidates:
        if compiler := _try_compiler(command):
            return compiler
        if command == asked:
            print(f"CXX={shlex.join(asked)} does not compile: other compilers are tried", file=sys.stderr)
    return None


def _try_compiler(command: list[str]) -> Compiler | None:
    """Return the compiler that a command runs, if it can build a library for the highest level."""
    if not shutil.which(command[0]):
        return None
    compiler = Compiler(command, "")
    with tempfile.TemporaryDirectory() as name:
        source, target, library = (Path(name) / f"probe{suffix}" for suffix in (".cpp", ".o", SUFFIX))
        source.write_text(_PROBE)
        for arguments in (
            [*compiler.compile(LEVELS[-1]), "-c", source, "-o", target], [*compiler.link(), target, "-o", library]
        ):  # fmt: skip
            if _run(arguments).returncode:
                return None
    says = _run([*command, *(["c++"] if compiler.is_zig else []), "--version"]).stdout.partition("\n")[0].strip()
    return compiler._replace(version=f"ziglang: {says}" if compiler.is_zig else says)


def _run(command: list) -> subprocess.CompletedProcess:
    """Run a command; return an exit status even if the command cannot be started."""
    command = [*map(str, command)]
    try:
        return subprocess.run(command, capture_output=True, text=True, errors="replace")
    except OSError as error:
        return subprocess.CompletedProcess(command, 126, "", f"{error.strerror}: {command[0]}")


def digest(folder: Path = HERE) -> str:
    """Digest of the sources in a folder and of the compiler flags."""
    digested = hashlib.sha256(json.dumps([FLAGS, _MARCH]).encode())
    for path in [*_headers(folder), *sorted(folder.glob("*.cpp"))]:
        digested.update(f"\0{path.name}\0".encode() + path.read_bytes())
    return digested.hexdigest()[:16]


def _headers(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.h"))


def library_path(level: str, folder: Path | None = None) -> Path:
    """Path of the library for a level, beside the sources or in the folder that STICKSLIP_CORE names."""
    return Path(folder or os.environ.get("STICKSLIP_CORE") or HERE) / f"core-{level}{SUFFIX}"


def stamp(path: Path) -> dict[str, str]:
    """Digest, compiler, command, target and sanitizers as stored in a library; empty if this is incomplete."""
    content = path.read_bytes() if path.is_file() else b""
    mark = re.search(re.escape(_MARK.encode()) + rb"(\{[^\0]*\})\0", content)
    return json.loads(mark[1]) if mark and not _is_truncated(content) else {}


def _is_truncated(content: bytes) -> bool:
    """Return True if an ELF file ends before its section table, which comes last; loading it could crash Python."""
    if not content.startswith(b"\x7fELF\x02\x01"):  # not 64-bit and little-endian
        return False
    start, size, number = struct.unpack("<40x Q 10x HH", content[:62])
    return start + size * number > len(content)


def library(level: str) -> Path:
    """Path of the library for a level; raise an error if there is none, or if it was built from other sources."""
    path, command = library_path(level), [sys.executable, str(HERE / "build.py")]
    command += ["--level", level] if level in LEVELS else []
    command += ["--out", str(path.parent)] if path.parent != HERE else []
    remedy = f"{shlex.join(command)} builds it"
    if not path.exists():
        raise BuildError(f"the compiled core {path} does not exist: {remedy}")
    if stamp(path).get("digest") != digest():
        raise BuildError(
            f"the compiled core {path} is damaged, or was built from sources other than those in {HERE}: {remedy}"
        )
    return path


def usable_levels(folder: Path | None = None) -> tuple[str, ...]:
    """Levels that this processor can run, lowest first, found by the probe beside the sources or in a folder."""
    probe = library_path(PROBE, folder) if folder else library(PROBE)
    return LEVELS[: ctypes.CDLL(str(probe)).core_processor_level() + 1]


def best_level() -> str:
    """Highest level that this processor can run and whose library was built, or the one that STICKSLIP_LEVEL names."""
    usable = usable_levels()
    built = [level for level in usable if library_path(level).exists()]
    asked = os.environ.get("STICKSLIP_LEVEL") or (built or usable)[-1]
    if asked not in usable:
        raise BuildError(f"STICKSLIP_LEVEL is {asked}: this processor runs {' and '.join(usable)}")
    return asked


def platform_tag() -> str:
    """Platform tag of a wheel that contains these libraries."""
    if sys.platform == "darwin":
        return f"macosx_{MACOS}_{platform.machine()}".replace(".", "_")
    if stamp(library_path(PROBE, HERE)).get("target", "").endswith(GLIBC):
        return f"manylinux_{GLIBC}_{MACHINE}".replace(".", "_")
    return sysconfig.get_platform().replace("-", "_").replace(".", "_")


def build(
    folder: Path = HERE,
    out: Path | None = None,
    *,
    levels: tuple[str, ...] = (),
    sanitize: str = "",
    force: bool = False,
    verbose: bool = False,
) -> str:
    """Build the probe and libraries, if they do not match the sources, and return a one-line summary.

    Parameters
    ----------
    folder : folder of the sources
    out : folder for libraries and objects; by default, that of the sources
    levels : levels to build; by default, the highest one that this processor can run
    sanitize : sanitizers of the compiler, separated by commas
    force : build even if the libraries are up to date
    verbose : print commands, and the complete messages of the compiler

    Raises
    ------
    BuildError
        If there is no compiler, if compilation fails, or if a file cannot be written. Existing libraries are kept.
    """
    start, out = time.perf_counter(), out or folder
    wanted = {"digest": digest(folder), "sanitize": sanitize}
    if asked := os.environ.get("CXX"):
        wanted["asked"] = asked

    def is_current(name: str) -> bool:
        return wanted.items() <= stamp(library_path(name, out)).items()

    def is_done() -> bool:
        return not force and is_current(PROBE) and all(map(is_current, levels or usable_levels(out)[-1:]))

    try:
        if is_done():
            return "the compiled core is up to date"
        with _alone_in(out):
            if is_done():
                return "another process has built the core"
            making = _Making(folder, out, wanted, force, verbose)
            making.make([PROBE])
            levels = levels or usable_levels(out)[-1:]
            making.make(levels)
    except OSError as error:
        raise BuildError(
            f"the core was not built: {error.filename or out}: {(error.strerror or str(error)).lower()}; make it "
            "writable, or give another folder with --out, which STICKSLIP_CORE then names"
        ) from None
    names, seconds = " and ".join(levels), time.perf_counter() - start
    return f"the compiled core ({names}) was built in {seconds:.1f} s by {making.compiler.version}"


@contextmanager
def _alone_in(out: Path):
    """Wait until no other process builds in the same folder, and prevent others from starting."""
    (out / OBJECTS).mkdir(parents=True, exist_ok=True)
    with open(out / OBJECTS / "lock", "w") as file:
        if fcntl:
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


class _Making:
    """Compilation and linking of libraries."""

    def __init__(self, folder: Path, out: Path, wanted: dict[str, str], force: bool, verbose: bool):
        compiler = find_compiler()
        if compiler is None:
            raise BuildError(NO_COMPILER)
        if wanted["sanitize"] and compiler.is_zig:
            raise BuildError("sanitizers need GCC or Clang: set CXX to one of them")
        made = {"asked": "", "compiler": compiler.version, "command": shlex.join(compiler.command)}
        made |= wanted | {"target": _zig_target() if compiler.is_zig else ""}
        self.compiler, self.folder, self.out, self.made, self.verbose = compiler, folder, out, made, verbose
        self.objects = out / OBJECTS
        killed = self.objects.glob(".[0-9]*") if fcntl else ()  # files left by builds that were killed
        for path in [*killed, *(self.objects.glob("*.o") if force else ())]:
            path.unlink(missing_ok=True)
        self.shared = b"".join(path.read_bytes() for path in _headers(folder)) + compiler.version.encode()
        self.stamp = self.objects / "stamp.cpp"
        _replace(self.stamp, _STAMP.format(json.dumps(_MARK + json.dumps(made))).encode())

    def make(self, names) -> None:
        """Build the libraries for some levels, or the probe, in parallel."""
        every = sorted(self.folder.glob("*.cpp"), key=lambda path: -path.stat().st_size)
        sources = {name: [self.folder / PROBE_SOURCE] if name == PROBE else every for name in names}
        jobs = [(path, name) for name in reversed(names) for path in [*sources[name], self.stamp]]
        with ThreadPoolExecutor(_cores()) as pool:
            made = list(pool.map(lambda job: self._compile(*job), jobs))
        for name in names:
            own = [target for target, job in zip(made, jobs, strict=True) if job[1] == name]
            command = [*self.compiler.link(self.made["sanitize"]), *self._extra(name), *sorted(own)]
            try:
                _make(library_path(name, self.out), command, self.objects, self.verbose)
            except BuildError as error:
                if "undefined" not in str(error):  # an object file may be damaged
                    for path in own:
                        path.unlink(missing_ok=True)
                raise
            for path in set(self.objects.glob(f"*-{name}-*.o")) - set(own):
                path.unlink(missing_ok=True)

    def _extra(self, name: str) -> list[str]:
        """Flags of the sanitizers; the probe has none, because this process loads it."""
        asked = self.made["sanitize"]
        return [f"-fsanitize={asked}", *_SANITIZE] if asked and name != PROBE else []

    def _compile(self, source: Path, name: str) -> Path:
        text = source.read_bytes()
        first = text.partition(b"\n")[0].decode()
        own = shlex.split(first.removeprefix("// build:")) if first.startswith("// build:") else []
        command = [*self.compiler.compile(LEVELS[0] if name == PROBE else name), *own, *self._extra(name)]
        key = hashlib.sha256(self.shared + text + "\0".join(command).encode()).hexdigest()[:16]
        target = self.objects / f"{source.stem}-{name}-{key}.o"
        if not target.exists():
            _make(target, [*command, "-c", source], self.objects, self.verbose)
        return target


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _make(target: Path, command: list, scratch: Path, verbose: bool) -> None:
    """Run a compiler or linker; its target is replaced only by a complete file."""
    part = scratch / f".{os.getpid()}-{target.name}"
    command = [*command, "-o", part]
    if verbose:
        print(shlex.join(map(str, command)))
    run = _run(command)
    if run.returncode or not part.exists():
        part.unlink(missing_ok=True)
        if not run.stderr.strip():
            raise BuildError(
                f"the core was not built: {command[0]} exited with {run.returncode} and wrote no {target.name}"
            )
        raise BuildError(run.stderr if verbose else _first_error(run.stderr))
    if run.stderr:
        print(run.stderr, end="", file=sys.stderr)
    os.replace(part, target)


def _first_error(text: str) -> str:
    """One sentence from the messages of a compiler or linker."""
    if match := re.search(r"^(.+?):(\d+):(?:\d+:)? (?:fatal )?error: (.*)$", text, flags=re.MULTILINE):
        return f"the core was not built: {match[1]}, line {match[2]}: {match[3]}"
    lines = [line for line in text.splitlines() if re.search("error|undefined", line)] or text.splitlines() or [""]
    return f"the core was not built: {lines[0].strip()}"


def _replace(path: Path, content: bytes) -> None:
    part = path.with_name(f".{os.getpid()}-{path.name}")
    part.write_bytes(content)
    os.replace(part, path)


def preload(sanitize: str) -> str:
    """Runtime libraries of sanitizers, which LD_PRELOAD must name before Python loads a library that needs them."""
    compiler, names = find_compiler(), {"address": "asan", "undefined": "ubsan", "thread": "tsan"}
    asked = [f"-print-file-name=lib{names[option]}.so" for option in sanitize.split(",") if option in names]
    return ":".join(_run([*compiler.command, option]).stdout.strip() for option in asked) if compiler else ""


def main() -> None:
    """Build the core from the command line."""
    parser = argparse.ArgumentParser(description="Build the compiled core.")
    parser.add_argument("--all", action="store_true", help="for all levels of processors")
    parser.add_argument("--level", action="append", choices=LEVELS, default=[], help="for this level")
    parser.add_argument("--force", action="store_true", help="even if it is up to date")
    parser.add_argument("--verbose", action="store_true", help="print commands and all messages of the compiler")
    parser.add_argument("--find", action="store_true", help="print the compiler only; the exit status is 1 without one")
    parser.add_argument("--sanitize", default="", metavar="address,undefined", help="sanitizers; needs --out")
    parser.add_argument("--out", type=Path, help="folder for the libraries")
    given = parser.parse_args()
    if given.sanitize and not given.out:
        parser.error("--sanitize needs --out: Python cannot load such libraries without their runtime")
    if given.find:
        compiler = find_compiler()
        sys.exit(print(compiler.version) if compiler else NO_COMPILER)
    try:
        levels = LEVELS if given.all else tuple(given.level)
        options = {"sanitize": given.sanitize, "force": given.force, "verbose": given.verbose}
        print(build(HERE, given.out, levels=levels, **options))
    except BuildError as error:
        sys.exit(str(error))
    if given.sanitize:
        print(f"STICKSLIP_CORE={given.out} LD_PRELOAD={preload(given.sanitize)} loads it")


if __name__ == "__main__":
    main()
