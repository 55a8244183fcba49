from .scenario import ThresholdScenario as ThresholdScenario
from .simulate import ThresholdResult as ThresholdResult
from .simulate import simulate_threshold as simulate_threshold
