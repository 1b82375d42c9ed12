"""Reflection reprojection in NumPy float64, from the paper: slow and obvious. Loops over pixels, nothing shared.

[XWD17] §3.2 with two corrections: line 3 of Algorithm 2 back-projects the primary depth, and "reflected position" is
the surface point plus the mirror direction times the reflected distance.
"""

import numpy as np

RING = ((-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1))
FOUND, SILHOUETTE, OUTSIDE, STEPS = "found", "silhouette", "outside", "steps"


def distance(eye, reflected, w, p, n):
    """Distance from the eye to the line through a surface point and the mirror image of the reflected point."""
    offset = reflected - w * p
    mirrored = offset - 2 * (offset @ n) * n
    length = np.linalg.norm(mirrored)
    if length == 0:
        return np.linalg.norm(eye - p)
    return np.linalg.norm(np.cross(eye - p, mirrored / length))


def is_silhouette(x, y, owner, t, epsilon):
    """Beside another object, the border, or a jump of 1 / depth."""
    h, w = owner.shape
    if x in (0, w - 1) or y in (0, h - 1):
        return True
    for dx, dy in ((1, 0), (0, 1)):
        if owner[y - dy, x - dx] != owner[y, x] or owner[y + dy, x + dx] != owner[y, x]:
            return True
        bend = 1 / t[y - dy, x - dx] - 2 / t[y, x] + 1 / t[y + dy, x + dx]
        if abs(bend) > epsilon / t[y, x]:
            return True
    return False


def match(x, y, start, eye, buffer, steps, epsilon):
    """Algorithm 2 for one pixel: offset, and how the search ended.

    `buffer` is a dictionary of arrays: p [h w 3], n [h w 3], reflected [h w 4], owner [h w] (-1: none), t [h w].
    """
    p, n, owner, t = buffer["p"], buffer["n"], buffer["owner"], buffer["t"]
    h, w = owner.shape
    point, kind, own = buffer["reflected"][y, x, :3], buffer["reflected"][y, x, 3], owner[y, x]

    def d(i, j):
        if not (0 <= i < w and 0 <= j < h) or owner[j, i] != own:
            return np.inf
        return distance(eye, point, kind, p[j, i], n[j, i])

    cx, cy = x + start[0], y + start[1]
    former = d(cx, cy)
    ended = False
    for _ in range(steps):
        candidates = [(d(cx + dx, cy + dy), number) for number, (dx, dy) in enumerate(RING)]
        best, number = min(candidates)
        if not best <= former:
            ended = True
            break
        former, cx, cy = best, cx + RING[number][0], cy + RING[number][1]
    if cx <= 0 or cx >= w - 1 or cy <= 0 or cy >= h - 1:
        return (0, 0), OUTSIDE
    if not ended:
        return (0, 0), STEPS
    if is_silhouette(cx, cy, owner, t, epsilon):
        return (0, 0), SILHOUETTE
    return (cx - x, cy - y), FOUND


def draw(xy, depth, connected, owner, target, largest=16.0):
    """Grid mesh with a depth test: source coordinate per target pixel, NaN where nothing covers its centre."""
    h, w = depth.shape
    uv, nearest = np.full((*target.shape, 2), np.nan), np.full(target.shape, np.inf)
    for y in range(h - 1):
        for x in range(w - 1):
            if not connected[y, x]:
                continue
            for corners in (((x, y), (x + 1, y), (x, y + 1)), ((x + 1, y + 1), (x + 1, y), (x, y + 1))):
                a, b, c = (xy[j, i].astype(np.float64) for i, j in corners)
                matrix = np.stack([b - a, c - a], 1)
                area = np.linalg.det(matrix)
                if area == 0 or abs(area) > largest:
                    continue
                near = min(depth[j, i] for i, j in corners)
                low, high = np.min([a, b, c], 0), np.max([a, b, c], 0)
                for py in range(max(int(np.floor(low[1])) - 1, 0), min(int(np.ceil(high[1])) + 1, target.shape[0])):
                    for px in range(max(int(np.floor(low[0])) - 1, 0), min(int(np.ceil(high[0])) + 1, target.shape[1])):
                        s, r = np.linalg.solve(matrix, np.array([px + 0.5, py + 0.5]) - a)
                        if s < -1e-9 or r < -1e-9 or s + r > 1 + 1e-9 or target[py, px] != owner[y, x]:
                            continue
                        if near < nearest[py, px]:
                            nearest[py, px] = near
                            centres = [np.array([i + 0.5, j + 0.5]) for i, j in corners]
                            uv[py, px] = centres[0] + s * (centres[1] - centres[0]) + r * (centres[2] - centres[0])
    return uv


def bilinear(image, u, v):
    """Bilinear value at pixel coordinate (u, v), and the four pixels used; None outside."""
    x, y = u - 0.5, v - 0.5
    h, w = image.shape[:2]
    if not (0 <= x <= w - 1 and 0 <= y <= h - 1):
        return None
    i, j = min(int(x), w - 2), min(int(y), h - 2)
    fx, fy = x - i, y - j
    top = (1 - fx) * image[j, i] + fx * image[j, i + 1]
    bottom = (1 - fx) * image[j + 1, i] + fx * image[j + 1, i + 1]
    return (1 - fy) * top + fy * bottom


def seen_before(p, n, t, owner, camera, buffer, tolerance):
    """Depth warp of one point: key coordinate, or None where the key frame shows something else there.

    `camera` is (world_from_camera 4x4, focal, centre).
    """
    matrix, focal, centre = camera
    local = matrix[:3, :3].T @ (p - matrix[:3, 3])
    if local[2] >= 0:
        return None
    u, v = centre[0] + focal[0] * local[0] / -local[2], centre[1] - focal[1] * local[1] / -local[2]
    there = bilinear(buffer["p"], u, v)
    if there is None:
        return None
    h, w = buffer["owner"].shape
    i, j = min(int(u - 0.5), w - 2), min(int(v - 0.5), h - 2)
    if not (buffer["owner"][j : j + 2, i : i + 2] == owner).all():
        return None
    offset = there - p
    if abs(offset @ n) > tolerance * t or np.linalg.norm(offset) > 16 * tolerance * t:
        return None
    return u, v
