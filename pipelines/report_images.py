"""Pictures of the report: PNG and EXR files of a results folder -> data URIs and error maps on one colour scale.

Error maps show what `metrics.mae255` averages, pixel by pixel, from the linear EXR files at the job's exposure. Their
scale is the same for all techniques and frames, so that colours can be compared. It ends at a round number above nearly
all errors, and goes with the square root of the error, so that an accurate technique beside a rough one is not black.
"""

import base64
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from jaxrefl.metrics import error_map255
from pipelines.outputs import read_exr
from pipelines.report_results import REFERENCE, Results

MAX_FRAMES = 48
"""More frames than this are thinned to every k-th."""
MAX_WIDTH = 960
"""Wider pictures are scaled down, pixels."""
MAX_LOSSLESS = 12
"""Up to this many pictures are embedded as PNG; more as WebP."""
WEBP_QUALITY = 90
SCALE_FRAMES = 6
"""Frames that the scale of the error maps is taken from."""
SCALE_PERCENTILE = 99.5
COLOUR_MAP = "inferno"
"""Perceptually uniform, black at 0."""


@dataclass(frozen=True)
class Source:
    """Everything that the viewer can show of one technique, or of the reference."""

    name: str
    pictures: list[str | None]
    """Data URI per shown frame; None where the source has no such frame."""
    errors: list[str | None]
    """Data URI of the error map per shown frame; None for the reference, or where an EXR file is missing."""


@dataclass(frozen=True)
class Pictures:
    """The embedded pictures and how they were made."""

    frames: list[int]
    """Frame numbers shown."""
    sources: list[Source]
    """Techniques in their order, then the reference."""
    width: int
    """Width of the rendered frames, pixels."""
    height: int
    """Height of the rendered frames, pixels."""
    error_scale: float | None
    """Value of the brightest colour, 0-255; None: there is no error map."""
    gradient: list[str]
    """CSS colours from error 0 to `error_scale`, evenly spaced on the scale."""
    ticks: list[tuple[float, str]]
    """(percent of the scale's length, error) of its labels."""
    notes: list[str]
    """What was left out or scaled, one sentence each."""


def embed_pictures(results: Results) -> Pictures:
    """All pictures and error maps that the report shows, as data URIs.

    Args:
        results: Checked results.
    Returns:
        The embedded pictures; error maps where technique and reference both have an EXR file of the frame.
    Raises:
        ValueError: If a picture cannot be decoded, or an image and its reference differ in size.
    """
    frames = thinned(results.frames)
    names = [*results.techniques, *([REFERENCE] if results.reference else [])]
    lossless = len(frames) * len(names) <= MAX_LOSSLESS
    exposure = _exposure(results)
    width, height = _first_size(results, names, frames, exposure)

    spread = frames[:: max(1, math.ceil(len(frames) / SCALE_FRAMES))]
    sample = [_error_map(results, name, frame, exposure) for name in results.techniques for frame in spread]
    scale = error_scale([error for error in sample if error is not None])

    sources, no_error = [], []
    for name in names:
        pictures, errors = [], []
        for frame in frames:
            picture = _picture(results, name, frame, exposure)
            pictures.append(None if picture is None else _uri(_shrunk(picture), lossless))
            error = _error_map(results, name, frame, exposure) if name != REFERENCE and scale else None
            errors.append(None if error is None else _uri(_coloured(error, scale or 1.0), lossless))
            if name != REFERENCE and error is None:
                no_error.append(f"{name} {frame}")
        sources.append(Source(name, pictures, errors))

    notes = []
    if len(frames) < len(results.frames):
        step = math.ceil(len(results.frames) / MAX_FRAMES)
        notes.append(f"Every {_ordinal(step)} of {len(results.frames)} frames is shown; tables and plots use all.")
    if width > MAX_WIDTH:
        notes.append(f"Pictures are scaled down from {width} to {MAX_WIDTH} pixels wide; figures are measured before.")
    if not lossless:
        notes.append(
            f"Pictures and error maps are embedded as WebP, quality {WEBP_QUALITY}; exact ones lie beside this page."
        )
    if results.reference and no_error:
        shown = ", ".join(no_error[:3]) + (", …" if len(no_error) > 3 else "")
        notes.append(f"{len(no_error)} error maps are missing, for want of an EXR file: {shown}.")
    gradient, ticks = (_gradient(), scale_ticks(scale)) if scale else ([], [])
    return Pictures(frames, sources, width, height, scale, gradient, ticks, notes)


def thinned(frames: tuple[int, ...]) -> list[int]:
    """At most `MAX_FRAMES` of the frames: every k-th from the first on."""
    return list(frames[:: math.ceil(len(frames) / MAX_FRAMES)])


def error_scale(errors: list[np.ndarray]) -> float | None:
    """A round number that at most 0.5 % of the errors exceed, in [0.1, 200].

    Args:
        errors: Error maps on the 0-255 scale.
    Returns:
        1, 2 or 5 times a power of ten, at most 200; None without any map.
    """
    if not errors:
        return None
    top = max(float(np.percentile(error, SCALE_PERCENTILE)) for error in errors)
    steps = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
    return next((step for step in steps if top <= step), steps[-1])


def scale_ticks(scale: float) -> list[tuple[float, str]]:
    """Labels of the error scale.

    Args:
        scale: Error at the end of the scale.
    Returns:
        (percent of the scale's length, error).
    """
    shares = (0.0, 0.01, 0.1, 0.5, 1.0)
    return [(100 * math.sqrt(share), f"{'≥ ' if share == 1 else ''}{scale * share:g}") for share in shares]


def _radiance(path: Path) -> np.ndarray:
    """[h w 3] float32 linear RGB of a plain EXR file."""
    try:
        channels = read_exr(path)
        return np.stack([channels[name] for name in "RGB"], -1)
    except OSError as error:
        raise ValueError(str(error)) from error
    except KeyError as error:
        raise ValueError(f"{path}: expected channels R, G and B, the file has none named {error}") from error


def _exposure(results: Results) -> float:
    """Stops from the job's [outputs]."""
    outputs = results.job.get("outputs", {})
    if not isinstance(outputs, dict):
        raise ValueError(f"{results.folder / 'job.toml'}: outputs: expected a table, got {outputs!r}")
    value = outputs.get("exposure", 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{results.folder / 'job.toml'}: outputs.exposure: expected a number of stops, got {value!r}")
    return float(value)


def _picture(results: Results, name: str, frame: int, exposure: float) -> Image.Image | None:
    """The frame's PNG or, where the job wrote none, its EXR tone-mapped the same way; None if it has neither."""
    png, exr = results.picture(name, frame), results.radiance(name, frame)
    if png.is_file():
        try:
            with Image.open(png) as image:
                return image.convert("RGB")
        except (OSError, SyntaxError, Image.DecompressionBombError) as error:
            raise ValueError(f"{png}: not a readable PNG: {error}") from error
    if exr.is_file():
        import jax.numpy as jnp

        from jaxrefl.composite import tone_map

        coded = tone_map(jnp.asarray(_radiance(exr)), exposure=exposure)
        return Image.fromarray(np.asarray(np.rint(255 * np.asarray(coded)), np.uint8))
    return None


def _first_size(results: Results, names: list[str], frames: list[int], exposure: float) -> tuple[int, int]:
    """Width and height of the first picture there is."""
    for frame in frames:
        for name in names:
            picture = _picture(results, name, frame, exposure)
            if picture is not None:
                return picture.size
    raise ValueError(f"{results.folder}: expected at least one picture of the frames in metrics.json, found none")


def _error_map(results: Results, name: str, frame: int, exposure: float) -> np.ndarray | None:
    """[h w] float32 error of a frame on the 0-255 scale; None if it or its reference has no EXR file."""
    exr, reference = results.radiance(name, frame), results.radiance(REFERENCE, frame)
    if not (exr.is_file() and reference.is_file()):
        return None
    try:
        return error_map255(_radiance(exr), _radiance(reference), exposure=exposure)
    except ValueError as error:
        raise ValueError(f"{exr}, against {reference}: {error}") from error


def _shrunk(picture: Image.Image) -> Image.Image:
    if picture.width <= MAX_WIDTH:
        return picture
    height = max(1, round(picture.height * MAX_WIDTH / picture.width))
    return picture.resize((MAX_WIDTH, height), Image.Resampling.LANCZOS)


def _coloured(error: np.ndarray, scale: float) -> Image.Image:
    """The error map in colours; scaled down by averaging errors, not colours."""
    import matplotlib

    image = Image.fromarray(error)
    if image.width > MAX_WIDTH:
        height = max(1, round(image.height * MAX_WIDTH / image.width))
        image = image.resize((MAX_WIDTH, height), Image.Resampling.BOX)
    rgba = matplotlib.colormaps[COLOUR_MAP](np.sqrt(np.clip(np.asarray(image) / scale, 0, 1)), bytes=True)
    return Image.fromarray(np.ascontiguousarray(rgba[..., :3]))


def _gradient() -> list[str]:
    import matplotlib
    from matplotlib.colors import to_hex

    return [to_hex(matplotlib.colormaps[COLOUR_MAP](x)) for x in np.linspace(0, 1, 17)]


def _uri(picture: Image.Image, lossless: bool) -> str:
    buffer = io.BytesIO()
    if lossless:
        picture.save(buffer, "PNG", optimize=True)
    else:
        picture.save(buffer, "WEBP", quality=WEBP_QUALITY, method=2)
    kind = "png" if lossless else "webp"
    return f"data:image/{kind};base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def _ordinal(number: int) -> str:
    suffix = {1: "st", 2: "nd", 3: "rd"}.get(number % 10 if number % 100 not in (11, 12, 13) else 0, "th")
    return f"{number}{suffix}"
