"""Verdicts: one of seven words whatever is given, no good one for noise; the files and the terminal's lines."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from stickslip.data import run_files
from stickslip.reports import claims as report
from stickslip.reports import terminal
from stickslip.reports.claims import (
    ALWAYS,
    CAN,
    DECISIVE,
    IS,
    NO_REFERENCE,
    NOT_REFUTED,
    NOT_REPRODUCED,
    PARTLY,
    REFUTED,
    REPRODUCED,
    UNDECIDED,
    VERDICTS,
    Claim,
    band,
    claim,
    format_measured,
    format_value,
    median_error,
    note_quick_run,
    standard_error,
    verdict,
    write_json,
)

SOURCE = "Fig 1: a sentence"
FINITE = st.floats(-1e6, 1e6, allow_nan=False)
NUMBERS = st.one_of(st.none(), st.floats(), st.integers(-100, 100))
ERRORS = st.one_of(st.none(), st.floats(0, 1e6), st.just(math.nan), st.just(math.inf))
TOLERANCES = st.floats(0, 2)


@pytest.mark.parametrize(
    ("paper", "measured", "tolerance", "error", "word"),
    [
        (1e-5, 2e-5, 1.0, 0, REPRODUCED),
        (1e-5, 0.5e-5, 1.0, 0, REPRODUCED),
        (1e-5, 2.9e-5, 1.0, 0, PARTLY),
        (1e-5, 1e-12, 1.0, 0, NOT_REPRODUCED),
        (1e-5, 0.0, 1.0, 0, NOT_REPRODUCED),
        (1.0, 1.1, 0.1, 0.01, REPRODUCED),  # at the edge: 1.1 − 1.0 is more than 0.1 in floating point
        (1.0, 1.15, 0.1, 0.01, PARTLY),
        (1.0, 1.05, 0.1, 0.2, UNDECIDED),
        (1.0, 1.45, 0.1, 0.2, UNDECIDED),  # 1.75 errors beyond the tolerance
        (1.0, 1.55, 0.1, 0.2, NOT_REPRODUCED),  # 2.25
        (1.0, 0.45, 0.1, 0.2, NOT_REPRODUCED),
        (1.0, 1.25, 0.1, 0.09, UNDECIDED),  # beyond twice the tolerance, but not by two errors beyond the tolerance
        (1.0, 0.75, 0.1, 0.09, UNDECIDED),
        (1.0, 1.25, 0.1, 0.07, NOT_REPRODUCED),
        (0.075, 0.5, 0.25, 0.03, NOT_REPRODUCED),
        (1.0, 1.05, 0.1, None, UNDECIDED),
        (1.0, 1.05, 0.1, math.nan, UNDECIDED),
        (1.0, math.nan, 0.1, 0.0, UNDECIDED),
        (1.0, None, 0.1, 0.0, UNDECIDED),
        (-1.0, -1.05, 0.1, 0.01, REPRODUCED),
        (-1.0, 1.05, 0.1, 0.01, NOT_REPRODUCED),
        (-1e-3, -2e-3, 1.0, 0.0, REPRODUCED),
        (0, 0, 0.0, 0, REPRODUCED),
        (0, 2, 0.0, 0, NOT_REPRODUCED),
        (0, 0.05, 0.1, 0, REPRODUCED),  # beside a printed zero a tolerance is absolute
        (0, 0.05, 0.1, 0.2, UNDECIDED),
        (1, 2, 0.0, 0, NOT_REPRODUCED),
        (True, True, 0.0, None, REPRODUCED),
        (True, False, 0.0, None, NOT_REPRODUCED),
        (True, None, 0.0, None, UNDECIDED),
        ([0.062, 0.082], [0.0618, 0.0823], 0.02, 0, REPRODUCED),
        ([0.062, 0.082], [0.05, 0.0823], 0.02, 0, PARTLY),
        ([0.062, 0.082], [0.05, 0.09], 0.02, 0, NOT_REPRODUCED),
        ([0.062, 0.082], [], 0.02, None, NOT_REPRODUCED),
        ([0.062, 0.082], [0.05, 0.0823], 0.02, None, UNDECIDED),
        ([0.062, 0.082], [0.05, math.nan], 0.02, 0, UNDECIDED),
        (None, 3.0, 0.1, 0.0, NO_REFERENCE),
        (None, None, 0.1, None, NO_REFERENCE),
    ],
)
def test_verdicts(paper, measured, tolerance, error, word):
    assert claim("id", SOURCE, paper, measured, "1", tolerance, error=error).verdict == word


@pytest.mark.parametrize(
    ("quantifier", "measured", "word"),
    [
        (IS, False, NOT_REPRODUCED), (CAN, True, REPRODUCED), (CAN, False, UNDECIDED), (CAN, None, UNDECIDED),
        (ALWAYS, True, NOT_REFUTED), (ALWAYS, False, REFUTED), (ALWAYS, None, UNDECIDED),
    ],
)  # fmt: skip
def test_one_instance_shows_what_can_be_and_refutes_what_always_is(quantifier, measured, word):
    assert claim("id", SOURCE, True, measured, "", 0.0, "sample 3", quantifier=quantifier).verdict == word


@given(NUMBERS, NUMBERS, TOLERANCES, ERRORS, st.sampled_from((IS, CAN, ALWAYS)))
def test_the_verdict_is_total_and_no_reference_means_no_number_in_the_paper(paper, measured, tolerance, error, kind):
    paper = None if paper is not None and not math.isfinite(paper) else paper
    row = claim("id", SOURCE, paper, measured, "1", tolerance, "a note", error=error, quantifier=kind)
    assert row.verdict in VERDICTS
    assert (row.verdict == NO_REFERENCE) == (row.paper is None)
    assert row.verdict != REFUTED, "a number is no counterexample"
    json.dumps(row._asdict(), allow_nan=False)


@given(FINITE, FINITE, TOLERANCES, ERRORS)
def test_noise_decides_nothing(paper, measured, tolerance, error):
    """Good words need an error below the way to the band's nearer edge, and a bad one a distance of two errors."""
    low, high = band(paper, tolerance)
    round_off = 1e-9 * (1 + abs(paper))
    word = verdict(paper, measured, tolerance, error)
    if error is None or not math.isfinite(error):
        assert word == UNDECIDED
        return
    gap = max(low - measured, measured - high)
    if word in (REPRODUCED, PARTLY):
        assert error <= min(high - paper, paper - low) + round_off
    elif word == NOT_REPRODUCED:
        assert gap > DECISIVE * error
    else:
        assert word == UNDECIDED
        assert gap <= DECISIVE * error + round_off


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), TOLERANCES)
def test_verdicts_do_not_depend_on_units_or_signs(paper, measured, tolerance):
    word = verdict(paper, measured, tolerance, 0.0)
    assert verdict(-paper, -measured, tolerance, 0.0) == word
    assert verdict(paper * 2.0**20, measured * 2.0**20, tolerance, 0.0) == word


@pytest.mark.parametrize(
    ("tolerance", "inside", "near", "far"),
    [(0.1, (0.91, 1.09), (0.89, 1.11, 0.81, 1.19), (0.79, 1.21)), (0.3, (0.71,), (0.69, 0.41, 1.59), (0.39, 1.61)),
     (1.0, (0.51, 1.99), (0.49, 0.34, 2.99), (0.33, 3.01))],
)  # fmt: skip
def test_partly_is_between_one_and_two_tolerances(tolerance, inside, near, far):
    texts = [{verdict(1.0, value, tolerance, 0.0) for value in values} for values in (inside, near, far)]
    assert texts == [{REPRODUCED}, {PARTLY}, {NOT_REPRODUCED}]


@pytest.mark.parametrize(
    "given",
    [(1.0, 1.0, float("nan"), 0.0), (1.0, 1.0, -0.1, 0.0), (1.0, 1.0, float("inf"), 0.0), (1.0, 1.0, 0.1, -0.5),
     (1.0, 1.0, 0.1, 0.0, "often"), ([1.0, 2.0], 1.0, 0.1, 0.0), (1.0, [1.0, 2.0], 0.1, 0.0), ([1, 2], [1], 0.1, 0.0)],
)  # fmt: skip
def test_what_cannot_be_compared_gives_a_one_sentence_error(given):
    with pytest.raises(ValueError, match=r"(, got |compare windows)"):
        verdict(*given)


def test_the_reason_of_an_undecided_number_is_its_error_or_its_distance():
    reasons = [claim("id", SOURCE, 1.0, value, "1", 0.1, error=0.3).note for value in (1.05, 1.5)]
    assert reasons[0] == "undecided: its error 3.0e-01 exceeds the tolerance"
    assert reasons[1] == "undecided: it is less than 2 errors of 3.0e-01 beyond the tolerance"


def test_types_of_numpy_are_taken_as_what_they_are():
    assert verdict(np.True_, np.True_, 0.0, None) == REPRODUCED
    assert verdict(np.float64(1), np.float64("nan"), 0.1, 0.0) == UNDECIDED


def test_a_reference_is_beside_the_paper_and_never_in_its_place():
    row = claim("id", SOURCE, None, 1.0, "1", 0.1, error=0.0, reference=1.0, reference_source="closed form")
    assert (row.verdict, row.paper, row.reference) == (NO_REFERENCE, None, 1.0)
    assert "agrees with the reference 1 (closed form)" in row.note
    both = claim("id", SOURCE, 5.0, 1.0, "1", 0.1, error=0.0, reference=1.0, reference_source="closed form")
    assert both.verdict == NOT_REPRODUCED
    far = claim("id", SOURCE, None, 9.0, "1", 0.1, error=0.0, reference=1.0, reference_source="closed form")
    assert "differs from" in far.note
    vague = claim("id", SOURCE, None, 1.0, "1", 0.1, error=None, reference=1.0, reference_source="closed form")
    assert "cannot be compared" in vague.note


@pytest.mark.parametrize(
    ("message", "options"),
    [
        ("a source must be 'PLACE: words'", {"source": "Fig 1"}),
        ("give reference and reference_source together", {"reference": 1.0}),
        ("give reference and reference_source together", {"reference_source": "theory"}),
        ("compare statements with statements", {"paper": True, "measured": 1.0}),
        ("counterexample", {"paper": True, "measured": False, "quantifier": ALWAYS}),
    ],
)
def test_rows_that_say_too_little_are_refused(message, options):
    row = {"source": SOURCE, "paper": 1.0, "measured": 1.0} | options
    with pytest.raises(ValueError, match=message):
        claim("id", row.pop("source"), row.pop("paper"), row.pop("measured"), "1", 0.1, **row)


def test_what_a_quick_run_leaves_out_is_undecided_and_says_so():
    number = claim("a", SOURCE, 1.0, None, "1", 0.1, "no front")
    statement = claim("b", SOURCE, True, None, "", 0.0)
    there = claim("c", SOURCE, 1.0, 1.0, "1", 0.1, error=0.0)
    told = note_quick_run([number, statement, there])
    assert [c.verdict for c in told] == [UNDECIDED, UNDECIDED, REPRODUCED]
    assert told[0].note.startswith("not measured by a quick run; no front")
    assert told[1].note.startswith("left open by a quick run")
    assert told[2] == there


def test_errors_of_means_are_wide_for_few_values_and_unknown_for_one():
    assert standard_error([1.0]) is None
    assert standard_error([0.0, 2.0]) == pytest.approx(0.5 * 12.706, rel=1e-4)  # Student's t with one degree of freedom
    many = np.random.default_rng(0).normal(size=4000)
    assert standard_error(many) == pytest.approx(many.std(ddof=1) / np.sqrt(4000), rel=0.03)
    assert median_error(many) == pytest.approx(1.2533 * standard_error(many), rel=1e-4)


def test_values_are_shown_short():
    assert [format_value(v) for v in (None, True, [0.1, 0.25], [], 1.23456e-5)] == [
        "–",
        "yes",
        "0.1–0.25",
        "none",
        "1.23e-05",
    ]
    rows = [claim("a", SOURCE, 1.0, 2.0, "1", 0.1, error=e) for e in (0.5, 1e-9, 0.0, None)]
    assert [format_measured(row) for row in rows] == ["2 ± 0.5", "2", "2", "2"]


SHOWS = {"Fig 1": ("a thing", "speed"), "Fig 2": ("drawn, without a number", ""), "Sec. V": ("a premise", "premise")}
ROWS = [
    claim("speed", "Fig 1: text", 0.075, 0.08, "m/s", 0.25, "by 16 runs", error=0.005),
    claim("half", "Fig 1: text", 1.0, 1.15, "1", 0.1, "near", error=0.0),
    claim("far", "Fig 1: text", 1.0, 9.0, "1", 0.1, "no | good", error=0.0),
    claim("window", "Fig 1: text", [0.1, 0.2], [0.1, 0.5], "1", 0.1, "one end", error=0.0),
    claim("no-window", "Fig 1: text", [0.1, 0.2], [], "1", 0.1, "none there"),
    claim("noise", "Fig 1: text", 1.0, 1.0, "1", 0.1, "few", error=0.3),
    claim("one", "Fig 1: text", 1.0, 1.0, "1", 0.1, "one run"),
    claim("premise", "Sec. V: it holds", True, False, "", 0.0, "sample 3 at 0.5", quantifier=ALWAYS),
    claim("rule", "Sec. V: it always holds", True, True, "", 0.0, "in 9 of 9 samples", quantifier=ALWAYS),
    claim("mode", "Sec. V: not printed", None, 0.2, "1", 0.1, error=0.0, reference=0.2, reference_source="closed form"),
    claim("bare", "Sec. V: not printed", None, 4.0, "1", 1.0, "counted"),
    claim("speed@other", "Fig 1: text", 0.075, 0.02, "m/s", 0.25, "a variant", error=0.001),
]

SUMMARY = (
    "Of the paper's sentences, 3 have a row, and 2 of these are decided. "
    "1 of the paper's 9 claims is reproduced, 2 in part, 2 not, 1 refuted, 1 not refuted, 2 undecided"
)


@pytest.fixture
def room(tmp_path):
    report.write_claims(tmp_path, ROWS, SHOWS, "Paper 9")
    return tmp_path


def test_claims_json_holds_every_field_and_is_read_back(room):
    told = json.loads((room / run_files.CLAIMS).read_text())
    assert [list(row) for row in told] == [[
        "id", "source", "paper", "measured", "unit", "tolerance", "verdict", "note", "error", "reference",
        "reference_source", "quantifier",
    ]] * len(ROWS)  # fmt: skip
    assert [Claim(**row) for row in told] == ROWS
    for row in told:
        given = (row[name] for name in ("paper", "measured", "tolerance", "error", "quantifier"))
        assert verdict(*given) == row["verdict"]
    assert {c.verdict for c in ROWS} == set(VERDICTS)


def test_claims_md_has_every_row_in_a_table_of_its_figure_and_every_note(room):
    text = (room / run_files.NOTES).read_text()
    assert text.startswith(f"# Paper 9\n\n{SUMMARY}")
    sections = text.split("\n## ")
    assert [part.splitlines()[0] for part in sections[1:]] == ["Fig 1: a thing", "Sec. V: a premise", "Notes"]
    for row in ROWS:
        (line,) = (line for line in text.splitlines() if line.startswith(f"| {row.id} |"))
        assert line.endswith(f"| **{row.verdict}** |")
        assert line.replace("\\|", "").count("|") == 9
        assert f"- **{row.id}** ({row.verdict}): {row.note.split(' |')[0]}" in text
    assert all(f"- **{word}**" in text for word in VERDICTS)


def test_what_failed_is_reported_in_claims_md_and_on_the_terminal(tmp_path, capsys):
    report.write_claims(tmp_path, ROWS[:1], SHOWS, "Paper 9", ["sample 4: no rest [after 9 s]"])
    assert "sample 4: no rest [after 9 s]" in capsys.readouterr().out
    text = (tmp_path / run_files.NOTES).read_text()
    assert text.index("Missing, because they failed:\n\n- sample 4: no rest [after 9 s]\n") < text.index(
        "- **reproduced**"
    )


def test_claims_png_has_a_row_for_each_claim(room):
    with Image.open(room / run_files.CHART) as picture:
        assert len(picture.convert("L").getcolors()) > 20
        lower = picture.size[1]
    report.write_claims(room, ROWS[:5], SHOWS, "Paper 9")
    with Image.open(room / run_files.CHART) as picture:
        assert picture.size[1] < lower


def test_deviations_are_in_tolerances():
    drawn = {(row.label, row.group): row for row in report.chart_rows(ROWS, SHOWS)}
    assert drawn["speed", "Fig 1"].deviation == pytest.approx([0.005 / (0.25 * 0.075)])
    assert drawn["speed", "Fig 1"].error == pytest.approx(0.005 / (0.25 * 0.075))
    assert drawn["window", "Fig 1"].deviation == pytest.approx([0, 15])
    assert drawn["mode", "Sec. V"].beside_reference
    assert drawn["premise", "Sec. V"].deviation == drawn["bare", "Sec. V"].deviation == ()
    assert list(drawn)[-1] == ("speed", "Fig 1 @other")
    factor, _ = report.deviation(-1e-3, -2e-3, 1.0, 0.0)
    assert factor == pytest.approx([-1.0])
    assert report.deviation(1.0, 3.0, 0.0, 0.0)[0] == (math.inf,)


def test_the_terminal_shows_three_sentences_and_a_line_for_each_figure(monkeypatch):
    for width in (80, 120):
        monkeypatch.setattr(terminal.console, "_width", width)
        with terminal.console.capture() as said:
            report.show_claims(ROWS, SHOWS)
        lines = said.get().splitlines()
        text = " ".join(said.get().split())
        assert max(map(len, lines)) <= width
        assert text.startswith(f"{SUMMARY}; ")
        assert "Of the rows that disagree, 2 of 3 are in Fig 1 (a thing): far 9, paper 1; undecided because" in text
        assert "its error is too large (1)" in text
        (fig1,) = (line for line in lines if line.startswith("Fig 1"))
        assert "1 of 7, other 0 of 1" in fig1
        assert ("a thing" in fig1) == (width == 120)
        assert "speed 0.08 ± 0.005, paper 0.075" in fig1
        assert any(line.startswith("Fig 2") for line in lines)
        assert "by 16 runs" not in text
        assert len(lines) < 14


def test_when_all_is_well_the_terminal_says_so():
    row = [ROWS[0]]
    assert report.summarize(row, SHOWS) == (
        "Of the paper's sentences, 1 has a row, and 1 of these is decided.",
        "1 of the paper's 1 claims is reproduced.",
        "Every claim agrees within its tolerance.",
    )


def test_a_sentence_is_decided_once_all_of_its_rows_are():
    same = [claim(f"speed-{k}", "Fig 1: 2 and 3", k, k, "1", 0.1, error=0.0) for k in (2.0, 3.0)]
    other = claim("other", "Fig 1: another", True, False, "", 0.0)
    beside = [
        claim("bare", "Fig 1: nothing", None, 1.0, "1", 0.1),
        claim("other@b", "Fig 1: variant", 1.0, None, "", 0.1),
    ]
    assert report.count_sentences([*same, other, *beside]) == (2, 2)
    left_open = claim("speed-4", "Fig 1: 2 and 3", 4.0, None, "1", 0.1, "it would take a run of a year")
    assert report.count_sentences([*same, left_open, other, *beside]) == (2, 1)
    assert report.count_sentences([*same, left_open._replace(source="Fig 2: 4"), other]) == (3, 2)


def test_claims_json_of_an_older_run_is_still_read(tmp_path):
    old = {"id": "a", "source": "Fig 5", "paper": 1.0, "measured": 1.0, "unit": "1", "tolerance": 0.1,
           "verdict": "reproduced", "note": ""}  # fmt: skip
    assert Claim(**old).error is None
    write_json(tmp_path / "claims.json", [Claim(**old)])
