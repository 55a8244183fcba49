"""Wrong arguments of public functions: one sentence that names the argument, from where the user calls."""

from typing import Annotated, Literal

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.arguments import FILLED, POSITIVE, Array, NotNegative, Numbers, Positive, checked, one_of

H = ss.laws.hertz_mindlin()


@pytest.fixture(scope="module")
def packings():
    spheres, _ = ss.packings.jammed(30, packing_fraction=0.68, seed=1)
    disks, _ = ss.packings.jammed(20, packing_fraction=0.9, dim=2, seed=1)
    return spheres, disks


def system(state):
    return ss.quasirigid.linear_system(state, H)


SWAPPED = "check the order of the arguments"
WRONG = [
    (lambda p, d: ss.stability(H, p), TypeError, f"state must be a State, .* Law: {SWAPPED}"),
    (lambda p, d: ss.stability(p, "hertz"), TypeError, "law must be a Law, got a value of type str"),
    (lambda p, d: ss.forces(p, None), TypeError, "law must be a Law, got None"),
    (lambda p, d: ss.assembly(p), TypeError, "grains must be a Grains, .*: give its .grains"),
    (lambda p, d: ss.measure.unbalanced_forces(p, ss.forces(p, H)), TypeError, "give value 0 of this tuple"),
    (lambda p, d: ss.measure.coordination(p, H), TypeError, "least must be a whole number"),
    (lambda p, d: ss.io.write_packing("x.npz", H, p), TypeError, "states must be a State or a list of Frame"),
    (lambda p, d: ss.figures.view(p), TypeError, "frames must be a list of Frame as io.frame_of makes it, got a value"),
    (lambda p, d: ss.figures.view([p]), TypeError, r"frames\[0\] must be a Frame as io.frame_of makes it, got a value"),
    (lambda p, d: ss.simulate("run.toml"), TypeError, "as scenario or read_scenario makes it, got .* str"),
    (lambda p, d: ss.run_sweep("sweep.toml"), TypeError, "a Sweep as sweep or io.read_sweep makes it, got .* str"),
    (lambda p, d: ss.quasirigid.contact_status(d, H), TypeError, "as quasirigid.linear_system makes it"),
    (lambda p, d: ss.control.between(p.control, p.control, 2), ValueError, "share must be from 0 to 1, got 2"),
    (lambda p, d: ss.measure.heights(p, p.walls), TypeError, "position must be numbers, got a value of type State"),
    (lambda p, d: ss.modes.participation_ratio(ss.spectrum(d, H), ss.freedom(d)), TypeError, "give its .modes"),
    (lambda p, d: ss.friction.steady_mean(np.ma.masked_greater(range(9), 7)), ValueError, "values has masked entries"),
    (lambda p, d: ss.packings.from_arrays(np.ma.masked_less(p.grains.position, 0), p.grains.radius, H), ValueError,
     "position has masked entries"),
    (lambda p, d: ss.modes.displaced(p, ss.freedom(p), 1j * np.ones(180)), ValueError, "step must be real numbers"),
    (lambda p, d: ss.quasirigid.quadratic_form(system(d), 1j * np.ones(60)), ValueError, "velocity must be real"),
    (lambda p, d: ss.quasirigid.contact_status(system(d), 1j * np.ones(60)), ValueError, "load must be real numbers"),
    (lambda p, d: ss.quasirigid.complementarity(system(d), 1j * np.ones(60)), ValueError, "load must be real numbers"),
    (lambda p, d: ss.quasirigid.probe_statuses(d, H, [1j * np.eye(2)]), ValueError, "stresses must be real numbers"),
    (lambda p, d: ss.control.spring_forces(p.control, 1j * p.grains.position, 0.0), ValueError, "must be real numbers"),
    (lambda p, d: ss.friction.healing([1, 10, 100], [0.1, 0.2]), ValueError, r"excess must have shape \(3,\), got"),
    (lambda p, d: ss.run(p, H, 10.5, 0.1), ValueError, "steps must be a whole number, got 10.5"),
    (lambda p, d: ss.run(p, H, np.inf, 0.1), ValueError, "steps must be a whole number, got inf"),
    (lambda p, d: ss.run(p, H, 10, np.nan), ValueError, "dt is NaN: give a number"),
    (lambda p, d: ss.run(p, H, 10, np.array([0.1, 0.2])), TypeError, "dt must be a number, .* ndarray"),
    (lambda p, d: ss.run(p, H, 10, 0.1, drag=-1), ValueError, "drag must be zero or positive, got -1"),
    (lambda p, d: ss.equilibrate(p, H, tolerance=-1), ValueError, "tolerance must be positive, got -1"),
    (lambda p, d: ss.newton(p, H, iterations=-3), ValueError, "iterations must be zero or positive, got -3"),
    (lambda p, d: ss.accept(d, ss.forces(p, H)[1]), ValueError, "memory is that of 30 bodies, but the state has 20"),
    (lambda p, d: ss.forces(d._replace(contacts=p.contacts), H), ValueError, r"contacts\.origin has shape \(30, 3\)"),
    (lambda p, d: ss.jacobian(d, H, ss.freedom(p)), ValueError, "coordinates are those of 30 bodies, but the state "
    "has 20"),
    (lambda p, d: ss.forces(p, H, memory=7), ValueError, "memory must be FREE, HELD or FROZEN"),
    (lambda p, d: ss.modes.dynamical_matrix(p, H, ss.freedom(d)), ValueError, r"use freedom\(state\)"),
    (lambda p, d: ss.laws.collision(H, radius=1, mass=1, speed=1, pair=(0, 1)), ValueError, "not material 1"),
    (lambda p, d: ss.laws.for_pair(H, 0, -1, mu=0.0), ValueError, "materials are numbered from 0 to .*, got -1"),
    (lambda p, d: ss.control.fixed(p.control, [-1]), ValueError, "body -1 does not exist: bodies have numbers 0 to 29"),
    (lambda p, d: ss.control.fixed(p.control, [30]), ValueError, "body 30 does not exist"),
    (lambda p, d: ss.control.fixed(p.control, "floor"), ValueError, "bodies must be whole numbers, got words"),
    (lambda p, d: ss.control.driven(p.control, [0], np.nan), ValueError, "rate contains NaN or infinity"),
    (lambda p, d: ss.packings.with_push(p, 1e-5, disk=99), ValueError, "body 99 does not exist"),
    (lambda p, d: ss.packings.without_walls(p, [0]), ValueError, "the state has 0 walls"),
    (lambda p, d: ss.packings.jammed(20, dim=4, packing_fraction=0.8), ValueError, r"2 \(disks\) or 3 .*got 4"),
    (lambda p, d: ss.packings.jammed(20, packing_fraction=5), ValueError, "packing_fraction must be at most 1.5"),
    (lambda p, d: ss.protocols.load_path([0, 1], -0.1), ValueError, "step must be positive, got -0.1"),
    (lambda p, d: ss.protocols.load_path([0, 1], 0.5, through=[7]), ValueError, "outside the turning points"),
    (lambda p, d: ss.modes.fastest_pair(p, H, rate=-1.0), ValueError, "rate must be positive, got -1.0"),
    (lambda p, d: ss.modes.damped_growth(p, H, drag=-1.0), ValueError, "drag must be zero or positive, got -1.0"),
    (lambda p, d: ss.box([np.nan, 1, 1]), ValueError, "size contains NaN or infinity"),
    (lambda p, d: ss.box([-1, 1, 1]), ValueError, "cell must be positive lengths"),
    (lambda p, d: ss.box(1), ValueError, "cell must be positive lengths"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "kind", "message"), WRONG)
def test_one_sentence_names_the_argument(packings, call, kind, message):
    with pytest.raises(kind, match=message) as caught:
        call(*packings)
    assert "\n" not in str(caught.value)


def test_arrays_of_different_lengths_are_refused(packings):
    state = packings[0]
    short = state._replace(grains=state.grains._replace(radius=state.grains.radius[:10]))
    with pytest.raises(ValueError, match=r"grains\.position has shape \(30, 3\) where \(10, 3\) is needed"):
        ss.forces(short, H)
    j = state.contacts.j.copy()
    j[0] = 10**6
    with pytest.raises(ValueError, match=r"contacts\.j\[0\] is 1000000: it must be between 0 and 29"):
        ss.run(state._replace(contacts=state.contacts._replace(j=j)), H, 1, 0.1)


def test_numbers_of_numpy_and_whole_floats_are_numbers(packings):
    state = packings[0]
    for steps, dt in ((10.0, 0.1), (np.int64(10), np.float64(0.1)), (np.array(10), np.array(0.1))):
        assert ss.run(state, H, steps, dt)[2].ok


def test_numbers_of_less_precision_are_computed_with_as_doubles():
    given = np.float32(7e10), np.float32(0.3)
    assert ss.laws.elastic_constants(*given) == ss.laws.elastic_constants(*map(float, given))
    assert ss.measure.inertial_number(np.float16(0.5), 2, diameter=np.int8(100), density=np.int8(2)) == 50.0


def test_a_pair_of_a_grain_with_itself_needs_an_image():
    with pytest.raises(ss.packings.PackingError, match="pair 0 joins grain 0 with itself"):
        ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], H, pair_i=[0], pair_j=[0])


def test_bodies_may_be_a_mask_or_a_range(packings):
    control, mask = packings[0].control, np.arange(30) < 3
    for bodies in (mask, range(3), slice(3), [0, 1, 2]):
        assert ss.control.fixed(control, bodies).free.any(axis=1).sum() == 27


def test_disks_without_a_cell_lie_in_a_plane():
    assert ss.assembly(ss.disks([[0, 0.5]], 0.5)).cell.dim == 2
    assert ss.assembly(ss.spheres([[0, 0.5]], 0.5)).cell.dim == 3
    assert ss.box([5, 4], dim=2).vectors.diagonal().tolist() == [5, 4, 1]


def test_errors_inside_do_not_leave_the_door_open(packings):
    with pytest.raises(ValueError, match="memory must be FREE, HELD or FROZEN, got 7"):
        ss.forces(packings[0], H, memory=7)
    with pytest.raises(TypeError, match="law must be a Law"):
        ss.forces(packings[0], 1)


@checked
def _measure(
    size: Positive = 1.0, count: Annotated[int, POSITIVE] | None = None, drag: NotNegative | None = None,
    kind: Literal["a", "b"] = "a", dim: Annotated[int, one_of(2, 3)] = 2, rate: Annotated[Numbers, FILLED] = (1,),
    tensor: Annotated[Numbers, Array(shapes=((2, 2), (3, 3)))] | None = None,
):  # fmt: skip
    return size, count, drag, kind, dim


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"size": 0}, "size must be positive, got 0"),
        ({"size": 1e-200}, "size must be positive, from"),
        ({"size": "1"}, "size must be a number, got a value of type str"),
        ({"count": -2.0}, "count must be positive, got -2"),
        ({"count": 0.5}, "count must be a whole number, got 0.5"),
        ({"drag": -1}, "drag must be zero or positive, got -1"),
        ({"drag": "x"}, "drag must be a number or None, got a value of type str"),
        ({"kind": "c"}, "kind must be 'a' or 'b', got 'c'"),
        ({"kind": 1}, "kind must be a word"),
        ({"dim": 4}, "dim must be 2 or 3, got 4"),
        ({"rate": []}, "rate is empty: give at least one entry"),
        ({"tensor": np.eye(4)}, r"tensor must have shape \(2, 2\) or \(3, 3\), got \(4, 4\)"),
        ({"tensor": [[1, np.nan], [0, 1]]}, "tensor contains NaN or infinity"),
    ],
)
def test_annotations_state_ranges_words_and_shapes(wrong, message):
    with pytest.raises((TypeError, ValueError), match=message):
        _measure(**wrong)


def test_values_within_the_ranges_are_taken():
    assert _measure(2, 3.0, 0, "b", np.int64(3), [0.5], np.eye(3)) == (2, 3, 0, "b", 3)
    assert _measure() == (1.0, None, None, "a", 2)
