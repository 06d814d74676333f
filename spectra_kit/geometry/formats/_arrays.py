"""What the format readers share."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from collections.abc import Sequence
from tokenize import TokenError

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.types import Ints
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.polygons import Polygons

Arrays = tuple[ArrayLike, ArrayLike | Polygons | InvalidInputError | None]
"""Points of shape (n, 3) and faces: a table of corners, polygons of several sizes, what is wrong
with them (for who wants the points alone), or None where the file holds none."""


# What NumPy, zipfile and the decompressors raise on damaged files; an OSError here is a seek to a
# bad place, a RuntimeError an encrypted array or a header of a thousand brackets.
BROKEN = (
    ValueError,
    TypeError,
    LookupError,
    SyntaxError,
    EOFError,
    OSError,
    OverflowError,
    RuntimeError,
    TokenError,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
)


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


def bands(corners: Ints) -> Ints:
    """Return the triangles of bands, -1 between them: of each corner and the two before, in turn.

    Those with a corner twice only lead from one part of a band to another.
    """
    band = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    place = np.arange(len(corners))
    since = place - np.maximum.accumulate(np.where(corners == -1, place + 1, 0))
    turned = since[: len(band)] % 2 == 1
    band[turned] = band[turned][:, [1, 0, 2]]
    a, b, c = band.T
    return np.asarray(band[(band != -1).all(axis=1) & (a != b) & (b != c) & (c != a)])


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
