from .scenario import RateStateScenario as RateStateScenario
from .simulate import SliderResult as SliderResult
from .simulate import simulate_slider as simulate_slider
