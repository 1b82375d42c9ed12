"""Codes that say where a value comes from."""

import enum


class Source(enum.IntEnum):
    """Where a reflected pixel's radiance comes from; the values of `Reflection.source` and of the EXR channel."""

    NONE = 0
    """No reflection: no surface, a matte one, or the technique has no answer."""
    TRACED = 1
    """A ray was traced for this pixel in this frame."""
    REUSED = 2
    """Taken over from another frame."""
    DEPTH_IMAGE = 3
    """Found in a depth image of the scene."""
    LAYER = 4
    """Looked up in a layered environment map."""
    PROBE = 5
    """Gathered from a precomputed probe."""
    ENVIRONMENT = 6
    """The reflected ray left the scene, or an environment map stands in for it."""
