"""The same physics in any units: what builds, settles or loads a packing gives the same when units are scaled.

Units that are powers of 4 scale all sums, products and square roots exactly, so that results agree to the last bit. Two
functions do not scale so: NumPy's determinant, from which a cell has its volume (it is the exponential of a sum of
logarithms), and the cube root that gives a free cell in three dimensions its size.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.dynamics.run import stable_time_step
from stickslip.loading.packing import frictionless
from stickslip.solve.equilibrate import quench
from stickslip.wings.studies.flow.scenario import FlowScenario


class Units(NamedTuple):
    """Size of the units in which a test is written, in those of a system of units."""

    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0

    @property
    def force(self):
        return self.mass * self.length / self.time**2

    @property
    def sizes(self):
        """Radii and masses of a packing."""
        return {"radius": self.length * np.array([0.5, 0.7]), "mass": self.mass}

    @property
    def box(self):
        """Arguments of boxes of disks."""
        stiffness = self.force / self.length
        return {
            "pressure": 1e-3 * stiffness, "kn": stiffness, "kt": 0.5 * stiffness, "seed": 1,
            "radius": self.length * np.array([0.4, 0.6]), "density": 4 / np.pi * self.mass / self.length**2,
        }  # fmt: skip

    def law(self, name="hertz_mindlin", mu=0.5, **more):
        power = {"hertz_mindlin": 1.5, "linear": 1.0, "hertz_mindlin_reff": 2.0}[name]
        stiffness = self.force / self.length**power
        return getattr(ss.laws, name)(stiffness, 2 / 7 * stiffness, mu, **more)


@cache
def packing(u, law="hertz_mindlin", n=30, **how):
    how = {"packing_fraction": 0.72, "seed": 3} | how
    return ss.packings.jammed(n, law=u.law(law), **u.sizes, **how)[0]


def under_pressure(u, dim, law):
    how = {"packing_fraction": None, "pressure": 1e-2 * u.force / u.length ** (dim - 1)}
    return packing(u, law, dim=dim, seed=2, **how)


def equilibrated(u):
    """Too far for Newton's method alone, so that damped dynamics helps."""
    end, outcome = ss.equilibrate(ss.packings.sheared(packing(u), 0.05), u.law(mu=0.2), check="nothing")
    assert outcome.fallback
    return end


def at_rest(u):
    law = u.law(damping="viscoelastic", damping_n=0.1 / u.time / u.length)
    moving = ss.packings.perturbed(packing(u), velocity=1e-3 * u.length / u.time, seed=1)
    end, _, outcome = ss.run(moving, law, 20_000, 0.1 * u.time, drag=0.1 / u.time, tolerance=1e-8 * u.force)
    assert outcome.ok
    return end


def sheared_quasistatically(u):
    return ss.protocols.ramp(packing(u), [0.0, 1e-5, 1e-4, 3e-3], ss.protocols.aqs(u.law()))[-1].state


def catalogue(u):
    state, law = packing(u, "linear", n=16, packing_fraction=0.86, dim=2), u.law("linear", mu=10.0)
    record = ss.protocols.find_events(
        state, law, to=0.006, drag=0.2 / stable_time_step(state, law), step=1e-3, smallest=1e-3, most=1,
        resolution=2e-5,
    )  # fmt: skip
    assert record.events
    first = record.events[0]
    return record.state, [first.strain, first.below, first.kind.value, first.jump, first.growth_rate * u.time]


@cache
def threshold(u):
    state, law = packing(u, "linear", dim=2, packing_fraction=0.9), u.law("linear")
    stress = ss.measure.pressure(state, law)
    protocol = ss.protocols.cell_shear(law, stress)
    path = ss.protocols.ramp(state, [0.0, 0.1, 0.2], protocol)
    how = {"realizations": 3, "duration": 40 * u.time, "dt": 0.1 * u.time, "drag": 0.01 / u.time, "distance": 0.02}
    kinetic = ss.protocols.kinetic_threshold(path, protocol, kicks=[0.03 * u.length / u.time], workers=1, **how)
    assert 0 < kinetic.slid.sum() < kinetic.runs.sum()
    return [*kinetic.slid.ravel(), *kinetic.lasting.ravel(), *kinetic.lifetime.ravel() / u.time]


def poured(u):
    length, time = u.length, u.time
    made = ss.packings.poured(FlowScenario.model_validate({
        "experiment": "flow", "samples": 4, "frames": 2, "gravity": [0.0, -1e-3 * length / time**2],
        "grains": {"number": 12, "low": [0, 0.5 * length], "high": [4 * length, 6 * length], "mass": u.mass,
                   "radius": 0.4 * length, "dim": 2, "polydispersity": 0.1},
        "cell": {"size": [4 * length, 8 * length], "periodic": ["x"]},
        "walls": [{"name": "floor", "point": [0, 0], "normal": [0, 1]}],
        "law": {"kind": "linear", "kn": u.force / length, "damping_n": 0.3 / time},
        "stages": [{"name": "settle", "duration": 4.0 * time}],
    }))  # fmt: skip
    return made.state, [made.dt / time]


def loaded(u):
    state, law = ss.packings.biaxial_box(30, **u.box)
    pushed = ss.quasirigid.with_load(state.control, 30 + ss.packings.RIGHT, 1.3)
    path = ss.quasirigid.load_path(state, law, pushed, increment=0.1)
    return path.states[-1], [[event.load for event in path.events], path.verdict]


BUILDERS = {
    "jammed": packing,
    "jammed, R_eff": lambda u: packing(u, "hertz_mindlin_reff"),
    "jammed disks": lambda u: packing(u, "linear", dim=2, packing_fraction=0.9),
    "quench": lambda u: quench(packing(u), frictionless(u.law()), 1e-14 * u.force),
    "biaxial_box": lambda u: ss.packings.biaxial_box(30, **u.box)[0],
    "sheared_box": lambda u: ss.packings.sheared_box(30, **u.box)[0],
    "poured": poured,
    "equilibrate": equilibrated,
    "newton": lambda u: ss.newton(ss.packings.sheared(packing(u), 1e-4), u.law())[0],
    "relax": lambda u: ss.relax(ss.packings.sheared(packing(u), 1e-3), u.law())[0],
    "run": at_rest,
    "aqs": sheared_quasistatically,
    "find_events": catalogue,
    "load_path": loaded,
}
# whose volume counts
BY_VOLUME = {
    "jammed spheres under pressure": lambda u: under_pressure(u, 3, "hertz_mindlin"),
    "jammed disks under pressure": lambda u: under_pressure(u, 2, "linear"),
    "compressed": lambda u: ss.packings.compressed(
        20, pressure=1e-3 * u.force / u.length, dim=2, seed=1, law=u.law(), **u.sizes
    )[0],
}


@cache
def in_own_units(name):
    """Made once for all units, as no test writes to it."""
    return (BUILDERS | BY_VOLUME)[name](Units())


def observed(built, u):
    """What a builder returned, in the units of the test: arrays, numbers and what else must be equal."""
    state, numbers = built if not hasattr(built, "grains") else (built, [])
    count, dim = int(state.contacts.count[0]), state.cell.dim
    cell = state.cell.vectors[:dim] / u.length if state.cell.periodic.any() else np.zeros(0)
    arrays = {
        "position": state.grains.position / u.length, "angle": state.grains.angle, "cell": cell,
        "velocity": state.grains.velocity * (u.time / u.length), "walls": state.walls.point / u.length,
        "mass": state.grains.mass / u.mass, "slip": state.contacts.slip[:count] / u.length,
    }  # fmt: skip
    return arrays, state.contacts.mode[:count].tolist(), numbers


FAR, APART = Units(4.0**-20, 4.0**13, 4.0**-11), Units(4.0**7, 4.0**-13, 4.0**11)  # small lengths, and large ones


@pytest.mark.parametrize(
    ("name", "units"),
    [
        *((name, FAR) for name in BUILDERS),
        *((name, APART) for name in ("jammed", "quench", "biaxial_box", "poured", "newton", "relax")),
    ],
)
def test_powers_of_four_change_no_bit(name, units):
    (arrays, *rest), (same, *others) = observed(in_own_units(name), Units()), observed(BUILDERS[name](units), units)
    assert others == rest
    for key, values in arrays.items():
        np.testing.assert_array_equal(same[key], values, err_msg=key)


def test_units_change_no_outcome_of_kicks():
    """The stress of the cell is exact to round-off, and a run of 400 steps is too short to make it visible."""
    np.testing.assert_array_equal(threshold(APART), threshold(Units()))


@pytest.mark.parametrize(
    ("law", "damping", "unit"),
    [("linear", "velocity", "force time/length"), ("linear", "mass_velocity", "1/time"),
     ("hertz_mindlin_reff", "viscoelastic", "1/time length")],
)  # fmt: skip
def test_units_change_no_restitution(law, damping, unit):
    """The root is found to a relative 1e-9, wherever it lies; the collision, whose depth has an odd root, to 1e-10."""

    @cache
    def gamma(u):
        here = {"radius": 0.5 * u.length, "mass": u.mass, "speed": 0.01 * u.length / u.time}
        damped = ss.laws.with_restitution(u.law(law, damping=damping), 0.7, **here).table[0, 0, 3]
        return damped / {"1/time": 1 / u.time, "1/time length": 1 / u.time / u.length}.get(unit, u.mass / u.time)

    for units in (Units(1e-9, 1e-12, 1e9), Units(1e6, 1e9, 1e-9)):
        assert gamma(units) == pytest.approx(gamma(Units()), rel=1e-8)


def mechanics(state, law, u):
    """Forces [force] on the contacts of a packing, by pair and image, and its cell, in the units of the test."""
    force, count = ss.measure.contact_forces(state, law) / u.force, int(state.contacts.count[0])
    cell = state.cell.vectors[: state.cell.dim] / u.length
    strong = np.abs(force).max(axis=1) > 1e-9  # not those of rattlers that touch by round-off
    return dict(zip(state.contacts.key[:count][strong].tolist(), force[strong], strict=True)), cell


LAWS = {"jammed, R_eff": "hertz_mindlin_reff", "jammed disks": "linear", "jammed disks under pressure": "linear"}


@pytest.mark.parametrize(
    "name",
    [*BY_VOLUME, "jammed disks", "equilibrate", "newton"]
    + [pytest.param(name, marks=pytest.mark.slow) for name in ("jammed, R_eff", "run", "aqs")],
)
@pytest.mark.parametrize(
    "units",
    [
        Units(1e-3, 1e-6, 1e-5),  # SI, kn = 1e4 N/m
        Units(0.1, 1.0, 0.1**0.25),  # radii times 0.1 alone
    ],
    ids=["SI", "radii"],
)
def test_any_units_change_forces_by_round_off(name, units):
    """Forces are differences of positions, whose round-off the way to equilibrium amplifies by some powers of ten."""
    (own, cell), (other, same) = (
        mechanics(state, u.law(LAWS.get(name, "hertz_mindlin")), u)
        for state, u in ((in_own_units(name), Units()), ((BUILDERS | BY_VOLUME)[name](units), units))
    )
    assert other.keys() == own.keys()
    np.testing.assert_allclose(same, cell, rtol=0, atol=1e-9)
    np.testing.assert_allclose(list(other.values()), list(own.values()), rtol=0, atol=1e-9)
