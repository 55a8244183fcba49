"""Off equilibrium there is no verdict: in Python, whatever takes the packing out of balance."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.jacobian import linearise
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.library import core
from stickslip.data.exchange.files import capture_warnings
from stickslip.loading.protocols import ramp
from stickslip.loading.quasistatic import aqs
from stickslip.solve.balance import with_modes_under
from stickslip.solve.freedom import jacobian
from tests.derivatives.test_jacobian import differences

SHARP = ss.laws.hertz_mindlin(1.0, 2 / 7, 0.5, coulomb="sharp")


@pytest.fixture(scope="module")
def sheared():
    """Twenty-four spheres at rest under friction of 0.5, some contacts at the Coulomb limit."""
    state, _ = ss.packings.jammed(24, packing_fraction=0.7, seed=3)
    end = ramp(state, np.arange(0, 16) * 1e-3, aqs(SHARP))[-1].state
    modes = end.contacts.mode[ss.measure.touching(end)]
    assert {ss.STICK, ss.SLIDE} == set(modes)
    return end


def with_slip(state, share):
    """The state with its slips multiplied, contacts in the mode that they had."""
    return state._replace(contacts=state.contacts._replace(slip=share * state.contacts.slip))


def larger(state, share):
    return state._replace(grains=state.grains._replace(radius=share * state.grains.radius))


def without_cell(state):
    grains = state.grains
    return ss.packings.from_arrays(ss.measure.wrapped(state), grains.radius, SHARP, mass=grains.mass)


CHANGES = {
    "without slips": lambda s: (with_slip(s, 0.0), SHARP),
    "slips turned round": lambda s: (with_slip(s, -1.0), SHARP),
    "larger grains": lambda s: (larger(s, 1 + 1e-4 * np.arange(24)), SHARP),
    "requires a cell": lambda s: (without_cell(s), SHARP),
    "less friction": lambda s: (s, ss.laws.hertz_mindlin(1.0, 2 / 7, 0.2, coulomb="sharp")),
    "smooth friction": lambda s: (s, ss.laws.hertz_mindlin(1.0, 2 / 7, 0.5, coulomb="smooth")),
    "stiffer tangentially": lambda s: (s, ss.laws.hertz_mindlin(1.0, 0.6, 0.5, coulomb="sharp")),
    "no friction": lambda s: (s, ss.laws.hertz_mindlin(1.0, 2 / 7, 0.0, coulomb="sharp")),
    "a load": lambda s: (s._replace(control=s.control._replace(gravity=np.array([0, 0, -1.0]))), SHARP),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_packing_off_balance_is_neither_stable_nor_unstable(sheared, change):
    assert ss.stability(sheared, SHARP).stable is not None
    result = ss.stability(*CHANGES[change](sheared))
    assert result.residual > ss.measure.BALANCED_BELOW
    assert result.stable is None and not result.balanced
    assert result.verdict.startswith("not in equilibrium (residual") and result.verdict.endswith("cannot be judged")
    assert result.causes[-1].startswith("another law")
    assert result.method == "none" and not result.grows and not result.modes.shape[1]
    asked = ss.stability(*CHANGES[change](sheared), method="all")  # the spectrum is there for whoever asks for it
    assert (len(asked.pairs) + len(asked.negative) > 0) == asked.grows and asked.zero_modes >= 0
    assert asked.verdict == result.verdict and "stable" not in asked.motion.split("; ")


def test_no_spectrum_is_computed_for_an_answer_that_is_not_given(sheared, monkeypatch):
    monkeypatch.setattr("stickslip.solve.stability.blocks_of", lambda *_: pytest.fail("a spectrum"))
    assert ss.stability(with_slip(sheared, 0.0), SHARP).stable is None


def test_contacts_are_linearised_once_and_once_more_with_those_at_the_limit_sticking(sheared, monkeypatch):
    calls, linearise = [], core.linearise
    monkeypatch.setattr(core, "linearise", lambda *args: calls.append(linearise(*args)), raising=False)
    result = ss.stability(sheared, SHARP)
    assert result.balanced and result.if_stuck and len(calls) == 2


def test_dashpots_and_the_plain_spectrum_do_not_judge_either(sheared):
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 0.5, coulomb="sharp", damping_n=1e-2)
    calm, off = ss.stability(sheared, law), ss.stability(with_slip(sheared, 0.0), law)
    assert calm.balanced and calm.motion in calm.verdict and not calm.causes
    assert off.stable is None and off.verdict.startswith("not in equilibrium") and off.causes
    assert ss.spectrum(sheared, SHARP).stable == ss.stability(sheared, SHARP).stable
    assert ss.spectrum(with_slip(sheared, 0.0), SHARP).stable is None


def test_causes_are_those_that_the_state_shows(sheared):
    slips, cell = ss.measure.likely_causes(without_cell(sheared), SHARP)[:2]
    assert slips.startswith("no slip: all ") and "never sheared" in slips
    assert cell.startswith("no cell")
    (only,) = ss.measure.likely_causes(sheared, SHARP)
    assert only.startswith("another law")
    some = sheared.contacts.slip.copy()
    rows = ss.measure.touching(sheared)
    some[rows[:5]] = 0.0
    few = sheared._replace(contacts=sheared.contacts._replace(slip=some))
    assert ss.measure.likely_causes(few, SHARP)[0].startswith(f"no slip: 5 of {len(rows)} contacts")
    control = ss.control.fixed(few.control, np.unique([few.contacts.i[rows[:5]], few.contacts.j[rows[:5]]]))
    assert not any("no slip:" in cause for cause in ss.measure.likely_causes(few._replace(control=control), SHARP))
    single = (1000 + sheared.grains.position).astype(np.float32).astype(float)
    coarse = with_neighbor_list(sheared._replace(grains=sheared.grains._replace(position=single)))
    assert "in single precision" in ss.measure.likely_causes(coarse, SHARP)[0]
    bare = ss.laws.hertz_mindlin(mu=0.0)
    assert not any(c.startswith("no slip:") for c in ss.measure.likely_causes(with_slip(sheared, 0.0), bare))


def with_velocity(state, velocity):
    return state._replace(grains=state.grains._replace(velocity=np.broadcast_to(velocity, (24, 3)).copy()))


def test_what_moves_is_not_in_equilibrium(sheared):
    shaken = with_velocity(sheared, 0.01 * np.random.default_rng(0).normal(size=(24, 3)))
    result = ss.stability(shaken, SHARP)
    assert result.residual <= ss.measure.BALANCED_BELOW < result.swing
    assert result.stable is None and result.verdict.startswith("not in equilibrium (the grains move, which changes")
    assert result.causes[0].startswith("motion")
    turning = sheared._replace(grains=sheared.grains._replace(spin=0.01 + 0 * shaken.grains.velocity))
    assert not ss.stability(turning, SHARP).balanced
    for still in (with_velocity(sheared, 0.01), with_velocity(sheared, 1e-6 * shaken.grains.velocity)):
        assert ss.stability(still, SHARP).balanced  # it drifts as a whole, or hardly moves


def test_torques_must_balance(sheared):
    torque = np.zeros((24, 3))
    grip = np.abs(ss.measure.contact_forces(sheared, SHARP)).mean()
    torque[5, 2] = 0.1 * grip * sheared.grains.radius[5]
    state = sheared._replace(control=sheared.control._replace(torque=torque))
    assert not ss.stability(state, SHARP).balanced


def test_a_strong_part_does_not_hide_what_is_missing_in_a_weak_one():
    """Two rows that do not touch, a weak one on a floor and a strong one under a ceiling; the weak one lacks slips."""
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth"), 0, 1)
    rows = []
    for press, push in ((5e-6, 1.5e-6), (1e-3, 0.0)):
        state, _ = ss.relax(ss.packings.disk_array(10, press=press), law)
        rows.append(ss.relax(ss.packings.with_push(state, push), law)[0])
    weak, strong = rows
    above = np.array([0, 40.0, 0]) + [1, -1, 1] * strong.grains.position
    grains = ss.disks(np.concatenate([weak.grains.position, above]), 0.5, mass=np.tile(weak.grains.mass, 2))
    grains = grains._replace(inertia=np.tile(weak.grains.inertia, 2))
    control = ss.control.loads(20, 2, force=np.concatenate([weak.control.force[:10], -strong.control.force[:10]]))
    control.free[20:] = False
    walls = ss.flat_walls([[0, 0, 0], [0, 40, 0]], [[0, 1, 0], [0, -1, 0]], material=[1, 1])
    state = ss.assembly(grains, walls, weak.cell, control)
    state = ss.accept(state, ss.forces(state, law)[1])
    bare = weak._replace(contacts=weak.contacts._replace(slip=0 * weak.contacts.slip))
    assert ss.measure.imbalance(state, law) == pytest.approx(ss.measure.imbalance(bare, law), rel=0.05)
    assert ss.stability(state, law).stable is None


def test_the_imbalance_of_packings_with_few_contacts_or_none():
    law, apart, far = ss.laws.linear(), [[0, 0, 0], [0.99, 0, 0]], [[0, 0, 0], [3.0, 0, 0]]
    pull = np.array([[1.0, 0, 0], [0, 0, 0]])
    assert ss.measure.imbalance(ss.packings.from_arrays(apart, [0.5, 0.5], law), law) == pytest.approx(1.0)
    held = ss.packings.from_arrays(apart, [0.5, 0.5], law, external_force=[[0.01, 0, 0], [-0.01, 0, 0]])
    assert ss.measure.imbalance(held, law) < 1e-13
    assert ss.measure.imbalance(ss.packings.from_arrays(far, [0.5, 0.5], law), law) == 0.0
    assert ss.measure.imbalance(ss.packings.from_arrays(far, [0.5, 0.5], law, external_force=pull), law) == np.inf
    for place in (apart, far):
        with pytest.raises(ValueError, match="only rattlers"):
            ss.stability(ss.packings.from_arrays(place, [0.5, 0.5], law), law)
    assert ss.measure.likely_causes(ss.packings.from_arrays(far, [0.5, 0.5], law), law)[0].startswith("no cell")


def test_rattlers_are_part_of_the_balance():
    """What floats in gravity beside a packing is not at rest, although its modes are left out."""
    place, radius, law = (
        np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [5, 5.0]]),
        [0.5 + 1e-6] * 4,
        ss.laws.linear(1, 0.5, 0.5),
    )
    out = ss.forces(ss.packings.from_arrays(place, radius, law, dim=2), law)[0].force[:, :2]
    result = ss.stability(ss.packings.from_arrays(place, radius, law, dim=2, external_force=-out), law)
    assert result.balanced and result.rattlers.tolist() == [3]
    out[3] = 1e-6, 0
    assert ss.stability(ss.packings.from_arrays(place, radius, law, dim=2, external_force=-out), law).stable is None


def test_a_free_cell_must_bear_its_stress(sheared):
    stress = ss.measure.stress(sheared, SHARP)
    names = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2)}
    for share, balanced in ((1.0, True), (1.01, False)):
        wanted = {name: share * stress[at] for name, at in names.items()}
        state = sheared._replace(control=ss.control.stress_controlled(sheared.control, wanted))
        assert ss.stability(state, SHARP).balanced is balanced
        assert ss.measure.imbalance(state, SHARP) == pytest.approx(share - 1, abs=1e-3)


def test_a_wide_tolerance_leaves_nothing_to_judge(sheared):
    pushed = with_slip(sheared, 0.9)
    for tolerance, message in ((1.0, "not in equilibrium (residual"), (1e-12, "")):
        _, outcome = ss.equilibrate(pushed, SHARP, tolerance=tolerance)
        assert outcome.ok and outcome.warning.startswith(message)
        assert bool(outcome.warning) == bool(message)


def test_more_friction_lets_what_slid_stick(sheared):
    """Settled under 0.5 and judged under 0.8: the slips hold the packing, and no contact is at its limit."""
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 0.8, coulomb="sharp")
    rows = ss.measure.touching(sheared)
    here = with_modes_under(sheared, law)
    assert set(here.contacts.mode[rows]) == {ss.STICK}
    assert np.array_equal(here.contacts.slip, sheared.contacts.slip)
    assert with_modes_under(sheared, SHARP) is sheared
    result, free = ss.stability(sheared, law), ss.freedom(sheared)
    assert result.stable is not None
    numeric = differences(sheared, law, free, ss.FREE, h=1e-6)
    np.testing.assert_allclose(jacobian(here, law, free).toarray(), numeric, atol=1e-7 * np.abs(numeric).max())
    weighted = -numeric / np.sqrt(free.mass[:, None] * free.mass)
    fastest = np.abs(np.sqrt(np.linalg.eigvals(weighted).astype(complex)).imag)
    assert result.growth_rate.max(initial=0.0) == pytest.approx(fastest.max(), abs=1e-4)


def test_less_friction_lets_what_stuck_slide(sheared):
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 0.2, coulomb="sharp")
    here, rows = with_modes_under(sheared, law), ss.measure.touching(sheared)
    slides = here.contacts.mode[rows] == ss.SLIDE
    assert slides.sum() > (sheared.contacts.mode[rows] == ss.SLIDE).sum()
    line = linearise(here, law)
    pull = line.stiffness_t[rows] * np.linalg.norm(here.contacts.slip[rows], axis=1)
    np.testing.assert_allclose(pull[slides], line.limit[rows][slides], rtol=1e-3)
    assert (pull <= (1 + 1e-9) * line.limit[rows]).all()


@pytest.mark.parametrize("digits", [6, 8])
def test_round_off_of_text_is_no_reason_to_refuse(sheared, digits):
    """Eight digits never are; six are not, where grains are as soft as these."""

    def text(values):
        return np.reshape([float(f"{v:.{digits}g}") for v in values.ravel()], values.shape)

    rows, c = ss.measure.touching(sheared), sheared.contacts
    read, _ = capture_warnings(
        ss.packings.from_arrays,
        text(sheared.grains.position), sheared.grains.radius, SHARP, mass=sheared.grains.mass,
        cell=sheared.cell.vectors, pair_i=c.i[rows], pair_j=c.j[rows], image=c.image[rows], slip=text(c.slip[rows]),
        mode=c.mode[rows],
    )  # fmt: skip
    result, truth = ss.stability(read, SHARP), ss.stability(sheared, SHARP)
    assert result.residual > 1e-9
    assert result.stable is truth.stable
    assert len(result.pairs) == len(truth.pairs)


@pytest.mark.slow
@pytest.mark.parametrize("dim", [2, 3])
def test_verdicts_are_those_of_finite_differences_and_changed_packings_have_none(dim):
    """Thirty packings, periodic and sheared, or between walls: eigenvalues of differences of `forces` from rest."""
    verdicts = set()
    for seed in range(15):
        state, law = _rest(dim, seed)
        result = ss.stability(state, law)
        assert result.balanced, result.verdict
        free = ss.modes.backbone(state, law)
        numeric = differences(state, law, free, ss.HELD, h=1e-6)
        values = np.linalg.eigvals(-numeric / np.sqrt(free.mass[:, None] * free.mass))
        scale = np.abs(values).max()
        # differences are off by 1e-8 of the largest, which pairs turn into its square root near their birth
        grows = np.abs(np.sqrt(values[np.abs(values) > 1e-6 * scale].astype(complex)).imag).max(initial=0.0)
        rates = np.concatenate([result.growth_rate, np.sqrt(-result.negative)])
        assert rates.max(initial=0.0) == pytest.approx(grows, rel=1e-2, abs=1e-4 * np.sqrt(scale)), seed
        verdicts.add(result.stable)
        radius = state.grains.radius * (1 + 1e-2 * np.random.default_rng(seed).random(len(state.grains.radius)))
        stiffer = law._replace(table=law.table * np.where(np.arange(law.table.shape[2]) == 1, 2.0, 1.0))
        for other, its_law in (
            (with_slip(state, 0.0), law), (state._replace(grains=state.grains._replace(radius=radius)), law),
            (state, stiffer),
        ):  # fmt: skip
            off = ss.stability(ss.accept(other, ss.forces(other, its_law, memory=ss.FROZEN)[1]), its_law)
            assert off.stable is None, (seed, off.residual)
    assert verdicts == {True, False}


def _rest(dim, seed):
    """A packing at rest under friction: sheared in a periodic box, or (every third in the plane) held by walls."""
    coulomb = ("smooth", "sharp")[seed % 2]
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0 if seed % 4 < 2 else 0.5, coulomb=coulomb)
    if seed % 3 == 2 and dim == 2 and seed % 2:
        return ss.packings.biaxial_box(20, seed=seed)
    if seed % 3 == 2 and dim == 2:
        law = ss.laws.for_pair(ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb=coulomb), 0, 1)
        return ss.relax(ss.packings.disk_array(8 + seed, press=5e-5, push=1e-4, gap=-1e-3), law)[0], law
    state, _ = ss.packings.jammed(14, packing_fraction=0.9 if dim == 2 else 0.7, dim=dim, seed=seed)
    return ramp(state, np.arange(0, 5 + seed) * 1e-3, aqs(law))[-1].state, law


@pytest.mark.parametrize(("spin", "rests"), [([0, 5.0, 0], True), ([5.0, 0, 0], False)])
def test_a_grain_that_spins_about_its_contact_moves_nothing(spin, rests):
    """As `fix viscous` of LAMMPS leaves grains, which does not act on rotations."""
    grains = ss.spheres([[0, 0.49, 0]], [0.5], mass=[1.0], spin=[spin])
    load = ss.control.loads(1, 1, gravity=[0, -1e-3, 0])
    state = ss.assembly(grains, ss.flat_walls([[0, 0, 0]], [[0, 1, 0]]), ss.box([5] * 3, [False] * 3, 3), load)
    law = ss.laws.linear(kn=0.1, kt=0.05)
    state = ss.accept(state, ss.forces(state, law)[1])
    result = ss.stability(state, law)
    assert result.balanced == rests
    assert rests or any("motion: the grains move, at up to 2.5" in cause for cause in result.causes)


def test_torques_that_do_not_balance_name_moments_if_there_are_any(sheared):
    def causes(law):
        state = sheared._replace(control=ss.control.loads(24))
        state.control.torque[:, 0] = 1e-4
        return " ".join(ss.measure.likely_causes(state, law))

    assert "lever arms: forces balance" in causes(SHARP) and "R, are those of this law" in causes(SHARP)
    rolling = ss.laws.with_rolling(SHARP, k_roll=0.1, mu_roll=0.1)
    assert "moments: forces balance" in causes(rolling)
    assert "R − δ/2, are those of this law" in causes(ss.laws.with_lever(SHARP, "overlap"))


def test_positions_are_wrapped_into_a_tilted_cell(sheared):
    """Each position moves by whole cell vectors, and becomes a multiple from 0 to 1 of them."""
    tilted = ss.packings.sheared(sheared, 0.3)
    moved = tilted._replace(
        grains=tilted.grains._replace(position=tilted.grains.position + [2, -3, 1] @ tilted.cell.vectors)
    )
    share = ss.measure.wrapped(moved) @ np.linalg.inv(tilted.cell.vectors)
    assert (share >= 0).all() and (share < 1).all()
    cells = (ss.measure.wrapped(moved) - moved.grains.position) @ np.linalg.inv(tilted.cell.vectors)
    np.testing.assert_allclose(cells, np.round(cells), atol=1e-12)
