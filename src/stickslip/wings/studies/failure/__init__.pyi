from .scenario import FailureScenario as FailureScenario
from .simulate import FailureResult as FailureResult
from .simulate import simulate_failure as simulate_failure
