"""Who is told that loops are being compiled: it takes seconds, once, in which nothing else happens.

Apart from `compiled`, which imports numba.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_told: list[Callable[[bool], object]] = []


@contextmanager
def heard_by(listener: Callable[[bool], object]) -> Iterator[None]:
    """Call `listener` inside the block with True when compiling a loop begins, False when it ends.

    From any thread, one loop at a time.
    """
    _told.append(listener)
    try:
        yield
    finally:
        _told.remove(listener)


def tell(begins: bool) -> None:
    """Tell those who asked for it."""
    for listener in tuple(_told):
        listener(begins)
