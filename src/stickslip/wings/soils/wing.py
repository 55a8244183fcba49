"""Definition of the soils wing."""

from ...wing import ExperimentEntry, Wing

WING = Wing(
    package=__package__,
    words="element tests and cyclic shear of soils",
    experiments={
        "element-test": ExperimentEntry(
            "element_test",
            needs=("status", "lammps"),
            meant_by="triax brazilian brazilian_test indirect_tension element_tests soils soil triaxial_test triaxial "
            "oedometer oedometric friction_angle dilatancy dilation critical_state mohr_circle mohr "
            "mohr_coulomb undrained drained cohesion_intercept peak geotechnical simple_shear_test "
            "plane_strain k0 skempton compression_index swelling_index swelling consolidation fit_envelope "
            "mohr_envelope csl ucs uniaxial_compression unconfined_compression direct_tension "
            "tensile_strength rock",
        ),
        "cyclic-shear": ExperimentEntry(
            "cyclic_shear",
            needs=("status", "lammps"),
            meant_by="cyclic cyclic_triaxial liquefaction damping_ratio g_gmax shear_modulus_reduction hysteresis "
            "return_point cyclic_loading fatigue compaction",
        ),
    },
    pages=("element_tests", "directions_of_failure", "tutorials/triaxial_test", "tutorials/cemented_sand"),
)
