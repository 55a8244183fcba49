"""Sharp friction at the Coulomb limit: verdicts against runs from tiny velocities."""

import json
from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.loading.protocols import ramp
from stickslip.loading.quasistatic import aqs
from stickslip.solve.stability import MIXED
from tests.conftest import stickslip_here as run


@cache
def sheared(seed, dim, kt, mu, damping=0.0):
    law = ss.laws.hertz_mindlin(1.0, kt, mu, coulomb="sharp", damping_n=damping)
    state, _ = ss.packings.jammed(12, packing_fraction=0.9 if dim == 2 else 0.7, dim=dim, seed=seed)
    return ramp(state, np.arange(6) * 2e-3, aqs(law))[-1].state, law


def growth(state, law, rate, e_foldings=25):
    """By how much displacements exceed 1e-11 after some e-folding times."""
    dim, n = state.cell.dim, len(state.grains.radius)
    velocity = 1e-11 * np.random.default_rng(1).normal(size=(n, 3)) * [1, 1, dim == 3]
    start = state._replace(grains=state.grains._replace(velocity=velocity - velocity.mean(axis=0)))
    dt = 0.1 * ss.measure.stable_time_step(state, law)
    end, _, _ = ss.run(start, law, int(e_foldings / rate / dt), dt)
    return np.abs(end.grains.position - state.grains.position).max() / 1e-11


def test_what_grows_only_if_contacts_slide_on_is_not_decided():
    state, law = sheared(0, 2, 1.2, 0.1)
    result = ss.stability(state, law)
    assert result.balanced and result.stable is None and result.at_limit == 4
    assert result.grows and not result.if_stuck.grows and result.if_stuck.stable
    assert result.verdict.startswith("not decided: if the 4 contacts at the Coulomb limit stick")
    assert "stable; if all of them keep sliding: oscillatory instability" in result.verdict
    assert "mixed cases were not considered" in result.scope
    assert growth(state, law, result.growth_rate[0]) < 100


def test_what_grows_while_contacts_stick_is_unstable():
    state, law = sheared(2, 3, 0.3, 0.3)
    result = ss.stability(state, law)
    assert result.at_limit == 2
    assert result.stable is False
    assert result.verdict.startswith("if the 2 contacts at the Coulomb limit stick")
    assert growth(state, law, result.if_stuck.growth_rate[0], 15) > 1000


def test_with_dashpots_both_are_reported_too():
    state, law = sheared(0, 2, 1.2, 0.1, damping=1e-4)
    result = ss.stability(state, law)
    assert result.stable is None and result.undamped.stable is None
    assert (
        result.if_stuck.stable
        and result.verdict.startswith("not decided: ")
        and "mixed cases were not considered" in result.scope
    )


@pytest.mark.parametrize("method", ["dense", "pairs", "fastest"])
@pytest.mark.parametrize("damping", [0.0, 1e-4])
def test_the_scope_always_says_that_mixtures_were_not_considered(method, damping):
    """Also of the analysis without dashpots; not of a state without contacts at the limit."""
    state, law = sheared(2, 3, 0.3, 0.3)
    if damping:
        law = ss.laws.hertz_mindlin(1.0, 0.3, 0.3, coulomb="sharp", damping_n=damping)
    result = ss.stability(state, law, method=method)
    assert result.at_limit == 2 and MIXED in result.scope
    assert result.undamped is None if not damping else result.undamped.at_limit == 2 and MIXED in result.undamped.scope
    calm, _ = ss.packings.jammed(12, packing_fraction=0.7, dim=3, seed=2)
    assert MIXED not in ss.stability(ss.equilibrate(calm, law)[0], law).scope


def test_smooth_friction_has_one_stiffness_at_the_limit():
    law = ss.laws.hertz_mindlin(1.0, 1.2, 0.1, coulomb="smooth")
    state, _ = ss.packings.jammed(12, packing_fraction=0.9, dim=2, seed=0)
    result = ss.stability(ramp(state, np.arange(6) * 2e-3, aqs(law))[-1].state, law)
    assert (result.at_limit, result.if_stuck) == (0, None)
    assert result.stable is not None


def test_the_command_line_gives_no_verdict_and_says_why(tmp_path):
    state, law = sheared(0, 2, 1.2, 0.1)
    ss.io.write_packing(tmp_path / "p.npz", state, law)
    done = run("stability", tmp_path / "p.npz", "--json", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    answer = json.loads(done.stdout)
    assert answer["balanced"] is True and answer["stable"] is None and answer["causes"] == []
    assert (answer["at_limit"], answer["if_stuck"]) == (4, "stable")
    done = run("stability", tmp_path / "p.npz", cwd=tmp_path)
    assert done.returncode == 3
    assert "not decided" in " ".join(done.stdout.split())
