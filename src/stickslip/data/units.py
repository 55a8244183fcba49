"""Units of archive datasets, looked up by the last part of their path: dimensions, or SI units for scenarios in SI."""

_NAMES = {
    "length": "position point vectors slip pair roll radius center low high edges wall_point plate_position load_point "
    "thickness overlap anchor turns depth station top bottom nucleation_length max_slip surface_slip dc dc2",
    "time": "time dt breach slide start end hold theta theta2 snapshot_time close_time turn_time knots",
    "length/time": "velocity speed profile_velocity before after max_velocity surface_velocity",
    "rad": "angle",
    "rad/time": "spin",
    "mass": "mass",
    "mass length^2": "inertia",
    "force": "force wall_force plate_force residual",
    "force length": "torque",
    "force/length": "spring",
    "energy": "kinetic_energy elastic_energy kinetic tangential external coulomb viscous drag nonpotential defect",
    "force/length^(dim-1)": "pressure shear_stress stress",
    "length/time^2": "gravity",
    "length^2": "msd snapshot_msd close_msd saturation",
    "length^2/time^2": "temperature",
    "1/time": "growth_rate frequency predicted_growth predicted_frequency rate",
    "1/time^2": "eigenvalues eigenvalue snapshots im_lambda largest smallest softest re_pair switched switch",
    "energy/length": "loading frictional radiated",
    "force/time": "moment_rate",
    "1": "friction contact_friction coordination sliding_fraction strain packing_fraction unbalanced volumetric ratio "
    "fabric",
}
# arrays that hold both lengths and angles, and names with another meaning
_OF_NOUNS = {
    ("Control", "rate"): None, ("Control", "stress"): "force/length^(dim-1)", ("Instant", "force"): None,
    ("Instant", "pull"): "1/time^2", ("Energy", "elastic"): "energy/length",
}  # fmt: skip
_UNITS = {name: unit for unit, names in _NAMES.items() for name in names.split()}
_SI = {
    "length": "m", "time": "s", "length/time": "m/s", "rad/time": "rad/s", "mass": "kg", "mass length^2": "kg m^2",
    "force": "N", "force length": "N m", "force/length": "N/m", "energy": "J", "force/length^(dim-1)": "Pa",
    "length/time^2": "m/s^2", "length^2": "m^2", "length^2/time^2": "m^2/s^2", "1/time": "1/s", "1/time^2": "1/s^2",
    "energy/length": "J/m", "force/time": "N/s",
}  # fmt: skip


def unit_of(name: str, *, noun: str | None = None, si: bool = False) -> str | None:
    """Unit of a dataset, in a group that stores a NamedTuple called `noun`; None if it has no unit, or has two.

    Examples
    --------
    >>> unit_of("velocity"), unit_of("velocity", si=True), unit_of("kind")
    ('length/time', 'm/s', None)
    """
    unit = _OF_NOUNS.get((noun, name), _UNITS.get(name))
    return _SI.get(unit, unit) if si else unit
