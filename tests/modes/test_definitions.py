"""Quantities computed once more with NumPy alone, from the definitions in their docstrings."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

import stickslip as ss

LAW = ss.laws.hertz_mindlin(mu=0.5, damping="mass_velocity", damping_n=0.2, damping_t=0.1)


@pytest.fixture(scope="module")
def packing():
    """Disks of two sizes with contacts that have slipped, and a rattler."""
    state, _ = ss.packings.jammed(20, packing_fraction=0.86, dim=2, seed=12)
    return ss.equilibrate(ss.packings.sheared(state, 1e-3), LAW)[0]


def matrices(state, drag):
    """A, D and the backbone, dense."""
    free = ss.modes.backbone(state, LAW)
    root = 1 / np.sqrt(free.mass)
    stiff, damp = (ss.modes.assembled(state, part, free).toarray() for part in ss.modes.contact_blocks(state, LAW))
    assert -(root[:, None] * stiff * root) == pytest.approx(ss.modes.dynamical_matrix(state, LAW, free).toarray())
    return -(root[:, None] * stiff * root), np.diag(drag * np.ones(len(free))) - root[:, None] * damp * root, free


def test_dispersion(packing):
    drag, k = 0.02, ss.modes.allowed_wavevectors(packing)[0]
    pull, drags, free = matrices(packing, drag)
    unit, phase = k / np.linalg.norm(k), np.exp(1j * packing.grains.position[free.body, :2] @ k)
    inertia, n = packing.grains.inertia[free.body], len(free)
    ways = np.stack([unit, [-unit[1], unit[0]]])
    waves = np.array([*(np.where(free.axis < 2, np.sqrt(free.mass) * way[free.axis % 2], 0) * phase for way in ways),
                      np.where(free.axis == 5, np.sqrt(inertia), 0) * phase]).T  # fmt: skip
    waves /= np.linalg.norm(waves, axis=0)
    found = []
    for wave, members in ((0, [0, 1]), (2, [2])):
        s = np.sqrt((waves[:, wave].conj() @ pull @ waves[:, wave]).real)
        inner, slope = np.linalg.inv(pull + s * drags + s**2 * np.eye(n)), drags + 2 * s * np.eye(n)
        first = -inner @ slope @ inner
        second = 2 * inner @ slope @ inner @ slope @ inner - 2 * inner @ inner
        chi, by_s, by_ss = (waves.conj().T @ part @ waves for part in (inner, first, second))
        z = np.linalg.inv(chi)
        z1 = -z @ by_s @ z
        mass = (2 * z @ by_s @ z @ by_s @ z - z @ by_ss @ z) / 2
        gamma = z1 - 2 * s * mass
        stiff = z - s * gamma - s**2 * mass
        solve = np.linalg.inv(mass)
        form = np.block([[np.zeros((3, 3)), np.eye(3)], [-solve @ stiff, -solve @ gamma]])
        values, vectors = np.linalg.eig(form)
        best = np.argsort(-values.imag)[:3]
        shares = np.abs(vectors[:3, best]) ** 2
        found += [values[best][np.argmax(shares[m] / shares.sum(axis=0))] for m in members]
    branches = ss.modes.dispersion(packing, LAW, [k], drag=drag)
    np.testing.assert_allclose(branches.exponent[0], found, rtol=1e-9)


def test_covariance_of_velocities(packing):
    """Without the common translations, each of which adds T/Σm."""
    drag, temperature = 0.05, 2.0
    pull, drags, free = matrices(packing, drag)
    moves = np.array([np.where(free.axis == a, np.sqrt(free.mass), 0) for a in (0, 1)]).T
    moves /= np.linalg.norm(moves, axis=0)
    basis = np.linalg.svd(np.eye(len(free)) - moves @ moves.T)[0][:, :-2]
    a, d = basis.T @ pull @ basis, basis.T @ drags @ basis
    n, none = len(a), np.zeros_like(a)
    noise = np.block([[none, none], [none, temperature * (d + d.T)]])
    whole = solve_continuous_lyapunov(np.block([[none, np.eye(n)], [-a, -d]]), -noise)
    root = 1 / np.sqrt(free.mass)
    mine = root[:, None] * (basis @ whole[n:, n:] @ basis.T) * root
    noisy = ss.modes.stationary_fluctuations(packing, LAW, temperature=temperature, drag=drag)
    np.testing.assert_allclose(noisy.velocity, mine, atol=1e-9 * np.abs(mine).max())
    assert noisy.kinetic == pytest.approx(0.5 * np.trace(whole[n:, n:]) / n, rel=1e-9)


def test_contacts_and_fields(packing):
    rows, grains = ss.measure.touching(packing), packing.grains
    i, j, branch = packing.contacts.i[rows], packing.contacts.j[rows], ss.measure.branch_vectors(packing)[rows]
    loose = ss.measure.rattlers(packing)
    counted = ~loose[i] & ~loose[j]
    number = np.bincount(np.append(i[counted], j[counted]), minlength=len(loose))
    assert loose.any() and ss.measure.coordination(packing) == pytest.approx(number[number > 0].mean())
    assert ss.measure.elastic_energy(packing, LAW) == pytest.approx(
        0.4 * (ss.measure.overlaps(packing)[rows] ** 2.5).sum()
    )
    loads = ss.forces(packing, LAW)[0]
    parts = np.hstack([loads.force, loads.torque / grains.radius[:, None]])
    assert ss.measure.residual(packing, LAW)[0] == pytest.approx(np.abs(parts).max())
    width, force = 0.8, ss.measure.contact_forces(packing, LAW)[rows]
    fields = ss.measure.coarse_grained(packing, LAW, width=width)
    a, b = packing.cell.vectors[:2, :2]
    images = np.array([[u, v] for u in range(-4, 5) for v in range(-4, 5)]) @ np.array([a, b])
    point = np.array([float(fields.x[2, 1]), float(fields.y[2, 1])])
    assert point == pytest.approx((2 + 0.5) / fields.sizes["a"] * a + (1 + 0.5) / fields.sizes["b"] * b)

    def phi(place):
        square = ((point - place[..., None, :2] - images) ** 2).sum(axis=-1)
        return (np.exp(-square / (2 * width**2)) / (2 * np.pi * width**2)).sum(axis=-1)

    assert float(fields.density[2, 1]) == pytest.approx((grains.mass * phi(grains.position)).sum(), rel=1e-6)
    shares = (np.arange(400) + 0.5) / 400
    along = phi(grains.position[i][:, None] - shares[None, :, None] * branch[:, None]).mean(axis=1)
    mine = np.einsum("ca,cb,c->ab", force, branch, along)[:2, :2]
    np.testing.assert_allclose(fields.stress[2, 1], mine, rtol=1e-4)
