"""The table of the backward front on its page is the one in its file, and no wave explains it."""

from benchmarks.backward_front import PAGE, read, table


def test_the_page_shows_the_file():
    assert table(read()) in PAGE.read_text(encoding="utf-8")


def test_the_drift_explains_the_front_and_the_frequency_along_y_does_not():
    rows = read()
    assert max(r.front for r in rows) > 4 * min(r.front for r in rows)
    assert max(r.wave for r in rows) < 1.1 * min(r.wave for r in rows)
    for row in rows:
        assert abs(row.smooth / row.drift - 1) < 0.25, row
