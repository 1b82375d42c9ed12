"""Reflections from depth images of clusters of mirror rays: nothing is carried from frame to frame.

Pixels with similar mirror rays make a cluster; a camera that sees nearly what they see renders its depth image; their
rays are intersected with that. What the images do not show is traced, or looked up in an environment map.

Source: [WXKP14] §3.1.
"""

import dataclasses
import time

import jax

from jaxrefl._status import Source
from jaxrefl._types import Frame, Reflection, Scene, Tracer
from jaxrefl.core.safe import norm
from jaxrefl.radiance import diffuse_light
from jaxrefl.techniques._captured import capture_reflectors
from jaxrefl.techniques._tracing import following_mirrors, trace_refracted
from jaxrefl.techniques.clusters.answer import Surroundings, answer
from jaxrefl.techniques.clusters.begin import begin_texels
from jaxrefl.techniques.clusters.cameras import cluster_cameras
from jaxrefl.techniques.clusters.cluster import describe, mirrors_of
from jaxrefl.techniques.clusters.concave import image_of_concave
from jaxrefl.techniques.clusters.depth_images import make_depth_images
from jaxrefl.techniques.clusters.hierarchy import pyramid_of
from jaxrefl.techniques.clusters.label import label_pixels
from jaxrefl.techniques.clusters.look_up import counts_of
from jaxrefl.techniques.clusters.needed import needed_texels
from jaxrefl.techniques.clusters.types import Info, Options, Params, State


def init(scene: Scene, tracer: Tracer, *, options: Options = Options()) -> State:  # noqa: B008  frozen
    """Capture environment maps where repairs need them, and nothing else.

    Args:
        scene: The scene.
        tracer: Ray queries against `scene.mesh`.
        options: `repair`, and the size and number of the maps.
    Returns:
        The state.
    """
    if options.repair != "environment":
        return State()
    light = following_mirrors(options).light
    maps = capture_reflectors(scene, tracer, scope="object", most=options.maps, height=options.map_height, light=light)
    return State(maps)


def step(
    state: State,
    frame: Frame,
    params: Params,
    *,
    options: Options = Options(),  # noqa: B008  frozen
) -> tuple[State, Reflection, Info]:
    """Render the reflections of one frame.

    Args:
        state: From `init`.
        frame: Scene, camera, G-buffer, key and tracer.
        params: Thresholds and resolutions.
        options: Clusters, cameras, depth images, lobes, repair.
    Returns:
        The state, the reflection, and counts: `clusters`, `merged` (clusters there was no room for), `texels`, `shrunk`
        (their share of those wanted), how the pixels ended, `disoccluded` (share of the reflective pixels, or of their
        rays if they are rough, that no depth image shows to the end), `steps` (per pixel), `traced_pixels` (most of
        whose rays were traced).
    """
    seconds, cast_before, tick = {}, frame.tracer.rays, time.perf_counter()

    def timed(stage: str, result):
        nonlocal tick
        result, now = jax.block_until_ready(result), time.perf_counter()
        seconds[stage], tick = seconds.get(stage, 0.0) + now - tick, now
        return result

    scene, camera, shape = frame.scene, frame.camera, frame.gbuffer.t.shape
    mirrors = mirrors_of(frame.gbuffer)
    eye = camera.world_from_camera[:3, 3]
    label, wanted = label_pixels(mirrors, eye, params, objects=len(scene.names.objects), options=options)
    clusters = timed("cluster", describe(mirrors, label, capacity=options.capacity))
    diameter = norm(scene.upper - scene.lower)
    cameras = cluster_cameras(camera, mirrors, clusters, diameter, params, options=options, shape=shape)
    cameras = timed("cameras", cameras)
    room = options.room(frame.gbuffer.t.size)
    needed = needed_texels(cameras, clusters, mirrors, room=room, block=options.block)
    begin = begin_texels(cameras, clusters, mirrors, room=room) if options.near == "pixels" else None
    images = timed("images", make_depth_images(frame, cameras.views, needed, begin, options=options))
    diffuse, itself = None, None
    if options.far == "glossiness" or options.concave == "cluster":
        light = following_mirrors(options).light
        diffuse = diffuse_light(scene, frame.tracer, frame.gbuffer, frame.key, options=light)
        itself = image_of_concave(camera, frame.gbuffer, clusters, diffuse) if options.concave == "cluster" else None
    fading = diffuse if options.far == "glossiness" else None
    pyramid = pyramid_of(images.plane, cameras.views, images.begin) if options.search == "pyramid" else None
    around = Surroundings(scene.mesh, scene.lights, cameras, images, state.maps, pyramid, itself, fading)
    found = timed("intersect", answer(frame, label.reshape(shape), around, options=options))
    transmitted = timed("transmit", trace_refracted(frame, options=options))
    result = dataclasses.replace(found.reflection, transmitted=transmitted)
    reflective, pixels = int(mirrors.valid.sum()), counts_of(found.found)
    counts = {
        "reflective_pixels": reflective,
        "clusters": int((clusters.pixels > 0).sum()),
        "merged": max(int(wanted) - options.capacity, 0),
        "texels": int(needed.sum()),
        "shrunk": float(cameras.shrunk),
        **{name: int(count) for name, count in pixels.items()},
        "disoccluded": float(found.unsure.sum()) / max(reflective, 1),
        "steps": float(found.steps.sum()) / max(reflective, 1),
        "traced_pixels": int((result.source == int(Source.TRACED)).sum()),
    }
    info = Info(frame.tracer.rays - cast_before, seconds, counts, label.reshape(shape), found.found)
    return state, result, info
