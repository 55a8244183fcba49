"""Functions of the compiled core, called with NumPy arrays and tuples: `core.find_pairs(grid, x, …)`.

The header `core.h` declares all functions, structs and constants and is read here. Arrays are checked against the
declared types. A struct is filled from the entries of a tuple that have the names of its members; a member `len_x` is
the length of x, and `width_x` the number of its columns.
"""

import ctypes
import re
from collections.abc import Callable
from operator import attrgetter, itemgetter
from pathlib import Path
from struct import Struct
from typing import Any

import numpy as np

from .._core import build

_SCALARS: dict[str, Any] = {
    "double": ctypes.c_double, "int64_t": ctypes.c_int64, "int32_t": ctypes.c_int32, "uint8_t": ctypes.c_bool,
    "void": None,
}  # fmt: skip
_CODES = {"double": "d", "int64_t": "q", "int32_t": "i", "uint8_t": "?"}
_ARRAYS = {
    "double": np.float64, "float": np.float32, "int64_t": np.int64, "int32_t": np.int32, "int16_t": np.int16,
    "int8_t": np.int8, "uint32_t": np.uint32, "uint8_t": np.bool_,
}  # fmt: skip
_DTYPES = {name: np.dtype(dtype) for name, dtype in _ARRAYS.items()}
_SIZES: dict[str, Callable] = {
    "len": lambda value, alive: 0 if value is None else len(value),
    "width": lambda value, alive: 0 if value is None else value.shape[1],
}
_CONSTANTS, _CONSTANT = re.compile(r"constexpr int\w+ ([^;]*);"), re.compile(r"(\w+) = (-?\d+)")
_STRUCT, _FUNCTION = re.compile(r"struct (\w+) \{(.*?)\}", re.DOTALL), re.compile(r"API ([^()]*?)(\w+)\(([^)]*)\)")
_COMMENT, _DECLARATION = re.compile(r"//.*"), re.compile(r"(?:const )?(?:struct )?(\w+)\s*(\*?)\s*(\w+)")


def _declarations(text: str, separator: str) -> list[tuple[str, bool, str]]:
    """Type of every declaration, whether it is a pointer, and its name."""
    parts = (" ".join(part.split()) for part in text.split(separator))
    matches = (_DECLARATION.fullmatch(part) for part in parts if part and part != "void")
    return [(match[1], bool(match[2]), match[3]) for match in matches]


def _interface(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def _first_member(array: np.ndarray, size=object.__basicsize__, read=ctypes.c_int64.from_address) -> int:
    """Address of the data, read from the first member of NumPy's C struct (eight times faster than its interface)."""
    return read(id(array) + size).value


_SAMPLE = np.zeros(1)
_data = _first_member if _first_member(_SAMPLE) == _interface(_SAMPLE) else _interface


class _Layout:
    """Members of a struct, the names of their sources, and their converters."""

    def __init__(self, name: str, members, sources):
        fields = [(key, ctypes.c_void_p if pointer else _SCALARS[kind]) for kind, pointer, key in members]
        self.type = type(name, (ctypes.Structure,), {"_fields_": fields})
        self.members = members
        self.pack_into = Struct("".join("P" if pointer else _CODES[kind] for kind, pointer, _ in members)).pack_into
        names, self.converters = zip(*sources, strict=True)
        self.read_tuple, self.read_dict = attrgetter(*names), itemgetter(*names)


class _Function:
    """Function of the library that converts its arguments."""

    def __init__(self, core: "_Core", pointer, result: str, parameters):
        self._call = pointer
        self._converters = [core.converter(kind, name) if is_pointer else None for kind, is_pointer, name in parameters]
        pointer.argtypes = [ctypes.c_void_p if is_pointer else _SCALARS[kind] for kind, is_pointer, _ in parameters]
        pointer.restype = ctypes.c_void_p if "*" in result else _SCALARS[result.strip()]

    def __call__(self, *values):
        alive: list = []  # targets of pointers, kept until the function returns
        pairs = zip(self._converters, values, strict=True)
        return self._call(*[value if convert is None else convert(value, alive) for convert, value in pairs])


class _Core:
    """Compiled core for this processor; loaded when a function is first used."""

    def __init__(self):
        text = _COMMENT.sub("", (Path(build.__file__).parent / "core.h").read_text(encoding="utf-8"))
        for line in _CONSTANTS.findall(text):
            vars(self).update((name, int(value)) for name, value in _CONSTANT.findall(line))
        self.structs = {name: self._layout(name, _declarations(body, ";")) for name, body in _STRUCT.findall(text)}
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

    def _layout(self, name: str, members) -> _Layout:
        return _Layout(name, members, [self._source(*member) for member in members])

    def _source(self, kind: str, pointer: bool, name: str):
        """Name of the entry that fills a struct member, and its converter."""
        before, _, rest = name.partition("_")
        if rest and not pointer and before in _SIZES:
            return rest, _SIZES[before]
        return name, self.converter(kind, name) if pointer else None

    def converter(self, kind: str, name: str) -> Callable:
        """Function that returns the address of an array or struct; None gives the null pointer, and a number itself."""

        def struct_address(value, alive: list):
            if value is None or isinstance(value, int):
                return value or 0
            struct = value if isinstance(value, ctypes.Structure) else self.fill(kind, value)
            alive.append(struct)
            return ctypes.addressof(struct)

        def array_address(value, alive: list):
            if not isinstance(value, np.ndarray):
                return int(value or 0)
            if value.dtype is not dtype and value.dtype != dtype:
                raise TypeError(f"{name} has type {value.dtype}: the compiled core needs {dtype}")
            if not value.flags.c_contiguous:
                raise TypeError(f"{name} is not contiguous: pass it through numpy.ascontiguousarray")
            return _data(value)

        dtype = _DTYPES.get(kind)
        return struct_address if dtype is None else array_address

    def fill(self, kind: str, value):
        """Struct filled from a tuple or dictionary, for repeated calls; it keeps the targets of its pointers alive."""
        layout = self.structs[kind]
        given = layout.read_dict(value) if isinstance(value, dict) else layout.read_tuple(value)
        out = layout.type()
        out.alive = alive = list(given)
        pairs = zip(layout.converters, given, strict=True)
        layout.pack_into(out, 0, *[entry if convert is None else convert(entry, alive) for convert, entry in pairs])
        return out


core = _Core()
