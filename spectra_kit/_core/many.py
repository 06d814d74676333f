"""What calls on many things share: which of them go together, and which one a message is about."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager

from spectra_kit._core.warn import place
from spectra_kit.errors import SpectraKitError

_PADDED = 0.8  # of the largest of a group: the smallest has as many points, or more


def of_similar_size(
    sizes: Sequence[int], most: int, alone: Container[int] = ()
) -> list[tuple[int, ...]]:
    """Return which things go together, largest first: of similar size, padded to `most` in all.

    Or one on its own, as those do that are to be `alone`.
    """
    groups: list[list[int]] = []
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i]):
        if groups and i not in alone:
            largest, count = groups[-1][0], len(groups[-1]) + 1
            near = sizes[i] >= _PADDED * sizes[largest] and count * sizes[largest] <= most
            if near and largest not in alone:
                groups[-1].append(i)
                continue
        groups.append([i])
    return [tuple(group) for group in groups]


@contextmanager
def about(where: str) -> Iterator[None]:
    """Let errors and warnings inside say which of several things they are about; the innermost."""
    token = place.set(where)
    try:
        yield
    except SpectraKitError as error:
        error.where = error.where or where
        raise
    finally:
        place.reset(token)
