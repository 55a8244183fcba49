"""Packings that are loaded until they fail: twins, closed forms, restarts, inputs and refusals; forecasts."""

import csv
import json
import warnings
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import stickslip as ss
from stickslip.data.checkpoint import Checkpoint
from stickslip.figures import failure_path
from stickslip.loading.event_path import CONTACT, PAIR, SADDLE, Signs, extrapolations, forecast
from stickslip.loading.failure import PathStep, signs_of
from stickslip.loading.protocols import bisect_change
from stickslip.loading.settling import deformation
from stickslip.modes import UnstableEquilibriumWarning
from stickslip.results import Event, EventKind
from stickslip.solve.shear_response import Response
from tests.conftest import stickslip_here
from tests.events.packings import FRICTIONLESS, SMOOTH, drag, found, packing

SHARP = ss.laws.hertz_mindlin(mu=0.3)
LINEAR = ss.laws.linear(kn=1.0, kt=0.4, mu=0.1)
SIDE = 0.98  # of a square lattice of disks of diameter 1


def lattice(law):
    """A square lattice of four disks, all of whose contacts are alike."""
    cell = ss.box([2 * SIDE, 2 * SIDE, 1.0], [True, True, False], 2)
    place = SIDE * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    return ss.equilibrate(ss.assembly(ss.disks(place, 0.5), cell=cell), law)[0]


@pytest.mark.parametrize("mode", ["simple", "pure", "isotropic", "uniaxial"])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_curve_is_that_of_steps_by_hand(mode, sign):
    """The twin repeats affine steps and `equilibrate`, and takes the stress from the work on a small strain."""
    state = packing(SHARP, 3, 0.88)
    path = ss.protocols.shear_to_failure(state, SHARP, until=sign * 3e-4, step=1e-4, mode=mode)
    assert [step.strain for step in path.steps] == pytest.approx(sign * np.array([0, 1e-4, 2e-4, 3e-4]))
    way = deformation(mode, 2)
    for step in path.steps[1:]:
        state, outcome = ss.equilibrate(way.apply(state, sign * 1e-4), SHARP, check="nothing")
        sigma = ss.measure.stress(state, SHARP)
        by_hand = {"simple": -sigma[0, 1], "pure": 0.5 * (sigma[1, 1] - sigma[0, 0]), "uniaxial": sigma[1, 1]}
        pressure = ss.measure.pressure(state, SHARP)
        assert outcome.ok and step.pressure == pytest.approx(pressure, rel=1e-7)
        assert step.stress == pytest.approx(by_hand.get(mode, pressure), rel=1e-6, abs=1e-8 * pressure)
        assert step.touching == len(ss.measure.touching(state))
        assert step.pairs == len(ss.spectrum(state, SHARP).pairs)


@pytest.mark.parametrize("mode", ["simple", "pure", "isotropic", "uniaxial"])
def test_the_tangent_modulus_is_the_slope_of_the_curve(mode):
    state = packing(SHARP, 3, 0.88)
    path = ss.protocols.find_events(state, SHARP, to=4e-6, step=2e-6, drag=drag(state, SHARP), mode=mode)
    slope = np.diff(path.steps.shear_stress)[0] / 2e-6
    assert path.steps.tangent_modulus[0] == pytest.approx(slope, rel=1e-3)


def test_compression_of_a_lattice_has_its_closed_form():
    """Each side carries k_n (2R − L), over the side L = L₀ exp(−ε/2)."""
    path = ss.protocols.shear_to_failure(lattice(LINEAR), LINEAR, until=-0.03, step=0.01, mode="isotropic")
    side = SIDE * np.exp(-0.5 * np.array([step.strain for step in path.steps]))
    np.testing.assert_allclose([step.pressure for step in path.steps], (1 - side) / side, rtol=1e-9)


def test_friction_of_a_lattice_is_mobilised_at_its_closed_form():
    """Torques balance if both contacts slip by γL/2: they slide at γ = 2 μ k_n δ/(k_t L), but for terms of order γ²."""
    slides = 2 * 0.1 * (1 - SIDE) / (0.4 * SIDE)
    path = ss.protocols.shear_to_failure(lattice(LINEAR), LINEAR, until=0.96 * slides, step=0.12 * slides)
    for step in path.steps:
        assert not step.sliding and not len(step.changes)
        mobilisation = Response(step.state, LINEAR).mobilisation
        np.testing.assert_allclose(mobilisation[np.isfinite(mobilisation)], step.strain / slides, atol=0.02)
        turned = (1 - SIDE) / SIDE  # of the normal forces with the contacts
        assert step.stress == pytest.approx((0.5 * 0.4 - turned) * step.strain, rel=0.01)


def test_a_packing_that_is_unloaded_falls_apart():
    state = packing(SHARP, 3, 0.845)
    path = ss.protocols.shear_to_failure(state, SHARP, until=-1.0, step=0.02, mode="isotropic")
    assert "fell apart" in path.end and path.steps[-1].pressure < 1e-9 * path.steps[0].pressure


def test_changes_of_contacts_are_those_of_the_states():
    """The twin compares pairs of grains that touch, rattlers left out, and the modes of their contacts."""
    path = ss.protocols.shear_to_failure(packing(SHARP, 8, 0.88), SHARP, until=4e-2, step=2e-3)
    seen = set()
    for a, b in pairwise(path.steps):
        old, new = bearing(a.state), bearing(b.state)
        twin = {(0, *key) for key in old.keys() - new.keys()} | {(1, *key) for key in new.keys() - old.keys()}
        both = [key for key in old.keys() & new.keys() if old[key] != new[key]]
        twin |= {(2 if new[key] == ss.SLIDE else 3, *key) for key in both}
        assert set(map(tuple, b.changes.tolist())) == twin
        seen |= {change for change, *_ in twin}
    assert seen == {0, 1, 2, 3}


def bearing(state):
    """Modes of the contacts that touch, by their grains, without those of rattlers."""
    loose, contacts = ss.measure.rattlers(state), state.contacts
    rows = [row for row in ss.measure.touching(state) if not (loose[contacts.i[row]] or loose[contacts.j[row]])]
    return {(int(contacts.i[row]), int(contacts.j[row])): int(contacts.mode[row]) for row in rows}


def test_the_first_pair_is_that_of_a_bisection_by_hand():
    state = packing(SMOOTH, 3)
    path = ss.protocols.shear_to_failure(state, SMOOTH, until="first-pair", step=2e-4, limit=0.01)
    assert path.steps[-1].pairs and not path.steps[-2].pairs and "complex pair" in path.reason
    protocol = ss.protocols.aqs(SMOOTH)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnstableEquilibriumWarning)
        points = ss.protocols.ramp(state, [step.strain for step in path.steps], protocol)
        by_hand = bisect_change(points[-2], points[-1].load, protocol, lambda s: bool(len(s.pairs)))
    assert path.onset.load == pytest.approx(by_hand.load, rel=3e-6)
    (life,) = [one for one in path.pairs if one.born == path.steps[-1].strain][:1]
    assert life.born_below <= path.onset.load <= life.born and np.isnan(life.died)
    assert path.decisive and path.decisive[0].what in ("opens", "slides")
    assert "first complex pair" in path.end and len(path.to_dataframe()) == len(path.steps)


def test_the_life_of_a_pair_is_that_of_the_steps():
    """The first pair is born in one step, grows faster in the next, and is gone after it."""
    path = ss.protocols.shear_to_failure(packing(SMOOTH, 3), SMOOTH, until=6e-3, step=2e-4)
    with_pair = [step for step in path.steps if step.pairs]
    life, first, fastest = path.pairs[0], with_pair[0], max(with_pair, key=lambda step: step.growth)
    assert first is not fastest and life.born == first.strain
    assert (life.at, life.growth) == (fastest.strain, pytest.approx(fastest.growth))


# 5 s: a search for events beside the path
def test_the_first_event_is_that_of_the_search():
    known = found(FRICTIONLESS, 3, 0.006, fraction=0.88).events[0]
    state = packing(FRICTIONLESS, 3, 0.88)
    path = ss.protocols.shear_to_failure(state, FRICTIONLESS, step=1e-3, limit=0.006, drag=drag(state, FRICTIONLESS))
    assert path.events[0].kind is known.kind
    assert path.events[0].strain == pytest.approx(known.strain, abs=5e-6)
    assert path.reason == "the path jumped to another state"
    assert not any(step.sliding for step in path.steps)
    top, bottom = failure_path(path).axes  # there is no pair, so no growth rate
    assert bottom.get_xlabel().startswith("strain") and "[" in top.get_ylabel()
    back = path._replace(sign=-1)
    assert [(e.strain, e.below) for e in back.events] == [(-e.strain, -e.below) for e in path.events]
    whole = path._replace(steps=path.steps[:-1])
    ahead = whole.forecasts
    assert ahead and whole._replace(sign=-1).forecasts == tuple(one.signed(-1) for one in ahead)


def test_a_killed_path_continues_with_the_same_bits(tmp_path):
    state, calls = packing(SMOOTH, 3), []
    whole = ss.protocols.shear_to_failure(state, SMOOTH, until=6e-3, step=1e-3)

    def stop(stage, share, text):
        calls.append(text)
        if len(calls) == 3:
            raise KeyboardInterrupt

    kept = Checkpoint(tmp_path, "text", (PathStep, Event, EventKind))
    with pytest.raises(KeyboardInterrupt):
        ss.protocols.shear_to_failure(state, SMOOTH, until=6e-3, step=1e-3, kept=kept, report=stop)
    assert kept.names == [f"strain-{k:06d}" for k in range(3)]  # what was reported is there
    again = ss.protocols.shear_to_failure(state, SMOOTH, until=6e-3, step=1e-3, kept=kept)
    for a, b in zip(whole.steps, again.steps, strict=True):
        assert a.stress == b.stress and a.growth == b.growth and a.loss_ahead == b.loss_ahead
        assert a.state.grains.position.tobytes() == b.state.grains.position.tobytes()
        assert a.state.contacts.slip.tobytes() == b.state.contacts.slip.tobytes()
    assert whole.end == again.end


def test_the_command_takes_every_input_and_resumes(few_spheres, tmp_path, request):
    state, law, _ = ss.io.read_packing(few_spheres)
    ss.io.write_packing(tmp_path / "packing.h5", state, law)
    ss.io.write_packing(tmp_path / "packing.data", state, law)
    lammps = ["--law", "hertz_mindlin", "--kn", "1", "--kt", "0.2857142857142857", "--mu", "10", "--coulomb", "smooth"]
    curves = []
    for name, options in ((few_spheres, []), ("packing.h5", []), ("packing.data", [*lammps, "--settle"])):
        out = f"out-{len(curves)}"
        how = ["--until", "2e-4", "--step", "1e-4", "--out", out, "--json"]
        done = stickslip_here("shear", name, *options, *how, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["command"] == "shear"
        request.getfixturevalue("plain_figures")  # those of the first are drawn
        with (tmp_path / out / "curve.csv").open() as file:
            curves.append([float(row["strain"]) for row in csv.DictReader(file)])
        assert {"events.csv", "pairs.csv", "contacts.csv", "forecasts.csv", "fig1_path.png", "report.html"} <= {
            path.name for path in (tmp_path / out).iterdir()
        }
    assert curves[0] == curves[1] == curves[2] == [0.0, 1e-4, 2e-4]
    assert "nothing to resume" in stickslip_here("resume", "out-0", cwd=tmp_path).stdout
    pages = [(tmp_path / f"out-{k}" / "report.html").read_text() for k in range(3)]
    assert all("Decisive contacts" in page and "strain 0.0002" in page for page in pages)


@pytest.mark.usefixtures("plain_figures")
def test_a_killed_command_continues_without_its_input(few_spheres, tmp_path, monkeypatch):
    from stickslip.wings.studies.failure import simulate

    source = tmp_path / "packing.npz"
    source.write_bytes(few_spheres.read_bytes())
    how = ["shear", source, "--until", "2e-4", "--step", "1e-4", "--out", tmp_path / "run"]

    def killed(*given, **more):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(simulate, "shear_to_failure", killed)
        done = stickslip_here(*how)
    assert done.returncode == 130 and "stickslip resume" in done.stderr
    source.unlink()
    done = stickslip_here("resume", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    assert "the path ended as requested" in done.stdout


@pytest.fixture
def refused(tmp_path):
    """Write packings that cannot be sheared, by name."""

    def write(name):
        law, path = ss.laws.hertz_mindlin(mu=0.3), tmp_path / "packing.npz"
        state = packing(law, 3, 0.88)
        if name == "unbalanced":
            position = state.grains.position.copy()
            position[0, 0] += 1e-3
            state = state._replace(grains=state.grains._replace(position=position))
        elif name == "apart":
            state = ss.packings.from_arrays([[0, 0], [2, 0]], [0.5, 0.5], law, dim=2, cell=[5.0, 5.0])
        elif name == "rattlers":
            state = ss.packings.from_arrays([[0, 0], [1.0, 0], [3, 3]], 0.5, law, dim=2, cell=[6.0, 6.0])
        elif name == "open":
            state = ss.packings.from_arrays([[0, 0], [0.999, 0]], [0.5, 0.5], law, dim=2)
        ss.io.write_packing(path, state, law)
        return path

    return write


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("unbalanced", [], "not in equilibrium"),
        ("apart", [], "has no contacts"),
        ("open", [], "must be periodic in all dimensions"),
        ("fine", ["--until", "soon"], "first-pair, first-event, first-break or a strain"),
        ("fine", ["--until", "0"], "until must be a nonzero strain, first-pair, first-event or first-break, got 0"),
        ("fine", ["--until", "nan"], "'first-break', or a finite number"),
        ("fine", ["--until", "1e-3", "--reverse"], "size and sign"),
        ("fine", ["--until", "1e-3", "--step", "1e-2"], "step must be between"),
        ("fine", ["--step", "-1"], "step"),
        ("fine", ["--step", "10"], "step must be at most 0.1, got 10"),
        ("fine", ["--mode", "torsion"], "simple"),
        ("fine", ["--law", "linear", "--kn", "1", "--kt", "1"], "not in equilibrium"),
        ("missing", [], "missing.npz"),
    ],
)
def test_what_cannot_be_sheared_is_refused_in_a_sentence(name, options, said, refused, tmp_path):
    path = tmp_path / "missing.npz" if name == "missing" else refused(name)
    done = stickslip_here("shear", path, *options, "--out", tmp_path / "out")
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert said in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def signs(strain, **more):
    n = len(strain)
    usual = {"softest": np.full(n, 1.0), "loss_ahead": np.full(n, np.inf), "couples": [np.zeros((0, 3))] * n}
    return Signs(strain=strain, **usual | {"pairs": np.zeros(n, int), "events": np.zeros(0)} | more)


def test_forecasts_are_exact_where_their_laws_hold():
    strain = np.linspace(0, 0.9, 10)
    left = 1 - strain
    value = np.array([np.roots([0.5, 1.0, 0.0, -d]).real.max() for d in left])  # d = λ² + λ³/2
    for basis, known in (
        (SADDLE, signs(strain, softest=value)),
        (CONTACT, signs(strain, loss_ahead=left)),
        (PAIR, signs(strain, couples=[np.array([[5.0, d, 0.9], [9.0, 1.0, 0.6]]) for d in left])),
    ):
        _, found = extrapolations(known, basis)
        assert len(found) >= 3
        np.testing.assert_allclose(found, 0.1, rtol=1e-6)
        (one,) = forecast(known)
        assert one.of == ("pair" if basis == PAIR else "event") and one.basis == basis
        assert one.made == pytest.approx(0.9) and one.made < one.low < one.high
        assert one.signed(-1).strain == -one.strain


def test_nothing_is_forecast_from_a_flat_or_short_path():
    strain = np.linspace(0, 0.9, 10)
    rising = signs(strain, softest=1 + strain)
    assert (
        forecast(signs(strain)) == forecast(rising) == forecast(signs(strain[:1])) == forecast(signs(strain[:0])) == []
    )


def test_forecasts_begin_anew_after_an_event():
    """What was measured before a jump says nothing about the next one; events before it still count."""
    parts = {"softest": 1.0, "loss_ahead": np.inf, "couples": np.zeros((0, 3)), "pairs": 0}
    steps = [SimpleNamespace(strain=-k, events=(), **parts) for k in range(6)]
    steps[1].events = (SimpleNamespace(strain=0.5),)
    steps[3].events = (SimpleNamespace(strain=2.5),)
    found = signs_of(steps)
    assert found.strain.tolist() == [3, 4, 5] and found.events.tolist() == [0.5, 2.5]
