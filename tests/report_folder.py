"""A small results folder as the runner writes it, for the tests of the report."""

import json
import math
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

from jaxrefl.metrics import compare

JOB = """\
frames = {frames}
size = [{width}, {height}]
seed = 0
techniques = ["raytrace", "envmap"]

[scene]
source = "cornell"

[outputs]
exposure = {exposure}
"""


def write_results(
    folder: Path,
    *,
    frames: int = 4,
    size: tuple[int, int] = (64, 36),
    scene: str = 'mirror <box> & "glass"',
    techniques: tuple[str, ...] = ("raytrace", "envmap"),
    reference: bool = True,
    exposure: float = 0.0,
) -> Path:
    """Write frames of a moving sphere over a floor, an accurate and a blurred technique, and their rows."""
    width, height = size
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "job.toml").write_text(JOB.format(frames=frames, width=width, height=height, exposure=exposure))
    stamp = {
        "versions": {"jaxrefl": "0.1.0", "jax": "0.10.2", "embreex": "4.4.0"},
        "seed": 0,
        "command": f"jaxrefl compare '{scene}' --frames {frames}",
        "hardware": {"cpu": "2 cores", "memory_gib": 8},
    }
    rng = np.random.default_rng(1)
    rows = []
    for frame in range(frames):
        exact, mask = _picture(width, height, frame / max(1, frames))
        if reference:
            write_frame(folder / "reference", frame, exact, exposure)
        for index, technique in enumerate(techniques):
            noise = rng.normal(0, 0.01 + 0.05 * index, exact.shape) * mask[..., None]
            shift = np.roll(exact, 2 * index, axis=1) if index else exact
            image = np.where(mask[..., None], np.maximum(0, shift + noise), exact).astype(np.float32)
            write_frame(folder / technique, frame, image, exposure)
            for name, over in (("reflective", mask), ("frame", np.ones_like(mask))):
                figures = compare(image, exact, over, exposure=exposure) if reference else {}
                seconds = 0.12 / (1 + 3 * index) + 0.01 * math.sin(frame)
                rows.append(
                    {
                        "scene": scene,
                        "technique": technique,
                        "frame": frame,
                        "mask": name,
                        **{k: figures.get(k) for k in ("mae255", "rmse", "relmse", "psnr", "dssim")},
                        "seconds": seconds,
                        "compile_seconds": 2.5 if frame == 0 else 0.0,
                        "init_seconds": 0.5 * index,
                        "shared": {"diffuse": 0.03, "composite": 0.01},
                        "stages": {"surface": 0.2 * seconds, "rays": 0.5 * seconds, "shade": 0.28 * seconds},
                        "rays": width * height * (2 - index),
                        "peak_mib": 310.0 + index,
                        "reflective_share": float(mask.mean()),
                        "info": {"overflow": 0, "layers": {"used": 3 + index}},
                        "stamp": stamp,
                    }
                )
    (folder / "metrics.json").write_text(json.dumps(rows, allow_nan=False))
    return folder


def write_frame(folder: Path, frame: int, image: np.ndarray, exposure: float) -> None:
    """PNG and plain EXR of a linear image."""
    folder.mkdir(exist_ok=True)
    clipped = np.clip(image * 2.0**exposure, 0, 1)
    coded = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    Image.fromarray(np.rint(255 * coded).astype(np.uint8)).save(folder / f"frame_{frame:04d}.png")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": np.ascontiguousarray(image, np.float32)}) as file:
        file.write(str(folder / f"frame_{frame:04d}.exr"))


def _picture(width: int, height: int, phase: float) -> tuple[np.ndarray, np.ndarray]:
    """Linear image [h w 3] and the mask of its reflective sphere."""
    y, x = np.mgrid[0:height, 0:width]
    u, v = (x + 0.5) / height, (y + 0.5) / height
    floor = np.where((np.floor(8 * u + 4 * phase) + np.floor(8 * v)) % 2, 0.65, 0.2) * (v > 0.5)
    sky = (0.35 + 0.5 * (0.5 - v)) * (v <= 0.5)
    image = np.stack([floor + 0.6 * sky, floor * 0.9 + 0.8 * sky, floor * 0.75 + 1.1 * sky], -1)
    dx, dy = u - width / height * (0.35 + 0.3 * phase), v - 0.55
    mask = dx**2 + dy**2 < 0.33**2
    bent = 0.5 + 0.5 * np.sin(18 * dx / (0.45 - np.hypot(dx, dy)).clip(0.08)) * np.cos(9 * dy)
    image = np.where(mask[..., None], np.stack([0.9 * bent, 0.85 * bent, 0.7 * bent + 0.1], -1), image)
    return image.astype(np.float32), mask
