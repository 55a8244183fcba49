"""Test cases for McNamara & Herrmann 2006, constructed from states of real packings.

The cases have randomly drawn critical contacts, or contacts at the apex of the friction cone.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ...status.apex_status import reduce_to_contacts
from ...status.complementarity import complementarity, status_map
from ...status.cone_apex import STATUS_NAMES, Apex, consistent_statuses
from ...status.matrices import LinearSystem, linear_system
from ...status.uniqueness import certificate
from .simulate import QuasiResult


class StatusCases(NamedTuple):
    """Counts of cases with randomly drawn critical contacts, slip signs and loads."""

    total: int
    p_matrices: int
    agree: int  # cases in which A is a P-matrix if and only if the status map is bijective
    none: int  # cases without a consistent status
    several: int  # cases with two or more


def status_cases(main: QuasiResult, cases: int) -> StatusCases:
    """Draw critical contacts, slip signs and loads for states on the paths; count the cases with a unique status."""
    rng, count, drawn = np.random.default_rng(main.scenario.seed), np.zeros(4, int), 0
    while drawn < cases:
        m = _random_system(main, rng, drawn)
        critical = rng.choice(m.count, int(rng.integers(2, 9)), replace=False)
        m = m._replace(sign=rng.choice([-1.0, 1.0], m.count))
        try:
            problem = complementarity(m, rng.normal(size=len(m.free)), critical=critical)
        except LinAlgError:
            continue  # a contact has just opened, and a disk with it
        whole, mapped = bool(certificate(problem).unique), status_map(problem)
        count += [whole, whole == mapped.bijective, len(mapped.consistent) == 0, len(mapped.consistent) > 1]
        drawn += 1
    return StatusCases(cases, *(int(c) for c in count))


def _random_system(main: QuasiResult, rng, number: int) -> LinearSystem:
    """Linear system for a random state on one sample's path; successive numbers cycle through the samples."""
    sample = main.tested[number % len(main.tested)]
    return linear_system(sample.path.states[int(rng.integers(len(sample.path.points)))], sample.law)


class ApexCases(NamedTuple):
    """Counts of cases in which contacts of real packings are placed at the apex of the cone."""

    total: int
    coherent: int  # cases in which det k has the same sign for all choices of statuses
    wrong: int  # coherent cases without exactly one consistent choice
    several: int  # other cases with two or more
    none: int  # other cases without any
    example: tuple[str, ...]  # statuses that are consistent together in the absence of stability


def counterexample(directions: int = 720) -> tuple[str, ...]:
    """Return the largest set of statuses that are simultaneously consistent for one contact in unstable surroundings.

    K_ext = ((1, 0.3), (0.3, 0.1)) in (n, t), with K_n = 1, K_t = 0.5 and μ = 0.9, over all directions of the load.
    """
    springs = np.diag([1.0, 0.5])
    compliance = np.linalg.inv(np.array([[1.0, 0.3], [0.3, 0.1]]) + springs)
    most = np.zeros((0, 1), int)
    for angle in np.linspace(0, 2 * np.pi, directions, endpoint=False):
        velocity = compliance @ np.array([np.cos(angle), np.sin(angle)])
        apex = Apex(compliance, velocity[None], springs[None], np.array([1.8]), np.zeros(1), np.zeros(1, bool))
        statuses, _ = consistent_statuses(apex)
        most = statuses if len(statuses) > len(most) else most
    return tuple(STATUS_NAMES[status] for status in most[:, 0])


def apex_cases(main: QuasiResult, cases: int) -> ApexCases:
    """Draw one or two contacts at the apex, up to two at the Coulomb limit, and loads; count the consistent statuses.

    The counts show whether the four statuses at the apex are mutually exclusive.
    """
    rng, count, drawn = np.random.default_rng(main.scenario.seed + 1), np.zeros(4, int), 0
    while drawn < cases:
        m = _random_system(main, rng, drawn)
        open_ones, critical = int(rng.integers(1, 3)), int(rng.integers(0, 3))
        contacts = rng.choice(m.count, open_ones + critical, replace=False)
        sign = np.append(np.zeros(open_ones), rng.choice([-1.0, 1.0], critical))
        try:
            apex = reduce_to_contacts(m, rng.normal(size=len(m.free)), contacts, sign).apex
        except LinAlgError:
            continue
        statuses, coherent = consistent_statuses(apex)
        number = len(statuses)
        count += [coherent, coherent and number != 1, not coherent and number > 1, not (coherent or number)]
        drawn += 1
    return ApexCases(cases, *(int(c) for c in count), counterexample())
