"""Reusing images of earlier frames: reading between pixels, depth warping, drawn meshes, key-frame policies."""

from .policy import POLICIES as POLICIES
from .policy import KeyOptions as KeyOptions
from .policy import same_camera as same_camera
from .policy import wants_key as wants_key
from .raster import Drawn as Drawn
from .raster import GridMesh as GridMesh
from .raster import draw as draw
from .read import SNAP as SNAP
from .read import Footprint as Footprint
from .read import all_of as all_of
from .read import components as components
from .read import footprint as footprint
from .read import pixel_centres as pixel_centres
from .read import read as read
from .surface import read_reflection as read_reflection
from .surface import seen_before as seen_before
