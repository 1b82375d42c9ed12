from .pipeline import init as init
from .pipeline import step as step
from .types import Found as Found
from .types import Info as Info
from .types import Options as Options
from .types import Params as Params
from .types import State as State
