"""Definition of the papers wing."""

from ...wing import ExperimentEntry, Wing

WING = Wing(
    package=__package__,
    words="four papers, with their claims",
    experiments={
        "disk-array": ExperimentEntry("disk_array", papers=("disk-array",)),
        "sphere-shear": ExperimentEntry("sphere_shear", papers=("sphere-shear",)),
        "quasi-rigid": ExperimentEntry("quasi_rigid", needs=("status",), papers=("quasi-rigid",)),
        "gouge": ExperimentEntry(
            "gouge", needs=("faults", "lammps"), papers=("gouge",),
            meant_by="ringshear ring_shear rotary_shear annular_shear velocity_step fault_gouge granular_fault",
        ),
    },
    pages=(
        "disk_array", "sphere_shear", "pairs_by_law", "quasi_rigid", "gouge", "tutorials/fault_gouge", "theory/gouge",
        "theory/gouge_paper_size", "theory/errata",
    ),
)  # fmt: skip
