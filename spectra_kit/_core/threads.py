"""Threads for loops that release the interpreter lock: compiled ones, NumPy's and SciPy's."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from contextvars import ContextVar, copy_context
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

Argument = TypeVar("Argument")
Begun = TypeVar("Begun")
Result = TypeVar("Result")

#: Entries of a block, 8 MiB: one core passes over fewer in a millisecond.
WORTH_SHARING = 1 << 20
_SHARES = 4  # for each thread: levels out rows of different lengths


_alone: ContextVar[bool] = ContextVar("_alone", default=False)


def alone() -> bool:
    """Whether this is inside `single_threaded`."""
    return _alone.get()


def thread_count() -> int:
    """Return NUMBA_NUM_THREADS if it is set, else the number of cores this process may use.

    Inside `single_threaded`, one.
    """
    if _alone.get():
        return 1
    chosen = os.environ.get("NUMBA_NUM_THREADS", "")
    if chosen.isdecimal() and int(chosen) > 0:
        return int(chosen)
    return usable_cores()


def usable_cores() -> int:
    """Return the number of cores this process may use: bound to some, or to a share of their time.

    The latter is what containers and batch systems give.
    """
    here = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if here else os.cpu_count() or 1
    return max(1, math.ceil(min(cores, _quota())))


@cache
def _quota(root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")) -> float:
    """Return the cores that the groups of this process may keep busy, on Linux."""
    least = math.inf
    try:
        lines = own.read_text().splitlines()
    except OSError:  # another system
        return least
    for line in lines:
        _, kinds, group = line.split(":", 2)
        if kinds and "cpu" not in kinds.split(","):
            continue
        # In a container its own group is the root; elsewhere each group around has a say.
        for above in (Path(group), *Path(group).parents):
            folder = root / kinds / above.relative_to("/")
            with suppress(OSError, ValueError):
                if kinds:  # of the first version
                    parts = ("cpu.cfs_quota_us", "cpu.cfs_period_us")
                    share, period = (float((folder / part).read_text()) for part in parts)
                else:
                    share, period = map(float, (folder / "cpu.max").read_text().split())
                least = min(least, share / period if share > 0 else math.inf)
    return least


def ranges(n: int, size: int) -> list[tuple[int, int]]:
    """Cut n rows into ranges of `size`: the same, and so each sum, on any number of threads."""
    return [(start, min(start + size, n)) for start in range(0, n, size)]


def shares(n: int, count: int | None = None) -> list[tuple[int, int]]:
    """Cut n rows into `count` nearly equal ranges; into some for each thread without it."""
    count = _SHARES * thread_count() if count is None else count
    return list(pairwise(round(i * n / count) for i in range(count + 1)))


_team: ContextVar[tuple[ThreadPoolExecutor, int] | None] = ContextVar("_team", default=None)


@contextmanager
def team() -> Iterator[None]:
    """Keep the threads of `in_threads` for all calls inside: starting them costs up to a step."""
    workers = thread_count() - 1  # and the one that calls
    if workers < 1:
        yield
        return
    with ThreadPoolExecutor(workers) as pool:
        token = _team.set((pool, workers))
        try:
            yield
        finally:
            _team.reset(token)


def in_threads(task: Callable[..., Any], arguments: Iterable[tuple[Any, ...]]) -> list[Any]:
    """Return what `task` returns for each tuple of `arguments`, in their order; side by side.

    The threads are those of the `team` around, or end with the call: a process may fork
    afterwards, and several may call at once.
    """
    calls = list(arguments)
    workers = min(thread_count(), len(calls)) if len(calls) > 1 else 1
    if workers <= 1:
        return _one_by_one(task, calls)
    if (members := _team.get()) is not None:
        pool, others = members
        first, *rest = ranges(len(calls), -(-len(calls) // (others + 1)))
        futures = [_begun(pool, _one_by_one, task, calls[slice(*cut)]) for cut in rest]
        results = _one_by_one(task, calls[slice(*first)])
        return results + [result for future in futures for result in future.result()]
    with ThreadPoolExecutor(workers) as pool:
        waiting = [_begun(pool, task, *call) for call in calls]
        try:
            return [done.result() for done in waiting]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)  # nobody wants what has not begun
            raise


def ended_beside(
    begin: Callable[[Argument], Begun],
    end: Callable[[Begun], Result],
    arguments: Iterable[Argument],
) -> Iterator[Result]:
    """Yield what `end` makes of what `begin` returns for each of the `arguments`, in their order.

    Each ends in a thread beside while the next is begun in that of the caller.
    """
    with ThreadPoolExecutor(1) as beside:
        waiting: Future[Result] | None = None
        for argument in arguments:
            begun = begin(argument)
            if waiting is not None:
                yield waiting.result()
            waiting = _begun(beside, copy_context().run, end, begun)
        if waiting is not None:
            yield waiting.result()


def _begun(
    pool: ThreadPoolExecutor, task: Callable[..., Result], *arguments: Any
) -> Future[Result]:
    try:
        return pool.submit(task, *arguments)
    except RuntimeError as error:  # Python's word for a thread whose stack does not fit
        raise MemoryError("no memory for another thread") from error


def _one_by_one(task: Callable[..., Any], calls: list[tuple[Any, ...]]) -> list[Any]:
    return [task(*call) for call in calls]


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
            _take_control()
            _limit = _controller().limit(limits=1)
        _depth += 1
    try:
        yield
    finally:
        with _lock:
            _depth -= 1
            if _depth == 0:
                _take_control()
                _limit.restore_original_limits()
                _limit = None


@contextmanager
def single_threaded() -> Iterator[None]:
    """Keep to one thread inside: others work beside this process."""
    token = _alone.set(True)
    try:
        with single_threaded_blas():
            yield
    finally:
        _alone.reset(token)


def _take_control() -> None:
    """Let this thread set limits: threadpoolctl heeds the first one that did, and no other."""
    for library in _controller().lib_controllers:
        if library.internal_api == "openblas":
            library.clear_controlling_thread(force=True)


def blas_threads_for(entries: int) -> AbstractContextManager[None]:
    """Keep BLAS to one thread inside where the largest block has few `entries`.

    Sharing such blocks out can gain little, and costs as much as the machine is busy, or has cores
    that the process may not use: hundreds of times the work itself. Larger ones get the threads
    that the environment asks for.
    """
    return nullcontext() if entries > WORTH_SHARING else single_threaded_blas()


@cache
def _controller() -> Any:
    """Find the BLAS libraries of NumPy and SciPy, once: it takes longer than a small product.

    And no others: what limits these would set OpenMP's threads, which torch counts, as it leaves.
    """
    import scipy.linalg  # noqa: F401  (has a BLAS of its own)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")
