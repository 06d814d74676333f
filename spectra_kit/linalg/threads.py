"""Threads for loops that release the interpreter lock: compiled ones, NumPy's and SciPy's."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from typing import Any

#: Entries of a block, 8 MiB: one core passes over fewer in a millisecond.
WORTH_SHARING = 1 << 20


def thread_count() -> int:
    """Return NUMBA_NUM_THREADS if it is set, else the number of cores this process may use."""
    chosen = os.environ.get("NUMBA_NUM_THREADS", "")
    if chosen.isdecimal() and int(chosen) > 0:
        return int(chosen)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_threads(task: Callable[..., None], arguments: Iterable[tuple[Any, ...]]) -> None:
    """Call `task` with each tuple of `arguments`, side by side.

    The threads end with the call: a process may fork afterwards, and several may call at once.
    """
    calls = list(arguments)
    workers = min(thread_count(), len(calls))
    if workers <= 1:
        for call in calls:
            task(*call)
        return
    with ThreadPoolExecutor(workers) as pool:
        for done in [pool.submit(task, *call) for call in calls]:
            done.result()


_lock = threading.Lock()
_depth = 0
_limit: Any = None


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Keep BLAS to one thread inside: the loops here bring threads of their own.

    OpenBLAS shares out even the smallest product and waits for its threads by spinning; beside any
    other work on the machine, an eigenproblem of size 150 then takes seconds. May be nested, and
    entered from several threads; the last to leave restores what was before.
    """
    global _depth, _limit
    with _lock:
        if _depth == 0:
            _limit = _controller().limit(limits=1, user_api="blas")
        _depth += 1
    try:
        yield
    finally:
        with _lock:
            _depth -= 1
            if _depth == 0:
                _limit.restore_original_limits()
                _limit = None


def blas_threads_for(entries: int) -> AbstractContextManager[None]:
    """Keep BLAS to one thread inside where the largest block has few `entries`.

    Sharing such blocks out can gain little, and costs as much as the machine is busy, or has cores
    that the process may not use: hundreds of times the work itself. Larger ones get the threads
    that the environment asks for.
    """
    return nullcontext() if entries > WORTH_SHARING else single_threaded_blas()


@cache
def _controller() -> Any:
    """Find the BLAS libraries of NumPy and SciPy, once: it takes longer than a small product."""
    import scipy.linalg  # noqa: F401  (has a BLAS of its own)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
