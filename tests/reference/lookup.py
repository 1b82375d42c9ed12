"""Slow float64 lookups in texture images and latitude-longitude maps, one value at a time, from the definitions."""

import math

import numpy as np


def srgb_decoded(byte: int) -> float:
    """Linear value of an sRGB-coded byte (IEC 61966-2-1)."""
    s = byte / 255
    return s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4


def texture(rgba: np.ndarray, u: float, v: float, *, srgb: bool, repeat: tuple[bool, bool]) -> np.ndarray:
    """Bilinear RGBA of an 8-bit image; texel (i, j) has its centre at ((i + 0.5) / width, (j + 0.5) / height)."""
    height, width, _ = rgba.shape
    x, y = u * width - 0.5, v * height - 0.5
    total = np.zeros(4)
    for j in (math.floor(y), math.floor(y) + 1):
        for i in (math.floor(x), math.floor(x) + 1):
            weight = (1 - abs(x - i)) * (1 - abs(y - j))
            column = i % width if repeat[0] else min(max(i, 0), width - 1)
            row = j % height if repeat[1] else min(max(j, 0), height - 1)
            texel = rgba[row, column]
            colour = [srgb_decoded(int(b)) if srgb else b / 255 for b in texel[:3]]
            total += weight * np.array([*colour, texel[3] / 255])
    return total


def latlong(radiance: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Bilinear radiance from directions [n 3] in map space: row 0 is +Y, the middle column -Z, u = 0.75 is +X."""
    height, width, _ = radiance.shape
    result = []
    for x, y, z in np.asarray(direction, np.float64):
        right = (0.5 + math.atan2(x, -z) / (2 * math.pi)) * width - 0.5
        down = min(max(math.acos(min(max(y, -1), 1)) / math.pi * height - 0.5, 0), height - 1)
        i, j = math.floor(right), min(math.floor(down), max(height - 2, 0))
        fx, fy = right - i, down - j
        below = min(j + 1, height - 1)
        upper = (1 - fx) * radiance[j, i % width] + fx * radiance[j, (i + 1) % width]
        lower = (1 - fx) * radiance[below, i % width] + fx * radiance[below, (i + 1) % width]
        result.append((1 - fy) * upper + fy * lower)
    return np.array(result)


def sphere(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions [rows*columns 3] at the centres of cells of equal azimuth and polar angle, and their solid angles."""
    edges = np.pi * np.arange(rows + 1) / rows
    polar, azimuth = (edges[:-1] + edges[1:]) / 2, 2 * np.pi * ((np.arange(columns) + 0.5) / columns - 0.5)
    polar, azimuth = np.meshgrid(polar, azimuth, indexing="ij")
    d = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], -1)
    solid_angle = np.broadcast_to((2 * np.pi / columns * -np.diff(np.cos(edges)))[:, None], polar.shape)
    return d.reshape(-1, 3), solid_angle.reshape(-1)
