from .pool import Member as Member
from .pool import Spread as Spread
from .pool import Workers as Workers
from .pool import default_workers as default_workers
from .pool import reach as reach
from .pool import run_members as run_members
from .pool import trial as trial
