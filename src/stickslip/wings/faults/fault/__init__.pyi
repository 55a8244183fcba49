from .scenario import FaultScenario as FaultScenario
from .simulate import FaultResult as FaultResult
from .simulate import simulate_cycles as simulate_cycles
