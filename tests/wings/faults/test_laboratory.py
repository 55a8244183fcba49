"""Records as CSV: units, separators, round trip, and every refusal in one sentence."""

import re
import struct
import warnings

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from stickslip.wings.faults.friction.fitting import fit
from stickslip.wings.faults.friction.laboratory import LabRecord, read_record, record_columns, record_data, write_csv
from stickslip.wings.faults.friction.laws import RateState, Spring, spring_slider
from stickslip.wings.faults.friction.loads import velocity_steps
from tests.conftest import stickslip_here

HEAD = "time [s], load_point [um], friction [-]"
HEAD_BY_NAME = ("time [s]", "friction [-]", "load_point [um]")
ROWS = [f"{k}, {10 * k}, 0.6{k % 10}" for k in range(12)]


def written(path, head=HEAD, rows=ROWS, **options):
    path.write_text("\n".join([head, *rows]) + "\n", **options)
    return path


def test_units_separators_and_comments(tmp_path):
    rows = [f"{k / 60};{k / 100};{3.0 + 0.01 * k};5.0;{2 + k};left out" for k in range(12)]
    head = "Time [minutes]; Load Point Displacement [mm]; Shear Stress [MPa]; sigma_n [MPa]; slip rate [mm/min]; note"
    path = written(tmp_path / "a.csv", head, ["# a comment", *rows[:5], "", *rows[5:]], encoding="utf-8-sig")
    record = read_record(path)
    assert np.allclose(record.time, np.arange(12.0))
    assert np.allclose(record.load_point, 1e-5 * np.arange(12))
    assert np.allclose(record.friction, (3.0 + 0.01 * np.arange(12)) / 5.0)
    assert np.allclose(record.normal_stress, 5e6)
    assert np.allclose(record.velocity, 1e-3 / 60 * (2 + np.arange(12)))
    tabs = written(tmp_path / "b.csv", HEAD.replace(", ", "\t"), [row.replace(", ", "\t") for row in ROWS])
    assert np.allclose(read_record(tabs).load_point, 1e-5 * np.arange(12))


def test_decimal_commas_parentheses_and_files_of_windows(tmp_path):
    rows = [f"{k},5;{k / 10};-0,{k:02}e1" for k in range(12)]
    path = written(tmp_path / "a.csv", "time (s); load_point (µm); friction", rows, encoding="cp1252")
    record = read_record(path)
    assert np.allclose(record.time, np.arange(12) + 0.5)
    assert np.allclose(record.load_point, 1e-7 * np.arange(12))
    assert np.allclose(record.friction, -0.1 * np.arange(12))
    with pytest.raises(ValueError, match="not a number"):
        read_record(written(tmp_path / "b.csv", HEAD.replace(",", ";"), ["1.23,4;1;1", *["1;2;3"] * 11]))


def test_rows_with_empty_cells_are_left_out_and_reported(tmp_path):
    path = written(tmp_path / "a.csv", HEAD + ", note", [f"{row}, " for row in [*ROWS, "12, , 0.6", "13, 130, "]])
    with pytest.warns(UserWarning, match="2 of 14 rows lack a number .* the first is line 14"):
        record = read_record(path)
    assert len(record.time) == 12


@pytest.mark.parametrize("mark", ["nan", "NaN", "-9999", "-999.0"])
def test_cells_that_stand_for_no_number_are_left_out_and_counted(tmp_path, mark):
    """A displacement that passes -9999 is whole."""
    path = written(tmp_path / "a.csv", HEAD, [*ROWS, f"12, {mark}, 0.6", "13, 130, 0.6", f"14, {mark}, {mark}"])
    with pytest.warns(UserWarning, match=r"2 of 15 rows lack a number \(an .*\) and are skipped; the first is line 14"):
        record = read_record(path)
    assert np.array_equal(record.time, [*range(12), 13]) and record.load_point.max() == pytest.approx(1.3e-4)
    passing = [f"{k}, {-10019 + 10 * k}, 0.6" for k in range(12)]
    assert len(read_record(written(tmp_path / "b.csv", HEAD, passing)).time) == 12


def test_files_without_headers_need_the_numbers_of_columns(tmp_path):
    path = written(tmp_path / "a.csv", ROWS[0], ROWS[1:])
    record = read_record(path, columns={"time": 0, "load_point [um]": 1, "friction": 2})
    assert np.allclose(record.load_point, 1e-5 * np.arange(12))
    assert np.allclose(
        read_record(path, columns={"time": 0, "load_point": 1, "mu": 2}).load_point, 10.0 * np.arange(12)
    )
    with pytest.raises(ValueError, match="column 3 for 'mu' does not exist: the file has columns 0 to 2"):
        read_record(path, columns={"time": 0, "load_point": 1, "mu": 3})


def test_what_is_written_is_read_and_fitted(tmp_path):
    legs = velocity_steps([1e-6, 1e-5, 1e-6], distance=2e-4)
    rs, times = RateState(0.010, 0.006, 1e-5, 0.6, 1e-6), np.unique(np.r_[np.linspace(0, 420, 2001), 200.0, 220.0])
    h = spring_slider(rs, Spring(1e4), legs, times=times)
    record = LabRecord(h.time, h.friction, h.load_point, np.full(len(times), 5e6), h.slip, h.velocity, h.theta)
    again = read_record(write_csv(tmp_path / "a.csv", record, ("made by a test",)))
    for column, other in zip(record, again, strict=True):
        assert np.allclose(column, other, rtol=1e-11, atol=0)
    lab = record_data(again, normal=True)
    assert [leg.velocity for leg in lab.legs] == pytest.approx([1e-6, 1e-5, 1e-6])
    best = fit(lab, law="aging", fixed={"stiffness": 1e4})
    assert [best.values[name] for name in ("a", "b", "dc")] == pytest.approx([0.010, 0.006, 1e-5], rel=1e-4)
    measured = record_data(again._replace(load_point=None))
    assert measured.legs == ()
    assert np.array_equal(measured.velocity, again.velocity)


@pytest.mark.parametrize(
    ("head", "rows", "sentence"),
    [
        ("load_point [um], friction [-]", ["1, 2"] * 12, "no column for time"),
        ("time [s], load_point [um]", ["1, 2"] * 12, "no column for friction"),
        ("time [s], load_point [um], shear_stress [MPa]", ["1, 2, 3"] * 12, "'normal_stress [MPa]'"),
        ("time [s], friction [-]", ["1, 2"] * 12, "no column for load_point or velocity"),
        ("1, 2, 3", ROWS, "has no row of headings above its numbers"),
        ("time, load_point [um], friction [-]", ROWS, "'time' has no unit: write it as 'time [s]'"),
        ("time [s], load_point [furlong], friction [-]", ROWS, "load_point has the unit 'furlong': use m, cm, mm"),
        ("time [s], load_point [um], friction [%]", ROWS, "friction has the unit '%'"),
        (
            "time [s], load_point [um], friction [-], Friction",
            [row + ", 1" for row in ROWS],
            "two columns for friction",
        ),
        (HEAD, ROWS[:5], "has 5 rows"),
        (HEAD, [*ROWS, "12, 120"], "line 14, has 2 fields, but the header has 3"),
        (HEAD, [*ROWS, "12, 120, n/a"], "line 14: friction is 'n/a', not a number"),
        (HEAD, [*ROWS, "12, 1_20, 0.6"], "line 14: load_point is '1_20', not a number"),
        (HEAD, [*ROWS, "12, ١٢٠, 0.6"], "line 14: load_point is '١٢٠', not a number"),
        (HEAD, [row.replace(", 0.6", ", -0.6") for row in ROWS], "friction is negative throughout: is its sign rever"),
        (HEAD, [*ROWS, "12, inf, 0.6"], "line 14: load_point is inf, not a finite number"),
        (HEAD, [*ROWS, "11, 110, 0.6"], "time must increase, but sample 13"),
        (
            "time [s], load_point [um], tau [MPa], sigma_n [MPa]",
            [f"{k}, {k}, 1, 0" for k in range(12)],
            "must be positive",
        ),
        ("", [], "contains no data"),
        ("PK\x03\x04\x14\0", [], "is a spreadsheet: save its sheet as CSV"),
    ],
)
def test_refusals(tmp_path, head, rows, sentence):
    with pytest.raises(ValueError) as caught:
        read_record(written(tmp_path / "a.csv", head, rows))
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_binary_files_and_rest_at_the_start(tmp_path):
    (tmp_path / "a.csv").write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match="not a text file"):
        read_record(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_bytes(b"time\0\0\0")
    with pytest.raises(ValueError, match="binary"):
        read_record(tmp_path / "b.csv")
    resting = read_record(written(tmp_path / "c.csv", rows=[f"{k}, 0, 0.5" for k in range(12)]))
    with pytest.raises(ValueError, match="does not start with sliding"):
        record_data(resting)
    with pytest.raises(ValueError, match="no normal_stress"):
        record_data(resting, normal=True)


def test_the_command_line_reads_files_without_headers(tmp_path):
    rows = [f"{k},5;{10 * k};0,6{k % 10}" for k in range(40)]
    written(tmp_path / "a.csv", rows[0], [*rows[1:], "41;;0,6"])
    arguments = ("fit", "a.csv", "--stiffness", "1000", "--law", "slip", "-q")
    done = stickslip_here(*arguments, "--columns", "time=0,load_point [um]=1,friction=2", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stderr == (
        "stickslip: a.csv: 1 of 41 rows lack a number (an empty cell, nan or -9999) and are skipped; the first is "
        "line 41\n"
    )
    done = stickslip_here(*arguments, "--columns", "time", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1) and "NAME=NUMBER" in done.stderr


@pytest.mark.parametrize("missing", ["time", "friction", "load_point"])
def test_unusual_headers_are_listed_with_those_that_are_read(tmp_path, missing):
    texts = {"time": "elapsed [s]", "friction": "F/N", "load_point": "x_piston [mm]"}
    head = ", ".join(texts[name] if name == missing else field for name, field in zip(texts, HEAD_BY_NAME, strict=True))
    with pytest.raises(ValueError) as caught:
        read_record(written(tmp_path / "a.csv", head))
    said = str(caught.value)
    assert repr(texts[missing]) in said  # what was seen
    for name in {"time": ("time", "t"), "friction": ("mu", "shear_stress"), "load_point": ("lp_disp", "slip_rate")}[
        missing
    ]:
        assert name in said  # what is looked for
    assert "\n" not in said and len(said) < 700


def test_a_header_of_a_hundred_columns_is_shortened(tmp_path):
    head = ",".join(f"channel {k} of the amplifier in the cellar" for k in range(100))
    with pytest.raises(ValueError, match=r"'channel 0 of the amplifier in the cellar'.* and 9. more") as caught:
        read_record(written(tmp_path / "a.csv", head, [",".join(["1"] * 100)] * 12))
    assert len(str(caught.value)) < 900


def test_times_in_days_and_years(tmp_path):
    record = read_record(
        written(tmp_path / "a.csv", "time [yr], velocity [mm/yr], friction [-]", [f"{k}, 35, 0.6" for k in range(12)])
    )
    assert record.time[1] == 365.25 * 86400
    assert record.velocity[0] == pytest.approx(35e-3 / (365.25 * 86400))
    assert read_record(written(tmp_path / "b.csv", HEAD.replace("[s]", "[d]"))).time[1] == 86400
    rows = [f"{k};{k},5;0,6" for k in range(12)]
    for head in ("Zeit [min];Verschiebung [mm];Reibung", "temps [min];deplacement [mm];coefficient de frottement"):
        record = read_record(written(tmp_path / "c.csv", head, rows))
        assert (record.time[1], record.load_point[1], record.friction[1]) == (60, pytest.approx(1.5e-3), 0.6)


LAB = {"time_s": np.arange(20.0), "vdcdt_um": 10.0 * np.arange(20), "mu": 0.6 + 0.001 * np.arange(20),
       "effns_mpa": np.full(20, 5.0), "hstress_mpa": np.full(20, 6.0), "recnum": np.arange(20.0)}  # fmt: skip


def as_text(columns, mark, units=None, above=()):
    rows = [mark.join(columns), *([mark.join(units)] if units else [])]
    rows += [mark.join(f"{x:.6g}" for x in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join([*above, *rows]) + "\n"


def check_lab(record, *, metres=1e-6):
    assert np.allclose(record.time, LAB["time_s"]) and np.allclose(record.friction, LAB["mu"])
    assert np.allclose(record.load_point, metres * LAB["vdcdt_um"]) and np.allclose(record.normal_stress, 5e6)


@pytest.mark.parametrize("mark", [",", ";", "\t", " ", "   "])
def test_units_inside_names_and_every_separator(tmp_path, mark):
    (tmp_path / "a.txt").write_text(as_text(LAB, mark, above=["run 12 of the cellar", "operator: nobody"]))
    with pytest.warns(UserWarning, match="normal_stress is 'effns_mpa', not 'hstress_mpa'"):
        check_lab(read_record(tmp_path / "a.txt"))


def test_units_in_a_row_below_with_the_numbers_of_rows_as_xlook_writes_them(tmp_path):
    names = ("LP_disp", "Shr_stress", "Nor_stress", "Time", "mu")
    units = ("micron", "MPa", "MPa", "sec", ".")
    columns = (LAB["vdcdt_um"], 3 + 0.005 * LAB["time_s"], LAB["effns_mpa"], LAB["time_s"], LAB["mu"])
    lines = ["number of records =  20", "     " + "".join(f"{f'col {k + 1}':>12}" for k in range(5))]
    lines += ["     " + "".join(f"{word:>12}" for word in row) for row in (names, units, ["20 recs"] * 5)]
    lines += [f"{k:5d}" + "".join(f"{x:12.5f}" for x in row) for k, row in enumerate(zip(*columns, strict=True))]
    (tmp_path / "p.txt").write_text("\n".join(lines))
    check_lab(read_record(tmp_path / "p.txt"))


def look(path, channels=32, kind="<f8", cut=0, lengths=(), units=("mic", "MPa", "MPa", "sec", ".")):
    """Write a binary XLOOK file; kind is that of its numbers."""
    names = ("LP_disp", "Shr_stress", "Nor_stress", "Time", "mu")
    columns = (LAB["vdcdt_um"], 3 + 0.005 * LAB["time_s"], LAB["effns_mpa"], LAB["time_s"], LAB["mu"])
    content = struct.pack(">20s4i", b"p5760\0\x84M\x03", len(columns[0]), len(columns), 0, 0)
    for k in range(channels):
        used = k < len(columns)
        name, unit = (names[k], units[k]) if used else ("no_val", "no_val")
        length = (dict(lengths).get(k, len(columns[k]))) if used else 0
        content += struct.pack(">13s13si50si", name.encode(), unit.encode(), 7, b"\xff", length)
    content += b"".join(np.asarray(column, kind).tobytes()[cut * (k == 0) :] for k, column in enumerate(columns))
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8", ">f8"])
@pytest.mark.parametrize("channels", [16, 32])
def test_binary_files_of_xlook(tmp_path, channels, kind):
    found, lab = read_record(look(tmp_path / "p5760", channels, kind)), LAB["mu"]
    np.testing.assert_allclose(found.friction, lab, rtol=1e-6)  # of four bytes
    np.testing.assert_allclose(found.load_point, 1e-6 * LAB["vdcdt_um"], rtol=1e-6)
    np.testing.assert_allclose(found.normal_stress, 1e6 * LAB["effns_mpa"], rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"cut": 8}, "damaged XLOOK file"), ({"lengths": {1: 19, 2: 21}}, r"different lengths \(LP_disp 20, Shr"),
        ({"units": ("bits", "MPa", "MPa", "sec", ".")}, "'bits'"),
    ],
)  # fmt: skip
def test_binary_files_of_xlook_that_cannot_be_used_are_refused(tmp_path, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        read_record(look(tmp_path / "p5760", **options))


@pytest.mark.parametrize("kind", ["hdf5", "group", "table", "matlab", "structure", "matlab 7.3"])
def test_files_of_arrays(tmp_path, kind):
    columns = {name: column for name, column in LAB.items() if name != "hstress_mpa"}
    path = tmp_path / "record.dat"
    if kind == "matlab":
        savemat(path, columns)
    elif kind == "structure":
        savemat(path, {"p5760": columns})
    else:
        with h5py.File(path, "w") as file:
            place = file if kind != "group" else file.create_group("run")
            if kind == "table":
                table = np.array(list(zip(*columns.values(), strict=True)), [(name, float) for name in columns])
                file.create_dataset("table", data=table)
            else:
                for name, column in columns.items():
                    place[name] = column[None] if kind == "matlab 7.3" else column
    check_lab(read_record(path))


def test_units_in_attributes_and_samples_without_a_number(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, unit, column in (("time", "s", 0), ("load_point", "mm", 1), ("friction", "1", 2)):
            file[name] = np.array([[k, 0.01 * k, 0.6] for k in range(15)])[:, column]
            file[name].attrs["units"] = unit
        file["friction"][3] = np.nan
    with pytest.warns(UserWarning, match="1 of 15 rows lack a number .* the first is sample 4"):
        record = read_record(tmp_path / "a.h5")
    assert np.allclose(record.load_point, 1e-5 * np.delete(np.arange(15), 3))


def test_a_displacement_that_is_counted_backwards_is_turned_round(tmp_path):
    turned = LAB | {"vdcdt_um": 300 - LAB["vdcdt_um"]}
    turned.pop("hstress_mpa")
    (tmp_path / "a.txt").write_text(as_text(turned, ","))
    with pytest.warns(UserWarning, match="load_point is counted backwards: its sign was reversed"):
        record = read_record(tmp_path / "a.txt")
    assert np.allclose(np.diff(record.load_point), 1e-5)


def test_columns_are_chosen_by_number_or_heading_below_a_header(tmp_path):
    columns = dict(zip(("Sample", "LVDT 2 [um]", "F/N", "age"), list(LAB.values())[:4], strict=True))
    (tmp_path / "a.txt").write_text(as_text(columns, ","))
    chosen = {"time [min]": 0, "load_point": "LVDT 2 [um]", "friction": "F/N", "normal_stress [MPa]": 3}
    record = read_record(tmp_path / "a.txt", columns=chosen)
    check_lab(record._replace(time=record.time / 60))
    with pytest.raises(
        ValueError, match=r"column 'LVDT 3' for 'load_point' does not exist: the file has 'Sample', 'LVDT 2"
    ):
        read_record(tmp_path / "a.txt", columns=chosen | {"load_point": "LVDT 3"})


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda f: f.update(time_s=np.arange(20.0), vdcdt_um=np.arange(19.0), mu=np.ones(20)), "different lengths"),
        (
            lambda f: [f.create_group(g).update(time_s=np.arange(20.0)) for g in "ab"],
            "in 2 groups (a, b): keep only one",
        ),
        (lambda f: f.update(signal=np.arange(20.0)), "has no column for time"),
        (lambda f: f.update(label=np.array([b"x"] * 20)), "has no column for time"),
    ],
)
def test_files_of_arrays_that_cannot_be_used_are_refused_in_a_sentence(tmp_path, make, sentence):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        make(file)
    with pytest.raises(ValueError) as caught:
        read_record(tmp_path / "a.h5")
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("mark", "row"), [("\t", "{k}.5\t{um:,}\t0.6"), (";", "{k},5;1.000;0,6"), ("\t", '"{k}.5"\t"1,000"\t"0.6"')]
)
def test_commas_or_points_that_may_separate_thousands_are_refused(tmp_path, mark, row):
    rows = [row.format(k=k, um=100 * k) for k in range(12)]
    with pytest.raises(ValueError, match="one of which may separate thousands"):
        read_record(written(tmp_path / "a.txt", HEAD.replace(", ", mark), rows))


def test_numbers_in_quotation_marks_and_separators_at_the_end_of_rows(tmp_path):
    quoted = [",".join(f'"{cell.strip()}"' for cell in row.split(",")) for row in ROWS]
    for rows in (quoted, [f"{row}," for row in ROWS], [f"{row}," for row in quoted]):
        record = read_record(written(tmp_path / "a.csv", HEAD, rows))
        assert np.allclose(record.load_point, 1e-5 * np.arange(12)) and np.allclose(record.time, np.arange(12))


def test_plural_names_of_units(tmp_path):
    head = "time (seconds), displacement (microns), friction"
    assert np.allclose(read_record(written(tmp_path / "a.csv", head)).load_point, 1e-5 * np.arange(12))


def test_two_units_of_one_column_are_not_guessed(tmp_path):
    path = written(tmp_path / "a.csv", "time_s, load_point_mm, friction", ["s, um, -", *ROWS])
    with pytest.raises(
        ValueError, match="load_point has the unit 'mm' in its heading and 'um' below it: keep only one"
    ):
        read_record(path)
    named = {"time [s]": 0, "load_point [um]": 1, "friction": 2}
    with pytest.warns(UserWarning, match=r"--columns gives 'load_point \[um\]', but the unit in the file is 'mm'"):
        assert np.allclose(read_record(path, columns=named).load_point, 1e-5 * np.arange(12))


@pytest.mark.parametrize("kind", ["structures", "tables"])
def test_two_records_in_one_file_are_not_mixed(tmp_path, kind):
    columns = {"time_s": np.arange(20.0), "vdcdt_um": np.arange(20.0), "mu": np.full(20, 0.6)}
    longer = columns | {"vdcdt_um": 3 * columns["vdcdt_um"]}
    if kind == "structures":
        savemat(tmp_path / "a", {"first": columns, "second": longer}, appendmat=False)
    else:
        with h5py.File(tmp_path / "a", "w") as file:
            for name, record in (("first", columns), ("second", longer)):
                rows = list(zip(*record.values(), strict=True))
                file[name] = np.array(rows, [(field, float) for field in record])
    with pytest.raises(ValueError, match=r"in 2 groups \(first, second\): keep only one"):
        read_record(tmp_path / "a")


def test_units_in_an_attribute_that_is_an_array(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for k, (name, unit) in enumerate((("time", b"s"), ("load_point", b"um"), ("friction", b"-"))):
            file[name] = np.array([[n, 10 * n, 0.6] for n in range(15)])[:, k]
            file[name].attrs["units"] = np.array([unit])
    assert np.allclose(read_record(tmp_path / "a.h5").load_point, 1e-5 * np.arange(15))


def test_files_without_names_of_columns_say_so(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["data"] = np.arange(60.0).reshape(20, 3)
    with pytest.raises(ValueError, match="its 3 columns have no headings; give their numbers"):
        read_record(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["label"] = [b"x"]
    with pytest.raises(ValueError, match="it has no columns of numbers"):
        read_record(tmp_path / "b.h5")


@pytest.mark.parametrize("kind", ["hdf5", "matlab", "xlook"])
def test_damaged_files_are_refused_in_a_sentence(tmp_path, kind):
    rng = np.random.default_rng(1)
    path = tmp_path / "a.dat"
    if kind == "matlab":
        savemat(path, LAB)
    elif kind == "xlook":
        look(path)
    else:
        with h5py.File(path, "w") as file:
            file.update(LAB)
    whole = path.read_bytes()
    for size in (2800 if kind == "xlook" else 520, len(whole) // 2 + 1400 * (kind == "xlook"), len(whole) - 9):
        path.write_bytes(whole[:size])
        with pytest.raises(ValueError, match="damaged"):
            read_record(path)
    for _ in range(0 if kind == "matlab" else 60):  # SciPy itself may crash on MATLAB files with wrong bytes
        wrong = bytearray(whole)
        for place in rng.integers(8, len(whole), 5):
            wrong[place] = rng.integers(256)
        path.write_bytes(bytes(wrong))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                read_record(path)
            except ValueError as problem:
                assert "\n" not in str(problem)


PORES = "time [s], load_point [um], shear_stress [MPa], normal_stress [MPa]"


@pytest.mark.parametrize(
    ("heading", "value", "friction", "group"),
    [
        ("pore_pressure [MPa]", 10.0, 0.6, "used"),
        ("Pore Pressure (psi)", 10e6 / 6894.757293168, 0.6, "used"),
        ("Pf_kPa", 1e4, 0.6, "used"),
        ("pp [bar]", 100.0, 0.6, "used"),
        ("p_up [MPa]", 10.0, 0.2, "not understood"),
        ("foo [MPa]", 10.0, 0.2, "not understood"),
        ("bananas", 1.0, 0.2, "not understood"),
        ("temperature [C]", 20.0, 0.2, "without influence on forces"),
    ],
)
def test_every_column_is_in_a_group_and_pore_pressure_makes_the_stress_effective(
    tmp_path, heading, value, friction, group
):
    path = written(tmp_path / "a.csv", f"{PORES}, {heading}", [f"{k}, {k}, 3, 15, {value!r}" for k in range(12)])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        record = read_record(path)
    assert np.allclose(record.friction, friction) and np.allclose(record.normal_stress, 3e6 / friction)
    groups = record_columns(path)
    assert any(name.startswith(heading) for name in groups[group]) and sum(map(len, groups.values())) == 5
    assert (group == "not understood") == any("unknown columns, not used" in str(w.message) for w in caught)
    assert (friction == 0.6) == any("pore pressure was subtracted" in str(w.message) for w in caught)
    assert any("may change the effective" in name for name in groups[group]) == ("MPa" in heading and friction < 0.5)


def test_pore_pressure_of_named_columns(tmp_path):
    """Found by its own heading; a stress that is effective already is left as it is."""
    path = written(tmp_path / "a.csv", "a, b, c, d, Pp (MPa)", [f"{k}, {k}, 3, 15, 10" for k in range(12)])
    names = {"time [s]": "a", "load_point [um]": "b", "shear_stress [MPa]": "c"}
    with pytest.warns(UserWarning, match="pore pressure was subtracted"):
        assert np.allclose(read_record(path, columns=names | {"normal_stress [MPa]": "d"}).friction, 0.6)
    assert np.allclose(read_record(path, columns=names | {"effective_normal_stress [MPa]": 3}).friction, 0.2)
    kept = written(tmp_path / "b.csv", f"{PORES}, friction, pp [MPa]", [f"{k}, {k}, 3, 15, 0.5, 10" for k in range(12)])
    with pytest.warns(UserWarning, match="friction is used as recorded"):
        record = read_record(kept)
    assert np.allclose(record.friction, 0.5) and np.allclose(record.normal_stress, 5e6)


@pytest.mark.parametrize(
    ("name", "hint"), [("bananas", "use time, load_point"), ("lod_point", "did you mean 'load_point'")]
)
def test_names_of_columns_that_are_not_known_are_refused(tmp_path, name, hint):
    path = written(tmp_path / "a.csv")
    with pytest.raises(ValueError, match=f"the column name '{name}' is unknown: {hint}"):
        read_record(path, columns={"time": 0, name: 1})


def test_decimal_commas_between_commas_are_not_taken_for_columns(tmp_path):
    """Whole seconds in the first column look like numbers of rows."""
    rows = "".join(f"{k},{k},0,6{k % 7}1\n" for k in range(20))
    (tmp_path / "a.csv").write_text(f"time [s],load_point [um],friction [-]\n{rows}")
    with pytest.raises(ValueError, match="separate columns by semicolons if numbers have decimal commas"):
        read_record(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("heads", "row", "sentence"),
    [
        ("friction", "60", "friction is about 60: is it in per cent"),
        ("tau (MPa),sigma_n (MPa)", "3,5000", "friction is about 0.0006: is it in per cent, or do the units"),
        ("friction,tau (MPa),sigma_n (MPa)", "0.9,3,5", "about 0.9, but shear over normal stress is about 0.6"),
    ],
)
def test_friction_that_contradicts_its_stresses_or_all_materials_is_doubted(tmp_path, heads, row, sentence):
    rows = "".join(f"{k},{k},{row}\n" for k in range(20))
    (tmp_path / "r.csv").write_text(f"time (s),load_point (um),{heads}\n{rows}")
    with pytest.warns(UserWarning, match=sentence):
        read_record(tmp_path / "r.csv")


@pytest.mark.parametrize(
    ("heads", "row", "sentence"),
    [
        ("time [s],load_point [um],lp velocity [um/s]", (1, 60, 1), r"load_point over time is 60 times 'lp velocity"),
        ("time [s],load_point [um],velocity [um/s]", (1, 3600, 1.03), r"'velocity .*: times seem to be in h, unless"),
        ("time [min],slip [mm],load_point [mm],slip rate [mm/s]", (1, 1, 1, 1), r"times seem to be in s, unless"),
        ("time [s],load_point [um],lp velocity [um/s]", (1, 30, 1), ""),
        ("time [min],load_point [um],lp velocity [um/s]", (1, 60, 1), ""),
    ],
)
def test_times_in_another_unit_contradict_the_velocities(tmp_path, heads, row, sentence):
    rows = "".join(",".join(f"{k * x:g}" for x in row[:-1]) + f",{row[-1]},0.6\n" for k in range(20))
    (tmp_path / "r.csv").write_text(f"{heads},friction\n{rows}")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        record = read_record(tmp_path / "r.csv")
    assert [bool(re.search(sentence, str(w.message))) for w in caught] == [True] * bool(sentence)
    if sentence and "velocity" in heads:
        with pytest.warns(UserWarning, match="as if the times were in (min|h): the fit uses --velocity"):
            record_data(record, velocity="1e-6")
