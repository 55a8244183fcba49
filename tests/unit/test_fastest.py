"""The fastest complex pair: windows and probes against the dense spectrum, which is the slow obvious twin."""

import warnings
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import csr_array

from stickslip.core.laws.builtin import hertz_mindlin, linear
from stickslip.core.state import assembly, box, disks, flat_walls, loads, spheres
from stickslip.solve import fastest, probes, stability
from stickslip.solve.fastest import ShiftWindows, fastest_pair
from stickslip.solve.freedom import dynamical_matrix, freedom
from stickslip.solve.spectrum import spectrum
from tests.conftest import stirred
from tests.modes.conftest import sheared

LAW = hertz_mindlin(1, 2 / 7, 10, coulomb="smooth")


def lattice(dim, side, stir, spacing=0.92, loose=0):
    """Grains of unlike masses on a periodic lattice, stirred so that contacts carry slip; some touch nothing."""
    rng = np.random.default_rng(0)
    axes = [np.arange(side)] * dim + [np.zeros(1)] * (3 - dim)
    position = spacing * np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(float)
    n = len(position)
    radius = np.where(np.arange(n) < loose, 0.3, 0.5)
    grains = (disks if dim == 2 else spheres)(position, radius, mass=rng.uniform(0.5, 2, n))
    edge = np.array([spacing * side] * dim + [10.0] * (3 - dim))
    state = assembly(grains, flat_walls(), box(edge, np.arange(3) < dim, dim), loads(n, 0))
    return stirred(state, LAW, rng, size=stir)


@pytest.mark.parametrize(
    ("dim", "side", "stir", "loose"), [(3, 4, 0.003, 0), (3, 4, 0.01, 0), (2, 8, 0.003, 0), (3, 4, 0.01, 1)]
)
def test_finds_the_fastest_pair_of_the_dense_spectrum(dim, side, stir, loose):
    state = lattice(dim, side, stir, loose=loose)
    truth = spectrum(state, LAW)
    fastest = fastest_pair(state, LAW, rate=5e-4, dense_below=0)
    # a simple eigenvalue of a matrix nearly symmetric: round-off times a condition number of some hundreds
    assert fastest.eigenvalue == pytest.approx(truth.pairs[0], rel=1e-9)
    assert fastest.growth_rate == pytest.approx(truth.growth_rate[truth.pair_indices[0]], rel=1e-6)
    assert fastest.residual < 1e-12
    free = freedom(state)
    vector = fastest.mode * np.sqrt(free.mass)
    assert np.linalg.norm(vector) == pytest.approx(1, rel=1e-12)
    defect = dynamical_matrix(state, LAW, free) @ vector - fastest.eigenvalue * vector
    assert np.linalg.norm(defect) < 1e-12 * np.abs(truth.eigenvalues).max()


def test_the_run_ends_early_and_says_how_far_it_looked():
    fastest = fastest_pair(lattice(3, 4, 0.01), LAW, rate=1e-5, dense_below=0)
    assert 1e-3 < fastest.looked < 2 * fastest.growth_rate  # and not 1e-5, which takes 100 times as long
    assert fastest.duration == pytest.approx(fastest.exponent / fastest.looked)
    assert "fastest pair found" in str(fastest) and "not a proof" in str(fastest)


def test_no_growing_mode_is_no_claim_of_stability():
    state = lattice(2, 8, 0.001)
    assert not len(spectrum(state, LAW).pairs)
    fastest = fastest_pair(state, LAW, rate=1e-3, dense_below=0)
    assert fastest.eigenvalue is None and fastest.mode is None and fastest.growth_rate == 0
    assert 0.45e-3 < fastest.looked < 1.05e-3  # whole spans, up to twice the time if there are peaks
    assert "no growing mode found" in str(fastest) and "not a proof" in str(fastest)


def test_growth_without_a_verified_mode_leaves_the_verdict_open(monkeypatch):
    state = lattice(3, 4, 0.01)
    search = partial(fastest.find_fastest, dense_below=0, factors_up_to=0)
    monkeypatch.setattr(fastest, "ALONE", 1e9)
    monkeypatch.setattr(probes, "CLEAR", 1e9)
    monkeypatch.setattr(stability, "DENSE_UP_TO", 0)
    pair = fastest_pair(state, LAW, dense_below=0, factors_up_to=0)
    monkeypatch.setattr(fastest, "find_fastest", search)
    assert pair.eigenvalue is None and pair.unverified > 0
    assert pair.suspected == pytest.approx(spectrum(state, LAW).growth_rate.max(), rel=0.5)
    assert "no growing mode verified" in str(pair) and "found none" not in str(pair)
    open_ = stability.stability(state, LAW, method="fastest")._replace(residual=0.0, swing=0.0)
    assert open_.balanced and open_.stable is None and not open_.grows
    assert open_.verdict.startswith("not decided") and f"{pair.unverified} peak" in open_.verdict
    calm = open_._replace(unverified=0)
    assert calm.stable and calm._replace(if_stuck=calm).stable
    for one in (open_._replace(if_stuck=calm), calm._replace(if_stuck=open_)):
        assert one.stable is None and one.verdict.startswith("not decided")
    grows = calm._replace(pairs=np.array([1 + 0.1j]), if_stuck=open_)
    assert grows.stable is None and open_._replace(if_stuck=grows).stable is False


def test_a_straight_chain_buckles():
    law = linear(1.0, mu=0.0)
    position = 0.99 * np.arange(40)[:, None] * np.array([1.0, 0, 0])
    state = assembly(
        disks(position, 0.5), flat_walls(), box([0.99 * 40, 10, 10], [True, False, False], 2), loads(40, 0)
    )
    state = stirred(state, law, np.random.default_rng(0), size=0.0)
    lowest = spectrum(state, law).eigenvalues.real.min()
    fastest = fastest_pair(state, law, dense_below=0)
    assert lowest < -0.01
    assert fastest.eigenvalue == pytest.approx(lowest, rel=1e-9) and fastest.frequency == 0
    assert "buckling" in str(fastest)


def test_same_seed_same_answer_and_other_seeds_agree():
    state = lattice(2, 8, 0.01)
    first, again, other = (fastest_pair(state, LAW, rate=1e-3, seed=seed, dense_below=0) for seed in (0, 0, 1))
    assert first.duration == again.duration and [w.shift for w in first.candidates] == [
        w.shift for w in again.candidates
    ]
    assert other.eigenvalue == pytest.approx(first.eigenvalue, rel=1e-9)


@pytest.mark.parametrize(("dim", "side", "stir"), [(2, 8, 0.01), (3, 4, 0.01)])
def test_probes_alone_find_the_fastest_pair_without_factors(dim, side, stir):
    state = lattice(dim, side, stir)
    truth = spectrum(state, LAW)
    fastest = fastest_pair(state, LAW, rate=5e-4, dense_below=0, factors_up_to=0)
    exact, norm = truth.pairs[0], np.abs(truth.eigenvalues).max()
    assert abs(fastest.eigenvalue - exact) < 0.02 * exact.imag  # a hundredth of it is the largest residual
    defect = dynamical_matrix(state, LAW) @ (v := fastest.mode * np.sqrt(fastest.free.mass)) - fastest.eigenvalue * v
    assert np.linalg.norm(defect) == pytest.approx(fastest.residual * norm, rel=0.01)
    assert fastest.residual * norm < 0.011 * exact.imag
    assert "below λ" not in fastest.guarantee and "/ω" in fastest.guarantee
    rate = np.where(truth.eigenvalues.imag > 0, truth.growth_rate, 0.0)
    assert (rate * truth.frequency).max() <= fastest.bottom.above


@pytest.mark.parametrize(("damping", "rel"), [(0.005, 1e-3), (0.2, 2e-3)])
def test_probes_find_the_fastest_exponent_with_dashpots(damping, rel, monkeypatch, tmp_path):
    """Weak dashpots damp the fastest pair, strong ones all but slower ones; LAPACK computes all exponents."""
    law = hertz_mindlin(1, 2 / 7, 10, coulomb="smooth", damping="velocity", damping_n=damping)
    state = stirred(lattice(3, 4, 0.01), law, np.random.default_rng(0), size=0.01)
    truth = stability.stability(state, law, method="dense")
    search = partial(fastest.find_fastest, dense_below=0, factors_up_to=0)
    monkeypatch.setattr(fastest, "find_fastest", search)
    monkeypatch.setattr(stability, "DENSE_UP_TO", 0)
    monkeypatch.setattr(stability, "FACTORS_UP_TO", 0)
    found = stability.stability(state, law, method="fastest", saved=tmp_path / "search.npz")
    assert found.exponents[0] == pytest.approx(truth.exponents[0], rel=rel)
    assert found.growth_rate[0] == pytest.approx(truth.growth_rate[0], rel=rel)
    assert found.undamped.growth_rate[0] == pytest.approx(truth.undamped.growth_rate[0], rel=1e-3)
    assert not found.unverified and not list(tmp_path.iterdir())
    mode = found.modes[:, 0] * np.sqrt(found.free.mass)
    exact = truth.modes[:, 0] * np.sqrt(truth.free.mass)
    assert abs(np.vdot(mode, exact)) == pytest.approx(np.linalg.norm(mode) * np.linalg.norm(exact), rel=1e-2)


def test_dashpots_that_stabilise_leave_nothing_that_grows(monkeypatch):
    law = hertz_mindlin(1, 2 / 7, 10, coulomb="smooth", damping="velocity", damping_n=0.01)
    state = stirred(lattice(3, 3, 0.004), law, np.random.default_rng(0), size=0.004)
    truth = stability.stability(state, law, method="dense")
    assert truth.undamped.grows and not truth.grows
    monkeypatch.setattr(fastest, "find_fastest", partial(fastest.find_fastest, dense_below=0, factors_up_to=0))
    monkeypatch.setattr(stability, "DENSE_UP_TO", 0)
    monkeypatch.setattr(stability, "FACTORS_UP_TO", 0)
    found = stability.stability(state, law, method="fastest")
    assert found.undamped.grows and not found.grows and not found.unverified


def test_a_search_continues_where_it_was_saved(tmp_path, monkeypatch):
    """The same answer, bit for bit; a file of another search is not used."""
    state, path = lattice(2, 8, 0.01), tmp_path / "search.npz"
    monkeypatch.setattr("stickslip.solve.probes.SAVED_EVERY", 0.0)
    options = {"dense_below": 0, "factors_up_to": 0, "saved": path}
    whole = fastest_pair(state, LAW, rate=2e-4, **options)
    assert not path.exists()
    told = []

    def stop(stage, share, text):
        told.append(text)
        if len(told) == 6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fastest_pair(state, LAW, rate=2e-4, report=stop, **options)
    assert path.exists()  # it was written before the fifth span
    first, last = told[0], told[-1]
    told.clear()
    again = fastest_pair(state, LAW, rate=2e-4, report=lambda stage, share, text: told.append(text), **options)
    assert told[0] == last and not path.exists()
    assert (again.eigenvalue, again.duration, again.looked) == (whole.eigenvalue, whole.duration, whole.looked)
    with pytest.raises(KeyboardInterrupt):
        told.clear()
        fastest_pair(state, LAW, rate=2e-4, report=stop, **options)
    told.clear()
    fastest_pair(state, LAW, rate=2e-4, seed=1, report=lambda stage, share, text: told.append(text), **options)
    assert told[0] == first  # another search starts anew


def test_nothing_that_touches_is_an_error():
    with pytest.raises(ValueError, match="no contact"):
        fastest_pair(lattice(2, 3, 0.0, spacing=1.2), LAW)


@pytest.fixture(scope="module", params=[(2, 100, 0.88, 10.0, 3), (3, 70, 0.68, 10.0, 3), (3, 70, 0.69, 0.5, 5)])
def packing(request):
    dim, n, fraction, mu, seed = request.param
    law = hertz_mindlin(1, 2 / 7, mu, coulomb="smooth")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        state = sheared(n, dim, fraction, 4e-3, seed=seed, law=law)
    return state, law, spectrum(state, law, modes=False)


def test_the_windows_at_the_bottom_hold_what_lapack_finds(packing):
    """And the number of eigenvalues that they claim is right, confirmed by the symmetric part or not."""
    state, law, full = packing
    truth = full.eigenvalues
    fastest = fastest_pair(state, law, rate=1e-3, dense_below=0)
    low, floor = fastest.bottom, 1e-6 * np.abs(truth).max()
    below = truth[truth.real < low.limit]
    assert 0 < low.limit < np.abs(truth).max() / 2  # a small part of the spectrum
    assert low.found == (np.abs(below) > (floor if low.zero else -1)).sum() - (0 if low.zero else _rattling(state, law))
    window = fastest.candidates[0]
    pairs = below[(below.imag > 0) & (np.abs(below - window.shift) < window.radius)]
    assert all(np.abs(window.growing - pair).min() < 1e-9 * np.abs(truth).max() for pair in pairs)


def _rattling(state, law):
    """Coordinates that nothing resists."""
    return int((abs(dynamical_matrix(state, law, freedom(state))).sum(axis=1) == 0).sum())


def test_the_guarantee_holds(packing):
    """No faster pair below the limit if it is confirmed, none faster above than seen, and none beyond the bound."""
    state, law, truth = packing
    rate = np.where(truth.eigenvalues.imag > 0, truth.growth_rate, 0.0)
    fastest = fastest_pair(state, law, rate=1e-3, dense_below=0)
    low = truth.eigenvalues.real < fastest.bottom.limit
    assert fastest.growth_rate == pytest.approx(rate.max(), rel=1e-6)
    assert rate[low].max(initial=0) <= fastest.growth_rate * (1 + 1e-6) or not fastest.bottom.confirmed
    assert rate[~low].max() <= fastest.bottom.above
    text = f"below λ = {fastest.bottom.limit:.4g} no other pair grows faster"
    assert text in fastest.guarantee and "which is not a proof" in fastest.guarantee


def test_a_missed_eigenvalue_is_noticed(packing, monkeypatch):
    state, law, _ = packing
    search = ShiftWindows.search
    monkeypatch.setattr(ShiftWindows, "search", lambda self, *given: np.sort(search(self, *given).real)[1:])
    fastest = fastest_pair(state, law, rate=1e-2, dense_below=0)
    assert not fastest.bottom.confirmed and "may be missing" in fastest.guarantee


def test_small_systems_go_to_lapack(packing):
    state, law, truth = packing
    fastest = fastest_pair(state, law)
    assert fastest.eigenvalue == pytest.approx(truth.pairs[0], rel=1e-9)
    assert fastest.probes == 0 and "eigenvalues were computed" in fastest.guarantee


@pytest.mark.slow
def test_a_thousand_grains_against_the_dense_spectrum():
    state = lattice(3, 10, 0.003)
    truth = spectrum(state, LAW)
    fastest = fastest_pair(state, LAW)
    assert fastest.eigenvalue == pytest.approx(truth.pairs[0], rel=1e-9)


def test_a_peak_that_failed_stays_unverified_and_is_tried_again_in_a_longer_run():
    modes = probes.GrowingModes(probes.Motion(np.eye(3), 1.0, np.zeros((3, 0))), (0.0, 0.0), 0.0, 10.0)
    run = SimpleNamespace(peaks=lambda: [(0.04 + 1e-4j, 2e-3)], time=2000.0)
    modes.failed = [(0.2, 0.01, 3e-3)]  # growth was overestimated in a short run
    assert not modes.hopeful(run) and modes.unverified(run) == run.peaks()
    modes.failed.clear()
    assert modes.hopeful(run) == run.peaks()
    run.tune, run.span, run.dt = lambda value: None, 100, 1.0
    with pytest.raises(AttributeError, match="log_scale"):  # an interruption while filters run
        modes.extract(run, None)
    assert modes.hopeful(run) == run.peaks()
    modes.explained = [(0.2, 0.01, 1.9e-3)]
    assert not modes.unverified(run)


@pytest.mark.parametrize(
    ("growth", "friction", "far"), [(0.026, 0.0, 150.0), (0.008, 3.0, 150.0), (0.008, 0.0, 10.0), (0.3, 0.0, 150.0)]
)
def test_probes_find_a_pair_that_leaks_or_outgrows_them_or_is_beside_strong_dashpots(
    growth, friction, far, monkeypatch
):
    """Power grows at most frequencies; other modes creep at the limit of the time step; amplitudes end the filters.

    The fastest pair overflows in runs of ordinary length.
    """
    monkeypatch.setattr(probes, "FAR", far)
    value, drag, k = np.linspace(0.05, 3.3, 61), np.full(61, -friction), 12
    drag[k : k + 2], value[k + 1] = 0.0, value[k]
    matrix = np.diag(value)
    matrix[k, k + 1] = 2 * growth * np.sqrt(value[k])
    matrix[k + 1, k] = -matrix[k, k + 1]
    motion = probes.Motion(csr_array(matrix), 3.3, np.zeros((61, 0)), csr_array(np.diag(drag)) if friction else None)
    clear = 1e9 if far < 100 else 100.0  # not reached before filters end
    effort, silently = probes.Effort(rate=1e-3), lambda *told: None
    found, _, left = probes.search_by_probes(motion, (0.0, 0.0), 0.0, effort, silently, None, clear)
    assert found.value == pytest.approx(value[k] + 1j * matrix[k, k + 1], rel=1e-3) and not left


def test_longer_runs_try_failed_peaks_again(monkeypatch):
    tried = []

    def stage(run, modes, *rest):
        tried.append((list(modes.failed), modes.rounds))
        modes.failed.append((0.2, 0.01, 3e-3))
        modes.rounds = 3
        return []

    monkeypatch.setattr(probes, "_run_stage", stage)
    motion = probes.Motion(csr_array(np.eye(9)), 1.0, np.zeros((9, 0)))
    probes.search_by_probes(motion, (0.0, 0.0), 0.0, probes.Effort(), lambda *told: None, None, 10.0)
    assert tried == [([], 0)] * len(tried) and len(tried) > 1
