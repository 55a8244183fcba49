"""Shared assemblies, and a process in which NaN raises errors and no test takes a minute."""

import contextlib
import gc
import io
import os
import pickle
import subprocess
import sys
import warnings
from functools import wraps
from types import SimpleNamespace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one test process runs on each core

import numpy as np
import pytest
import typer.main
from hypothesis import settings
from matplotlib.figure import Figure
from PIL import Image

import stickslip as ss
from stickslip.core.contacts.forces import accept, forces
from stickslip.core.laws.builtin import for_pair
from stickslip.core.state import assembly, box, disks, flat_walls, loads, spheres
from stickslip.data.sample import LAWS
from stickslip.figures import style
from stickslip.solve import birth

settings.register_profile("ci", deadline=None, max_examples=40, derandomize=True)
settings.load_profile("ci")


pytest_plugins = ("tests.durations",)

# folders of `make quick`, without files that start other processes or have a long preparation
QUICK = ("unit", "derivatives", "laws", "faults", "exchange")


def pytest_addoption(parser):
    parser.addoption(
        "--quick", action="store_true", help="tests for the edit-test loop: no other processes, no long runs"
    )


def _is_quick(path) -> bool:
    if path.parent.name not in QUICK:
        return False
    text = path.read_text(encoding="utf-8")
    return not any(word in text for word in ("subprocess", "stickslip_here", "tests.published", 'scope="module"'))


def pytest_collection_modifyitems(config, items):
    """Give slow tests an hour; with --quick, run only quick files."""
    if config.getoption("--quick"):
        quick = {path: _is_quick(path) for path in {item.path for item in items}}
        config.hook.pytest_deselected(items=[item for item in items if not quick[item.path]])
        items[:] = [item for item in items if quick[item.path]]
    for item in items:
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(3600))


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect garbage rarely, and exclude objects held by modules: collection takes a tenth of the time of the tests.

    Rewriting the assertions of all modules creates millions of objects, on which a third of its time was spent.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.set_threshold(20_000, 20, 20)
        gc.enable()


_get_command, _commands = typer.main.get_command, {}


def get_command_once(app):
    """Parse the signatures of all commands once for all tests that call the command line, to save 0.03 s per call."""
    state = app, *app.registered_commands
    if state not in _commands:
        _commands[state] = _get_command(app)
    return _commands[state]


typer.main.get_command = get_command_once


_birth_form, _forms = birth.birth_form, {}


@wraps(_birth_form)
def birth_form_once(state, law, **how):
    """Find the normal form of a state once for all tests: every page of the same packing states it, at 1 s each."""
    try:
        key = pickle.dumps((state, law, how))
    except Exception:  # an object that cannot be pickled is no state
        return _birth_form(state, law, **how)
    if key not in _forms:
        _forms[key] = _birth_form(state, law, **how)
    return _forms[key]


birth.birth_form = birth_form_once
os.fsync = lambda file: None  # each call waits 10 ms for a disk, and no test can cut the power


@pytest.fixture(autouse=True)
def _loud_floating_point():
    with np.errstate(all="raise", under="ignore"):
        yield


# folders and files without figure tests; figures of flows, faults and sliders are drawn in test_axes_of_figures.py
PLAIN = {
    "hardening", "restart", "ensemble", "laws", "peers", "exchange", "lammps", "reports", "test_cli", "test_output",
    "test_lock", "test_help", "test_flow", "test_fault_experiment", "test_rate_state_cli", "test_noisy_records",
    "test_pasted_advice", "test_gouge_samples", "test_units",
}  # fmt: skip
_savefig = Figure.savefig


def save_noise(figure, path, format=None, **options):
    """Save noise of the size of a figure, as drawing takes a second; frames of movies are drawn."""
    if format == "rgba":
        return _savefig(figure, path, format=format, **options)
    return Image.effect_noise((300, 300), 100).save(path, format)


@contextlib.contextmanager
def without_drawing():
    """Write noise for figures that nobody checks, in fixtures of modules and sessions."""
    with pytest.MonkeyPatch.context() as now:
        now.setattr(Figure, "savefig", save_noise)
        now.setattr(style, "_letter", lambda figure: [])  # placed after a layout, half the time of drawing
        yield


@pytest.fixture
def plain_figures():
    """Skip drawing in a test that writes figures without checking them."""
    with without_drawing():
        yield


@pytest.fixture(autouse=True)
def _plain_figures(request):
    if {request.path.parent.name, request.path.stem} & PLAIN:
        request.getfixturevalue("plain_figures")


@pytest.fixture(scope="session")
def few_spheres(tmp_path_factory):
    """File of a sheared packing with a complex pair, smaller than that of the examples, with the same arrays."""
    law = ss.laws.hertz_mindlin(kn=1.0, kt=2 / 7, mu=10.0, coulomb="smooth")
    packing, _ = ss.packings.jammed(18, packing_fraction=0.7, seed=1)
    state = ss.protocols.ramp(packing, np.arange(0, 5e-3, 2.5e-4), ss.protocols.aqs(law))[-1].state
    ss.io.write_packing(path := tmp_path_factory.mktemp("few") / "few_spheres.npz", state, law)
    return path


def make_law(name, coulomb, mu=0.4, **more):
    """Law whose grain–wall friction differs from its grain–grain friction."""
    return for_pair(LAWS[name](1.0, 2 / 7, mu, coulomb=coulomb, **more), 0, 1, mu=0.7 * mu, kn=1.3, kt=0.5)


def make_packing(dim, seed=0, n=7, wall=True, overlap=0.05):
    """Grains of different radii on a floor, in a periodic box so small that some touch through two images."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.4, 0.6, n)
    axes = [0] if dim == 2 else [0, 1]
    up = 1 if dim == 2 else 2
    position = np.zeros((n, 3))
    position[:, up] = np.linspace(0.5 - overlap, 0.5 - overlap + 0.62 * (n - 1), n)
    for a in axes:
        position[:, a] = np.cumsum(rng.choice([-1, 1], n) * rng.uniform(0.4, 0.5, n))
    size, periodic = np.array([1.55, 1.55, 1.55]), np.zeros(3, bool)
    periodic[axes] = True
    size[up] = 10.0
    normal = np.eye(3)[up]
    walls = flat_walls([0, 0, 0], normal, material=1) if wall else flat_walls()
    make = disks if dim == 2 else spheres
    grains = make(position, radius, mass=rng.uniform(0.5, 2, n))
    return assembly(grains, walls, box(size, periodic, dim), loads(n, len(walls.mass)))


def stirred(state, law, rng, size=0.02, times=3):
    """State after several random displacements, each committed, so that contacts carry slip and some slide."""
    dim, n = state.cell.dim, len(state.grains.radius)
    for _ in range(times):
        _, trial = forces(state, law)
        state = accept(state, trial)
        move, turn = rng.normal(0, size, (2, n, 3))
        if dim == 2:
            move[:, 2] = turn[:, :2] = 0
        grains = state.grains
        state = state._replace(grains=grains._replace(position=grains.position + move, angle=grains.angle + turn))
    _, trial = forces(state, law)
    return accept(state, trial)


def stickslip_process(*arguments, cwd=None):
    """Output and exit status of the command line in a separate process."""
    call = [sys.executable, "-c", "from stickslip.cli import main; main()", *map(str, arguments)]
    return subprocess.run(call, capture_output=True, text=True, cwd=cwd)


def stickslip_here(*arguments, cwd=None):
    """Output and exit status of the command line in this process, a second faster than in a separate one."""
    from stickslip.cli import main

    out, err, argv = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["stickslip", *map(str, arguments)]
    go = contextlib.chdir(cwd) if cwd else contextlib.nullcontext()
    with go, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        finally:
            sys.argv = argv
    return SimpleNamespace(returncode=code, stdout=out.getvalue(), stderr=err.getvalue())
