"""The path tracer against Mitsuba 3, a renderer that nobody here wrote, on the same scene file.

Both render independent replicates of the same image; blocks of pixels are averaged, and the difference of the two
means is divided by its standard error. If the two agree, those scores follow Student's distribution, whose degrees of
freedom come from the spread of the replicates ([Welch47]); how many lie beyond 3 is then known in advance.

Source: [Welch47] Welch, "The generalization of Student's problem when several different population variances are
involved", Biometrika 34, 1947; [SA07] Subr and Arvo, "Statistical Hypothesis Testing for Assessing Monte Carlo
Estimators", Pacific Graphics 2007.
"""

import tempfile
import time
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxrefl._types import Camera, Scene, Tracer
from jaxrefl.core import hash_words
from jaxrefl.radiance import PathOptions, camera_samples, path_radiance
from jaxrefl.surface.bsdf import Scattering

MODEL = Scattering(masking="separable", multiple_scattering=False)
"""Mitsuba's model of rough surfaces: separable masking, single scattering."""
REPLICATES = 8
"""Independent renderings of each image."""
_ROUNDING = 1e-5
"""Relative error of a block's mean that is left to rounding."""
_RAYS = 2**20
"""Rays that are followed in one call."""


class Agreement(NamedTuple):
    """How two sets of replicates compare."""

    means: tuple[np.ndarray, np.ndarray]
    """Mean radiance per channel of ours and theirs."""
    means_error: np.ndarray
    """Standard error of the relative difference of those means, per channel."""
    scores: np.ndarray
    """[rows columns 3] difference over its standard error, block by block; NaN where both are black."""
    beyond: float
    """Share of the scores beyond 3."""
    expected: float
    """That share if both estimate the same image."""
    images: tuple[np.ndarray, np.ndarray]
    """[h w 3] mean images."""

    @property
    def difference(self) -> np.ndarray:
        """Relative difference of the mean radiance, per channel."""
        ours, theirs = self.means
        return (ours - theirs) / theirs


def agreement(ours: np.ndarray, theirs: np.ndarray, *, block: int) -> Agreement:
    """Compare two sets of replicates of one image.

    Args:
        ours: [r h w 3] linear radiance.
        theirs: [r h w 3] linear radiance.
        block: Side of the blocks of pixels, in pixels; partial blocks at the edges are left out.
    Returns:
        Means, scores, and the share of scores beyond 3 beside what is expected.
    Raises:
        ValueError: If the shapes differ or there are fewer than two replicates.
    """
    from scipy.stats import t as student

    if ours.shape != theirs.shape or len(ours) < 2:
        raise ValueError(f"ours, theirs: expected equal shapes [r h w 3], r >= 2, got {ours.shape} and {theirs.shape}")
    blocks = [_block_means(np.asarray(x, np.float64), block) for x in (ours, theirs)]
    counts = [len(x) for x in blocks]
    mean = [x.mean(0) for x in blocks]
    variance = [x.var(0, ddof=1) / n for x, n in zip(blocks, counts, strict=True)]
    # A block that shows nothing but a lamp has no noise; what is left there is the rounding of float32 sums.
    total = variance[0] + variance[1] + np.where(mean[1] > 0, (_ROUNDING * mean[1]) ** 2, 0)
    known = total > 0
    safe = np.where(known, total, 1)
    scores = np.where(known, (mean[0] - mean[1]) / np.sqrt(safe), np.nan)
    spread = sum(v**2 / (n - 1) for v, n in zip(variance, counts, strict=True))
    freedom = np.where(spread > 0, safe**2 / np.where(spread > 0, spread, 1), np.inf)
    tails = 2 * student.sf(3, freedom)
    means = [np.asarray(x, np.float64).mean((1, 2)) for x in (ours, theirs)]
    error = np.sqrt(sum(x.var(0, ddof=1) / len(x) for x in means)) / means[1].mean(0)
    return Agreement(
        means=(means[0].mean(0), means[1].mean(0)),
        means_error=error,
        scores=scores,
        beyond=float((np.abs(scores[known]) > 3).mean()),
        expected=float(tails[known].mean()),
        images=(np.asarray(ours).mean(0), np.asarray(theirs).mean(0)),
    )


def _block_means(images: np.ndarray, block: int) -> np.ndarray:
    r, h, w, c = images.shape
    rows, columns = h // block, w // block
    return images[:, : rows * block, : columns * block].reshape(r, rows, block, columns, block, c).mean((2, 4))


class Rendered(NamedTuple):
    """Replicates of one image and what they cost."""

    images: np.ndarray
    """[r h w 3] linear radiance."""
    paths_per_second: float
    """Paths per second, compilation left out."""


def render_ours(
    scene: Scene, tracer: Tracer, camera: Camera, *, samples: int, bounces: int, replicates: int = REPLICATES
) -> Rendered:
    """Replicates by this library's path tracer, with Mitsuba's model of rough surfaces.

    Args:
        scene: The scene.
        tracer: Ray queries against it.
        camera: The camera.
        samples: Paths per pixel and replicate.
        bounces: Most scattering events.
        replicates: How many.
    Returns:
        The images, and paths per second.
    """
    options = PathOptions(bounces=bounces, scattering=MODEL)
    at_once = max(1, min(samples, _RAYS // (camera.width * camera.height)))

    def image(replicate: int, count: int) -> np.ndarray:
        total = np.zeros((camera.height, camera.width, 3))
        for first in range(0, count, at_once):
            number = jnp.arange(first, min(first + at_once, count), dtype=jnp.uint32)
            rays = camera_samples(camera, hash_words(jnp.zeros_like(number), replicate), number)
            total += np.asarray(path_radiance(scene, tracer, *rays, options=options)).sum(0)
        return total / count

    image(replicates, at_once)
    began = time.perf_counter()
    images = np.stack([image(number, samples) for number in range(replicates)])
    seconds = time.perf_counter() - began
    return Rendered(images, replicates * samples * camera.width * camera.height / seconds)


def render_theirs(
    file: Path,
    size: tuple[int, int],
    *,
    samples: int,
    bounces: int,
    replicates: int = REPLICATES,
    variant: str = "scalar_rgb",
) -> Rendered:
    """Replicates by Mitsuba 3.

    Args:
        file: Scene file.
        size: Width and height in pixels; the image is filtered by a box, as ours is.
        samples: Paths per pixel and replicate.
        bounces: Most scattering events.
        replicates: How many.
        variant: Variant of Mitsuba.
    Returns:
        The images, and paths per second.
    Raises:
        ImportError: If the package `mitsuba` is not installed.
    """
    import mitsuba

    mi: Any = mitsuba

    before = mi.variant()
    mi.set_variant(variant)
    try:
        scene: Any = _load_for_comparison(mi, file, size, bounces)
        np.asarray(mi.render(scene, spp=1, seed=replicates))
        began = time.perf_counter()
        images = [np.array(mi.render(scene, spp=samples, seed=number))[..., :3] for number in range(replicates)]
        seconds = time.perf_counter() - began
    finally:
        if before:
            mi.set_variant(before)
    return Rendered(np.stack(images), replicates * samples * size[0] * size[1] / seconds)


def _load_for_comparison(mi: Any, file: Path, size: tuple[int, int], bounces: int) -> Any:
    """The scene with the film, filter, depth and microfacets (GGX, as they are read here) of the comparison."""
    tree = ET.parse(file)
    root = tree.getroot()
    for old in root.findall("integrator"):
        root.remove(old)
    old_version = root.get("version", "3.0.0").startswith("0.")
    names = (
        ("maxDepth", "pixelFormat", "componentFormat")
        if old_version
        else ("max_depth", "pixel_format", "component_format")
    )
    integrator = ET.SubElement(root, "integrator", type="path")
    ET.SubElement(integrator, "integer", name=names[0], value=str(bounces + 1))
    for surface in root.iter("bsdf"):
        if surface.get("type", "").startswith("rough"):
            for old in [x for x in surface.findall("string") if x.get("name") == "distribution"]:
                surface.remove(old)
            ET.SubElement(surface, "string", name="distribution", value="ggx")
    for sensor in root.findall("sensor"):
        for film in sensor.findall("film"):
            sensor.remove(film)
        film = ET.SubElement(sensor, "film", type="hdrfilm")
        ET.SubElement(film, "integer", name="width", value=str(size[0]))
        ET.SubElement(film, "integer", name="height", value=str(size[1]))
        ET.SubElement(film, "string", name=names[1], value="rgb")
        ET.SubElement(film, "string", name=names[2], value="float32")
        ET.SubElement(film, "rfilter", type="box")
    with tempfile.TemporaryDirectory() as folder:
        changed = Path(folder) / "scene.xml"
        tree.write(changed)
        resolver = mi.file_resolver()
        own = mi.FileResolver(resolver)
        own.prepend(str(file.resolve().parent))
        mi.set_file_resolver(own)
        try:
            return mi.load_file(str(changed), parallel=False)  # in parallel it waits for itself now and then
        finally:
            mi.set_file_resolver(resolver)


def compare_with_mitsuba(
    file: Path, scene: Scene, tracer: Tracer, camera: Camera, *, samples: int, bounces: int, block: int = 8
) -> Agreement:
    """Both renderers on the same file.

    Args:
        file: Scene file that Mitsuba reads.
        scene: The same scene, loaded here.
        tracer: Ray queries against it.
        camera: Its camera; its size is that of the images.
        samples: Paths per pixel and replicate.
        bounces: Most scattering events.
        block: Side of the blocks, in pixels.
    Returns:
        How the two compare.
    """
    ours = render_ours(scene, tracer, camera, samples=samples, bounces=bounces)
    theirs = render_theirs(file, (camera.width, camera.height), samples=samples, bounces=bounces)
    return agreement(ours.images, theirs.images, block=block)
