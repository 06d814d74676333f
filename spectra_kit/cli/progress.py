"""What a person at a terminal sees while a command works; files and pipes see nothing of it."""

from __future__ import annotations

import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from contextvars import ContextVar
from typing import Any

from spectra_kit._core.compiling import heard_by
from spectra_kit._core.shown import printable
from spectra_kit.cli.words import told

_TICK = 0.1  # seconds
STDOUT = "standard output"  # in errors of what is printed
_LONG = 1.0  # seconds; a step that took less leaves no line behind
_COMPILES = "compiling for this processor: that takes some seconds, once"
_QUIET = ContextVar("quiet", default=False)


@contextmanager
def telling(*, quiet: bool) -> Iterator[None]:
    """Show progress inside the block, or do not; and warnings as lines of their own."""
    token = _QUIET.set(quiet)
    shown = warnings.showwarning
    warnings.showwarning = lambda message, *_: say(f"warning: {told(message)}")
    try:
        with nullcontext() if _unseen() else heard_by(_Compiling()):
            yield
    finally:
        warnings.showwarning = shown
        _QUIET.reset(token)


@contextmanager
def step(text: str) -> Iterator[None]:
    """Show `text` and the seconds while the block runs; then how long it took."""
    with _line(text, bar_format="{desc}  {elapsed_s:.1f} s") as bar:
        stop = threading.Event()
        ticker = threading.Thread(target=_tick, args=(bar, stop), daemon=True)
        ticker.start()
        try:
            yield
        finally:
            stop.set()
            ticker.join()


@contextmanager
def counted(text: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar while the block runs; it is handed ``tell(done, total)``."""
    with _line(text, unit=unit) as bar:

        def tell(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield tell


@contextmanager
def _line(text: str, **options: Any) -> Iterator[Any]:
    """A line of the terminal, cleared before anything is said of an error or of the end."""
    from tqdm import tqdm

    text = printable(text)
    if _unseen():
        yield tqdm(disable=True)
        return
    start = time.perf_counter()
    # Some terminals do not know their size: theirs would be shown nothing.
    width = (os.get_terminal_size(sys.stderr.fileno()).columns or 80) - 1
    size = {"ncols": width, "nrows": 24}
    try:
        with tqdm(desc=text[: width - 10], leave=False, file=sys.stderr, **size, **options) as bar:
            yield bar
    finally:
        # Interrupted just as it is made, a line is shown and never closed.
        sys.stderr.write(f"\r{'':{width}}\r")
    if (seconds := time.perf_counter() - start) >= _LONG:
        sys.stderr.write(f"{text}: done in {seconds:.1f} s\n")


def _unseen() -> bool:
    return _QUIET.get() or not sys.stderr.isatty()


class _Compiling:
    """Says that loops are compiled, once that has taken as long as a step that is told of."""

    _start: float
    _timer: threading.Timer

    def __init__(self) -> None:
        self._left = _LONG

    def __call__(self, begins: bool) -> None:
        if begins:
            self._start = time.perf_counter()
            self._timer = threading.Timer(self._left, say, [_COMPILES])
            self._timer.daemon = True
            if self._left > 0:
                self._timer.start()
        else:
            self._timer.cancel()
            self._left -= time.perf_counter() - self._start


def _tick(bar: Any, stop: threading.Event) -> None:
    while not stop.wait(_TICK):
        bar.refresh()


def say(text: str) -> None:
    """Write a line to stderr, also in the midst of a step; where that is full, to nobody."""
    from tqdm import tqdm

    with suppress(OSError):
        tqdm.write(printable(text), file=sys.stderr)
