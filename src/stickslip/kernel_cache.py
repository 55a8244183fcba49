"""Disk cache of compiled kernels: its folder, the key of each module, and repair of damaged files.

Numba compiles a function again when any byte of its file has changed, but does not notice changes in other files.
Kernels of this package are kept in one folder per module, named by a digest of what determines the machine code: the
syntax trees (without docstrings and comments) of the module and of every module of the package that it imports, and
Numba's version and settings. A changed docstring recompiles nothing; a changed contact law recompiles everything that
uses it.

If a kernel is not in the user's cache, a prebuilt one may be used; see `prebuilt`.

Numba unpickles what it finds on disk. Each saved kernel therefore ends with its checksum. A kernel whose file does not
match its checksum, or cannot be unpickled, is compiled again, with one warning.
"""

import ast
import atexit
import contextlib
import functools
import hashlib
import json
import os
import shutil
import sys
import tempfile
import types
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
from numba.core import event
from numba.core.caching import Cache, CacheImpl, IndexDataCacheFile, _CacheLocator

from . import compilation, prebuilt

_PACKAGE = Path(__file__).parent
_CONFIG: Any = numba.config
_TEMPORARY = "STICKSLIP_KERNELS"
_PREFIX = "stickslip-kernels-"
_SYNTAX = "syntax.json"  # digests of syntax trees by digests of files: parsing takes half a second
_MARK = b"\0stickslip, SHA-256:\0"
# Numba's settings that change machine code
_SETTINGS = (
    "BOUNDSCHECK", "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "ENABLE_AVX", "USING_SVML", "DEBUGINFO_DEFAULT",
    "LLVM_REFPRUNE_PASS", "LLVM_REFPRUNE_FLAGS", "EXTEND_VARIABLE_LIFETIMES", "DEBUG_NRT", "PARFOR_MAX_TUPLE_SIZE",
)  # fmt: skip
# modules that find functions of another one when types are inferred, without an import
_LOOKED_UP = {"stickslip.core.laws.oracle": ("stickslip.core.laws.user",)}


# ---- the folder


@functools.cache
def folder() -> Path:
    """Folder of all compiled kernels: NUMBA_CACHE_DIR or the user's cache; if it is not writable, a temporary one."""
    if _CONFIG.CACHE_DIR:
        chosen = Path(_CONFIG.CACHE_DIR)
        return chosen if _is_usable(str(chosen)) else _temporary()
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stickslip"
    try:
        base.mkdir(parents=True, exist_ok=True)
        if os.access(base, os.W_OK):
            return base
    except OSError:
        pass
    return _temporary()


def is_temporary() -> bool:
    """Return True if no other folder could be written to, so that kernels last only as long as this process."""
    return folder().name.startswith(_PREFIX)


def _temporary() -> Path:
    """Create a folder that is removed when this process ends; its worker processes use it, too."""
    compilation.forget_afterwards()
    path = os.environ.get(_TEMPORARY)
    if not (path and os.access(path, os.W_OK)):
        path = os.environ[_TEMPORARY] = tempfile.mkdtemp(prefix=_PREFIX)
        atexit.register(shutil.rmtree, path, ignore_errors=True)
    return Path(path)


def prebuilt_state() -> str:
    """Say whether prebuilt kernels are used, and for how many modules, or why not."""
    found = prebuilt.find()
    if not found.folder:
        return found.reason
    names = [path.name.rpartition("-") for path in found.folder.iterdir() if path.is_dir()]
    current = sum(
        _file(f"stickslip.{module}") is not None and digest(f"stickslip.{module}") == key for module, _, key in names
    )
    if not current:
        return "not used: built from other sources or with other settings of Numba"
    return f"{found.reason}: {current} of {len(names)} modules are up to date"


def outdated() -> list[Path]:
    """Folders of kernels that the current sources do not use."""
    found = []
    with contextlib.suppress(OSError):
        for path in folder().iterdir():
            module, _, key = path.name.rpartition("-")
            own = path.is_dir() and len(key) == 16 and not set(key) - set("0123456789abcdef")
            if own and not (_file(f"stickslip.{module}") and digest(f"stickslip.{module}") == key):
                found.append(path)
    return found


# ---- the key of a module


@functools.cache
def digest(module: str) -> str:
    """Digest of what determines the machine code of a module's kernels.

    Parameters
    ----------
    module : full name, such as "stickslip.core.contacts.forces"

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    found, waiting = {}, [module]
    while waiting:
        name = waiting.pop()
        path = _file(name)
        if path and name not in found and name not in (__name__, prebuilt.__name__):
            found[name], imports = _syntax(path)
            waiting += [*_names(imports, name, path.name == "__init__.py"), *_LOOKED_UP.get(name, ())]
    settings = [getattr(_CONFIG, name, None) for name in _SETTINGS]
    text = repr((numba.__version__, settings, sorted(found.items())))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@functools.cache
def _file(module: str) -> Path | None:
    """Source file of a module of this package."""
    package, *parts = module.split(".")
    base = _PACKAGE.joinpath(*parts)
    choices = (base / "__init__.py", base.with_suffix(".py")) if parts else (base / "__init__.py",)
    return next((path for path in choices if package == "stickslip" and path.is_file()), None)


def _names(imports: list, module: str, is_package: bool) -> Iterator[str]:
    """Full names of modules that import statements may load."""
    for level, base, names in imports:
        if level:
            parents = module.split(".")
            parents = parents[: len(parents) - level + is_package]
            base = ".".join([*parents, *([base] if base else [])])
        yield base
        yield from (f"{base}.{name}" for name in names)


@functools.cache
def _syntax(path: Path) -> tuple[str, list]:
    """Digest of the syntax tree of a source file, and its import statements as (level, module, names)."""
    source = path.read_bytes()
    known, key = _known(), hashlib.sha256(source + sys.version.encode()).hexdigest()  # trees differ among versions
    if key not in known:
        tree = _without_docstrings(ast.parse(source))
        imports: list[tuple[int, str, list[str]]] = []
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                imports += [(0, alias.name, []) for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                imports.append((node.level, node.module or "", [alias.name for alias in node.names]))
        known[key] = hashlib.sha256(ast.dump(tree).encode()).hexdigest(), imports
        _save_known()
    return known[key]


def _without_docstrings(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and ast.get_docstring(
            node, clean=False
        ):
            node.body = node.body[1:] or [ast.Pass()]
    return tree


@functools.cache
def _known() -> dict[str, tuple[str, list]]:
    try:
        table = json.loads((folder() / _SYNTAX).read_bytes())
        return {
            str(key): (str(text), [(int(level), str(base), list(map(str, names))) for level, base, names in imports])
            for key, (text, imports) in table.items()
        }
    except (OSError, ValueError, TypeError, AttributeError):
        return {}


@functools.cache
def _save_known() -> None:
    """Save new digests of syntax trees once, when the process ends."""
    atexit.register(_write_known)


def _write_known() -> None:
    with contextlib.suppress(OSError):
        folder().mkdir(parents=True, exist_ok=True)
        handle, path = tempfile.mkstemp(dir=folder(), suffix=".json")
        try:
            with os.fdopen(handle, "w") as file:
                json.dump(_known(), file)
            os.replace(path, folder() / _SYNTAX)
        except OSError:
            os.unlink(path)


# ---- Numba's view of it


class _Locator(_CacheLocator):
    """Location and cache key of one of this package's kernels."""

    def __init__(self, function, module: str):
        self._function, self._module = function, module
        self._py_file = function.__code__.co_filename  # Numba names it in warnings

    def get_cache_path(self) -> str:
        return str(folder() / f"{self._module.removeprefix('stickslip.')}-{digest(self._module)}")

    def get_source_stamp(self) -> str:
        return digest(self._module)

    def get_disambiguator(self) -> str:
        """Digest of the function's code, which tells functions of the same name apart wherever they are in the file."""
        text = repr(_without_lines(self._function.__code__, self._function.__doc__))
        return hashlib.sha256(text.encode()).hexdigest()[:8]

    @classmethod
    def from_function(cls, function, file: str) -> "_Locator | None":
        path = Path(file)
        if not path.is_relative_to(_PACKAGE) or path.suffix != ".py":
            return None
        parts = path.relative_to(_PACKAGE).with_suffix("").parts
        module = ".".join(("stickslip", *parts)).removesuffix(".__init__")
        locator = cls(function, module)
        return locator if _is_usable(locator.get_cache_path()) else None  # else Numba finds a place


@functools.cache
def _is_usable(path: str) -> bool:
    with contextlib.suppress(OSError):
        os.makedirs(path, exist_ok=True)
        return os.access(path, os.W_OK)
    return False


def _without_lines(code: types.CodeType, docstring: str | None = None) -> tuple:
    """Contents of a code object that do not change when it moves in its file."""
    constants = [
        _without_lines(one)
        if isinstance(one, types.CodeType)
        else sorted(map(repr, one))
        if isinstance(one, frozenset)
        else repr(one)
        for one in code.co_consts
        if one != docstring
    ]
    return code.co_name, code.co_code, constants, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars


# ---- damaged files


class DamagedKernelWarning(RuntimeWarning):
    """A compiled kernel on disk was damaged and has been compiled again."""


@functools.cache
def _warn(path: str, problem: str) -> None:
    words = f"the compiled kernel {path} is damaged ({problem}): it will be compiled again"
    warnings.warn(words, DamagedKernelWarning, stacklevel=3)


def _load(self, key, load=IndexDataCacheFile.load):
    """Load a kernel from the user's cache, or else a prebuilt one."""
    found = load(self, key)
    place, path = prebuilt.find().folder, Path(self._index_path)
    if found is None and place and path.parent.parent == folder():
        other = IndexDataCacheFile(str(place / path.parent.name), path.stem, self._source_stamp)
        with contextlib.suppress(OSError):  # a file that cannot be read is a missing one
            found = load(other, prebuilt.key_of(key))
    return found


def _load_index(self, load=IndexDataCacheFile._load_index):
    try:
        return load(self)
    except OSError:
        raise
    except Exception as problem:  # whatever unpickling runs into
        _warn(self._index_path, type(problem).__name__)
        return {}


def _load_data(self, name, load=IndexDataCacheFile._load_data):
    path = self._data_path(name)
    try:
        with open(path, "rb") as file:
            data = file.read()
        body, mark, checksum = data.rpartition(_MARK)
        if (mark or _is_ours(path)) and hashlib.sha256(body).digest() != checksum:
            raise ValueError("the checksum does not match")
        if _is_ours(path) and name != self._data_name(int.from_bytes(checksum[:6])):
            raise ValueError("it is another kernel's")
        return load(self, name)
    except OSError:
        raise
    except Exception as problem:
        _warn(path, type(problem).__name__)
        raise OSError(f"{path} is damaged") from problem  # Numba takes it for a missing kernel


def _is_ours(path: str) -> bool:
    """Return True for files of this package's kernels, which `_save` wrote."""
    return Path(path).parent.parent in (folder(), prebuilt.find().folder)


def _save(self, key, data):
    """Save a kernel in a file named after its contents, before the index refers to it.

    Numba numbers its files and writes the index first. A disk that fills up between the two writes, or another process
    that meanwhile compiles the same function for other types, would leave an index that names a different kernel.
    """
    body = self._dump(data)
    checksum = hashlib.sha256(body).digest()
    name = self._data_name(int.from_bytes(checksum[:6]))
    with self._open_for_write(self._data_path(name)) as file:
        file.write(body + _MARK + checksum)
    from filelock import FileLock  # only processes that compile need it

    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # without a lock, another process may lose its entry and compile again
            stack.enter_context(FileLock(f"{self._index_path}.lock", timeout=10))
        overloads = self._load_index()
        before, overloads[key] = overloads.get(key), name
        self._save_index(overloads)
    if before and before not in overloads.values():
        with contextlib.suppress(OSError):
            os.unlink(self._data_path(before))


def _save_overload(self, sig, data, save=Cache.save_overload):
    """Save a kernel if the disk allows it; a run does not fail if its kernels cannot be saved."""
    with contextlib.suppress(OSError):
        save(self, sig, data)


class _CompileListener(event.Listener):
    """Announces the compilation of a kernel of this package; functions that it calls are compiled as part of it."""

    depth, ours = 0, False

    def on_start(self, event) -> None:
        self.depth += 1
        function = event.data["dispatcher"].py_func
        module = function.__module__ or ""  # a function from a string has none
        if self.depth == 1 and module.startswith("stickslip."):
            self.ours = True
            compilation.start(f"{module.removeprefix('stickslip.')}.{function.__name__}")

    def on_end(self, event) -> None:
        self.depth -= 1
        if self.depth == 0 and self.ours:
            self.ours = False
            compilation.end()


def install() -> None:
    """Let Numba find this package's kernels in its cache, announce those that it compiles, and repair damaged files."""
    if _Locator not in CacheImpl._locator_classes:
        CacheImpl._locator_classes.insert(0, _Locator)
        event.register("numba:compile", _CompileListener())
    for kind, name, method in (
        (Cache, "save_overload", _save_overload),
        (IndexDataCacheFile, "save", _save), (IndexDataCacheFile, "load", _load),
        (IndexDataCacheFile, "_load_index", _load_index), (IndexDataCacheFile, "_load_data", _load_data),
    ):  # fmt: skip
        setattr(kind, name, method)
