from .blend import Options as Options
from .blend import blend as blend
from .tone import tone_map as tone_map
