"""The process that draws, kept for the next pictures: to start it takes longer than to draw."""

from __future__ import annotations

import atexit
import json
import os
import pickle
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from spectra_kit._files import cleaned
from spectra_kit.errors import MissingDependencyError

_WORKER = Path(__file__).with_name("worker.py")
_PATIENCE = 10.0  # seconds for a worker to end by itself


def draw_requests(folder: Path, count: int, drawn: Callable[[int], None]) -> None:
    """Let the requests in a folder be drawn, and the pictures be written beside them.

    Parameters
    ----------
    folder : Path
        With ``request0.npz`` and so on; ``pictures0.npy`` and so on are written.
    count : int
        How many requests there are.
    drawn : callable
        Called after each picture with the number of those drawn.

    Raises
    ------
    MissingDependencyError
        If there is no OpenGL library that PyVista can draw with.
    Exception
        What the process that draws raised itself, with its traceback as a note.
    """
    mine = _of_this_process()
    error: Exception | None = None
    with mine.turn:
        for drawer in mine.drawers():
            able, mine.drawer = drawer is mine.drawer, None
            end = drawer.draw(folder, count, drawn)
            if end == "done":
                mine.drawer = drawer
                return
            code, complaints = drawer.end()
            if end == "error":
                error = pickle.loads((folder / "error.pickle").read_bytes())
                error.add_note(f"It was raised in the process that draws:\n{complaints}")
                if able:  # it has drawn others: no other way to draw would help
                    break
    if error is not None:
        raise error
    # Libraries that are not there cannot be imported; VTK without a window dies by a signal.
    reason = complaints.split("\n")[-1] if code == 1 else "it crashed"
    raise MissingDependencyError(
        f"PyVista could not draw ({reason}); it needs an OpenGL library but no display,"
        " on Debian or Ubuntu: apt-get install libegl1 libgl1"
    )


class _Drawer:
    """A running worker. It ends with this process, or when it has nothing to draw for a while."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._complaints = tempfile.TemporaryFile("w+")  # noqa: SIM115  # as long as the process
        self._process = subprocess.Popen(
            # -P: the folder of the worker must not shadow other modules.
            [sys.executable, "-P", str(_WORKER)],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._complaints,
            text=True,
        )

    def draw(self, folder: Path, count: int, drawn: Callable[[int], None]) -> str:
        """Ask for pictures; return "done", "error", or nothing where the process has ended."""
        asked, told = self._process.stdin, self._process.stdout
        assert asked is not None  # they are pipes
        assert told is not None
        number, waiting = 0, True
        # Also on Ctrl-C: nobody waits for the pictures any more.
        with cleaned(lambda: self._kill() if waiting else None):
            try:
                asked.write(json.dumps([str(folder), count]) + "\n")
                asked.flush()
                while (line := told.readline()) == "picture\n":
                    number += 1
                    drawn(number)
            except BrokenPipeError:
                line = ""
            waiting = False
        return line.strip()

    def _kill(self) -> None:
        self._process.kill()
        self.end()

    def end(self) -> tuple[int, str]:
        """Let it end; return its exit code, and what it had to complain of."""
        with suppress(BrokenPipeError):
            self._process.stdin.close()  # type: ignore[union-attr]  # a pipe
        try:
            code = self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        self._process.stdout.close()  # type: ignore[union-attr]
        with self._complaints:
            self._complaints.seek(0)
            return code, self._complaints.read().strip()


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
