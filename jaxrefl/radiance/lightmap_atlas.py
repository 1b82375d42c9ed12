"""Where the surfaces of a scene lie in a texture: Mesh -> charts by xatlas -> the points that each texel stands for.

Charts never mix objects: each object is a mesh of its own for xatlas. They are packed at one density, so that a texel
stands for the same area everywhere, whatever the unit of the scene. A texel stands for the part of itself that its
chart covers, sampled on a grid of `GRID` by `GRID` places: at the border of a chart it does not see beyond the edge.

Source: [Young] J. Young, xatlas, after [LPRM02] Lévy et al., "Least squares conformal maps", SIGGRAPH 2002.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrefl._types import Scene

GRID = 4
"""Places per texel and axis at which charts are sampled."""
GUTTER = 2
"""Texels between charts."""


class Atlas(NamedTuple):
    """Charts in a texture."""

    uv: Float[np.ndarray, "f 3 2"]
    """Corners of each triangle in texels; 0 for triangles that have no place."""
    width: int
    """Texels across."""
    height: int
    """Texels down."""
    placed: Bool[np.ndarray, "f"]
    """Triangles that have a place."""
    density: float
    """Texels per world unit."""


class Places(NamedTuple):
    """The covered texels and what covers them."""

    texel: Int[np.ndarray, "n"]
    """Flat index of each covered texel, rising."""
    triangle: Int[np.ndarray, "n k"]
    """Triangle at each of its places, a permutation that spreads them; texels covered in part repeat what they have."""
    place: Int[np.ndarray, "n k"]
    """Number of the place in the texel's grid, row by row."""


def has_diffuse(scene: Scene) -> Bool[np.ndarray, "m"]:
    """Which materials scatter light diffusely.

    Args:
        scene: The scene.
    Returns:
        True for all but pure metals, pure glass and what has no colour.
    """
    table = scene.materials
    textured = np.asarray(table.metallic_roughness_texture) >= 0
    metal = (np.asarray(table.metallic) >= 1) & ~textured
    glass = np.asarray(table.transmission) >= 1
    black = np.asarray(table.base_colour).max(-1) <= 0
    return ~metal & ~glass & ~black


def make_atlas(scene: Scene, texels: int) -> Atlas:
    """Charts for all surfaces with a diffuse component.

    Args:
        scene: The scene.
        texels: How many texels the surfaces cover together, about; the texture is larger by its gutters.
    Returns:
        The atlas.
    Edge cases: a scene without diffuse surfaces gets a texture of one texel; triangles that are smaller than a
        millionth of a texel have no place.
    """
    import xatlas

    vertices, faces = np.asarray(scene.mesh.vertices, np.float64), np.asarray(scene.mesh.faces)
    owner = np.asarray(scene.mesh.object)
    wanted = has_diffuse(scene)[np.asarray(scene.mesh.material)]
    uv = np.zeros((len(faces), 3, 2), np.float32)
    if not wanted.any():
        return Atlas(uv, 1, 1, wanted, 0.0)
    corners = vertices[faces[wanted]]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1).sum()
    density = float(np.sqrt(texels / area))
    # xatlas drops triangles below an absolute area: it gets the scene in units of a texel, about its middle.
    scaled = ((vertices - vertices.mean(0)) * density).astype(np.float32)

    atlas, members = xatlas.Atlas(), []
    for number in np.unique(owner[wanted]):
        rows = np.flatnonzero(wanted & (owner == number))
        used, index = np.unique(faces[rows], return_inverse=True)
        atlas.add_mesh(scaled[used], index.reshape(-1, 3).astype(np.uint32))
        members.append(rows)
    packing = xatlas.PackOptions()
    packing.texels_per_unit, packing.padding, packing.bilinear, packing.blockAlign = 1.0, GUTTER, True, True
    atlas.generate(xatlas.ChartOptions(), packing)
    width, height = int(atlas.width), int(atlas.height)
    for number, rows in enumerate(members):
        _, index, place = atlas[number]
        uv[rows] = place[index] * np.array([width, height], np.float32)
    edges = uv[:, 1:] - uv[:, :1]
    placed = wanted & (np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) > 2e-6)
    uv[~placed] = 0
    return Atlas(uv, width, height, placed, density)


def places_of(atlas: Atlas) -> Places:
    """The covered texels of an atlas.

    Args:
        atlas: From `make_atlas`.
    Returns:
        Texels and their places; empty if no triangle has a place.
    Edge cases: triangles that lie between all places cover nothing, and read what their neighbours in the chart give.
    """
    grid = _rasterise(atlas)
    k = GRID * GRID
    tiles = grid.reshape(atlas.height, GRID, atlas.width, GRID).transpose(0, 2, 1, 3).reshape(-1, k)
    texel = np.flatnonzero((tiles >= 0).any(-1))
    tiles = tiles[texel][:, _SPREAD]
    # Covered places first, in the order that spreads them; then the same ones again, round and round.
    order = np.argsort(tiles < 0, axis=-1, kind="stable")
    count = (tiles >= 0).sum(-1, keepdims=True)
    order = np.take_along_axis(order, np.arange(k)[None] % np.maximum(count, 1), axis=-1)
    return Places(texel, np.take_along_axis(tiles, order, axis=-1), _SPREAD[order])


_SPREAD = np.array([1, 14, 4, 11, 2, 13, 7, 8, 0, 15, 6, 9, 3, 12, 5, 10])
"""Order of a 4 by 4 grid in which each two lie opposite each other, and each four in rows and columns of their own."""


def _rasterise(atlas: Atlas) -> Int[np.ndarray, "gh gw"]:
    """Triangle at the middle of each place of the finer grid, -1 for none, row by row of each triangle."""
    gw, gh = atlas.width * GRID, atlas.height * GRID
    grid = np.full(gh * gw, -1, np.int32)
    rows = np.flatnonzero(atlas.placed)
    corners = atlas.uv[rows].astype(np.float64) * GRID
    first = np.clip(np.ceil(corners[..., 1].min(1) - 0.5), 0, gh).astype(np.int64)
    last = np.clip(np.floor(corners[..., 1].max(1) - 0.5), -1, gh - 1).astype(np.int64)
    for part in _chunks(np.maximum(last - first + 1, 0)):
        spans = np.maximum(last[part] - first[part] + 1, 0)
        which = np.repeat(part, spans)
        y = first[which] + _count_up(spans)
        low, high = _crossings(corners[which], y + 0.5)
        start = np.clip(np.ceil(low - 0.5), 0, gw).astype(np.int64)
        lengths = np.maximum(np.clip(np.floor(high - 0.5), -1, gw - 1).astype(np.int64) - start + 1, 0)
        for line in _chunks(lengths):
            number = np.repeat(line, lengths[line])
            x = start[number] + _count_up(lengths[line])
            grid[y[number] * gw + x] = rows[which[number]]
    return grid.reshape(gh, gw)


def _crossings(corners: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a horizontal line enters and leaves triangles."""
    low, high = np.full(len(y), np.inf), np.full(len(y), -np.inf)
    for i in range(3):
        a, b = corners[:, i], corners[:, (i + 1) % 3]
        rise = b[:, 1] - a[:, 1]
        share = (y - a[:, 1]) / np.where(rise == 0, 1, rise)
        crosses = (rise != 0) & (share >= 0) & (share <= 1)
        x = a[:, 0] + share * (b[:, 0] - a[:, 0])
        low = np.where(crosses, np.minimum(low, x), low)
        high = np.where(crosses, np.maximum(high, x), high)
    # Lines that miss the triangle by a rounding have no crossing at all.
    return np.where(np.isfinite(low), low, 1.0), np.where(np.isfinite(high), high, 0.0)


def _chunks(sizes: np.ndarray, most: int = 2**20):
    """Consecutive indices, in groups whose sizes add up to about `most`, so that memory stays bounded."""
    ends = np.cumsum(sizes)
    edges = np.searchsorted(ends, np.arange(most, ends[-1] + most, most)) + 1 if len(ends) else np.array([], int)
    start = 0
    for end in np.minimum(edges, len(sizes)):
        if end > start:
            yield np.arange(start, end)
        start = max(start, int(end))


def _count_up(sizes: np.ndarray) -> np.ndarray:
    """0 to size - 1 for each size, one after another."""
    return np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
