"""Checks of the arguments that users pass to public functions, made once per call.

`checked` compares arguments with annotations such as `State`, `Law`, `int` or `float | None`. It does so only when a
user calls the package, not when public functions call each other. Other annotations are ignored.
"""

import inspect
import threading
import types
from collections.abc import Callable
from functools import cache, wraps
from numbers import Integral, Real
from typing import ParamSpec, TypeVar, get_args, get_origin

import numpy as np

from .text import bounded

P, R = ParamSpec("P"), TypeVar("R")
_door = threading.local()


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Check arguments by their annotations when a user calls the function.

    Raises
    ------
    TypeError
        if an argument has another type, with a one-sentence message; arguments are not converted.
    ValueError
        if a number is NaN or not whole where it must be, or if the arrays of a state do not fit together.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if getattr(_door, "passed", False):
            return function(*args, **kwargs)
        given = []
        for place, name, classes in _checkable(function):
            if place < len(args) or name in kwargs:
                given.append(args[place] if place < len(args) else kwargs[name])
                _check(name, given[-1], classes)
        for value in given:
            if hasattr(value, "check_belongs"):
                value.check_belongs(given)
        _door.passed = True
        try:
            return function(*args, **kwargs)
        except ValueError as problem:
            if type(problem) is ValueError and len(problem.args) == 1:
                problem.args = (bounded(str(problem)),)
            raise
        finally:
            _door.passed = False

    return call


@cache
def _checkable(function) -> list[tuple[int, str, tuple[type, ...]]]:
    """Index, name and allowed classes of the parameters whose annotations can be checked."""
    found = []
    for place, one in enumerate(inspect.signature(function).parameters.values()):
        several = isinstance(one.annotation, types.UnionType) or get_origin(one.annotation) is list
        classes = get_args(one.annotation) if several else (one.annotation,)
        if one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD) and all(map(_is_checkable, classes)):
            classes = (list, *classes) if get_origin(one.annotation) is list else classes
            found.append((place if one.kind is not one.KEYWORD_ONLY else 10**6, one.name, classes))
    return found


def _is_checkable(kind) -> bool:
    noun = isinstance(kind, type) and kind.__module__.startswith("stickslip.")
    return kind in (int, float, type(None)) or noun


def _check(name: str, value, classes: tuple[type, ...]) -> None:
    if classes[0] is list:
        if not isinstance(value, list | tuple) or not all(isinstance(one, classes[1]) for one in value):
            kind = "something else" if type(value) in (list, tuple) else f"a value of type {type(value).__name__}"
            raise TypeError(f"{name} must be a list of {classes[1].__name__}, but {kind} was given")
        return
    if isinstance(value, classes):
        if hasattr(value, "check_lengths"):
            value.check_lengths()
        elif isinstance(value, float) and value != value:
            raise ValueError(f"{name} is NaN: give a number")
        return
    if isinstance(value, np.ndarray) and not value.shape:
        value = value[()]
    if float in classes and isinstance(value, Real):
        if value != value:
            raise ValueError(f"{name} is NaN: give a number")
    elif int in classes and isinstance(value, Real):
        if not isinstance(value, Integral) and value != int(value if np.isfinite(value) else 0):
            raise ValueError(f"{name} = {value} was given, but it must be a whole number")
    else:
        raise TypeError(_mismatch(name, value, classes))


def _mismatch(name: str, value, classes: tuple[type, ...]) -> str:
    words = {int: "a whole number", float: "a number", type(None): "None"}
    allowed = " or ".join(words.get(kind, f"a {kind.__name__}") for kind in classes)
    nouns = tuple(kind for kind in classes if kind not in words)
    remedy = ""
    if type(value) is tuple and any(isinstance(part, nouns) for part in value):
        k = next(k for k, part in enumerate(value) if isinstance(part, nouns))
        remedy = f": give value {k} of this tuple"
    elif type(value).__module__.startswith("stickslip."):
        held = [field for field in getattr(value, "_fields", ()) if isinstance(getattr(value, field), nouns)]
        remedy = f": give its .{held[0]}" if nouns and held else ": check the order of the arguments"
    kind = "None" if value is None else f"a value of type {type(value).__name__}"
    return f"{name} must be {allowed}, but {kind} was given{remedy}"


def require_positive(**values) -> None:
    """Raise ValueError with a one-sentence message if a value is not positive and finite."""
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value} was given: it must be positive")


def require_not_negative(**values) -> None:
    """Raise ValueError with a one-sentence message if a value is negative or not finite; None is ignored."""
    for name, value in values.items():
        if value is not None and not (np.isfinite(value) and value >= 0):
            raise ValueError(f"{name} = {value} was given: it must be zero or positive")
