"""Meshes that deform in every frame: clusters without any rays against rays with a structure that must be rebuilt.

The light is ambient alone, so neither side casts shadow rays. Everything that must be done again for a new frame
counts: for ray tracing building Embree's structure, the viewer's rays and the mirror rays; for clusters rasterising the
viewer's image and the depth images.
"""

import dataclasses
import time
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

import scenes
from jaxrefl._types import Camera, Frame, Mesh, Scene
from jaxrefl.core import resize
from jaxrefl.metrics import mae255
from jaxrefl.rays import EmbreeTracer, camera_rays, raster_camera
from jaxrefl.scene import assemble
from jaxrefl.surface import build_gbuffer, look, reflective
from jaxrefl.techniques import clusters, raytrace

Rows = list[dict[str, Any]]
SCENE = "mirror_room"


class NoRays:
    """Stands where a tracer would, and has none."""

    rays = 0

    def _none(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("this frame is rendered without rays, and something asked for one")

    closest = closest_rows = occluded = _none


def under_a_plain_sky(scene: Scene) -> Scene:
    """The scene with nothing but ambient light.

    Args:
        scene: A scene.
    Returns:
        The same geometry, lit evenly.
    """
    lights = dataclasses.replace(
        scene.lights, ambient=jnp.ones(3, jnp.float32), area=None, punctual=None, environment=None
    )
    return dataclasses.replace(scene, lights=lights)


@jax.jit
def waved(scene: Scene, phase: Array) -> Mesh:
    """A scene's mesh with a wave running through everything that does not reflect.

    Args:
        scene: The scene at rest.
        phase: Of the wave, radians.
    Returns:
        The mesh with its vertices moved by up to a thousandth of the diagonal; normals stay as they are.
    """
    mesh, size = scene.mesh, jnp.linalg.norm(scene.upper - scene.lower)
    dull = ((scene.materials.metallic == 0) & (scene.materials.eta == 1))[mesh.material]
    moves = (
        jnp.zeros(mesh.vertices.shape[0], bool).at[mesh.faces].max(jnp.broadcast_to(dull[:, None], mesh.faces.shape))
    )
    wave = jnp.where(moves[:, None], jnp.sin(40 * mesh.vertices[:, jnp.array([1, 2, 0])] / size + phase), 0)
    return dataclasses.replace(mesh, vertices=mesh.vertices + 1e-3 * size * wave)


def deforming(triangles: tuple[int, ...], side: int, *, frames: int = 3) -> Rows:
    """Milliseconds per frame of both ways, static and deforming.

    Args:
        triangles: Tessellations of the scene.
        side: Width and height of the images, pixels.
        frames: Frames that are timed, after one that is not.
    Returns:
        One row per tessellation.
    """
    rows = []
    for count in triangles:
        rest = under_a_plain_sky(assemble(scenes.build(SCENE, triangles=count)))
        camera = resize(scenes.BUILT_IN[SCENE].path(1, size=(side, side))[0], (side, side))
        options = clusters.Options(maker="raster", repair="none")
        total = {"build": 0.0, "trace": 0.0, "static": 0.0, "clusters": 0.0}
        error = 0.0
        for number in range(frames + 1):
            mesh = jax.block_until_ready(waved(rest, jnp.float32(number)))
            scene = dataclasses.replace(rest, mesh=mesh)
            key = jax.random.key(number)
            began = time.perf_counter()
            tracer = EmbreeTracer(mesh)
            built = time.perf_counter()
            traced, gbuffer = _traced(scene, camera, tracer, key)
            done = time.perf_counter()
            drawn = _drawn(scene, camera, key, options)
            ended = time.perf_counter()
            cast = Frame(scene, camera, gbuffer, key, tracer)
            still = clusters.Options(repair="none")
            clusters.step(clusters.init(scene, tracer, options=still), cast, clusters.Params(), options=still)
            stopped = time.perf_counter()
            if number == 0:
                continue  # compiles
            for name, seconds in zip(total, (built - began, done - built, stopped - ended, ended - done), strict=True):
                total[name] += 1e3 * seconds / frames
            error += mae255(drawn.radiance, traced.radiance, reflective(gbuffer)) / frames
        rows.append({
            "triangles": int(rest.mesh.faces.shape[0]),
            "build ms": total["build"],
            "rays and shading ms": total["trace"],
            "clusters, cast, ms": total["static"],
            "clusters, rasterised, viewer's image too, ms": total["clusters"],
            "static: tracing / clusters": total["trace"] / total["static"],
            "deforming: tracing / clusters": (total["build"] + total["trace"]) / total["clusters"],
            "MAE 255 of the reflection": error,
        })  # fmt: skip
    return rows


def _traced(scene: Scene, camera: Camera, tracer: EmbreeTracer, key: Array) -> tuple[Any, Any]:
    gbuffer = look(scene, tracer, camera)
    frame = Frame(scene, camera, gbuffer, key, tracer)
    _, image, _ = raytrace.step(raytrace.State(), frame, raytrace.Params(), options=raytrace.Options())
    return jax.block_until_ready(image), gbuffer


def _drawn(scene: Scene, camera: Camera, key: Array, options: clusters.Options) -> Any:
    hits = raster_camera(scene.mesh, camera)
    gbuffer = build_gbuffer(scene, camera_rays(camera), hits, camera=camera)
    frame = Frame(scene, camera, gbuffer, key, NoRays())
    _, image, _ = clusters.step(clusters.State(), frame, clusters.Params(), options=options)
    return jax.block_until_ready(image)


def rasteriser(triangles: tuple[int, ...], side: int, *, runs: int = 5) -> Rows:
    """Milliseconds to draw what one camera sees, against casting its rays.

    Args:
        triangles: Tessellations of the scene.
        side: Largest width and height of the images, pixels; half of it is drawn too.
        runs: Runs whose median counts.
    Returns:
        One row per tessellation and size.
    """
    rows = []
    for count in triangles:
        scene = assemble(scenes.build(SCENE, triangles=count))
        began = time.perf_counter()
        tracer = EmbreeTracer(scene.mesh)
        build = 1e3 * (time.perf_counter() - began)
        for size in (side // 2, side):
            camera = resize(scenes.BUILT_IN[SCENE].path(1, size=(size, size))[0], (size, size))
            rays = camera_rays(camera)
            drawn = _median(lambda camera=camera, scene=scene: raster_camera(scene.mesh, camera), runs)
            cast = _median(lambda rays=rays, tracer=tracer: tracer.closest(rays), runs)
            hits = raster_camera(scene.mesh, camera)
            truth = tracer.closest(rays)
            differ = (hits.valid != truth.valid) | (hits.triangle != truth.triangle)
            faces = int(scene.mesh.faces.shape[0])
            rows.append({
                "triangles": faces, "side": size, "raster ms": drawn, "Embree's rays ms": cast,
                "Embree's build ms": build,
                "raster ns per triangle": 1e6 * drawn / faces, "raster ns per pixel": 1e6 * drawn / size**2,
                "other triangle %": 100 * float(differ.mean()),
            })  # fmt: skip
    return rows


def _median(call: Any, runs: int) -> float:
    jax.block_until_ready(call())
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        jax.block_until_ready(call())
        times.append(1e3 * (time.perf_counter() - began))
    return sorted(times)[runs // 2]
