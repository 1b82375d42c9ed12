"""Rooms with mirrors between coloured posts, and their clusters: what several tests of clusters use."""

import jax
import numpy as np
from shapes import QUAD, ball, floor

from jaxrefl._types import Frame
from jaxrefl.core import look_at
from jaxrefl.core.safe import norm
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, Part, matte, mirror
from jaxrefl.surface import look
from jaxrefl.techniques.clusters import Options, Params
from jaxrefl.techniques.clusters.cameras import cluster_cameras
from jaxrefl.techniques.clusters.cluster import describe, mirrors_of
from jaxrefl.techniques.clusters.label import label_pixels

KINDS = ("split", "octahedral", "spherical")
SIZE = (64, 48)
EYE = (0.2, 1.3, 2.4)


def checks(name: str, *, height: float = 0.0, z: float = -2.0) -> list[Part]:
    """A row of coloured posts behind the scene."""
    parts = []
    for i in range(6):
        x, colour = -2.5 + i, ((0.9, 0.2, 0.1), (0.1, 0.3, 0.9), (0.2, 0.8, 0.2))[i % 3]
        corners = np.array([[x, height, z], [x + 0.6, height, z], [x + 0.6, height + 2, z], [x, height + 2, z]])
        parts.append(Part(f"{name}{i}", corners, QUAD, matte(f"{name}{i}", colour)))
    return parts


def frame_of(parts, *, eye=EYE, target=(0, 0.5, 0), size=SIZE, **changes) -> Frame:
    scene = assemble(Description("clusters", parts, **{"ambient": (1.0, 1.0, 1.0), **changes}))
    tracer, camera = EmbreeTracer(scene.mesh), look_at(eye, target, size=size)
    return Frame(scene, camera, look(scene, tracer, camera), jax.random.key(1), tracer)


def run(technique, frame, *, params=None, **options):
    chosen = technique.Options(**options)
    state = technique.init(frame.scene, frame.tracer, options=chosen)
    _, reflection, info = technique.step(state, frame, params or technique.Params(), options=chosen)
    return reflection, info


def room(shape=None, *, size=SIZE) -> Frame:
    """A mirror ball, or another shape, on a grey floor before coloured posts."""
    shape = shape or ball("ball", mirror("m"), centre=(0, 0.6, 0), radius=0.6)
    grey = floor("floor", matte("f", (0.5, 0.5, 0.5)), size=6)
    return frame_of([grey, shape, *checks("back"), *checks("front", z=5)], size=size)


def clusters_of(frame: Frame, params=None, **options):
    options, params = Options(**options), params or Params()
    mirrors, eye = mirrors_of(frame.gbuffer), frame.camera.world_from_camera[:3, 3]
    label, wanted = label_pixels(mirrors, eye, params, objects=len(frame.scene.names.objects), options=options)
    found = describe(mirrors, label, capacity=options.capacity)
    diameter = norm(frame.scene.upper - frame.scene.lower)
    shape = frame.gbuffer.t.shape
    cameras = cluster_cameras(frame.camera, mirrors, found, diameter, params, options=options, shape=shape)
    return mirrors, found, cameras, int(wanted)
