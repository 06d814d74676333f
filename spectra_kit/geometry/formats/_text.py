"""Text as programs write it: its encoding, its lines, and all of its numbers at once."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
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
_WORD = 400  # letters of a number at most, and more than any has
_PLAIN = bytes([9, 10, *range(32, 127)])
_WHOLE = b"0123456789 \t\n"
_NUMERIC = b"+-.eE" + _WHOLE
_LOWER = np.uint64(0x2020202020202020)  # the bits that part eight capitals from small letters


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
    # Not `str.splitlines`, which ends a comment at separators that no editor shows as one.
    for number, line in enumerate(BytesIO(text), start=1):
        yield number, line.decode(errors="replace")


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
    # Integers, as faces are, take a sixth of the time: here those of the lines behind all points.
    point = text.rfind(b".")
    start = 0 if point < 0 else text.find(b"\n", point)
    found = None
    if dtype is np.float64 and start >= 0 and not text[start:].translate(None, _WHOLE):
        reals, whole = _parsed(text[:start], np.float64), _parsed(text[start:], np.int64)
        if reals is not None and whole is not None:
            found = np.concatenate([reals, whole])
    if found is None:
        found = _parsed(text, dtype)
    return found if found is not None and len(found) == count else None


def _parsed(text: bytes, dtype: type[np.generic]) -> NDArray[Any] | None:
    """Return the numbers up to what is none, which some versions of NumPy refuse, or None."""
    if text.isspace() or not text:
        return np.empty(0, dtype)
    try:
        found = np.fromstring(text, dtype=dtype, sep=" ")
        # Of the last word NumPy before 2.3 may take the beginning.
        dtype(text.rstrip()[-_WORD:].split()[-1])
    except (ValueError, OverflowError, DeprecationWarning):
        return None
    if dtype is np.int64 and (found.max() >= 2**62 or found.min() <= -(2**62)):
        return None  # larger ones are cut off
    return np.asarray(found)


@dataclass(frozen=True)
class Lines:
    """Where words stand in those lines of a text that are not blank."""

    characters: NDArray[np.uint8]  # of the text
    words: Ints  # where each word begins, and where the text ends
    first: Ints  # which word is the first of each line
    stop: Ints  # where each line ends
    widths: Ints  # how many words each has

    @staticmethod
    def of(text: bytes) -> Lines | None:
        """Find them all at once; None where a character is none of plain text."""
        if text.translate(None, _PLAIN):
            return None
        characters = np.frombuffer(text, dtype=np.uint8)
        is_word = characters > ord(" ")
        is_word[1:] &= ~is_word[:-1]
        words = np.flatnonzero(is_word)
        stop = np.append(np.flatnonzero(characters == ord("\n")), len(text))
        upto = np.searchsorted(words, stop)
        widths = np.diff(upto, prepend=0)
        some = widths > 0
        small = np.int32 if len(text) < 2**30 else np.int64  # half the room
        words = np.append(words, len(text)).astype(small)
        return Lines(characters, words, (upto - widths)[some], stop[some], widths[some])

    def __len__(self) -> int:
        return len(self.first)

    def character(self, place: int) -> NDArray[np.uint8]:
        """Return that character of each line, counted from its first word; a line feed behind."""
        at = self.words[self.first] + place
        return np.where(at < self.stop, self.characters[np.minimum(at, self.stop - 1)], ord("\n"))

    def text(self, which: Any, start: Any = 0, stop: Any = None) -> bytes:
        """Return the words from `start` to before `stop`, or to the end, of the lines `which`."""
        first, widths = self.first[which], self.widths[which]
        end = np.minimum(self.stop[which] + 1, len(self.characters))
        if not len(first):
            return b""
        begin, upto = (
            np.where(place < widths, self.words[first + np.minimum(place, widths)], end)
            for place in (start, widths if stop is None else stop)
        )
        between = slice(begin[0], upto[-1])
        if (begin[1:] == upto[:-1]).all():
            return bytes(self.characters[between])
        edges = np.column_stack([begin, upto]).ravel()
        chosen = np.repeat(np.arange(len(edges) - 1) % 2 == 0, np.diff(edges))
        return bytes(self.characters[between][chosen])

    def points(self, which: Any, start: int = 0) -> Floats | None:
        """Return the three numbers from word `start` on of each of the lines `which`."""
        text, count = self.text(which, start, start + 3), len(self.first[which])
        found = numbers(text, np.float64, 3 * count)
        return None if found is None else found.reshape(-1, 3)

    def are(self, words: Ints, word: bytes) -> bool:
        """Whether these are all that word of lower case and up to 8 letters, in any case.

        Eight line feeds must end the text.
        """
        eights = np.ndarray(len(self.characters) - 8, "<u8", self.characters, strides=(1,))
        begin = self.words[words]
        letters = (eights[begin] | _LOWER) & np.uint64(2 ** (8 * len(word)) - 1)
        is_it = (letters == int.from_bytes(word, "little")).all()
        return bool(is_it and (self.characters[begin + len(word)] <= ord(" ")).all())
