"""Verdicts: symmetric, honest about their own error."""

import pytest

from stickslip.experiments.claims import NOT_REPRODUCED, PARTLY, REPRODUCED, claim, shown


@pytest.mark.parametrize(
    ("paper", "measured", "tolerance", "error", "verdict"),
    [
        (1e-5, 2e-5, 1.0, 0, REPRODUCED),
        (1e-5, 0.5e-5, 1.0, 0, REPRODUCED),
        (1e-5, 2.9e-5, 1.0, 0, PARTLY),
        (1e-5, 1e-12, 1.0, 0, NOT_REPRODUCED),
        (1e-5, 0.0, 1.0, 0, NOT_REPRODUCED),
        (1.0, 1.05, 0.1, 0.01, REPRODUCED),
        (1.0, 1.05, 0.1, 0.2, PARTLY),
        (1.0, 1.45, 0.1, 0.2, NOT_REPRODUCED),
        (0, 0, 0.0, 0, REPRODUCED),
        (1, 2, 0.0, 0, NOT_REPRODUCED),
        (True, True, 0.0, 0, REPRODUCED),
        (True, False, 0.0, 0, NOT_REPRODUCED),
        ([0.062, 0.082], [0.0618, 0.0823], 0.02, 0, REPRODUCED),
        ([0.062, 0.082], [0.05, 0.0823], 0.02, 0, PARTLY),
        (0.1, None, 0.1, 0, NOT_REPRODUCED),
    ],
)
def test_verdicts(paper, measured, tolerance, error, verdict):
    assert claim("id", "Fig 1", paper, measured, "1", tolerance, error=error).verdict == verdict


def test_values_are_shown_short():
    assert [shown(v) for v in (None, True, [0.1, 0.25], 1.23456e-5)] == ["–", "yes", "0.1–0.25", "1.23e-05"]
