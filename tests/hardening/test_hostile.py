"""Output folders that hold what nobody expects: pipes, devices, links, folders by the names of hidden ones, sweeps."""

import os
import shutil
import signal
from contextlib import contextmanager

import pytest

from stickslip.ensemble import pool
from tests.conftest import stickslip_here, without_drawing

SLIDER = 'experiment = "rate-state"\nseed = {seed}\nsamples.number = 10\n'
SWEEP = SLIDER.format(seed=0) + "[sweep]\n{key} = [0.4, 0.5]\n"
HIDDEN = (".writing", ".unfinished", ".anew", "unfinished")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "default_workers", lambda: 1)  # members of sweeps run in this process
    for seed in (0, 1):
        (tmp_path / f"{seed}.toml").write_text(SLIDER.format(seed=seed))
    for key in ("surface.mu0", "surface.b"):
        (tmp_path / f"{key[8:]}.toml").write_text(SWEEP.format(key=f'"{key}"'))
    return tmp_path


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a run that has ended, for copies."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "0.toml").write_text(SLIDER.format(seed=0))
    with without_drawing():
        assert stickslip_here("run", "0.toml", "--out", "out", cwd=folder).returncode == 0
    return folder / "out"


@contextmanager
def patience(seconds=20):
    """Who waits for a pipe waits for ever."""

    def waits(*_):
        raise AssertionError("no answer")

    before = signal.signal(signal.SIGALRM, waits)
    left = signal.setitimer(signal.ITIMER_REAL, seconds)[0]
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, left)
        signal.signal(signal.SIGALRM, before)


def listing(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


MAKE = {
    "pipe": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "link to nothing": lambda path: path.symlink_to("absent"),
    "link to itself": lambda path: path.symlink_to(path.name),
}


@pytest.mark.parametrize(
    ("name", "kind"),
    [("thing", "device"), ("thing", "link to nothing"), ("series.csv", "pipe"), ("series.csv", "link to itself"),
     ("manifest.json", "device"), ("manifest.json", "pipe"), ("scenario.json", "link to nothing"),
     ("scenario.json", "device")],
)  # fmt: skip
@pytest.mark.parametrize("arguments", [["run", "0.toml"], ["run", "0.toml", "--overwrite"]], ids=["run", "overwrite"])
def test_what_is_no_file_is_never_read(here, kind, name, arguments):
    (here / "out").mkdir()
    MAKE[kind](here / "out" / name)
    with patience():
        run = stickslip_here(*arguments, "--out", "out", cwd=here)
    if "--overwrite" in arguments:
        assert run.returncode == 0, run.stderr
        assert (here / "out" / "series.csv").read_text().startswith("#")
        assert name != "thing" or os.path.lexists(here / "out" / name)
    else:
        assert (run.returncode, run.stderr.count("\n")) == (2, 1)
        assert f"({name})" in run.stderr
        assert os.listdir(here / "out") == [name]


def test_files_that_nobody_may_replace_are_not_read(here, monkeypatch):
    """A folder with large files is told at once."""
    (here / "out").mkdir()
    (here / "out" / "large").write_bytes(b"x")
    monkeypatch.setattr("stickslip.data.run_files.digest", lambda path: pytest.fail(f"{path} is read"))
    assert "(large)" in stickslip_here("run", "0.toml", "--out", "out", cwd=here).stderr


COMMANDS = {"run": ["run", "0.toml"], "sweep": ["run", "b.toml"], "resume": ["resume"]}
KINDS = ("folder", "file", "link")
# every name as every kind, and every name and every kind with every command
MET = [(name, kind, [*COMMANDS][(i + j) % 3]) for i, name in enumerate(HIDDEN) for j, kind in enumerate(KINDS)]


@pytest.mark.parametrize(("name", "kind", "command"), MET)
def test_what_bears_the_names_of_hidden_folders_stays(here, finished, name, kind, command):
    arguments = COMMANDS[command]
    (here / "precious").mkdir()
    (here / "precious" / "mine").write_text("mine")
    if arguments[0] == "resume":
        shutil.copytree(finished, here / "out")
    else:
        (here / "out").mkdir()
    path = here / "out" / name
    if kind == "folder":
        path.mkdir()
        (path / "mine").write_text("mine")
    elif kind == "file":
        path.write_text("mine")
    else:
        path.symlink_to(here / "precious")
    before = listing(here)
    call = [*arguments, "out"] if arguments[0] == "resume" else [*arguments, "--out", "out"]
    for more in ([], ["--overwrite"]) if arguments[0] == "run" else ([],):
        run = stickslip_here(*call, *more, cwd=here)
        assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
        assert f"{name}" in run.stderr
        assert "move it away" in run.stderr or "choose another --out" in run.stderr
        assert listing(here) == before


def test_nothing_else_is_run_in_the_folder_of_a_sweep(here, monkeypatch):
    assert stickslip_here("run", "b.toml", "--out", "out", cwd=here).returncode == 0
    before = listing(here)
    monkeypatch.setattr("stickslip.wings.papers.quasi_rigid.claims.reproduce", lambda **_: pytest.fail("it runs"))
    for arguments in (["reproduce", "quasi-rigid", "--quick"], ["run", "0.toml"]):
        for more in ([], ["--overwrite"]):
            run = stickslip_here(*arguments, "--out", "out", *more, cwd=here)
            assert (run.returncode, run.stderr.count("\n")) == (2, 1)
            assert "out contains the results of a sweep: choose another --out" in run.stderr
            assert listing(here) == before
