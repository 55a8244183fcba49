from .scenario import FaultScenario as FaultScenario
from .simulate import simulate_cycles as simulate_cycles
