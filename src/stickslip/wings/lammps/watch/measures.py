"""What is measured in each frame: one row of the table."""

from typing import NamedTuple

import numpy as np

from .... import SLIDE, Law, State, stability
from ....core.measure import least_supports
from ....kit import Report, silent
from ....measure import BALANCED_BELOW, coordination, stress
from ....reports.packing import to_dict, verdict
from ....results import Stability
from ....solve.balance import force_imbalance, linearised, modes_under, no_equilibrium_message
from ....solve.spectrum import softest_eigenvalue
from ....solve.stability import DENSE_UP_TO

METHODS = ("auto", "none", "fastest", "all", "dense", "pairs")
TENSOR = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")


class Row(NamedTuple):
    """Measures of a frame, in the units of the simulation; None where there is none."""

    step: int
    digest: str = ""  # of the frame; a frame with another one is computed again
    grains: int | None = None
    contacts: int | None = None  # that touch
    rattlers: int | None = None
    coordination: float | None = None  # contacts per grain, without rattlers
    sliding: int | None = None  # contacts at the Coulomb limit; unknown without memory
    pressure: float | None = None  # [force/length^(dim−1)]
    shear_stress: float | None = None  # half the difference of extreme principal stresses [force/length^(dim−1)]
    stress_xx: float | None = None
    stress_xy: float | None = None
    stress_xz: float | None = None
    stress_yx: float | None = None
    stress_yy: float | None = None
    stress_yz: float | None = None
    stress_zx: float | None = None
    stress_zy: float | None = None
    stress_zz: float | None = None
    residual: float | None = None  # largest unbalanced force over the mean normal contact force
    softest: float | None = None  # smallest real part of an eigenvalue λ, without zero modes [1/time²]
    zero_modes: int | None = None
    pairs: int | None = None  # that grow
    growth_rate: float | None = None  # of the fastest pair [1/time]
    omega: float | None = None  # its frequency [1/time]
    buckling: int | None = None  # motions that grow without oscillation
    stable: bool | None = None  # None without a verdict
    balanced: bool | None = None
    verdict: str = ""
    scope: str = ""  # what was checked, where it was not everything
    note: str = ""  # why something is missing

    @property
    def computed(self) -> bool:
        """True if the frame could be used."""
        return self.grains is not None


def measure_frame(
    step: int, digest: str, state: State, law: Law, *, memory: bool, method: str = "auto", notes=(),
    report: Report = silent,
) -> Row:  # fmt: skip
    """Measure a frame.

    Parameters
    ----------
    memory : whether the slip of its contacts is known
    method : one of `METHODS`; with "auto", the spectrum of more than 1500 coordinates is computed only in equilibrium
    notes : on the frame; what acts on its grains and was not taken over leaves the verdict undecided
    report : called as report(stage, share done, text)
    """
    here, mode = linearised(state, law), state.contacts.mode[: state.contacts.count[0]]
    row = Row(
        step, digest, len(state.grains.radius), len(here.rows),
        coordination=coordination(state, least_supports(law, state.cell.dim)),
        sliding=int((mode == SLIDE).sum()) if memory else None, residual=force_imbalance(here),
    )  # fmt: skip
    row = _add_stress(row, state, law)
    free = here.backbone
    if not len(free):
        return _note(row, "no grain is supported by others, so there is no spectrum")
    large = method == "auto" and len(free) > DENSE_UP_TO
    if method == "none" or (large and not row.residual <= BALANCED_BELOW):
        row = _without_spectrum(row)
        return _note(row, f"no spectrum of {len(free)} coordinates out of equilibrium") if large else row
    result = stability(state, law, method="fastest" if large else method, report=report)
    matrix = here.with_modes(modes_under(state, law, here.line)).dynamical_matrix(free)
    return _add_spectrum(row, result, softest_eigenvalue(matrix), notes)


def _note(row: Row, text: str) -> Row:
    return row._replace(note="; ".join(filter(None, [row.note, text])))


def _add_stress(row: Row, state: State, law: Law) -> Row:
    try:
        tensor, dim = stress(state, law), state.cell.dim
    except ValueError:
        return _note(row, "the box is open, so there is no volume for the stress")
    principal = np.linalg.eigvalsh(0.5 * (tensor + tensor.T)[:dim, :dim])
    parts = {f"stress_{name}": float(value) for name, value in zip(TENSOR, tensor.ravel(), strict=True)}
    shear = float(principal[-1] - principal[0]) / 2
    return row._replace(pressure=float(np.trace(tensor)) / dim, shear_stress=shear, **parts)


def _without_spectrum(row: Row) -> Row:
    balanced = bool(row.residual is not None and row.residual <= BALANCED_BELOW)
    told = "in equilibrium; the spectrum was not computed" if balanced else no_equilibrium_message(row.residual)
    return row._replace(balanced=balanced, verdict=told)


def _add_spectrum(row: Row, result: Stability, softest: complex, notes) -> Row:
    """Row with the numbers of a spectrum, as `stickslip stability --json` has them."""
    known = to_dict(result, notes=notes)
    grow = known["pairs"]
    negative = known["negative"] if "negative" in known else known["growing"]
    static = result.undamped or result
    least = min([softest.real, *map(float, static.negative)]) if np.isfinite(softest.real) else None
    return row._replace(
        rattlers=known["rattlers"], softest=least, zero_modes=known["zero_modes"], pairs=len(grow),
        growth_rate=grow[0]["growth_rate"] if grow else None, omega=grow[0]["omega"] if grow else None,
        buckling=len(negative), stable=known["stable"], balanced=known["balanced"],
        verdict=verdict(result, None, notes), scope=known["scope"],
    )  # fmt: skip


def verdict_word(row: Row) -> str:
    """Verdict in one word."""
    if not row.computed:
        return "damaged"
    if row.stable is not None:
        return "stable" if row.stable else "unstable"
    return "undecided" if row.balanced and row.pairs is not None else "balanced" if row.balanced else "unbalanced"
