"""Write sheared_spheres.npz, the packing of the quick start: 50 spheres, sheared until a complex pair exists.

python examples/sheared_spheres.py
"""

from pathlib import Path

import numpy as np

import stickslip as ss

law = ss.laws.hertz_mindlin(kn=1.0, kt=2 / 7, mu=10.0, coulomb="smooth")
packing, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
state = ss.protocols.ramp(packing, np.arange(0, 2.1e-3, 1e-4), ss.protocols.aqs(law))[-1].state
c, touch = state.contacts, ss.measure.touching(state)
np.savez_compressed(
    Path(__file__).with_suffix(".npz"), position=state.grains.position, radius=state.grains.radius,
    cell=state.cell.vectors, pair_i=c.i[touch], pair_j=c.j[touch], image=c.image[touch], slip=c.slip[touch],
    law="hertz_mindlin", coulomb="smooth", kn=1.0, kt=2 / 7, mu=10.0,
)  # fmt: skip
