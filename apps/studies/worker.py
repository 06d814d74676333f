"""Processes that measure: limits of threads, time and memory, and an end with their parent."""

from __future__ import annotations

import gc
import math
import os
import pickle
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any

from spectra_kit.errors import SpectraKitError

#: What libraries raise where a problem is too large or too hard for them; torch and SuperLU raise
#: RuntimeError where memory ends, ARPACK's and LAPACK's errors are RuntimeError and ValueError.
FAILURES = (SpectraKitError, RuntimeError, ValueError, MemoryError, ImportError)
# Every library of threads that may take part.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_POLL = 0.1  # seconds between two looks at the clock and the memory


class FailedError(Exception):
    """A measurement raised one of `FAILURES`."""


class StoppedError(Exception):
    """The process was stopped for a limit, or ended by itself."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a process may use."""

    threads: int = 1  #: For every library that counts them.
    #: For what a measurement clocks (see `clocked`), not for what is around it.
    seconds: float = math.inf
    memory: float = math.inf  #: Bytes.


class Worker:
    """A process that calls functions, one after another, for this one, within limits.

    It leads a group of its own, so Ctrl-C is for the parent, which ends it in order; where the
    parent dies, the whole group ends. What it prints goes to the log.
    """

    def __init__(self, limits: Limits, log: IO[bytes] | int = subprocess.DEVNULL) -> None:
        self._limits = limits
        self._known: Callable[..., Any] | None = None
        self._link, theirs = Pipe()
        modules = os.pathsep.join(path for path in sys.path if path)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", f"from {__name__} import serve; serve({theirs.fileno()})"],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={
                    **os.environ,
                    **dict.fromkeys(_THREADS, str(limits.threads)),
                    "PYTHONPATH": modules,
                },
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )

    def call(self, function: Callable[..., Any], *args: object) -> Any:
        """Call a function there and return its answer; all three can be pickled.

        The function is sent again only if it is not the one of the call before. FailedError says
        that it raised one of `FAILURES`, StoppedError that a limit was reached or the process
        ended; it is gone then.
        """
        try:
            self._link.send((None if function is self._known else function, args))
            self._known = function
            deadline = math.inf
            while True:
                if self._link.poll(max(0.0, min(_POLL, deadline - time.monotonic()))):
                    kind, value = self._link.recv()
                    if kind == "answer":
                        return value
                    if kind == "failure":
                        raise FailedError(value)
                    running = kind == "clock" and value
                    deadline = time.monotonic() + self._limits.seconds if running else math.inf
                elif self._process.poll() is not None and not self._link.poll():
                    # What it has started may hold its end of the link open.
                    raise StoppedError(self._last_words())
                elif time.monotonic() > deadline:
                    self.close()
                    raise StoppedError(f"took more than {self._limits.seconds:g} s")
                elif (held := _resident(self._process.pid)) > self._limits.memory:
                    self.close()
                    allowed = self._limits.memory / 1e9
                    raise StoppedError(
                        f"held {held / 1e9:.1f} GB, more than the {allowed:.1f} GB allowed"
                    )
        except (EOFError, ConnectionError):
            raise StoppedError(self._last_words()) from None

    def kill(self) -> None:
        """End the process and what it has started, at once; harmless if it has ended."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def close(self) -> None:
        """End the process and let go of it."""
        self.kill()
        self._process.wait()
        self._link.close()

    def _last_words(self) -> str:
        code = self._process.wait()
        self.close()
        if code == -signal.SIGKILL:
            return "the process was killed, as systems do when memory ends"
        return f"the process ended with code {code}"


class Pool:
    """Workers side by side; none is started before it is needed.

    With 0 jobs everything runs in this process, without limits. If it is `fresh`, every call has a
    process of its own. What they print goes to the log.
    """

    def __init__(
        self,
        jobs: int,
        limits: Limits,
        *,
        fresh: bool = False,
        log: IO[bytes] | int = subprocess.DEVNULL,
    ) -> None:
        self._limits, self._fresh, self._log = limits, fresh, log
        self._alive: set[Worker] = set()
        self._lock, self._closed = threading.Lock(), False
        self._threads = ThreadPoolExecutor(jobs) if jobs else None
        self._idle: SimpleQueue[Worker | None] = SimpleQueue()
        for _ in range(jobs):
            self._idle.put(None)

    def submit(self, function: Callable[..., Any], *args: object) -> Future[Any]:
        """Return a future of ``function(*args)``; its errors are those of `Worker.call`."""
        if self._threads is not None:
            return self._threads.submit(self._call, function, *args)
        future: Future[Any] = Future()
        try:
            future.set_result(function(*args))
        except FAILURES as error:
            future.set_exception(FailedError(_told(error)))
        return future

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._closed = True
            for worker in self._alive:
                worker.kill()
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)
        for worker in self._alive:
            worker.close()

    def _call(self, function: Callable[..., Any], *args: object) -> Any:
        worker = self._idle.get() or self._started()
        kept = None
        try:
            answer = worker.call(function, *args)
            kept = None if self._fresh else worker
            return answer
        finally:
            if kept is None:
                worker.close()
                with self._lock:
                    self._alive.discard(worker)
            self._idle.put(kept)

    def _started(self) -> Worker:
        with self._lock:
            if self._closed:
                raise StoppedError("the pool was closed")
            worker = Worker(self._limits, self._log)
            self._alive.add(worker)
            return worker


# --- in the process ---

_parent: list[Connection] = []  # of a process that serves


def serve(descriptor: int) -> None:
    """Call what the parent asks for, until it closes the connection or dies."""
    link = Connection(descriptor)
    _parent.append(link)
    requests: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(link, requests), daemon=True).start()
    function: Callable[..., Any] | None = None
    while True:
        try:
            new, args = pickle.loads(requests.get())
            function = new or function
            assert function is not None
            link.send(("answer", function(*args)))
        except FAILURES as error:
            link.send(("failure", _told(error)))


def _listen(link: Connection, requests: SimpleQueue[bytes]) -> None:
    """Take requests also while another is worked on, to notice when there will be no more."""
    with suppress(EOFError, ConnectionError):
        while True:
            requests.put(link.recv_bytes())
    os.killpg(0, signal.SIGKILL)


def _told(error: BaseException) -> str:
    ours = isinstance(error, SpectraKitError)  # whose messages need no type to be understood
    return str(error) if ours else f"{type(error).__name__}: {error}"


class Clocked:
    """What a block took: wall time, and memory above that before."""

    seconds = 0.0
    processor_seconds = 0.0  #: Of all threads: more fit to compare on a busy machine.
    waited_seconds = 0.0  #: In which the main thread could have run but had no core, where known.
    peak_bytes = 0
    device_peak_bytes = 0  #: On the accelerator.


@contextmanager
def clocked(*, device: str = "cpu") -> Iterator[Clocked]:
    """Measure a block, which the parent's limit of seconds holds for."""
    found = Clocked()
    gc.collect()
    resident = _reset_peak(device)
    for link in _parent:
        link.send(("clock", True))
    waited, processor, start = _waited(), time.process_time(), time.perf_counter()
    try:
        yield found
    finally:
        found.seconds = time.perf_counter() - start
        found.processor_seconds = time.process_time() - processor
        found.waited_seconds = _waited() - waited
        found.peak_bytes = max(_peak() - resident, 0)
        if device == "cuda":
            import torch

            found.device_peak_bytes = int(torch.cuda.max_memory_allocated())
        for link in _parent:
            link.send(("clock", False))


def _reset_peak(device: str) -> int:
    """Forget the peak of memory so far and return what is resident now, in bytes."""
    if device == "cuda":
        import torch

        torch.cuda.reset_peak_memory_stats()
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:  # not Linux, or not allowed: the difference of two peaks must do
        return _peak()
    return _resident(os.getpid())


def _peak() -> int:
    status = Path("/proc/self/status")
    if status.exists():
        [line] = [x for x in status.read_text().splitlines() if x.startswith("VmHWM:")]
        return int(line.split()[1]) * 1024
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _resident(process: int) -> int:
    """Bytes that a process holds, 0 where the system does not say."""
    try:
        pages = Path(f"/proc/{process}/statm").read_text().split()[1]
    except (OSError, IndexError):
        return 0
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def _waited() -> float:
    try:
        return int(Path("/proc/self/schedstat").read_text().split()[1]) / 1e9
    except OSError:
        return 0.0
