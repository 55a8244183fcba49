from .scenario import ShearScenario as ShearScenario
from .simulate import ShearPath as ShearPath
from .simulate import ShearResult as ShearResult
from .simulate import simulate_shear as simulate_shear
