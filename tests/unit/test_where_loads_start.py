"""Loads start where the state is: from tilted and turned cells, from states in motion, and on paths that go on."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.loading.packing import _with_images

LAW = ss.laws.hertz_mindlin(1.0, 0.6, 0.3, coulomb="sharp")
DAMPED = ss.laws.hertz_mindlin(1.0, 0.6, 0.3, coulomb="sharp", damping="mass_velocity", damping_n=0.3, damping_t=0.3)


def in_other_cell(state, change):
    """The same packing in other cell vectors of its lattice."""
    count, back = int(state.contacts.count[0]), np.round(np.linalg.inv(change)).astype(np.int64)
    contacts = _with_images(state.contacts, state.contacts.image[:count] @ back)
    return state._replace(cell=state.cell._replace(vectors=change @ state.cell.vectors), contacts=contacts)


@pytest.fixture(scope="module")
def untilted():
    state, _ = ss.packings.jammed(24, pressure=1e-3, dim=2, seed=1)
    return ss.equilibrate(ss.packings.sheared(state, 2e-3), LAW)[0]


@pytest.fixture(scope="module", params=["leans by one", "turned"])
def image(request, untilted):
    turned = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    return in_other_cell(
        untilted, turned if request.param == "turned" else np.eye(3, dtype=int) + np.eye(3, 3, -1, int)
    )


def strained(state):
    return ss.protocols.ramp(state, [0.0, 1e-4, 3e-4], ss.protocols.aqs(LAW))[-1].state


def stressed(state):
    return ss.protocols.ramp(state, [0.0, 0.02], ss.protocols.cell_shear(LAW, 1e-3))[-1].state


def searched(state):
    return ss.protocols.find_events(state, LAW, to=4e-4, drag=0.2, step=2e-4).state


def driven(state):
    control = ss.control.strained_at(state.control, [[0, 1e-4], [0, 0]])
    return ss.run(state._replace(control=control), LAW, 50, 0.02)[0]


def inflated(state):
    return ss.protocols.inflate(state, LAW, 0, steps=2).states[0]


@pytest.mark.parametrize("load", [strained, stressed, searched, driven, inflated])
def test_loads_do_not_depend_on_the_cell_that_spans_the_lattice(untilted, image, load):
    mine, other = (load(state).grains.position for state in (untilted, image))
    assert np.abs(mine - untilted.grains.position).max() < 0.05  # sheared by 1, it would be several diameters
    assert np.abs(mine - other).max() < 1e-8  # tolerances of equilibria


def test_probes_do_not_depend_on_it_either(untilted, image):
    mine, other = (ss.protocols.response_envelope(state, LAW, directions=8).work for state in (untilted, image))
    np.testing.assert_allclose(other, mine, rtol=1e-4)


def test_a_path_starts_at_its_state_and_goes_on_from_it(untilted):
    tilted = ss.equilibrate(ss.packings.sheared(untilted, 0.1), LAW)[0]
    protocol = ss.protocols.aqs(LAW)
    path = ss.protocols.ramp(tilted, [0.0, 1e-4, 2e-4], protocol)
    assert np.array_equal(path[0].state.grains.position, tilted.grains.position)
    assert [point.load for point in path] == [0.0, 1e-4, 2e-4]
    gained = ss.measure.shear_strain(path[-1].state) - ss.measure.shear_strain(tilted)
    assert gained == pytest.approx(2e-4, rel=1e-9)
    # a path whose first load is the strain of the cell
    here = ss.measure.shear_strain(tilted)
    further = ss.protocols.ramp(tilted, [here, here + 1e-4], protocol)
    assert np.abs(further[-1].state.grains.position - path[1].state.grains.position).max() < 1e-9
    # one load from another point, as in a bisection
    middle = protocol.starting(path[1].state, path[1].load).step(path[1].state, 2e-4)
    assert np.abs(middle.state.grains.position - path[2].state.grains.position).max() < 1e-9


def test_what_moves_is_brought_to_rest_where_it_is(untilted):
    rng, rest = np.random.default_rng(0), ss.equilibrate(untilted, DAMPED)[0]
    velocity = 1e-3 * rng.normal(size=(24, 3)) * [1, 1, 0]
    moving = rest._replace(
        grains=rest.grains._replace(velocity=velocity), cell=rest.cell._replace(rate=np.diag([1e-4, 2e-4, 0]))
    )
    end, outcome = ss.equilibrate(moving, DAMPED)
    assert outcome.ok and not outcome.fallback and not end.cell.rate.any()
    assert np.array_equal(end.grains.position, rest.grains.position)
    mine, other = (ss.protocols.ramp(state, [0.0, 1e-4], ss.protocols.aqs(DAMPED))[-1] for state in (moving, rest))
    assert np.array_equal(mine.state.grains.position, other.state.grains.position)
