"""Units, entry by entry, against a table that was written from what the quantities are."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.data import units
from stickslip.figures.quantities import quantities

# exponents of mass, length and time, as (M, L, T); stresses in d dimensions as their own word
LENGTH, TIME, VELOCITY, ANGLE = (0, 1, 0), (0, 0, 1), (0, 1, -1), "rad"
FORCE, ENERGY, STRESS, NUMBER = (1, 1, -2), (1, 2, -2), "stress", (0, 0, 0)
MEANT = {
    LENGTH: "anchor bottom center dc dc2 depth edges high load_point low max_slip nucleation_length overlap pair "
    "plate_position point position radius roll slip station surface_slip thickness top turns vectors wall_point",
    TIME: "breach close_time dt end hold knots slide snapshot_time start theta theta2 time turn_time",
    VELOCITY: "after before max_velocity profile_velocity speed surface_velocity velocity",
    ANGLE: "angle",
    "rad/T": "spin",
    (1, 0, 0): "mass",
    (1, 2, 0): "inertia",
    FORCE: "force plate_force residual wall_force",
    "moment": "torque",
    (1, 0, -2): "spring",
    ENERGY: "coulomb defect drag elastic_energy external kinetic kinetic_energy nonpotential tangential viscous",
    STRESS: "pressure shear_stress stress",
    "energy per length": "frictional loading radiated",
    (1, 1, -3): "moment_rate",
    (0, 1, -2): "gravity",
    (0, 2, 0): "close_msd msd saturation snapshot_msd",
    (0, 2, -2): "temperature",
    (0, 0, -1): "frequency growth_rate predicted_frequency predicted_growth rate",
    (0, 0, -2): "eigenvalue eigenvalues im_lambda largest re_pair smallest snapshots softest switch switched",
    NUMBER: "contact_friction coordination fabric friction packing_fraction ratio sliding_fraction strain unbalanced "
    "volumetric",
}
# how each kind is written: as dimensions, and in SI
WRITTEN = {
    LENGTH: ("length", "m"), TIME: ("time", "s"), VELOCITY: ("length/time", "m/s"), ANGLE: ("rad", "rad"),
    "rad/T": ("rad/time", "rad/s"), (1, 0, 0): ("mass", "kg"), (1, 2, 0): ("mass length^2", "kg m^2"),
    FORCE: ("force", "N"), "moment": ("force length", "N m"), (1, 0, -2): ("force/length", "N/m"),
    ENERGY: ("energy", "J"), STRESS: ("force/length^(dim-1)", "Pa"), (0, 1, -2): ("length/time^2", "m/s^2"),
    (0, 2, 0): ("length^2", "m^2"), (0, 2, -2): ("length^2/time^2", "m^2/s^2"), (0, 0, -1): ("1/time", "1/s"),
    (0, 0, -2): ("1/time^2", "1/s^2"), NUMBER: ("1", "1"), (1, 1, -3): ("force/time", "N/s"),
    "energy per length": ("energy/length", "J/m"),
}  # fmt: skip
BASE = {
    "m": (0, 1, 0), "s": (0, 0, 1), "kg": (1, 0, 0), "N": (1, 1, -2), "J": (1, 2, -2), "rad": (0, 0, 0), "1": (0, 0, 0),
    "length": (0, 1, 0), "time": (0, 0, 1), "mass": (1, 0, 0), "force": (1, 1, -2), "energy": (1, 2, -2),
}  # fmt: skip


def exponents(unit: str) -> tuple:
    """(M, L, T) of a unit such as kg m^2 or length/time^2."""
    total = np.zeros(3, int)
    above, _, below = unit.partition("/")
    for side, sign in ((above, 1), (below, -1)):
        for word in side.split():
            name, _, power = word.partition("^")
            total += sign * int(power or 1) * np.array(BASE[name])
    return tuple(total.tolist())


def test_every_entry_is_what_the_quantity_is():
    meant = {name: WRITTEN[kind] for kind, names in MEANT.items() for name in names.split()}
    told = {name: (units.unit_of(name), units.unit_of(name, si=True)) for name in units._UNITS}
    assert told == meant
    for kind, both in WRITTEN.items():
        if kind != STRESS:  # has the dimensions of a pressure in space only
            assert exponents(both[0]) == exponents(both[1]), kind
        if isinstance(kind, tuple):
            assert exponents(both[1]) == kind


@pytest.mark.parametrize("si", [False, True])
def test_what_has_two_units_or_none_has_none(si):
    assert units.unit_of("rate", noun="Control", si=si) is None  # velocities and spins
    assert units.unit_of("stress", noun="Control", si=si) == ("Pa" if si else "force/length^(dim-1)")
    assert units.unit_of("force", noun="Instant", si=si) is None  # forces and torques
    assert units.unit_of("pull", noun="Instant", si=si) == ("1/s^2" if si else "1/time^2")
    assert units.unit_of("kind", si=si) is None


def test_what_grains_are_coloured_by_has_its_unit():
    """A number per length in two dimensions, per area in three; Pa only where there is an area."""
    law = ss.laws.hertz_mindlin_reff(2.0, 1.5, 0.2)
    told = {}
    for dim in (2, 3):
        place = np.array([[0, 0, 0], [0.99, 0, 0]])[:, :dim]
        frame = ss.io.frame_of(ss.packings.from_arrays(place, [0.5, 0.5], law, dim=dim), law)
        before = ss.io.frame_of(frame.state, law)
        for si in (False, True):
            told[dim, si] = {name: unit for name, (_, unit) in quantities(frame, first=before, si=si).items()}
    bare = {"material": "", "coordination": "", "sliding contacts": ""}
    own = {"radius": "length", "speed": "length/time", "displacement": "length"} | bare
    real = {"radius": "m", "speed": "m/s", "displacement": "m"} | bare
    assert told[2, False] == own | {"pressure": "force/length"}
    assert told[3, False] == own | {"pressure": "force/length²"}
    assert told[2, True] == real | {"pressure": "N/m"}
    assert told[3, True] == real | {"pressure": "Pa"}


def test_the_pressure_of_a_grain_is_force_times_lever_over_its_volume():
    """p = (1/(3 V)) Σ F l, with l from the centre to the contact: the branch's share by radius, all of it at a wall."""
    law, small, large, overlap = ss.laws.hertz_mindlin_reff(2.0, 1.5, 0.2), 0.3, 0.6, 0.01
    place = [[0, 0, small - overlap], [0, 0, 2 * small + large - 2 * overlap]]
    state = ss.assembly(ss.spheres(place, [small, large]), ss.flat_walls([0, 0, 0], [0, 0, 1]))
    state = ss.accept(state, ss.forces(state, law)[1])
    found = quantities(ss.io.frame_of(state, law))["pressure"][0]
    at_wall, between = (2.0 * overlap * np.sqrt(overlap * r) for r in (small, small * large / (small + large)))
    branch = small + large - overlap
    levers = [at_wall * (small - overlap) + between * branch * small / (small + large), between * branch * 2 / 3]
    volumes = [4 / 3 * np.pi * r**3 for r in (small, large)]
    np.testing.assert_allclose(found, np.array(levers) / volumes / 3, rtol=1e-11)  # round-off of an overlap of 0.01
