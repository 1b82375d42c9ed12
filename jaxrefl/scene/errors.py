"""What goes wrong with scene files: one exception and one warning class."""

import warnings


class SceneError(ValueError):
    """A scene cannot be built; the message names the file or object, what was expected and what came."""


class SceneWarning(UserWarning):
    """Something in a scene file was assumed, changed or ignored; the message says what."""


def warn_notes(notes: list[str], source: str) -> None:
    """Issue each note as one `SceneWarning`.

    Args:
        notes: Sentences for the user.
        source: File or scene they are about; stands in front of each.
    """
    for note in notes:
        warnings.warn(f"{source}: {note}", SceneWarning, stacklevel=3)
