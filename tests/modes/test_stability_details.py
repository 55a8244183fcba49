"""`stickslip stability --more`, for the eye and for programs; and the page that tells what it means."""

import contextlib
import doctest
import io
import json
import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.reports.packing import show
from tests.conftest import stickslip_here
from tests.modes.conftest import LAW

PAGE = Path(__file__).parents[2] / "docs/beyond_the_spectrum.md"
OPTIONS = ["--law", "hertz_mindlin", "--coulomb", "smooth", "--kn", "1", "--kt", str(2 / 7), "--mu", "10"]


def written(state, path):
    ss.io.write_packing(path, state, LAW)
    return path


def test_a_stable_packing_has_moduli_and_transient_growth(calm, tmp_path):
    file = written(calm, tmp_path / "calm.npz")
    done = stickslip_here("stability", file, *OPTIONS, "--more", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    more = json.loads(done.stdout)["more"]
    moduli, transient = ss.modes.elastic_moduli(calm, LAW), ss.modes.transient_growth(calm, LAW)
    assert more["participation_ratio"] == [] and more["reasons"] == {}
    assert more["moduli"]["shear"] == pytest.approx(moduli.shear, rel=1e-9)
    np.testing.assert_allclose(more["moduli"]["voigt"], moduli.voigt, atol=1e-12)
    assert more["transient"]["amplitude"] == pytest.approx(transient.amplitude, rel=1e-6)
    assert len(more["contacts"]) == 5 and all(c["turns"] for c in more["contacts"])
    plain = stickslip_here("stability", file, *OPTIONS, "--json", cwd=tmp_path)
    assert "more" not in json.loads(plain.stdout)


def test_an_unstable_packing_says_who_takes_part_and_which_contact_decides(swinging, tmp_path):
    file = written(swinging, tmp_path / "swings.npz")
    done = stickslip_here("stability", file, *OPTIONS, "--more", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    text = " ".join(done.stdout.split())
    ratio = ss.modes.participation_ratio(ss.stability(swinging, LAW).modes, ss.modes.backbone(swinging, LAW))[0]
    assert f"participation ratios of the growing modes, in this order: {ratio:.3g}" in text
    assert "transient growth: none, since exponential growth" in text
    assert re.search(r"decisive contacts: \d+ of \d+ changes", text)
    assert "∂/∂ln s" in text and "shear G" in text


def test_what_cannot_be_told_has_a_reason(tmp_path):
    place, radius = [[0, 0, 0], [0.99, 0, 0], [0.5, 0.85, 0]], [0.5] * 3
    outwards = ss.forces(ss.packings.from_arrays(place, radius, LAW), LAW)[0].force
    file = written(ss.packings.from_arrays(place, radius, LAW, external_force=-outwards), tmp_path / "three.npz")
    done = stickslip_here("stability", file, *OPTIONS, "--more", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    more = json.loads(done.stdout)["more"]
    assert more["moduli"] is None and "periodic in all its dimensions" in more["reasons"]["moduli"]
    assert more["transient"] is None and more["reasons"]["transient"]
    done = stickslip_here("stability", file, *OPTIONS, "--more", cwd=tmp_path)
    assert done.returncode == 0 and "elastic moduli: none" in " ".join(done.stdout.split())
    file = written(ss.packings.from_arrays(place, radius, LAW), tmp_path / "apart.npz")
    done = stickslip_here("stability", file, *OPTIONS, "--more", "--json", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    more = json.loads(done.stdout)["more"]
    assert set(more["reasons"].values()) == {"since the packing is not in equilibrium"}
    assert len(more["reasons"]) == 3


@pytest.mark.parametrize("name", ["spectrum", "moduli", "sensitivity", "transient"])
def test_examples_of_docstrings(name):
    tried = doctest.testmod(import_module(f"stickslip.solve.{name}"))
    assert tried.attempted and not tried.failed


@pytest.mark.slow
def test_the_example_of_the_page_prints_what_the_page_says():
    text = PAGE.read_text(encoding="utf-8")
    code, shown = re.search(r"```python\n(.*?)```\n+This prints\n+(.*?)\n\n(?=\S)", text, flags=re.S).groups()
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(code, {})
    # minimisation from random places ends in the same packing to round-off, which conditions amplify
    numbers = [[float(x) for x in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", t)] for t in (said.getvalue(), shown)]
    assert re.sub(r"[\d.e-]+", "#", said.getvalue().strip()) == re.sub(r"[\d.e-]+", "#", _flat(shown))
    np.testing.assert_allclose(*numbers, rtol=2e-3)


def _flat(shown):
    return "\n".join(line.strip() for line in shown.strip().splitlines())


def test_a_list_of_negative_eigenvalues_says_how_many_there_are(capsys):
    packing, _ = ss.packings.jammed(12, packing_fraction=0.7, seed=0)
    result = ss.stability(packing, LAW)._replace(negative=-np.arange(1.0, 14.0))
    show(result, LAW, [])
    assert "negative λ, the lowest 12 of 13:" in " ".join(capsys.readouterr().out.split())
