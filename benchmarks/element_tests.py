"""CPU time of element tests of 1000 spheres, and of response envelopes of their states.

    python -m benchmarks --element-tests           dynamic test and envelopes; minutes
    python -m benchmarks --element-tests --large   also the quasi-static test

A drained triaxial test of the sample of `examples/triaxial.toml` to an axial strain of 10 %, and the responses to 64
probes before the test and at its end, where contacts slide.
"""

import os
import time
import tomllib
import warnings
from pathlib import Path

import stickslip as ss

from .spheres import row

EXAMPLE = Path(__file__).parents[1] / "examples/triaxial.toml"
STRAIN, DIRECTIONS = 0.1, 64
BUDGETS = {"dynamic": 300, "quasi-static": 900, "envelope": 180}  # seconds of one core


def triaxial(integrator: str):
    """Result of the test of one sample, and its CPU seconds."""
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    path = {"kind": "triaxial", "strain": STRAIN, "integrator": integrator}
    if integrator == "dynamic":
        path["inertial_number"] = tables["path"]["inertial_number"]
    tables |= {"realizations": 1, "check": False, "path": path}
    start = time.process_time()
    return ss.simulate(ss.scenario(**tables), workers=1), time.process_time() - start


def envelope(state, law, case: str) -> list[dict]:
    """CPU seconds of the response envelope of a state, and the share of directions with an answer."""
    state, _ = ss.equilibrate(state, law, check="nothing")
    start = time.process_time()
    answer = ss.protocols.response_envelope(state, law, directions=DIRECTIONS)
    seconds = time.process_time() - start
    n, case = len(state.grains.radius), f"envelope of {DIRECTIONS} directions {case}"
    return [
        row(case, n, seconds, BUDGETS["envelope"], "budget"),
        row(f"{case}: share without equilibrium nearby", n, answer.collapsed.mean(), None, "", ""),
    ]


def rows(full: bool) -> list[dict]:
    """All rows; `full` adds the quasi-static test, which may take an hour."""
    warnings.simplefilter("ignore")
    os.environ["OMP_NUM_THREADS"] = "1"
    out = []
    for integrator in ("dynamic", "quasi-static") if full else ("dynamic",):
        result, seconds = triaxial(integrator)
        run, case = result.runs[0], f"{integrator} triaxial test to {STRAIN:.0%}"
        n = len(run.end.grains.radius)
        out += [
            row(case, n, seconds, BUDGETS[integrator], "budget"),
            row(f"{case}: strain reached", n, float(run.series.load[-1]), None, "", ""),
        ]
        if integrator == "dynamic":
            out += envelope(run.end, result.law, "at 10 % strain")
    return [r | {"threads": 1} for r in out]
