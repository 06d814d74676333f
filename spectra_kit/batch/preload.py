"""What Dask has each of our workers do as it starts."""

import signal
from typing import Any


def dask_setup(_worker: Any) -> None:
    """Leave Ctrl-C, which a terminal sends to all of its processes, to the one that was called."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
