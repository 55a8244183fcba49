from .scenario import CyclicShearScenario as CyclicShearScenario
from .simulate import CyclicShearResult as CyclicShearResult
from .simulate import simulate_cyclic_shear as simulate_cyclic_shear
