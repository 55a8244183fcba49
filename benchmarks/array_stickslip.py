"""Run the array of `array_lammps.py` with stickslip; print seconds per step with compiled kernels."""

import sys
import time

import stickslip as ss


def main(steps: int) -> None:
    """Relax the array as in LAMMPS, run a warm-up, then time one run."""
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(kn=1.0, kt=2 / 7, mu=10.0, coulomb="sharp"), 0, 1)
    state = ss.packings.disk_array(10, press=5e-5, push=1.5e-5)
    state, _, _ = ss.run(state, law, 20_000, 0.1, drag=0.05, spin_drag=0.0)
    state, _, _ = ss.run(state, law, 1000, 0.1)
    start = time.perf_counter()
    ss.run(state, law, steps, 0.1)
    print((time.perf_counter() - start) / steps)


if __name__ == "__main__":
    main(int(sys.argv[1]))
