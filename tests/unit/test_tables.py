"""Tables in CSV files."""

import numpy as np
import pytest

from stickslip.core.tables import format_table, heading_of, read_table, split_label, write_table


def test_a_table_comes_back(tmp_path):
    numbers = np.random.default_rng(1).normal(size=20)
    rows = [(k, x, f'word {k}, "quoted"', None) for k, x in enumerate(numbers)]
    write_table(
        tmp_path / "t.csv", ["n", heading_of("time", "s"), "note", "empty"], rows, digits=None, comments=["made"]
    )
    (line, names), *back = read_table(tmp_path / "t.csv")
    assert (line, names) == (2, ["n", "time [s]", "note", "empty"])
    assert [float(fields[1]) for _, fields in back] == numbers.tolist()
    assert back[3] == (6, ["3", str(numbers[3]), 'word 3, "quoted"', ""])


def test_floating_point_numbers_have_a_number_of_digits_and_integers_all():
    text = format_table(["a", "b"], zip(np.array([1 / 3, np.nan]), np.array([123456789, 1]), strict=True), digits=3)
    assert text == "a,b\n0.333,123456789\nnan,1\n"


@pytest.mark.parametrize(
    ("heading", "parts"),
    [("dc [m]", ("dc", "m")), ("dc (um)", ("dc", "um")), ("a [-]", ("a", "-")), ("kind", ("kind", None))],
)
def test_a_heading_has_a_name_and_a_unit(heading, parts):
    assert split_label(heading) == parts
    assert heading_of("a", "1") == "a [-]"


def test_numbers_between_quotation_marks_may_have_decimal_commas(tmp_path):
    (tmp_path / "t.csv").write_text('a,b\n"0,50",1\n"1,25",2\n')
    assert [fields for _, fields in read_table(tmp_path / "t.csv")[1:]] == [["0.50", "1"], ["1.25", "2"]]
