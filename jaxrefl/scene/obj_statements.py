"""Statements of an OBJ file -> arrays of numbers and triangles.

Lines of one kind mostly have the same number of values: then they are read by one array operation. Where they do not,
or where that fails, they are read one by one, which also finds the line to name in the error.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxrefl.scene.errors import SceneError

KNOWN = {"v", "vt", "vn", "f", "o", "g", "s", "usemtl", "mtllib"}
"""Keywords that are read."""

_REST = {0: "/0/0", 1: "/0", 2: ""}
_NO_DIGITS = str.maketrans("", "", "-0123456789")


@dataclass(frozen=True)
class Statements:
    """The statements of a file, in order."""

    path: Path
    """The file."""
    keyword: np.ndarray
    """Keyword of each statement."""
    rest: list[str]
    """What follows the keyword, with single spaces."""
    number: np.ndarray
    """Line number of each statement, from 1."""

    def rows(self, keyword: str) -> np.ndarray:
        """Which statements have a keyword."""
        return np.flatnonzero(self.keyword == keyword)


def read_statements(path: Path) -> Statements:
    """The statements of an OBJ file without comments, continued lines joined.

    Args:
        path: The file.
    Returns:
        The statements.
    Raises:
        SceneError: If not one of them is known, because then this is no OBJ file.
    """
    text = path.read_bytes().decode("utf-8", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    text = text.replace("\\\n", " \f").replace("\t", " ")
    while "  " in text:
        text = text.replace("  ", " ")
    lines = text.split("\n")
    joined = np.cumsum([0] + [line.count("\f") for line in lines[:-1]]) if "\f" in text else 0
    if "#" in text:
        lines = [line.partition("#")[0] for line in lines]
    pairs = [line.replace("\f", "").strip().partition(" ") for line in lines]
    keyword = np.array([pair[0] for pair in pairs], dtype=np.str_)
    filled = np.flatnonzero(keyword != "")
    keyword = keyword[filled]
    if len(keyword) and not np.isin(keyword, sorted(KNOWN)).any():
        raise SceneError(f"{path}: expected OBJ statements such as 'v 0 0 0', got {str(keyword[0])[:40]!r}")
    number = (np.arange(len(lines)) + 1 + joined)[filled]
    return Statements(path, keyword, [pairs[row][2] for row in filled], number)


def read_vectors(statements: Statements, keyword: str, columns: int) -> tuple[np.ndarray, np.ndarray | None]:
    """The numbers after a keyword.

    Args:
        statements: The file.
        keyword: "v", "vt" or "vn".
        columns: How many numbers are needed.
    Returns:
        The vectors [n columns], and the further numbers [n k] where all lines have equally many.
    Raises:
        SceneError: If there are too few numbers or something else; names the line.
    """
    rows = statements.rows(keyword)
    lines = [statements.rest[row] for row in rows]
    values = _uniform_numbers(lines, np.float64)
    if values is not None and values.shape[1] >= columns:
        return values[:, :columns], values[:, columns:]
    vectors = np.zeros((len(lines), columns))
    for i, (row, line) in enumerate(zip(rows, lines, strict=True)):
        where = f"{statements.path}: line {statements.number[row]}"
        try:
            numbers = [float(token) for token in line.split()]
        except ValueError as error:
            raise SceneError(f"{where}: {error}") from error
        if len(numbers) < columns:
            raise SceneError(f"{where}: expected {columns} numbers after {keyword!r}, got {len(numbers)}")
        vectors[i] = numbers[:columns]
    return vectors, None


def read_triangles(statements: Statements, sizes: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The faces, cut into triangles.

    Args:
        statements: The file.
        sizes: How many positions, texture coordinates and normals there are.
    Returns:
        Corners [n 3] as 0-based rows of position, texture coordinate and normal, -1 for none; triangles [f 3] of
        corners; and the number [f] of the `f` statement each triangle comes from.
    Raises:
        SceneError: If a face has fewer than three vertices, is malformed, or an index is out of range; names the line.
    Edge cases: negative indices count backwards from the last element above the face.
    """
    rows = statements.rows("f")
    lines = [statements.rest[row] for row in rows]
    count = np.array([line.count(" ") + 1 for line in lines], np.int64)
    for row in rows[count < 3]:
        raise SceneError(
            f"{statements.path}: line {statements.number[row]}: expected a face of at least 3 vertices, "
            f"got {statements.rest[row]!r}"
        )
    index = _references(lines, int(count.sum()))
    if index is None:
        raise SceneError(f"{statements.path}: broken face: expected vertex/texture/normal numbers in each `f`")
    line = np.repeat(np.arange(len(rows)), count)
    for column, keyword in enumerate(("v", "vt", "vn")):
        above = np.cumsum(statements.keyword == keyword)[rows][line]  # how many are defined above the face
        index[:, column] = _resolved(statements, rows[line], index[:, column], keyword, above, sizes[column])
    start, fan = np.cumsum(count) - count, count - 2
    owner = np.repeat(np.arange(len(rows)), fan)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(fan) - fan, fan)
    first = start[owner]
    return index, np.stack([first, first + step + 1, first + step + 2], 1), owner


def _resolved(
    statements: Statements, rows: np.ndarray, given: np.ndarray, keyword: str, above: np.ndarray, size: int
) -> np.ndarray:
    """0-based indices from 1-based and negative ones; -1 for none."""
    resolved = np.where(given < 0, above + given, given - 1)
    wrong = (given != 0) & ((resolved < 0) | (resolved >= size))
    wrong |= (given == 0) & (keyword == "v")
    if wrong.any():
        first = int(np.flatnonzero(wrong)[0])
        raise SceneError(
            f"{statements.path}: line {statements.number[rows[first]]}: {keyword} index {given[first]} is out of "
            f"range: expected 1 to {size} or -{above[first]} to -1 ({int(wrong.sum())} such indices)"
        )
    return np.where(given == 0, -1, resolved)


def _references(lines: list[str], count: int) -> np.ndarray | None:
    """The references of all faces as [count 3] numbers, 0 where one is left out; None if they are malformed."""
    text = " ".join(lines)
    slashes, double = text.count("/") // max(count, 1), text.count("//")
    alike = text.translate(_NO_DIGITS) == " ".join(["/" * slashes] * count) and slashes <= 2
    if alike and double in (0, count):
        flat = _numbers(text.replace("//", " 0 ").replace("/", " "), np.int64)
        if flat is not None and flat.size == (slashes + 1) * count:
            index = np.zeros((count, 3), np.int64)
            index[:, : slashes + 1] = flat.reshape(count, slashes + 1)
            return index
    try:
        full = "/".join([ref + _REST[ref.count("/")] for ref in text.split()])
        return np.array([int(token) if token else 0 for token in full.split("/")], np.int64).reshape(count, 3)
    except (KeyError, ValueError):
        return None


def _uniform_numbers(lines: list[str], dtype: type) -> np.ndarray | None:
    """[n columns] if all lines have the same number of values and all are numbers, else None."""
    spaces = {line.count(" ") for line in lines}
    if len(spaces) != 1:
        return None
    columns = spaces.pop() + 1
    flat = _numbers(" ".join(lines), dtype)
    return None if flat is None or flat.size != columns * len(lines) else flat.reshape(-1, columns)


def _numbers(text: str, dtype: type) -> np.ndarray | None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # NumPy's word for text that is not a number
        try:
            return np.fromstring(text, dtype, sep=" ")
        except (DeprecationWarning, ValueError):
            return None
