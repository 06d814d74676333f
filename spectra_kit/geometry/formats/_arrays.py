"""What the format readers share."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.polygons import Polygons

Arrays = tuple[ArrayLike, ArrayLike | Polygons | InvalidInputError | None]
"""Points of shape (n, 3) and faces: a table of corners, polygons of several sizes, what is wrong
with them (for who wants the points alone), or None where the file holds none."""


def broken_line(number: int, words: Sequence[str], error: ValueError) -> InvalidInputError:
    """Return what is to be raised of a line that cannot be read."""
    return InvalidInputError(
        f"line {number} is broken: {' '.join(words)[:60]!r} ({error})",
        advice="the file may be cut short or damaged",
    )


def real(word: str) -> float:
    """Return the number that `word` is in any program; Python alone reads ``1_0``.

    Microsoft's libraries write ``-nan(ind)``.
    """
    if "_" in word or not word.isascii():
        raise ValueError(f"{word!r} is no number")
    return float("nan") if word.lower().lstrip("+-").startswith("nan(") else float(word)


def whole(word: str) -> int:
    """Return the integer that `word` is in any program, if an index can be as large."""
    if "_" in word or not word.isascii():
        raise ValueError(f"{word!r} is no integer")
    value = int(word)
    if not -(2**63) <= value < 2**63:
        raise ValueError(f"{word[:20]!r} has more than 64 bits")
    return value


def position(columns: list[str], width: int) -> list[float]:
    """Return x, y, z, the first of `width` columns, of which all lines of a file have as many."""
    if len(columns) != width:
        raise ValueError(f"{quantity(len(columns), 'column')} where there must be {width}")
    return [real(column.strip()) for column in columns[:3]]


def check_corners(faces: Polygons) -> None:
    """Refuse binary faces without corners: zeros that a disk left, or rows that begin too late."""
    if not faces.sizes.all():
        raise InvalidInputError(
            f"holds {quantity((faces.sizes == 0).sum(), 'face')} without corners, the first being"
            f" face {faces.sizes.argmin()}, counted from 0; the file may be damaged"
        )


def check_rest(rest: bytes, is_row: bool) -> None:
    """Tell of bytes behind the announced end of a file; refuse what is long or like more rows."""
    if not rest.strip(b"\0\x1a \t\r\n"):
        return
    told = f"{quantity(len(rest), 'byte')} more than its header announces"
    if is_row:
        raise InvalidInputError(
            f"holds {told}, which may be rows that it does not count; the file may be damaged",
            advice="correct the header, or cut them off",
        )
    warn(f"passed over {told}", IgnoredContentWarning)
