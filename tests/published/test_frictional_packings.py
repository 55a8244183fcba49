"""Contact number of compressed packings against friction; published values and tolerances stand in a CSV file."""

import csv
from functools import cache
from pathlib import Path

import pytest

from benchmarks.contact_number import excess, sample

pytestmark = pytest.mark.slow
with Path(__file__).with_name("frictional_packings.csv").open(encoding="utf-8") as file:
    ROWS = list(csv.DictReader(line for line in file if not line.startswith("#")))


@cache
def packing(dim: int, mu: float, pressure: float = 1e-5):
    """Properties of a packing of 100 grains."""
    return sample(dim, mu, seed=0, pressure=pressure, n=100)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row['dim']}D, μ = {row['mu']}")
def test_contact_number_without_and_with_much_friction(row):
    info = packing(int(row["dim"]), float(row["mu"]))
    assert info.coordination == pytest.approx(float(row["contact_number"]), abs=float(row["tolerance"]))


@pytest.mark.parametrize("dim", [2, 3])
def test_contact_number_falls_in_between(dim):
    """Both papers: the contact number decreases steadily, mostly between μ = 0.01 and 1."""
    z = [packing(dim, mu).coordination for mu in (0.0, 0.1, 10.0)]
    assert z[0] - 0.1 > z[1] > z[2] + 0.1


@pytest.mark.parametrize("dim", [2, 3])
def test_generalised_isostaticity_is_approached_from_above(dim):
    """Henkes et al.: packings lie above z = d + 1 + 2 n_m/d, and the nearer to it the lower the pressure."""
    near, far = (excess(packing(dim, 0.1, p), dim, 0.1) for p in (1e-5, 1e-3))
    assert 0 <= near < far
