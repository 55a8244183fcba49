"""Definition of the soils wing."""

from ...wing import ExperimentEntry, Wing

WING = Wing(
    package=__package__,
    words="element tests and cyclic shear of soils",
    experiments={
        "element-test": ExperimentEntry("element_test", needs=("status", "lammps")),
        "cyclic-shear": ExperimentEntry("cyclic_shear", needs=("status", "lammps")),
    },
    pages=("element_tests", "directions_of_failure", "tutorials/triaxial_test", "tutorials/cemented_sand"),
)
