"""Which stages a scene switches on, and why: Scene -> text, for `jaxrefl info`."""

import dataclasses

from jaxrefl._types import Features, Scene
from jaxrefl.scene import feature_reasons

STAGES = {
    "planar": "planar reflectors take closed forms",
    "curved": "reflections on curved surfaces",
    "glossy": "several rays or prefiltered light per glossy pixel; a mirror needs one ray",
    "refractive": "rays are refracted into and through surfaces",
    "textured": "textures are looked up at every hit",
    "normal_mapped": "normals are perturbed by normal maps, with tangent frames",
    "vertex_coloured": "vertex colours are interpolated",
    "emissive": "shadow rays to area lights, and emission at hits",
    "punctual": "shadow rays to points, spots and the sun",
    "environment_lit": "shadow rays to the environment, and its light along rays that leave the scene",
    "moving": "motion vectors of objects",
}
"""What each feature switches on."""


def format_switches(scene: Scene) -> str:
    """Which stages a scene switches on, and why.

    Args:
        scene: Any scene.
    Returns:
        One line per feature that is on, with its reason, and one line that lists those that are off.
    """
    reasons = feature_reasons(scene)
    names = [field.name for field in dataclasses.fields(Features)]
    lines = ["stages switched on"]
    for name in names:
        if getattr(scene.features, name):
            lines.append(f"  {name}: {STAGES.get(name, name)}")
            lines.append(f"      because of {reasons.get(name, 'the scene')}")
    off = [name for name in names if not getattr(scene.features, name)]
    lines.append(f"switched off, at no cost: {', '.join(off) if off else 'nothing'}")
    return "\n".join(lines)
