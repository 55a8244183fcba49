"""Advice that commands print in the form of commands or options: pasted back, it is accepted and does as it says."""

import importlib.metadata
import re
import shlex
import shutil
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement

import stickslip as ss
from stickslip import extras
from stickslip._core import build
from stickslip.data.checkpoint import checkpoint_in
from stickslip.experiments.registry import read_scenario
from tests.conftest import stickslip_here, without_drawing

EXAMPLES = Path(__file__).parents[2] / "examples"
LAW = "--law hertz_mindlin_reff --kn 1 --kt 0.8 --mu 0.2 --damping-n 0 --damping-t 0"
SLIDER = 'experiment = "rate-state"\nsamples.number = 10\n'


def stopped(folder: Path) -> None:
    """A run that was killed before it had saved anything."""
    (folder / "my run").mkdir()
    (folder / "s.toml").write_text(SLIDER)
    checkpoint_in(folder / "my run", read_scenario(folder / "s.toml")).announce()


def packing(folder: Path) -> None:
    shutil.copy(EXAMPLES / "sheared_spheres.npz", folder / "a.npz")


def moved(folder: Path) -> None:
    """A packing that is not in equilibrium, and files with several states."""
    state, law = ss.packings.jammed(16, packing_fraction=0.9, dim=2, seed=1)[0], ss.laws.hertz_mindlin(mu=0.5)
    place = state.grains.position + [1e-3, 0, 0] * (np.arange(16) % 2)[:, None]
    state = state._replace(grains=state.grains._replace(position=place))
    ss.io.write_packing(folder / "m.npz", state, law)
    ss.io.write_packing(folder / "two.h5", [ss.io.frame_of(one, law) for one in (state, state)])
    ss.io.write_packing(folder / "bare.xyz", state, law)


def exported(folder: Path) -> None:
    """A packing as LAMMPS has it, with its contacts, and without the comments that name its columns."""
    law = ss.laws.hertz_mindlin_reff(1.0, 0.8, 0.2, coulomb="sharp")
    state = ss.packings.jammed(16, packing_fraction=0.7, law=law, seed=1)[0]
    for name in ("a.data", "a.npz"):
        ss.io.write_packing(folder / name, state, law)
    head, _, rows = (folder / "a.data").read_text().partition("Atoms # sphere\n\n")
    table = np.loadtxt(rows.partition("\nVel")[0].splitlines())
    table[:, 2] = 1.0  # a diameter, or a type of molecule
    table = [(f"{a:.0f} {b:.0f}", f"{c:.0f} {d!r}", f"{x!r} {y!r} {z!r}") for a, b, c, d, x, y, z, *_ in table.tolist()]
    plain = "\n".join(f"{ids} {size} {place}" for ids, size, place in table)
    mixed = "\n".join(f"{ids} {place} {size} 0" for ids, size, place in table)
    (folder / "plain.data").write_text(f"{head}Atoms\n\n{plain}\n")
    (folder / "mixed.data").write_text(f"{head}Atoms # hybrid\n\n{mixed}\n")


def occupied(folder: Path) -> None:
    """A packing beside a file with the name of its modes."""
    packing(folder)
    (folder / "a-modes.npz").write_text("notes")


def sliders(folder: Path) -> None:
    (folder / "s.toml").write_text(SLIDER)
    (folder / "t.toml").write_text(SLIDER + "seed = 3\n")
    assert stickslip_here("run", "s.toml", "--out", "my out", "--quiet", cwd=folder).returncode == 0


def records(folder: Path) -> None:
    time = np.arange(0.0, 40.0, 0.5)
    place = np.where(time < 10, 0.0, 1e-5 * (time - 10))
    np.savetxt(folder / "held.csv", np.stack([time, 0.6 + 0.01 * np.sin(time), place], axis=1), delimiter=",",
               header="time [s],friction [-],load_point [m]", comments="")  # fmt: skip
    legs = ss.friction.velocity_steps([1e-6, 1e-5, 1e-6], distance=6e-5)
    surface = ss.friction.RateState(mu0=0.6, a=0.01, b=0.015, dc=1e-5, v0=1e-6)
    time = np.arange(0.0, sum(leg.duration for leg in legs), 0.5)
    place = np.interp(time, np.cumsum([0, *(leg.duration for leg in legs)]), 6e-5 * np.arange(4))
    friction = ss.friction.spring_slider(surface, ss.friction.Spring(stiffness=2e3), legs, times=time).friction
    friction = friction + 1e-4 * np.random.default_rng(0).normal(size=len(time))
    ss.friction.write_csv(folder / "slid.csv", ss.friction.LabRecord(time, friction, place))
    np.savetxt(folder / "bare.csv", np.stack([time, 1e6 * place, friction], axis=1), delimiter=",")


def empty(folder: Path) -> None:
    (folder / "s.toml").write_text(SLIDER)
    (folder / "new run").mkdir()


# what is made, the command, its advice, and what is put in place of what only the user knows
CASES = {
    "resume before a page": (stopped, "report 'my run'", r"finish it with stickslip (.*)", {}),
    "first run": (empty, "resume 'new run'", r"start with stickslip (.*)", {"SCENARIO": "s.toml"}),
    "other scenario": (sliders, "run t.toml --out 'my out'", r"or add (--overwrite)", {}),
    "file in the way": (moved, "convert m.npz --to bare.xyz", r"or add (--overwrite)", {}),
    "not at rest": (moved, "stability m.npz", r"come to rest with (--settle)", {}),
    "page of a packing not at rest": (moved, "report m.npz --out m.html", r"settle the packing with (--settle)", {}),
    "several states": (moved, "stability two.h5 --settle", r"(--frame), from ([^,\s]*)", {}),
    "several states to write": (
        moved, "convert two.h5 --to one.npz", r"with (--frame)", {"--frame": "--frame frames/000000"},
    ),
    "no sliding at the start": (
        records, "fit held.csv --stiffness 2000 --law slip", r"\((--before)\)", {"--before": "--before 1e-6"},
    ),
    "no stiffness": (records, "fit slid.csv --law slip", r"give (--stiffness K)", {"K": "2000"}),
    "stiffness to be fitted": (records, "fit slid.csv --law slip", r"or (--free-stiffness)", {}),
    "no headings": (records, "fit bare.csv --stiffness 2000 --law slip", r"\((--columns '.*')\)", {}),
    "parameter of a law": (
        packing, "stability a.npz --law walton_braun --coulomb sharp --settle", r"(--parameter k_unload=…)", {"…": "2"},
    ),
    "no boundaries": (
        exported, "convert a.data --to b.npz --overwrite", r"\((--boundary)\)", {"--boundary": "--boundary ppp"},
    ),
    "style of atoms": (exported, "convert plain.data --to b.npz", r"give (--atom-style sphere)", {}),
    "parts of a style": (
        exported, "convert mixed.data --to b.npz", r"with (--atom-style)",
        {"--atom-style": "--atom-style 'hybrid sphere bond'"},
    ),
    "memory in another file": (
        exported, "convert a.npz --to b.data", r"read it back with (--contacts \S+)",
        {"--contacts": f"convert b.data --to b.npz {LAW} --contacts"},
    ),
    "modes in the way": (occupied, "stability a.npz", r"give (--modes),", {"--modes": "--modes b.npz"}),
    "sharp friction": (
        moved, "stability m.npz --coulomb rough --settle", r"must be (sharp) or", {"sharp": "--coulomb sharp"},
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Function that returns a folder with what is made for several cases."""

    @cache
    def folder(make):
        make(place := tmp_path_factory.mktemp(make.__name__))
        return place

    with without_drawing():
        yield folder


@pytest.mark.parametrize("case", CASES)
def test_advice_can_be_pasted(made, tmp_path, case):
    make, command, pattern, own = CASES[case]
    shutil.copytree(made(make), tmp_path, dirs_exist_ok=True)
    words = shlex.split(command)
    first = stickslip_here(*words, cwd=tmp_path)
    said = " ".join((first.stdout + first.stderr).split())
    found = re.search(pattern, said)
    assert found, said
    text = " ".join(found.groups())
    for name, value in own.items():
        text = text.replace(name, value)
    pasted = shlex.split(text)
    again = stickslip_here(*(words if pasted[0].startswith("--") else []), *pasted, cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert not re.search(pattern, " ".join((again.stdout + again.stderr).split()))


def test_the_command_that_builds_a_core_builds_that_one(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("STICKSLIP_CORE", str(tmp_path / "my core"))
    with pytest.raises(build.BuildError) as error:
        build.library("base")
    _, *words = shlex.split(re.search(r"exist: (.*) builds it$", str(error.value))[1])
    built = []
    monkeypatch.setattr(build, "build", lambda *given, **options: built.append((*given, options["levels"])))
    monkeypatch.setattr(sys, "argv", words)
    build.main()
    assert words[0] == str(build.HERE / "build.py")
    assert built == [(build.HERE, tmp_path / "my core", ("base",))]


def test_extras_that_doctor_advises_exist():
    known = importlib.metadata.metadata("stickslip").get_all("Provides-Extra")
    for extra in extras.EXTRAS:
        pip, install, requirement = shlex.split(extras.install_command(extra).strip("`"))
        assert (pip, install) == ("pip", "install")
        assert Requirement(requirement).name == "stickslip" and Requirement(requirement).extras <= {*known}
