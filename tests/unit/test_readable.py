"""Values print themselves in a few lines, in a terminal and in a notebook."""

import copy
import html
import inspect
import pickle
import re

import numpy as np
import pytest
from pydantic import Field

import stickslip as ss
from stickslip.core.readable import LINE_WIDTH, MAX_LINES, format_value
from stickslip.data.schema import ScenarioBase, ScenarioTable, given_keys

LAW = ss.laws.hertz_mindlin(kn=1.0, kt=2 / 7, mu=10.0, coulomb="smooth")


@pytest.fixture(scope="module")
def state():
    grains = ss.spheres(np.random.default_rng(0).uniform(0, 10, (500, 3)), 0.5)
    return ss.assembly(grains, cell=ss.box([10, 10, 10], periodic=(True, True, True)))


class Table(ScenarioTable):
    size: float = Field(1.0, description="of what it holds [length]")


class Scenario(ScenarioBase):
    experiment: str = "toy"
    inner: Table = Table(size=2.0)
    several: tuple[Table, ...] = ()


def test_keys_of_a_scenario_that_differ_from_its_own_defaults():
    """Those of a table may differ from the defaults of its class; entries of lists count from 1, as in sweeps."""
    assert list(given_keys(Scenario())) == []
    row = "length", "of what it holds"
    assert list(given_keys(Scenario(inner=Table(size=1.0)))) == [("inner.size", 1.0, *row)]
    assert list(given_keys(Scenario(several=(Table(), Table(size=3.0))))) == [("several.2.size", 3.0, *row)]


def cells(value) -> list[list[str]]:
    """Rows of the table that a notebook shows, as text."""
    rows = re.findall("<tr>(.*?)</tr>", value._repr_html_(), re.DOTALL)
    return [[html.unescape(cell) for cell in re.findall("<td[^>]*>(.*?)</td>", row, re.DOTALL)] for row in rows]


def types():
    """All public types that are tuples with names."""
    spaces = [ss, *(getattr(ss, n) for n in ss.__all__ if inspect.ismodule(getattr(ss, n)))]
    return sorted(
        {
            thing
            for space in spaces
            for name in space.__all__
            if inspect.isclass(thing := getattr(space, name)) and issubclass(thing, tuple)
        },
        key=lambda thing: thing.__name__,
    )


def test_no_type_prints_the_generic_tuple():
    for kind in types():
        assert "readable" in kind.__repr__.__code__.co_filename, kind
        assert hasattr(kind, "_repr_html_"), kind


def test_the_repr_of_a_large_value_stays_short():
    path = ss.results.Ledger(*[np.arange(1e5)] * len(ss.results.Ledger._fields))
    for text in (repr(path), str(path)):
        assert len(text) < 1000
        assert len(text.splitlines()) <= MAX_LINES
        assert max(map(len, text.splitlines())) <= LINE_WIDTH


def test_nouns_say_how_many(state):
    assert repr(state) == "State: 500 spheres in a periodic cell, contacts not yet searched, t = 0"
    assert repr(state.grains) == "Grains: 500 grains, radii 0.5 to 0.5, mass 500"
    assert repr(state.cell) == "Cell: 3 dimensions, 10 × 10 × 10, periodic along xyz"
    assert repr(LAW) == "Law: hertz_mindlin, smooth Coulomb, kn = 1, kt = 0.285714, mu = 10"
    assert "500 bodies" in repr(state.control)


def test_a_state_is_drawn_in_a_notebook(state):
    page = state._repr_html_()
    assert page.count("<circle") == 500
    assert "500 spheres" in page
    assert len(page) < 100_000


def test_what_stands_in_a_table_is_escaped():
    outcome = ss.Outcome(ss.Status.DONE, 0.0, 1, how="<b>")
    assert "<b>" not in outcome._repr_html_()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.zeros((5, 3)), "0 (5 × 3 values)"), (1e-13, "1e-13"), (None, "none"), (True, "yes"),
        (ss.Status.DONE, "the run reached its last step"), ("x" * 100, "x" * 59 + "…"), ([1.0] * 50, "1 (50 values)"),
        ({"a": 1}, "a: 1"), (1 + 2j, "1+2j"), (np.arange(3), "0, 1, 2"), (np.zeros((0, 3)), "none"),
        (np.array([np.nan, 1, np.inf, 2, 3.5]), "1 to 3.5 (5 values, 2 undefined or infinite)"),
        (np.full(5, np.nan), "undefined (5 values)"), (np.array([True, False, True]), "2 of 3"),
        (np.nan, "undefined"), (np.array([3 + 4j] * 5), "modulus 5 (5 values)"),
        (np.eye(2), "1, 0; 0, 1"), (np.array(2.5), "2.5"),
    ],
)  # fmt: skip
def test_one_value(value, text):
    assert format_value(value) == text


def test_a_scenario_names_what_differs_from_its_defaults():
    chosen = ss.scenario(array={"disks": 5}, load={"push": (0.0, 0.05)}, dynamics={"loads": (0.03,)})
    assert repr(chosen).startswith("DiskArrayScenario: disk-array, array.disks = 5, load.push = 0, 0.05")
    assert ["load.push", "0, 0.05", "[unit]", "turning points of the quasi-static load path"] in cells(chosen)
    assert len(repr(ss.scenario(dynamics={"loads": tuple(np.linspace(0, 0.09, 999))}))) < 1000


# types and shapes of arrays, assignments to names with an underscore, digests
TECHNICAL = r"float64|int\d\d|complex128|dtype|\(\d+, \d+\)|[a-z]_[a-z_]* ?=|[0-9a-f]{16}"


@pytest.fixture(scope="module")
def jammed():
    return ss.packings.jammed(50, packing_fraction=0.7, seed=1)


def test_tables_are_for_people(state, jammed):
    """Quantities in words, with their numbers; no names of fields, types of arrays, or digests."""
    packed, info = jammed
    law = ss.laws.hertz_mindlin(mu=0.5)
    _, record, outcome = ss.run(packed, law, 20, 0.05, every=10)
    sweep = ss.sweep(experiment="gouge", sweep={"grains.density": {"linspace": [2000, 3000], "number": 20}})
    values = [state, packed, packed.grains, packed.contacts, packed.control, packed.cell, info, law, record, outcome]
    values += [ss.spectrum(packed, law), ss.stability(packed, law), sweep, ss.freedom(packed), ss.scenario()]
    for value in values:
        for text in (value._repr_html_(), repr(value)):
            assert not re.search(TECHNICAL, text)
        assert not any("_" in row[0] for row in cells(value))
    shown = cells(packed)
    assert ["contacts that touch", "193"] in shown
    assert ["contacts that slide", "0", "", "at the Coulomb limit"] in shown  # there is no friction
    assert ["packing fraction", "0.7"] in shown
    smaller = ss.packings.strained(packed, -0.01 * np.eye(3))
    assert ["contacts that touch", "193", "", "when last evaluated"] in cells(smaller)
    assert "193 contacts (0 sliding) when last evaluated" in repr(smaller)
    assert ["cell", repr(packed.cell).removeprefix("Cell: "), "[length]"] in shown
    mean = f"{info.overlap:.4g} on average"
    assert ["largest overlap", f"{info.largest_overlap:.6g}", "[length]", mean] in cells(info)
    assert info.largest_overlap == ss.measure.overlaps(packed).max()
    assert repr(info) == "PackingInfo: packing fraction 0.7, pressure 0.004229, 193 contacts, 0 rattlers"


def test_a_table_of_stability_lists_growing_pairs():
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth"), 0, 1, mu=0.3)
    array = ss.packings.disk_array(10, press=5e-5, push=1.5e-5, gap=-1e-6)
    result = ss.stability(ss.equilibrate(array, law)[0], law)
    shown = dict(row[:2] for row in cells(result))
    assert shown["verdict"] == result.verdict
    assert len(result.pairs) == 2
    for k in range(2):
        period = f"period {2 * np.pi / result.frequency[k]:.4g}"
        assert shown[f"growing pair {k + 1}"] == f"{period}, e-folding time {1 / result.growth_rate[k]:.4g}"
    assert shown["rattlers"] == "0"


def test_a_law_lists_what_differs_by_pair_of_materials():
    law = ss.laws.for_pair(ss.laws.linear(2.0, 1.0, 0.5, damping_n=0.1), 0, 1, mu=0.2)
    shown = cells(law)
    assert ["kn", "2", "[force/length]", "normal stiffness"] in shown
    assert ["damping_n", "0.1", "[force time/length]", "normal dashpot"] in shown
    assert [row for row in shown if row[0].startswith("materials")] == [
        ["materials 0 and 0", "mu = 0.5"], ["materials 0 and 1", "mu = 0.2"], ["materials 1 and 1", "mu = 0.5"]
    ]  # fmt: skip


def test_a_sweep_says_what_varies_and_what_was_refused():
    tables = {"surface.a": {"linspace": [0.01, 0.02], "number": 5}, "surface.b": [0.012, 0.03]}
    grid = ss.sweep(experiment="rate-state", sweep=tables | {"where": "surface.a < surface.b"})
    shown = cells(grid)
    assert shown[0] == ["experiment", "rate-state"]
    assert ["members", "6"] in shown
    assert ["rejected points", grid.refusals] in shown
    assert grid.digest not in repr(grid) + grid._repr_html_()
    assert repr(grid).startswith("Sweep: 6 members of rate-state, surface.a = ")


def test_a_result_shows_its_measures():
    result = ss.simulate(ss.scenario(experiment="rate-state", spring={"stiffness": 50.0}))
    shown = cells(result)
    assert shown[0] == ["experiment", "rate-state", "", "a spring-slider with rate-and-state friction"]
    assert ["spring.stiffness", "50", "[1/m]"] in [row[:3] for row in shown]
    assert ["final velocity", f"{result.history.velocity[-1]:.6g}", "[m/s]"] in [row[:3] for row in shown]


def test_values_with_arrays_are_compared_entry_by_entry(state):
    """In the terms of numpy, the truth value of such a comparison would be ambiguous."""
    same = copy.deepcopy(state)
    assert state == same and (state != same) is False and state in [same]
    assert state != state._replace(time=1.0) and state != ss.packings.sheared(state, 1e-3) and state != 3
    assert ss.laws.linear() == ss.laws.linear() != ss.laws.linear(mu=0.1)
    found = ss.friction.Data(np.array([0.0, np.nan]), np.array([0.5, 0.6]))
    assert found == copy.deepcopy(found)
    surface = ss.friction.RateState(0.01, 0.015, 1e-5)
    assert surface in {surface._replace()} and surface == tuple(surface)
    pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], LAW)
    motion = ss.modes.equations_of_motion(pair, LAW)
    assert motion == pickle.loads(pickle.dumps(motion)), "with sparse matrices"
