"""Who is told that loops are being compiled, which takes seconds, once, and who helps with it.

Apart from `compiled`, which imports numba.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from spectra_kit._core.threads import thread_count

_told: list[Callable[[bool], object]] = []
_helpers: dict[str, subprocess.Popen[bytes]] | None = None  # by what they run; None: not wanted


@contextmanager
def heard_by(listener: Callable[[bool], object]) -> Iterator[None]:
    """Call `listener` inside the block with True when compiling a loop begins, False when it ends.

    From any thread, one loop at a time.
    """
    _told.append(listener)
    try:
        yield
    finally:
        _told.remove(listener)


def tell(begins: bool) -> None:
    """Tell those who asked for it."""
    for listener in tuple(_told):
        listener(begins)


@contextmanager
def helped() -> Iterator[None]:
    """Let processes beside compile, inside the block, what is needed next.

    For programs that know what their interpreter is: it is run again.
    """
    global _helpers
    _helpers = {}
    try:
        yield
    finally:
        for helper in _helpers.values():
            helper.terminate()
            helper.wait()
        _helpers = None


def help_with(module: str, folder: Path) -> None:
    """Have a process run a module that compiles into `folder`, where a core has nothing to do."""
    if _helpers is None or module in _helpers or thread_count() < 2:
        return
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            nothing = subprocess.DEVNULL
            command = [sys.executable, "-m", module]
            _helpers[module] = subprocess.Popen(
                command, stdin=nothing, stdout=nothing, stderr=nothing
            )


def helped_to(path: Path, module: str) -> bool:
    """Wait for a file while a process that runs `module` may still write it; whether it did."""
    helper = (_helpers or {}).get(module)
    if helper is None:
        return False
    tell(True)
    while helper.poll() is None and not path.exists():
        time.sleep(0.01)
    tell(False)
    return path.exists()
