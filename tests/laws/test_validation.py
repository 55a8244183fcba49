"""Laws by users are judged when they are made: one sentence for each way in which one can be wrong."""

import math
import re
import sys
import warnings

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.laws import kinds
from stickslip.core.laws.compiled import law_struct
from stickslip.extras import MissingExtraError

SCALE = 2.0
TABLE = [1.0, 2.0]


def hertz(overlap, kn):
    return SCALE * kn * overlap * math.sqrt(overlap)


def branches_on_complex(overlap, kn):
    return kn * overlap if overlap > 0.01 else 0.5 * kn * overlap


def random(overlap):
    return overlap * np.random.random()


def modulus(overlap):
    return np.abs(overlap)


def root_of_a_gap(overlap):
    return math.sqrt(overlap)


def uses_a_list(overlap):
    return TABLE[0] * overlap


@pytest.mark.parametrize(
    ("functions", "message"),
    [
        ({"normal_force": lambda overlap: float("nan")}, "it must be finite"),
        ({"normal_force": root_of_a_gap, "contact_range": lambda r_eff: 0.1}, "nan"),
        ({"normal_force": lambda overlap: None}, "returns None"),
        ({"normal_force": lambda overlap, foo: overlap}, "an argument 'foo', which is not a parameter"),
        ({"normal_force": lambda overlap, *rest: overlap}, "plain ones"),
        ({"normal_force": 3}, "normal_force must be a function"),
        ({"normal_force": random}, "a law must be deterministic"),
        ({"normal_force": branches_on_complex}, r"line \d+: 'return kn \* overlap if overlap > 0.01.*overlap.real"),
        ({"normal_force": modulus}, "by a complex step and"),
        ({"normal_force": uses_a_list}, "'TABLE' of type list"),
        ({"normal_force": lambda overlap: nowhere * overlap}, "'nowhere', which is not defined"),  # noqa: F821
        ({"normal_force": lambda overlap: overlap.speed}, "cannot be evaluated, line"),
        ({"normal_force": hertz, "tangential_stiffness": lambda overlap: -1.0}, "must not be negative"),
        ({"normal_force": hertz, "contact_range": lambda r_eff: 0.1 / r_eff}, "contact_range decreases with r_eff"),
        ({"normal_force": hertz, "rolling_stiffness": hertz}, "rolling resistance needs both"),
        ({"normal_force": hertz, "normal_energy": hertz}, "make the force the slope of the energy"),
        ({"normal_force": hertz, "parameters": {"kn": -1.0}}, "kn must be finite and positive, got -1.0"),
        ({"normal_force": hertz, "parameters": {"overlap": 1.0}}, "must be an identifier"),
        ({"normal_force": hertz, "parameters": {"mu": "much"}}, "must be a number, got"),
        ({"normal_force": hertz, "coulomb": "rough"}, "'rough'"),
        ({"normal_force": hertz, "size": 0.0}, "size must be positive"),
        ({"normal_force": lambda overlap: float(f"{overlap.real:.12f}") + 0 * overlap}, "by a complex step"),
    ],
)
def test_a_bad_law_is_refused_in_one_sentence(functions, message):
    with pytest.raises((TypeError, ValueError), match=message) as told:
        ss.laws.custom(**functions)
    assert "\n" not in str(told.value)


def test_what_only_the_compiler_refuses_gives_a_one_sentence_error():
    def imports(overlap, kn):
        import os  # noqa: F401

        return kn * overlap

    law = ss.laws.custom(normal_force=imports)
    with pytest.raises(ValueError, match=r"normal_force cannot be compiled, line \d+: 'import os") as told:
        law_struct(law)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("line", ["import os", "global k; k = 1.0", "from math import sqrt"])
@pytest.mark.parametrize("inner", [False, True])
def test_what_only_the_compiler_refuses_in_a_file_is_reported_with_its_line(line, inner, tmp_path):
    path = tmp_path / "mine.py"
    text = "k = 2.0\ndef {}(overlap):\n    {}\n    return k * overlap\n"
    shell = "def normal_force(overlap):\n    return helper(overlap)\n"
    path.write_text(text.format("helper", line) + shell if inner else text.format("normal_force", line))
    law = ss.laws.from_file(path)
    message = rf"mine\.py: normal_force cannot be compiled, line 3: '{re.escape(line)}' \("
    with pytest.raises(ValueError, match=message) as told:
        law_struct(law)
    assert "\n" not in str(told.value)


def test_a_force_that_jumps_is_reported_and_a_continuous_one_is_not():
    with pytest.warns(ss.laws.LawWarning, match="jumps from 0 to 0.5 at first touch"):
        ss.laws.custom(normal_force=lambda overlap: overlap + 0.5)
    with pytest.warns(ss.laws.LawWarning, match=r"at the end of its range \(a gap of 0.1\)"):
        ss.laws.custom(normal_force=lambda overlap: overlap, contact_range=lambda r_eff: 0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ss.laws.custom(normal_force=hertz)


def test_the_kind_is_a_digest_of_what_decides_the_machine_code():
    global SCALE
    first = ss.laws.custom(normal_force=hertz)
    assert ss.laws.custom(normal_force=hertz, parameters={"kn": 3.0}).kind == first.kind  # values are in the table
    assert isinstance(first.kind, int) and first.kind not in (0, 1, 2) and first.kind < 2**62
    SCALE = 3.0
    try:
        assert ss.laws.custom(normal_force=hertz).kind != first.kind  # a constant, which is in the machine code
    finally:
        SCALE = 2.0
    assert ss.laws.custom(normal_force=lambda overlap, kn: kn * overlap).kind != first.kind
    assert ss.laws.custom(normal_force=hertz, parameters={"extra": 1.0}).kind != first.kind  # another column


def test_parameters_by_pair_of_materials():
    law = ss.laws.custom(normal_force=lambda overlap, kn, well: kn * overlap * (1 - well), parameters={"well": 0.1})
    law = ss.laws.for_pair(law, 0, 1, well=-0.2, mu=0.3)
    names = kinds.find_user_law(law.kind).names
    assert names == ("kn", "kt", "mu", "damping_n", "damping_t", "well")
    assert law.table[0, 1, 5] == law.table[1, 0, 5] == -0.2 and law.table[0, 0, 5] == law.table[1, 1, 5] == 0.1
    with pytest.raises(ValueError, match=r"no parameter 'wall': it has .*well"):
        ss.laws.for_pair(law, 0, 1, wall=1.0)
    assert ss.laws.custom(normal_force=hertz, cap=lambda overlap: overlap).table[0, 0, 2] == 1.0  # has friction


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def normal_force(overlap)\n    return overlap\n", r"line 1: 'def normal_force\(overlap\)' \(expected ':'\)"),
        ("a = 1\nb = a / 0\n", r"does not run, line 2: 'b = a / 0' \(ZeroDivisionError"),
        ("import nowhere_at_all\n", "does not run, line 1: 'import nowhere_at_all'"),
        ("def force(overlap):\n    return overlap\n", "has no function normal_force"),
        ("parameters = 3\ndef normal_force(overlap):\n    return overlap\n", "parameters is a int"),
        ("def normal_force(overlap):\n    return overlap.speed\n", "line 2: 'return overlap.speed'"),
        (
            "def normal_force(overlap):\n    if overlap < 0.1:\n        return overlap\n    return 0.1\n",
            "line 2: 'if ov",
        ),
        ("import sys\nsys.exit(0)\n", r"does not run, line 2: 'sys.exit\(0\)' \(SystemExit: 0\)"),
        ("raise SystemExit\n", "does not run, line 1: 'raise SystemExit'"),
    ],
)
def test_a_bad_file_is_refused_with_its_line(text, message, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as told:
        ss.laws.from_file(path)
    assert "mine.py" in str(told.value) and "\n" not in str(told.value)


def test_a_file_takes_values_and_refuses_names(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        'parameters = {"well": 0.1}\ndef normal_force(overlap, kn, well):\n    return kn * overlap * well\n'
    )
    assert ss.laws.from_file(path, well=0.2, mu=0.3).table[0, 0].tolist() == [1.0, 0.0, 0.3, 0.0, 0.0, 0.2]
    with pytest.raises(ValueError, match="no parameter 'wel': it has well, kn"):
        ss.laws.from_file(path, wel=0.2)
    with pytest.raises(ValueError, match="is not a file"):
        ss.laws.from_file(tmp_path / "other.py")


def test_a_law_names_the_extra_that_compiles_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    law = ss.laws.custom(normal_force=lambda overlap: 0.123 * overlap)
    with pytest.raises(
        MissingExtraError, match=r"^numba is not installed: `pip install \"stickslip\[laws\]\"` installs"
    ):
        law_struct(law)
    law_struct(ss.laws.linear())
