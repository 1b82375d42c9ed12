from .direct import DirectOptions as DirectOptions
from .direct import direct_light as direct_light
from .incoming import Incoming as Incoming
from .incoming import IncomingOptions as IncomingOptions
from .incoming import incoming as incoming
