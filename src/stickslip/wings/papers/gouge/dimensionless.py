"""Dimensionless numbers of a gouge experiment, each with its defining formula."""

from typing import NamedTuple

import numpy as np

from ....measure import inertial_number
from .scenario import GougeScenario

# limits of the quasi-static range of hard grains, in a layer that is not dominated by its plates
INERTIAL, STIFFNESS, OVERLAP, LAYER = 1e-3, 100.0, 0.02, 8.0
LONG = 0.4  # share of the largest stable time step above which the stiffest contacts are wrong by at least a per cent


def stiffness(scenario: GougeScenario, value: float | None = None, definition: str | None = None) -> float:
    """Stiffness k of the spring per unit area of the plate [Pa/m], from `value` in terms of `definition`.

    The default is the scenario's stiffness. The definitions are per_area, k; per_stress, k/σ; grain, k D/σ; rate_state,
    k dc/(b σ).

    Examples
    --------
    The 425 of Ferdowsi & Rubin 2021 as `rate_state`, in units of σ/D:

    >>> import stickslip as ss
    >>> slide = {"kind": "slide", "velocity": 0.1, "slip": 1.0}
    >>> paper = ss.scenario(experiment="gouge", law={"damping_n": 1e4}, protocol=[slide])
    >>> k = stiffness(paper, 425.0, "rate_state")
    >>> round(k * paper.grains.mean / paper.load.normal_stress, 2)
    4.28
    """
    load = scenario.load
    value, definition = (load.stiffness, load.definition) if value is None else (value, definition)
    return value * _unit(scenario, definition)


def normalised_stiffness(scenario: GougeScenario) -> dict[str, float]:
    """Return the scenario's stiffness in terms of every definition; see `stiffness`."""
    return {
        name: stiffness(scenario) / _unit(scenario, name) for name in ("per_area", "per_stress", "grain", "rate_state")
    }


def _unit(scenario: GougeScenario, definition: str) -> float:
    stress, scales = scenario.load.normal_stress, scenario.scales
    return {
        "per_area": 1.0,
        "per_stress": stress,
        "grain": stress / scenario.grains.mean,
        "rate_state": scales.b * stress / scales.dc,
    }[definition]


def normalised_hold(scenario: GougeScenario, hold: float, velocity: float) -> dict[str, float]:
    """Return a hold time t after sliding at V in terms of every definition (Ferdowsi & Rubin 2021: 1650, with none).

    The definitions are load_point, V t/dc; frozen, k V t/(a σ), which governs the decay of the velocity in a hold with
    frozen state; inertial, t/(D √(ρ/σ)).
    """
    stress, scales, grains = scenario.load.normal_stress, scenario.scales, scenario.grains
    return {
        "load_point": velocity * hold / scales.dc,
        "frozen": stiffness(scenario) * velocity * hold / (scales.a * stress),
        "inertial": hold / (grains.mean * np.sqrt(grains.density / stress)),
    }


def inertial_numbers(scenario: GougeScenario, velocity: float, thickness: float) -> dict[str, float]:
    """Return the inertial number at a velocity V of the plate and a thickness H [m] in terms of every definition.

    The definitions are mean_grain, (V/H) D √(ρ/σ) with the mean diameter, on which warnings are based; largest_grain,
    the same with the largest diameter; slip, V √(ρ/σ), for shear localised in one layer of grains.
    """
    grains, stress = scenario.grains, scenario.load.normal_stress
    sizes = {"mean_grain": grains.mean, "largest_grain": grains.diameter[1], "slip": thickness}
    return {
        name: inertial_number(velocity / thickness, stress, diameter=size, density=grains.density)
        for name, size in sizes.items()
    }


class Range(NamedTuple):
    """Numbers that show how quasi-static and how hard a sample is, and how far apart its plates are."""

    inertial_number: float  # (V/H) D √(ρ/σ) at the largest velocity V
    stiffness: float  # (E/((1 − ν²) σ))^(2/3), about D over the overlap
    overlap: float  # mean overlap of contacts over D
    thickness: float  # H/D
    length: float  # length of the cell over D
    time_step: float  # dt over the largest stable time step

    @property
    def warnings(self) -> list[str]:
        """One sentence for every number outside the range in which results do not depend on it."""
        said = []
        if self.inertial_number > INERTIAL:
            said.append(
                f"the inertial number reaches {self.inertial_number:.1e}, above {INERTIAL:g}: shear is no longer "
                f"quasi-static; use lower velocities"
            )
        if self.stiffness < STIFFNESS or self.overlap > OVERLAP:
            said.append(
                f"grains overlap by {self.overlap:.1%} of a diameter, and (E/((1 − ν²) σ))^(2/3) = "
                f"{self.stiffness:.3g}: grains count as hard below {OVERLAP:.0%} and above {STIFFNESS:g}; use a larger "
                f"young"
            )
        if self.time_step > LONG:
            said.append(f"dt is {self.time_step:.2f} of the largest stable time step: use a shorter dt")
        for name, value in (("thickness", self.thickness), ("length", self.length)):
            if value < LAYER:
                said.append(
                    f"the {name} of the layer is {value:.0f} D: below {LAYER:g} D, plates and periodic images affect "
                    f"the results; use more grains or a longer cell"
                )
        return said


def make_range(scenario: GougeScenario, velocity: float, thickness: float, overlap: float, stable: float) -> Range:
    """Return the Range of a sample from its thickness [m], mean overlap over D, and largest stable time step [s]."""
    grains, law, stress = scenario.grains, scenario.law, scenario.load.normal_stress
    return Range(
        inertial_numbers(scenario, velocity, thickness)["mean_grain"],
        (law.young / ((1 - law.poisson**2) * stress)) ** (2 / 3),
        overlap, thickness / grains.mean, scenario.cell.length / grains.mean, scenario.dt / stable,
    )  # fmt: skip
