"""Waves: Bloch's theorem for lattices with rotations, moduli at long wavelength, spectra, and bounds of moduli."""

import numpy as np
import pytest
from scipy.linalg import eigvals, expm

import stickslip as ss
from stickslip.core.contacts.jacobian import cross_matrix, linearise
from stickslip.core.measure import volume
from stickslip.solve import waves as solver
from stickslip.solve.freedom import assembled
from stickslip.solve.linear import factorised
from stickslip.solve.moduli import ModuliBounds, isotropic_tensor, voigt, with_free_cell
from stickslip.solve.response import forced_motion
from tests.modes.conftest import LAW, sheared

OVERLAP = 1e-11  # carries a stress that changes ω² by as much
KN, KT = 1.3, 0.4
TRIANGULAR = np.array([[1, 0, 0], [0.5, 0.75**0.5, 0], [-0.5, 0.75**0.5, 0]])


def lattice(law, dim, across):
    """Disks of diameter 1 on a triangular lattice, or spheres on a simple cubic one; `across` along each axis."""
    if dim == 3:
        place, cell = np.argwhere(np.ones(across)), across
    else:
        site = np.array([[0, 0], [0.5, 0.75**0.5]])
        rows = np.argwhere(np.ones((across[0], across[1] // 2))) * [1, 3**0.5]
        place, cell = (rows[:, None] + site).reshape(-1, 2), [across[0], across[1] / 2 * 3**0.5]
    radius = np.full(len(place), 0.5 + OVERLAP / 2)
    return ss.packings.from_arrays(place, radius, law, cell=[float(x) for x in cell], dim=dim)


def bloch(normals, k, normal, lateral, dim):
    """Σ over contacts of EᴴKE, E = [(1 − e) 1, (1 + e) n×] for the slip of a grain and a neighbour with the phase e."""
    out = np.zeros((6, 6), complex)
    for n in normals:
        phase = np.exp(-1j * (n[: len(k)] @ k))
        cross = np.cross(np.eye(3), n).T @ -np.eye(3)
        np.testing.assert_allclose(cross @ [1.0, 2, 3], np.cross(n, [1.0, 2, 3]))
        reach = np.hstack([(1 - phase) * np.eye(3), (1 + phase) * cross])
        spring = normal * np.outer(n, n) + lateral * (np.eye(3) - np.outer(n, n))
        out += reach.conj().T @ spring @ reach
    kept = [0, 1, 5] if dim == 2 else range(6)
    return out[np.ix_(kept, kept)]


def exact(state, k, normals, damping=(0.0, 0.0), drag=0.0):
    """Exponents with Im s > 0 of the 3 × 3 or 6 × 6 problem for one grain, sorted."""
    dim, grains = state.cell.dim, state.grains
    mass = np.repeat([grains.mass[0], (grains.inertia / grains.radius**2)[0]], (dim, 2 * dim - 3))
    pull = bloch(normals, k, KN, KT, dim) / mass[:, None]
    drags = bloch(normals, k, *damping, dim) / mass[:, None] + drag * np.eye(len(mass))
    zero, one = np.zeros_like(pull), np.eye(len(mass))
    s = eigvals(np.block([[zero, one], [-pull, -drags]]))
    return in_order(s[s.imag > 0])


def in_order(s):
    return s[np.lexsort((s.real.round(9), s.imag.round(9)))]


@pytest.mark.parametrize(("dim", "across"), [(2, (6, 4)), (3, (4, 3, 3))])
def test_branches_of_a_lattice_are_those_of_one_grain(dim, across):
    law = ss.laws.linear(KN, KT, 0.5)
    state, normals = lattice(law, dim, across), TRIANGULAR if dim == 2 else np.eye(3)
    waves = ss.modes.dispersion(state, law, ss.modes.allowed_wavevectors(state, 10))
    for k, s in zip(waves.wavevector, waves.exponent, strict=True):
        np.testing.assert_allclose(np.sort(s.imag), exact(state, k, normals).imag, rtol=1e-10)
    assert np.abs(waves.damping).max() < 1e-10 and waves.scattered.max() < 1e-10
    np.testing.assert_allclose(waves.polarisation.sum(axis=2), 1.0)


def test_dashpots_and_drag_damp_the_waves_of_a_lattice():
    law = ss.laws.linear(KN, KT, 0.5, damping="mass_velocity", damping_n=0.3, damping_t=0.1)
    state = lattice(law, 2, (6, 4))
    half = 0.5 * state.grains.mass[0]  # reduced mass
    waves = ss.modes.dispersion(state, law, drag=0.05)
    for k, s in zip(waves.wavevector, waves.exponent, strict=True):
        truth = exact(state, k, TRIANGULAR, (0.3 * half, 0.1 * half), 0.05)
        np.testing.assert_allclose(in_order(s), truth, rtol=1e-10)
    assert waves.damping.min() > 0.025


def test_waves_along_a_row_of_a_cubic_lattice():
    """P: 4k_n/m sin²(k/2). Twist about the row: 8k_t R²/I, at any k: contacts do not resist twisting."""
    law = ss.laws.linear(KN, KT, 0.5)
    state = lattice(law, 3, (8, 3, 3))
    k = 2 * np.pi * np.arange(1, 5) / 8
    waves = ss.modes.dispersion(state, law, np.outer(k, [1, 0, 0]))
    mass, inertia = state.grains.mass[0], (state.grains.inertia / state.grains.radius**2)[0]
    np.testing.assert_allclose(waves.frequency[:, 0], 2 * np.sqrt(KN / mass) * np.sin(k / 2), rtol=1e-10)
    np.testing.assert_allclose(waves.frequency[:, 3], np.sqrt(8 * KT / inertia), rtol=1e-10)
    assert waves.names == ("P", "S", "S", "R", "R", "R")
    np.testing.assert_allclose(waves.polarisation[:, [0, 3], [0, 3]], 1.0)


def test_long_waves_of_a_lattice_have_the_speeds_of_the_moduli():
    law = ss.laws.linear(KN, KT, 0.5)
    state = lattice(law, 2, (80, 2))
    waves = ss.modes.dispersion(state, law, [[2 * np.pi / 80, 0]])
    np.testing.assert_allclose(waves.speed[0, :2], ss.modes.elastic_speeds(state, law, [1, 0])[0], rtol=1e-3)


@pytest.fixture(scope="module")
def disks():
    return ss.packings.jammed(300, packing_fraction=0.92, dim=2, seed=2)[0]


def test_long_waves_of_a_disordered_packing_approach_the_moduli(disks):
    """Speeds over those of the moduli fall with k: 2 % below at a wavelength of 18 diameters, and 1.5 % by 1 − a k²."""
    law = ss.laws.hertz_mindlin(mu=0.5)
    waves = ss.modes.dispersion(disks, law)
    ratio = waves.speed[:, :2] / ss.modes.elastic_speeds(disks, law, waves.wavevector)
    slope, start = np.polyfit((waves.wavevector**2).sum(axis=1), ratio, 1)
    assert (slope < 0).all()
    np.testing.assert_allclose(ratio[:2], 1.0, atol=0.03)
    np.testing.assert_allclose(start, 1.0, atol=0.02)
    assert (np.diff(waves.damping[[0, 3, 11], :2], axis=0) > 0).all()  # disorder scatters shorter waves more


@pytest.mark.parametrize(("dim", "fraction"), [(2, 0.92), (3, 0.7)])
def test_a_disordered_packing_repeated_along_a_row_has_the_speeds_of_its_moduli(dim, fraction):
    """A crystal with twelve grains in its cell: the wave of 40 cells leaves O(k²)."""
    law, repeats, along = ss.laws.hertz_mindlin(mu=0.5), 40, np.eye(dim)[0]
    one = ss.packings.jammed(12, packing_fraction=fraction, dim=dim, seed=1, tolerance=1e-12)[0]
    size, radius = np.diag(one.cell.vectors)[:dim], np.tile(one.grains.radius, repeats)
    place = np.concatenate([one.grains.position[:, :dim] + m * size * along for m in range(repeats)])
    cell = size * np.where(along, repeats, 1)
    state = ss.packings.from_arrays(place, radius, law, cell=cell, dim=dim)
    waves = ss.modes.dispersion(state, law, 2 * np.pi / cell[0] * along)
    np.testing.assert_allclose(waves.speed[0, :dim], ss.modes.elastic_speeds(one, law, along)[0], rtol=1e-3)


def test_the_wave_is_where_the_structure_factor_peaks(disks):
    law = ss.laws.hertz_mindlin(mu=0.5)
    k = ss.modes.allowed_wavevectors(disks, 4)
    waves, modes = ss.modes.dispersion(disks, law, k), ss.modes.wave_spectrum(disks, law, k)
    omega = np.linspace(0.002, 1.3, 1300)
    peak = omega[modes.structure_factor(omega, width=0.01).argmax(axis=2)]
    # steps of 0.001; the band of rotations is skewed, so that its peak is not its mean
    assert (np.abs(peak / waves.frequency - 1) < [0.03, 0.03, 0.1]).all()


def test_rotations_without_friction_do_not_oscillate(disks):
    waves = ss.modes.dispersion(disks, ss.laws.hertz_mindlin(kt=0.0, mu=0.0), ss.modes.allowed_wavevectors(disks, 2))
    assert np.abs(waves.exponent[:, 2]).max() < 1e-6 and waves.frequency[:, :2].min() > 0.05


def test_large_packings_are_factorised(disks, monkeypatch):
    law, k = ss.laws.hertz_mindlin(mu=0.5), ss.modes.allowed_wavevectors(disks, 1)
    dense = ss.modes.dispersion(disks, law, k, drag=0.1)
    monkeypatch.setattr(solver, "factorised", lambda matrix: factorised(matrix, method="superlu"))
    np.testing.assert_allclose(dense.exponent, ss.modes.dispersion(disks, law, k, drag=0.1).exponent, rtol=1e-9)


@pytest.mark.parametrize("drag", [0.0, 0.2])
def test_modes_of_waves_are_the_motion_after_a_push(swinging, drag):
    modes = ss.modes.wave_spectrum(swinging, LAW, drag=drag)
    motion, n = forced_motion(swinging, LAW, drag, None), len(modes.exponent) // 2
    pull, drags = motion.pull.toarray(), motion.drag.toarray()
    size, wave = len(pull), solver._plane_waves(swinging, motion.free, modes.wavevector[0])
    rigid = np.where(motion.free.axis[:, None] == np.arange(3), np.sqrt(motion.free.mass)[:, None], 0.0)
    rigid /= np.linalg.norm(rigid, axis=0)
    wave = wave - rigid @ (rigid.T @ wave)
    form = np.block([[np.zeros((size, size)), np.eye(size)], [-pull, -drags]])
    later = expm(3.0 * form)[size:, size:] @ wave
    correlation = (modes.weight[0] * np.exp(3.0 * modes.exponent)).sum(axis=1)
    np.testing.assert_allclose(correlation, (wave.conj() * later).sum(axis=0), atol=1e-9)
    assert n == size - 3
    pairs = len(ss.spectrum(swinging, LAW).pairs)
    assert modes.pair.sum() == (4 * pairs if not drag else 0)  # this drag stops the pair


def test_structure_factor_is_the_frequency_response_to_a_plane_wave():
    disks = ss.packings.jammed(90, packing_fraction=0.92, dim=2, seed=2)[0]
    law = ss.laws.hertz_mindlin(mu=0.5)
    k, omega = ss.modes.allowed_wavevectors(disks, 1), np.array([0.1, 0.2, 0.4])
    factor = ss.modes.wave_spectrum(disks, law, k, drag=0.1).structure_factor(omega)[0, 0]
    heavy = np.where(ss.measure.rattlers(disks), 0.0, disks.grains.mass)
    mass, drive = heavy.sum(), ss.modes.plane_wave(disks, k[0], k[0] / np.linalg.norm(k))
    drive[:, heavy == 0] = 0.0
    drive -= drive.sum(axis=1, keepdims=True) * heavy[:, None] / mass  # without translation
    response = ss.modes.frequency_response(disks, law, drive, omega, observe=drive, drag=0.1).matrix
    chi = np.trace(response, axis1=1, axis2=2) / mass
    np.testing.assert_allclose(factor, -omega * chi.imag / np.pi, rtol=1e-6)


def test_bounds_of_a_triangular_lattice():
    """Affine motion is exact. Equal forces along and across: 1/G = (1/√3)(1/k_n + 1/k_t)."""
    law = ss.laws.linear(KN, KT, 0.5)
    bounds = ss.modes.moduli_bounds(lattice(law, 2, (4, 4)), law)
    np.testing.assert_allclose(bounds.bulk, 3**0.5 / 2 * KN, rtol=1e-9)
    truth = [3**0.5 / (1 / KN + 1 / KT), *[3**0.5 / 4 * (KN + KT)] * 2]
    np.testing.assert_allclose(bounds.shear, truth, rtol=1e-9)
    for dim in (2, 3):
        c = voigt(isotropic_tensor(dim, 1.7, 0.6))
        np.testing.assert_allclose(ModuliBounds(c, c, c).bulk + ModuliBounds(c, c, c).shear, [1.7] * 3 + [0.6] * 3)


@pytest.mark.parametrize(("dim", "n", "fraction"), [(2, 60, 0.9), (3, 40, 0.68)])
def test_moduli_lie_between_their_bounds(dim, n, fraction):
    law = ss.laws.hertz_mindlin(mu=0.5)
    low, exact_, high = ss.modes.moduli_bounds(sheared(n, dim, fraction, 1e-5, seed=1, law=law), law)
    exact_ = (exact_ + exact_.T) / 2
    assert np.linalg.eigvalsh(exact_ - low).min() > 0 and np.linalg.eigvalsh(high - exact_).min() > 0
    assert np.trace(low) > 0.5 * np.trace(exact_)  # the bound says something


def test_moduli_fall_below_the_lower_bound_by_terms_of_the_stress():
    """Springs of the contacts alone obey the bound. Stress of 0.1 of the moduli breaks it, a hundredth hardly."""
    law, dim = ss.laws.hertz_mindlin(mu=10.0), 3
    state = ss.packings.jammed(4, packing_fraction=0.72, seed=1, tolerance=1e-13, law=law)[0]
    low, exact_, _ = ss.modes.moduli_bounds(state, law)
    strained, matrix, free, grain, cell = with_free_cell(state, law)
    line = linearise(strained, law)
    nn = line.normal[:, :, None] * line.normal[:, None]
    spring = line.slope_n[:, None, None] * nn + line.along[:, None, None] * (np.eye(3) - nn)
    reach = np.concatenate([np.broadcast_to(np.eye(3), nn.shape), cross_matrix(line.normal)], axis=2)
    springs = assembled(strained, -reach.transpose(0, 2, 1) @ spring @ reach, free).toarray()
    lowest = []
    for share in (1.0, 0.1, 0.01, 0.0):
        k = -(springs + share * (matrix.toarray() - springs)) * free.length**2 / volume(state)
        kept = k[np.ix_(grain, cell)]
        c = k[np.ix_(cell, cell)] - k[np.ix_(cell, grain)] @ np.linalg.pinv(k[np.ix_(grain, grain)], 1e-9) @ kept
        c = voigt(c.reshape([dim] * 4))
        lowest.append(np.linalg.eigvalsh((c + c.T) / 2 - low).min() / np.abs(exact_).max())
    assert lowest[0] < -0.1 and abs(lowest[3]) < 1e-12
    assert abs(lowest[1]) < abs(lowest[0]) / 10 and abs(lowest[2]) < abs(lowest[1]) / 10


@pytest.mark.parametrize("dim", [2, 3])
def test_allowed_wave_vectors_are_the_shortest_of_a_tilted_cell(dim):
    cell = np.array([[9.0, 0, 0], [3.0, 2.0, 0], [0.5, -0.4, 4.0]])[:dim, :dim]
    state = ss.packings.from_arrays([[0.0] * dim], [0.5], LAW, cell=cell, dim=dim)
    k = ss.modes.allowed_wavevectors(state, 30)
    whole = np.argwhere(np.ones([61] * dim)) - 30
    brute = np.sort(np.linalg.norm(2 * np.pi * np.linalg.solve(cell, whole.T), axis=0))
    np.testing.assert_allclose(np.linalg.norm(k, axis=1), brute[1:61:2])
    turns = k @ cell.T / (2 * np.pi)
    np.testing.assert_allclose(turns, turns.round(), atol=1e-9)
    assert len(np.unique(np.concatenate([k, -k]).round(6), axis=0)) == 60


def test_rolling_resistance_adds_its_bonds_to_the_rotations():
    """Σ ω² of the branches is the trace of a 3 × 3 matrix, to which rolling adds (k R_eff²/I) Σ |1 − e|²."""
    slips = ss.laws.linear(KN, KT, 0.5)
    rolls = ss.laws.with_rolling(slips, k_roll=0.2, mu_roll=0.5)
    state = lattice(rolls, 2, (6, 4))
    k = ss.modes.allowed_wavevectors(state, 6)
    more, less = ((ss.modes.dispersion(state, law, k).frequency ** 2).sum(axis=1) for law in (rolls, slips))
    bonds = (np.abs(1 - np.exp(1j * k @ TRIANGULAR[:, :2].T)) ** 2).sum(axis=1)
    np.testing.assert_allclose(more - less, 0.2 * 0.25**2 / state.grains.inertia[0] * bonds, rtol=1e-8)


def test_what_has_no_waves_is_reported(disks, calm):
    law = ss.laws.hertz_mindlin(mu=0.5)
    with pytest.raises(ValueError, match="waves need a cell that is periodic in all its dimensions"):
        ss.modes.dispersion(ss.packings.disk_array(4, press=5e-5), law)
    swollen = np.where(np.arange(300) == 7, 1.01, 1.0) * disks.grains.radius
    cell = np.diag(disks.cell.vectors)[:2]
    off = ss.packings.from_arrays(disks.grains.position[:, :2], swollen, law, cell=cell, dim=2)
    with pytest.raises(ValueError, match="not in equilibrium"):
        ss.modes.dispersion(off, law)
    with pytest.raises(ValueError, match="must be 2π times an integer"):
        ss.modes.dispersion(disks, law, [0.1, 0.0])
    with pytest.raises(ValueError, match="a mode that does not decay"):
        ss.modes.wave_spectrum(calm, LAW, ss.modes.allowed_wavevectors(calm, 1)).structure_factor([0.1])


def test_waves_are_drawn_with_the_lines_of_the_moduli():
    law = ss.laws.linear(KN, KT, 0.5)
    state = lattice(law, 3, (4, 3, 3))
    waves = ss.modes.dispersion(state, law, [[np.pi / 2, 0, 0]], drag=0.2)
    speeds = ss.modes.elastic_speeds(state, law, [1, 0, 0])
    left, right = ss.figures.dispersion(waves, speeds).axes
    drawn = np.concatenate([line.get_ydata() for line in left.lines if len(line.get_ydata()) == 1])
    np.testing.assert_allclose(np.sort(drawn), np.sort(waves.frequency[0]))
    lines = np.array([line.get_xydata()[1] for line in left.lines if len(line.get_ydata()) == 2])
    np.testing.assert_allclose(lines[:, 0], np.pi / 2)
    np.testing.assert_allclose(lines[[0, -1], 1], speeds[0, :2] * np.pi / 2)
    np.testing.assert_allclose(np.concatenate([line.get_ydata() for line in right.lines]), 0.1)
    assert [text.get_text() for text in left.get_legend().get_texts()] == ["P", "S", "R"]


def test_a_wave_that_shifts_all_grains_alike_has_no_frequency():
    """Two disks in a centred square cell, both where the phase is zero: ω² = 8 k_t R²/I for rotations, else nothing."""
    law = ss.laws.linear(KN, KT, 0.5)
    radius, side = np.full(2, 0.5 + OVERLAP / 2), 2**0.5
    state = ss.packings.from_arrays([[0, 0], [side / 2, side / 2]], radius, law, cell=[side, side], dim=2)
    waves = ss.modes.dispersion(state, law, 2 * np.pi / side * np.ones(2))
    truth = [0.0, 0.0, (8 * KT * 0.25 / state.grains.inertia[0]) ** 0.5]
    np.testing.assert_allclose(waves.frequency[0], truth, atol=1e-6)


@pytest.mark.parametrize(
    ("k", "e", "message"),
    [
        ([0, 0, 1.0], [1, 0], "z component of wavevector"),
        ([0, 0], [0, 0, 1.0], "z component of direction"),
        ([0, 0], [0, 0], "direction = 0 has no direction"),
        ([0.1, 0], [1, 0], "2π times an integer"),
    ],
)
def test_plane_waves_that_the_cell_does_not_have_are_refused(calm, k, e, message):
    with pytest.raises(ValueError, match=message):
        ss.modes.plane_wave(calm, k, e)


def test_waves_have_a_direction_in_the_plane(calm):
    with pytest.raises(ValueError, match=r"direction = 0 has no direction"):
        ss.modes.elastic_speeds(calm, LAW, [[1, 0], [0, 0]])
    with pytest.raises(ValueError, match="z component"):
        ss.modes.dispersion(calm, LAW, [0, 0, 1.0])
    with pytest.raises(ValueError, match=r"wavevector = 0 has no direction"):
        ss.modes.dispersion(calm, LAW, [0, 0])
