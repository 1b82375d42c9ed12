"""Error and image-quality figures of an image against its reference, over a mask."""

from .display import error_map255 as error_map255
from .display import mae255 as mae255
from .display import psnr as psnr
from .figures import FIGURES as FIGURES
from .figures import compare as compare
from .linear import RELMSE_EPSILON as RELMSE_EPSILON
from .linear import relmse as relmse
from .linear import rmse as rmse
from .perceptual import flip as flip
from .structure import BORDER as BORDER
from .structure import dssim as dssim
from .structure import ssim as ssim
from .structure import ssim_map as ssim_map
