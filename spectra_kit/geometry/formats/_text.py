"""Text as programs write it: its encoding, its lines, and all of its numbers at once."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning

# That of UTF-32 begins with that of UTF-16.
_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF32_LE: "utf-32-le",
    codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
_PLAIN = bytes([9, 10, *range(32, 127)])
_NUMERIC = b"0123456789+-.eE \t\n"


def text_of(data: bytes) -> bytes:
    """Return text in UTF-8 without a mark, lines ended by a line feed, nothing blank at its end.

    Blank are the zeros that fill up a block, and the Ctrl-Z that DOS ended files with.
    """
    for mark, encoding in _MARKS.items():
        if data.startswith(mark):
            data = data[len(mark) :].decode(encoding, errors="replace").encode()
            break
    data = data.rstrip(b"\0\x1a \t\r\n")
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def lines_of(text: bytes) -> Iterator[tuple[int, str]]:
    """Yield (number, line) for each line."""
    # Not `splitlines`, which ends a comment at separators that no editor shows as one.
    yield from enumerate(text.decode(errors="replace").split("\n"), start=1)


def words_of(text: bytes) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, words) of each line that is not blank, without ``#`` comments."""
    for number, line in lines_of(text):
        if words := without_comment(line).split():
            yield number, words


def without_comment(line: str) -> str:
    """Return the line up to its ``#``, if it has one."""
    return line.partition("#")[0] if "#" in line else line


def without_comments(text: bytes) -> bytes:
    """Return the text without its ``#`` comments."""
    return re.sub(rb"#[^\n]*", b"", text) if b"#" in text else text


def passed_over(lines: Iterable[int], which: str) -> None:
    """Warn of the lines of these numbers, if there are any."""
    if numbers := list(lines):
        told = (
            f"passed over {quantity(len(numbers), 'line')} {which}, the first is line {numbers[0]}"
        )
        warn(told, IgnoredContentWarning)


def are_laid_out(widths: Ints, start: int, lines: Ints, *, lists: bool) -> bool:
    """Whether rows of so many numbers lie on lines as programs write them.

    Where a number is torn in two, the rows that follow may still add up to what is announced, above
    all where lists may have any length. So rows stand on one line, together or alone; or those on
    several begin and end with lines, and are lists of one length, more than one.

    `widths` (r,) are the numbers of each row, behind `start` numbers; `lines` those up to the end
    of each line, ascending; `lists` whether the rows are lists that tell their length.
    """
    ends = start + np.cumsum(widths)
    starts = ends - widths
    on_several = np.searchsorted(lines, ends) > np.searchsorted(lines, starts, side="right")
    if not on_several.any():
        return True
    if not (np.isin(ends, lines).all() and np.isin(starts[starts > 0], lines).all()):
        return False
    return not lists or (on_several.sum() > 1 and bool((widths == widths[0]).all()))


def numbers(text: bytes, dtype: type[np.generic], count: int) -> NDArray[Any] | None:
    """Return the numbers of a text of as many words, or None where a word is not exactly one."""
    if text.translate(None, _NUMERIC):
        return None
    try:
        found = np.fromstring(text.decode(), dtype=dtype, sep=" ")
    except (ValueError, DeprecationWarning):  # which one depends on the version of NumPy
        return None
    if len(found) != count or (dtype is np.int64 and count and np.abs(found).max() >= 2**62):
        return None  # larger ones are cut off
    return np.asarray(found)


@dataclass(frozen=True)
class Lines:
    """Where words stand in those lines of a text that are not blank."""

    text: bytes
    first: Ints  # where the first word of each begins
    stop: Ints  # where each ends
    widths: Ints  # how many words each has

    @staticmethod
    def of(text: bytes) -> Lines | None:
        """Find them all at once; None where a character is none of plain text."""
        if text.translate(None, _PLAIN):
            return None
        characters = np.frombuffer(text, dtype=np.uint8)
        is_word = characters > ord(" ")
        is_word[1:] &= characters[:-1] <= ord(" ")
        begins = np.flatnonzero(is_word)
        stop = np.append(np.flatnonzero(characters == ord("\n")), len(text))
        upto = np.searchsorted(begins, stop)
        widths = np.diff(upto, prepend=0)
        some = widths > 0
        return Lines(text, begins[(upto - widths)[some]], stop[some], widths[some])

    def __len__(self) -> int:
        return len(self.first)

    def character(self, place: int) -> NDArray[np.uint8]:
        """Return that character of each line, counted from its first word; a line feed behind."""
        characters = np.frombuffer(self.text + b"\n", dtype=np.uint8)
        return characters[np.minimum(self.first + place, self.stop)]

    def part(self, start: int, stop: int) -> bytes:
        """Return the text of consecutive lines."""
        return self.text[self.first[start] : self.stop[stop - 1]] if stop > start else b""

    def chosen(self, which: NDArray[np.bool_]) -> bytes:
        """Return the text of some lines, from their first words on."""
        ends = np.append(self.first[1:], len(self.text))
        begin = self.first[0] if len(self) else 0
        mask = np.repeat(which, np.diff(ends, prepend=begin))
        return np.frombuffer(self.text, np.uint8)[begin:][mask].tobytes()

    def rows(self, start: int, stop: int) -> Floats | None:
        """Return the numbers of consecutive lines of one width, as a table."""
        widths = self.widths[start:stop]
        if stop <= start or (widths != widths[0]).any():
            return None
        found = numbers(self.part(start, stop), np.float64, int(widths.sum()))
        return None if found is None else found.reshape(len(widths), -1)
