"""`Worker`: a handle on a process that measures, with limits of time and memory."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any

_POLL = 0.1  # seconds between two looks at the clock and the memory
# Every library of threads that a method may use; the same for all.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class StoppedError(Exception):
    """The process was stopped for a limit, or ended by itself."""


class Worker:
    """A child process of `spectra_kit.benchmarks.worker`.

    Parameters
    ----------
    threads : int
        For every library that counts them.
    log : file
        Where its stderr goes.

    Examples
    --------
    >>> import tempfile
    >>> from spectra_kit.benchmarks.process import Worker
    >>> with tempfile.TemporaryFile() as log, Worker(threads=1, log=log) as worker:
    ...     worker.ask({"do": "solve", "keep": False}, seconds=0.0)
    Traceback (most recent call last):
    spectra_kit.benchmarks.process.StoppedError: took more than 0 s
    """

    def __init__(self, *, threads: int, log: IO[bytes]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "spectra_kit.benchmarks.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            env={**os.environ, **dict.fromkeys(_THREADS, str(threads))},
            start_new_session=True,  # Ctrl-C is for the parent, which ends it in order
        )

    def ask(
        self, request: dict[str, Any], *, seconds: float, memory: int | None = None
    ) -> dict[str, Any]:
        """Send a request and wait for the answer.

        Parameters
        ----------
        request : dict
            As JSON.
        seconds : float
            How long to wait.
        memory : int, optional
            Bytes that the process may hold.

        Returns
        -------
        dict
            The answer.

        Raises
        ------
        StoppedError
            If a limit was reached, or the process ended; it is gone then.
        """
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        try:
            stdin.write(json.dumps(request).encode() + b"\n")
            stdin.flush()
        except BrokenPipeError:
            raise StoppedError(self._last_words()) from None
        deadline = time.monotonic() + seconds
        with selectors.DefaultSelector() as selector:
            selector.register(stdout, selectors.EVENT_READ)
            while not selector.select(min(_POLL, seconds)):
                if time.monotonic() > deadline:
                    self.close()
                    raise StoppedError(f"took more than {seconds:g} s")
                if memory is not None and (held := self._resident()) > memory:
                    self.close()
                    raise StoppedError(
                        f"held {held / 1e9:.1f} GB, more than the {memory / 1e9:.1f} GB allowed"
                    )
        line = stdout.readline()
        if not line:
            raise StoppedError(self._last_words())
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """End the process at once; harmless if it has ended."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None and not stream.closed:
                with suppress(BrokenPipeError):  # what it had not read is lost
                    stream.close()

    def __enter__(self) -> Worker:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _last_words(self) -> str:
        code = self._process.wait()
        self.close()
        if code == -signal.SIGKILL:
            return "the process was killed, as systems do when memory ends"
        return f"the process ended with code {code}"

    def _resident(self) -> int:
        """Bytes that the process holds, 0 where the system does not say."""
        try:
            pages = Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]
        except (OSError, IndexError):
            return 0
        return int(pages) * os.sysconf("SC_PAGE_SIZE")
