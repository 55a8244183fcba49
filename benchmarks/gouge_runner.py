"""Run one side of the gouge benchmark in its own process: `python gouge_runner.py SIDE SCENE STEPS SKIN`.

Prints seconds per step, without samples; the first `WARM` steps are not counted.
"""

import os
import pickle
import sys
import tempfile
import time
from pathlib import Path

from stickslip.experiments.gouge.scenario import GougeScenario

WARM, VELOCITY = 1000, 0.3


def ours(whole, place, steps: int) -> float:
    """Seconds per step of stickslip."""
    import stickslip as ss
    from stickslip.experiments.gouge.dimensionless import stiffness
    from stickslip.experiments.gouge.protocol import load_point_lead
    from stickslip.experiments.gouge.sample import attach_spring

    start, ahead, seconds = place.gouge.state.time, load_point_lead(place.gouge), (WARM + steps) * whole.dt
    course = [start, start + seconds], [ahead, ahead + VELOCITY * seconds]
    gouge = attach_spring(place.gouge, stiffness(whole) * whole.area, *course)
    state, _, _ = ss.run(gouge.state, gouge.law, WARM, whole.dt, threads=1)
    start = time.perf_counter()
    ss.run(state, gouge.law, steps, whole.dt, threads=1)
    return (time.perf_counter() - start) / steps


def lammps(whole, place, steps: int, skin: float) -> float:
    """Seconds per step of LAMMPS."""
    from lammps import lammps as code

    from stickslip.experiments.gouge.lammps import mechanics_commands, write_input

    with tempfile.TemporaryDirectory() as folder:
        write_input(whole, place, VELOCITY, steps, Path(folder))
        os.chdir(folder)
        lmp = code(cmdargs=["-screen", "none", "-log", "none"])
        lmp.commands_string(mechanics_commands(whole, place, VELOCITY, skin))
        lmp.command(f"run {WARM} post no")
        start = time.perf_counter()
        lmp.command(f"run {steps} pre no post no")
        return (time.perf_counter() - start) / steps


def main() -> None:
    """Run the side given on the command line."""
    side, path, steps, skin = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    text, place = pickle.loads(path.read_bytes())
    whole = GougeScenario.model_validate_json(text)
    print(ours(whole, place, steps) if side == "ours" else lammps(whole, place, steps, skin))


if __name__ == "__main__":
    main()
