"""How much memory there is, and how much a sparse factor takes, before there is one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

_limit: ContextVar[float | None] = ContextVar("_limit", default=None)


@contextmanager
def memory_of(gigabytes: float | None) -> Iterator[None]:
    """Tell what is done inside how much it may take, in GiB; None says nothing of it."""
    token = _limit.set(gigabytes)
    try:
        yield
    finally:
        _limit.reset(token)


def memory_limit() -> float | None:
    """Return how much may be taken here, in GiB, where somebody has said so."""
    return _limit.get()


def factor_gigabytes(n: int, dimension: int = 2) -> float:
    """Estimate what a complete factor takes on n points of a surface or a volume, in GiB.

    Up to ``4 n log2 n`` entries of 8 bytes, as on meshes of even triangles (1.1 to 3.7 on 15 real
    ones), and half as much again while it is made. In a volume up to ``3 n^(3/2)`` (2.3 to 2.7 in
    balls of 5,000 to 50,000 points and a Delaunay mesh), and 1.4 of that again (1.2 to 1.9 of what
    there is in balls of 24,000 to 2,000 points, with two threads). `Elimination.gigabytes` counts.
    """
    surface, volume = 1.5 * 4 * n * float(np.log2(max(n, 2))), 2.4 * 3 * n**1.5
    return 8 * (surface if dimension == 2 else volume) / 2**30
