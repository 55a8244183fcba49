"""CPU time of element tests of 1000 spheres, and of response envelopes.

    python -m benchmarks element_tests
    python -m benchmarks element_test_budget

The first command runs a drained triaxial test of the sample of `examples/triaxial.toml` to an axial strain of 10 %, and
computes the responses to 64 probes at its end, where contacts slide. The second runs one sample of the unchanged
example.
"""

import os
import time
import tomllib
import warnings
from itertools import pairwise
from pathlib import Path

import stickslip as ss
from stickslip.experiments.realizations import make_law
from stickslip.loading.compression import compression_scales
from stickslip.loading.settling import settle
from stickslip.solve.newton import Factorisation
from stickslip.wings.soils.element_test.sample import make_sample
from stickslip.wings.soils.element_test.simulate import BALANCED

from .spheres import row

EXAMPLE = Path(__file__).parents[1] / "examples/triaxial.toml"
STRAIN, DIRECTIONS = 0.1, 64
BUDGETS = {"dynamic": 300, "quasi-static": 900, "envelope": 180}  # seconds of one core


def triaxial(integrator: str, smallest: bool):
    """Result of the test of one sample, and its CPU seconds."""
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    path = {"kind": "triaxial", "strain": STRAIN, "integrator": integrator}
    if integrator == "dynamic":
        path["inertial_number"] = tables["path"]["inertial_number"]
    tables |= {"realizations": 1, "check": False, "path": path}
    if smallest:
        tables["sample"] = tables["sample"] | {"grains": 60}
        path |= {"strain": 1e-4, "step": 2e-5}
    start = time.process_time()
    return ss.simulate(ss.scenario(**tables), workers=1), time.process_time() - start


def envelope(result, case: str, directions: int) -> list[dict]:
    """CPU seconds of the response envelope of the last state, at rest, and the fraction without a response."""
    state, pressure = result.runs[0].end, result.scenario.sample.pressure
    n, tolerance = len(state.grains.radius), BALANCED * pressure * float(2 * state.grains.radius.mean()) ** 2
    scales = compression_scales(state, result.law, pressure, tolerance)
    held = state._replace(control=ss.control.loads(n))
    rest, _ = settle(held, result.law, scales, tolerance=tolerance, keep=Factorisation())
    start = time.process_time()
    answer = ss.protocols.response_envelope(rest, result.law, directions=directions)
    seconds, case = time.process_time() - start, f"envelope of {directions} directions, {case}"
    return [
        row(case, n, seconds, BUDGETS["envelope"], "budget"),
        row(f"{case}: share without equilibrium nearby", n, answer.collapsed.mean(), None, "", ""),
    ]


def rows(*, smallest: bool = False):
    """Yield all rows of the triaxial tests and envelopes."""
    warnings.simplefilter("ignore")
    os.environ["OMP_NUM_THREADS"] = "1"
    for integrator in ("quasi-static",) if smallest else ("dynamic", "quasi-static"):
        result, seconds = triaxial(integrator, smallest)
        run, case = result.runs[0], f"{integrator} triaxial test to {100 * STRAIN:g} %"
        n = len(run.end.grains.radius)
        found = [
            row(case, n, seconds, BUDGETS[integrator], "budget"),
            row(f"{case}: strain reached", n, float(run.series.load[-1]), None, "", ""),
        ]
        found += envelope(result, f"end of the {integrator} test", 4 if smallest else DIRECTIONS)
        yield from (one | {"threads": 1} for one in found)


def budget_rows(*, smallest: bool = False):
    """CPU seconds of one sample of the example, and of its compression only."""
    os.environ["OMP_NUM_THREADS"] = "1"
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8")) | {"realizations": 1, "check": False}
    if smallest:
        tables["sample"] = tables["sample"] | {"grains": 60}
        tables["path"] = tables["path"] | {"strain": 1e-4, "inertial_number": 1e-3}
    scenario = ss.scenario(**tables)
    starts = [time.process_time()]
    make_sample(scenario.sample, make_law(scenario.law), scenario.seed, lambda *_: None)
    starts.append(time.process_time())
    result = ss.simulate(scenario, workers=1)
    starts.append(time.process_time())
    n, (sample, whole) = scenario.sample.grains, (b - a for a, b in pairwise(starts))
    found = [
        row("triaxial test of the example", n, whole, BUDGETS["dynamic"], "budget"),
        row("its sample", n, sample, None, ""),
        row("its stiffness number", n, result.scenario.stiffness_number, None, "", ""),
    ]
    yield from (one | {"threads": 1} for one in found)
