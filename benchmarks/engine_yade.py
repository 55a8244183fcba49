# ruff: noqa: F405
"""Run the scene of `engine_runner.py` in YADE, `yade -j1 -n -x engine_yade.py SCENE STEPS`; print seconds per step.

E is chosen so that 4/3 E* is k_n = 2; YADE derives k_t from E and ν by Mindlin's formula.
"""

import sys
import time

import numpy as np
from yade import *  # noqa: F403

scene, steps = dict(np.load(sys.argv[1])), int(sys.argv[2])
size = float(scene["size"])
O.periodic = True
O.cell.setBox(size, size, size)
material = O.materials.append(FrictMat(young=3 * (1 - 0.3**2), poisson=0.3, frictionAngle=np.arctan(0.5), density=1.0))
for x, r, v in zip(scene["position"] % size, scene["radius"], scene["velocity"], strict=True):
    body = sphere(tuple(x), float(r), material=material)
    body.state.vel = Vector3(*v)
    O.bodies.append(body)
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb()], verletDist=0.1),
    InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom()], [Ip2_FrictMat_FrictMat_MindlinPhys()], [Law2_ScGeom_MindlinPhys_Mindlin()]
    ),
    NewtonIntegrator(damping=0),
]
O.dt = float(scene["dt"])
O.run(20, True)
start = time.perf_counter()
O.run(steps, True)
print("seconds", (time.perf_counter() - start) / steps)
