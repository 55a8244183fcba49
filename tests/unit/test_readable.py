"""Values print themselves in a few lines, in a terminal and in a notebook."""

import inspect

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.readable import LINE_WIDTH, MAX_LINES, format_value

LAW = ss.laws.hertz_mindlin(kn=1.0, kt=2 / 7, mu=10.0, coulomb="smooth")


@pytest.fixture(scope="module")
def state():
    grains = ss.spheres(np.random.default_rng(0).uniform(0, 10, (500, 3)), 0.5)
    return ss.assembly(grains, cell=ss.box([10, 10, 10], periodic=(True, True, True)))


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


@pytest.mark.parametrize("kind", types(), ids=lambda kind: kind.__name__)
def test_no_type_prints_the_generic_tuple(kind):
    assert "readable" in kind.__repr__.__code__.co_filename
    assert hasattr(kind, "_repr_html_")


def test_a_large_value_stays_short_whatever_it_holds():
    path = ss.results.Ledger(*[np.arange(1e5)] * len(ss.results.Ledger._fields))
    for text in (repr(path), str(path)):
        assert len(text) < 1000
        assert len(text.splitlines()) <= MAX_LINES
        assert max(map(len, text.splitlines())) <= LINE_WIDTH


def test_nouns_say_how_many(state):
    assert repr(state) == "State: 500 spheres in a periodic cell, 0 contacts (0 sliding), t = 0"
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
    ("value", "words"),
    [
        (np.zeros((5, 3)), "float64 (5, 3)"), (1e-13, "1e-13"), (None, "None"), (True, "True"),
        (ss.Status.DONE, "DONE"), ("x" * 100, "x" * 59 + "…"), ([1.0] * 50, "50 float"), ({"a": 1}, "{'a': 1}"),
        (1 + 2j, "1+2j"), (np.arange(3), "[0 1 2]"),
    ],
)  # fmt: skip
def test_one_value(value, words):
    assert format_value(value) == words


def test_a_scenario_names_what_differs_from_its_defaults():
    one = ss.scenario(array={"disks": 5}, load={"push": (0.0, 0.05)}, dynamics={"loads": (0.03,)})
    assert repr(one).startswith(f"DiskArrayScenario {one.digest}: array = {{'disks': 5}}")
    assert len(repr(ss.scenario(dynamics={"loads": tuple(np.linspace(0, 0.09, 999))}))) < 1000
