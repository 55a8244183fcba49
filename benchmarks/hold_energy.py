"""Energy balance of vibrations in holds of fault gouge for two tangential laws, and several dampings and time steps.

    python -m benchmarks hold_energy                # 16 ledgers of 10 ms (about a quarter of an hour on two cores)
    python -m benchmarks hold_energy_steps          # holds of 20 ms with time steps from 5e-8 to 4e-7 s
    python -m benchmarks hold_energy_lammps         # holds of 0.1 s of one scenario with stickslip and with LAMMPS

One sample of 300 mobile grains slides at 0.03 m/s with γ_n = 1e4 1/(m s) and the plain tangential law. Holds start from
several of its states, with the law, damping and time step of each row. Energies are means over these states, in units
of the elastic energy of the contacts at the start of the hold.
"""

from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import stickslip as ss
from stickslip.core.dynamics.run import own_engine
from stickslip.core.measure import elastic_energy
from stickslip.ensemble import run_members
from stickslip.wings.papers.gouge import measures
from stickslip.wings.papers.gouge.protocol import load_point_lead, run_trunk
from stickslip.wings.papers.gouge.sample import attach_spring, gouge_law, stiffness
from stickslip.wings.papers.gouge.scenario import GougeScenario
from stickslip.wings.papers.gouge.simulate import simulate_gouge

VELOCITY, HOLD, STATES = 0.03, 0.01, 2
DAMPINGS = (0.0, 1e4, 6.2e5, 6e7)
STEPS = (4e-7, 2e-7, 5e-8)
LAWS = {"plain": "hertz_mindlin_reff", "rescaled": "hertz_mindlin_reff_rescaled"}
SMALLEST = {"grains": {"number": 40}, "cell": {"length": 0.017}, "preparation": {"slip": 0.01}}
COLUMNS = ("kinetic", "normal", "tangential", "external", "coulomb", "viscous", "nonpotential", "defect")


def base(**more) -> GougeScenario:
    """Scenario with holds from `STATES` states of one sample."""
    hold = {"kind": "slide-hold-slide", "before": [VELOCITY], "holds": [HOLD], "after": [], "approach": 1.5}
    tables = {
        "experiment": "gouge", "dt": 4e-7, "sample_every": 250, "grains": {"number": 300}, "cell": {"length": 0.024},
        "law": {"damping_n": 1e4}, "preparation": {"slip": 4.0}, "protocol": [hold | {"branches": STATES}],
    }  # fmt: skip
    return ss.scenario(**tables | more)


def run_hold(place, law_table: dict, dt: float, seconds: float, ledger: bool):
    """Change of friction in a hold, and the ledger in units of the initial elastic energy."""
    scenario = base(law=law_table)
    law = gouge_law(scenario, scenario.law.mu)
    stored, begin, ahead = elastic_energy(place.state, place.law), place.state.time, load_point_lead(place)
    here = attach_spring(place, stiffness(scenario) * scenario.area, [begin, begin + seconds], [ahead, ahead])
    steps = round(seconds / dt)
    every = max(1, round(1e-4 / dt))
    _, record, outcome = ss.run(here.state, law, steps, dt, every=every, ledger=ledger, threads=1)
    if not outcome.ok:
        raise RuntimeError(str(outcome))
    friction = record.group_pull[:, 1, 0] / (place.normal_stress * place.area)
    late = record.time > record.time[-1] - 0.1 * seconds
    kinetic = record.kinetic_energy[late].mean() / stored
    books = {}
    if ledger:
        whole = record.ledger._asdict() | {"defect": record.ledger.defect}
        books = {name: float(whole[name][-1] - whole[name][0]) / stored for name in COLUMNS}
    return float(friction[late].mean() - friction[0]), float(kinetic), books


def places(scenario: GougeScenario):
    """States of the trunk from which holds start."""
    return [one.place for one in run_trunk(scenario, scenario.seed, own_engine(1), lambda *_: None).branches]


def holds(cases, starts, *, seconds: float, ledger: bool):
    """Yield one line per (name of a law, γ_n, dt)."""
    cases = list(cases)
    tasks = [
        (place, {"damping_n": gamma, "kind": LAWS[name]}, dt, seconds, ledger)
        for name, gamma, dt in cases
        for place in starts
    ]
    members = run_members(run_hold, tasks)
    words = [f"{name:>12}" for name in COLUMNS] if ledger else []
    yield "  ".join(["history   gamma_n       dt   friction  kin./elast.", *words])
    for k, (name, gamma, dt) in enumerate(cases):
        mine = members[k * len(starts) : (k + 1) * len(starts)]
        if failure := next((m.failure for m in mine if m.failure), None):
            yield f"{name:8}  {gamma:7.1e}  {dt:7.0e}  {failure}"
            continue
        found = [m.result for m in mine]
        change, kinetic = np.mean([f[0] for f in found]), np.mean([f[1] for f in found])
        books = [f"{np.mean([f[2][name] for f in found]):12.2e}" for name in COLUMNS] if ledger else []
        head = f"{name:8}  {gamma:7.1e}  {dt:7.0e}  {change:9.4f}  {kinetic:11.2e}"
        yield "  ".join([head, *books])


def rows(*, smallest: bool = False):
    """Yield the energy ledgers."""
    if smallest:
        yield from holds([("plain", 1e4, STEPS[0])], places(base(**SMALLEST))[:1], seconds=1e-4, ledger=True)
    else:
        yield from holds(product(LAWS, DAMPINGS, (STEPS[0], STEPS[-1])), places(base()), seconds=HOLD, ledger=True)


def rows_of_steps(*, smallest: bool = False):
    """Yield the holds with several time steps."""
    if smallest:
        yield from holds([("plain", 6e7, STEPS[1])], places(base(**SMALLEST))[:1], seconds=1e-4, ledger=False)
    else:
        yield from holds(product(("plain",), (1e4, 6e7), STEPS), places(base()), seconds=2 * HOLD, ledger=False)


def rows_of_engines(*, smallest: bool = False):
    """Compare relaxation in 0.1 s between engines, for both tangential laws; each engine slides its own samples."""
    holds, engines = ((1e-4, 1e-3), ("stickslip",)) if smallest else ((1e-2, 1e-1), ("stickslip", "lammps"))
    protocol = [base().protocol[0].model_dump() | {"holds": holds, "branches": 3}]
    for name, gamma in product(LAWS, (1e4, 6e7)):
        for engine in engines:
            law = {"damping_n": gamma, "kind": LAWS[name]}
            scenario = base(**SMALLEST if smallest else {}, engine=engine, protocol=protocol, law=law)
            scenario = scenario.model_copy(update={"realizations": 2})
            with TemporaryDirectory() as folder:
                result = simulate_gouge(scenario, folder=Path(folder))
            curve = measures.hold_curve(result, VELOCITY)
            words = ", ".join(f"{curve.at(t).value:.4f} ± {curve.at(t).half:.4f} at {t:g} s" for t in holds)
            yield f"{name:8}  {gamma:7.1e}  {engine:9}  {words}"
