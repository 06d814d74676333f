"""Threads for loops that release the interpreter lock: compiled ones, NumPy's and SciPy's."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any


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
