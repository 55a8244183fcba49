from ..wings.faults.fault import figures as fault
from ..wings.faults.rate_state import figures as rate_state
from ..wings.papers.disk_array import figures as disk_array
from ..wings.papers.gouge import figures as gouge
from ..wings.papers.quasi_rigid import figures as quasi_rigid
from ..wings.papers.sphere_shear import figures as sphere_shear
from ..wings.soils.cyclic_shear import figures as cyclic_shear
from ..wings.soils.element_test import figures as element_test
from ..wings.studies.catalogue import figures as catalogue
from ..wings.studies.flow import figures as flow
from .analyses import bursts as bursts
from .analyses import dispersion as dispersion
from .analyses import failure_path as failure_path
from .analyses import forces as forces
from .analyses import growth_by_amplitude as growth_by_amplitude
from .analyses import inclusion as inclusion
from .analyses import response_envelopes as response_envelopes
from .analyses import static_and_kinetic as static_and_kinetic
from .animation import movie as movie
from .claims import claims_chart as claims_chart
from .grains import packing as packing
from .scene import view as view
from .style import Look as Look
from .style import save as save

__all__ = [
    "Look",
    "bursts",
    "catalogue",
    "claims_chart",
    "cyclic_shear",
    "disk_array",
    "dispersion",
    "element_test",
    "failure_path",
    "fault",
    "flow",
    "forces",
    "gouge",
    "growth_by_amplitude",
    "inclusion",
    "movie",
    "packing",
    "quasi_rigid",
    "rate_state",
    "response_envelopes",
    "save",
    "sphere_shear",
    "static_and_kinetic",
    "view",
]
