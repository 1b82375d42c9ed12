from . import envmap as envmap
from . import raytrace as raytrace
from . import temporal as temporal
from . import warp as warp
from ._registry import TECHNIQUES as TECHNIQUES
from ._shape import Info as Info
from ._shape import Technique as Technique
