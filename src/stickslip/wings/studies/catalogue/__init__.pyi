from .scenario import CatalogueScenario as CatalogueScenario
from .simulate import CatalogueResult as CatalogueResult
from .simulate import read_table as read_table
from .simulate import roc as roc
from .simulate import simulate_catalogue as simulate_catalogue
