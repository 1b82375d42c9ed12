"""Screen-space filters: what a rough surface does to a sharp reflection."""

from .covariance import Axes as Axes
from .covariance import nearest_covariance as nearest_covariance
from .covariance import principal_axes as principal_axes
from .footprint import Footprint as Footprint
from .footprint import FootprintOptions as FootprintOptions
from .footprint import footprint as footprint
from .footprint import plane_slope as plane_slope
from .footprint import relative_distance as relative_distance
from .footprint import remaining as remaining
from .gloss import GlossOptions as GlossOptions
from .gloss import GlossParams as GlossParams
from .gloss import Guides as Guides
from .gloss import gloss as gloss
from .gloss import guides_of as guides_of
from .lobe_file import cache_folder as cache_folder
from .lobe_file import load_table as load_table
from .lobe_table import LobeGaussians as LobeGaussians
from .lobe_table import LobeTable as LobeTable
from .lobe_table import TableOptions as TableOptions
from .lobe_table import build_table as build_table
from .lobe_table import lobe_gaussians as lobe_gaussians
