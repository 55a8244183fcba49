"""Argument checks of public functions, made once per user call.

`checked` compares arguments with annotations when a user calls the package, but not when public functions call each
other. If a value, such as a law or a part of a state, has a method `check_entries`, this method is called, because
compiled code does not check array bounds.

Supported annotations: `int`, `float`, `complex`, `bool`, `str`, `None`, classes of this package and of the
standard library, `Callable`, `np.ndarray`, unions, `list[…]`, `tuple[…]`, `dict[…]`, `Literal[…]`, and `Annotated[…]`
with an `Array`, a `Result`, or a `Requirement` such as `POSITIVE`, `NOT_NEGATIVE`, `FILLED` or `one_of(…)`. All others
are ignored. Relations between arguments are checked in the function itself.
"""

import inspect
import threading
import types
from collections.abc import Callable, Iterable, Mapping
from functools import cache, wraps
from numbers import Complex, Integral, Real
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, ParamSpec, TypeVar, Union, get_args, get_origin

import numpy as np

from .fields import LARGEST, shapes_of
from .text import bounded, quoted

P, R = ParamSpec("P"), TypeVar("R")
_door = threading.local()
_LARGEST_INTEGER = 2**64 - 1
_LONGEST_NAME = 255  # longest file name [bytes]
_KNOW_BONDS: set[Callable] = set()


class Array(NamedTuple):
    """Annotation for numbers that are converted with `np.asarray`."""

    ndim: tuple[int, ...] | None = None  # allowed numbers of dimensions; None: any
    kinds: str = "buif"  # allowed kinds of NumPy types
    empty: bool = True  # whether the array may be empty
    finite: bool = True  # whether all numbers must be finite
    shapes: tuple[tuple[int, ...], ...] = ()  # allowed shapes; empty: any


class Requirement(NamedTuple):
    """Annotation for a value with an additional check: a function of name and value that raises ValueError."""

    check: Callable[[str, Any], None]


class Result(NamedTuple):
    """Annotation for instances of a class that a module cannot import, recognised by their attributes or keys."""

    name: str
    attributes: tuple[str, ...] = ()
    keys: tuple[str, ...] = ()


def require_filled(name: str, value) -> None:
    """Raise ValueError if a list or dictionary is empty."""
    if not len(value):
        raise ValueError(f"{name} is empty: give at least one entry")


def require_positive(**values) -> None:
    """Raise ValueError unless a value is positive and within the range that a state allows."""
    for name, value in values.items():
        if not 1 / LARGEST <= value <= LARGEST:
            range_ = f", from {1 / LARGEST:g} to {LARGEST:g}: use other units" if 0 < value < np.inf else ""
            raise ValueError(f"{name} must be positive{range_}, got {value}")


def require_not_negative(**values) -> None:
    """Raise ValueError if a value is negative or not finite; None is ignored."""
    for name, value in values.items():
        if value is not None and not 0 <= value <= LARGEST:
            range_ = f", at most {LARGEST:g}" if value > 0 else ""
            raise ValueError(f"{name} must be zero or positive{range_}, got {value}")


def require_unmasked(name: str, value) -> None:
    """Raise ValueError if an array has masked entries, which would count as numbers."""
    if np.ma.is_masked(value):
        raise ValueError(f"{name} has masked entries: leave them out")


def one_of(*allowed) -> Requirement:
    """Requirement that a value is one of those given, such as the keys of a table; for a fixed list, use `Literal`."""

    def check(name, value):
        if not any(isinstance(value, type(one)) and value == one for one in allowed):
            *others, last = map(repr, allowed)
            shown = f"{', '.join(others)} or {last}" if others else last
            raise ValueError(f"{name} must be {shown}, got {quoted(value)}")

    return Requirement(check)


def _require_seed(name: str, value: int) -> None:
    if value < 0:
        raise ValueError(f"{name} must be zero or positive, got {value}")


FILLED = Requirement(require_filled)
POSITIVE = Requirement(lambda name, value: require_positive(**{name: value}))
NOT_NEGATIVE = Requirement(lambda name, value: require_not_negative(**{name: value}))
Positive = Annotated[float, POSITIVE]
NotNegative = Annotated[float, NOT_NEGATIVE]
Seed = Annotated[int, Requirement(_require_seed)]
Numbers = Annotated[Any, Array()]
Several = Annotated[Any, Array((0, 1))]  # a number, or a one-dimensional array
Values = Annotated[Any, Array((0, 1), empty=False)]  # a number, or a one-dimensional array that is not empty
Series = Annotated[Any, Array((1,), empty=False)]  # a one-dimensional array that is not empty
Bodies = Annotated[Any, Array((0, 1), kinds="bui")]  # numbers of bodies, or a mask


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Check arguments against their annotations when a user calls the function; whole numbers become `int`.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a number is NaN, or not whole where an integer is required, or if an entry of a state is not allowed.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if getattr(_door, "passed", False):
            return function(*args, **kwargs)
        try:
            given: list[Any] = list(args)
            for index, name, check in _parameters(function):
                if index < len(given):
                    given[index] = check(name, given[index])
                elif name in kwargs:
                    kwargs[name] = check(name, kwargs[name])
            everything = [*given, *kwargs.values()]
            _refuse_bonds(function, everything)
            for value in everything:
                if hasattr(value, "check_belongs"):
                    value.check_belongs(everything)
            _door.passed = True
            return function(*given, **kwargs)  # type: ignore[arg-type]
        except TypeError as problem:
            if problem.__traceback__ is not None and problem.__traceback__.tb_next is None:  # it was not entered
                names = ", ".join(inspect.signature(function).parameters)
                raise TypeError(f"{problem}: the arguments are {names}") from None
            raise
        except ValueError as problem:
            if type(problem) is ValueError and len(problem.args) == 1:
                problem.args = (bounded(str(problem)),)
            raise
        finally:
            _door.passed = False

    return call


def knows_bonds(function: Callable[P, R]) -> Callable[P, R]:
    """Mark a function as correct for states with bonds; `checked`, applied afterwards, rejects them in all others."""
    _KNOW_BONDS.add(function)
    return function


def _refuse_bonds(function, values) -> None:
    """Raise ValueError if a state has bonds that a function would ignore."""
    if function not in _KNOW_BONDS and any(getattr(value, "bonds", None) is not None for value in values):
        raise ValueError(f"{function.__name__}() does not support bonds yet: remove them with packings.without_bonds")


def check_value(name: str, value, annotation, *, given: bool = False) -> None:
    """Check a value that is not an argument, such as one from a file, against an annotation; by default, allow NaN."""
    check = _check_of(annotation, given)
    if check is not None:
        check(name, value)


def check_types(values: tuple) -> None:
    """Check all fields of a user-made NamedTuple against their annotations and the shapes stated in comments."""
    _check_fields("", values, given=True)


def check_computed(values: tuple) -> None:
    """Check all fields of a NamedTuple made by a function, as `check_types` does, but allow NaN."""
    _check_fields("", values, given=False)


def _check_fields(prefix: str, values, *, given: bool) -> None:
    """Check the fields of a NamedTuple; unless `given` by a user, numbers may be NaN, and arrays must not be lists."""
    sizes: dict[str, tuple[str, int]] = {}
    for (name, check, shape, scalar), value in zip(_fields(type(values), given), values, strict=True):
        if check is not None:
            check(prefix + name, value)
        if shape and value is not None and not (scalar and isinstance(value, Real)):
            _check_sizes(prefix + name, np.shape(value), shape, sizes)


@cache
def _fields(kind, given: bool) -> list[tuple[str, Callable[[str, Any], Any] | None, tuple[str, ...], bool]]:
    """Name, check and shape of each field of a NamedTuple, and whether it may be a single number."""
    shapes, hints = shapes_of(kind), getattr(kind, "__annotations__", {})
    known = {name: hints.get(name, Any) for name in kind._fields}
    return [(name, _check_of(k, given), shapes.get(name, ()), float in get_args(k)) for name, k in known.items()]


def _check_sizes(name: str, got: tuple[int, ...], shape: tuple[str, ...], sizes: dict[str, tuple[str, int]]) -> None:
    """Raise ValueError if a shape differs from the stated one; a letter stands for the same size in all fields."""
    wanted = [int(part) if part.isdigit() else sizes.get(part, (name, None))[1] for part in shape]
    if len(got) != len(shape) or any(size not in (None, n) for n, size in zip(got, wanted, strict=True)):
        others = sorted({f"{sizes[part][0]} has {part} = {sizes[part][1]}" for part in shape if part in sizes})
        belongs = f", as {' and '.join(others)}" if others else ""
        needed = f"({', '.join(shape)}{',' * (len(shape) == 1)})"
        raise ValueError(f"{name} must have shape {needed}, got {got}{belongs}")
    sizes |= {part: (name, n) for n, part in zip(got, shape, strict=True) if not part.isdigit() and part not in sizes}


_KEYWORD = 10**6  # index of keyword-only parameters
_MOST = 16  # largest number of values in *arguments that are checked


@cache
def _parameters(function) -> list[tuple[int, str, Callable[[str, Any], Any]]]:
    """Index, name and check of each parameter whose annotation can be checked."""
    places = []
    for index, parameter in enumerate(inspect.signature(function).parameters.values()):
        if parameter.kind is parameter.VAR_KEYWORD or parameter.annotation is parameter.empty:
            continue
        check = _check_of(parameter.annotation)
        if check is not None and parameter.kind is not parameter.VAR_POSITIONAL:
            places.append((index if parameter.kind is not parameter.KEYWORD_ONLY else _KEYWORD, parameter.name, check))
        elif check is not None:
            places += [(index + k, f"{parameter.name}[{k}]", check) for k in range(_MOST)]
    return places


def _check_of(annotation, given: bool = True) -> Callable[[str, Any], Any] | None:
    """Function (name, value) that returns the checked value, or None if an annotation cannot be checked.

    If not `given`, the values were computed: numbers may then be NaN, and arrays must not be lists.
    """
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _check_of_annotated(*parts)
    if origin is Literal:
        return _check_of_annotated(Union[*map(type, parts)], one_of(*parts))
    if origin in (types.UnionType, Union):
        return _check_of_union(parts, given)
    if origin in (list, dict) or (origin is tuple and parts):
        return _check_of_container(origin, parts, given)
    if origin is Iterable:
        return lambda name, value: _check_of_container(list, parts, given)(name, _as_list(name, value))
    if origin is Callable or annotation is Callable:
        return _check_callable
    if annotation is np.ndarray:
        return _check_numbers if given else _check_computed
    if annotation is None or isinstance(annotation, type):
        kind = type(None) if annotation is None else annotation
        return (lambda name, value: _check_class(name, value, (kind,), given)) if _is_checkable(kind) else None
    return None


def _check_numbers(name: str, value):
    return _check_array(name, value, Array(kinds="buifc"))


def _check_computed(name: str, value):
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "buifcV":
        kind = f"an array of {value.dtype}" if isinstance(value, np.ndarray) else _describe(value)
        raise TypeError(f"{name} must be an array of numbers, got {kind}")
    return value


def _is_checkable(kind) -> bool:
    return isinstance(kind, type) and kind not in (object, Any, np.ndarray)


def _check_of_annotated(kind, *known):
    tests = {Array: _check_array, Result: _check_result, Requirement: _check_requirement}
    base, known = _check_of(kind), [one for one in known if type(one) in tests]

    def check(name, value):
        value = _part(base, name, value)
        for one in known:
            value = tests[type(one)](name, value, one)
        return value

    return check if base or known else None


def _check_requirement(name: str, value, wanted: Requirement):
    wanted.check(name, value)
    return value


def _check_of_union(parts, given: bool):
    if all(map(_is_checkable, parts)):
        return lambda name, value: _check_class(name, value, parts, given)
    checks = [_check_of(part, given) for part in parts]
    if None in checks:
        return None
    kinds = " or ".join(map(_words, parts))

    def check(name, value):
        problems = []
        for convert in checks:
            try:
                return convert(name, value)
            except (TypeError, ValueError) as problem:
                problems.append(problem)
        for problem in problems:  # the type is right, but an entry is invalid
            if isinstance(problem, ValueError):
                raise problem
        raise TypeError(f"{name} must be {kinds}, got {_describe(value)}")

    return check


def _check_of_container(origin, parts, given: bool = True):
    checks = [_check_of(part, given) for part in parts if part is not Ellipsis]
    kinds = _words(origin[parts])

    def check(name, value):
        if not isinstance(value, (list, tuple) if origin is list else origin) or hasattr(value, "_fields"):
            raise TypeError(f"{name} must be {kinds}, got {_describe(value)}")
        if origin is dict:
            return {_part(checks[0], name, k): _part(checks[1], f"{name}[{k!r}]", v) for k, v in value.items()}
        fixed = origin is tuple and Ellipsis not in parts
        if fixed and len(value) != len(parts):
            raise ValueError(f"{name} must have {len(parts)} entries, got {len(value)}")
        pairs = zip(checks if fixed else checks[:1] * len(value), value, strict=True)
        made = [_part(convert, f"{name}[{k}]", part) for k, (convert, part) in enumerate(pairs)]
        return tuple(made) if isinstance(value, tuple) else made

    return check


def _as_list(name: str, value) -> list:
    scalar = isinstance(value, np.ndarray) and not value.ndim
    if scalar or not isinstance(value, Iterable) or isinstance(value, str | bytes) or hasattr(value, "_fields"):
        raise TypeError(f"{name} must be a list, got {_describe(value)}")
    return list(value)


def _part(check, name, value):
    return value if check is None else check(name, value)


_WORDS = {int: "a whole number", float: "a number", bool: "True or False", type(None): "None", str: "a word"}


def _words(annotation) -> str:
    """Describe the values that an annotation allows."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return f"a {parts[1].name}" if isinstance(parts[1], Result) else _words(parts[0])
    if origin is Literal:
        return " or ".join(map(repr, parts))
    if origin in (types.UnionType, Union):
        return " or ".join(map(_words, parts))
    if origin in (list, tuple, dict):
        inner = " and ".join(_words(part).removeprefix("a ") for part in parts if part is not Ellipsis)
        return f"a {origin.__name__} of {inner}"
    if annotation is Any:
        return "numbers"
    noun, maker = getattr(annotation, "__name__", str(annotation)), getattr(annotation, "MADE_BY", "")
    article = "an" if noun[0] in "AEIO" else "a"
    return _WORDS.get(annotation, f"{article} {noun}" + (f" as {maker} makes it" if maker else ""))


def _check_class(name: str, value, classes: tuple[Any, ...], given: bool = True):
    if isinstance(value, np.ndarray | np.generic) and not value.shape and value.dtype.kind in "biuf":
        value = value.item()  # a double, even if the value has less precision
    if isinstance(value, classes) and not isinstance(value, Complex):
        if hasattr(value, "_fields") and not isinstance(value, type):
            if hasattr(value, "check_entries"):
                value.check_entries()
            else:
                _check_fields(f"{name}.", value, given=False)
        return _check_path(name, value) if Path in classes else value
    if bool in classes and isinstance(value, bool | np.bool_ | Integral) and value in (0, 1):
        return bool(value)
    if float in classes and isinstance(value, Real):
        return _check_float(name, value) if given else value
    if int in classes and isinstance(value, Real):
        if not isinstance(value, Integral) and (not np.isfinite(value) or value != int(value)):
            raise ValueError(f"{name} must be a whole number, got {value}")
        if abs(value) > _LARGEST_INTEGER:
            shown = value if abs(value) < 1e40 else "a longer number"
            raise ValueError(f"{name} must be at most {_LARGEST_INTEGER}, got {shown}")
        return value if isinstance(value, bool) else int(value)
    if complex in classes and isinstance(value, Complex):
        if isinstance(value, Real):
            return _check_float(name, value)
        if given and not np.isfinite(value):
            raise ValueError(f"{name} must be finite, got {value}")
        return value
    raise TypeError(_mismatch(name, value, classes))


def _check_path(name: str, value):
    parts = Path(value).parts if isinstance(value, str | Path) else ()
    if "\0" in str(value) or any(len(part.encode(errors="replace")) > _LONGEST_NAME for part in parts):
        raise ValueError(f"{name} is not a valid path: names have at most {_LONGEST_NAME} bytes, none of which is zero")
    return value


def _check_float(name: str, value):
    if value != value:
        raise ValueError(f"{name} is NaN: give a number")
    if isinstance(value, Integral) and abs(value) > _LARGEST_INTEGER:
        raise ValueError(f"{name} is a whole number beyond {_LARGEST_INTEGER}: give a float")
    return value


def _check_callable(name: str, value):
    if not callable(value):
        raise TypeError(f"{name} must be a function, got {_describe(value)}")
    return value


def _check_array(name: str, value, wanted: Array):
    if isinstance(value, slice):
        return value
    if hasattr(value, "_fields") and not isinstance(value, type):
        remedy = f"give its .{name}" if name in value._fields else "give an array"
        raise TypeError(f"{name} must be numbers, got {_describe(value)}: {remedy}")
    require_unmasked(name, value)
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError(f"{name} has rows of different lengths: give an array") from None
    kind = array.dtype.kind
    if kind == "O":
        kind = "c" if any(isinstance(v, complex) for v in array.flat) else "f" if _are_numbers(array) else "O"
    if kind not in wanted.kinds and array.size:
        nouns = {"f": "fractions", "c": "complex numbers", "U": "words", "M": "dates", "m": "time differences"}
        got = nouns.get(kind, "things other than numbers")
        needed = "real numbers" if "f" in wanted.kinds else "whole numbers"
        raise ValueError(f"{name} must be {needed}, got {got}")
    if wanted.finite and array.dtype.kind in "fc" and not np.isfinite(array).all():
        raise ValueError(f"{name} contains NaN or infinity: give finite numbers")
    if wanted.ndim is not None and array.ndim not in wanted.ndim:
        allowed = " or ".join(map(str, wanted.ndim))
        raise ValueError(f"{name} must be {allowed}-dimensional, got {array.ndim} dimensions")
    if wanted.shapes and array.shape not in wanted.shapes:
        raise ValueError(f"{name} must have shape {' or '.join(map(str, wanted.shapes))}, got {array.shape}")
    if not (array.size or wanted.empty):
        raise ValueError(f"{name} is empty: give at least one number")
    if array.dtype.kind == "b" and "f" in wanted.kinds and "c" not in wanted.kinds:  # numbers, not masks: True is 1
        return array.astype(int)
    doubles = array.dtype.kind == "O" or (array.dtype.kind == "f" and "f" in wanted.kinds)
    return array.astype(float, copy=False) if doubles else array


def _are_numbers(array: np.ndarray) -> bool:
    return all(isinstance(v, Real) for v in array.flat)


def _check_result(name: str, value, wanted: Result):
    absent = [f".{key}" for key in wanted.attributes if not hasattr(value, key)]
    absent += [repr(key) for key in wanted.keys if not isinstance(value, Mapping) or key not in value]
    if absent:
        kind = _describe(value)
        raise TypeError(f"{name} must be a {wanted.name}, got {kind}, which has no {absent[0]}")
    return _check_class(name, value, (type(value),)) if hasattr(value, "_fields") else value


def _describe(value) -> str:
    return "None" if value is None else f"a value of type {type(value).__name__}"


def _mismatch(name: str, value, classes: tuple[Any, ...]) -> str:
    allowed = " or ".join(map(_words, classes))
    nouns = tuple(kind for kind in classes if kind not in _WORDS)
    remedy = ""
    if type(value) is tuple and any(isinstance(part, nouns) for part in value):
        k = next(k for k, part in enumerate(value) if isinstance(part, nouns))
        remedy = f": give value {k} of this tuple"
    elif type(value).__module__.startswith("stickslip."):
        held = [field for field in getattr(value, "_fields", ()) if isinstance(getattr(value, field), nouns)]
        remedy = f": give its .{held[0]}" if nouns and held else ": check the order of the arguments"
    return f"{name} must be {allowed}, got {_describe(value)}{remedy}"


def require_options(function: Callable, options: Iterable[str]) -> None:
    """Raise TypeError if a function lacks one of these options."""
    parameters = inspect.signature(function).parameters.values()
    names = [one.name for one in parameters if one.kind is one.KEYWORD_ONLY]
    for name in options:
        if name not in names:
            raise TypeError(f"{name} is not an option; the options are {', '.join(names)}")


def require_index(count: int, **values) -> None:
    """Raise ValueError if a value is not an index from 0 to `count` − 1."""
    for name, value in values.items():
        if not 0 <= value < count:
            raise ValueError(f"{name} must be from 0 to {count - 1}, got {value}")


def require_shape(shape: tuple[int, ...], **values) -> None:
    """Raise ValueError if a value does not have this shape."""
    for name, value in values.items():
        if np.shape(value) != shape:
            raise ValueError(f"{name} must have shape {shape}, got {np.shape(value)}")
