"""Records as CSV: units, separators, round trip, and every refusal in one sentence."""

import numpy as np
import pytest

from stickslip.friction.fitting import fit
from stickslip.friction.laboratory import LabRecord, read_csv, record_data, write_csv
from stickslip.friction.loads import velocity_steps
from stickslip.friction.ratestate import RateState, Spring, spring_slider
from tests.conftest import stickslip_here

HEAD = "time [s], load_point [um], friction [-]"
HEAD_BY_NAME = ("time [s]", "friction [-]", "load_point [um]")
ROWS = [f"{k}, {10 * k}, 0.6{k % 10}" for k in range(12)]


def written(path, head=HEAD, rows=ROWS, **options):
    path.write_text("\n".join([head, *rows]) + "\n", **options)
    return path


def test_units_separators_and_comments(tmp_path):
    rows = [f"{k / 60};{k / 100};{3.0 + 0.01 * k};5.0;{2 + k};left out" for k in range(12)]
    head = "Time [min]; Load Point Displacement [mm]; Shear Stress [MPa]; sigma_n [MPa]; slip rate [mm/min]; note"
    path = written(tmp_path / "a.csv", head, ["# a comment", *rows[:5], "", *rows[5:]], encoding="utf-8-sig")
    record = read_csv(path)
    assert np.allclose(record.time, np.arange(12.0))
    assert np.allclose(record.load_point, 1e-5 * np.arange(12))
    assert np.allclose(record.friction, (3.0 + 0.01 * np.arange(12)) / 5.0)
    assert np.allclose(record.normal_stress, 5e6)
    assert np.allclose(record.velocity, 1e-3 / 60 * (2 + np.arange(12)))
    tabs = written(tmp_path / "b.csv", HEAD.replace(", ", "\t"), [row.replace(", ", "\t") for row in ROWS])
    assert np.allclose(read_csv(tabs).load_point, 1e-5 * np.arange(12))


def test_decimal_commas_parentheses_and_files_of_windows(tmp_path):
    rows = [f"{k},5;{k / 10};-0,{k:02}e1" for k in range(12)]
    path = written(tmp_path / "a.csv", "time (s); load_point (µm); friction", rows, encoding="cp1252")
    record = read_csv(path)
    assert np.allclose(record.time, np.arange(12) + 0.5)
    assert np.allclose(record.load_point, 1e-7 * np.arange(12))
    assert np.allclose(record.friction, -0.1 * np.arange(12))
    with pytest.raises(ValueError, match="not a number"):
        read_csv(written(tmp_path / "b.csv", HEAD.replace(",", ";"), ["1.234,5;1;1", *["1;2;3"] * 11]))


def test_rows_with_empty_cells_are_left_out_and_reported(tmp_path):
    path = written(tmp_path / "a.csv", HEAD + ", note", [f"{row}, " for row in [*ROWS, "12, , 0.6", "13, 130, "]])
    with pytest.warns(UserWarning, match="2 of 14 rows have an empty cell and are left out; the first is line 14"):
        record = read_csv(path)
    assert len(record.time) == 12


def test_files_without_headers_need_the_numbers_of_columns(tmp_path):
    path = written(tmp_path / "a.csv", ROWS[0], ROWS[1:])
    record = read_csv(path, columns={"time": 0, "load_point [um]": 1, "friction": 2})
    assert np.allclose(record.load_point, 1e-5 * np.arange(12))
    assert np.allclose(read_csv(path, columns={"time": 0, "load_point": 1, "mu": 2}).load_point, 10.0 * np.arange(12))
    with pytest.raises(ValueError, match="column 3 was given for 'mu': the file has columns 0 to 2"):
        read_csv(path, columns={"time": 0, "load_point": 1, "mu": 3})


def test_what_is_written_is_read_and_fitted(tmp_path):
    legs = velocity_steps([1e-6, 1e-5, 1e-6], distance=2e-4)
    rs, times = RateState(0.010, 0.006, 1e-5, 0.6, 1e-6), np.unique(np.r_[np.linspace(0, 420, 2001), 200.0, 220.0])
    h = spring_slider(rs, Spring(1e4), legs, times=times)
    record = LabRecord(h.time, h.friction, h.load_point, np.full(len(times), 5e6), h.slip, h.velocity, h.theta)
    again = read_csv(write_csv(tmp_path / "a.csv", record, ("made by a test",)))
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
        ("1, 2, 3", ROWS, "its columns are '1', '2', '3'"),
        ("time, load_point [um], friction [-]", ROWS, "'time' has no unit: write it as 'time [s]'"),
        ("time [s], load_point [furlong], friction [-]", ROWS, "load_point has the unit 'furlong': use m, cm, mm"),
        ("time [s], load_point [um], friction [%]", ROWS, "friction has the unit '%'"),
        ("time [s], load_point [um], mu [-], friction", [row + ", 1" for row in ROWS], "two columns for friction"),
        (HEAD, ROWS[:5], "has 5 rows"),
        (HEAD, [*ROWS, "12, 120"], "line 14, has 2 fields but the header has 3"),
        (HEAD, [*ROWS, "12, 120, n/a"], "line 14: friction is 'n/a', not a number"),
        (HEAD, [*ROWS, "12, 1_20, 0.6"], "line 14: load_point is '1_20', not a number"),
        (HEAD, [*ROWS, "12, ١٢٠, 0.6"], "line 14: load_point is '١٢٠', not a number"),
        (HEAD, [row.replace(", 0.6", ", -0.6") for row in ROWS], "friction is negative throughout: is its sign rever"),
        (HEAD, [*ROWS, "12, nan, 0.6"], "line 14: load_point is nan, not a finite number"),
        (HEAD, [*ROWS, "11, 110, 0.6"], "time must increase, but sample 13"),
        (
            "time [s], load_point [um], tau [MPa], sigma_n [MPa]",
            [f"{k}, {k}, 1, 0" for k in range(12)],
            "must be positive",
        ),
        ("", [], "contains no data"),
    ],
)
def test_refusals(tmp_path, head, rows, sentence):
    with pytest.raises(ValueError) as caught:
        read_csv(written(tmp_path / "a.csv", head, rows))
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_binary_files_and_rest_at_the_start(tmp_path):
    (tmp_path / "a.csv").write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match="not a text file"):
        read_csv(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_bytes(b"time\0\0\0")
    with pytest.raises(ValueError, match="binary"):
        read_csv(tmp_path / "b.csv")
    resting = read_csv(written(tmp_path / "c.csv", rows=[f"{k}, 0, 0.5" for k in range(12)]))
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
    assert done.stderr == ("stickslip: a.csv: 1 of 41 rows have an empty cell and are left out; the first is line 41\n")
    done = stickslip_here(*arguments, "--columns", "time", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1) and "NAME=NUMBER" in done.stderr


@pytest.mark.parametrize("missing", ["time", "friction", "load_point"])
def test_unusual_headers_are_listed_with_those_that_are_read(tmp_path, missing):
    texts = {"time": "elapsed [s]", "friction": "F/N", "load_point": "x_piston [mm]"}
    head = ", ".join(texts[name] if name == missing else field for name, field in zip(texts, HEAD_BY_NAME, strict=True))
    with pytest.raises(ValueError) as caught:
        read_csv(written(tmp_path / "a.csv", head))
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
        read_csv(written(tmp_path / "a.csv", head, [",".join(["1"] * 100)] * 12))
    assert len(str(caught.value)) < 900


def test_times_in_days_and_years(tmp_path):
    record = read_csv(
        written(tmp_path / "a.csv", "time [yr], velocity [mm/yr], friction [-]", [f"{k}, 35, 0.6" for k in range(12)])
    )
    assert record.time[1] == 365.25 * 86400
    assert record.velocity[0] == pytest.approx(35e-3 / (365.25 * 86400))
    assert read_csv(written(tmp_path / "b.csv", HEAD.replace("[s]", "[d]"))).time[1] == 86400
