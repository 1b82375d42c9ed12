"""The gloss filter and the footprint of a GGX lobe in NumPy float64: slow and obvious, from the equations.

[RLPWSD20] §6, Eq. 4. One loop per pixel and per tap, nothing shared with the library.
"""

import numpy as np


def lobe(alpha, cosine, count=256):
    """Tangents (along, across) of the mirrored lobe relative to the line of sight, and weights, on a regular grid.

    The viewer looks along v; the reflected direction, mirrored at the surface, continues behind it. Coordinates are
    those on a plane across v at distance 1, where v itself is 0 and "along" points to the normal.
    """
    u, v = np.meshgrid((np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) / count, indexing="ij")
    sine = np.sqrt(1 - cosine**2)
    wo = np.array([sine, 0, cosine])
    stretched = np.array([alpha * sine, 0, cosine])
    stretched /= np.linalg.norm(stretched)
    # [DB23]: a uniform point on the cap, plus the stretched viewer, stretched back.
    z = 1 - u * (1 + stretched[2])
    r = np.sqrt(np.maximum(0, 1 - z**2))
    cap = np.stack([r * np.cos(2 * np.pi * v), r * np.sin(2 * np.pi * v), z], -1)
    h = (cap + stretched) * np.array([alpha, alpha, 1])
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    wi = 2 * (h @ wo)[..., None] * h - wo
    mirrored = wi * np.array([1, 1, -1])
    view, along, across = -wo, np.array([-cosine, 0, sine]), np.array([0, 1.0, 0])
    depth = mirrored @ view

    def g1(c):
        return 2 * c / (c + np.sqrt(c**2 + alpha**2 * (1 - c**2)))

    gi, go = g1(np.maximum(wi[..., 2], 1e-12)), g1(cosine)
    weight = np.where(wi[..., 2] > 0, gi / (go + gi - go * gi), 0)
    safe = np.where(depth > 1e-6, depth, 1e-6)
    tangents = np.stack([mirrored @ along, mirrored @ across], -1) / safe[..., None]
    return tangents.reshape(-1, 2), (weight / weight.sum()).reshape(-1)


def edge_profile(offsets, values, weights):
    """Share of the lobe below each offset: what a step edge there looks like."""
    order = np.argsort(values)
    total = np.concatenate([[0], np.cumsum(weights[order])])
    return total[np.searchsorted(values[order], offsets)]


def filtered(image, valid, confidence, ids, normals, depth, slope, gaussians, thresholds):
    """Eq. 4 pixel by pixel. `gaussians[y][x]` is a list of (weight, mean (x, y), covariance 2x2)."""
    h, w = ids.shape
    out = np.zeros_like(image)
    ys, xs = np.mgrid[:h, :w]
    for y in range(h):
        for x in range(w):
            offset = np.stack([xs - x, ys - y], -1).astype(np.float64)
            expected = 1 / depth[y, x] + offset @ slope[y, x]
            same = ids == ids[y, x]
            same &= normals @ normals[y, x] > thresholds[0]
            same &= np.abs(1 / depth - expected) * depth[y, x] < thresholds[1]
            total = np.zeros(image.shape[-1])
            for share, mean, covariance in gaussians[y][x]:
                d = offset - mean
                g = np.exp(-0.5 * np.einsum("yxi,ij,yxj->yx", d, np.linalg.inv(covariance), d))
                g = g * same * valid * confidence
                total += share * (g[..., None] * image).sum((0, 1)) / g.sum()
            out[y, x] = total
    return out
