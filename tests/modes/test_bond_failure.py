"""Bonds that decide over stability, and the first bond to break under a load."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.state import FAILURES
from stickslip.reports import details

LAW = ss.laws.hertz_mindlin(mu=0.5)
ERRORS = {1e-4: 1e-3, 1e-3: 1e-2}  # of the amount, by the factor on strengths
SHEAR = np.array([[0.0, 1.0], [0.0, 0.0]])


@pytest.fixture(scope="module")
def cemented():
    """Disks whose cement is as strong as the parallel bond of unit strengths, and carries nothing yet."""
    state, _ = ss.packings.jammed(30, packing_fraction=0.88, dim=2, law=LAW, seed=1)
    return ss.packings.bonded(state, ss.laws.parallel_bond(0.5, 0.2, 1.0, 2.0), within=0.05)


def with_strength(state, factor):
    return state._replace(bonds=state.bonds._replace(strength=factor * state.bonds.strength))


@pytest.mark.parametrize("factor", [1e-4, 1e-3])
@pytest.mark.parametrize("gradient", [SHEAR, -SHEAR, np.diag([0.5, 0.5])])
def test_the_first_bond_breaks_where_the_linear_response_says(cemented, gradient, factor):
    """Between the equilibria just before and just after it; the error is of the order of the strain."""
    state, wide = with_strength(cemented, factor), np.zeros((3, 3))
    wide[:2, :2] = gradient
    found = ss.modes.first_break(state, LAW, strain=gradient)
    error = ERRORS[factor]
    before, after = (
        ss.equilibrate(ss.packings.strained(state, share * found.at * wide), LAW, check="nothing")[0]
        for share in (1 - error, 1 + error)
    )
    assert before.bonds.intact.all() and not after.bonds.intact[found.bond]
    assert found.mode == FAILURES[after.bonds.failed[found.bond]]
    assert found.pair == (state.bonds.i[found.bond], state.bonds.j[found.bond])


def test_shares_on_the_way_to_a_break_are_those_of_equilibria(cemented):
    """All bonds, not only the first: each is at its strength where its amount says so."""
    found = ss.modes.first_break(with_strength(cemented, 1.0), LAW, strain=SHEAR)
    wide, amount = np.zeros((3, 3)), 1e-6
    wide[:2, :2] = SHEAR
    end, _ = ss.equilibrate(ss.packings.strained(cemented, amount * wide), LAW, check="nothing")
    share, loaded = ss.measure.bond_shares(end), np.isfinite(found.amount)
    np.testing.assert_allclose(share[loaded], amount / found.amount[loaded], rtol=1e-3)
    assert loaded.sum() > 20 and np.isinf(found.amount[share == 0]).all()


def test_bonds_without_a_limit_never_break(cemented):
    state = ss.packings.bonded(ss.packings.without_bonds(cemented), ss.laws.parallel_bond(0.5, 0.2), within=0.05)
    found = ss.modes.first_break(state, LAW, strain=SHEAR)
    assert found.bond == -1 and np.isinf(found.amount).all() and "no bond breaks" in str(found)


def test_a_stress_is_what_grows_if_one_is_given(cemented):
    wanted = np.array([[-2.0, 0.5], [0.5, 1.0]])
    found = ss.modes.first_break(cemented, LAW, stress=wanted)
    np.testing.assert_allclose(found.stress, wanted, atol=1e-4)
    again = ss.modes.first_break(cemented, LAW, strain=found.strain)
    np.testing.assert_allclose(again.amount, found.amount)


def test_derivatives_of_the_deciding_mode_are_those_of_stiffer_bonds(cemented, capsys):
    found = ss.modes.decisive_bonds(cemented, LAW)
    table = details.BondDetails(found, "not computed")
    details.show_bonds(table)
    assert f"and {len(found.bond) - details.BONDS} more with --json" in capsys.readouterr().out
    assert len(details.bonds_dict(table)["decisive"]["bonds"]) == len(cemented.bonds.i)
    for k in (0, 1):
        values = []
        for factor in (1 - 1e-4, 1 + 1e-4):
            stiffness = cemented.bonds.stiffness.copy()
            stiffness[found.bond[k]] *= factor
            other = cemented._replace(bonds=cemented.bonds._replace(stiffness=stiffness))
            values.append(ss.modes.decisive_bonds(other, LAW, most=0).eigenvalue)
        assert (values[1] - values[0]) / 2e-4 == pytest.approx(found.derivative[k], rel=1e-4)


def test_what_follows_a_break_is_that_of_the_packing_without_the_bond():
    """Of two grains on springs between fixed ones, the one whose spring breaks falls along its compressed contact."""
    chain = ss.assembly(ss.spheres([[0, 0, 0], [1, 0, 0], [2, 0, 0]], 0.5 + 1e-3))
    state = ss.packings.bonded(chain, ss.laws.beam_bond(1.0, 0.5, 0.1, 0.1), within=0.1)
    control = ss.control.fixed(state.control, [0, 2])
    state, _ = ss.equilibrate(state._replace(control=control), LAW)
    found = ss.modes.decisive_bonds(state, LAW)
    for k, bond in enumerate(found.bond):
        intact = np.arange(2) != bond
        after = ss.stability(state._replace(bonds=state.bonds._replace(intact=intact)), LAW, method="dense")
        assert (after.verdict.split(":")[0] == "stable") == (found.verdict_after[k] == "stable")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "needs either strain or stress"), ({"strain": SHEAR, "stress": SHEAR}, "needs either strain or stress"),
        ({"strain": np.eye(3)}, r"strain.*\(2, 2\)"), ({"stress": SHEAR}, "the stress must be symmetric"),
    ],
)  # fmt: skip
def test_loads_that_mean_nothing_are_refused(cemented, options, words):
    with pytest.raises(ValueError, match=words):
        ss.modes.first_break(cemented, LAW, **options)


def test_a_packing_without_bonds_is_refused(cemented):
    for function in (ss.modes.decisive_bonds, lambda *about: ss.modes.first_break(*about, strain=SHEAR)):
        with pytest.raises(ValueError, match="has no intact bonds"):
            function(ss.packings.without_bonds(cemented), LAW)
