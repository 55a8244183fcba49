from .report import read_table as read_table
from .report import roc as roc
from .scenario import CatalogueScenario as CatalogueScenario
from .simulate import CatalogueResult as CatalogueResult
from .simulate import simulate_catalogue as simulate_catalogue
