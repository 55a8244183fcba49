"""Commands, sections, columns and files of other programs: names that are used, and names without influence on forces.

Readers look up each command of a log, each section of a data file, each column of a table or laboratory record, and
each file of a folder. Names missing from the table are unknown. Names with a reason also count as unknown: they act on
grains in an unsupported way. Names are `fnmatch` patterns.
"""

from fnmatch import fnmatchcase
from functools import lru_cache
from typing import NamedTuple

USED, HARMLESS, UNKNOWN = "used", "without influence on forces", "not understood"
ACCELERATED = ("omp", "kk", "kk/host", "kk/device", "gpu", "intel", "opt")  # suffixes of LAMMPS styles
FORCE_STYLES = tuple(f"{name}_style" for name in ("angle", "dihedral", "improper", "kspace"))
BETWEEN = "it exerts forces between bonded grains, or on charges"
BONDED = "LAMMPS changes or removes contacts between bonded grains"


class Row(NamedTuple):
    """Names of one kind that belong to one group."""

    kind: str
    group: str
    names: str  # patterns, separated by blanks
    why: str = ""  # reason why the names count as unknown


TABLE = (
    Row("command", USED, "atom_style boundary change_box clear dump dump_modify fix group labelmap lattice log "
        "neigh_modify pair_coeff pair_style read_data read_restart region reset_timestep restart run unfix units "
        "variable write_data write_dump write_restart echo bond_style bond_coeff special_bonds create_bonds"),
    Row("command", HARMLESS, "atom_modify balance *_coeff bond_write box comm_modify comm_style compute compute_modify "
        "create_atoms create_box delete_atoms delete_bonds dimension displace_atoms fix_modify group2ndx "
        "if include info jump kspace_modify label mass min_modify min_style minimize molecule ndx2group neighbor "
        "newton next package pair_modify pair_write partition plugin print processors python quit read_dump replicate "
        "rerun reset_* run_style set shell suffix thermo thermo_modify thermo_style timer timestep "
        "uncompute undump velocity write_coeff dynamical_matrix third_order"),
    Row("line of a log", HARMLESS, "using prefer dynamic"),
    Row("style beside the pair style", HARMLESS, "none zero"),
    Row("style beside the pair style", UNKNOWN, "*", BETWEEN),
    Row("bond style", USED, "bpm/spring bpm/rotational harmonic hybrid"),
    Row("bond style", HARMLESS, "none zero"),
    Row("bond style", UNKNOWN, "*", "stickslip has no equivalent bond"),
    Row("pair style whose force is proportional to its first coefficient", HARMLESS, "lj/cut lj/cut/soft lj/cut/sphere "
        "lj/expand lj/expand/sphere lj/smooth lj/smooth/linear lj/gromacs lj/mdf lj96/cut mie/cut nm/cut soft gauss "
        "harmonic/cut morse ufm wf/cut yukawa"),
    Row("fix", USED, "wall/gran wall/gran/region gravity freeze setforce addforce deform nve nve/sphere nve/limit "
        "nve/bpm/sphere momentum recenter NEIGH_HISTORY* neigh_history* BOND_HISTORY"),
    Row("fix", HARMLESS, "enforce2d print ave/* vector balance property/atom store/* STORE/* halt pour "
        "deposit evaporate dt/reset heat/flow controller numdiff* nonaffine/displacement DUMMY GROUP "
        "UPDATE_SPECIAL_BONDS"),
    Row("fix", UNKNOWN, "adapt*", "it changes sizes or laws"),
    Row("fix", UNKNOWN, "accelerate/* momentum/* addtorque* aveforce bond/* box/relax brownian* damping/* drag efield* "
        "external indent langevin* lineforce move npt* nph* nvt* nve/* planeforce poems press/* propel/* python/* "
        "restrain rigid* shake rattle spring* temp/* viscous* wall/* bpm/* mesh/* rheo* lb/* cfd/* couple/*",
        "it acts on the grains"),
    Row("section", USED, "Atoms Velocities Bonds Atom?Type?Labels Bond?Type?Labels"),
    Row("section", HARMLESS, "Masses *?Type?Labels Bond?Coeffs Angle?Coeffs Dihedral?Coeffs Improper?Coeffs"),
    Row("section", UNKNOWN, "Angles Dihedrals Impropers", BONDED),
    Row("section", UNKNOWN, "Pair?Coeffs PairIJ?Coeffs", "it has a contact law, which is not read from this section"),
    Row("heading of a data file", USED, "atoms bonds xlo?xhi ylo?yhi zlo?zhi xy?xz?yz avec bvec cvec "
        "abc?origin atom?types"),
    Row("heading of a data file", HARMLESS, "*?types extra?*"),
    Row("heading of a data file", UNKNOWN, "angles dihedrals impropers", BONDED),
    Row("part of a GSD file", UNKNOWN, "bonds angles dihedrals impropers", BONDED),
    Row("item of a dump", USED, "TIMESTEP NUMBER BOX ATOMS ENTRIES"),
    Row("item of a dump", HARMLESS, "UNITS TIME LABEL"),
    Row("column of a dump", USED, "id type x y z xu yu zu xs ys zs xsu ysu zsu ix iy iz radius diameter c_radius "
        "c_diameter mass density vx vy vz omegax omegay omegaz fx fy fz"),
    Row("column of a dump", HARMLESS, "typelabel element mol molecule proc procp1 tqx tqy tqz angmomx angmomy angmomz "
        "quatw quati quatj quatk c_* f_* v_* i_* d_* i2_* d2_* mux muy muz mu spx spy spz"),
    Row("column of a dump", UNKNOWN, "q", "charges repel or attract each other"),
    Row("column of contacts", USED, "i j dist dx dy dz fx fy fz Fx Fy Fz tx ty tz"),
    Row("column of contacts", HARMLESS, "periodic ?1 ?2 id1 id2 p* cutoff radius force eng "
        "energy overlap* delta* index area* fn ft slides c? x y z step c_* f_*"),
    Row("column of a table", HARMLESS, "frame no nr number index time step timestep t absv u speed vmag colou?r c "
        "coordination* coord*number z cn neighbo?rs numneighbo?rs numcontacts contacts ncontacts mask name angle* phi "
        "psi theta orientation* quat* q? rot* info volume voronoi* area stress stress? stress?? sigma sigma? sigma?? "
        "pressure p energy ekin "
        "epot kinetic* potentialenergy* temperature temp displacement* disp disp? d?min* contactforce* contacttorque* "
        "resultant* inertia* label cluster* edge rattler* dstn dstv* state status void* porosity packingfraction "
        "localdensity reserved reserved? vorticity* strain* vel*mag* *mag *energy* "
        "ke pe nbr* numcontact* particleid* parent* bodyid angmom* angularmomentum* alpha? ori*"),
    Row("column of a table", UNKNOWN, "accel* a?", "the same acceleration of all grains may be gravity"),
    Row("column of a table", UNKNOWN, "type* mat* material* species",
        "grains of different kinds may have different contact laws"),
    Row("column of a table", UNKNOWN, "f? force* load* external* torque*",
        "it may be an external load, not due to contacts"),
    Row("column of a table", UNKNOWN, "box cell l periodic pbc", "grains may touch across a periodic box"),
    Row("column of a record", HARMLESS, "rec* record* row n no nr index sync samp_freq sampling* step *strain* "
        " nor_disp* norm*_disp* normal_disp* h thickness layer* gouge* *temp* *humid* *lvdt* lt_* rgt_* *_lt "
        "date day hour clock timestamp comment note* v *_velocity *_rate acoustic* ae ae_* *amp* volt* gain event* "
        "potcy pot_* dtau_dt samples channel* flag*"),
    Row("column of a record", UNKNOWN, "pp* p_up* p_down* upstream* downstream* *pore* *fluid*",
        "it may change the effective normal stress"),
    Row("column of a test of soil", HARMLESS, "rec* record* row n no no. nr nr. index point* time* elapsed* date day "
        "hour clock timestamp comment* note* stage* step* sample* specimen* test* *temp* load* force* displacement* "
        "*disp height* area* volume* *_rate back_pressure*"),
    Row("file", HARMLESS, "*.png *.gif *.mp4 *.jpg *.jpeg *.pdf *.svg *.html *.md *.rst README* LICENSE* *.py *.ipynb "
        "*.m *.sh *.slurm *.job *.pbs *.sbatch *.out *.err *.o[0-9]* *.e[0-9]* log.cite *.bib Makefile *.npz *.h5 "
        "*.gsd *.json *.toml *.yaml *.yml *.csv *.tsv *.dat *.bak *.lock *.ini *.tex"),
)  # fmt: skip


@lru_cache(4096)
def find_row(kind: str, name: str) -> Row:
    """Row of the table that contains a name, or a row for unknown names."""
    rows = (row for row in TABLE if row.kind == kind)
    return next(
        (row for row in rows if any(fnmatchcase(name, pattern) for pattern in row.names.split())),
        Row(kind, UNKNOWN, name),
    )


def group_of(kind: str, name: str) -> str:
    """Group of a name: used, without influence on forces, or unknown."""
    return find_row(kind, name).group


def plain_style(style: str) -> str:
    """Name of a LAMMPS style without the suffix of its accelerator: gran/hooke/history for gran/hooke/history/omp."""
    end = next((f"/{end}" for end in sorted(ACCELERATED, key=len, reverse=True) if style.endswith(f"/{end}")), "")
    return style.removesuffix(end)


def with_keys(groups: dict[str, list[str]]) -> dict[str, list[str]]:
    """Names by group, under the keys of the JSON output."""
    return {group.replace(" ", "_"): names for group, names in groups.items()}
