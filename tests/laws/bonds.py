"""Bonds between grains, written slowly and plainly, and closed forms of chains, as truth for the package.

A bond joins sphere i to sphere j. `pair` is r_i − r_j (nearest image), `normal` points from j to i, forces and torques
act on i and j. Arrays hold one row per bond; in two dimensions spins and rotations are about z, and the formulas are
the same. A bond breaks where `share`, its load as a share of its strength, reaches 1; from then on it carries nothing.

Sources: LAMMPS manual, `bond_style bpm/spring` and `bpm/rotational`; Y. Wang, Acta Geotechnica 4, 117 (2009);
Y. Wang and P. Mora, Advances in Geocomputing, LNES 119, 183 (2009); Y. Wang, F. Alonso-Marroquin and W. W. Guo,
Particuology 23, 49 (2015); D. O. Potyondy and P. A. Cundall, Int. J. Rock Mech. Min. Sci. 41, 1329 (2004),
doi:10.1016/j.ijrmms.2004.09.011.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation


class Loads(NamedTuple):
    """Loads of bonds: vectors (B, 3), stored energy (B,) or None where no potential exists, share of strength (B,)."""

    force_i: np.ndarray
    force_j: np.ndarray
    torque_i: np.ndarray
    torque_j: np.ndarray
    energy: np.ndarray | None
    share: np.ndarray


def length(vectors):
    """Lengths of vectors, as a column."""
    return np.linalg.norm(vectors, axis=-1, keepdims=True)


def dot(a, b):
    """Scalar products of rows, as a column."""
    return np.sum(a * b, axis=-1, keepdims=True)


def rotation_vector(a, b):
    """The smallest rotation that turns direction a to direction b: axis times angle."""
    axis = np.cross(a, b)
    sine = length(axis)
    return np.arctan2(sine, dot(a, b)) * axis / np.where(sine > 0, sine, 1)


# Springs between centres


def spring(pair, velocity, rest, *, k, ecrit, gamma=0.0, smooth=True, normalize=False):
    """Loads of LAMMPS's `bpm/spring` on pairs with relative velocity v_i − v_j and rest lengths (B,).

    With the strain e = (r − r₀)/r₀ the force on i along n is −(k (r − r₀) + γ v·n) w, where k is divided by r₀ with
    `normalize` and w = 1 − (e/ecrit)⁸ with `smooth`. LAMMPS breaks the bond where |e| > ecrit, in tension and in
    compression alike. The energy is that of the elastic force with its smoothing, k (r − r₀)²/2 (1 − (e/ecrit)⁸/5).
    """
    r, rest = length(pair), np.asarray(rest)[:, None]
    normal, stretch = pair / r, r - rest
    stiffness = k / rest if normalize else k
    share = np.abs(stretch) / rest / ecrit
    weight = np.where(share > 1, 0, 1 - share**8 if smooth else 1)
    force = -(stiffness * stretch + gamma * dot(velocity, normal)) * weight * normal
    energy = stiffness * stretch**2 / 2 * np.where(share > 1, 0, 1 - share**8 / 5 if smooth else 1)
    none = np.zeros_like(force)
    return Loads(force, -force, none, none, energy[:, 0], share[:, 0])


# Springs between bodies that rotate


def angles(pair, turned_i, turned_j, reference):
    """Angles of bonds, as rotation vectors seen from j: γ of the pair, β of bending, and the twist ψ about the pair.

    `turned_i` and `turned_j` are rotations since bonding, `reference` is the pair at bonding. γ turns the reference to
    the pair as j sees it. The rotation of i relative to j, as j sees it, is a twist ψ n followed by a swing β ⟂ n.
    """
    seen = turned_j.inv().apply(pair)
    normal = seen / length(seen)
    relative = turned_j.inv() * turned_i
    swing = rotation_vector(normal, relative.apply(normal))
    twist = (Rotation.from_rotvec(-swing) * relative).as_rotvec()
    return rotation_vector(reference, seen), swing, dot(twist, normal), normal


def rotational(
    pair, velocity, spin, turned, reference, *, stiffness, strength, damping=(0, 0, 0, 0), smooth=True, normalize=False
):
    """Loads of LAMMPS's `bpm/rotational`; i is the atom with the smaller id.

    Velocities and spins are (2, B, 3), of i and of j; `turned` holds the rotations of i and of j since bonding,
    `reference` is the pair at bonding (B, 3). Stiffnesses are (Kr, Ks, Kt, Kb) and strengths (Fcr, Fcs, Tct, Tcb):
    radial, shear, twist, bending; dampings are (γn, γs, γr, γt): normal, sliding, rolling, twisting. Seen from j, the
    force on j is

        Kr (r − r₀) n + Fs,   Fs = Ks r (γ − β/2) × n,

    the torque on j r × Fs/2 + Kb β + Kt ψ n and that on i r × Fs/2 − Kb β − Kt ψ n (see `angles`). With `normalize`
    Kr and Ks are divided by r₀. Dashpots add γn v·n n + γs s to the force on j, where v = v_i − v_j and
    s = v − v·n n − (ω_i + ω_j)/2 × r is the sliding velocity at the middle of the pair, r × γs s/2 to both torques, and
    γr r/2 Δω_⟂ + γt/2 Δω·n n, where Δω = ω_i − ω_j, to the torque on j and its opposite to that on i. The share is
    max(0, Kr (r − r₀)/Fcr + |Fs|/Fcs + Kt |ψ|/Tct + Kb |β|/Tcb), without dashpots; compression lowers it. With `smooth`
    all loads, those of dashpots included, are multiplied by 1 − share⁴. The torques and forces have no potential.
    """
    kr, ks, kt, kb = stiffness
    (vi, vj), (wi, wj), (turned_i, turned_j) = velocity, spin, turned
    r, rest = length(pair), length(reference)
    if normalize:
        kr, ks = kr / rest, ks / rest
    gamma, beta, psi, normal = angles(pair, turned_i, turned_j, reference)
    radial = kr * (r - rest)
    shear = ks * r * np.cross(gamma - beta / 2, normal)
    bending, twisting = kb * beta, kt * psi * normal
    parts = [radial, length(shear), length(twisting), length(bending)]
    share = np.maximum(0, sum(part / limit for part, limit in zip(parts, strength, strict=True)))

    force = turned_j.apply(radial * normal + shear)
    lever = turned_j.apply(r * np.cross(normal, shear) / 2)
    moment = turned_j.apply(bending + twisting)

    gn, gs, gr, gt = damping
    n, v, w = pair / r, vi - vj, wi - wj
    slide = v - dot(v, n) * n - np.cross((wi + wj) / 2, pair)
    force = force + gn * dot(v, n) * n + gs * slide
    lever = lever + np.cross(pair, gs * slide) / 2
    moment = moment + gr * r / 2 * (w - dot(w, n) * n) + gt / 2 * dot(w, n) * n

    weight = np.where(share >= 1, 0, 1 - share**4 if smooth else 1)
    return Loads(
        -weight * force, weight * force, weight * (lever - moment), weight * (lever + moment), None, share[:, 0]
    )


def quadratic_energy(pair, turned, reference, *, stiffness, normalize=False):
    """Energy of `rotational` to second order in strains: Kr Δr²/2 + Ks r² |γ − β/2|²/2 + Kt ψ²/2 + Kb β²/2."""
    kr, ks, kt, kb = stiffness
    r, rest = length(pair), length(reference)
    if normalize:
        kr, ks = kr / rest, ks / rest
    gamma, beta, psi, _ = angles(pair, *turned, reference)
    shear = r * length(gamma - beta / 2)
    return (kr * (r - rest) ** 2 + ks * shear**2 + kt * psi**2 + kb * length(beta) ** 2)[:, 0] / 2


# Parallel bonds


class Cement(NamedTuple):
    """Forces and moments on i in parallel bonds: normal force (B, 1), compression positive, shear force (B, 3), moment
    of twist (B, 1) and of bending (B, 3)."""

    normal: np.ndarray
    shear: np.ndarray
    twist: np.ndarray
    bending: np.ndarray


def section(radius_i, radius_j, ratio=1.0, *, dim=3):
    """Radius R̄ = λ min(R_i, R_j), area A, moment of inertia I and polar moment J of a parallel bond.

    A disc in three dimensions: πR̄², πR̄⁴/4, πR̄⁴/2. A strip of unit thickness in two: 2R̄, 2R̄³/3, and no J. Potyondy and
    Cundall (2004).
    """
    radius = ratio * np.minimum(radius_i, radius_j)
    if dim == 2:
        return radius, 2 * radius, 2 * radius**3 / 3, np.full_like(radius, np.inf)
    return radius, np.pi * radius**2, np.pi * radius**4 / 4, np.pi * radius**4 / 2


def no_cement(bonds):
    """Cement at bonding, which carries nothing."""
    return Cement(np.zeros((bonds, 1)), np.zeros((bonds, 3)), np.zeros((bonds, 1)), np.zeros((bonds, 3)))


def contact_point(pair, radius_i, radius_j):
    """Vectors from the centres of i and of j to the middle of their overlap or gap."""
    r = length(pair)
    gap = r - radius_i - radius_j
    return -(radius_i + gap / 2) * pair / r, (radius_j + gap / 2) * pair / r


def carried(vector, old, new, spin, dt):
    """Vectors in the plane of contact, turned with the normal and about it with the mean spin."""
    turned = Rotation.from_rotvec(rotation_vector(old, new)).apply(vector)
    normal = new / length(new)
    return Rotation.from_rotvec(dot(spin, normal) * dt * normal).apply(turned)


def cemented(cement, old, pair, velocity, spin, dt, *, kn, ks, radii, ratio=1.0, dim=3):
    """The cement after a step from pair `old` to `pair` with constant velocities and spins, (2, B, 3) of i and of j.

    Potyondy and Cundall (2004), where B is i and A is j: with the relative velocity V of i at the contact point,
    ΔFn = −kn A V·n Δt (compression positive), ΔFs = −ks A V_t Δt, ΔMn = −ks J Δω·n Δt, ΔMs = −kn I Δω_t Δt. Vectors
    in the plane of contact turn with it. The contact halfway through the step is used, so that errors fall as Δt².
    """
    (vi, vj), (wi, wj), (radius_i, radius_j) = velocity, spin, (np.asarray(one)[:, None] for one in radii)
    middle, mean = (old + pair) / 2, (wi + wj) / 2
    normal = middle / length(middle)
    _, area, inertia, polar = section(radius_i, radius_j, ratio, dim=dim)
    arm_i, arm_j = contact_point(middle, radius_i, radius_j)
    moved = (vi + np.cross(wi, arm_i) - vj - np.cross(wj, arm_j)) * dt
    turned = (wi - wj) * dt

    def added(vector, change):
        """Half a turn, the change in the plane of contact, half a turn."""
        flat = change - dot(change, normal) * normal
        return carried(carried(vector, old, middle, mean, dt / 2) - flat, middle, pair, mean, dt / 2)

    return Cement(
        cement.normal - kn * area * dot(moved, normal),
        added(cement.shear, ks * area * moved),
        0 * cement.twist if dim == 2 else cement.twist - ks * polar * dot(turned, normal),
        added(cement.bending, kn * inertia * turned),
    )


def parallel(cement, pair, *, kn, ks, radii, tensile, shear, ratio=1.0, dim=3):
    """Loads of parallel bonds with tensile and shear strengths [stress].

    The force on i is Fn n + Fs at the contact point, the moment on i Mn n + Ms. The share is the larger of
    (−Fn/A + |Ms| R̄/I)/tensile and (|Fs|/A + |Mn| R̄/J)/shear, from Potyondy and Cundall (2004). The energy is
    Fn²/(2 kn A) + |Fs|²/(2 ks A) + Mn²/(2 ks J) + |Ms|²/(2 kn I).
    """
    radius_i, radius_j = (np.asarray(one)[:, None] for one in radii)
    normal = pair / length(pair)
    radius, area, inertia, polar = section(radius_i, radius_j, ratio, dim=dim)
    tension = -cement.normal / area + length(cement.bending) * radius / inertia
    sliding = length(cement.shear) / area + np.abs(cement.twist) * radius / polar
    share = np.maximum(tension / tensile, sliding / shear)
    force = np.where(share >= 1, 0, cement.normal * normal + cement.shear)
    moment = np.where(share >= 1, 0, cement.twist * normal + cement.bending)
    arm_i, arm_j = contact_point(pair, radius_i, radius_j)
    energy = cement.normal**2 / (2 * kn * area) + length(cement.shear) ** 2 / (2 * ks * area)
    energy = energy + cement.twist**2 / (2 * ks * polar) + length(cement.bending) ** 2 / (2 * kn * inertia)
    torque_i, torque_j = moment + np.cross(arm_i, force), -moment + np.cross(arm_j, -force)
    return Loads(force, -force, torque_i, torque_j, np.where(share >= 1, 0, energy)[:, 0], share[:, 0])


# Chains of equal spheres: the first is clamped, n bonds of length L follow along a line


class Chain(NamedTuple):
    """A chain of n bonds of length L: stiffnesses of one bond [force/length, and moment/angle]."""

    bonds: int
    spacing: float
    stretch: float
    shear: float
    twist: float
    bend: float


def rotational_chain(bonds, spacing, stiffness, *, normalize=False):
    """A chain of `rotational` bonds: Kr, Ks, Kt, Kb themselves, Kr and Ks divided by the spacing with `normalize`."""
    kr, ks, kt, kb = stiffness
    return Chain(bonds, spacing, *((kr / spacing, ks / spacing) if normalize else (kr, ks)), kt, kb)


def parallel_chain(bonds, spacing, *, kn, ks, radius, ratio=1.0, dim=3):
    """A chain of parallel bonds, without the stiffness of contacts: kn A, ks A, ks J, kn I."""
    _, area, inertia, polar = (float(one) for one in section(np.float64(radius), np.float64(radius), ratio, dim=dim))
    return Chain(bonds, spacing, kn * area, ks * area, ks * polar if dim == 3 else 0.0, kn * inertia)


def compliance(chain):
    """Displacements of the tip per unit load: stretch/force, deflection/force, slope/force, slope/moment, twist/moment.

    A bond passes on its moment at its middle, so that bond k of a chain under a transverse force P at the tip carries
    P (n − k + ½) L. Summed: stretch n/Kr; deflection n/Ks + L² n (4n² − 1)/(12 Kb); slope (which is also deflection per
    moment) n² L/(2 Kb); n/Kb; n/Kt. For large n these are the ones of a Timoshenko beam with EA = Kr L, κGA = Ks L,
    EI = Kb L, GJ = Kt L (Timoshenko and Gere, Mechanics of Materials, ch. 9).
    """
    n, spacing, kr, ks, kt, kb = chain
    deflection = n / ks + spacing**2 * n * (4 * n**2 - 1) / (12 * kb)
    return n / kr, deflection, n**2 * spacing / (2 * kb), n / kb, n / kt if kt else np.inf


def beam_stiffness(chain):
    """Transverse stiffness matrix (2n, 2n) of a clamped chain in (deflection, slope) of its free spheres.

    A bond stores Ks (Δw − L (θ + θ')/2)²/2 + Kb (θ' − θ)²/2.
    """
    n, spacing = chain.bonds, chain.spacing
    sheared, bent = np.array([-1, -spacing / 2, 1, -spacing / 2]), np.array([0, -1, 0, 1])
    bond = chain.shear * np.outer(sheared, sheared) + chain.bend * np.outer(bent, bent)
    whole = np.zeros((2 * n + 2, 2 * n + 2))
    for k in range(0, 2 * n, 2):
        whole[k : k + 4, k : k + 4] += bond
    return whole[2:, 2:]


def bending_frequencies(chain, mass, inertia):
    """Angular frequencies of transverse vibration of the clamped chain, ascending."""
    masses = np.diag(np.tile([mass, inertia], chain.bonds))
    return np.sqrt(eigh(beam_stiffness(chain), masses, eigvals_only=True))


def line_frequencies(chain, stiffness, mass):
    """Angular frequencies of a clamped-free line of n equal springs and masses, 2 √(k/m) sin((2p − 1) π/(4n + 2)).

    For torsion the stiffness is Kt and the mass a moment of inertia. Brillouin, Wave Propagation in Periodic
    Structures, ch. 3: standing waves of a line whose ends are clamped and free.
    """
    p = np.arange(1, chain.bonds + 1)
    return 2 * np.sqrt(stiffness / mass) * np.sin((2 * p - 1) * np.pi / (4 * chain.bonds + 2))


def continuum_frequencies(chain, mass, inertia):
    """First angular frequencies of the long, slender cantilever: bending, torsion.

    Euler and Bernoulli: (κ/ℓ)² √(EI L/m), where cos κ cosh κ = −1 and ℓ = nL; torsion: π/(2n) √(Kt/I). Weaver,
    Timoshenko and Young, Vibration Problems in Engineering, ch. 5.
    """
    kappa = brentq(lambda x: np.cos(x) * np.cosh(x) + 1, 1.5, 2.5, xtol=1e-14)
    bending = (kappa / chain.bonds) ** 2 / chain.spacing * np.sqrt(chain.bend / mass)
    return bending, np.pi / (2 * chain.bonds) * np.sqrt(chain.twist / inertia)


def rotational_limits(chain, strength):
    """Small loads at the tip that break a chain of `rotational` bonds: tension, transverse force, twist, moment.

    Bonds carry a tension, a twist or a moment alike and break at Fcr, Tct or Tcb. Under a transverse force P the bond
    at the clamp breaks: P/Fcs + P (n − ½) L/Tcb = 1. With `smooth` a bond carries less, see `SMOOTHED_PEAK`.
    """
    radial, shear, twist, bend = strength
    transverse = 1 / (1 / shear + (chain.bonds - 0.5) * chain.spacing / bend)
    return radial, transverse, twist, bend


def parallel_limits(chain, *, radius, tensile, shear, ratio=1.0, dim=3):
    """Small loads at the tip that break a chain of parallel bonds: tension, transverse force, twist, moment.

    tensile A; the smaller of shear A and tensile I/(R̄ (n − ½) L), at the clamp; shear J/R̄; tensile I/R̄.
    """
    radius, area, inertia, polar = section(np.float64(radius), np.float64(radius), ratio, dim=dim)
    moment = tensile * inertia / radius
    transverse = min(shear * area, moment / ((chain.bonds - 0.5) * chain.spacing))
    return tensile * area, transverse, shear * polar / radius, moment


SMOOTHED_PEAK = {"rotational": 5**-0.25 * 4 / 5, "spring": 9**-0.125 * 8 / 9}
"""Largest tension of smoothed bonds, as a share of Fcr and of k r₀ ecrit: maxima of s (1 − s⁴) and s (1 − s⁸)."""
