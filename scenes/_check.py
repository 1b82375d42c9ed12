"""Checks of what users pass to the built-in scenes."""

Real = float | int
"""A number; run-time checkers take `float` literally."""


def in_range(name: str, value: Real, low: Real, high: Real) -> float:
    """Check a number.

    Args:
        name: Parameter name, for the message.
        value: What came.
        low: Smallest allowed value.
        high: Largest allowed value.
    Returns:
        The value as a float.
    Raises:
        ValueError: If it is not a number in [low, high].
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ValueError(f"{name}: expected a number from {low:g} to {high:g}, got {value!r}")
    return float(value)


def whole(name: str, value: int, low: int, high: int) -> int:
    """Check a count.

    Args:
        name: Parameter name, for the message.
        value: What came.
        low: Smallest allowed value.
        high: Largest allowed value.
    Returns:
        The value.
    Raises:
        ValueError: If it is not a whole number in [low, high].
    """
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name}: expected a whole number from {low} to {high}, got {value!r}")
    return value


def one_of(name: str, value: str, choices: tuple[str, ...]) -> str:
    """Check a choice.

    Args:
        name: Parameter name, for the message.
        value: What came.
        choices: What is allowed.
    Returns:
        The value.
    Raises:
        ValueError: If it is none of the choices.
    """
    if value not in choices:
        raise ValueError(f"{name}: expected one of {', '.join(choices)}, got {value!r}")
    return value
