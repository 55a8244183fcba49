"""Least-squares problem of a fit: residuals, their Jacobian, and the search for the best minimum."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from .identifiability import WIDEST
from .initial_guess import extended_guesses, initial_guesses
from .model import DEFAULTS, LINEAR, LOGARITHMIC, Prepared, linear_column, model_friction
from .noise import WHITE, whitened

BLANK = {"a": 1.0, "b": 0.0, "dc": 1.0, "mu0": 0.0, "stiffness": 1.0, **DEFAULTS}  # before the coarse search
STEP = 1e-5  # step of logarithms for finite differences; the model is accurate to 1e-9
RUNAWAY_RESIDUAL = 1e3  # residual over the record's scatter if the slider runs away
SAME = 1e-4  # relative difference of sums of squares within one minimum
MAX_SHIFT = 7.0  # largest change of a logarithm from its initial guess: a factor of a thousand
WIDE = 0.3  # half width of the interval of a logarithm above which its ends are checked


class Task(NamedTuple):
    """A fit: records, law, and the mapping from the vector x to the parameters of each record."""

    cases: list[Prepared]
    law: str
    names: tuple[str, ...]  # one for each entry of x
    slots: list[dict]  # for each record: name → index in x
    fixed: dict
    scatter: float  # of friction in the records
    form: str = "logarithmic"

    @property
    def logs(self) -> np.ndarray:
        """Mask of the entries of x that are logarithms."""
        return np.array([label.split("[")[0] in LOGARITHMIC for label in self.names])


def parameters_of(task: Task, x, number: int) -> dict:
    """Parameters of one record, by name."""
    values = {name: float(x[k]) for name, k in task.slots[number].items()}
    return task.fixed | {k: float(np.exp(v)) if k in LOGARITHMIC else v for k, v in values.items()}


def residual(task: Task, x) -> np.ndarray:
    """Residual (data − model)/sigma of all fitted samples."""
    out = []
    for number, case in enumerate(task.cases):
        model = model_friction(case, parameters_of(task, x, number), task.law, task.form)
        rest = np.full(len(case.time), RUNAWAY_RESIDUAL * task.scatter) if model is None else case.friction - model
        out.append((rest / case.sigma)[case.used])
    return np.concatenate(out)


def jacobian(task: Task, x, *, central: bool = False) -> np.ndarray:
    """Jacobian d residual/dx: exact for trend and drift, else by finite differences.

    It is also exact for μ0 at constant normal stress, of which friction in the logarithmic form is a linear function.
    """
    base = None if central else residual(task, x)
    out = np.zeros((sum(int(c.used.sum()) for c in task.cases), len(x)))
    for k, label in enumerate(task.names):
        name, row = label.split("[")[0], 0
        simple = (name == "drift" or (name == "trend" and task.fixed.get("trend_length") == np.inf)) or (
            name == "mu0"
            and task.form == "logarithmic"
            and all(c.legs is None or np.ptp(c.legs[2]) == 0 for c in task.cases)
        )
        if not simple:
            step = STEP * (10 if central else 1) * np.eye(len(x))[k]
            ahead = residual(task, x + step)
            out[:, k] = (ahead - residual(task, x - step)) / (2 * step[k]) if central else (ahead - base) / step[k]
            continue
        for case, slot in zip(task.cases, task.slots, strict=True):
            column = linear_column(case, name)
            piece = slice(row, row + int(case.used.sum()))
            if slot[name] == k:
                out[piece, k] = -(column / case.sigma)[case.used]
            row = piece.stop
    return out


def pieces(task: Task) -> list[slice]:
    """Contiguous runs of samples over all records."""
    out, row = [], 0
    for case in task.cases:
        out += [slice(row + piece.start, row + piece.stop) for piece in case.pieces]
        row += int(case.used.sum())
    return out


def filtered_residual(task: Task, x, filters) -> np.ndarray:
    """Whitened residual."""
    return whitened(residual(task, x), filters, pieces(task))


def solve(task: Task, x, filters, most: int = 60, held: int | None = None, close: float = 1e-10):
    """Solve the least-squares problem from x, optionally with one entry held fixed."""
    runs = pieces(task)
    moves = np.array([k != held for k in range(len(x))])
    span = np.array([MAX_SHIFT if label.split("[")[0] in LOGARITHMIC else np.inf for label in task.names])[moves]

    def whole(y):
        return np.where(moves, np.insert(y, held, 0.0) if held is not None else y, x)

    return least_squares(
        lambda y: whitened(residual(task, whole(y)), filters, runs),
        x[moves],
        jac=lambda y: whitened(jacobian(task, whole(y)), filters, runs)[:, moves],
        bounds=(x[moves] - span, x[moves] + span),
        x_scale="jac",
        ftol=close,
        xtol=1e-9,
        gtol=1e-14,
        max_nfev=most,
    )


def find_best(task: Task) -> tuple[np.ndarray, int]:
    """Best minimum reached from the initial guesses."""
    free = {label.split("[")[0] for label in task.names}
    minima, count = [], 0
    guesses = initial_guesses(task.cases, task.law, free, {**BLANK, **task.fixed})
    for start in (more for guess in guesses for more in extended_guesses(guess, task.cases, free)):
        begin = _start_vector(task, start, free)
        if _runs_away(task, begin):
            continue
        solved = solve(task, begin, WHITE, most=25, close=1e-6)
        count += solved.nfev
        again = any(abs(solved.cost - cost) < SAME * cost for cost, _ in minima)
        minima.append((solved.cost, solved.x))
        if again and solved.cost <= min(cost for cost, _ in minima) * (1 + SAME):
            break  # two guesses led to the best minimum
    if not minima:
        raise RuntimeError("the slider runs away for all parameters tried: give the damping, or the stiffness")
    x = min(minima, key=lambda minimum: minimum[0])[1]
    solved = solve(task, with_states_in_order(task, x), WHITE)
    return solved.x, count + solved.nfev


def _runs_away(task: Task, x) -> bool:
    parameters = (parameters_of(task, x, k) for k in range(len(task.cases)))
    return any(
        model_friction(case, values, task.law, task.form) is None
        for case, values in zip(task.cases, parameters, strict=True)
    )


def _start_vector(task: Task, start: dict, free) -> np.ndarray:
    x = np.zeros(len(task.names))
    for slot, linear in zip(task.slots, start["linear"], strict=True):
        extra = dict(zip([n for n in LINEAR if n in free], linear, strict=True))
        for name, k in slot.items():
            x[k] = np.log(start.get(name) or 0.01) if name in LOGARITHMIC else extra[name]
    return x


def with_states_in_order(task: Task, x) -> np.ndarray:
    """Return x with D_c < D_c2, if both states are free and can be exchanged."""
    pairs = (("b", "b2"), ("dc", "dc2"))
    if not {name for pair in pairs for name in pair} <= set(task.names):
        return x
    (b, b2), (dc, dc2) = ((task.names.index(first), task.names.index(second)) for first, second in pairs)
    x = x.copy()
    if x[dc] > x[dc2]:
        x[[b, b2, dc, dc2]] = x[[b2, b, dc2, dc]]
    return x


def find_open_sides(task: Task, x, filters, worst: float, half) -> dict:
    """Find unbounded sides of wide intervals, where distant values fit equally well after refitting other parameters.

    Intervals follow from derivatives at the best point. As k → ∞, for example, the derivatives vanish while the sum of
    squares stays finite.
    """
    out, runs = {}, pieces(task)
    cost = float(np.sum(whitened(residual(task, x), filters, runs) ** 2))
    for k in np.flatnonzero((half > WIDE) & (half < WIDEST)):
        for side, word in ((1.0, "above"), (-1.0, "below")):
            there = x.copy()
            there[k] += side * max(3 * half[k], WIDEST)
            solved = solve(task, there, filters, most=15, held=int(k), close=1e-4)
            if 2 * solved.cost - cost < worst**2:
                out[task.names[k]] = (float(np.exp(x[k] - side * half[k])), word)
    return out
