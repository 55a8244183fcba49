"""A triaxial test in LAMMPS, for tests: writes the sample and the stresses on its path.

LD_LIBRARY_PATH=… python -m tests.wings.soils.element_test_lammps  # with the `lammps` package
"""

import json
from pathlib import Path

import numpy as np

import stickslip as ss
from stickslip.experiments.realizations import make_law
from stickslip.solve.newton import Factorisation
from stickslip.wings.soils.element_test import simulate as element
from stickslip.wings.soils.element_test.sample import drive_of, make_sample

STORE = Path(__file__).with_suffix(".json")
SAMPLE = STORE.with_suffix(".npz")
LOADS = np.array([0.0, 1e-5, 1e-4, 3e-4])


def rig(state, engine: str) -> element.Rig:
    """Rig of a triaxial test of a sample at a rate, with dashpots of `gran/hertz/history`."""
    scenario = ss.scenario(
        experiment="element-test", engine=engine, sample={"grains": 60, "friction": 0.1},
        law={"young": 1e9, "poisson": 0.2, "damping": "viscoelastic", "damping_n": 5e9},
        path={"strain": 0.01, "integrator": "dynamic", "inertial_number": 3e-4},
    )  # fmt: skip
    law = make_law(scenario.law)
    if state is None:
        state, _ = make_sample(scenario.sample, law, 0, lambda *_: None)
        ss.io.write_packing(SAMPLE, state, law)
        state, _, _ = ss.io.read_packing(SAMPLE)
    engine, tolerance = element.find_engine(scenario), 1e-9 * 1e5 * 1e-6
    return element.Rig(scenario, law, state, drive_of(scenario.path, 3), tolerance, Factorisation(), engine)


def stresses(here: element.Rig) -> list:
    """Normal stresses at the loads."""
    states = [state for state, _, _ in element.dynamic(here, here.start, LOADS, 0)]
    return [np.diag(ss.measure.stress(state, here.law)).tolist() for state in states]


if __name__ == "__main__":
    STORE.write_text(json.dumps(stresses(rig(None, "lammps"))), encoding="utf-8")
