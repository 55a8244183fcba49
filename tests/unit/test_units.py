"""Units stand once, beside the fields: archives store what is documented there, with the right dimensions in SI."""

import ast
import importlib
import re
import typing
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import stickslip as ss
from stickslip.cli import app
from stickslip.core.units import (
    SI,
    Fields,
    Units,
    in_readable_units,
    in_si,
    in_units,
    unit_name,
    units_from,
    units_in_use,
    units_of,
)
from stickslip.data import archive
from stickslip.data.exchange.files import packing_units
from stickslip.experiments.registry import EXPERIMENTS, read_tables
from stickslip.figures.scene import quantities, view_data
from stickslip.loading.event_class import Events
from stickslip.runs import page
from stickslip.runs.folder import write_result

PACKAGE = Path(ss.__file__).parent
BASE = {  # exponents of mass, length and time
    "m": (0, 1, 0), "s": (0, 0, 1), "kg": (1, 0, 0), "N": (1, 1, -2), "J": (1, 2, -2), "Pa": (1, -1, -2),
    "W": (1, 2, -3), "rad": (0, 0, 0), "1": (0, 0, 0), "length": (0, 1, 0), "time": (0, 0, 1), "mass": (1, 0, 0),
    "force": (1, 1, -2), "energy": (1, 2, -2), "stress": (1, -1, -2),
}  # fmt: skip


def exponents(unit: str) -> tuple:
    """(M, L, T) of a unit such as kg m^2 or length/time^2."""
    total = np.zeros(3, int)
    above, _, below = unit.partition("/")
    for side, sign in ((above, 1), (below, -1)):
        for word in side.split():
            name, _, power = word.partition("^")
            total += sign * int(power or 1) * np.array(BASE[name])
    return tuple(total.tolist())


@cache
def classes() -> list[tuple]:
    """All NamedTuple classes of the package, with the text of their definitions."""
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
    return [
        (path, node, text.splitlines())
        for path, text in texts.items()
        for node in (ast.parse(text).body if "(NamedTuple" in text or "NamedTuple)" in text else ())
        if isinstance(node, ast.ClassDef) and any("NamedTuple" in ast.unparse(base) for base in node.bases)
    ]


def documented(node, lines) -> dict[str, set[str]]:
    """Units in the comment beside each field, or in the first line of the docstring."""
    whole = set(re.findall(r"\[([^\]]+)\]", (ast.get_docstring(node) or " ").splitlines()[0]))
    values = {}
    for field in node.body:
        if isinstance(field, ast.AnnAssign):
            comment = lines[field.end_lineno - 1].partition("#")[2]
            values[field.target.id] = set(re.findall(r"\[([^\]]+)\]", comment)) or whole
    return values


# in brackets in comments, but not units
NO_UNITS = {"value, unit", "2", "0", "A + B cos(2 ω_r t + φ)", "degrees", "of the drive", "mm", "bytes"}


# 3 s: every module of the package is imported and read
def test_archives_store_the_documented_units_of_all_classes(tmp_path):
    """One float for each field of each class; what has two units, as velocities beside spins, has none."""
    checked, tree, meant = 0, {}, {}
    for path, node, lines in classes():
        name = ".".join(("stickslip", *path.relative_to(PACKAGE).with_suffix("").parts))
        kind = getattr(importlib.import_module(name), node.name)
        key = f"{name}:{node.name}"
        tree[key] = Fields(dict.fromkeys(kind._fields, 0.5), kind)
        for field, units in documented(node, lines).items():
            if len(units := units - NO_UNITS) == 1:
                meant[f"{key}/{field}"] = units.pop().replace("²", "^2").replace("³", "^3").replace("−", "-")
                checked += 1
    archive.write(tmp_path / "a.h5", tree)
    assert archive.units(tmp_path / "a.h5") == meant
    assert checked > 300
    archive.write(tmp_path / "b.h5", tree, units=SI)
    for place, unit in archive.units(tmp_path / "b.h5").items():
        assert "length" not in unit and "force" not in unit and "time" not in unit
        if not {"dim", "amplitude", "ns", "steps"} & set(re.findall("[a-z]+", meant[place])):
            assert exponents(unit) == exponents(meant[place]), place


def test_a_field_has_the_unit_of_its_own_class(tmp_path):
    """The same name has other units elsewhere: work against drag in a ledger, the mean over a window in a fit."""
    archive.write(tmp_path / "a.h5", {"piece": Events(**dict.fromkeys(Events._fields, 0.5))})
    units = archive.units(tmp_path / "a.h5")
    assert units["piece/drag"] == "1/time"
    state = ss.packings.disk_array(2, press=1e-5)
    for si, force, stress, time in ((False, "force", "force/length^(dim-1)", "time"), (True, "N", "Pa", "s")):
        archive.write(tmp_path / "b.h5", {"state": state}, units=SI if si else None)
        units = archive.units(tmp_path / "b.h5")
        told = [units.get(f"state/control/{name}") for name in ("force", "stress", "rate")]
        assert told == [force, stress, None]  # `rate` holds velocities and spins
        assert units["state/time"] == time


def test_stored_names_of_a_table_have_units(tmp_path):
    """Dictionaries have the units of the fields that they are made of, and no others."""
    archive.write(tmp_path / "a.h5", {"rows": Fields({"time": 1.0, "drag": 2.0, "x": 3.0}, Events, x="1")})
    archive.write(tmp_path / "b.h5", {"rows": {"time": 1.0, "pressure": 2.0}})
    assert archive.units(tmp_path / "a.h5") == {"rows/drag": "1/time", "rows/x": "1"}
    assert archive.units(tmp_path / "b.h5") == {}


@pytest.mark.parametrize(
    ("unit", "si"),
    [("length/time", "m/s"), ("rad/time", "rad/s"), ("mass length^2", "kg m^2"), ("force/length^(dim-1)", "Pa"),
     ("force length", "N m"), ("1/time^2", "1/s^2"), ("energy/length", "J/m"), ("m/s", "m/s"), ("1", "1")],
)  # fmt: skip
def test_units_in_si(unit, si):
    assert in_si(unit) == si


def test_a_table_for_notebooks_shows_units():
    state = ss.packings.disk_array(2, press=1e-5)
    assert "[length/time]" in state.grains._repr_html_()
    assert units_of(int) == units_of(typing.NamedTuple("Own", [("x", float)])) == {}


def test_what_grains_are_coloured_by_has_its_unit():
    """A number per length in two dimensions, per area in three; Pa only where there is an area."""
    law = ss.laws.hertz_mindlin_reff(2.0, 1.5, 0.2)
    told = {}
    for dim in (2, 3):
        place = np.array([[0, 0, 0], [0.99, 0, 0]])[:, :dim]
        frame = ss.io.frame_of(ss.packings.from_arrays(place, [0.5, 0.5], law, dim=dim), law)
        before = ss.io.frame_of(frame.state, law)
        for si in (False, True):
            with units_in_use(SI if si else None):
                told[dim, si] = {name: unit for name, (_, unit) in quantities(frame, first=before).items()}
    bare = {"material": "", "coordination": "", "sliding contacts": ""}
    own = {"radius": "length", "speed": "length/time", "displacement": "length"} | bare
    real = {"radius": "m", "speed": "m/s", "displacement": "m"} | bare
    assert told[2, False] == own | {"pressure": "force/length"}
    assert told[3, False] == own | {"pressure": "force/length²"}
    assert told[2, True] == real | {"pressure": "N/m"}
    assert told[3, True] == real | {"pressure": "Pa"}


def test_the_pressure_of_a_grain_is_force_times_lever_over_its_volume():
    """p = (1/(3 V)) Σ F l, with l from the centre to the contact: the branch's share by radius, all of it at a wall."""
    law, small, large, overlap = ss.laws.hertz_mindlin_reff(2.0, 1.5, 0.2), 0.3, 0.6, 0.01
    place = [[0, 0, small - overlap], [0, 0, 2 * small + large - 2 * overlap]]
    state = ss.assembly(ss.spheres(place, [small, large]), ss.flat_walls([0, 0, 0], [0, 0, 1]))
    state = ss.accept(state, ss.forces(state, law)[1])
    fields = quantities(ss.io.frame_of(state, law))["pressure"][0]
    at_wall, between = (2.0 * overlap * np.sqrt(overlap * r) for r in (small, small * large / (small + large)))
    branch = small + large - overlap
    levers = [at_wall * (small - overlap) + between * branch * small / (small + large), between * branch * 2 / 3]
    volumes = [4 / 3 * np.pi * r**3 for r in (small, large)]
    np.testing.assert_allclose(fields, np.array(levers) / volumes / 3, rtol=1e-11)  # round-off of an overlap of 0.01


MILLIMETRES = {"length": "mm", "mass": "g", "time": "s"}
FLOW = {
    "experiment": "flow", "grains": {"number": 3, "mass": 1.0, "low": (0.0, 0.0), "high": (5.0, 5.0)},
    "law": {"kn": 1e3}, "gravity": (0.0, -1.0), "walls": [{"name": "floor", "point": (0.0, 0.0), "normal": (0.0, 1.0)}],
    "stages": [{"name": "fall", "duration": 0.2}], "samples": 5, "frames": 2,
}  # fmt: skip


@pytest.mark.parametrize(
    ("unit", "named", "plane"),
    [("force", "g mm/s^2", "g mm/s^2"), ("force/length^(dim-1)", "g/(mm s^2)", "g/s^2"), ("1", "1", "1"),
     ("energy", "g mm^2/s^2", "g mm^2/s^2"), ("force/length", "g/s^2", "g/s^2"), ("1/time^2", "1/s^2", "1/s^2"),
     ("rad/time", "rad/s", "rad/s"), ("stress/length", "g/(mm^2 s^2)", "g/(mm s^2)"), ("load", "load", "load"),
     ("1/(length time)^2", "1/(mm^2 s^2)", "1/(mm^2 s^2)")],
)  # fmt: skip
def test_units_of_other_quantities_are_products(unit, named, plane):
    assert in_units(unit, units_from(MILLIMETRES)) == named
    assert in_units(unit, units_from(MILLIMETRES, dim=2)) == plane
    assert in_units(unit, None) == unit


def test_products_have_the_right_dimensions():
    """With three names that are the dimensions themselves, a product is the quantity in mass, length and time."""
    for _, node, lines in classes():
        for units in documented(node, lines).values():
            for unit in units - NO_UNITS:
                text = in_units(unit.replace("²", "^2").replace("−", "-"), Units("length", "mass", "time"))
                if not {"dim", "amplitude", "ns", "steps"} & set(re.findall("[a-z]+", unit)) and "(" not in text:
                    assert exponents(text) == exponents(unit.replace("²", "^2").replace("−", "-")), unit


@pytest.mark.parametrize(
    "given", ["SII", "m, kg", {"length": "m"}, ["m", "m", "s"], ["m", "k g", "s"], ["m", "$", "s"], 5]
)
def test_other_units_are_refused_in_one_sentence(given):
    with pytest.raises(ValueError, match=r'^units must be "SI", or names of length, mass and time as in ') as caught:
        units_from(given)
    with pytest.raises(ValueError) as again:
        ss.scenario(units=given)
    assert str(caught.value) == str(again.value)


def test_units_of_a_scenario_change_its_text_but_no_number():
    bare, named = ss.scenario(**FLOW), ss.scenario(**FLOW, units="SI")
    assert "units" not in bare.text and bare.named_units is None
    assert named.digest != bare.digest
    assert named.named_units == SI._replace(dim=2)
    tables = named.model_dump(mode="json")
    assert tables.pop("units") == "SI" and tables == bare.model_dump(mode="json")
    again = ss.scenario(**FLOW, units=MILLIMETRES)
    assert ss.scenario(**again.model_dump()) == again and str(again.named_units) == "mm, g, s"


@pytest.mark.parametrize("name", ["fault", "gouge", "rate_state"])
def test_experiments_in_si_refuse_other_units(name):
    tables = read_tables(PACKAGE.parents[1] / "examples" / f"{name}.toml")
    assert ss.scenario(**tables, units="SI").named_units == ss.scenario(**tables).named_units == SI
    with pytest.raises(ValueError, match="which is always in SI units: leave them out"):
        ss.scenario(**tables, units=MILLIMETRES)


@pytest.fixture(scope="module")
def flows(tmp_path_factory):
    """Folders of the same flow without units and with names for them, and the labels of its figures as drawn."""
    out, labels = {}, {}

    def savefig(figure, *_, **__):
        words = (text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()))
        labels[name].update(re.sub(r"\$10\^.*?\$ ", "", " ".join(text.split())) for text in words)  # no powers of ten

    with pytest.MonkeyPatch.context() as now:
        now.setattr(Figure, "savefig", savefig)
        for name, more in {"bare": {}, "named": {"units": MILLIMETRES}}.items():
            out[name], labels[name] = tmp_path_factory.mktemp(name), set()
            write_result(out[name], EXPERIMENTS["flow"], ss.simulate(ss.scenario(**FLOW, **more)))
    return out | {"labels": labels}


def test_a_run_names_its_units_everywhere(flows):
    bare, named = (archive.units(flows[name] / "results.h5") for name in ("bare", "named"))
    assert {name: in_units(unit, units_from(MILLIMETRES, dim=2)) for name, unit in bare.items()} == named
    assert named["series/kinetic_energy"] == "g mm^2/s^2"
    trees = [archive.read(flows[name] / "results.h5") for name in ("bare", "named")]
    assert [tree["measures"]["run_out"]["unit"] for tree in trees] == ["length", "mm"]
    assert trees[1]["units"] == "mm, g, s"
    for name in ("bare", "named"):
        series = (flows[name] / "series.csv").read_text().splitlines()
        assert series[0].startswith({"bare": "time,", "named": "time [s],"}[name])
        assert series[1] == (flows["bare"] / "series.csv").read_text().splitlines()[1]


def test_a_page_names_the_units_of_its_run(flows):
    for name, speed, time in (("bare", "length/time", "time 0.1992,"), ("named", "mm/s", "time 0.1992 s,")):
        folder = flows[name]
        app(["report", str(folder), "--no-verdict", "-q"], standalone_mode=False)
        text = (folder / "report.html").read_text()
        assert f'<td class="">{"mm" if name == "named" else "length"}</td>' in text  # of the measure run_out
        with units_in_use(packing_units(folder)):
            shown = page.folder_content(folder, search=False)
            data = view_data(shown.frames, shown.modes, labels=shown.labels)
        assert time in shown.labels[-1]
        assert speed in {quantity["unit"] for quantity in data["quantities"]}


def test_labels_of_figures_name_units(flows):
    words = {"$x$ [diameters]", "speed [diameters / time unit]", "energy [units of energy]"}
    assert {*words, "time $t$ [units of time]"} <= flows["labels"]["bare"]
    assert {"$x$ [mm]", "speed [mm/s]", "energy [g mm²/s²]", "time $t$ [s]"} <= flows["labels"]["named"]


def test_formulas_in_labels_stay_as_they_are():
    with units_in_use("SI"):
        assert unit_name(r"$(2\sigma_1)^2$") == r"$(2\sigma_1)^2$"
        assert unit_name("length^2") == "m²"


def test_packings_have_units_as_well(few_spheres, tmp_path, capsys):
    source = np.load(few_spheres)
    np.savez(tmp_path / "named.npz", **source, units="mm, g, s")
    told = {}
    for path in (few_spheres, tmp_path / "named.npz"):
        app(["stability", str(path), "--modes", str(tmp_path / "m.npz"), "-q"], standalone_mode=False)
        told[path.stem] = capsys.readouterr().out.strip()
        more = ["--after", "--more"] if path.stem == "named" else []
        app(["stability", str(path), "--modes", str(tmp_path / "m.npz"), *more], standalone_mode=False)
        table = " ".join(capsys.readouterr().out.split())
        for text in ("period [s]", "growth rate [1/s]", "moduli in g/(mm s²)", " mm"):
            assert (text in table) == (path.stem == "named"), text
    assert re.sub(r"(period|time) ([\d.e+]+)", r"\1 \2 s", told["few_spheres"]) == told["named"]
    np.savez(tmp_path / "wrong.npz", **source, units="furlongs")
    with pytest.raises(
        ValueError,
        match=r"wrong.npz: units must be \"SI\", .*, three different words of up to 12 letters, got 'furlongs'",
    ):
        app(["stability", str(tmp_path / "wrong.npz")], standalone_mode=False)
    app(["convert", str(tmp_path / "named.npz"), "--to", str(tmp_path / "again.npz"), "-q"], standalone_mode=False)
    app(["convert", str(tmp_path / "named.npz"), "--to", str(tmp_path / "again.h5"), "-q"], standalone_mode=False)
    for name in ("again.npz", "again.h5"):
        assert str(packing_units(tmp_path / name)) == "mm, g, s"
    assert archive.units(tmp_path / "again.h5")["state/grains/velocity"] == "mm/s"


def test_long_times_in_seconds_are_shown_in_years():
    year = 365.25 * 86400
    assert in_readable_units((60 * year, 80 * year), "s") == ((60.0, 80.0), "years")
    assert in_readable_units((-80 * year, 0.0), "s") == ((-80.0, 0.0), "years")
    assert in_readable_units((300.0,), "s") == ((300.0,), "s")
    assert in_readable_units((1e12,), "m") == ((1e12,), "m")


def test_a_page_shows_the_recurrence_of_earthquakes_in_years():
    saved = {"recurrence": {"value": 80 * 365.25 * 86400, "unit": "s"}, "duration": {"value": 72.0, "unit": "s"}}
    assert page._list_measures({"measures": saved}, {}) == [["recurrence", "80", "years"], ["duration", "72", "s"]]


def test_a_fault_says_its_time_in_years():
    fault = ss.friction.line_fault(1e3, 100.0, a=0.01, b=0.015, dc=1e-2, normal=5e7)
    state = ss.friction.initial_state(fault)
    assert "at 0 s" in str(state)
    assert "at 80 years" in str(state._replace(time=80 * 365.25 * 86400))
