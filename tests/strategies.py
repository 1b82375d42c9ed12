"""Hypothesis strategies shared by the property tests: values are mapped into their domain, never filtered."""

import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from jax import Array

SHAPES = ((), (5,), (2, 3))
"""The three batch shapes of every property test, fixed so that each function compiles three times at the most."""


def shapes() -> st.SearchStrategy[tuple[int, ...]]:
    """One of the three fixed batch shapes."""
    return st.sampled_from(SHAPES)


def floats(low: float, high: float, shape: tuple[int, ...] = ()) -> st.SearchStrategy[Array]:
    """float32 arrays with values in [low, high], without subnormals."""
    elements = st.floats(0.0, 1.0, width=32, allow_subnormal=False)
    return hnp.arrays(np.float32, shape, elements=elements).map(
        lambda x: jnp.asarray(np.clip(low + (high - low) * x, low, high), jnp.float32)
    )


def unit_vectors(shape: tuple[int, ...] = ()) -> st.SearchStrategy[Array]:
    """Unit vectors [*shape 3], uniform in (z, phi)."""

    def build(uv: np.ndarray) -> Array:
        z, phi = 2 * uv[..., 0].astype(np.float64) - 1, 2 * np.pi * uv[..., 1].astype(np.float64)
        r = np.sqrt(np.maximum(0.0, 1 - z * z))
        return jnp.asarray(np.stack([r * np.cos(phi), r * np.sin(phi), z], -1), jnp.float32)

    elements = st.floats(0.0, 1.0, width=32, allow_subnormal=False)
    return hnp.arrays(np.float32, (*shape, 2), elements=elements).map(build)
