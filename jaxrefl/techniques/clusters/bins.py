"""Bins of directions: unit normals -> bin numbers, and how fine the bins of each reflector are.

Source: [WXKP14] §3.2.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

AZIMUTHS = 13
"""Most bins around the pole (the paper's MAXTHETABINS)."""
POLARS = 8
"""Most bins from pole to pole (MAXPHIBINS)."""
SIDE = 10
"""Most bins along each side of the octahedral map: 100 instead of the 104 of `AZIMUTHS` and `POLARS`."""
MOST = AZIMUTHS * POLARS
"""Bins that a reflector may have at the most, in either way of binning."""


def fineness(
    share: Float[Array, "*b"], visible: Int[Array, ""], exponent: Float[Array, ""], least: Float[Array, ""]
) -> Float[Array, "*b"]:
    r"""How fine a reflector's bins are: the larger its image the finer, the more reflectors there are the coarser.

    $$ s_R = (a_R / n_v)^\gamma $$

    Args:
        share: Share of the image's pixels that show the reflector, in [0, 1].
        visible: How many reflectors the image shows.
        exponent: gamma, >= 0.
        least: Smallest factor: with bins too coarse the rays of a bin fan out further than a pinhole can see.
    Returns:
        Factor on the number of bins along each dimension, in [0, 1].
    Source: [WXKP14] §3.2, step 4.
    Differs from the source: its factor is a_R / n_v itself (gamma = 1), which leaves less than one bin for every
        reflector as soon as there are several. With gamma = 1/8 one sphere that fills the image still has all bins, the
        paper's limit, and 20 reflectors that cover half of it come to about as many clusters as the paper counts.
    """
    return jnp.maximum(jnp.clip(share / jnp.maximum(visible, 1).astype(share.dtype), 0, 1) ** exponent, least)


def spherical_bin(n: Float[Array, "*b 3"], fine: Float[Array, "*b"]) -> Int[Array, "*b"]:
    """Bin of a normal by its azimuth and its polar angle from +Y.

    Args:
        n: Unit normals, world space.
        fine: From `fineness`.
    Returns:
        Numbers in [0, `MOST`).
    Edge cases: whole numbers of bins go around, so that none is cut at 360 degrees; at the poles they crowd.
    Source: [WXKP14] §3.2, step 4.
    """
    azimuth = jnp.arctan2(n[..., 2], n[..., 0]) / (2 * jnp.pi)
    polar = jnp.arccos(jnp.clip(n[..., 1], -1, 1)) / jnp.pi
    around, down = _count(AZIMUTHS, fine), _count(POLARS, fine)
    column = jnp.clip(((azimuth - jnp.floor(azimuth)) * around.astype(azimuth.dtype)).astype(jnp.int32), 0, around - 1)
    row = jnp.clip((polar * down.astype(polar.dtype)).astype(jnp.int32), 0, down - 1)
    return row * AZIMUTHS + column


def octahedral_bin(n: Float[Array, "*b 3"], fine: Float[Array, "*b"]) -> Int[Array, "*b"]:
    r"""Bin of a normal on the equal-area octahedral map: bins of one solid angle, without poles.

    $$ r = \sqrt{1 - |z|}, \quad v = r\,\tfrac{2}{\pi}\arctan\tfrac{|y|}{|x|}, \quad u = r - v $$

    Args:
        n: Unit normals, world space.
        fine: From `fineness`.
    Returns:
        Numbers in [0, `MOST`).
    Source: [Clarberg08], eq. 5; instead of the bins of [WXKP14] §3.2.
    """
    side = _count(SIDE, fine)
    column, row = octahedral_cell(n, side)
    return row * SIDE + column


def octahedral_cell(n: Float[Array, "*b 3"], side: Int[Array, "*b"] | int) -> tuple[Int[Array, "*b"], Int[Array, "*b"]]:
    """Column and row of a normal's cell on the octahedral map.

    Args:
        n: Unit normals.
        side: Cells along each side of the map.
    Returns:
        Column and row, in [0, `side`).
    """
    side = jnp.broadcast_to(jnp.asarray(side, jnp.int32), n.shape[:-1])
    x, y, z = (jnp.abs(n[..., i]) for i in range(3))
    r = jnp.sqrt(jnp.clip(1 - z, 0, 1))
    v = r * jnp.arctan2(y, x) * (2 / jnp.pi)
    u = r - v
    u, v = jnp.where(n[..., 2] < 0, 1 - v, u), jnp.where(n[..., 2] < 0, 1 - u, v)
    u, v = (jnp.where(n[..., i] < 0, -a, a) * 0.5 + 0.5 for i, a in enumerate((u, v)))
    column, row = (jnp.clip((a * side.astype(a.dtype)).astype(jnp.int32), 0, side - 1) for a in (u, v))
    return column, row


def _count(most: int, fine: Float[Array, "*b"]) -> Int[Array, "*b"]:
    return jnp.maximum(jnp.round(most * fine), 1).astype(jnp.int32)
