"""The camera of every frame: from a file, from keyframes, from the scene, or made up (and then it says so).

- A built-in scene brings a path of its own.
- A camera that stands still (a scene file's, or the only one of a camera file) is turned into a short closed loop
  around it when several frames are asked for: frame 0 is the camera itself, the others turn about the point it looks
  at, by at most `swing` degrees. The loop shrinks where something stands in its way.
- A scene without any camera gets one that shows its bounds (`framing`).
"""

import math
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Camera, Rays, Scene, Tracer
from jaxrefl.core.cameras import resize
from pipelines.camera_files import camera_file_facts, read_cameras
from pipelines.framing import framing_camera, seen_from_behind
from pipelines.job import Job
from pipelines.keyframes import keyframe_cameras
from pipelines.toml_tables import JobError, suggestion
from scenes import BUILT_IN

_PROBES = 64
_PIVOT = 0.1


def job_cameras(job: Job, scene: Scene, tracer: Tracer) -> tuple[tuple[Camera, ...], list[str]]:
    """One camera per frame of a resolved job.

    Args:
        job: Resolved job.
        scene: Its scene.
        tracer: Ray queries against the scene.
    Returns:
        The cameras, and notes on what was assumed and on cameras that seem to be inside something.
    Raises:
        JobError: If the path cannot be made; names the file, keyframe or frame.
    """
    choice, frames, size = job.camera, job.frames or 1, job.size or (1, 1)
    notes = []
    if choice.file is not None and camera_file_facts(Path(choice.file)).frames > 1:
        cameras = read_cameras(Path(choice.file), frames=frames, size=size, up=choice.up)
    elif choice.keyframes and len(choice.keyframes) > 1:
        cameras = keyframe_cameras(choice.keyframes, frames=frames, size=size, closed=choice.closed, up=choice.up)
    elif choice.file is None and choice.name is None and not choice.keyframes and job.scene.source in BUILT_IN:
        cameras = tuple(BUILT_IN[job.scene.source].path(frames, size=size))
    else:
        still = _still_camera(job, scene, tracer, notes)
        cameras, swing = loop_around(still, scene, tracer, frames=frames, swing=choice.swing)
        if frames > 1:
            notes.append(
                f"The camera stands still in its source; it moves on a loop of {swing:g} degrees around its target."
            )
    notes += inside_notes(cameras, scene, tracer)
    return cameras, notes


def _still_camera(job: Job, scene: Scene, tracer: Tracer, notes: list[str]) -> Camera:
    choice, size = job.camera, job.size or (1, 1)
    if choice.file is not None:
        return read_cameras(Path(choice.file), frames=1, size=size, up=choice.up)[0]
    if choice.keyframes:
        return keyframe_cameras(choice.keyframes, frames=1, size=size, up=choice.up)[0]
    if choice.name is not None:
        if choice.name not in scene.names.cameras:
            raise JobError(
                f"camera: the scene has no camera {choice.name!r}; {suggestion(choice.name, scene.names.cameras)}"
            )
        return resize(scene.cameras[scene.names.cameras.index(choice.name)], size)
    if scene.cameras:
        return resize(scene.cameras[0], size)
    notes.append("The scene has no camera; one was made up that shows all of it.")
    return framing_camera(scene, tracer, size)


def loop_around(
    camera: Camera, scene: Scene, tracer: Tracer, *, frames: int, swing: float = 5.0
) -> tuple[tuple[Camera, ...], float]:
    """A short closed loop around a camera that stands still.

    $$ \\text{yaw} = s \\sin\\varphi, \\text{pitch} = \\tfrac{s}{4} \\sin 2\\varphi, \\varphi = 2\\pi i / n $$

    Args:
        camera: The camera; it is frame 0.
        scene: The scene; its bounds give the point to turn about.
        tracer: Ray queries, to see that nothing stands between the camera and its loop.
        frames: How many cameras.
        swing: Largest yaw s, degrees.
    Returns:
        The cameras, and the swing that was possible: halved until the loop is free, 0 where it never is.
    """
    matrix = np.asarray(camera.world_from_camera, np.float64)
    eye, backward = matrix[:3, 3], matrix[:3, 2]
    lower, upper = (np.asarray(x, np.float64) for x in (scene.lower, scene.upper))
    distance = max(float((eye - (lower + upper) / 2) @ backward), _PIVOT * float(np.linalg.norm(upper - lower)), 1e-6)
    pivot = eye - backward * distance
    for halvings in range(6):
        angle = swing / 2**halvings
        path = [_turned(matrix, pivot, angle, 2 * math.pi * i / frames) for i in range(frames)]
        if frames == 1 or _is_free(tracer, eye, np.array([m[:3, 3] for m in path[1:]])):
            break
    else:
        angle, path = 0.0, [matrix] * frames
    place = lambda m: eqx.tree_at(lambda c: c.world_from_camera, camera, jnp.asarray(m, jnp.float32))  # noqa: E731
    return (camera, *(place(m) for m in path[1:])), angle


def _turned(matrix: np.ndarray, pivot: np.ndarray, swing: float, phase: float) -> np.ndarray:
    """The camera turned about the pivot, yaw about its own up axis, then pitch about its own right axis."""
    yaw, pitch = math.radians(swing) * math.sin(phase), math.radians(swing) / 4 * math.sin(2 * phase)
    about_y = np.array([[math.cos(yaw), 0, math.sin(yaw)], [0, 1, 0], [-math.sin(yaw), 0, math.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, math.cos(pitch), -math.sin(pitch)], [0, math.sin(pitch), math.cos(pitch)]])
    axes = matrix[:3, :3]
    turn = axes @ about_y @ about_x @ np.linalg.inv(axes)
    turned = np.eye(4)
    turned[:3, :3], turned[:3, 3] = turn @ axes, pivot + turn @ (matrix[:3, 3] - pivot)
    return turned


def _is_free(tracer: Tracer, eye: np.ndarray, stops: np.ndarray) -> bool:
    """True if the straight ways from `eye` to the stops, and half as far again, meet nothing."""
    way = stops - eye
    length = np.linalg.norm(way, axis=-1)
    direction = way / np.where(length > 0, length, 1)[:, None]
    origin = np.broadcast_to(eye, way.shape)
    rays = Rays(jnp.asarray(origin, jnp.float32), jnp.asarray(direction, jnp.float32))
    return not bool(tracer.occluded(rays, jnp.asarray(1.5 * length, jnp.float32)).any())


def inside_notes(cameras: tuple[Camera, ...], scene: Scene, tracer: Tracer) -> list[str]:
    """A note on cameras that seem to be inside an object.

    A camera counts as inside when rays in all directions first meet the back of one and the same object.

    Args:
        cameras: The cameras.
        scene: The scene.
        tracer: Ray queries against it.
    Returns:
        At most one sentence, which counts and names the frames.
    """
    index = np.arange(_PROBES) + 0.5
    z, phi = 1 - 2 * index / _PROBES, math.pi * (1 + math.sqrt(5)) * index
    ring = np.sqrt(1 - z * z)
    around = np.stack([ring * np.cos(phi), ring * np.sin(phi), z], -1)
    eyes = np.array([np.asarray(c.world_from_camera)[:3, 3] for c in cameras])
    direction = np.broadcast_to(around, (len(cameras), _PROBES, 3))
    origin = np.broadcast_to(eyes[:, None], direction.shape)
    hits = tracer.closest(Rays(jnp.asarray(origin, jnp.float32), jnp.asarray(direction, jnp.float32)))
    triangle = np.asarray(hits.triangle)
    owner = np.asarray(scene.mesh.object)[triangle]
    from_behind = np.asarray(hits.valid) & seen_from_behind(scene, triangle, direction)
    inside = from_behind.all(-1) & (owner == owner[:, :1]).all(-1)
    if not inside.any():
        return []
    numbers = np.flatnonzero(inside)
    first = scene.names.objects[owner[numbers[0], 0]]
    listed = ", ".join(str(n) for n in numbers[:5]) + (", ..." if len(numbers) > 5 else "")
    return [f"{len(numbers)} of {len(cameras)} cameras seem to be inside an object (frames {listed}; {first!r})."]
