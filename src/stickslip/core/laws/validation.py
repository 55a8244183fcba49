"""Validation of new user-defined laws: they are evaluated in Python on a grid of overlaps and radii."""

import traceback
import warnings

import numpy as np

from .builtin import STEP, Law
from .kinds import HELP, ROLES, USER_LAWS, UserLaw, bound, update_memory

MAX_RANGE = 100.0  # largest range of a law, in radii
NOT_NEGATIVE = ("tangential_stiffness", "contact_range", "rolling_stiffness")
OVERLAP_RATIOS = (1e-6, 1e-4, 1e-3, 0.0031, 0.01, 0.031, 0.1)  # test overlaps, divided by the size
SLOPE_TOLERANCE = (
    1e-3  # fraction of the largest slope: accuracy of differences over a step of 1e-6 for smooth functions
)
JUMP_THRESHOLD = 1e-6  # fraction of the largest force above which jumps are reported


class LawWarning(UserWarning):
    """Warning about an unusual user-defined law that can still be used."""


def validate_law(law: Law, size: float) -> Law:
    """Return the law if it is usable; otherwise raise ValueError.

    `size` is a grain radius [length].
    """
    if isinstance(size, bool) or not (isinstance(size, int | float) and np.isfinite(size) and size > 0):
        raise ValueError(f"size must be a radius, a positive number, got {size!r}")
    user_law, values = USER_LAWS[law.kind], dict(zip(USER_LAWS[law.kind].names, law.table[0, 0].tolist(), strict=True))
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ranges = _ranges(user_law, values, size)
        if ranges[0] > ranges[1]:
            raise ValueError(
                f"contact_range decreases with r_eff, from {ranges[0]:g} to {ranges[1]:g}: neighbour lists "
                f"require that it does not decrease"
            )
        if not ranges[1] <= MAX_RANGE * size:
            raise ValueError(
                f"contact_range is {ranges[1]:g} for a grain of radius {size:g}: at most {MAX_RANGE:g} radii are "
                f"allowed, because the neighbour list holds all pairs within it"
            )
        points = sample_points(user_law, values, size)
        for memory in _memories(user_law, values, size):
            for role in user_law.functions.keys() - {"update"}:
                _check_function(user_law, role, values | memory, points)
        jump = "" if user_law.bonds else _describe_jump(user_law, values, points, ranges)
    if jump:
        warnings.warn(jump, LawWarning, stacklevel=4)
    return law


def _ranges(own: UserLaw, values: dict, size: float) -> list[float]:
    """Contact ranges for two values of R_eff."""
    return [float(_evaluate(own, "contact_range", values, r_eff=r)) for r in (0.5 * size, size)]


def sample_points(own: UserLaw, values: dict, size: float) -> list[tuple[float, float]]:
    """R_eff and overlap of the points at which functions are compared with each other, gaps included."""
    ranges = _ranges(own, values, size)
    return [(r, x) for r, end in zip((0.5 * size, size), ranges, strict=True) for x in _test_overlaps(r, end)]


def _test_overlaps(size: float, end: float) -> list[float]:
    """Overlaps for the tests, starting just inside the range."""
    gap = [-end * share for share in (0.999, 0.8, 0.55, 0.3, 0.1, 0.001)] if end > 0 else []
    return gap + [size * share for share in OVERLAP_RATIOS]


def _memories(own: UserLaw, values: dict, size: float) -> list[dict]:
    """Additional memories of contacts, with which other functions are tested. An invalid update raises ValueError."""
    memories: list[dict] = []
    for overlap in size * np.array((0.0, 0.0137, 0.0973)):
        at = {"overlap": float(overlap), "r_eff": size}
        try:
            new = update_memory(own, values, **at)
            again = update_memory(own, values | new, **at)
            stepped = update_memory(own, values, **at | {"overlap": complex(overlap, STEP)})
        except Exception as problem:
            raise ValueError(
                f"update cannot be evaluated, {_error_location(problem)}: it must return {len(own.memory)} real "
                f"number(s), also for a complex overlap; {HELP}"
            ) from None
        for name, value in new.items():
            if not isinstance(value, int | float | np.floating | np.integer) or not np.isfinite(value):
                raise ValueError(
                    f"update at overlap = {overlap:.4g} gives {name} = {value}: it must be a finite number"
                )
            if again[name] != value or np.real(stepped[name]) != value:
                raise ValueError(
                    f"update at overlap = {overlap:.4g} gives {name} = {value:.6g}, then {again[name]:.6g} at the same "
                    f"overlap: a second update must not change it"
                )
        memories.append(new)
    return memories if own.memory else [{}]


def _evaluate(own: UserLaw, role: str, values: dict, **given):
    """Evaluate a function of the law; a missing contact range counts as zero."""
    if role not in own.functions:
        return 0.0
    known = values | given
    try:
        return own.functions[role](*bound(own, role, known))
    except ZeroDivisionError:
        return np.nan
    except Exception as problem:
        reason = _error_location(problem)
        if any(isinstance(v, complex) for v in given.values()):
            raise ValueError(
                f"{role} does not accept complex numbers, which its derivative needs, {reason}: compare real parts, as "
                f"in overlap.real < 0.0, and use max, min, abs, math or numpy; {HELP}"
            ) from None
        raise ValueError(f"{role} cannot be evaluated, {reason}: correct it") from None


def _error_location(problem: Exception) -> str:
    """Location of an error in words, with the line if its text is known."""
    last = traceback.extract_tb(problem.__traceback__)[-1]
    line = f"line {last.lineno}: {last.line!r} " if last.line else f"line {last.lineno} "
    return f"{line}({type(problem).__name__}: {problem})"


def _check_function(own: UserLaw, role: str, values: dict, points) -> None:
    """Raise ValueError if a function is not finite, deterministic and differentiable."""
    slopes = {name: [] for name in ("overlap", "normal_force") if name in own.arguments[role]}
    for r_eff, overlap in points:
        fn = 0.0
        if "normal_force" in ROLES[role]:
            fn = abs(_evaluate(own, "normal_force", values, overlap=overlap, r_eff=r_eff)) or 1.0
        at = {"overlap": overlap, "r_eff": r_eff, "normal_force": fn}
        value, again = (_evaluate(own, role, values, **at) for _ in range(2))
        location = f"{role} at overlap = {overlap:.4g}, r_eff = {r_eff:.4g}"
        if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
            kind = "None" if value is None else f"a {type(value).__name__}"
            raise ValueError(f"{location} returns {kind}: it must return one real number")
        if not np.isfinite(value):
            raise ValueError(f"{location} is {value}: it must be finite; check roots and logarithms of gaps")
        if value != again:
            raise ValueError(
                f"{location} is {value:.6g} on one call and {again:.6g} on the next: a law must be deterministic"
            )
        if value < 0 and role in NOT_NEGATIVE:
            raise ValueError(f"{location} is {value:.4g}: it must not be negative")
        for name in slopes:
            slopes[name].append((at, *_derivatives(own, role, values, at, name, location)))
    for name, samples in slopes.items():
        scale = max(abs(slope) for _, _, *sides in samples for slope in sides)
        for at, exact, left, right in samples:
            if min(abs(exact - left), abs(exact - right), abs(2 * exact - left - right) / 2) > SLOPE_TOLERANCE * scale:
                raise ValueError(
                    f"{role} at overlap = {at['overlap']:.4g} has the slope {exact:.4g} by a complex step and "
                    f"{0.5 * (left + right):.4g} by differences in {name}: compare real parts only, and use max, min, "
                    f"abs, math or numpy; {HELP}"
                )
    if role == "normal_energy":
        _check_energy(own, values, points)


def _derivatives(own, role, values, at, name, place):
    """Derivative d/d(name) by a complex step, and by backward and forward differences."""
    x = at[name]
    step = 1e-6 * abs(x)
    stepped = _evaluate(own, role, values, **at | {name: complex(x, STEP)})
    middle = _evaluate(own, role, values, **at)
    if not np.isclose(np.real(stepped), middle, rtol=1e-12, atol=1e-100):
        raise ValueError(
            f"{place} is {middle:.6g}, but {np.real(stepped):.6g} for a complex number with that real part: "
            f"compare real parts only; {HELP}"
        )
    left, right = (_evaluate(own, role, values, **at | {name: x + d}) for d in (-step, step))
    return np.imag(stepped) / STEP, (middle - left) / step, (right - middle) / step


def _check_energy(own: UserLaw, values: dict, points) -> None:
    """Raise ValueError if the slope of the energy is not the force."""
    for r_eff, overlap in points:
        at = {"overlap": complex(overlap, STEP), "r_eff": r_eff}
        force = _evaluate(own, "normal_force", values, overlap=overlap, r_eff=r_eff)
        slope = np.imag(_evaluate(own, "normal_energy", values, **at)) / STEP
        if not np.isclose(slope, force, rtol=1e-6, atol=1e-12 * abs(force)):
            raise ValueError(
                f"normal_energy at overlap = {overlap:.4g} has the slope {slope:.6g}, but normal_force is {force:.6g}: "
                f"make the force the slope of the energy, or omit normal_energy"
            )


def _describe_jump(own: UserLaw, values: dict, points, ranges) -> str:
    """Describe a force that is not zero at the end of the range; the description is empty if there is none."""
    largest = max(abs(_evaluate(own, "normal_force", values, overlap=x, r_eff=r)) for r, x in points)
    end = max(ranges)
    r_eff = max(r for r, _ in points)
    edge = -end * (1 - 1e-9) if end else 1e-12 * r_eff
    force = _evaluate(own, "normal_force", values, overlap=edge, r_eff=r_eff)
    if not abs(force) > JUMP_THRESHOLD * largest:
        return ""
    location = f"at the end of its range (a gap of {end:.4g})" if end else "at first touch"
    return (
        f"the normal force of {own.name} jumps from 0 to {force:.4g} {location}: the force is discontinuous "
        f"when contacts close and open there, and energy is conserved only as far as the time step resolves the jump"
    )


def locate_error(problem: BaseException, path) -> str:
    """Describe the line of a file in which an error occurred."""
    here = [frame for frame in traceback.extract_tb(problem.__traceback__) if frame.filename == str(path)]
    location = f"line {here[-1].lineno}: {here[-1].line!r} " if here else ""
    return f"{location}({type(problem).__name__}: {problem})"
