"""Built-in procedural scenes, one module each; every module says what its scene stresses.

A scene module has `build(*, triangles, ...) -> Description`, `path(frames, *, size) -> tuple[Camera, ...]` (a camera
path made for the scene, whose frame 0 is its best still) and `STRESSES`, one line on what the scene is good for.
"""

from scenes._registry import BUILT_IN as BUILT_IN
from scenes._registry import build as build
