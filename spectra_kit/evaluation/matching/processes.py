"""Processes side by side that end with their parent, or everything in this one."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import Any, TypeVar

from tqdm import tqdm

from spectra_kit.linalg.threads import single_threaded_blas

Item = TypeVar("Item")
Answer = TypeVar("Answer")
Submit = Callable[[Callable[[Any], Any], Any], "Future[Any]"]

# One thread for each pair: processes share the cores, and times of one job are those of many.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_WATCH = 1.0  # seconds between two looks at whether the parent still lives


@contextmanager
def workers(jobs: int, begin: Callable[[Any], None], shared: object) -> Iterator[Submit | None]:
    """Start processes that call ``begin(shared)`` first.

    Parameters
    ----------
    jobs : int
        How many, of one thread each; with 1 this process begins itself, and starts no other.
    begin : callable
        Of a module that can be imported.
    shared : object
        What can be pickled.

    Yields
    ------
    callable or None
        Takes a function and its argument to a process; None where there is none.
    """
    with _one_thread():
        if jobs == 1:
            begin(shared)
            with single_threaded_blas():  # which read the environment as it was loaded
                yield None
            return
        executor = ProcessPoolExecutor(
            jobs,
            mp_context=multiprocessing.get_context("spawn"),
            initializer=_begin,
            initargs=(os.getpid(), begin, shared),
        )
        try:
            yield executor.submit
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Tell the processes that start meanwhile, and the loops of this one, to use one thread."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def done(
    submit: Submit | None,
    function: Callable[[Item], Answer],
    items: Sequence[Item],
    unit: str,
    progress: bool,
) -> Iterator[tuple[Item, Answer]]:
    """Yield each item with its answer as soon as that is there, in any order.

    Parameters
    ----------
    submit : callable or None
        Of `workers`; without it each item waits until the one before has been taken.
    function : callable
        What answers.
    items : sequence
        Its arguments.
    unit : str
        What to call one of them.
    progress : bool
        Show a bar on a terminal.
    """
    with tqdm(total=len(items), unit=unit, disable=None if progress else True) as bar:
        if submit is None:
            for item in items:
                yield item, function(item)
                bar.update()
            return
        futures = {submit(function, item): item for item in items}
        for future in as_completed(futures):
            yield futures[future], future.result()
            bar.update()


def _begin(parent: int, begin: Callable[[Any], None], shared: object) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends them
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    begin(shared)


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH)
    os._exit(1)  # the parent was killed: nobody waits for this
