"""The stability of a packing, on the terminal, as JSON, and its modes in a file."""

import json
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from ..core.laws import COULOMB, HERTZ_MINDLIN, PARAMETERS, Law
from ..solve.stability import Stability
from .report import console

SHOWN = 12  # pairs in the table
UNBALANCED = 1e-6  # residual above which the user is told that this is no equilibrium


def as_json(found: Stability) -> str:
    """One object with the documented keys."""
    pairs = [
        {"re_lambda": float(p.real), "im_lambda": float(p.imag), "omega": float(w), "growth_rate": float(g)}
        for p, w, g in zip(found.pairs, found.frequency, found.growth_rate, strict=True)
    ]
    out = {
        "n": found.n,
        "contacts": found.contacts,
        "rattlers": len(found.rattlers),
        "residual": found.residual if np.isfinite(found.residual) else None,
        "stable": found.stable,
        "pairs": pairs,
        "negative": [float(v) for v in found.negative],
        "zero_modes": found.zero_modes,
    }
    return json.dumps(out, allow_nan=False)


def show(found: Stability, law: Law, words: list[str]) -> None:
    """The verdict in words, the pairs in a table."""
    kind = "hertz_mindlin" if law.kind == HERTZ_MINDLIN else "linear"
    coulomb = next(name for name, number in COULOMB.items() if number == law.coulomb)
    values = ", ".join(
        f"{name} = {value:.4g}" for name, value in zip(PARAMETERS, law.table[0, 0], strict=True) if value
    )
    for line in words:
        console.print(f"[yellow]{line}[/]")
    console.print(f"law: {kind}, {coulomb} Coulomb, {values}", highlight=False)
    console.print(
        f"{found.n} grains, {found.contacts} contacts, {len(found.rattlers)} rattlers, residual "
        f"{found.residual:.2g} of the mean normal contact force",
        highlight=False,
    )
    if found.residual > UNBALANCED:
        console.print("[yellow]the forces do not balance: this is the first moment of a motion, not an equilibrium[/]")
    color = "green" if found.stable else "red"
    console.print(f"[bold {color}]{found.verdict}[/]", highlight=False)
    if found.scope:
        console.print(f"scope: {found.scope}", highlight=False)
    if len(found.rattlers):
        some = ", ".join(map(str, found.rattlers[:20])) + (" …" if len(found.rattlers) > 20 else "")
        console.print(f"rattlers (left out): {some}", highlight=False)
    if len(found.pairs):
        title = "Complex pairs" + (f", the fastest {SHOWN} of {len(found.pairs)}" if len(found.pairs) > SHOWN else "")
        table = Table(title=title, title_justify="left", header_style="bold", box=SIMPLE_HEAD)
        for name in ("Re λ", "Im λ", "ω", "growth rate", "period", "e-folding time"):
            table.add_column(name, justify="right")
        rows = zip(found.pairs[:SHOWN], found.frequency, found.growth_rate, strict=False)
        for pair, w, g in rows:
            period = f"{2 * np.pi / w:.4g}" if w > 0 else "–"
            table.add_row(f"{pair.real:.5g}", f"{pair.imag:.4g}", f"{w:.5g}", f"{g:.4g}", period, f"{1 / g:.4g}")
        console.print(table)
    if len(found.negative):
        console.print("negative λ: " + ", ".join(f"{v:.4g}" for v in found.negative[:SHOWN]), highlight=False)


def write_modes(path: Path, found: Stability) -> Path:
    """λ and modes of all pairs and negative λ: `eigenvalue` (K,), `translation` and `rotation` (K, N, 3) complex.

    A rotation is R·angle; modes have unit norm in the mass-weighted metric. Rattlers and what is not free are zero.
    """
    count = found.modes.shape[1]
    full = np.array([found.free.spread(mode)[: found.n] for mode in found.modes.T]).reshape(count, found.n, 6)
    values = np.concatenate([found.pairs, found.negative.astype(complex)])
    beside = path.with_name(f".{path.name}.part.npz")
    try:
        np.savez(beside, eigenvalue=values, translation=full[..., :3], rotation=full[..., 3:], rattlers=found.rattlers)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    return path
