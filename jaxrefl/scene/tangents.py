"""Tangents for normal maps, from texture coordinates.

Input and output are NumPy arrays; the convention is glTF's: `bitangent = sign * cross(normal, tangent)`.
"""

import numpy as np

from jaxrefl.scene.normals import normalised


def vertex_tangents(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Unit tangents along growing u, one per vertex, split where the texture is mirrored.

    $$ T = \frac{\partial p}{\partial u}
         = \frac{e_1\, \Delta v_2 - e_2\, \Delta v_1}{\Delta u_1 \Delta v_2 - \Delta u_2 \Delta v_1} $$

    summed over a vertex's triangles weighted by their area in the texture, then made orthogonal to the normal.

    Args:
        vertices: [v 3] positions.
        faces: [f 3] indices.
        normals: [v 3] unit shading normals.
        uv: [v 2] texture coordinates, (0, 0) at the top left of the image.
    Returns:
        New faces [f 3], the source vertex [w] of each new vertex, and the tangents [w 4] with handedness +1 or -1.
    Edge cases: where the texture coordinates span no area the tangent is any unit vector orthogonal to the normal.
    Source: glTF 2.0 specification §3.7.2.1 for the convention (with v downwards, hence the sign of the handedness).
    """
    p, q = vertices[faces].astype(np.float64), uv[faces].astype(np.float64)
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    (u1, v1), (u2, v2) = (q[:, 1] - q[:, 0]).T, (q[:, 2] - q[:, 0]).T
    determinant = u1 * v2 - u2 * v1
    along_u = (e1 * v2[:, None] - e2 * v1[:, None]) * np.sign(determinant)[:, None]
    # v grows downwards in glTF's image convention and the bitangent points to growing green, upwards in the image
    sign = np.where(determinant <= 0, 1, -1)
    key = (faces * 2 + (sign[:, None] > 0)).reshape(-1)
    unique, inverse = np.unique(key, return_inverse=True)
    source, handedness = unique // 2, np.where(unique % 2 > 0, 1.0, -1.0)
    sums = np.stack([np.bincount(inverse, np.repeat(along_u[:, i], 3), minlength=len(unique)) for i in range(3)], 1)
    n = normals[source]
    tangent = sums - n * (n * sums).sum(1, keepdims=True)
    degenerate = np.linalg.norm(tangent, axis=1) <= 1e-6 * np.linalg.norm(sums, axis=1)
    tangent = np.where(degenerate[:, None], any_orthogonal(n), normalised(tangent))
    return inverse.reshape(-1, 3), source, np.concatenate([tangent, handedness[:, None]], 1)


def any_orthogonal(n: np.ndarray) -> np.ndarray:
    """A unit vector at a right angle to each of the given ones.

    Args:
        n: [k 3] unit vectors.
    Returns:
        [k 3] unit vectors.
    """
    axis = np.eye(3)[np.abs(n).argmin(1)]
    return normalised(np.cross(n, axis))
