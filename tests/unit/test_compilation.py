"""Compilation is announced: to the logger, and to displays of progress, once per kernel."""

import logging
import subprocess
import sys

import pytest
from numba import njit

from stickslip import compilation
from stickslip.experiments import terminal

CODE = """
import logging, numpy as np
logging.basicConfig(level=logging.INFO, format="%(name)s %(message)s")
import stickslip as ss
from stickslip.compilation import announced_to
heard = []
state = ss.assembly(ss.disks([[0.0, 0.0], [0.99, 0.0]], 0.5), cell=ss.box(dim=2))
with announced_to(heard.append):
    ss.forces(state, ss.laws.hertz_mindlin())
print(heard)
"""


def heard_by_a_process(cache) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", CODE], capture_output=True, text=True, env={"XDG_CACHE_HOME": str(cache), "PATH": ""}
    )


def test_kernels_are_announced_while_they_are_compiled_and_not_when_they_are_loaded(tmp_path):
    cold, warm = heard_by_a_process(tmp_path), heard_by_a_process(tmp_path)
    heard = eval(cold.stdout)
    assert "core.contacts.forces.evaluate" in heard[::2] and set(heard[1::2]) == {None}
    assert cold.stderr.count(f"stickslip {compilation.WORDS}") == 1
    assert eval(warm.stdout) == [] and compilation.WORDS not in warm.stderr


def test_progress_shows_the_kernel_that_is_compiled(capsys, monkeypatch, caplog):
    monkeypatch.setattr(compilation, "_compiled", [])
    with caplog.at_level(logging.INFO, "stickslip"), terminal.progress() as tell:
        tell("first", 0.5, "half")
        compilation.start("core.a")
        compilation.end()
        tell("second", 0.1, "more")
        compilation.start("core.b")
        compilation.end()
    assert [line for line in capsys.readouterr().out.splitlines() if line] == [
        "first …", f"{compilation.WORDS} …", "second …",
    ]  # fmt: skip
    assert len(caplog.records) == 1
    compilation.start("core.c")  # nobody listens any more
    compilation.end()


def test_functions_of_no_module_are_no_kernels_of_ours():
    space = {"__name__": None}
    exec("def f(x):\n    return x + 1", space)
    with compilation.announced_to(lambda kernel: pytest.fail(str(kernel))):
        assert njit(space["f"])(1) == 2
