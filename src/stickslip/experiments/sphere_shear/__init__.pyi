from .scenario import ShearScenario as ShearScenario
from .simulate import simulate_shear as simulate_shear
