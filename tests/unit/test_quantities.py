"""Tables of quantities: one row gives columns, measures with intervals, terminal rows and tables of notebooks."""

import csv
from types import SimpleNamespace as Made

import numpy as np
import pytest

from stickslip.core.units import units_in_use
from stickslip.experiments.quantities import Measures, Quantities, Quantity, estimate, median

SAMPLE = [
    Quantity("seed", "1", "number of the sample"),
    Quantity("stress", "force/length^(dim-1)", "mean stress", "packed.pressure", r"$\sigma$"),
    Quantity("damping", "1", "damping ratio", lambda sample: {1e-3: 2 * sample.seed, "last": 7.0}),
    Quantity("rare", "time", "a time that some samples have", lambda sample: sample.rare, partial=True),
    Quantity("absent", "1", "none", lambda sample: None),
]


def samples(*seeds, rare=(np.nan, np.nan, 4.0)):
    return [Made(seed=float(k), packed=Made(pressure=10.0 * k), rare=rare[i]) for i, k in enumerate(seeds)]


def test_rows_give_values_units_and_meanings():
    table = Quantities(SAMPLE)
    assert table.of(samples(1)[0]) == pytest.approx(
        {"seed": 1.0, "stress": 10.0, "damping@0.001": 2.0, "damping@last": 7.0, "rare": np.nan}, nan_ok=True
    )
    assert table.row("damping@0.001_error").meaning == "damping ratio" and table.row("stress_error").unit[:5] == "force"
    assert table["stress"].axis == (r"$\sigma$", "force/length^(dim-1)") and table["seed"].axis == "seed"
    assert table.columns(samples(1, 2))["stress"].tolist() == [10.0, 20.0] and Quantities([]).columns([]) == {}
    assert np.isnan(table["stress"].at(Made(packed=None))["stress"])
    with pytest.raises(ValueError, match="same name: seed, seed"):
        Quantities([SAMPLE[0], SAMPLE[0]])


def test_measures_are_estimates_over_the_samples_that_count():
    measures = Measures(SAMPLE, samples=lambda result: result, over=estimate)
    found = measures(samples(1, 2, 3))
    assert [*found][:4] == ["seed", "seed_error", "stress", "stress_error"] and found["stress"][1][:5] == "force"
    half = 4.302652729911275 * 10 / np.sqrt(3)  # Student's t with two degrees of freedom
    assert (found["stress"][0], found["stress_error"][0]) == pytest.approx((20, half))
    assert found["rare"][0] == 4.0 and np.isnan(found["rare_error"][0])  # of one sample
    assert "rare" not in measures.finite_values(samples(1, 2, rare=(np.nan, np.nan)))
    lost = Measures([SAMPLE[3]._replace(partial=False)], samples=lambda result: result, over=estimate)
    assert np.isnan(lost(samples(1, 2, 3))["rare"][0])


def test_medians_leave_out_samples_without_a_value():
    rows = [Quantity("onset", "1", "first", lambda result: [1.0, np.nan, 3.0]), Quantity("none", "1", "", lambda r: [])]
    found = Measures(rows, over=median)(None)
    assert found["onset"] == (2.0, "1") and np.isnan(found["none"][0])
    array = Quantity("onset", "1", "first", lambda result: np.array([1.0, np.nan, 3.0]))
    assert Measures([array], over=median)(None)["onset"] == (2.0, "1")


def test_one_sample_has_no_interval():
    one = estimate([3.0])
    assert one.mean == 3.0 and np.isnan(one.half_width)


def test_series_repeat_the_numbers_of_their_sample(tmp_path):
    table = Quantities(
        [*SAMPLE[:2], Quantity("tau", "1", "series", lambda s: np.array([False, True]) if s.seed else 0.5)]
    )
    with units_in_use("SI"):
        table.write(tmp_path / "series.csv", samples(1, 0))
    with (tmp_path / "series.csv").open() as file:
        assert [*csv.reader(file)] == [
            ["seed", "stress [Pa]", "tau"], ["1", "10", "0"], ["1", "10", "1"], ["0", "0", "0.5"]
        ]  # fmt: skip


def test_series_of_one_subject_are_equally_long(tmp_path):
    table = Quantities([Quantity("x", "1", "", lambda s: np.zeros(3)), Quantity("y", "1", "", lambda s: np.zeros(2))])
    with pytest.raises(ValueError):
        table.write(tmp_path / "series.csv", [None])
    assert not (tmp_path / "series.csv").exists()


def test_the_terminal_shows_intervals_units_and_meanings(capsys):
    measures = Measures(SAMPLE, samples=lambda result: result, over=estimate)
    with units_in_use("SI"):
        measures.show(samples(1, 2), title="Samples", without=["seed"])
    text = capsys.readouterr().out
    assert "seed" not in text and "mean stress" in text and "Pa" in text and "15" in text


def test_rows_on_the_terminal_have_a_column_for_each_quantity(capsys):
    table = Quantities([*SAMPLE, Quantity("grains_lost", "1", "", lambda sample: 12345)])
    with units_in_use("SI"):
        table.show_rows(samples(1, 2), "stress", "grains_lost", "rare", "absent", title="Samples")
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[0] == ["Samples"] and ["stress", "[Pa]", "grains", "lost", "rare", "[s]", "absent"] in lines
    assert ["10", "12345", "–", "–"] in lines and ["20", "12345", "–", "–"] in lines
