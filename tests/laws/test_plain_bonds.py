"""Bonds written plainly (`bonds`) against LAMMPS (`bonds_lammps`) and against closed forms of chains."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.laws import bonds, bonds_lammps

THEIRS = np.load(bonds_lammps.STORE)
CASES = bonds_lammps.CASES


def of(name, key):
    return THEIRS[f"{name}/{key}"]


def loads_at(case, state, pairs, reference):
    """Loads of bonds between spheres in a state, by the plain law."""
    i, j = pairs.T
    place, velocity, spin = state[:, :3], state[:, 3:6], state[:, 6:9]
    pair = bonds_lammps.shortest(place[i] - place[j], case)
    if case.law == "spring":
        rest = np.linalg.norm(reference, axis=1)
        return bonds.spring(pair, velocity[i] - velocity[j], rest, **case.options)
    turned = [Rotation.from_quat(state[k, 9:], scalar_first=True) for k in (i, j)]
    return bonds.rotational(pair, velocity[[i, j]], spin[[i, j]], turned, reference, **case.options)


def summed(n, pairs, on_i, on_j):
    """Loads of spheres from loads of bonds."""
    total = np.zeros((n, 3))
    np.add.at(total, pairs[:, 0], on_i)
    np.add.at(total, pairs[:, 1], on_j)
    return total


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if not case.motion])
def test_loads_are_those_of_lammps(name):
    pairs, state = of(name, "bonds"), of(name, "start")
    ours = loads_at(CASES[name], state, pairs, of(name, "reference"))
    for key, *both in (("force", ours.force_i, ours.force_j), ("torque", ours.torque_i, ours.torque_j)):
        theirs = of(name, key)
        size = max(np.abs(of(name, "force")).max(), np.abs(theirs).max())
        np.testing.assert_allclose(summed(len(state), pairs, *both), theirs, rtol=0, atol=1e-12 * size)
    np.testing.assert_array_equal(ours.share < 1, of(name, "kept"))


def turned_by(quaternion, spin, dt):
    """Quaternions after a step of LAMMPS: two half steps, extrapolated with one whole step."""

    def half_turned(start, by, time):
        w, v = start[:, :1], start[:, 1:]
        rate = np.hstack([-np.sum(by * v, axis=1, keepdims=True), w * by + np.cross(by, v)]) / 2
        return rate * time

    def unit(q):
        return q / np.linalg.norm(q, axis=1, keepdims=True)

    whole = unit(quaternion + half_turned(quaternion, spin, dt))
    middle = unit(quaternion + half_turned(quaternion, spin, dt / 2))
    return unit(2 * unit(middle + half_turned(middle, spin, dt / 2)) - whole)


def moved(name, steps):
    """States at some steps, and steps at which bonds broke, of velocity Verlet with the plain law."""
    case, pairs, reference, dt = CASES[name], of(name, "bonds"), of(name, "reference"), bonds_lammps.STEP
    state, mass, radius = of(name, "start").copy(), of(name, "mass")[:, None], of(name, "radius")[:, None]
    inertia = (0.5 if case.dim == 2 else 0.4) * mass * radius**2
    broken, found = np.full(len(pairs), -1), []

    def accelerations(step):
        kept = broken < 0
        loads = loads_at(case, state, pairs[kept], reference[kept])
        if step > 0:
            broken[np.flatnonzero(kept)[loads.share >= 1]] = step
        force = summed(len(state), pairs[kept], loads.force_i, loads.force_j)
        torque = summed(len(state), pairs[kept], loads.torque_i, loads.torque_j)
        return np.hstack([force / mass, torque / inertia])

    rates = accelerations(0)
    for step in range(max(steps) + 1):
        if step > 0:
            state[:, 3:9] += dt / 2 * rates
            state[:, :3] += dt * state[:, 3:6]
            if case.law == "rotational":
                state[:, 9:] = turned_by(state[:, 9:], state[:, 6:9], dt)
            rates = accelerations(step)
            state[:, 3:9] += dt / 2 * rates
        if step in steps:
            found.append(state.copy())
    return np.array(found), broken


# LAMMPS finds angles by acos, whose rounding, 1e-8 at angles near zero, is all that the first steps differ by.
@pytest.mark.parametrize(
    ("name", "steps", "tolerance"),
    [("spring, moves", (1000,), 1e-12), ("rotational, moves", (10, 100), 1e-7), ("rotational, breaks", (100,), 1e-7)],
)
def test_motion_is_that_of_lammps(name, steps, tolerance):
    states, broken = moved(name, steps)
    stored = list(of(name, "steps"))
    np.testing.assert_allclose(states, of(name, "states")[[stored.index(k) for k in steps]], rtol=0, atol=tolerance)
    theirs = of(name, "broken")
    np.testing.assert_array_equal(broken, np.where(theirs <= max(steps), theirs, -1))
    assert (broken >= 0).any() == ("breaks" in name)


SPACING, RADIUS, MASS, INERTIA = 0.9, 0.5, 0.6, 0.05
STIFF, STRONG = (400.0, 300.0, 30.0, 40.0), (15.0, 20.0, 6.0, 8.0)
CEMENT = {"kn": 800.0, "ks": 500.0, "ratio": 0.8}
LAWS = ["rotational", "normalized", "parallel"]


def chain(law, n, dim=3):
    if law == "parallel":
        return bonds.parallel_chain(n, SPACING, radius=RADIUS, dim=dim, **CEMENT)
    return bonds.rotational_chain(n, SPACING, STIFF, normalize=law == "normalized")


def chain_loads(law, moved, dim=3, strength=None):
    """Loads of the bonds of a chain whose free spheres are moved and turned by small vectors (n, 6)."""
    n = len(moved)
    moved = np.vstack([np.zeros(6), moved])
    reference = np.tile([-SPACING, 0.0, 0.0], (n, 1))
    shift, turn = moved[:, :3], moved[:, 3:]
    pair, still = reference + shift[:-1] - shift[1:], np.zeros((2, n, 3))
    if law == "parallel":
        radii = np.full((2, n), RADIUS)
        motion, spin = (np.array([one[:-1], one[1:]]) for one in (shift, turn))
        cement = bonds.cemented(
            bonds.no_cement(n), reference, pair, motion, spin, 1.0, radii=radii, dim=dim, **CEMENT
        )  # fmt: skip
        tensile, shear = strength or (np.inf, np.inf)
        return bonds.parallel(cement, pair, radii=radii, tensile=tensile, shear=shear, dim=dim, **CEMENT)
    turned = [Rotation.from_rotvec(one) for one in (turn[:-1], turn[1:])]
    options = {"stiffness": STIFF, "strength": strength or (np.inf,) * 4, "normalize": law == "normalized"}
    return bonds.rotational(pair, still, still, turned, reference, smooth=False, **options)


def stiffness_matrix(law, n, dim, h=1e-6):
    """Differences of the loads of the chain, with the freedoms of the dimension."""
    free = np.array([0, 1, 2, 3, 4, 5] if dim == 3 else [0, 1, 5])
    columns = []
    for k in range(n):
        for axis in free:
            sides = []
            for sign in (1, -1):
                moved = np.zeros((n, 6))
                moved[k, axis] = sign * h
                loads = chain_loads(law, moved, dim)
                total = np.zeros((n + 1, 6))
                total[:-1] += np.hstack([loads.force_i, loads.torque_i])
                total[1:] += np.hstack([loads.force_j, loads.torque_j])
                sides.append(total[1:, free].ravel())
            columns.append((sides[1] - sides[0]) / (2 * h))
    return np.array(columns).T, free


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", LAWS)
def test_chains_yield_and_vibrate_as_their_closed_forms(law, dim):
    n = 4
    matrix, free = stiffness_matrix(law, n, dim)
    scale = np.abs(matrix).max()
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-6 * scale)
    inverse = np.linalg.inv(matrix)
    tip = {axis: (n - 1) * len(free) + k for k, axis in enumerate(free)}
    ours = chain(law, n, dim)
    stretch, deflection, slope, bend, twist = bonds.compliance(ours)
    found = [inverse[tip[a], tip[b]] for a, b in ((0, 0), (1, 1), (5, 1), (1, 5), (5, 5))]
    np.testing.assert_allclose(found, [stretch, deflection, slope, slope, bend], rtol=1e-6)
    masses = np.tile(np.where(free < 3, MASS, INERTIA), n)
    spectrum = np.linalg.eigvals(matrix / masses[:, None])
    expected = [bonds.line_frequencies(ours, ours.stretch, MASS), bonds.bending_frequencies(ours, MASS, INERTIA)]
    if dim == 3:
        assert inverse[tip[3], tip[3]] == pytest.approx(twist, rel=1e-6)
        expected += [expected[1], bonds.line_frequencies(ours, ours.twist, INERTIA)]
    np.testing.assert_allclose(np.sort(spectrum.real), np.sort(np.concatenate(expected)) ** 2, rtol=1e-6)


def test_long_chains_are_beams():
    """Half a sphere more than the beam has at its tip lowers frequencies by 1/n in bending and by 1/(2n) in torsion."""
    n = 100
    ours = chain("rotational", n)
    found = bonds.bending_frequencies(ours, MASS, INERTIA)[0], bonds.line_frequencies(ours, ours.twist, INERTIA)[0]
    errors = np.array(found) / bonds.continuum_frequencies(ours, MASS, INERTIA) - 1
    np.testing.assert_allclose(n * errors, [-1, -0.5], rtol=0.03)
    beam = (n * SPACING) ** 3 / (3 * ours.bend * SPACING)
    assert bonds.compliance(ours)[1] == pytest.approx(beam, rel=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("law", "strength"), [("rotational", STRONG), ("parallel", (20.0, 15.0)), ("parallel", (20.0, 1.5))]
)
def test_chains_break_at_their_closed_limits(law, strength, dim):
    n, small = 3, 1e-6
    matrix, free = stiffness_matrix(law, n, dim)
    if law == "rotational":
        limits = bonds.rotational_limits(chain(law, n), strength)
    else:
        tensile, shear = strength
        section = {"radius": RADIUS, "tensile": tensile, "shear": shear, "ratio": CEMENT["ratio"]}
        limits = bonds.parallel_limits(chain(law, n, dim), dim=dim, **section)
    for axis, limit in zip((0, 1, 3, 5), limits, strict=True):
        if axis not in free:
            continue
        load = np.zeros((n, len(free)))
        load[-1, list(free).index(axis)] = small * limit
        moved = np.zeros((n, 6))
        moved[:, free] = np.linalg.solve(matrix, load.ravel()).reshape(n, -1)
        share = chain_loads(law, moved, dim, strength).share
        assert share.max() == pytest.approx(small, rel=1e-4), axis


def test_smoothed_bonds_carry_the_closed_share_of_their_strength():
    stretch = np.linspace(0, 0.0999, 20001)
    pair, still = np.column_stack([1 + stretch, 0 * stretch, 0 * stretch]), np.zeros((2, len(stretch), 3))
    loads = bonds.spring(pair, still[0], np.ones(len(stretch)), k=400.0, ecrit=0.1)
    pulled = -loads.force_i[:, 0]
    assert loads.energy[-1] == pytest.approx(np.trapezoid(pulled, stretch), rel=1e-6)
    assert pulled.max() == pytest.approx(bonds.SMOOTHED_PEAK["spring"] * 400 * 0.1, rel=1e-6)
    none = Rotation.identity(len(stretch))
    reference = np.tile([1.0, 0, 0], (len(stretch), 1))
    loads = bonds.rotational(pair, still, still, (none, none), reference, stiffness=STIFF, strength=(40, 1, 1, 1))
    assert -loads.force_i[:, 0].min() == pytest.approx(bonds.SMOOTHED_PEAK["rotational"] * 40, rel=1e-6)


@pytest.mark.parametrize("size", [1e-3, 1e-4])
def test_small_loads_of_rotating_bonds_are_the_slope_of_an_energy(size):
    rng = np.random.default_rng(3)
    reference = np.array([[-0.5, 0.6, 0.4]])
    moved, h = size * rng.normal(size=12), size * 1e-3

    def bond(u):
        turned = [Rotation.from_rotvec(u[k : k + 3][None]) for k in (6, 9)]
        return reference + u[:3] - u[3:6], turned

    def energy(u):
        return bonds.quadratic_energy(*bond(u), reference, stiffness=STIFF)[0]

    slopes = [(energy(moved - h * one) - energy(moved + h * one)) / (2 * h) for one in np.eye(12)]
    pair, turned = bond(moved)
    still, limits = np.zeros((2, 1, 3)), (np.inf,) * 4
    loads = bonds.rotational(pair, still, still, turned, reference, stiffness=STIFF, strength=limits, smooth=False)
    found = np.concatenate([loads.force_i, loads.force_j, loads.torque_i, loads.torque_j], axis=1)[0]
    assert np.abs(found - slopes).max() < 10 * size * np.abs(found).max()


RADII = np.array([[0.5], [0.35]])
STRONG_CEMENT = {"kn": 800.0, "ks": 500.0, "radii": RADII, "tensile": np.inf, "shear": np.inf}


def cemented(*arguments):
    return bonds.cemented(*arguments, kn=800.0, ks=500.0, radii=RADII)


def strained():
    """A parallel bond of unequal spheres under load, and its pair."""
    velocity, spin = 0.02 * np.random.default_rng(4).normal(size=(2, 2, 1, 3))
    pair = np.array([[0.5, 0.6, 0.3]])
    after = pair + velocity[0] - velocity[1]
    return cemented(bonds.no_cement(1), pair, after, velocity, spin, 1.0), after


def test_parallel_bonds_turn_with_their_grains():
    turn, errors = np.array([0.3, -0.7, 0.5]), []
    whole, (cement, start) = Rotation.from_rotvec(turn), strained()
    first = bonds.parallel(cement, start, **STRONG_CEMENT)
    for steps in (50, 100):
        now, pair, about = cement, start, Rotation.from_rotvec(turn / steps)
        for _ in range(steps):
            after = about.apply(pair)
            velocity, spin = np.array([after - pair, 0 * pair]), np.tile(turn / steps, (2, 1, 1))
            now, pair = cemented(now, pair, after, velocity, spin, 1.0), after
        last = bonds.parallel(now, pair, **STRONG_CEMENT)
        expected = [whole.apply(one) for one in first[:4]]
        errors.append(np.abs(np.array(last[:4]) - expected).max() / np.abs(expected).max())
    assert errors[0] < 1e-3
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.1)


def test_bonds_exert_no_force_and_no_torque_in_total():
    rng = np.random.default_rng(5)
    cement, pair = strained()
    turned = [Rotation.from_rotvec(0.3 * rng.normal(size=(1, 3))) for _ in range(2)]
    options = {"stiffness": STIFF, "strength": (1e3,) * 4, "damping": (0.7, 0.5, 0.3, 0.2)}
    rotating = bonds.rotational(pair, *rng.normal(size=(2, 2, 1, 3)), turned, 1.1 * pair, **options)
    for loads in (bonds.parallel(cement, pair, **STRONG_CEMENT), rotating):
        np.testing.assert_array_equal(loads.force_i, -loads.force_j)
        total = loads.torque_i + loads.torque_j + np.cross(pair, loads.force_i)
        assert np.abs(total).max() < 1e-13 * np.abs(loads.torque_i).max()


def test_work_on_a_parallel_bond_is_its_energy():
    """Pulled, sheared, twisted and bent along a smooth path; the work is the trapezoidal sum of load · motion."""
    steps, errors = (100, 200), []
    way = 0.1 * np.random.default_rng(6).normal(size=(2, 2, 1, 3))
    for n in steps:
        cement, pair, work, load = bonds.no_cement(1), np.array([[0.5, 0.6, 0.3]]), 0.0, np.zeros((4, 1, 3))
        for _ in range(n):
            after = pair + (way[0, 0] - way[0, 1]) / n
            cement, pair = cemented(cement, pair, after, *(way / n), 1.0), after
            loads = bonds.parallel(cement, pair, **STRONG_CEMENT)
            now = np.array(loads[:4])
            work -= np.sum((load + now) / 2 * way.reshape(4, 1, 3)) / n
            load = now
        errors.append(work / loads.energy[0] - 1)
    assert abs(errors[0]) < 1e-3
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.1)


def test_sections_are_integrals_over_them():
    line = (np.arange(20000) + 0.5) / 10000 - 1
    radius, area, inertia, _ = bonds.section(np.float64(0.5), np.float64(0.8), 0.6, dim=2)
    y = radius * line
    assert (area, inertia) == pytest.approx((np.ones_like(y).sum() * radius / 1e4, (y**2).sum() * radius / 1e4))
    radius, area, inertia, polar = bonds.section(np.float64(0.5), np.float64(0.8), 0.6, dim=3)
    r = radius * (np.arange(20000) + 0.5) / 20000
    rings = 2 * np.pi * r * radius / 20000
    assert (area, inertia, polar) == pytest.approx((rings.sum(), (rings * r**2 / 2).sum(), (rings * r**2).sum()))
