"""Definition of the soils wing."""

from ...wing import Wing

WING = Wing(
    package=__package__,
    words="element tests and cyclic shear of soils",
    needs=("status", "lammps"),
    experiments={"element-test": "element_test", "cyclic-shear": "cyclic_shear"},
    pages=("element_tests", "directions_of_failure", "tutorials/triaxial_test", "tutorials/cemented_sand"),
)
