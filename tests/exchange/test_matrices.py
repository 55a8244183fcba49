"""Matrices in files for other programs: read by SciPy alone, they give the same motion and contact status."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from scipy.io import mmread
from scipy.linalg import eigvals

import stickslip as ss
from stickslip.cli import main
from tests.conftest import make_law, make_packing, stickslip_here, stirred

ROOT = Path(__file__).parents[2]
LAW = make_law("linear", "sharp")


def read(path) -> dict:
    """Matrices and vectors of a file or folder, without stickslip."""
    if path.is_dir():
        return {one.stem: mmread(one) for one in path.iterdir()}
    with np.load(path) as file:
        names = dict.fromkeys(name.partition(".")[0] for name in file)
        return {
            name: sparse.csr_array(
                tuple(file[f"{name}.{part}"] for part in ("data", "indices", "indptr")), shape=file[f"{name}.shape"]
            )
            if f"{name}.shape" in file
            else file[name]
            for name in names
        }


@pytest.mark.parametrize("name", ["m.npz", "m"])
def test_matrices_read_again_give_the_motion(tmp_path, name):
    state = stirred(make_packing(2), LAW, np.random.default_rng(1))
    motion = ss.modes.equations_of_motion(state, LAW)
    ss.io.write_matrices(tmp_path / name, motion)
    found = read(tmp_path / name)
    assert set(found) == set(motion._fields)
    for key, value in motion._asdict().items():
        there = found[key]
        a, b = (one.toarray() if sparse.issparse(one) else np.asarray(one) for one in (value, there))
        assert np.array_equal(a, b.reshape(a.shape)), key
    size, mass = len(motion.mass), found["mass"].reshape(-1, 1)
    blocks = [found[key].toarray() / mass for key in ("jacobian", "damping")]
    values = eigvals(np.block([[np.zeros((size, size)), np.eye(size)], blocks]))
    ours = ss.modes.damped_growth(state, LAW)
    assert np.abs(np.sort(values.real) - np.sort(ours.real)).max() < 1e-6 * np.abs(ours).max()


def test_the_linear_system_read_again_gives_its_stiffness_and_the_complementarity_problem(tmp_path):
    state, _ = ss.packings.jammed(16, packing_fraction=0.9, dim=2, seed=1)
    law = ss.laws.hertz_mindlin(mu=0.5, coulomb="sharp")
    system = ss.quasirigid.linear_system(state, law)
    load = np.random.default_rng(0).normal(size=len(system.free))
    problem = ss.quasirigid.complementarity(system, load, critical=np.arange(3))
    ss.io.write_matrices(tmp_path / "s.npz", system, problem)
    found = read(tmp_path / "s.npz")
    springs = sparse.block_diag(list(found["springs"]))
    stuck = (found["c"] @ springs @ found["c"].T + found["geometric"] + found["machine"]).toarray()
    assert np.allclose(stuck, ss.quasirigid.stiffness_matrix(system).toarray())
    assert np.array_equal(found["matrix"], problem.matrix) and np.array_equal(found["vector"], problem.vector)
    assert all(np.array_equal(found[name], getattr(system.free, name)) for name in ("mass", "body", "axis"))
    assert found["c"].shape[0] == len(found["body"]) and np.array_equal(found["sign"], system.sign)
    slippery = ss.quasirigid.linear_system(state, ss.laws.hertz_mindlin(mu=0.0, coulomb="sharp"))
    with pytest.raises(np.linalg.LinAlgError, match="there are unresisted motions"):
        ss.quasirigid.complementarity(slippery, load, critical=np.arange(3))


@pytest.mark.parametrize(
    ("name", "sources", "message"),
    [
        ("a.npz", (), "there is nothing to write"),
        ("a.npz", ({"n": 3},), "dict has no matrices"),
        ("a.npz", ({"a": np.ones(2)}, {"a": np.ones(2)}), "a occurs twice"),
        ("a.mtx", ({"a": np.ones(2)},), "expected NAME.npz, or a folder"),
        ("there", ({"a": np.ones(2)},), "there is a file: give another name"),
        ("no/a.npz", ({"a": np.ones(2)},), "no is not a folder: create it first"),
    ],
)
def test_refusals(tmp_path, name, sources, message):
    (tmp_path / "there").write_text("notes")
    with pytest.raises(ValueError, match=message):
        ss.io.write_matrices(tmp_path / name, *sources)
    assert [one.name for one in tmp_path.iterdir()] == ["there"]


def test_stability_writes_matrices_once(tmp_path):
    packing = [str(ROOT / "examples" / "sheared_spheres.npz"), "--json", "--matrices", "m"]
    packing += ["--damping", "viscoelastic", "--damping-n", "1", "--no-dashpots"]
    assert stickslip_here("stability", *packing, cwd=tmp_path).returncode == 0
    found = read(tmp_path / "m")
    assert found["jacobian"].shape == (300, 300) and found["damping"].nnz == 0
    again = stickslip_here("stability", *packing, cwd=tmp_path)
    assert again.returncode == 2 and "exists: give another name" in again.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--matrices", "a.npz", "--modes", "./a.npz"], "--matrices and --modes name the same file a.npz"),
        (["--matrices", ""], "--matrices has no name: give NAME.npz, or a folder"),
        (["--matrices", "a.mtx", "--settle"], "expected NAME.npz, or a folder for Matrix Market files, got a.mtx"),
    ],
)
def test_names_of_files_are_checked_before_the_analysis(tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("stickslip.loading.reading.read_packing", None)
    monkeypatch.setattr(sys, "argv", ["stickslip", "stability", str(ROOT / "examples/sheared_spheres.npz"), *options])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2 and message in capsys.readouterr().err and not list(tmp_path.iterdir())
