"""Modes replace neither the packing nor, under the name that they have unasked, what is something else."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from stickslip.reports.packing import check_modes
from tests.conftest import stickslip_here

PACKING = Path(__file__).parents[2] / "examples" / "sheared_spheres.npz"


@pytest.fixture
def here(tmp_path):
    shutil.copy(PACKING, tmp_path / "a.npz")
    return tmp_path


def test_modes_never_replace_the_packing(here):
    before = (here / "a.npz").read_bytes()
    run = stickslip_here("stability", "a.npz", "--settle", "--modes", "./a.npz", cwd=here)
    assert run.returncode == 2
    assert "--modes a.npz would replace the packing: give another name" in run.stderr
    assert (here / "a.npz").read_bytes() == before


@pytest.mark.parametrize("content", [b"mine", b"", PACKING.read_bytes()], ids=["text", "empty", "packing"])
def test_a_name_that_nobody_gave_replaces_modes_only(here, content):
    (here / "a-modes.npz").write_bytes(content)
    run = stickslip_here("stability", "a.npz", cwd=here)
    assert run.returncode == 2
    assert "modes would replace a-modes.npz, which does not contain modes: give --modes" in run.stderr
    assert (here / "a-modes.npz").read_bytes() == content
    assert stickslip_here("stability", "a.npz", "--json", cwd=here).returncode in (0, 3)


def test_modes_replace_earlier_ones(here):
    modes = np.zeros((1, 2, 3))
    np.savez(here / "a-modes.npz", eigenvalue=[1j], exponent=[1j], translation=modes, rotation=modes, rattlers=[])
    check_modes(here / "a-modes.npz", here / "a.npz", asked=False)
