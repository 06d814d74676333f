"""Threads that stay for the whole of an iteration: starting them for each step costs more."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from spectra_kit.linalg.threads import thread_count

_ROWS = 16384  # in a range: sums within one are never cut differently

_pool: ContextVar[tuple[ThreadPoolExecutor, int] | None] = ContextVar("_pool", default=None)

Call = tuple[Callable[..., Any], tuple[Any, ...]]


@contextmanager
def team() -> Iterator[None]:
    """Let `side_by_side` use all threads inside; they end with the context."""
    workers = thread_count() - 1  # and the one that calls
    if workers < 1:
        yield
        return
    with ThreadPoolExecutor(workers) as pool:
        token = _pool.set((pool, workers))
        try:
            yield
        finally:
            _pool.reset(token)


def ranges(n: int) -> list[tuple[int, int]]:
    """Cut n rows into ranges, the same whatever the number of threads."""
    return [(start, min(start + _ROWS, n)) for start in range(0, n, _ROWS)]


def side_by_side(calls: Sequence[Call]) -> list[Any]:
    """Return what the calls return, in their order; one after the other outside of a `team`."""
    active = _pool.get()
    if active is None or len(calls) < 2:
        return [task(*arguments) for task, arguments in calls]
    pool, workers = active
    share = -(-len(calls) // (workers + 1))
    cuts = [calls[i : i + share] for i in range(0, len(calls), share)]
    futures = [pool.submit(_one_after_the_other, cut) for cut in cuts[1:]]
    results = _one_after_the_other(cuts[0])
    for future in futures:
        results += future.result()
    return results


def _one_after_the_other(calls: Sequence[Call]) -> list[Any]:
    return [task(*arguments) for task, arguments in calls]
