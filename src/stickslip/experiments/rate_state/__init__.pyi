from .scenario import RateStateScenario as RateStateScenario
from .simulate import simulate_slider as simulate_slider
