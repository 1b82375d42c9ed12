"""The light map of a job: baked once, kept in a file, used again as long as scene and knobs are the same.

A job needs one if the diffuse light of the image or of what is seen in reflections is to be `baked`.
"""

import dataclasses
import json
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jaxrefl._types import LightMap, Scene, Tracer
from jaxrefl.radiance import LightMapOptions, LightOptions, StaleLightMap, bake, load_lightmap, save_lightmap
from pipelines.job import Job

NAME = "lightmap.npz"
"""File in the results folder."""
_STEPS = 10


def wants_lightmap(job: Job) -> bool:
    """Whether a job needs a light map.

    Args:
        job: Any job.
    Returns:
        True if one of its tables asks for baked light.
    """
    tables: list[Mapping[str, Any]] = [job.technique.get(name, {}) for name in job.techniques]
    if job.reference is not None:
        tables.append(job.reference.knobs)
    return job.light.get("model") == "baked" or any(table.get("light") == "baked" for table in tables)


def with_lightmap(
    scene: Scene, tracer: Tracer, options: LightOptions, folder: Path | None, say: Callable[[str], None]
) -> Scene:
    """The scene with its light map, from the file if that fits, and baked otherwise.

    Args:
        scene: The scene.
        tracer: Ray queries against it.
        options: How to bake, and the file.
        folder: Results folder; without a file in the options the map is kept there, if it exists.
        say: Told what is done.
    Returns:
        The scene with `lightmap`.
    Raises:
        ValueError: If the scene cannot have one, or the file is something else than a light map.
        OSError: If the file cannot be read or written.
    """
    path = Path(options.lightmap) if options.lightmap else None
    if path is None and folder is not None and folder.is_dir():
        path = folder / NAME
    if path is not None and path.exists():
        found = _fresh(path, scene, options.map, say)
        if found is not None:
            return dataclasses.replace(scene, lightmap=found)
    lightmap = baked(scene, tracer, options.map, say)
    if path is not None:
        write(lightmap, path)
        say(f"light map: written to {path}")
    return dataclasses.replace(scene, lightmap=lightmap)


def _fresh(path: Path, scene: Scene, options: LightMapOptions, say: Callable[[str], None]) -> LightMap | None:
    try:
        found = load_lightmap(path, scene)
    except StaleLightMap as error:
        say(f"light map: {error}")
        return None
    if json.loads(found.options) != dataclasses.asdict(options):
        say(f"light map: {path} was baked with other knobs; baked again")
        return None
    say(f"light map: read from {path}")
    return found


def baked(scene: Scene, tracer: Tracer, options: LightMapOptions, say: Callable[[str], None]) -> LightMap:
    """A new light map, with word of how far it is.

    Args:
        scene: The scene.
        tracer: Ray queries against it.
        options: How to bake.
        say: Told how far it is.
    Returns:
        The map.
    """
    began, last = time.monotonic(), [0]

    def progress(done: int, total: int) -> None:
        step = _STEPS * done // total
        if step > last[0]:
            last[0] = step
            say(f"light map: {100 * done // total} % of {total} paths, {time.monotonic() - began:.0f} s")

    say(f"light map: baking about {options.texels} texels with {options.samples} paths each and per side")
    lightmap = bake(scene, tracer, options=options, progress=progress)
    layers, height, width, _ = lightmap.light.shape
    say(f"light map: {layers} x {width} x {height} texels baked in {time.monotonic() - began:.1f} s")
    return lightmap


def write(lightmap: LightMap, path: Path) -> None:
    """Write a light map so that there is never half a file.

    Args:
        lightmap: The map.
        path: File.
    Raises:
        OSError: If it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        save_lightmap(lightmap, part)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
