"""Maps of the surroundings of reflectors, for techniques that read or fall back on them: Scene -> Captured."""

from .capture import reflectors_of as reflectors_of
from .maps import SCOPES as SCOPES
from .maps import Captured as Captured
from .maps import capture_reflectors as capture_reflectors
from .read import read_stack as read_stack
