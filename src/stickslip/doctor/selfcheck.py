"""Self-check: a few numbers from every subpackage are compared with `numbers.json`.

`python -m stickslip.doctor.selfcheck` updates the stored numbers; do this only if they are meant to change. All cases
share one contact law and one dimension, so few kernels are compiled.
"""

import hashlib
import json
import platform
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..core.contacts.forces import accept, forces
from ..core.dynamics.run import run
from ..core.laws.builtin import Law, for_pair, hertz_mindlin
from ..core.progress import Outcome, Report, silent
from ..core.state import State
from ..loading.packing import disk_array, with_push
from ..loading.protocols import perturbed
from ..solve.equilibrate import relax
from ..solve.spectrum import spectrum
from ..wing import Selfcheck, wings

STORED = Path(__file__).with_name("numbers.json")
PUSHES = (0.5e-5, 1.0e-5, 1.5e-5)
BITS, PROBLEM = "dynamics, bits of positions", "problem"


class Check(NamedTuple):
    """One line of the self-check."""

    name: str
    measured: float | str
    stored: float | str
    deviation: float | None  # relative; None for bits
    tolerance: float | None
    ok: bool
    note: str


class SelfcheckResult(NamedTuple):
    """Result of the self-check."""

    checks: list[Check]
    problem: str  # errors during the measurements, or empty
    seconds: float

    @property
    def ok(self) -> bool:
        """Return True if every number is right."""
        return all(check.ok for check in self.checks)


def measure_forces(law: Law) -> dict[str, float]:
    """Contact forces of displaced disks: they involve no solver and no time step, so only round-off can differ."""
    state = disk_array(10, press=5e-5)
    _, trial = forces(state, law)
    state = accept(state, trial)
    grains = state.grains
    move, turn = np.zeros((10, 3)), np.zeros((10, 3))
    move[0], turn[0, 2] = (2e-4, -1e-3, 0.0), 3e-4
    moved = state._replace(grains=grains._replace(position=grains.position + move, angle=grains.angle + turn))
    loads, _ = forces(moved, law)
    return {"contact force, normal": loads.force[0, 1], "contact force, tangential": loads.force[0, 0]}


def pushed_array(law: Law) -> State:
    """Ten disks on a substrate, pushed until a complex pair appears (Charan et al. 2020)."""
    state, _ = relax(disk_array(10, press=5e-5), law)
    for push in PUSHES:
        state = _require_success(*relax(with_push(state, push), law))
    return state


def measure_pair(state: State, law: Law) -> dict[str, float]:
    """The fastest complex pair of the exact Jacobian."""
    modes = spectrum(state, law)
    if not len(modes.pairs):
        return {}
    first = modes.pairs[0]
    return {"Jacobian, Re λ of a pair": first.real, "Jacobian, Im λ of a pair": first.imag}


def measure_dynamics(state: State, law: Law) -> dict[str, float | str]:
    """Position of the pushed disk after a thousand steps, and the bits of all positions."""
    end, _, outcome = run(perturbed(state, seed=1, velocity=1e-4), law, 1000, 0.1)
    end = _require_success(end, outcome)
    bits = hashlib.sha256(np.ascontiguousarray(end.grains.position).tobytes()).hexdigest()[:16]
    return {"dynamics, x after 1000 steps": end.grains.position[0, 0], BITS: bits}


def measure_array(law: Law) -> dict[str, float | str]:
    """Eigenvalues and dynamics of the pushed array."""
    state = pushed_array(law)
    return measure_pair(state, law) | measure_dynamics(state, law)


def measure(report: Report = silent, *, with_wings: bool = True) -> dict[str, float | str | Selfcheck]:
    """All numbers by name, those of wings with the right values; errors are listed under `PROBLEM`."""
    law = for_pair(hertz_mindlin(kn=1.0, kt=2 / 7, mu=10.0, coulomb="smooth"), 0, 1)
    numbers: dict[str, float | str | Selfcheck] = {}
    groups: dict[str, Callable[[], dict]] = {
        "contact forces": partial(measure_forces, law),
        "ten disks: equilibria, eigenvalues, dynamics": partial(measure_array, law),
    }
    if with_wings:
        groups |= {name: wing.function(wing.selfchecks) for name, wing in wings().items() if wing.selfchecks}
    for k, (part, group) in enumerate(groups.items()):
        report("self-check", k / len(groups), part)
        try:
            numbers |= {name: float(v) if isinstance(v, np.floating) else v for name, v in group().items()}
        except Exception as problem:  # the purpose of the self-check is to detect a broken compiler or library
            said = f"{part}: {type(problem).__name__}: {' '.join(str(problem).split())[:300]}"
            numbers[PROBLEM] = "; ".join(filter(None, [numbers.get(PROBLEM), said]))
    return numbers


# relative deviations that are acceptable on any processor and with any BLAS, each with its reason
TOLERANCES = {
    "contact force": (1e-12, "round-off of one evaluation, with or without fused operations"),
    "Jacobian": (1e-6, "equilibria with a residual force of 1e-14, and LAPACK's eigenvalues"),
    "dynamics": (1e-9, "a thousand steps from such an equilibrium; nothing is chaotic yet"),
}


def compare(measured: dict, stored: dict) -> list[Check]:
    """Compare every stored number, and those of wings, with the measured one.

    Bits are also compared, but they are only guaranteed on the same type of machine and may differ on another
    processor or with another build of the core: differing bits are reported but do not count as a failure.
    """
    rows = []
    for name, right in stored["numbers"].items():
        if name == BITS:
            got = measured.get(name, "none")
            note = "the same bits" if got == right else "other bits: allowed"
            rows.append(Check(name, got, right, None, None, got != "none", note))
            continue
        tolerance, why = next(rule for start, rule in TOLERANCES.items() if name.startswith(start))
        rows.append(_compare(name, Selfcheck(measured.get(name, float("nan")), right, tolerance, why)))
    return rows + [_compare(name, value) for name, value in measured.items() if isinstance(value, Selfcheck)]


def _compare(name: str, number: Selfcheck) -> Check:
    deviation = abs(number.measured - number.stored) / abs(number.stored)
    is_right = bool(deviation <= number.tolerance)
    return Check(name, number.measured, number.stored, deviation, number.tolerance, is_right, number.why)


def selfcheck(report: Report = silent) -> SelfcheckResult:
    """Measure all numbers and compare them with the stored ones."""
    start = time.perf_counter()
    measured = measure(report)
    checks = compare(measured, json.loads(STORED.read_text(encoding="utf-8")))
    return SelfcheckResult(checks, measured.get(PROBLEM, ""), time.perf_counter() - start)


def write() -> None:
    """Store the numbers measured on this machine."""
    with_what = {name: version(name) for name in ("numpy", "scipy")}
    with_what |= {"python": platform.python_version(), "machine": platform.machine()}
    made = {"made_by": "python -m stickslip.doctor.selfcheck", "with": with_what, "numbers": measure(with_wings=False)}
    if PROBLEM in made["numbers"]:
        raise RuntimeError(made["numbers"][PROBLEM])
    STORED.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _require_success(end: State, outcome: Outcome) -> State:
    if not outcome.ok:
        raise RuntimeError(f"the self-check could not finish: {outcome}")
    return end


if __name__ == "__main__":
    write()
