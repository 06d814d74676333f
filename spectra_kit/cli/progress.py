"""What a person at a terminal sees while a command works; files and pipes see nothing of it."""

from __future__ import annotations

import itertools
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar

from spectra_kit.cli.words import told

_TICK = 0.1  # seconds
_LONG = 1.0  # seconds; a step that took less leaves no line behind
_QUIET = ContextVar("quiet", default=False)


@contextmanager
def telling(*, quiet: bool) -> Iterator[None]:
    """Show progress inside the block, or do not; and warnings as lines of their own."""
    token = _QUIET.set(quiet)
    shown = warnings.showwarning
    warnings.showwarning = lambda message, *_: say(f"warning: {told(message)}")
    try:
        yield
    finally:
        warnings.showwarning = shown
        _QUIET.reset(token)


@contextmanager
def step(text: str) -> Iterator[None]:
    """Show `text`, a wheel and the seconds while the block runs; then how long it took.

    The line is cleared when the block fails or is interrupted, before anything is said of that.
    """
    if not _seen():
        yield
        return
    start, stop = time.perf_counter(), threading.Event()
    ticker = threading.Thread(target=_tick, args=(text, start, stop), daemon=True)
    ticker.start()
    finished = False
    try:
        yield
        finished = True
    finally:
        stop.set()
        ticker.join()
        _show("")
        if finished:
            _tell_done(text, time.perf_counter() - start)


@contextmanager
def counted(text: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar while the block runs; it is handed ``tell(done, total)``."""
    from tqdm import tqdm

    start = time.perf_counter()
    seen = _seen()
    with tqdm(
        desc=text,
        unit=unit,
        leave=False,
        disable=not seen,
        file=sys.stderr,
        ncols=_width() if seen else None,
        nrows=24,  # a terminal that does not know its size would show nothing
    ) as bar:

        def tell(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield tell
    if seen:
        _tell_done(text, time.perf_counter() - start)


def say(text: str) -> None:
    """Write a line to stderr, also in the midst of a step; where that is full, to nobody."""
    with suppress(OSError):
        if sys.stderr.isatty():
            _show("")
        sys.stderr.write(text + "\n")


def _seen() -> bool:
    return not _QUIET.get() and sys.stderr.isatty()


def _tell_done(text: str, seconds: float) -> None:
    if seconds >= _LONG:
        sys.stderr.write(f"{text}: done in {seconds:.1f} s\n")


def _tick(text: str, start: float, stop: threading.Event) -> None:
    fancy = (sys.stderr.encoding or "").lower().startswith("utf")
    for wheel in itertools.cycle("⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏" if fancy else "|/-\\"):
        if stop.wait(_TICK):
            return
        _show(f"{wheel} {text}  {time.perf_counter() - start:.1f} s")


def _show(text: str) -> None:
    """Put `text` in place of the line; one write, so that two threads do not mix theirs."""
    width = _width()
    sys.stderr.write(f"\r{text[:width]:{width}}\r")
    sys.stderr.flush()


def _width() -> int:
    """Columns that a line may fill without wrapping; some terminals do not know theirs."""
    return (os.get_terminal_size(sys.stderr.fileno()).columns or 80) - 1
