"""Cases for paper 002 constructed on states of real packings: critical contacts, and contacts at the cone's apex."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ...quasirigid.cone_apex import WORDS, Apex, consistent_statuses
from ...quasirigid.enumeration import status_map
from ...quasirigid.lcp import complementarity
from ...quasirigid.matrices import LinearSystem, linear_system
from ...quasirigid.opening import reduced
from ...quasirigid.uniqueness import certificate
from .simulate import QuasiResult


class StatusCases(NamedTuple):
    """Cases drawn on states of real packings: which contacts are critical, to which side, and the load."""

    total: int
    p_matrices: int
    agree: int  # cases in which P and a bijective status map come together
    none: int  # cases without a consistent status
    several: int  # with two or more


def status_cases(main: QuasiResult, cases: int) -> StatusCases:
    """Random critical contacts, slip signs and loads on states of the paths: is the status unique?"""
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
    """The matrices of a state that is drawn from one sample's path, sample after sample."""
    one = main.tested[number % len(main.tested)]
    return linear_system(one.path.states[int(rng.integers(len(one.path.points)))], one.law)


class ApexCases(NamedTuple):
    """Contacts of real packings put at the apex of the cone."""

    total: int
    coherent: int  # all choices of statuses have det k of one sign
    wrong: int  # coherent cases without exactly one consistent choice
    several: int  # other cases, with two or more
    none: int  # other cases, without any
    example: tuple[str, ...]  # statuses that are consistent together, without stability


def counterexample(directions: int = 720) -> tuple[str, ...]:
    """The most statuses that are consistent together for one contact and a surrounding that is not stable.

    K_ext = ((1, 0.3), (0.3, 0.1)) in (n, t) beside K_n = 1, K_t = 0.5, μ = 0.9, over all directions of the load.
    """
    springs = np.diag([1.0, 0.5])
    compliance = np.linalg.inv(np.array([[1.0, 0.3], [0.3, 0.1]]) + springs)
    most = np.zeros((0, 1), int)
    for angle in np.linspace(0, 2 * np.pi, directions, endpoint=False):
        velocity = compliance @ np.array([np.cos(angle), np.sin(angle)])
        apex = Apex(compliance, velocity[None], springs[None], np.array([1.8]), np.zeros(1), np.zeros(1, bool))
        found, _ = consistent_statuses(apex)
        most = found if len(found) > len(most) else most
    return tuple(WORDS[status] for status in most[:, 0])


def apex_cases(main: QuasiResult, cases: int) -> ApexCases:
    """One or two contacts at the apex, up to two at the limit, and random loads: do the four statuses exclude?"""
    rng, count, drawn = np.random.default_rng(main.scenario.seed + 1), np.zeros(4, int), 0
    while drawn < cases:
        m = _random_system(main, rng, drawn)
        open_ones, critical = int(rng.integers(1, 3)), int(rng.integers(0, 3))
        contacts = rng.choice(m.count, open_ones + critical, replace=False)
        sign = np.append(np.zeros(open_ones), rng.choice([-1.0, 1.0], critical))
        try:
            apex = reduced(m, rng.normal(size=len(m.free)), contacts, sign).apex
        except LinAlgError:
            continue
        found, coherent = consistent_statuses(apex)
        count += [coherent, coherent and len(found) != 1, not coherent and len(found) > 1, not (coherent or len(found))]
        drawn += 1
    return ApexCases(cases, *(int(c) for c in count), counterexample())
