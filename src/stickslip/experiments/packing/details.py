"""What `stickslip stability --more` tells beside the spectrum: who takes part, moduli, transient growth, contacts."""

from typing import NamedTuple

import numpy as np
from rich.table import Table

from ...core.laws.builtin import Law
from ...core.state import State
from ...solve.damped import DampedStability
from ...solve.density import participation_ratio
from ...solve.moduli import ElasticModuli, elastic_moduli, voigt
from ...solve.sensitivity import ContactSensitivity, contact_sensitivity
from ...solve.stability import Stability
from ...solve.transient import TransientGrowth, transient_growth
from ..terminal import STYLE, console

CONTACTS = 5  # in the table
SHOWN = 12  # participation ratios
UNBALANCED = "as the packing is not in equilibrium"
POSITIVE = "the symmetric part of the stiffness"


class Details(NamedTuple):
    """What was computed, or a sentence why it could not be."""

    participation: np.ndarray  # (K,) of the modes that grow, in their order
    moduli: ElasticModuli | str
    transient: TransientGrowth | str
    contacts: ContactSensitivity | str


def more_of(state: State, law: Law, found: Stability | DampedStability, *, report=None) -> Details:
    """Everything beyond the spectrum that this packing has; report(stage, share done, words) on the way."""
    participation = participation_ratio(found.modes, found.free)
    if not found.balanced:
        return Details(participation, UNBALANCED, UNBALANCED, UNBALANCED)
    return Details(
        participation,
        _try(elastic_moduli, state, law),
        _compute_transient(state, law, found, report),
        _try(contact_sensitivity, state, law, report=report),
    )


def _try(function, *arguments, **options):
    """What a function returns, or its sentence why not."""
    try:
        return function(*arguments, **options)
    except ValueError as problem:
        return str(problem)


def _compute_transient(state: State, law: Law, found, report) -> TransientGrowth | str:
    if found.grows:
        return "as something grows exponentially, which outgrows every transient"
    by_energy = _try(transient_growth, state, law, report=report)
    if isinstance(by_energy, str) and by_energy.startswith(POSITIVE):
        return _try(transient_growth, state, law, norm="displacement", report=report)
    return by_energy


def to_dict(more: Details) -> dict:
    """The same as JSON takes it: null where `reasons` says why."""
    m, t, s = more.moduli, more.transient, more.contacts
    parts = {"moduli": m, "transient": t, "contacts": s}
    return {
        "participation_ratio": [float(p) for p in more.participation],
        "moduli": None if isinstance(m, str) else _moduli_dict(m),
        "transient": None if isinstance(t, str) else _transient_dict(t),
        "contacts": None if isinstance(s, str) else [_contact_dict(s, k) for k in range(min(CONTACTS, len(s.contact)))],
        "contacts_scope": "" if isinstance(s, str) else s.scope,
        "reasons": {name: part for name, part in parts.items() if isinstance(part, str)},
    }


def _moduli_dict(m: ElasticModuli) -> dict:
    names = ("bulk", "shear", "bulk_affine", "shear_affine", "poisson", "young", "anisotropy", "asymmetry")
    whole = {"voigt": m.voigt.tolist(), "voigt_affine": voigt(m.affine).tolist()}
    numbers = {name: float(getattr(m, name)) for name in names}
    return {name: value if np.isfinite(value) else None for name, value in numbers.items()} | whole


def _transient_dict(t: TransientGrowth) -> dict:
    names = ("amplitude", "time", "bound", "of_pair")
    rest = {"norm": t.norm, "duration": float(t.times[-1]), "pair": [float(w) for w in t.pair]}
    return {name: float(getattr(t, name)) for name in names} | rest


def _contact_dict(s: ContactSensitivity, k: int) -> dict:
    slope = s.growth_derivative[np.searchsorted(s.contacts, s.contact[k])] if len(s.derivative) else None
    after = float(s.after[k]) if s.verified[k] else None
    return {
        "contact": int(s.contact[k]), "i": int(s.i[k]), "j": int(s.j[k]), "what": str(s.what[k]),
        "mobilised": float(s.mobilised[k]) if np.isfinite(s.mobilised[k]) else None,
        "growth_rate_before": s.growth_rate, "growth_rate_after": after, "predicted": float(s.predicted[k]),
        "verdict_after": str(s.verdict_after[k]) or None, "turns": bool(s.turns[k]), "verified": bool(s.verified[k]),
        "derivative": None if slope is None else float(slope),
    }  # fmt: skip


def show(more: Details, found: Stability | DampedStability) -> None:
    """The same for the eye."""
    static = found.undamped if isinstance(found, DampedStability) else found
    if len(more.participation):
        ratios = ", ".join(f"{p:.3g}" for p in more.participation[:SHOWN])
        rest = " …" if len(more.participation) > SHOWN else ""
        console.print(f"\nparticipation ratios of what grows, in this order: {ratios}{rest}")
    for name, part, shown in (
        ("elastic moduli", more.moduli, _show_moduli),
        ("transient growth", more.transient, _show_transient),
        (
            "contacts that decide",
            more.contacts,
            lambda s: _show_contacts(s, static.n, isinstance(found, DampedStability)),
        ),
    ):
        if isinstance(part, str):
            console.print(f"\n{name}: none, {part}")
        else:
            shown(part)


def _show_moduli(m: ElasticModuli) -> None:
    console.print("\nelastic moduli in force/length^(dim−1), each contact held in its mode")
    table = Table(**STYLE)
    for column in ("", "whole", "affine", "non-affine"):
        table.add_column(column, justify="right")
    for name, whole, affine in (("bulk K", m.bulk, m.bulk_affine), ("shear G", m.shear, m.shear_affine)):
        table.add_row(name, f"{whole:.5g}", f"{affine:.5g}", f"{whole - affine:.5g}")
    console.print(table)
    console.print(
        f"Young's modulus {m.young:.5g}, Poisson's ratio {m.poisson:.4g}; {100 * m.anisotropy:.2g} % of C is not "
        f"isotropic, {100 * m.asymmetry:.2g} % not symmetric"
    )


def _show_transient(t: TransientGrowth) -> None:
    what = "√energy" if t.norm == "energy" else "displacements"
    pair = f"; frequencies {t.pair[0]:.6g} and {t.pair[1]:.6g} nearly coincide" if len(t.pair) else ""
    console.print(
        f"\ntransient growth: {what} ×{t.amplitude:.4g} at time {t.time:.4g}, the most that was found up to time "
        f"{t.times[-1]:.4g}; never more than ×{t.bound:.4g}{pair}"
    )


def _show_contacts(s: ContactSensitivity, n: int, damped: bool) -> None:
    count, verified = int(s.turns.sum()), int(s.verified.sum())
    turned, aside = "unstable" if s.verdict == "stable" else "stable", " (dashpots left out)" if damped else ""
    console.print(
        f"\ncontacts that decide{aside}: {count} of {verified} changes whose spectrum was computed make the packing "
        f"{turned}" + (f"; {s.scope}" if s.scope else "")
    )
    slope = dict(zip(s.contacts, s.growth_derivative, strict=True)) if len(s.derivative) else {}
    table = Table(**STYLE)
    for column in ("grains", "F_t/(μ F_n)", "if it", "growth rate", "then", "verdict then", *["∂/∂ln s"] * bool(slope)):
        table.add_column(column, justify="right")
    for k in range(len(s.contact))[:CONTACTS]:
        after, words = (f"{s.after[k]:.4g}", s.verdict_after[k]) if s.verified[k] else (f"≈ {s.predicted[k]:.3g}", "?")
        other = f"{s.j[k]}" if s.j[k] < n else f"wall {s.j[k] - n}"
        row = [f"{s.i[k]}–{other}", f"{s.mobilised[k]:.3g}", s.what[k], f"{s.growth_rate:.4g}", after, words]
        table.add_row(*row, *([f"{slope[s.contact[k]]:.3g}"] if slope else []))
    console.print(table)
