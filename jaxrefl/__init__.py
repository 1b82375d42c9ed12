"""Render reflections approximately, fast, and with a known error.

A scene goes in, an image with its layers and errors comes out; each step is a function of its own:

    load -> look -> direct_light -> <technique>.step -> blend -> metrics.compare
"""

from . import composite as composite
from . import core as core
from . import filters as filters
from . import metrics as metrics
from . import radiance as radiance
from . import rays as rays
from . import scene as scene
from . import surface as surface
from . import techniques as techniques
from ._status import Source as Source
from ._types import AreaLights as AreaLights
from ._types import Camera as Camera
from ._types import Environment as Environment
from ._types import Features as Features
from ._types import Frame as Frame
from ._types import GBuffer as GBuffer
from ._types import Hits as Hits
from ._types import LightMap as LightMap
from ._types import Lights as Lights
from ._types import Materials as Materials
from ._types import Mesh as Mesh
from ._types import Names as Names
from ._types import PunctualLights as PunctualLights
from ._types import Rays as Rays
from ._types import Reflection as Reflection
from ._types import Scene as Scene
from ._types import Textures as Textures
from ._types import Tracer as Tracer
from .composite import blend as blend
from .composite import tone_map as tone_map
from .core import look_at as look_at
from .core import perspective as perspective
from .core import project as project
from .core import resize as resize
from .metrics import compare as compare
from .radiance import DirectOptions as DirectOptions
from .radiance import direct_light as direct_light
from .radiance import incoming as incoming
from .rays import BruteTracer as BruteTracer
from .rays import EmbreeTracer as EmbreeTracer
from .rays import attach_hits as attach_hits
from .rays import camera_rays as camera_rays
from .scene import assemble as assemble
from .scene import load as load
from .surface import build_gbuffer as build_gbuffer
from .surface import look as look
from .techniques import TECHNIQUES as TECHNIQUES
from .techniques import clusters as clusters
from .techniques import envmap as envmap
from .techniques import gather as gather
from .techniques import mirror_gloss as mirror_gloss
from .techniques import raytrace as raytrace
from .techniques import temporal as temporal
from .techniques import warp as warp
