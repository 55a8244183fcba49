"""Growth through a mechanism and an instability, and measures of sliding contacts, on cases with a known answer."""

from itertools import product

import numpy as np
import pytest

import stickslip as ss
from stickslip.wings.papers.quasi_rigid import cases
from stickslip.wings.status.matrices import linear_system, quadratic_form


def test_speed_through_a_mechanism_is_force_over_mass_times_time():
    motion = cases.through_mechanism()
    assert motion.power == pytest.approx(1, abs=1e-6)
    assert motion.speed == pytest.approx(cases.PUSH * cases.OVERLAP * motion.time, rel=1e-6)  # the mass is 1
    assert motion.predicted == 0


def test_speed_through_an_instability_grows_at_the_rate_of_the_lowest_eigenvalue():
    motion = cases.through_instability()
    assert motion.predicted > 0.1
    assert motion.rate == pytest.approx(motion.predicted, rel=1e-3)
    assert motion.power > 2


def test_a_flatter_groove_is_stable():
    motion = cases.follow_motion(*cases.disk_in_groove(steep=60.0), 1e-10 * np.array([0.0, 1.0]), 30.0)
    assert motion.predicted == 0
    assert motion.speed[-1] < 1e-9


@pytest.mark.parametrize(("mu", "positive"), [(2.0, True), (3.0, False)])
def test_a_sticking_hertzian_contact_contributes_positively_below_a_limit_of_mu(mu, positive):
    """μ² < 24 k_t/k_n, here μ < 2.45 with k_t = k_n/4."""

    def make(kn, _, friction, coulomb):
        return ss.laws.hertz_mindlin(kn, kn / 4, friction, coulomb=coulomb)

    made = cases.disk_in_groove(mu, make=make)
    springs = linear_system(*made, rattlers=True).springs
    factor = cases.KT / 0.25  # the slip was made for this k_t, and at the limit it is larger
    springs[:, 1, 0] *= factor
    assert (np.linalg.eigvalsh(0.5 * (springs + springs.transpose(0, 2, 1))).min() > 0) == positive


def test_shares_of_sliding_contacts_are_those_of_the_quadratic_form():
    state, law = cases.disk_in_groove()
    m = linear_system(state, law, rattlers=True)
    v = np.array([0.3, -0.2, -0.5])
    (share,) = cases.sliding_shares(m, v, m.limit)
    n, t = (m.c.T @ v).reshape(-1, 2)[m.limit][0]
    expected = n**2 - cases.FRICTION * t * n * m.sign[m.limit][0]  # Eq 45 with K_n = 1
    assert share == pytest.approx(expected / quadratic_form(m, v, m.limit))
    assert share < 0


def test_the_least_stable_status_by_brute_force():
    """Both contacts of a groove at the limit: k = c K S cᵀ of four statuses from dense matrices, for all signs."""
    seen = set()
    for mu, steep, first, second in product((0.2, 2.0), (10.0, 30.0, 60.0), (-1.0, 1.0), (-1.0, 1.0)):
        m = linear_system(*cases.disk_in_groove(mu, steep=steep), rattlers=True)
        m = m._replace(limit=np.ones(2, bool), sign=np.array([first, second]))
        c, values, minors = m.c.toarray(), [], []
        for slides in product((False, True), repeat=2):
            block = np.zeros((4, 4))
            for k, slide in enumerate(slides):
                s = [[1, 0], [-mu / cases.KT * m.sign[k], 0]] if slide else np.eye(2)
                block[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = np.diag([1.0, cases.KT]) @ s
            k = c @ block @ c.T
            values.append(np.linalg.eigvalsh(k + k.T)[0])
            minors.append(np.linalg.det(k + m.geometric.toarray()))
        least = values[-1] <= min(values) + 1e-9, minors[-1] <= min(minors) + 1e-9
        assert (cases.least_eigenvalue(m), cases.least_determinant(m, np.ones(3))) == least
        seen |= {("value", least[0]), ("det", least[1])}
    assert len(seen) == 4


def test_the_geometric_stiffness_is_proportional_to_the_overlap():
    assert cases.geometric_slope(0, disks=12) == pytest.approx(1, abs=0.15)


def test_switches_of_a_contact_on_a_wall_that_goes_back_and_forth():
    """The wall slides under a held disk; after each turn the contact sticks while the wall moves by 2 μ F_n/k_t."""
    period, speed, law = 40.0, 1e-3, ss.laws.linear(1.0, 1.0, 0.5)
    grains = ss.disks([[0.0, 0.49]], 0.5)
    turns = np.arange(period / 2, 220, period)
    times = np.sort(np.concatenate([[0.0], turns - 1e-3, turns + 1e-3]))
    signs = np.repeat((-1.0) ** np.arange(len(turns) + 1), 2)[: len(times)]
    control = ss.control.driven(ss.control.loads(1, 1), [0, 1], 0.0)
    control.rate[1, 0] = speed
    control = ss.control.time_dependent(control, [1], times, signs, axes=[0])
    state = ss.assembly(grains, ss.flat_walls([[0, 0, 0]], [[0, 1, 0]]), control=control)
    state, _, _ = ss.run(state, law, 150, 0.1)  # the contact slides after 5 units of time
    state = state._replace(time=0.0)
    key = state.contacts.key[: int(state.contacts.count[0])]
    switches, energy = cases._watch(state, law, key)
    sticks = 2 * 0.5 * 0.01 / speed
    assert sticks == pytest.approx(10) and cases.TIME == 200
    assert switches == 2 * (turns < 200 - sticks).sum() and energy == 0
