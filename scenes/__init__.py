"""Built-in procedural scenes, one module each; every module says what its scene stresses.

A scene module has `build(*, triangles, ...) -> Description`, `path(frames, *, size) -> tuple[Camera, ...]` (a closed or
open camera path made for the scene) and `STRESSES`, one line on what the scene is good for.
"""
