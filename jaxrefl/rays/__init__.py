from .blocks import block_size as block_size
from .blocks import blocks_of as blocks_of
from .blocks import put_block as put_block
from .blocks import take_block as take_block
from .brute import BruteTracer as BruteTracer
from .camera_rays import camera_rays as camera_rays
from .embree import EmbreeTracer as EmbreeTracer
from .offset import offset_origin as offset_origin
