"""Tolerances by dtype, used by all tests; any other number in a test carries the measured worst case beside it."""

import numpy as np

RTOL = {np.dtype(np.float32): 2e-5, np.dtype(np.float64): 1e-12}
ATOL = {np.dtype(np.float32): 2e-6, np.dtype(np.float64): 1e-14}


def assert_close(actual, expected, *, scale: float = 1.0) -> None:
    """Assert that two arrays agree to the tolerance of the coarser dtype, times `scale`."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    coarser = max((actual.dtype, expected.dtype), key=lambda dtype: RTOL.get(dtype, 0.0))
    rtol, atol = RTOL[coarser] * scale, ATOL[coarser] * scale
    np.testing.assert_allclose(actual, expected, rtol=rtol, atol=atol)
