"""Loads of contacts with memory are those of LAMMPS `pair_style granular`, see `granular_lammps`."""

import json

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.forces import FREE, bodies
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.laws.compiled import FORCES, law_struct
from stickslip.core.library import core
from tests.laws import granular_lammps as lammps

THEIRS = json.loads(lammps.STORE.read_text())


def loads(law, steps, overlap, wall, after=None):
    """Forces and torques with LAMMPS's slip update, after `steps` steps in place, and one at another overlap."""
    state = with_neighbor_list(lammps.two_spheres(overlap, wall), law)
    g, contacts, n = state.grains, state.contacts, len(state.grains.radius)
    pair = ss.core.measure.branch_vectors(state)[0]
    normal, time = pair / np.linalg.norm(pair), steps * lammps.STEP
    velocity, rolled = g.velocity[0] - (0 if wall else g.velocity[1]), (g.radius[:, None] * g.spin).sum(axis=0)
    slip = velocity + np.cross(normal, rolled)
    turned = g.spin[0] - (0 if wall else g.spin[1])
    tangential = slip - slip @ normal * normal
    contacts.slip[0] = time * tangential
    contacts.mode[0], contacts.pair[0] = ss.STICK, pair
    if contacts.rolling is not None and contacts.rolling.shape[1] >= 7:
        contacts.rolling[0, :3] = time * (turned - turned @ normal * normal)
        if contacts.rolling.shape[1] == 9:
            contacts.rolling[0, 7] = time * turned @ normal
    if after is not None:
        grains = state.grains._replace(position=lammps.two_spheres(after, wall).grains.position)
        state = state._replace(grains=grains)
        contacts.roll[0] = -lammps.STEP * np.cross(tangential, normal)
        if contacts.rolling is not None:
            contacts.rolling[0, 3:6] = 0
    force, torque = np.zeros((2, state.n_bodies, 3))
    struct = law_struct(law, rate=True, members=FORCES)
    core.evaluate_contacts(struct, 3, bodies(state), contacts, state.cell.vectors, FREE, force, torque)
    return {"force": force[:n], "torque": torque[:n]}


@pytest.mark.parametrize("wall", [False, True])
@pytest.mark.parametrize("name", lammps.CASES)
def test_forces_and_torques_are_those_of_lammps(name, wall):
    _, make, steps, overlap, *after = lammps.CASES[name]
    ours, theirs = loads(make(), steps, overlap, wall, *after), THEIRS[f"{name}, {'wall' if wall else 'pair'}"]
    for key, value in ours.items():
        np.testing.assert_allclose(value, theirs[key], rtol=0, atol=1e-12 * np.abs(theirs["force"]).max())
