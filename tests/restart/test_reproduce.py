"""A reproduction that was stopped is resumed with the arguments with which it was started."""

import functools
import inspect
import json
from pathlib import Path

import pytest

from stickslip.data.checkpoint import checkpoint_in
from stickslip.data.run_files import UNFINISHED
from stickslip.experiments.registry import papers
from stickslip.runs.folder import mark_reproduction, reproduction_arguments
from tests.conftest import stickslip_here as stickslip

VALUES = {bool: True, int: 3, int | None: 3, Path | None: Path("kept").absolute()}
NEEDED = {"realizations": ["--paper-size"], "samples": ["--paper-size", "--realizations", "3"]}
CASES = [(name, option) for name in papers() for option in reproduction_arguments(name).model_fields]


@pytest.mark.parametrize(("name", "option"), CASES)
def test_a_stopped_reproduction_goes_on_with_its_options(name, option, tmp_path, monkeypatch):
    """Each paper with each of its options: stopped after something was saved, and resumed."""
    calls, real = [], papers()[name].paper.reproduce.resolve()

    @functools.wraps(real)
    def stop(*, folder, **arguments):
        calls.append({key: value for key, value in arguments.items() if key not in ("report", "workers")})
        checkpoint_in(folder, papers()[name].paper.scenario()).of("part").save("piece", 1.0)
        raise KeyboardInterrupt

    monkeypatch.setattr(inspect.getmodule(real), real.__name__, stop)
    kind = reproduction_arguments(name).model_fields[option].annotation
    value, flag = VALUES[kind], f"--{option.replace('_', '-')}"
    words = [*NEEDED.get(option, []), flag, *([] if kind is bool else [value])]
    out = tmp_path / "out"
    first = stickslip("reproduce", name, *words, "--out", out)
    assert f"continue with stickslip resume {out}" in " ".join(first.stderr.split())
    second = stickslip("resume", out)
    assert "stopped by the user" in second.stderr, second.stderr
    assert calls[0][option] == value
    assert calls[1] == reproduction_arguments(name)(**calls[0]).model_dump()


@pytest.mark.parametrize("change", [{"seed": "0"}, {"fast": True}, {"experiment": "gauge"}, {"experiment": None}])
def test_other_arguments_are_named(change, tmp_path):
    paper = papers()["sphere-shear"].paper
    mark_reproduction(tmp_path, paper.scenario(), "sphere-shear", quick=True)
    file = tmp_path / UNFINISHED / "reproduce.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    done = stickslip("resume", tmp_path)
    assert done.returncode == 2
    assert "reproduce.json is damaged: start again with --overwrite" in " ".join(done.stderr.split())
