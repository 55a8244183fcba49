"""Which module is whose: every experiment has a report, those of papers a module of their own."""

# every report has simulate, write_result, show_result, numbers and scalars, those of papers have write_reproduction
REPORTS = {
    "disk-array": "disk_report", "sphere-shear": "shear_report", "quasi-rigid": "quasi_report", "flow": "flow_report",
    "gouge": "gouge_report", "rate-state": "ratestate_report",
}  # fmt: skip
PAPERS = {"disk-array": "disk_array", "sphere-shear": "sphere_shear", "quasi-rigid": "quasi_rigid", "gouge": "gouge"}
WORDS = {
    "disk-array": "paper 000: ten disks on a substrate are pushed", "sphere-shear": "paper 001: packings are sheared",
    "quasi-rigid": "paper 002: disks under biaxial load", "gouge": "paper 003: fault gouge",
}  # fmt: skip
ALONE = ("flow", "rate-state")  # one run, and no realizations that could be spread
