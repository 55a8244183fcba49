"""The recipe for a built-in law in `docs/about/extending.md`, step by step in a copy of the sources."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ENTRY = """\
    BuiltinLaw(
        "stiffening", "k √R δ^(3/2) (1 + c δ)", 1.5, ("Hertz1882",), uses_radius=True,
        parameters=(Parameter("stiffening_c", "1/length", "relative growth of the stiffness"),),
    ),
"""
FORMULA = """\
struct Stiffening : Plain {
  template <class T>
  static Elastic<T> spring(const At<T> &at) {
    Elastic<T> out = hertz(at);
    return {out.force * (at.q[OWN] * at.overlap + 1.0), out.stiffness};
  }

  static double energy(const At<double> &at) {
    return hertz(at).force * at.overlap * (0.4 + 2.0 / 7.0 * at.q[OWN] * at.overlap);
  }
};

"""
CONSTRUCTOR = '''\
@checked
def stiffening(
    kn=1.0, kt=2 / 7, mu=0.5, *, stiffening_c, coulomb="sharp", damping="viscoelastic", damping_n=0.0, damping_t=0.0,
    tension: bool = True,
) -> Law:  # fmt: skip
    """F_n = k_n √R_eff δ^{3/2} (1 + c δ)."""
    own = {"stiffening_c": stiffening_c}
    return make_law("stiffening", coulomb, damping, tension, kn, kt, mu, damping_n, damping_t, **own)


'''
FORM = """\
from math import sqrt

parameters = {"kn": 1.0, "kt": 0.8, "mu": 0.5, "stiffening_c": 0.7}
damping = "viscoelastic"


def normal_force(overlap, r_eff, kn, stiffening_c):
    return kn * overlap * sqrt(overlap * r_eff) * (1 + stiffening_c * overlap)


def normal_energy(overlap, r_eff, kn, stiffening_c):
    return kn * overlap**2 * sqrt(overlap * r_eff) * (0.4 + 2 / 7 * stiffening_c * overlap)


def tangential_stiffness(overlap, r_eff, kt):
    return kt * sqrt(overlap * r_eff)
"""
STEPS = {  # file: text, and the text that comes before it
    "src/stickslip/builtin_laws.py": (")  # fmt: skip\nBY_NAME", ENTRY),
    "src/stickslip/_core/normal_laws.cpp": ("enum Member", FORMULA),
    "src/stickslip/core/laws/builtin.py": ("# by name: each built-in law", CONSTRUCTOR),
    "src/stickslip/laws.pyi": (
        "from .core.laws.builtin import walton_braun", "from .core.laws.builtin import stiffening as stiffening\n",
    ),
    "docs/contact_laws.md": ("| `walton_braun` |", "| `stiffening` | Hertz (1 + c δ) | `stiffening_c` |\n"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_law_needs_one_entry_one_formula_one_constructor_one_form_and_one_line(tmp_path):
    for folder in ("src", "tests", "docs", "examples"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__", "_build"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for name, (after, text) in STEPS.items():
        path = tmp_path / name
        before = path.read_text()
        assert before.count(after) == 1, name
        path.write_text(before.replace(after, text + after))
    formulas, last = tmp_path / "src/stickslip/_core/normal_laws.cpp", "function<LiquidBridge>}"
    formulas.write_text(formulas.read_text().replace(last, last.replace("}", ", function<Stiffening>}")))
    (tmp_path / "tests/laws/forms/stiffening.py").write_text(FORM)
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "src")}
    tests = ["-m", "pytest", "-x", "-p", "no:cacheprovider", "tests/laws/test_normal_laws.py"]
    for command in (["src/stickslip/_core/build.py"], [*tests, "-k", "stiffening or guide"]):
        run = subprocess.run([sys.executable, *command], cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert run.returncode == 0, run.stdout + run.stderr
    assert " passed" in run.stdout and "skipped" not in run.stdout
