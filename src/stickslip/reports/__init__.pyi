from . import claims as claims
from . import details as details
from . import packing as packing
from . import page as page
from . import terminal as terminal
