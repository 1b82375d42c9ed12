"""Pictures of how clusters see a frame: Shot -> a strip of five images."""

from pathlib import Path

import imageio.v3 as iio
import numpy as np

from jaxrefl._types import Reflection
from jaxrefl.composite import tone_map
from jaxrefl.techniques.clusters import Found, Info

_COLOURS = {
    Found.NONE: (0, 0, 0),
    Found.SURFACE: (90, 90, 90),
    Found.SKY: (110, 130, 170),
    Found.PASSED: (255, 200, 0),
    Found.HIDDEN: (255, 0, 0),
    Found.NO_CAMERA: (255, 0, 255),
    Found.OUTSIDE: (0, 255, 255),
}
_GAIN = 4


def draw_strip(traced: Reflection, image: Reflection, info: Info, out: Path) -> None:
    """Write a strip: traced, by clusters, the clusters, how rays ended, and four times the difference.

    Args:
        traced: The reflection by ray tracing.
        image: The same by clusters.
        info: What they tell.
        out: PNG file to write.
    """
    truth, ours = (255 * np.asarray(tone_map(r.radiance)) for r in (traced, image))
    label = np.asarray(info.cluster)
    palette = np.random.default_rng(3).integers(40, 255, (int(label.max()) + 2, 3))
    palette[0] = 0
    codes = np.array([_COLOURS[code] for code in Found])
    difference = np.abs(truth - ours).mean(-1, keepdims=True) * (_GAIN, _GAIN, _GAIN)
    strip = np.concatenate([truth, ours, palette[label + 1], codes[np.asarray(info.found)], difference], 1)
    iio.imwrite(out, np.clip(strip, 0, 255).astype(np.uint8))
