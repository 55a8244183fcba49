from . import bundled as bundled
from . import dataset as dataset
from . import folder as folder
from . import json_output as json_output
from . import page as page
