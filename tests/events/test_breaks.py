"""Cemented packings on quasi-static paths: to the first break of a bond, and through it."""

import csv
import sys
from functools import partial

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.bonding import without_failure
from stickslip.core.contacts.jacobian import bond_blocks, contact_blocks
from stickslip.core.state import FAILURES
from stickslip.data.checkpoint import Checkpoint
from stickslip.loading.failure import CHANGES, PathStep
from stickslip.loading.settling import deformation
from stickslip.results import Event, EventKind
from stickslip.wings.studies.failure import simulate
from stickslip.wings.studies.failure.scenario import FailureScenario
from tests.conftest import stickslip_here
from tests.events.packings import packing

LAW = ss.laws.hertz_mindlin(mu=0.3)
solve_equilibrate = sys.modules["stickslip.solve.equilibrate"]  # `ss.equilibrate` is the function


@pytest.fixture(scope="module")
def cemented():
    state = packing(LAW, 3, 0.88)
    return ss.packings.bonded(state, ss.laws.parallel_bond(0.5, 0.2, 2e-4, 4e-4), within=0.05)


@pytest.fixture(scope="module")
def broken(cemented):
    """Path to just beyond the first break."""
    first = ss.modes.first_break(cemented, LAW, strain=[[0, 1], [0, 0]])
    return ss.protocols.shear_to_failure(cemented, LAW, until=1.05 * first.at, step=0.6 * first.at)


def test_the_first_break_is_where_equilibria_and_linear_response_say(cemented, broken):
    first, event = ss.modes.first_break(cemented, LAW, strain=[[0, 1], [0, 0]]), broken.events[0]
    assert event.kind is EventKind.BREAKING and event.trigger == first.pair == tuple(event.broken[0, :2])
    assert FAILURES[event.broken[0, 2]] == first.mode
    assert event.strain == pytest.approx(first.at, rel=2e-3)
    way = deformation("simple", 2)
    for strain, breaks in ((event.below, False), (event.strain, True)):
        end, _ = ss.equilibrate(way.apply(cemented, strain), LAW, check="nothing")
        assert breaks == (not end.bonds.intact.all())


def test_damped_dynamics_does_not_break_bonds_on_the_way(cemented, monkeypatch):
    """Only the equilibrium counts: the way to it is that of bonds that cannot break."""
    stalled = partial(solve_equilibrate.approach, iterations=0)
    monkeypatch.setattr(solve_equilibrate, "approach", stalled)
    first = ss.modes.first_break(cemented, LAW, strain=[[0, 1], [0, 0]])
    start = deformation("simple", 2).apply(cemented, 0.97 * first.at)
    end, outcome = ss.equilibrate(start, LAW, check="nothing")
    assert outcome.fallback and end.bonds.intact.all()
    strong, _ = ss.equilibrate(without_failure(start), LAW, check="nothing")
    assert np.array_equal(end.grains.position, strong.grains.position)


def test_the_path_goes_on_without_the_bonds_that_broke(cemented, broken):
    """Each step has the bonds that events left; breaks are among the changes of contacts, and the stress falls."""
    intact = len(cemented.bonds.i)
    for step in broken.steps:
        intact -= sum(len(event.broken) for event in step.events)
        assert step.bonds == intact == step.state.bonds.intact.sum() and step.bond_share < 1
        assert step.bond_share == pytest.approx(ss.measure.bond_shares(step.state).max())
    assert intact < len(cemented.bonds.i) and all(event.stress_drop > 0 for event in broken.events)
    lost = {tuple(row[:2]) for event in broken.events for row in event.broken.tolist()}
    opened = {tuple(c[1:]) for step in broken.steps for c in step.changes.tolist() if CHANGES[c[0]] == "opens"}
    assert opened <= lost
    rest, _ = ss.equilibrate(broken.steps[-1].state, LAW, check="nothing")
    np.testing.assert_allclose(rest.grains.position, broken.steps[-1].state.grains.position, atol=1e-9)


def test_a_path_that_is_killed_in_the_middle_continues_through_the_break_with_the_same_bits(cemented, broken, tmp_path):
    kept, calls = Checkpoint(tmp_path, "text", (PathStep, Event, EventKind)), []

    def stop(*about):
        calls.append(about)
        if len(calls) == 2:  # the break is in the step after
            raise KeyboardInterrupt

    how = {"until": broken.steps[-1].strain, "step": broken.step}
    with pytest.raises(KeyboardInterrupt):
        ss.protocols.shear_to_failure(cemented, LAW, **how, kept=kept, report=stop)
    again = ss.protocols.shear_to_failure(cemented, LAW, **how, kept=kept)
    for a, b in zip(broken.steps, again.steps, strict=True):
        assert a.stress == b.stress and a.bonds == b.bonds
        assert all(np.array_equal(x, y) for x, y in zip(a.state.bonds, b.state.bonds, strict=True))
    assert [e.broken.tolist() for e in again.events] == [e.broken.tolist() for e in broken.events]


def test_a_scenario_reads_a_cemented_packing_and_writes_its_breaks(cemented, broken, tmp_path, capsys):
    ss.io.write_packing(tmp_path / "cemented.h5", cemented, LAW)
    scenario = FailureScenario(
        packing={"file": str(tmp_path / "cemented.h5")}, shear={"until": "first-break", "step": broken.step}
    )
    found = simulate.simulate_failure(scenario)
    (i, j, how), event = broken.events[0].broken[0], broken.events[0]
    simulate.show(found)
    assert f"a bond broke: that of grains {i} and {j}, by {FAILURES[how]}" in " ".join(capsys.readouterr().out.split())
    last = found.found.steps[-1]._replace(events=(event,) * (simulate.SHOWN + 2))
    simulate.show(found._replace(found=found.found._replace(steps=(found.found.steps[0], last))))
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert "and 2 more in events.csv" in lines and "and 2 more in breaks.csv" in lines
    dict(simulate.files(found))["breaks.csv"](tmp_path / "breaks.csv")
    with (tmp_path / "breaks.csv").open() as file:
        row = next(csv.DictReader(file))
    assert (int(row["i"]), int(row["j"]), row["by"]) == (i, j, FAILURES[how])
    below, strain = float(row["below"]), float(row["strain"])
    assert (below, strain) == (found.found.events[0].below, found.found.events[0].strain)
    # the longer last step has other brackets, of the same width, around the same strain
    assert below < event.strain and event.below < strain and strain - below < 3e-3 * broken.step
    other = cemented._replace(bonds=cemented.bonds._replace(strength=2 * cemented.bonds.strength))
    packed = simulate.Packed(cemented, LAW, ())
    assert simulate.digest_of(packed) != simulate.digest_of(packed._replace(state=other))


def test_a_page_shows_a_cemented_packing(cemented, tmp_path):
    ss.io.write_packing(tmp_path / "cemented.h5", cemented, LAW)
    done = stickslip_here("report", "cemented.h5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "cemented-report.html").read_text(encoding="utf-8")
    assert "Sand-coloured bands are bonds" in text and "strong network and directions of contact forces" in text.lower()


def test_bonds_that_should_break_must_be_there(cemented):
    bare = ss.packings.without_bonds(cemented)
    with pytest.raises(ValueError, match="first-break requires intact bonds"):
        ss.protocols.shear_to_failure(bare, LAW, until="first-break")


def test_a_contact_that_opens_keeps_its_bond(cemented):
    """In the sensitivity to contacts, and in the switch test of events."""
    bare = contact_blocks(ss.packings.without_bonds(cemented), LAW)[0]
    whole, held = contact_blocks(cemented, LAW)[0], bond_blocks(cemented)
    np.testing.assert_allclose(whole[:, :6, :6] - held[:, :6, :6], bare, atol=1e-14)
    found = ss.modes.contact_sensitivity(cemented, LAW, most=2)
    assert {"opens", "breaks"} <= set(found.what) and (found.what == "breaks").sum() == cemented.bonds.intact.sum()
