"""Bonds of a packing in the report of `stickslip stability`: which ones decide, and which break first under strains."""

from typing import NamedTuple

import numpy as np

from ..core.laws.builtin import Law
from ..core.state import State
from ..core.units import with_unit
from ..loading.settling import MODES, deformation
from ..solve.balance import balanced
from ..solve.bond_failure import NEVER, DecisiveBonds, FirstBreak, break_along, decisive_bonds
from ..solve.moduli import elastic_moduli
from .details import attempt
from .terminal import console, new_table, show_table

SHOWN = 5  # decisive bonds in a table


class BondDetails(NamedTuple):
    """Computed quantities, or the reason why they could not be computed."""

    decisive: DecisiveBonds | str
    breaks: dict[tuple[str, int], FirstBreak] | str  # by mode of deformation and sign


def compute_bonds(state: State, law: Law) -> BondDetails:
    """Compute the decisive bonds of a packing in equilibrium, and the first ones to break under a few strains."""
    return BondDetails(attempt(decisive_bonds, state, law), attempt(_first_breaks, state, law))


def _first_breaks(state: State, law: Law) -> dict[tuple[str, int], FirstBreak]:
    here, dim = balanced(state, law), state.cell.dim
    moduli, out = elastic_moduli(here.state, law), {}
    for mode in MODES:
        for sign in (1, -1):
            gradient = deformation(mode, 2 if dim == 2 else 3, sign).gradient
            out[mode, sign] = break_along(here, moduli, gradient[:dim, :dim])
    return out


def to_dict(found: BondDetails) -> dict:
    """Return the details for JSON: null for quantities with an entry in `reasons`."""
    decisive, breaks = found
    return {
        "decisive": None if isinstance(decisive, str) else _decisive_dict(decisive),
        "first_breaks": None if isinstance(breaks, str) else [
            {
                "mode": mode, "sign": sign, "amount": one.at if np.isfinite(one.at) else None, "bond": one.bond,
                "grains": list(one.pair), "by": one.mode,
            }
            for (mode, sign), one in breaks.items()
        ],
        "reasons": {name: part for name, part in found._asdict().items() if isinstance(part, str)},
    }  # fmt: skip


def _decisive_dict(found: DecisiveBonds) -> dict:
    return {
        "re_lambda": found.eigenvalue.real, "im_lambda": found.eigenvalue.imag, "verdict": found.verdict,
        "bonds": [
            {
                "bond": int(found.bond[k]), "grains": [int(found.i[k]), int(found.j[k])],
                "derivative": [found.derivative[k].real, found.derivative[k].imag], "share": float(found.share[k]),
                "verdict_after": str(found.verdict_after[k]) or None,
            }
            for k in range(len(found.bond))
        ],
    }  # fmt: skip


def show(found: BondDetails) -> None:
    """Print the details."""
    decisive, breaks = found
    if isinstance(decisive, str):
        console.print(f"\ndecisive bonds: none, {decisive}")
    else:
        _show_decisive(decisive)
    if isinstance(breaks, str):
        console.print(f"\nfirst bond to break: none, {breaks}")
    else:
        _show_breaks(breaks)


def _show_decisive(found: DecisiveBonds) -> None:
    value = found.eigenvalue
    name = "softest mode" if found.verdict == "stable" else "growing mode"
    imaginary = f" ± {abs(value.imag):.4g}i" if value.imag else ""
    console.print(f"\nbonds that decide the {name}, {with_unit(f'λ = {value.real:.4g}{imaginary}', '1/time^2')}")
    table = new_table("grains", "∂ln|λ|/∂ln k", "share of strength", "if it breaks", left=("if it breaks",))
    for k in range(min(SHOWN, len(found.bond))):
        slope, share = (found.derivative[k] / value).real, found.share[k]
        table.add_row(
            f"{found.i[k]}–{found.j[k]}",
            f"{slope:.3g}",
            f"{share:.3g}" if share > 1 / NEVER else "–",
            found.verdict_after[k] or "?",
        )
    show_table(table)
    if len(found.bond) > SHOWN:
        console.print(f"  and {len(found.bond) - SHOWN} more with --json")


def _show_breaks(breaks: dict[tuple[str, int], FirstBreak]) -> None:
    console.print("\nfirst bond to break as a strain grows, by linear response")
    table = new_table("strain", "bond of grains", "at", "by", left=("strain", "by"))
    for (mode, sign), one in breaks.items():
        words = mode if sign > 0 else f"{mode}, reversed"
        if one.bond < 0:
            table.add_row(words, "–", "–", "never")
        else:
            table.add_row(words, "{}–{}".format(*one.pair), f"{one.at:.4g}", one.mode)
    show_table(table)
