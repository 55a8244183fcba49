"""Piles of spheres of rigid-contact codes: positions without overlaps, and contact forces as vectors."""

import numpy as np
import pytest

import stickslip as ss
from benchmarks.measured_forces import LAW as LAW_OF_DISKS
from benchmarks.measured_forces import cut, measured, sheared
from stickslip.core.contacts.jacobian import linearise
from stickslip.loading.measured import _network

LAW = ss.laws.hertz_mindlin(1e4, 3e3, 0.5)  # overlaps of 0.001 under the weight of the spheres


@pytest.fixture(scope="module")
def pile():
    """Pyramid of 14 spheres at rest under gravity, the lowest held, and the weights."""
    rng = np.random.default_rng(2)
    place = [[a + m / 2, b + m / 2, m / np.sqrt(2)] for m in range(3) for a in range(3 - m) for b in range(3 - m)]
    place, radius = np.array(place), 0.5 * (1 - 0.01 * rng.uniform(size=14))
    weight = -4 / 3 * np.pi * radius[:, None] ** 3 * [0, 0, 1]
    state = ss.packings.from_arrays(0.998 * place, radius, LAW, density=1.0, external_force=weight)
    state = state._replace(control=ss.control.fixed(state.control, np.flatnonzero(place[:, 2] == 0)))
    state, _ = ss.relax(state, LAW, drag=5.0, steps=2000)
    state, outcome = ss.equilibrate(state, LAW, tolerance=1e-12)
    assert outcome.ok
    return state, weight


def forces_of(state, law=LAW):
    """Force on the first grain of each contact, by the pair of grains."""
    rows = ss.measure.touching(state)
    ends = zip(state.contacts.i[rows].tolist(), state.contacts.j[rows].tolist(), strict=True)
    return dict(zip(ends, linearise(state, law).force[rows], strict=True))


def tables(folder, state, weight, *, noise=0.0, split=False, pairs=slice(None)):
    """Tables of a rigid-contact code, numbers from 1: grains; forces on the first grain, the floor as −1."""
    place = state.grains.position + noise * np.random.default_rng(1).normal(size=state.grains.position.shape)
    known = forces_of(state)
    ends, force = np.array(list(known))[pairs], np.array(list(known.values()))[pairs]
    floor = [[k + 1, -1, *[0.0] * 6, 1.0] for k in np.flatnonzero(~state.control.free[:14, 2])]
    normal = place[ends[:, 0]] - place[ends[:, 1]]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = np.einsum("ck,ck->c", force, normal)
    rows = np.column_stack([ends + 1, force, force - along[:, None] * normal, along])
    rows, head = np.vstack([rows, floor]), "i j fx fy fz tx ty tz fn"
    keep = [0, 1, *([5, 6, 7, 8] if split else [2, 3, 4])]
    grains = np.column_stack([np.arange(14) + 1, place, state.grains.radius, weight[:, 2]])
    np.savetxt(folder / "grains.csv", grains, header="id x y z radius load_z", comments="")
    np.savetxt(folder / "forces.csv", rows[:, keep], header=" ".join(np.array(head.split())[keep]), comments="")
    return folder / "grains.csv", folder / "forces.csv"


@pytest.mark.parametrize("split", [False, True], ids=["whole force", "normal and tangential"])
def test_vectors_may_be_listed_from_both_grains(pile, tmp_path, split):
    grains, forces = tables(tmp_path, *pile, split=split)
    once = ss.io.read_forces(grains, forces)
    head, *rows = forces.read_text().splitlines()
    words = [row.split() for row in rows]
    signs = np.array([1, 1, -1, -1, -1, 1] if split else [1, 1, -1, -1, -1])
    others = [np.array([b, a, *rest], float) * signs for a, b, *rest in words if float(b) > 0]
    forces.write_text("\n".join([head, *rows, *(" ".join(map(repr, row.tolist())) for row in others)]) + "\n")
    both = ss.io.read_forces(grains, forces)
    for name in ("ends", "force_n", "force_t"):
        np.testing.assert_allclose(getattr(both, name), getattr(once, name), atol=1e-12, err_msg=name)


@pytest.mark.parametrize("split", [False, True], ids=["whole force", "normal and tangential"])
def test_a_pile_is_found_again_from_its_forces(pile, tmp_path, split):
    state, weight = pile
    grains, forces = tables(tmp_path, state, weight, split=split)
    out, law, notes = ss.io.read_packing(
        grains, contacts=forces, law="hertz_mindlin", coulomb="sharp", kn=1e4, kt=3e3, mu=0.5
    )
    assert any("with walls, which have negative numbers" in note and "held: 9 of" in note for note in notes)
    before, after = forces_of(state), forces_of(out, law)
    assert before.keys() == {pair if pair in before else pair[::-1] for pair in after}
    for (i, j), force in after.items():
        np.testing.assert_allclose(force, before[i, j] if (i, j) in before else -before[j, i], atol=1e-9)
    found, wanted = ss.stability(out, law), ss.stability(state, LAW)
    assert found.motion == wanted.motion and found.residual < 1e-8
    here, there = (ss.modes.equations_of_motion(s, LAW).jacobian for s in (out, state))
    assert abs(here - there).max() < 1e-7 * abs(there).max()


def test_errors_of_positions_change_neither_balance_nor_verdict(pile, tmp_path):
    state, weight = pile
    m = ss.io.read_forces(*tables(tmp_path, state, weight, noise=5e-4))
    out, change = ss.packings.from_forces(m, LAW)
    assert change.position_error == pytest.approx(5e-4, rel=0.5)
    found, wanted = ss.stability(out, LAW), ss.stability(state, LAW)
    assert found.residual < 1e-8 and found.grows == wanted.grows


def test_tangential_forces_beyond_the_cone_are_brought_onto_it(pile):
    """Measured under more friction: each force ends within the cone, some on it, and all are balanced."""
    state, weight = pile
    known = forces_of(state)
    ends, force = np.array(list(known)).T, np.array(list(known.values()))
    normal = state.grains.position[ends[0]] - state.grains.position[ends[1]]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = np.einsum("ck,ck->c", force, normal)
    across = force - along[:, None] * normal
    mu = 0.7 * (np.linalg.norm(across, axis=1) / along).max()
    m = ss.io.measured_forces(
        state.grains.position, state.grains.radius, *ends, along, force, load=weight,
        held=np.flatnonzero(~state.control.free[:14, 2]), position_error=1e-3, force_n_error=0.1, force_t_error=0.1,
    )  # fmt: skip
    np.testing.assert_allclose(m.force_t, across, atol=1e-12)  # the part along the normal is left out
    law = ss.laws.hertz_mindlin(1e4, 3e3, mu)
    out, change = ss.packings.from_forces(m, law)
    line, rows = linearise(out, law), ss.measure.touching(out)
    assert change.at_limit > 0 and (line.mobilisation[rows] <= 1 + 1e-9).all()
    assert ss.stability(out, law).residual < 1e-6


@pytest.mark.parametrize("dim", [2, 3])
def test_linearised_equations_have_the_slopes_of_finite_differences(pile, tmp_path, dim):
    if dim == 3:
        network = _network(ss.io.read_forces(*tables(tmp_path, *pile, noise=1e-3)), LAW)
    else:
        network = _network(measured(*cut(sheared(9, 0.87, 3e-3, seed=3)), move=1e-2, push=0.05), LAW_OF_DISKS)
    rng = np.random.default_rng(0)
    at, step = rng.normal(size=network.start.size), rng.normal(size=network.start.size)
    at[network.measured.position.size :] *= 0.1  # so that no force reaches its least value

    def values(z):
        a, b, *_ = network.linearise(z)
        return a @ z - b

    slope, h = network.linearise(at)[0] @ step, 1e-4
    np.testing.assert_allclose((values(at + h * step) - values(at - h * step)) / (2 * h), slope, rtol=2e-5, atol=2e-5)


def test_sizes_of_tangential_forces_are_too_little_between_spheres(pile, tmp_path):
    grains, forces = tables(tmp_path, *pile)
    forces.write_text("i,j,fn,ft\n1,2,0.1,0.0\n")
    with pytest.raises(ValueError, match="no force directions between spheres"):
        ss.io.read_forces(grains, forces)
    forces.write_text("i,j,fx,fy\n1,2,0.1,0.0\n")
    with pytest.raises(ValueError, match="give the force on grain i, fx fy fz"):
        ss.io.read_forces(grains, forces)
