"""Host-side checks of what users pass: each raises one sentence with the argument, what was expected and what came.

Input: NumPy arrays and Python numbers at the border of the library, never traced values. All functions return the
checked value, converted, so that a call site reads `faces = checked_indices("faces", faces, len(vertices))`.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np


def checked_array(
    name: str, value: Any, shape: Sequence[int | None], *, dtype: type = np.float64, finite: bool = True
) -> np.ndarray:
    """A numeric array of the expected shape.

    Args:
        name: Name of the argument, for messages.
        value: Anything NumPy turns into an array.
        shape: Expected extent of each axis; None accepts any extent.
        dtype: Type of the result.
        finite: True refuses NaN and infinity.
    Returns:
        The array as `dtype`.
    Raises:
        ValueError: If the value is not numeric, has another shape, or is not finite.
    Edge cases: an extent of zero passes where `shape` says None.
    """
    try:
        array = np.asarray(value, dtype)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected numbers of shape {_shape_text(shape)}, got {value!r}") from error
    if array.ndim != len(shape) or any(e is not None and e != a for e, a in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{name}: expected shape {_shape_text(shape)}, got {array.shape}")
    if finite and not np.isfinite(array).all():
        count = int((~np.isfinite(array)).sum())
        raise ValueError(f"{name}: expected finite values, got {count} of {array.size} that are NaN or infinite")
    return array


def checked_indices(name: str, value: Any, size: int, *, columns: int = 3) -> np.ndarray:
    """Rows of indices into something of a known size.

    Args:
        name: Name of the argument, for messages.
        value: [n columns] whole numbers.
        size: How many elements there are to point at.
        columns: Indices per row.
    Returns:
        The indices as int64.
    Raises:
        ValueError: If the shape is wrong, the values are not integers, or one lies outside [0, size).
    Edge cases: zero rows pass, whatever their type.
    """
    array = np.asarray(value)
    if array.ndim != 2 or array.shape[1] != columns:
        raise ValueError(f"{name}: expected shape [n {columns}], got {array.shape}")
    if array.size and array.dtype.kind not in "iu":
        raise ValueError(f"{name}: expected integers, got {array.dtype}")
    array = array.astype(np.int64)
    outside = (array < 0) | (array >= size)
    if outside.any():
        raise ValueError(
            f"{name}: expected indices from 0 to {size - 1}, got {int(outside.sum())} outside, "
            f"the first is {int(array[outside][0])}"
        )
    return array


def checked_number(
    name: str, value: Any, *, low: float = -np.inf, high: float = np.inf, above: float | None = None
) -> float:
    """A finite number in a range.

    Args:
        name: Name of the argument, for messages.
        value: An int or float; bool and text are refused.
        low: Smallest allowed value.
        high: Largest allowed value.
        above: A bound the value must be strictly greater than.
    Returns:
        The value as float.
    Raises:
        ValueError: If it is not a number, not finite, or out of range.
    """
    expected = "a number" + (f" > {above}" if above is not None else _range_text(low, high))
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise ValueError(f"{name}: expected {expected}, got {value!r}")
    number = float(value)
    if not np.isfinite(number) or not low <= number <= high or (above is not None and number <= above):
        raise ValueError(f"{name}: expected {expected}, got {value!r}")
    return number


def checked_keys(name: str, keys: Iterable[str], allowed: Iterable[str]) -> None:
    """Refuse keys that nobody reads, so that a typing error is not silently ignored.

    Args:
        name: Where the keys stand, for messages.
        keys: What was given.
        allowed: What is understood.
    Raises:
        ValueError: If a key is unknown; lists the known ones.
    """
    known = list(allowed)
    unknown = [key for key in keys if key not in known]
    if unknown:
        raise ValueError(
            f"{name}: unknown key{'s' if len(unknown) > 1 else ''} {', '.join(map(repr, unknown))}; "
            f"known are {', '.join(known)}"
        )


def _shape_text(shape: Sequence[int | None]) -> str:
    return "[" + " ".join("n" if extent is None else str(extent) for extent in shape) + "]"


def _range_text(low: float, high: float) -> str:
    if np.isfinite(low) and np.isfinite(high):
        return f" from {low:g} to {high:g}"
    if np.isfinite(low):
        return f" >= {low:g}"
    return f" <= {high:g}" if np.isfinite(high) else ""
