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
    "conductive": "metals take the exact Fresnel term of their complex index",
    "coupled": "diffuse light passes the interface twice: albedos are converted, the path tracer weighs directions",
    "cut_out": "path traced light passes through; the surfaces that images see first are taken as opaque",
    "moving": "motion vectors of objects",
}
"""What each feature switches on."""


def format_switches(scene: Scene) -> str:
    """Which stages a scene switches on, and why.

    Args:
        scene: Any scene.
    Returns:
        What each feature that is on adds to a frame, with its reason; a feature that is off adds nothing.
    """
    reasons = feature_reasons(scene)
    lines = ["stages switched on"]
    for name in (field.name for field in dataclasses.fields(Features)):
        if getattr(scene.features, name):
            lines.append(f"  {name}: {STAGES[name]}")
            lines.append(f"      because of {reasons.get(name, 'the scene')}")
    return "\n".join(lines)
