"""Light maps on disk: LightMap <-> .npz, bound to the scene they were baked for by a fingerprint."""

import hashlib
import zipfile
from os import PathLike

import jax
import jax.numpy as jnp
import numpy as np

from jaxrefl._types import LightMap, Scene

_VERSION = 1


class StaleLightMap(ValueError):
    """A light map that was baked for another scene, or for this one before it was changed."""


def scene_fingerprint(scene: Scene) -> str:
    """Digest of everything that a light map depends on.

    Args:
        scene: The scene; its cameras and names do not count.
    Returns:
        SHA-256 over geometry, materials, textures and lights, hexadecimal.
    """
    digest = hashlib.sha256()
    parts = {"mesh": scene.mesh, "materials": scene.materials, "textures": scene.textures, "lights": scene.lights}
    for path, leaf in jax.tree_util.tree_leaves_with_path(parts):
        array = np.ascontiguousarray(leaf)
        digest.update(f"{jax.tree_util.keystr(path)} {array.dtype} {array.shape}\n".encode())
        digest.update(array.data if array.size else b"")
    return digest.hexdigest()


def save_lightmap(lightmap: LightMap, path: str | PathLike[str]) -> None:
    """Write a light map.

    Args:
        lightmap: Any light map.
        path: File to write; `.npz` by custom.
    Returns:
        Nothing.
    Raises:
        OSError: If it cannot be written.
    """
    with open(path, "wb") as stream:
        np.savez_compressed(
            stream,
            version=np.int32(_VERSION),
            light=np.asarray(lightmap.light),
            uv=np.asarray(lightmap.uv),
            fingerprint=np.array(lightmap.fingerprint),
            options=np.array(lightmap.options),
        )


def load_lightmap(path: str | PathLike[str], scene: Scene) -> LightMap:
    """Read a light map.

    Args:
        path: From `save_lightmap`.
        scene: The scene it was baked for.
    Returns:
        The map.
    Raises:
        StaleLightMap: If it was baked for another scene, or for this one before it was changed.
        ValueError: If the file is no light map.
        OSError: If it cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            version = int(stored["version"])
            light, uv = stored["light"], stored["uv"]
            fingerprint, options = str(stored["fingerprint"]), str(stored["options"])
    except (ValueError, KeyError, zipfile.BadZipFile, EOFError) as error:
        raise ValueError(f"{path}: expected a light map written by `save_lightmap`: {error}") from error
    if version != _VERSION:
        raise ValueError(f"{path}: expected a light map of version {_VERSION}, got {version}")
    own = scene_fingerprint(scene)
    if fingerprint != own:
        raise StaleLightMap(
            f"{path}: was baked for a scene with other geometry, materials or lights than {scene.names.scene!r} has "
            f"(expected {own[:12]}, got {fingerprint[:12]}); bake it again"
        )
    if light.ndim != 4 or light.shape[-1] != 3 or uv.shape != (scene.mesh.faces.shape[0], 3, 2):
        raise ValueError(f"{path}: expected [s h w 3] light and [f 3 2] places, got {light.shape} and {uv.shape}")
    return LightMap(jnp.asarray(light, jnp.float32), jnp.asarray(uv, jnp.float32), fingerprint, options)
