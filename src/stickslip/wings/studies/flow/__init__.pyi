from .report import deposit as deposit
from .report import plane_shear as plane_shear
from .report import velocity_profile as velocity_profile
from .scenario import FlowScenario as FlowScenario
from .simulate import FlowResult as FlowResult
from .simulate import FlowSeries as FlowSeries
from .simulate import simulate_flow as simulate_flow
