from .scenario import FlowScenario as FlowScenario
from .simulate import FlowResult as FlowResult
from .simulate import FlowSeries as FlowSeries
from .simulate import deposit as deposit
from .simulate import plane_shear as plane_shear
from .simulate import simulate_flow as simulate_flow
from .simulate import velocity_profile as velocity_profile
