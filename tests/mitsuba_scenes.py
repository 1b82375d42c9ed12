"""Small Mitsuba scene files for tests, and what Mitsuba itself says about them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as PillowImage

CAMERA = """<sensor type="perspective" id="eye"><float name="fov" value="{fov}"/>{more}
<transform name="to_world"><lookat origin="{origin}" target="{target}" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="{width}"/><integer name="height" value="{height}"/>{film}</film>
</sensor>"""


def mitsuba() -> Any:
    """The module, in the variant that the reader uses; skips the test without it."""
    mi = pytest.importorskip("mitsuba", reason="mitsuba is not installed: pip install 'jaxrefl[mitsuba]'")
    mi.set_variant("scalar_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    return mi


def camera(
    *, origin: str = "0, 0, 4", target: str = "0, 0, 0", size=(24, 16), fov: float = 45, more: str = "", film: str = ""
) -> str:
    """A `<sensor>`."""
    width, height = size
    return CAMERA.format(origin=origin, target=target, width=width, height=height, fov=fov, more=more, film=film)


def write_scene(folder: Path, *content: str, version: str = "3.0.0") -> Path:
    """A scene file."""
    folder.mkdir(exist_ok=True)
    path = folder / "room.xml"
    path.write_text(f'<scene version="{version}">\n' + "\n".join(content) + "\n</scene>\n")
    return path


def write_png(path: Path, values: Any) -> Path:
    """An 8-bit image: [h w], [h w 3] or [h w 4]."""
    PillowImage.fromarray(np.asarray(values, np.uint8)).save(path)
    return path


def rays_of(mi: Any, sensor: Any, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions [h w 3] of Mitsuba's rays through the pixel centres."""
    width, height = size
    origins, directions = np.zeros((2, height, width, 3))
    for y in range(height):
        for x in range(width):
            ray, _ = sensor.sample_ray(0, 0.5, [(x + 0.5) / width, (y + 0.5) / height], [0.5, 0.5])
            directions[y, x] = np.asarray(ray.d)
            # Mitsuba starts at the near plane; the eye lies behind it on the ray.
            origins[y, x] = np.asarray(ray.o)
    return origins, directions


def seen_by_mitsuba(mi: Any, path: Path, size: tuple[int, int]) -> dict[str, np.ndarray]:
    """What Mitsuba hits at each pixel centre of the first sensor: valid, p, front, albedo, emission."""
    scene = mi.load_file(str(path))
    sensor = scene.sensors()[0]
    origins, directions = rays_of(mi, sensor, size)
    shape = origins.shape[:2]
    found = {"valid": np.zeros(shape, bool), "front": np.zeros(shape, bool)}
    found |= {name: np.zeros((*shape, 3)) for name in ("p", "ns", "albedo", "emission")}
    for index in np.ndindex(*shape):
        ray = mi.Ray3f(origins[index].tolist(), directions[index].tolist())
        si = scene.ray_intersect(ray)
        found["valid"][index] = si.is_valid()
        if not si.is_valid():
            continue
        found["p"][index] = np.asarray(si.p)
        found["ns"][index] = np.asarray(si.sh_frame.n)
        found["front"][index] = si.wi.z > 0
        found["albedo"][index] = np.asarray(si.bsdf(mi.RayDifferential3f(ray)).eval_diffuse_reflectance(si))
        if si.shape.is_emitter():
            found["emission"][index] = np.asarray(si.shape.emitter().eval(si))
    return found
