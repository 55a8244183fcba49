from .scenario import QuasiScenario as QuasiScenario
from .simulate import QuasiResult as QuasiResult
from .simulate import simulate_quasi as simulate_quasi
