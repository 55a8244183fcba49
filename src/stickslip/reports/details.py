"""Details of `stickslip stability --more`: participation ratios, moduli, transient growth, and decisive contacts.

For packings with bonds, the details include the decisive bonds, and the first bonds to break under several strains.
"""

from typing import NamedTuple

import numpy as np

from ..core.laws.builtin import Law
from ..core.progress import Report, silent
from ..core.state import State
from ..core.units import unit_name, with_unit
from ..loading.settling import MODES, deformation
from ..solve.balance import balanced
from ..solve.bond_failure import NEVER, DecisiveBonds, FirstBreak, break_along, decisive_bonds
from ..solve.moduli import ElasticModuli, elastic_moduli, voigt
from ..solve.sensitivity import ContactSensitivity, contact_sensitivity
from ..solve.spectrum import participation_ratio
from ..solve.stability import Stability
from ..solve.transient import NoElasticEnergyError, TransientGrowth, transient_growth
from .terminal import console, new_table, show_table

CONTACTS = 5  # number of rows of the table of contacts
SHOWN = 12  # number of participation ratios that are printed
UNBALANCED = "since the packing is not in equilibrium"


class Details(NamedTuple):
    """Computed quantities, or the reason why they could not be computed."""

    participation: np.ndarray  # (K,) participation ratios of the growing modes, in their order
    moduli: ElasticModuli | str
    transient: TransientGrowth | str
    contacts: ContactSensitivity | str


def compute_details(state: State, law: Law, result: Stability, *, report: Report = silent) -> Details:
    """Compute all details beyond the spectrum; progress is reported as report(stage, share done, text)."""
    participation = participation_ratio(result.modes, result.free)
    if not result.balanced:
        return Details(participation, UNBALANCED, UNBALANCED, UNBALANCED)
    moduli = attempt(elastic_moduli, state, law)
    transient: TransientGrowth | str = "since exponential growth exceeds any transient"
    if not result.grows:
        try:
            transient = transient_growth(state, law, report=report)
        except NoElasticEnergyError:
            transient = attempt(transient_growth, state, law, norm="displacement", report=report)
        except ValueError as problem:
            transient = str(problem)
    return Details(participation, moduli, transient, attempt(contact_sensitivity, state, law, report=report))


def attempt(function, *arguments, **options):
    """Return the result of a function, or the message of its ValueError."""
    try:
        return function(*arguments, **options)
    except ValueError as problem:
        return str(problem)


def to_dict(more: Details) -> dict:
    """Return the details for `to_json`: None for quantities with an entry in `reasons`."""
    m, t, s = more.moduli, more.transient, more.contacts
    parts = {"moduli": m, "transient": t, "contacts": s}
    moduli = None
    if not isinstance(m, str):
        names = ("bulk", "shear", "bulk_affine", "shear_affine", "poisson", "young", "anisotropy", "asymmetry")
        moduli = {name: getattr(m, name) for name in names} | {"voigt": m.voigt, "voigt_affine": voigt(m.affine)}
    return {
        "participation_ratio": more.participation,
        "moduli": moduli,
        "transient": None if isinstance(t, str) else {
            **{name: float(getattr(t, name)) for name in ("amplitude", "time", "bound", "of_pair")},
            "norm": t.norm, "duration": t.times[-1], "pair": t.pair,
        },
        "contacts": None if isinstance(s, str) else [_contact_dict(s, k) for k in range(min(CONTACTS, len(s.contact)))],
        "contacts_scope": "" if isinstance(s, str) else s.scope,
        "reasons": {name: part for name, part in parts.items() if isinstance(part, str)},
    }  # fmt: skip


def _contact_dict(s: ContactSensitivity, k: int) -> dict:
    slope = s.growth_derivative[np.searchsorted(s.contacts, s.contact[k])] if len(s.derivative) else None
    return {
        "contact": s.contact[k], "i": s.i[k], "j": s.j[k], "what": s.what[k], "mobilised": s.mobilised[k],
        "growth_rate_before": s.growth_rate, "growth_rate_after": s.after[k] if s.verified[k] else None,
        "predicted": s.predicted[k], "verdict_after": s.verdict_after[k] or None, "turns": s.turns[k],
        "verified": s.verified[k], "derivative": slope,
    }  # fmt: skip


def show(more: Details, result: Stability) -> None:
    """Print the details."""
    if len(more.participation):
        ratios = ", ".join(f"{p:.3g}" for p in more.participation[:SHOWN])
        rest = " …" if len(more.participation) > SHOWN else ""
        console.print(f"\nparticipation ratios of the growing modes, in this order: {ratios}{rest}")
    for name, part, shown in (
        ("elastic moduli", more.moduli, _show_moduli),
        ("transient growth", more.transient, _show_transient),
        ("decisive contacts", more.contacts, lambda s: _show_contacts(s, result.n)),
    ):
        if isinstance(part, str):
            console.print(f"\n{name}: none, {part}")
        else:
            shown(part)


def _show_moduli(m: ElasticModuli) -> None:
    unit = unit_name("force/length^(dim-1)").replace("-", "−")
    console.print(f"\nelastic moduli in {unit}, with fixed contact modes")
    table = new_table("", "total", "affine", "non-affine")
    for name, total, affine in (("bulk K", m.bulk, m.bulk_affine), ("shear G", m.shear, m.shear_affine)):
        table.add_row(name, f"{total:.5g}", f"{affine:.5g}", f"{total - affine:.5g}")
    show_table(table)
    console.print(
        f"Young's modulus {m.young:.5g}, Poisson's ratio {m.poisson:.4g}; {100 * m.anisotropy:.2g} % of C is "
        f"anisotropic, {100 * m.asymmetry:.2g} % antisymmetric"
    )


def _show_transient(t: TransientGrowth) -> None:
    what = "√energy" if t.norm == "energy" else "displacements"
    at, until = (with_unit(f"{time:.4g}", "time") for time in (t.time, t.times[-1]))
    pair = f"; frequencies {t.pair[0]:.6g} and {t.pair[1]:.6g} nearly coincide" if len(t.pair) else ""
    console.print(
        f"\ntransient growth: {what} ×{t.amplitude:.4g} at time {at}, the largest value found up to "
        f"time {until}; upper bound ×{t.bound:.4g}{pair}"
    )


def _show_contacts(s: ContactSensitivity, n: int) -> None:
    count, verified = int(s.turns.sum()), int(s.verified.sum())
    turned = "unstable" if s.verdict == "stable" else "stable"
    console.print(
        f"\ndecisive contacts: {count} of {verified} changes whose spectrum was computed make the packing "
        f"{turned}" + (f"; {s.scope}" if s.scope else "")
    )
    slope = dict(zip(s.contacts, s.growth_derivative, strict=True)) if len(s.derivative) else {}
    names = ("grains", "F_t/(μ F_n)", "if it", "growth rate", "then", "verdict then")
    table = new_table(*names, *["∂/∂ln s"] * bool(slope))
    for k in range(len(s.contact))[:CONTACTS]:
        after, text = (f"{s.after[k]:.4g}", s.verdict_after[k]) if s.verified[k] else (f"≈ {s.predicted[k]:.3g}", "?")
        other = f"{s.j[k]}" if s.j[k] < n else f"wall {s.j[k] - n}"
        row = [f"{s.i[k]}–{other}", f"{s.mobilised[k]:.3g}", s.what[k], f"{s.growth_rate:.4g}", after, text]
        table.add_row(*row, *([f"{slope[s.contact[k]]:.3g}"] if slope else []))
    show_table(table)


BONDS = 5  # number of decisive bonds in a table


class BondDetails(NamedTuple):
    """Computed quantities, or the reason why they could not be computed."""

    decisive: DecisiveBonds | str
    breaks: dict[tuple[str, int], FirstBreak] | str  # first breaks, by mode of deformation and sign


def compute_bonds(state: State, law: Law) -> BondDetails:
    """Compute the decisive bonds of a packing in equilibrium, and the first bonds to break under several strains."""
    return BondDetails(attempt(decisive_bonds, state, law), attempt(_first_breaks, state, law))


def _first_breaks(state: State, law: Law) -> dict[tuple[str, int], FirstBreak]:
    here, dim = balanced(state, law), state.cell.dim
    moduli, out = elastic_moduli(here.state, law), {}
    for mode in MODES:
        for sign in (1, -1):
            gradient = deformation(mode, 2 if dim == 2 else 3, sign).gradient
            out[mode, sign] = break_along(here, moduli, gradient[:dim, :dim])
    return out


def bonds_dict(found: BondDetails) -> dict:
    """Return the details of bonds for JSON: null for quantities with an entry in `reasons`."""
    decisive, breaks = found
    return {
        "decisive": None if isinstance(decisive, str) else {
            "re_lambda": decisive.eigenvalue.real, "im_lambda": decisive.eigenvalue.imag, "verdict": decisive.verdict,
            "bonds": [
                {
                    "bond": int(decisive.bond[k]), "grains": [int(decisive.i[k]), int(decisive.j[k])],
                    "derivative": [decisive.derivative[k].real, decisive.derivative[k].imag],
                    "share": float(decisive.share[k]), "verdict_after": str(decisive.verdict_after[k]) or None,
                }
                for k in range(len(decisive.bond))
            ],
        },
        "first_breaks": None if isinstance(breaks, str) else [
            {
                "mode": mode, "sign": sign, "amount": one.at if np.isfinite(one.at) else None, "bond": one.bond,
                "grains": list(one.pair), "by": one.mode,
            }
            for (mode, sign), one in breaks.items()
        ],
        "reasons": {name: part for name, part in found._asdict().items() if isinstance(part, str)},
    }  # fmt: skip


def show_bonds(found: BondDetails) -> None:
    """Print the details of bonds."""
    decisive, breaks = found
    if isinstance(decisive, str):
        console.print(f"\ndecisive bonds: none, {decisive}")
    else:
        value = decisive.eigenvalue
        name = "softest mode" if decisive.verdict == "stable" else "growing mode"
        imaginary = f" ± {abs(value.imag):.4g}i" if value.imag else ""
        console.print(f"\nbonds that decide the {name}, {with_unit(f'λ = {value.real:.4g}{imaginary}', '1/time^2')}")
        table = new_table("grains", "∂ln|λ|/∂ln k", "share of strength", "if it breaks", left=("if it breaks",))
        for k in range(min(BONDS, len(decisive.bond))):
            share = f"{decisive.share[k]:.3g}" if decisive.share[k] > 1 / NEVER else "–"
            slope, after = (decisive.derivative[k] / value).real, decisive.verdict_after[k] or "?"
            table.add_row(f"{decisive.i[k]}–{decisive.j[k]}", f"{slope:.3g}", share, after)
        show_table(table)
        if len(decisive.bond) > BONDS:
            console.print(f"  and {len(decisive.bond) - BONDS} more with --json")
    if isinstance(breaks, str):
        console.print(f"\nfirst bond to break: none, {breaks}")
    else:
        console.print("\nfirst bond to break as a strain grows, by linear response")
        table = new_table("strain", "bond of grains", "at", "by", left=("strain", "by"))
        for (mode, sign), one in breaks.items():
            words = mode if sign > 0 else f"{mode}, reversed"
            if one.bond < 0:
                table.add_row(words, "–", "–", "never")
            else:
                table.add_row(words, "{}–{}".format(*one.pair), f"{one.at:.4g}", one.mode)
        show_table(table)
