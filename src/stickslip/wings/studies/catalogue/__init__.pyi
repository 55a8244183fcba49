from .scenario import CatalogueScenario as CatalogueScenario
from .simulate import CatalogueResult as CatalogueResult
from .simulate import simulate_catalogue as simulate_catalogue
from .tables import read_table as read_table
from .tables import roc as roc
