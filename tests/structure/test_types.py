"""A type checker sees every public name, although it is imported when first used."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import stickslip

pytest.importorskip("mypy")

HERE = os.environ | {"MYPYPATH": str(Path(stickslip.__file__).parents[1])}
PROGRAM = """
import stickslip as ss

law = ss.laws.hertz_mindlin(kn=1.0, kt=2 / 7, mu=10.0, coulomb="smooth")
state, info = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
found: ss.results.Stability = ss.stability(state, law)
print(found.verdict, ss.measure.coordination(state), ss.figures.packing, ss.experiments.gouge.GougeScenario)
print(ss.simulate(ss.scenario(array={"disks": 5})), ss.friction.fit, ss.quasirigid.load_path, ss.io.open_dataset)
print(ss.stabilty)
print(ss.friction.fits)
rate: str = found.residual
"""


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_mypy_sees_names_and_types(tmp_path):
    (tmp_path / "user.py").write_text(PROGRAM)
    arguments = [sys.executable, "-m", "mypy", "--follow-imports=silent", "--ignore-missing-imports", "user.py"]
    said = subprocess.run(arguments, cwd=tmp_path, capture_output=True, text=True, timeout=280, env=HERE).stdout
    errors = [line for line in said.splitlines() if ": error: " in line]
    assert [line.split(":")[1] for line in errors] == ["9", "10", "11"], said
    assert '"stabilty"' in errors[0]
    assert '"fits"' in errors[1]
    assert '"float"' in errors[2]
