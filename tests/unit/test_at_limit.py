"""Sharp friction at the Coulomb limit: verdicts against runs from tiny velocities."""

import json

import numpy as np
import pytest

import stickslip as ss
from stickslip.loading.protocols import ramp
from stickslip.loading.quasistatic import aqs
from stickslip.solve.stability import MIXED
from tests.conftest import stickslip_here as run


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
    found = ss.stability(state, law)
    assert found.balanced and found.stable is None and found.at_limit == 4
    assert found.grows and not found.if_stuck.grows and found.if_stuck.stable
    assert found.verdict.startswith("not decided: if the 4 contacts at the Coulomb limit stick")
    assert "stable; if all of them keep sliding: oscillatory instability" in found.verdict
    assert "mixed cases were not considered" in found.scope
    assert growth(state, law, found.growth_rate[0]) < 100


def test_what_grows_while_contacts_stick_is_unstable():
    state, law = sheared(2, 3, 0.3, 0.3)
    found = ss.stability(state, law)
    assert found.at_limit == 2
    assert found.stable is False
    assert found.verdict.startswith("if the 2 contacts at the Coulomb limit stick")
    assert growth(state, law, found.if_stuck.growth_rate[0], 15) > 1000


def test_with_dashpots_both_are_told_too():
    state, law = sheared(0, 2, 1.2, 0.1, damping=1e-4)
    found = ss.stability(state, law)
    assert found.stable is None and found.undamped.stable is None
    assert (
        found.if_stuck.stable
        and found.verdict.startswith("not decided: ")
        and "mixed cases were not considered" in found.scope
    )


@pytest.mark.parametrize("method", ["dense", "pairs", "fastest"])
@pytest.mark.parametrize("damping", [0.0, 1e-4])
def test_the_scope_always_says_that_mixtures_were_not_considered(method, damping):
    """Also of the analysis without dashpots; not of a state without contacts at the limit."""
    state, law = sheared(2, 3, 0.3, 0.3)
    if damping:
        law = ss.laws.hertz_mindlin(1.0, 0.3, 0.3, coulomb="sharp", damping_n=damping)
    found = ss.stability(state, law, method=method)
    assert found.at_limit == 2 and MIXED in found.scope
    assert found.undamped is None if not damping else found.undamped.at_limit == 2 and MIXED in found.undamped.scope
    calm, _ = ss.packings.jammed(12, packing_fraction=0.7, dim=3, seed=2)
    assert MIXED not in ss.stability(ss.equilibrate(calm, law)[0], law).scope


def test_smooth_friction_has_one_stiffness_at_the_limit():
    law = ss.laws.hertz_mindlin(1.0, 1.2, 0.1, coulomb="smooth")
    state, _ = ss.packings.jammed(12, packing_fraction=0.9, dim=2, seed=0)
    found = ss.stability(ramp(state, np.arange(6) * 2e-3, aqs(law))[-1].state, law)
    assert (found.at_limit, found.if_stuck) == (0, None)
    assert found.stable is not None


def test_the_command_line_gives_no_verdict_and_says_why(tmp_path):
    state, law = sheared(0, 2, 1.2, 0.1)
    ss.io.write_packing(tmp_path / "p.npz", state, law)
    done = run("stability", tmp_path / "p.npz", "--json", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    found = json.loads(done.stdout)
    assert found["balanced"] is True and found["stable"] is None and found["causes"] == []
    assert (found["at_limit"], found["if_stuck"]) == (4, "stable")
    done = run("stability", tmp_path / "p.npz", cwd=tmp_path)
    assert done.returncode == 3
    assert "not decided" in " ".join(done.stdout.split())
