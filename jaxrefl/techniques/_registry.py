"""The techniques that exist, by the name they have on the command line."""

from types import ModuleType

from jaxrefl.techniques import clusters, envmap, gather, mirror_gloss, raytrace, temporal, warp
from jaxrefl.techniques._shape import Technique


def _technique(name: str, summary: str, module: ModuleType) -> Technique:
    carried = (getattr(module, name, None) for name in ("interval", "ahead"))
    return Technique(name, summary, module.init, module.step, module.Params, module.Options, *carried)


TECHNIQUES: dict[str, Technique] = {
    technique.name: technique
    for technique in (
        _technique("raytrace", "Brute force: mirror rays, or n GGX samples, for every reflective pixel.", raytrace),
        _technique("envmap", "Environment mapping: a prefiltered map captured once per reflector or scene.", envmap),
        _technique("mirror_gloss", "Mirror rays, blurred by the footprint of each pixel's lobe.", mirror_gloss),
        _technique("gather", "Image-space gathering: mirror rays, averaged over a disk in the image.", gather),
        _technique("warp", "Naive warping: key frames are traced, reflections stick to surfaces between them.", warp),
        _technique("clusters", "Depth images of clusters of mirror rays, met by each pixel's own rays.", clusters),
        _technique("temporal", "Reflections reprojected from key frames, traced where that fails.", temporal),
    )
}
"""Techniques in the order in which a reader should meet them."""
