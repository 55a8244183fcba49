"""Stability of a packing: terminal output, JSON, and a file of modes."""

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from zipfile import BadZipFile, ZipFile

import numpy as np
from rich.table import Table

from .. import reports
from ..builtin_laws import NAMES
from ..core.arguments import require_positive
from ..core.laws.builtin import COULOMB, DAMPING, NO_TENSION, Law, damping_model, parameter_names, with_values
from ..core.laws.kinds import Kind, find_user_law
from ..core.measure import coordination, grain_volumes, mean_normal_force, overlaps, rattlers, touching, volume
from ..core.progress import Report, silent
from ..core.readable import pluralize
from ..core.state import State
from ..core.units import with_unit
from ..data.run_files import replace_atomically
from ..data.sample import UNDECIDED, Absent, Assumption, NoMemory, Obstacle, account_of, assumes_law
from ..known import with_keys
from ..solve.balance import BALANCED_BELOW, imbalance
from ..solve.freedom import backbone
from ..solve.stability import Stability
from .terminal import console, new_table, show_table

if TYPE_CHECKING:  # needed by a few options only, otherwise not loaded
    from ..solve.birth import BirthForm
    from ..solve.gradient import VerdictProbability
    from .details import BondDetails, Details

UNITS = {"Re λ": "1/time^2", "Im λ": "1/time^2", "period": "time", "e-folding time": "time"}
UNITS |= dict.fromkeys(("ω", "growth rate", "Re s", "Im s"), "1/time")
SHOWN = 12  # largest number of modes in a list, and of pairs of materials
MOST_KINDS = 20  # largest number of types of grains, or walls, whose laws are described
_MODES = ("eigenvalue", "exponent", "translation", "rotation")  # arrays in a file of modes
SETTLE_TOLERANCE = 1e-10  # largest residual of a settled packing, over the mean normal contact force
LAW_OPTIONS = ("law", "coulomb", "kn", "kt", "mu", "young", "poisson", "damping", "damping_n", "damping_t")


class Settling(NamedTuple):
    """Change in a packing caused by settling it; the verdict is for the settled packing."""

    moved: float  # largest displacement of a grain, over its radius
    moved_rms: float  # root mean square over grains of displacement over radius
    lost: int  # number of contacts lost
    gained: int
    before: float  # residual of the given packing
    how: str  # description of how the solver found equilibrium

    def __str__(self) -> str:
        return (
            f"the verdict is for the SETTLED packing, not for the one in the file: grains moved by up to "
            f"{self.moved:.2g} of their radius (rms {self.moved_rms:.2g}), {pluralize(self.lost, 'contact')} lost and "
            f"{self.gained} gained"
        )


def find_birth_form(state: State, law: Law, *, dashpots: bool = True) -> "BirthForm | str":
    """Return the normal form of the fastest-growing pair, or the reason why there is none."""
    from ..solve.birth import birth_form

    bare = {} if dashpots else {"damping_n": 0.0, "damping_t": 0.0}
    return reports.details.attempt(lambda: birth_form(state, with_values(law, **bare)))


def find_probability(
    state: State, law: Law, error: float, *, dashpots: bool = True, report: Report = silent
) -> "VerdictProbability | str":
    """Return the probability of the verdict, given errors of positions, or the reason why it is unknown."""
    from ..solve.gradient import verdict_probability

    require_positive(position_error=error)
    law = law if dashpots or not damping_model(law) else with_values(law, damping_n=0.0, damping_t=0.0)
    return reports.details.attempt(verdict_probability, state, law, position_error=error, report=report)


def probability_dict(sure: "VerdictProbability | str") -> dict:
    """Return the JSON object of a probability."""
    if isinstance(sure, str):
        return {"reason": sure}
    out = sure._asdict() | {"probability": sure.probability, "contact": list(sure.contact)}
    value = out.pop("eigenvalue")
    return out | {"re_lambda": value.real, "im_lambda": value.imag}


def show_probability(sure: "VerdictProbability | str") -> None:
    """Print the probability that a packing is stable, and the decisive contact."""
    if isinstance(sure, str):
        console.print(f"the effect of errors in positions is unknown: {sure}")
        return
    part, i, j = ("Im λ" if sure.eigenvalue.imag else "λ"), *sure.contact
    value = sure.eigenvalue.imag or sure.eigenvalue.real
    console.print(
        f"with these errors in positions, it is stable in {sure.stable} of {sure.samples} samples (probability "
        f"{sure.low:.2g} to {sure.high:.2g}); {with_unit(f'{part} = {value:.4g} ± {sure.deviation:.2g}', '1/time^2')}, "
        f"most of it from the contact of grains {i} and {j} ({100 * sure.share:.2g} % of the variance)",
        style="bold",
    )


def let_settle(state: State, law: Law) -> tuple[State, Settling]:
    """Return the packing in equilibrium under a law, and its change.

    Raises
    ------
    RuntimeError
        If no equilibrium was found.
    """
    from ..solve.equilibrate import equilibrate  # loads the time loop, which most packings do not need

    force, before = mean_normal_force(state, law), imbalance(state, law)
    end, outcome = equilibrate(state, law, tolerance=SETTLE_TOLERANCE * force or SETTLE_TOLERANCE, check="nothing")
    if not outcome.ok:
        raise RuntimeError(f"no equilibrium was found under this law: {outcome}")
    moved = np.linalg.norm(end.grains.position - state.grains.position, axis=1) / state.grains.radius
    if not len(backbone(end, law)):
        raise RuntimeError("the packing fell apart while settling: only rattlers are left")
    old, new = (set(packing.contacts.key[touching(packing)].tolist()) for packing in (state, end))
    rms = float(np.sqrt((moved**2).mean()))
    return end, Settling(float(moved.max()), rms, len(old - new), len(new - old), before, outcome.how)


def verdict(result: Stability, calm: Settling | None = None, notes=()) -> str:
    """Return the verdict in one sentence, which mentions settling, if any.

    The verdict takes account of notes about actions on the grains that were not imported, and about missing data.
    """
    sentence = f"{result.verdict}; {calm}" if calm else result.verdict
    left_out = "; ".join(note.reason for note in notes if isinstance(note, Obstacle))
    if not result.balanced:
        missing = f"{UNDECIDED}{left_out}" if left_out else missing_parts(notes)
        return f"{missing}; {sentence}" if missing else sentence
    without = "it" if sum(isinstance(note, Obstacle) for note in notes) == 1 else "these"
    return f"{UNDECIDED}{left_out}. Without {without}: {sentence}" if left_out else sentence


def is_stable(result: Stability, notes) -> bool | None:
    """Return True if the packing is stable; None if undecided."""
    return None if any(isinstance(note, Obstacle) for note in notes) else result.stable


def missing_parts(notes) -> str:
    """Sentence on missing data, if a file has neither a contact law nor the memory of contacts; otherwise empty."""
    if assumes_law(notes) and any(isinstance(note, NoMemory) for note in notes):
        return "no verdict: the file has no contact law and no memory of tangential contacts"
    return ""


class Geometry(NamedTuple):
    """Properties of a packing that follow from positions and radii alone."""

    contacts: int
    coordination: float  # mean number of contacts of grains that are not rattlers
    rattlers: int  # grains with fewer than two contacts, after recursive removal of rattlers
    overlap: float  # largest overlap, over the smaller radius of the two grains
    mean_overlap: float  # mean of this ratio over contacts
    packing_fraction: float
    volume: str  # volume to which the packing fraction refers

    def __str__(self) -> str:
        return (
            f"geometry: {pluralize(self.contacts, 'contact')}, coordination {self.coordination:.4g} without "
            f"{pluralize(self.rattlers, 'rattler')}, overlaps up to {100 * self.overlap:.3g} % of a radius (mean "
            f"{100 * self.mean_overlap:.3g} %), packing fraction {self.packing_fraction:.4g} of {self.volume}"
        )


def geometry(state: State) -> Geometry:
    """Return the properties from positions and radii alone: coordination, rattlers, overlaps, packing fraction."""
    rows, grains, dim = touching(state), state.grains, state.cell.dim
    radius = np.append(grains.radius, np.full(len(state.walls.mass), np.inf))
    small = np.minimum(radius[state.contacts.i[rows]], radius[state.contacts.j[rows]])
    share = overlaps(state)[rows] / small if len(rows) else np.zeros(1)
    if state.cell.periodic[:dim].all():
        whole, name = volume(state), "the cell"
    else:
        low, high = (
            op(grains.position + side * grains.radius[:, None], axis=0) for op, side in ((np.min, -1), (np.max, 1))
        )
        lengths = np.where(state.cell.periodic, np.diag(state.cell.vectors), high - low)[:dim]
        whole, name = float(np.prod(lengths)), "the box around the grains"
    fraction = float(grain_volumes(state).sum() / whole)
    loose = rattlers(state)
    return Geometry(
        len(rows), coordination(state), int(loose.sum()), float(share.max()), float(share.mean()), fraction, name
    )


def likely_causes(result: Stability, options: dict, notes: list[str]) -> list[str]:
    """Return the likely causes of unbalanced forces, from the packing, missing data, and options for its law."""
    law = "another law than that of the packing"
    acts = [note.reason for note in notes if isinstance(note, Obstacle)]
    lacks = [note for note in notes if isinstance(note, Absent)]
    known = [*acts, *result.causes[:-1], *lacks]  # the last cause is implied by `law`
    given = [f"--{name.replace('_', '-')}" for name in LAW_OPTIONS if options.get(name) is not None]
    if given:
        known.append(f"{law}: {', '.join(given)} came from the command line")
    elif assumes_law(notes):
        known.append(f"{law}: none was given, so the defaults were used")
    return known or list(result.causes)


def to_dict(
    result: Stability, more: "Details | None" = None,
    form: "BirthForm | str | None" = None, *, calm: Settling | None = None, why=(), notes=(),
    shape: Geometry | None = None, bonds: "BondDetails | None" = None,
) -> dict:  # fmt: skip
    """Return the JSON object with the documented keys; `why` gives the likely causes (see `likely_causes`)."""
    damped = result.undamped is not None
    pairs = [
        ({"re_s": g, "im_s": w} if damped else {"re_lambda": p.real, "im_lambda": p.imag})
        | {"omega": w, "growth_rate": g}
        for p, w, g in zip(*(x.tolist() for x in (result.pairs, result.frequency, result.growth_rate)), strict=True)
    ]
    out = {
        "n": result.n,
        "contacts": result.contacts,
        "bonded": result.bonded,
        "rattlers": len(result.rattlers),
        "residual": result.residual if np.isfinite(result.residual) else None,
        "tolerance": BALANCED_BELOW,
        "balanced": result.balanced,
        "causes": list(why),
        "settled": None
        if calm is None
        else calm._asdict() | {"before": calm.before if np.isfinite(calm.before) else None},
        "stable": is_stable(result, notes),
        "assumed": [note for note in notes if isinstance(note, Assumption)],
        "met": with_keys(account_of(notes)),
        "geometry": shape and shape._asdict(),
        "at_limit": result.at_limit,
        "if_stuck": result.if_stuck.motion if result.if_stuck else None,
        "pairs": pairs,
        "growing" if damped else "negative": (np.sqrt(-result.negative) if damped else result.negative).tolist(),
        "zero_modes": result.zero_modes,
        "unverified": result.unverified,
        "spectrum": "damped" if damped else "undamped",
        "method": result.method,
        "scope": result.scope,
    }
    if more:
        out["more"] = reports.details.to_dict(more)
    if bonds:
        out["bonds"] = reports.details.bonds_dict(bonds)
    if form:
        out["after"] = {"reason": form} if isinstance(form, str) else _form_dict(form)
    return out


def _form_dict(form: "BirthForm") -> dict:
    """Numbers of the normal form; infinite ones are null."""
    out = {"fate": form.fate, "verdict": form.verdict, "limit_contact": list(form.limit_contact)}
    out |= {"opening_contact": list(form.opening_contact), "closing_contact": list(form.closing_contact)}
    for name in (
        "frequency", "growth_rate", "nearness", "beta", "bare", "peak", "cubic_peak", "limit", "opening", "closing",
        "resonance", "detuned",
    ):  # fmt: skip
        value = getattr(form, name)
        out[name] = value if np.isfinite(value) else None
    return out


def show(
    result: Stability, law: Law, notes: list[str], more: "Details | None" = None,
    form: "BirthForm | str | None" = None, *, calm: Settling | None = None, why=(), remedy: str = "",
    shape: Geometry | None = None, state: State | None = None, bonds: "BondDetails | None" = None,
) -> None:  # fmt: skip
    """Print the verdict, a table of pairs and the details.

    Also print `why` and `remedy` if the packing is not in equilibrium, and its geometry if the file contains little
    else.
    """
    # print the data read, then the assumptions; omissions are part of the verdict
    for note in notes:
        if not isinstance(note, Assumption):
            console.print(note, style="yellow")
    assumed = [note for note in notes if isinstance(note, Assumption) and not isinstance(note, Obstacle)]
    if assumed:
        console.print("assumed:", style="yellow")
    for note in assumed:
        console.print(f"  - {note}", style="yellow")
    console.print(f"law: {describe_law(law, state)}")
    bonded = f", {result.bonded} of them bonded" if result.bonded else ""
    console.print(
        f"{result.n} grains, {result.contacts} contacts{bonded}, {len(result.rattlers)} rattlers, residual "
        f"{result.residual:.2g} of the mean contact force"
    )
    if calm:
        console.print(str(calm), style="bold yellow")
    if shape:
        console.print(str(shape))
    color = {True: "green", False: "red", None: "yellow"}[is_stable(result, notes)]
    console.print(verdict(result, None, notes), style=f"bold {color}")
    if not result.balanced:
        console.print(f"an equilibrium has a residual of at most {BALANCED_BELOW:g}; likely causes:")
        for cause in why:
            console.print(f"  - {cause}")
        if remedy:
            console.print(remedy)
        if result.grows:
            console.print(f"spectrum of the initial motion, no verdict: {result.motion}")
    if result.undamped:
        console.print("spectrum: damped, exponents s of exp(st) from M q̈ = J q + C q̇ at rest")
        console.print(f"without dashpots: {result.undamped.motion}")
    console.print(f"method: {result.way}")
    if result.scope:
        console.print(f"scope: {result.scope}")
    if len(result.rattlers):
        some = ", ".join(map(str, result.rattlers[:20])) + (" …" if len(result.rattlers) > 20 else "")
        console.print(f"rattlers (excluded): {some}")
    _show_exponents(result) if result.undamped else _show_pairs(result)
    if more:
        reports.details.show(more, result)
    if bonds:
        reports.details.show_bonds(bonds)
    if form:
        _show_form(form)


def _show_form(form: "BirthForm | str") -> None:
    if isinstance(form, str):
        console.print(f"the course of the instability is unknown: {form}")
        return
    console.print(f"course of the instability: {form.verdict}", style="bold")
    rate = with_unit(f"{form.growth_rate:.4g}", "1/time")
    console.print(
        f"normal form of the fastest pair: σ = {rate}, β = {form.beta:.4g} ({form.bare:.4g} without "
        f"slaved modes), |q|/|p| = {form.nearness:.2g}; the mode nearest to 2ω is {100 * form.resonance:.2g} % away, "
        f"which leaves β uncertain by {100 * form.detuned:.2g} %"
    )
    if len(form.rates):
        table = new_table("amplitude", "growth rate", "over σ", units=UNITS)
        for k in range(len(form.rates) // 4 - 1, len(form.rates), len(form.rates) // 4):
            if np.isfinite(form.rates[k]):
                ratio = form.rates[k] / form.growth_rate
                table.add_row(f"{form.amplitudes[k]:.4g}", f"{form.rates[k]:.4g}", f"{ratio:.3g}")
        show_table(table)


def describe_law(law: Law, state: State | None = None) -> str:
    """Describe a law: kind, Coulomb limit, parameters of each pair of materials, and damping.

    With a state, only pairs that can meet are listed. Types of grains are numbered from 1, and walls in their order.
    """
    coulomb = next(name for name, number in COULOMB.items() if number == law.coulomb)
    damping = next(name for name, number in DAMPING.items() if number == law.damping & ~NO_TENSION)
    name = find_user_law(law.kind).name if isinstance(law.kind, Kind) else NAMES[law.kind]
    kinds = list(range(len(law.table)))[:MOST_KINDS]
    walls: list[tuple[str, int]] = []
    if state is not None:
        kinds = np.unique(state.grains.material).tolist()[:MOST_KINDS]
        walls = [(f"wall {k + 1}", material) for k, material in enumerate(state.walls.material.tolist())][:MOST_KINDS]
    meeting = [(f"types {a + 1} and {b + 1}", a, b) for a in kinds for b in kinds if a <= b]
    meeting += [(f"type {a + 1} and {label}", a, wall) for label, wall in walls for a in kinds]
    pairs: dict[str, list[str]] = {}
    for label, a, b in meeting:
        values = zip(parameter_names(law), law.table[a, b], strict=True)
        pairs.setdefault(", ".join(f"{key} = {value:.4g}" for key, value in values if value), []).append(label)
    told = [f"{', '.join(labels)}: {values}" for values, labels in pairs.items()]
    more = [f"and {len(told) - SHOWN} more"] if len(told) > SHOWN else []
    values = "; ".join([*told[:SHOWN], *more]) if len(pairs) > 1 else next(iter(pairs), "")
    return f"{name}, {coulomb} Coulomb, {values}" + (f" ({damping})" if damping_model(law) else "")


def _make_table(name: str, count: int, columns: tuple[str, ...]) -> Table:
    title = name + (f", the fastest {SHOWN} of {count}" if count > SHOWN else "")
    return new_table(*columns, title=title, units=UNITS)


def _show_exponents(result: Stability) -> None:
    if result.grows:
        table = _make_table("Growing exponents", len(result.exponents), ("Re s", "Im s", "period", "e-folding time"))
        for s in sorted(result.exponents, key=lambda s: -s.real)[:SHOWN]:
            frequency = abs(s.imag)
            period = f"{2 * np.pi / frequency:.4g}" if frequency > 0 else "–"
            table.add_row(f"{s.real:.5g}", f"{frequency:.5g}", period, f"{1 / s.real:.4g}")
        show_table(table)
    elif result.slowest is not None:
        s = result.slowest
        console.print(f"slowest decay: s = {s.real:.4g} ± {abs(s.imag):.4g}i")


def _show_pairs(result: Stability) -> None:
    if len(result.pairs):
        names = ("Re λ", "Im λ", "ω", "growth rate", "period", "e-folding time")
        table = _make_table("Complex pairs", len(result.pairs), names)
        rows = zip(result.pairs[:SHOWN], result.frequency, result.growth_rate, strict=False)
        for pair, w, g in rows:
            period = f"{2 * np.pi / w:.4g}" if w > 0 else "–"
            table.add_row(f"{pair.real:.5g}", f"{pair.imag:.4g}", f"{w:.5g}", f"{g:.4g}", period, f"{1 / g:.4g}")
        show_table(table)
    if len(result.negative):
        count = len(result.negative)
        lowest = f", the lowest {SHOWN} of {count}" if count > SHOWN else ""
        console.print(f"negative λ{lowest}: " + ", ".join(f"{v:.4g}" for v in result.negative[:SHOWN]))


def check_modes(path: Path, packing: Path, *, asked: bool) -> None:
    """Raise ValueError if the file of modes would replace the packing, or a file without modes."""
    if path.exists() and packing.exists() and path.samefile(packing):
        raise ValueError(f"--modes {path} would replace the packing: give another name")
    if not path.parent.is_dir():
        raise ValueError(f"{path.parent} is not a folder: create it first, or give another --modes")
    if path.is_dir():
        raise ValueError(f"{path} is a folder: give the name of a file")
    if not os.path.lexists(path):
        return
    if path.is_file():
        with suppress(OSError, ValueError, BadZipFile), ZipFile(path) as file:
            if {f"{name}.npy" for name in _MODES} <= set(file.namelist()):
                return
    if asked:
        raise ValueError(f"--modes {path} exists and does not contain modes: give another name, or move it away")
    raise ValueError(f"modes would replace {path}, which does not contain modes: give --modes, or move it away")


def write_modes(path: Path, result: Stability) -> Path:
    """Write the growing modes: `eigenvalue` λ and `exponent` s (K,), `translation` and `rotation` (K, N, 3) complex.

    The motion is Re(mode exp(st)), with s = −i√λ of the damped or the undamped spectrum. A rotation is R·angle; modes
    have unit norm in the mass-weighted metric. Rattlers and constrained coordinates are zero.
    """
    full = _expand_modes(result)
    with replace_atomically(path) as part, part.open("wb") as file:
        np.savez(
            file, eigenvalue=-(result.exponents**2), exponent=result.exponents, translation=full[..., :3],
            rotation=full[..., 3:], rattlers=result.rattlers,
        )  # fmt: skip
    return path


def growing_modes(result: Stability) -> list[tuple[np.ndarray, np.ndarray, complex]]:
    """Return translation, rotation (N, 3) complex and exponent s of each growing mode, fastest first."""
    full, exponents = _expand_modes(result), result.exponents
    order = np.argsort(-exponents.real, kind="stable")
    return [(full[k, :, :3], full[k, :, 3:], complex(exponents[k])) for k in order]


def _expand_modes(result: Stability) -> np.ndarray:
    """(K, N, 6) growing modes, with zeros for constrained coordinates."""
    count = result.modes.shape[1]
    return np.array([result.free.spread(mode)[: result.n] for mode in result.modes.T]).reshape(count, result.n, 6)
