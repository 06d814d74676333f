"""The process that draws, kept for the next pictures: to start it takes longer than to draw."""

from __future__ import annotations

import atexit
import os
import pickle
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit._core.files import cleaned
from spectra_kit._core.types import Bytes
from spectra_kit.errors import MissingDependencyError

_WORKER = Path(__file__).with_name("worker.py")
_PATIENCE = 10.0  # seconds for a worker to end by itself


def draw_requests(
    requests: Sequence[Mapping[str, Any]], drawn: Callable[[int], None]
) -> list[Bytes]:
    """Return the pictures of all requests as `worker.draw` takes them; count those `drawn`.

    What the process that draws raises is raised here, with its traceback as a note.
    """
    mine, reason = _of_this_process(), ""
    with mine.turn:
        for drawer in mine.drawers():
            mine.drawer = None
            answer = drawer.draw(requests, drawn)
            if isinstance(answer, str):
                reason = answer
                continue
            mine.drawer = drawer
            if isinstance(answer, Exception):
                raise answer
            return answer
    raise MissingDependencyError(
        f"PyVista could not draw ({reason}); it needs an OpenGL library but no display,"
        " on Debian or Ubuntu: apt-get install libegl1 libgl1"
    )


class _Drawer:
    """A running worker. It ends with this process, or when it has nothing to draw for a while."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._complaints = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115  # as long as the process
        self._process = subprocess.Popen(
            # -P: the folder of the worker must not shadow other modules.
            [sys.executable, "-P", str(_WORKER)],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._complaints,
        )

    def draw(
        self, requests: Sequence[Mapping[str, Any]], drawn: Callable[[int], None]
    ) -> list[Bytes] | Exception | str:
        """Ask for pictures; return them, or the error that came instead, or why it has ended."""
        asked, told = self._process.stdin, self._process.stdout
        assert asked is not None  # they are pipes
        assert told is not None
        pictures: list[Bytes] = []
        waiting = True
        # Also on Ctrl-C: nobody waits for the pictures any more.
        with cleaned(lambda: self._kill() if waiting else None):
            try:
                pickle.dump(requests, asked, protocol=5)
                asked.flush()
                while isinstance(answer := pickle.load(told), np.ndarray):
                    pictures.append(answer)
                    drawn(len(pictures))
            except (BrokenPipeError, EOFError):
                answer = self.end()
            waiting = False
        return pictures if answer is None else answer

    def _kill(self) -> None:
        self._process.kill()
        self.end()

    def end(self) -> str:
        """Let it end, and say why it did."""
        busy = RuntimeError  # a signal has come while this process writes or reads
        with suppress(BrokenPipeError, busy):
            self._process.stdin.close()  # type: ignore[union-attr]  # a pipe
        try:
            code = self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        with suppress(busy):
            self._process.stdout.close()  # type: ignore[union-attr]
        with self._complaints:
            self._complaints.seek(0)
            # What is not there cannot be imported; VTK without a window dies by a signal.
            told = self._complaints.read().strip().split("\n")[-1]
        return told if code == 1 else "it crashed"


class _Mine:
    """The worker of one process, and whose turn it is to draw."""

    def __init__(self) -> None:
        self.turn = threading.Lock()
        self.drawer: _Drawer | None = None

    def drawers(self) -> Iterator[_Drawer]:
        """Yield the one that has drawn before, then new ones with all there is to try."""
        if self.drawer is not None:
            yield self.drawer
        # On Linux first a context without a display, then whatever VTK prefers.
        own = dict(os.environ)
        own.pop("MPLBACKEND", None)  # PyVista imports Matplotlib, and draws by VTK
        if sys.platform.startswith("linux") and "VTK_DEFAULT_OPENGL_WINDOW" not in own:
            yield _Drawer(own | {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"})
        yield _Drawer(own)


_by_process: dict[int, _Mine] = {}  # a fork must not share the worker of its parent


def _of_this_process() -> _Mine:
    return _by_process.setdefault(os.getpid(), _Mine())


@atexit.register
def end_drawing() -> None:
    """End the process that draws, if there is one; the next picture starts another."""
    mine = _of_this_process()
    if mine.drawer is not None:
        mine.drawer.end()
        mine.drawer = None
