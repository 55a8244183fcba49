"""Committing what has not moved changes nothing: slips, modes, J, moduli and verdicts stay the same to the last bit."""

import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

import stickslip as ss
from stickslip._core import build
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.laws.builtin import SHARP, SMOOTH
from stickslip.core.state import OPEN
from stickslip.data import archive
from stickslip.solve.freedom import jacobian
from stickslip.solve.newton import newton
from tests.conftest import make_law, make_packing, stirred
from tests.laws.test_properties import LAWS, rolling, twisting

BASES = {name: make(mu=0.3, damping_n=0.1) for name, make in LAWS.items()} | {
    "walton_braun": ss.laws.walton_braun(mu=0.3, k_unload=3.0),
    "walton_braun, everything": twisting(rolling(ss.laws.walton_braun(mu=0.3, k_unload=3.0), mu_roll=0.02)),
}  # fmt: skip
EVERY = {name: ss.laws.for_pair(law, 0, 1, mu=0.2) for name, law in BASES.items()} | {
    "sharp": make_law("linear", "sharp"), "smooth": make_law("hertz_mindlin", "smooth"),
}  # fmt: skip
MEMORY = ("key", "slip", "mode", "pair", "roll", "reached", "rolling")


def accepted(state, law, memory=ss.FREE):
    return ss.accept(state, ss.forces(state, law, memory=memory)[1])


def memories(state):
    contacts = state.contacts
    rows = np.flatnonzero(contacts.mode[: contacts.count[0]] != OPEN)
    return {name: part[rows] for name in MEMORY if (part := getattr(contacts, name)) is not None}


def assert_same(state, other, names=MEMORY):
    mine, its = memories(state), memories(other)
    assert mine.keys() == its.keys()
    for name in mine.keys() & set(names):
        assert np.array_equal(mine[name], its[name]), name


def samples(law, dim):
    """Stirred, running, pushed away over many periods, and at rest."""
    rng = np.random.default_rng(2)
    state = with_neighbor_list(stirred(make_packing(dim, seed=3), law, rng, size=0.03))
    yield state
    velocity, spin = 0.02 * rng.normal(size=(2, len(state.grains.radius), 3))
    flat = [1, 1, dim == 3]
    moving = state._replace(grains=state.grains._replace(velocity=velocity * flat, spin=spin * ([0, 0, 1], 1)[dim - 2]))
    running = ss.run(moving, law, 60, 0.05)[0]
    yield running
    yield ss.run(moving, law, 60, 0.05, slip_update="rate")[0] if law.coulomb == SHARP else running
    place = state.grains.position + rng.integers(-9, 9, (len(velocity), 1)) * state.cell.vectors[0]
    away = state._replace(grains=state.grains._replace(position=place), contacts=state.contacts._replace(stale=True))
    yield ss.run(accepted(away, law), law, 5, 0.01)[0]


@pytest.mark.parametrize(
    ("name", "dim"),
    [*((name, 3) for name in EVERY), *((name, 2) for name in ("everything", "forces and arms", "sharp", "smooth"))],
)
def test_every_law_keeps_the_memory_of_what_has_not_moved(name, dim, tmp_path):
    law, slides = EVERY[name], 0
    for state in samples(law, dim):
        once = accepted(state, law)
        assert_same(state, once)
        assert_same(state, accepted(state, law, ss.HELD))
        jacobians = [jacobian(with_neighbor_list(s), law).toarray() for s in (state, once, accepted(once, law))]
        assert np.array_equal(jacobians[0], jacobians[1]) and np.array_equal(jacobians[1], jacobians[2])
        slides += int((state.contacts.mode == ss.SLIDE).sum())
    archive.write(tmp_path / "one.h5", {"state": state, "law": law})
    assert_same(state, accepted(archive.read(tmp_path / "one.h5")["state"], law))
    assert slides or law.coulomb == SMOOTH


@pytest.mark.parametrize("level", ["base", "avx2"])
def test_a_state_of_one_processor_keeps_its_memory_on_another(level, tmp_path):
    try:
        build.library(level)
    except (build.BuildError, KeyError, ValueError):
        pytest.skip(f"no core of the level {level} was built")
    cases = [(state, law) for name in ("everything", "marshall", "walton_braun") for law in (EVERY[name],)
             for dim in (2, 3) for state in samples(law, dim)]  # fmt: skip
    (tmp_path / "cases").write_bytes(pickle.dumps(cases))
    code = (
        "import pickle, sys, stickslip as ss; cases = pickle.load(open('cases', 'rb'));"
        "pickle.dump([ss.accept(s, ss.forces(s, law)[1]) for s, law in cases], open('answers', 'wb'))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=os.environ | {"STICKSLIP_LEVEL": level}, capture_output=True
    )
    assert done.returncode == 0, done.stderr
    for (state, _), answer in zip(cases, pickle.loads((tmp_path / "answers").read_bytes()), strict=True):
        assert_same(state, answer)


@pytest.fixture(scope="module", params=[2, 3])
def sheared(request):
    """A sheared packing with contacts at the limit, and its law."""
    law = ss.laws.hertz_mindlin(1.0, 0.6, 0.2, coulomb="sharp")
    state, _ = ss.packings.jammed(16, packing_fraction={2: 0.9, 3: 0.7}[request.param], dim=request.param, seed=1)
    return ss.protocols.ramp(state, [0.0, 3e-3, 6e-3], ss.protocols.aqs(law))[-1].state, law


def test_solvers_and_verdicts_take_a_balanced_state_as_it_is(sheared):
    state, law = sheared
    sliding = int((state.contacts.mode == ss.SLIDE).sum())
    assert sliding
    verdict, moduli = ss.stability(state, law), ss.modes.elastic_moduli(state, law)
    for other in (accepted(state, law), ss.equilibrate(state, law)[0], newton(state, law, tolerance=1e-12)[0],
                  accepted(ss.packings.sheared(state, 0.0), law)):  # fmt: skip
        assert_same(state, other)
        found = ss.stability(other, law)
        assert (found.verdict, found.at_limit) == (verdict.verdict, verdict.at_limit)
        assert np.array_equal(found.growth_rate, verdict.growth_rate) and np.array_equal(
            found.negative, verdict.negative
        )
        assert np.array_equal(ss.modes.elastic_moduli(other, law).tensor, moduli.tensor)
    still = ss.run(state, law, 1, 0.01)[0]
    assert_same(state, still, ("key", "mode", "reached"))
    np.testing.assert_allclose(memories(still)["slip"], memories(state)["slip"], rtol=0, atol=1e-15)


def test_another_law_is_not_kept(sheared):
    """Only the law under which memory was committed leaves it as it is."""
    state, law = sheared
    slides = memories(state)["mode"] == ss.SLIDE
    rough, slick, without = (
        accepted(state, ss.laws.hertz_mindlin(1.0, 0.6, mu, coulomb="sharp")) for mu in (0.3, 0.1, 0.0)
    )
    assert (memories(rough)["mode"] == ss.STICK).all()
    size, before = (np.linalg.norm(memories(s)["slip"], axis=1) for s in (slick, state))
    assert (memories(slick)["mode"][slides] == ss.SLIDE).all()
    np.testing.assert_allclose(size[slides], before[slides] / 2, rtol=1e-9)
    assert not memories(without)["slip"].any() and (memories(without)["mode"] == ss.SLIDE).all()
    assert (memories(accepted(without, law))["mode"] == ss.STICK).all()


def test_a_packing_made_without_friction_does_not_slide_under_a_law_with_it():
    for law, mode in ((None, ss.STICK), (ss.laws.linear(mu=0.5), ss.STICK), (ss.laws.linear(mu=0.0), ss.SLIDE)):
        state, _ = ss.packings.jammed(20, packing_fraction=0.9, dim=2, law=law)
        assert set(memories(state)["mode"].tolist()) == {mode}


def test_a_contact_at_the_limit_sticks_as_soon_as_it_moves_back():
    """However slowly: steps far below the tolerance of the limit add up."""
    law = ss.laws.linear(1.0, 0.5, 0.2, coulomb="sharp")
    state = ss.assembly(ss.disks([[0, 0, 0], [0, 0.99, 0]], 0.5), control=ss.control.fixed(ss.control.loads(2), [0, 1]))
    place = accepted(state, law)
    forth = np.array([[0, 0, 0], [0.02, 0, 0]])

    def moved(state, way):
        return accepted(state._replace(grains=state.grains._replace(position=state.grains.position + way)), law)

    place = moved(place, forth)
    assert memories(place)["mode"][0] == ss.SLIDE
    for _ in range(40):
        place = moved(place, -1e-12 * forth / 0.02)
    assert memories(place)["mode"][0] == ss.STICK
