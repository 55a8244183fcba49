from .laboratory import read_test as read_test
from .scenario import ElementTestScenario as ElementTestScenario
from .simulate import ElementTestResult as ElementTestResult
from .simulate import simulate_element_test as simulate_element_test
