"""Texture images of the built-in scenes, computed instead of loaded.

numbers -> `Image` (8-bit sRGB, repeating). Colours are given linear, as everywhere, and coded here. Plain patterns with
sharp edges: errors of a reflection show on them, and they need no random numbers.
"""

import numpy as np
from jaxtyping import Float

from jaxrefl.scene.description import Image
from scenes._check import Real

Colour = tuple[Real, Real, Real]


def checker(name: str, first: Colour, second: Colour, *, tiles: int = 2, texels: int = 128, joint: Real = 0.0) -> Image:
    """Squares in two colours.

    Args:
        name: Image name.
        first: Linear colour of the square at the top left.
        second: Linear colour of the others.
        tiles: Squares along each side, even so that the pattern repeats.
        texels: Texels along each side.
        joint: Width of the dark joint between squares, as a share of a square, in [0, 1).
    Returns:
        The image.
    """
    at = (np.arange(texels) + 0.5) / texels * tiles
    odd = (np.floor(at)[:, None] + np.floor(at)[None, :]) % 2 == 1
    colour = np.where(odd[..., None], np.asarray(second), np.asarray(first))
    to_edge = 0.5 - np.abs(at % 1 - 0.5)
    in_joint = np.minimum(to_edge[:, None], to_edge[None, :]) < joint / 2
    return _image(name, np.where(in_joint[..., None], 0.35 * colour, colour))


def stripes(name: str, colours: tuple[Colour, ...], *, texels: int = 128) -> Image:
    """Upright stripes of one width, from left to right.

    Args:
        name: Image name.
        colours: Linear colours, at least one.
        texels: Width of the image in texels.
    Returns:
        The image, `texels` wide and 2 high.
    """
    which = np.arange(texels) * len(colours) // texels
    return _image(name, np.broadcast_to(np.asarray(colours, np.float64)[which], (2, texels, 3)))


def planks(name: str, colour: Colour, *, rows: int = 8, texels: int = 256) -> Image:
    """Wooden floor boards along u, each a little lighter or darker, with grain and dark joints.

    Args:
        name: Image name.
        colour: Linear mean colour.
        rows: Boards across the image, even.
        texels: Texels along each side.
    Returns:
        The image.
    """
    u = (np.arange(texels) + 0.5) / texels
    across = u * rows
    row = np.floor(across).astype(int)
    shift = (0.37 * row) % 1  # where a board of this row ends
    board = 2 * row[:, None] + np.floor((u[None, :] + shift[:, None]) * 2).astype(int) % 2
    tone = 1 + 0.22 * np.sin(2.4 * board + 1.3 * row[:, None])
    wave = 0.35 * np.sin(2 * np.pi * u)[None, :] + 1.7 * board
    grain = 1 + 0.07 * np.sin(2 * np.pi * (5 * across[:, None] + wave)) * np.sin(
        2 * np.pi * (2 * across[:, None] + 2 * wave)
    )
    edge = np.minimum(across % 1, 1 - across % 1)[:, None] < 0.03
    end = np.abs((u[None, :] + shift[:, None]) * 2 % 1 - 0.5) > 0.5 - 0.006
    value = tone * grain * np.where(edge | end, 0.4, 1.0)
    return _image(name, value[..., None] * np.asarray(colour))


def _image(name: str, linear: Float[np.ndarray, "h w 3"]) -> Image:
    linear = np.clip(linear, 0, 1)
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    rgba = np.full((*linear.shape[:2], 4), 255, np.uint8)
    rgba[..., :3] = np.round(255 * coded)
    return Image(name, rgba)
