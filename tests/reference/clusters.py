"""Second-order feed-forward rendering in NumPy float64, from the paper: slow and obvious.

[WXKP14] §3.2 to §3.4. The formula of the eye is derived again; see `displacement`.
"""

import numpy as np


def spherical_bin(n, around, down):
    """Column and row of a normal's bin: azimuth of 360 degrees, polar angle of 180 degrees from +y."""
    azimuth = np.degrees(np.arctan2(n[2], n[0])) % 360
    polar = np.degrees(np.arccos(np.clip(n[1], -1, 1)))
    return min(int(around * azimuth / 360), around - 1), min(int(down * polar / 180), down - 1)


def displacement(near, spread, reach):
    """Distance behind the image plane of an eye that sees `spread`, at `reach` beyond the plane, as wide as `near`.

    Similar triangles: near / h = spread / (h + reach).
    """
    return near * reach / (spread - near)


def intersect(image, eye, origin, direction, length, *, low, pitch, steps):
    """First crossing of a ray with a depth image of planes, by very small steps.

    The view looks along +z with x to the right and y down. `image` [h w 3] holds 1 / z at texel centres and its change
    per texel along x and y. Returns the distance along the ray, or None where it is never seen to go from before a
    texel's plane to behind it within that texel.
    """
    h, w, _ = image.shape
    before = None
    for t in np.linspace(0, length, steps):
        x, y, z = origin + t * direction - eye
        u, v = (x / z - low[0]) / pitch[0], (y / z - low[1]) / pitch[1]
        column, row = int(np.clip(np.floor(u), 0, w - 1)), int(np.clip(np.floor(v), 0, h - 1))
        level, gx, gy = image[row, column]
        ahead = 1 / z - (level + gx * (u - column - 0.5) + gy * (v - row - 0.5))
        if before is not None and before[0] > 0 >= ahead and before[1] == (column, row):
            return t
        before = ahead, (column, row)
    return None
