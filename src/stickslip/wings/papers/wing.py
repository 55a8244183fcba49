"""Definition of the papers wing."""

from ...wing import Wing

WING = Wing(
    package=__package__,
    words="four papers, with their claims",
    needs=("faults", "status", "lammps"),
    experiments={
        "disk-array": "disk_array", "sphere-shear": "sphere_shear", "quasi-rigid": "quasi_rigid", "gouge": "gouge"
    },
    pages=(
        "disk_array", "sphere_shear", "pairs_by_law", "quasi_rigid", "gouge", "tutorials/fault_gouge", "theory/gouge",
        "theory/gouge_paper_size", "theory/errata",
    ),
)  # fmt: skip
