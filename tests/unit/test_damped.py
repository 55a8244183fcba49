"""Stability with dashpots: against the closed form of one contact, the whole spectrum, and the other method."""

import json

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.jacobian import contact_blocks
from stickslip.solve.freedom import assembled, dynamical_matrix
from tests.conftest import stickslip_here as run
from tests.exchange.packings import spheres

LAW = ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp", damping="velocity", damping_n=0.03, damping_t=0.02)


def growing(values):
    kept = (values.real > 1e-9) & (values.imag >= 0) & (np.abs(values) > 1e-5)
    return np.sort_complex(values[kept])


@pytest.fixture(scope="module")
def packing():
    return spheres(law=ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp"), motion=False)


@pytest.mark.parametrize(
    "damping", [pytest.param(1e-3, marks=pytest.mark.slow), 1e-2, pytest.param(0.1, marks=pytest.mark.slow)]
)
def test_exponents_are_those_of_the_whole_spectrum(packing, damping):
    law = ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp", damping_n=damping, damping_t=damping / 2)
    result = ss.stability(packing, law, method="all")
    truth = growing(ss.modes.damped_growth(packing, law))
    np.testing.assert_allclose(np.sort_complex(result.exponents.conj()), truth, atol=1e-9)
    assert result.grows == bool(len(truth))
    assert result.stable is None and not result.balanced  # arbitrary slips: no equilibrium


def test_modes_solve_the_quadratic_problem(packing):
    law = ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp", damping_n=1e-3)
    result = ss.stability(packing, law, method="all")
    assert len(result.exponents)
    free, root = result.free, np.sqrt(result.free.mass)
    pull, drag = dynamical_matrix(packing, law, free), assembled(packing, contact_blocks(packing, law)[1], free)
    for s, mode in zip(result.exponents, result.modes.T, strict=True):
        y = root * mode
        assert np.linalg.norm(y) == pytest.approx(1)
        assert np.linalg.norm(s**2 * y - s * (drag @ mode) / root + pull @ y) < 1e-9


def test_the_law_is_taken_as_it_is_unless_dashpots_are_left_out(packing):
    """Left out, the answer is that of the law without them, to the last bit; `undamped` is the same."""
    law = ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp", damping_n=0.1, damping_t=0.05)
    damped, left_out = (
        ss.stability(packing, law, method="all"),
        ss.stability(packing, law, method="all", dashpots=False),
    )
    plain = ss.stability(packing, ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp"), method="all")
    assert plain.undamped is left_out.undamped is None
    for result in (left_out, damped.undamped):
        for name in ("pairs", "negative", "modes"):
            assert np.array_equal(getattr(result, name), getattr(plain, name))
    assert "dashpots of the law were ignored" in left_out.scope and "dashpots" not in damped.scope + plain.scope
    assert len(damped.pairs) < len(plain.pairs) and damped.slowest.real < 0
    np.testing.assert_allclose(damped.growth_rate, damped.exponents[: len(damped.pairs)].real, rtol=1e-12)
    with pytest.raises(ValueError, match="method 'certify' does not support dashpots: use 'all', or omit them"):
        ss.stability(packing, law, method="certify")


def test_the_command_line_leaves_dashpots_out_on_request(tmp_path):
    """A pair swings and never comes to rest without its dashpots, which both commands are told to leave out."""
    law = ss.laws.linear(1.0, 0.0, 0.5, damping_n=0.1)
    pull = np.array([[-0.01, 0], [0.01, 0]])
    ss.io.write_packing(
        tmp_path / "two.npz",
        ss.packings.from_arrays([[0, 0], [0.99, 0]], [0.5, 0.5], law, dim=2, external_force=-pull), law,
    )  # fmt: skip
    values = {}
    for option in ((), ("--no-dashpots",)):
        done = run("stability", tmp_path / "two.npz", *option, "--json", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        values[option] = json.loads(done.stdout)
    assert [answer["spectrum"] for answer in values.values()] == ["damped", "undamped"]
    assert values["--no-dashpots",]["scope"] == "the dashpots of the law were ignored"
    done = run("report", tmp_path / "two.npz", "--no-dashpots", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "the dashpots of the law were ignored" in (tmp_path / "two-report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_methods_for_large_packings_find_the_same(packing):
    law = ss.laws.linear(1.0, 0.4, 5.0, coulomb="sharp", damping_n=1e-3, damping_t=1e-3)
    dense, near = (ss.stability(packing, law, method=method) for method in ("dense", "pairs"))
    assert len(dense.exponents)
    assert "did not cover growth caused by dashpots alone" in near.scope
    np.testing.assert_allclose(near.exponents[:3], dense.exponents[:3], atol=1e-9)


def test_a_pair_of_disks_swings_as_in_closed_form():
    """Two disks, one contact: m/2 s² + c s + k = 0 along the normal."""
    k, c = 1.0, 0.1
    law = ss.laws.linear(k, 0.0, 0.5, damping_n=c)
    state = ss.packings.from_arrays([[0, 0], [0.99, 0]], [0.5, 0.5], law, dim=2)
    s = ss.modes.damped_growth(state, law)
    truth = -c + 1j * np.sqrt(2 * k - c**2)
    assert np.abs(s - truth).min() < 1e-12


def test_too_large_for_dense_names_another_method(packing, monkeypatch):
    monkeypatch.setattr("stickslip.solve.stability.DAMPED_AT_MOST", 10)
    with pytest.raises(ValueError, match="use 'pairs' or 'fastest'"):
        ss.stability(packing, LAW, method="dense")
