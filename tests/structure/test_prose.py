"""The check of wording finds phrases in prose, and leaves code alone."""

import pytest

from tests.structure.prose import faults, prose


@pytest.mark.parametrize(
    ("text", "advice"),
    [
        ("# notes on what is lost", "name the thing"),
        ('"""How forces are summed."""', "begin with a noun"),
        ("pressure = {pressure:g} was given: use less", "must be"),
        ("the folder of a run", "run folder"),
        ("f'{what} of `what` exceeds the limit'", None),
        ('the group "not understood" of names', None),
    ],
)
def test_faults(text, advice):
    found = faults(text)
    assert found == [] if advice is None else len(found) == 1 and advice in found[0]


def test_lines_of_code_are_left_out(tmp_path):
    path = tmp_path / "law.py"
    path.write_text('what = told("a b")  # notes on what is lost\nsaid = 1\n')
    assert list(prose(path)) == [1] and "told" not in prose(path)[1]
    path = tmp_path / "law.h"
    path.write_text("int what = 0;\nint k;  // what\n")
    assert prose(path) == {2: " what"}


def test_pages_are_searched_for_fewer_phrases_and_without_their_code(tmp_path):
    path = tmp_path / "page.md"
    path.write_text("# What is new\n```\nbut for this\n```\nall but for two\n")
    assert prose(path)[3] == "" and not faults(prose(path)[1], page=True)
    assert faults(prose(path)[5], page=True) == ["'but for': write 'except for', 'this many'"]
