"""Self-check: a few numbers from every subpackage are compared with `numbers.json`.

`python -m stickslip.doctor.selfcheck` updates the stored numbers; do this only if they are meant to change. All cases
share one contact law and one dimension, so that few kernels are compiled.
"""

import hashlib
import json
import platform
import time
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..core.contacts.forces import accept, forces
from ..core.contacts.neighbors import with_neighbor_list
from ..core.dynamics.run import run
from ..core.laws.builtin import Law, for_pair, hertz_mindlin, linear
from ..core.outcome import Outcome
from ..core.progress import Report, silent
from ..core.state import SLIDE, STICK, State
from ..loading.packing import disk_array, with_push
from ..loading.protocols import perturbed
from ..solve.relax import relax
from ..solve.spectrum import spectrum
from ..wings.faults.friction.loads import slide_hold_slide
from ..wings.faults.friction.ratestate import RateState, Spring, spring_slider
from ..wings.status.apex_status import contact_status
from ..wings.status.matrices import linear_system

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


class Selfcheck(NamedTuple):
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


def measure_slider() -> dict[str, float]:
    """Friction right after a hold, from the slip law with the parameters of Ferdowsi & Rubin 2021."""
    surface = RateState(a=0.0247, b=0.0178, dc=5.3e-3, mu0=0.4, v0=0.02, law="slip")
    legs = slide_hold_slide([1.0], velocity=0.02, distance=0.05)
    history = spring_slider(surface, Spring(200.0), legs, times=np.linspace(0, 5, 51))
    return {"rate and state, after a hold": float(history.friction.min())}


def measure_contact_status() -> dict[str, float]:
    """Status of four critical contacts in a row of disks, given their slip (McNamara & Herrmann 2006)."""
    law = for_pair(linear(kn=1.0, kt=0.5, mu=0.5), 0, 1)
    state = disk_array(5, press=1e-3, gap=-1e-3)
    lifted = state.grains.position - [0, 1e-3, 0]
    state = with_neighbor_list(state._replace(grains=state.grains._replace(position=lifted)))
    contacts, near = state.contacts, state.contacts.count[0]
    mode, slip = np.zeros_like(contacts.mode), np.zeros_like(contacts.slip)
    mode[:near] = STICK
    critical = np.flatnonzero((contacts.j[:near] >= 5) & (contacts.i[:near] < 4))  # on the floor, the last disk's not
    mode[critical], slip[critical, 0] = SLIDE, 1e-3
    matrix = linear_system(state._replace(contacts=contacts._replace(mode=mode, slip=slip)), law)
    load = np.zeros(matrix.c.shape[0])
    load[0], load[9] = 0.3, -0.4  # along x on the first disk and on the fourth
    choice = contact_status(matrix, load)
    return {
        "quasi-rigid, number sliding": float(choice.sliding.sum()) if choice.ok else -1.0,
        "quasi-rigid, slip rate": float(np.abs(choice.rate).max()),
    }


def measure_array(law: Law) -> dict[str, float | str]:
    """Eigenvalues and dynamics of the pushed array."""
    state = pushed_array(law)
    return measure_pair(state, law) | measure_dynamics(state, law)


def measure(report: Report = silent) -> dict[str, float | str]:
    """All numbers by name; errors are listed under `PROBLEM`."""
    law, numbers = for_pair(hertz_mindlin(kn=1.0, kt=2 / 7, mu=10.0, coulomb="smooth"), 0, 1), {}
    groups = {
        "contact forces": partial(measure_forces, law),
        "ten disks: equilibria, eigenvalues, dynamics": partial(measure_array, law),
        "rate and state": measure_slider,
        "quasi-rigid": measure_contact_status,
    }
    for k, (part, group) in enumerate(groups.items()):
        report("self-check", k / len(groups), part)
        try:
            numbers |= {name: value if isinstance(value, str) else float(value) for name, value in group().items()}
        except Exception as problem:  # a broken compiler or library is what the self-check looks for
            said = f"{part}: {type(problem).__name__}: {' '.join(str(problem).split())[:300]}"
            numbers[PROBLEM] = "; ".join(filter(None, [numbers.get(PROBLEM), said]))
    return numbers


# relative deviations that are acceptable on any processor and with any BLAS, each with its reason
TOLERANCES = {
    "contact force": (1e-12, "round-off of one evaluation, with or without fused operations"),
    "Jacobian": (1e-6, "equilibria with a residual force of 1e-14, and LAPACK's eigenvalues"),
    "dynamics": (1e-9, "a thousand steps from such an equilibrium; nothing is chaotic yet"),
    "rate": (1e-6, "tolerance of the integrator"),
    "quasi-rigid": (1e-9, "one sparse or dense solve"),
}


def compare(measured: dict, stored: dict) -> list[Check]:
    """Compare every stored number with the measured one.

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
        got = measured.get(name, float("nan"))
        tolerance, why = next(rule for start, rule in TOLERANCES.items() if name.startswith(start))
        deviation = abs(got - right) / abs(right)
        rows.append(Check(name, got, right, deviation, tolerance, bool(deviation <= tolerance), why))
    return rows


def selfcheck(report: Report = silent) -> Selfcheck:
    """Measure all numbers and compare them with the stored ones."""
    start = time.perf_counter()
    measured = measure(report)
    checks = compare(measured, json.loads(STORED.read_text(encoding="utf-8")))
    return Selfcheck(checks, measured.get(PROBLEM, ""), time.perf_counter() - start)


def write() -> None:
    """Store the numbers measured on this machine."""
    with_what = {name: version(name) for name in ("numpy", "scipy")}
    with_what |= {"python": platform.python_version(), "machine": platform.machine()}
    made = {"made_by": "python -m stickslip.doctor.selfcheck", "with": with_what, "numbers": measure()}
    if PROBLEM in made["numbers"]:
        raise RuntimeError(made["numbers"][PROBLEM])
    STORED.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _require_success(end: State, outcome: Outcome) -> State:
    if not outcome.ok:
        raise RuntimeError(f"the self-check could not finish: {outcome}")
    return end


if __name__ == "__main__":
    write()
