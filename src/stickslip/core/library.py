"""Functions of the compiled core, called with NumPy arrays and tuples: `core.find_pairs(grid, x, …)`.

The header `core.h` declares all functions, structs and constants and is read here. Arrays are checked against the
declared types. A struct is filled from a tuple by the names of its members, of which `len_x` is the length of x and
`width_x` the number of its columns.
"""

import ctypes
import re
from pathlib import Path
from typing import Any

import numpy as np

from .._core import build

_SCALARS: dict[str, Any] = {
    "double": ctypes.c_double, "int64_t": ctypes.c_int64, "int32_t": ctypes.c_int32, "uint8_t": ctypes.c_bool,
    "void": None,
}  # fmt: skip
_ARRAYS = {
    "double": np.float64, "float": np.float32, "int64_t": np.int64, "int32_t": np.int32, "int16_t": np.int16,
    "int8_t": np.int8, "uint32_t": np.uint32, "uint8_t": np.bool_,
}  # fmt: skip
_DTYPES = {name: np.dtype(dtype) for name, dtype in _ARRAYS.items()}
_CONSTANTS, _CONSTANT = re.compile(r"constexpr int\w+ ([^;]*);"), re.compile(r"(\w+) = (-?\d+)")
_STRUCT, _FUNCTION = re.compile(r"struct (\w+) \{(.*?)\}", re.DOTALL), re.compile(r"API ([^()]*?)(\w+)\(([^)]*)\)")
_COMMENT, _DECLARATION = re.compile(r"//.*"), re.compile(r"(?:const )?(?:struct )?(\w+)\s*(\*?)\s*(\w+)")


def _declarations(text: str, separator: str) -> list[tuple[str, bool, str]]:
    """Type, whether it is a pointer, and name of every declaration."""
    parts = (" ".join(part.split()) for part in text.split(separator))
    found = (_DECLARATION.fullmatch(part) for part in parts if part and part != "void")
    return [(match[1], bool(match[2]), match[3]) for match in found]


class _Struct:
    """Layout of a struct, and how its members are filled."""

    def __init__(self, name: str, members):
        fields = [(key, ctypes.c_void_p if pointer else _SCALARS[kind]) for kind, pointer, key in members]
        self.type = type(name, (ctypes.Structure,), {"_fields_": fields})
        self.members = members


class _Function:
    """Function of the library that converts its arguments."""

    def __init__(self, core: "_Core", pointer, result: str, parameters):
        self._core, self._call, self._parameters = core, pointer, parameters
        pointer.argtypes = [ctypes.c_void_p if is_pointer else _SCALARS[kind] for kind, is_pointer, _ in parameters]
        pointer.restype = ctypes.c_void_p if "*" in result else _SCALARS[result.strip()]

    def __call__(self, *values):
        alive: list = []  # what pointers refer to, until the function returns
        return self._call(*(
            self._core.address(kind, value, name, alive) if pointer else value
            for (kind, pointer, name), value in zip(self._parameters, values, strict=True)
        ))  # fmt: skip


class _Core:
    """Compiled core for this processor; loaded when a function is first used."""

    def __init__(self):
        text = _COMMENT.sub("", (Path(build.__file__).parent / "core.h").read_text(encoding="utf-8"))
        for line in _CONSTANTS.findall(text):
            vars(self).update((name, int(value)) for name, value in _CONSTANT.findall(line))
        self.structs = {name: _Struct(name, _declarations(body, ";")) for name, body in _STRUCT.findall(text)}
        self._functions = {name: (result, arguments) for result, name, arguments in _FUNCTION.findall(text)}
        self._library = None

    def __getattr__(self, name: str):
        if name.startswith("__") or name not in self._functions:
            raise AttributeError(name)
        if self._library is None:
            self._library = ctypes.CDLL(str(build.library(build.best_level())))
        result, arguments = self._functions[name]
        function = _Function(self, getattr(self._library, name), result, _declarations(arguments, ","))
        setattr(self, name, function)
        return function

    def address(self, kind: str, value, name: str, alive: list):
        """Address of an array or struct; None is the null pointer, and a number an address."""
        if value is None or type(value) is int:
            return value
        if isinstance(value, ctypes.Structure):
            alive.append(value)
            return ctypes.addressof(value)
        if kind not in self.structs:
            dtype = _DTYPES[kind]
            if value.dtype is not dtype and value.dtype != dtype:
                raise TypeError(f"{name} has type {value.dtype}: the compiled core needs {dtype}")
            if not value.flags.c_contiguous:
                raise TypeError(f"{name} is not contiguous: the compiled core needs numpy.ascontiguousarray")
            alive.append(value)
            return value.__array_interface__["data"][0]
        filled = self.fill(kind, value)
        alive.append(filled)
        return ctypes.addressof(filled)

    def fill(self, kind: str, value):
        """Struct filled from a tuple or dictionary, for calls that use it often; it keeps alive what it points to."""
        struct = self.structs[kind]
        entries = value if isinstance(value, dict) else {}
        out = struct.type()
        out.alive = alive = []
        for inner, pointer, name in struct.members:
            if name.startswith("width_"):
                entry = _entry(value, entries, name[6:])
                entry = 0 if entry is None else entry.shape[1]
            elif name.startswith("len_") and name not in entries:
                entry = _entry(value, entries, name[4:])
                entry = 0 if entry is None else len(entry)
            else:
                entry = _entry(value, entries, name)
                entry = self.address(inner, entry, name, alive) if pointer else entry
            setattr(out, name, entry)
        return out


def _entry(value, entries: dict, name: str):
    return entries[name] if entries else getattr(value, name)


core = _Core()
