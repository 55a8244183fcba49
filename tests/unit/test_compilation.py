"""Compilation is announced: to the logger, and to displays of progress, once per kernel."""

import logging
import os
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
    assert cold.stderr.count(f"stickslip {compilation.ONCE}") == 1
    assert eval(warm.stdout) == [] and compilation.ONCE not in warm.stderr


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
        "first …", f"{compilation.ONCE} …", "second …",
    ]  # fmt: skip
    assert len(caplog.records) == 1
    compilation.start("core.c")  # nobody listens any more
    compilation.end()


def test_functions_of_no_module_are_no_kernels_of_ours():
    space = {"__name__": None}
    exec("def f(x):\n    return x + 1", space)
    with compilation.announced_to(lambda kernel: pytest.fail(str(kernel))):
        assert njit(space["f"])(1) == 2


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="nothing is unwritable for this user")
def test_without_a_folder_for_kernels_the_announcement_says_what_it_costs(tmp_path):
    (tmp_path / "shut").mkdir(mode=0o500)
    assert compilation.ALWAYS in heard_by_a_process(tmp_path / "shut").stderr


def test_the_headline_says_how_often_kernels_are_compiled(monkeypatch):
    monkeypatch.setattr(compilation, "_kept", True)
    assert compilation.headline() == compilation.ONCE
    compilation.forget_afterwards()
    assert compilation.headline() == compilation.ALWAYS


def test_who_waits_at_a_terminal_is_told_once(monkeypatch, capsys):
    monkeypatch.setattr(compilation, "_compiled", [])
    for somebody, said in ((False, 0), (True, 1)):
        monkeypatch.setattr(compilation, "_compiled", [])
        monkeypatch.setattr(compilation, "_somebody_waits", lambda somebody=somebody: somebody)
        for _ in range(2):
            compilation.start("a kernel")
            compilation.end()
        assert capsys.readouterr().err.count("stickslip: compiling kernels") == said
    monkeypatch.setattr(compilation, "_compiled", [])
    with compilation.announced_to(lambda kernel: None):  # a progress display says it
        compilation.start("a kernel")
    assert not capsys.readouterr().err
