from .scenario import ThresholdScenario as ThresholdScenario
from .simulate import simulate_threshold as simulate_threshold
