from . import measures as measures
from .scenario import GougeScenario as GougeScenario
from .simulate import GougeResult as GougeResult
from .simulate import simulate_gouge as simulate_gouge
