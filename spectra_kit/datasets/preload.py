"""What Dask has each of our workers do as it starts."""

import os
import signal
from glob import glob
from typing import Any


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C to the process that was called, and take an accelerator of our own.

    A terminal sends Ctrl-C to all of its processes.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if (device := own_device(int(worker.name))) is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = device  # before CUDA is asked for any


def own_device(number: int) -> str | None:
    """Return the CUDA device of a worker of this machine, by turns; None where there is none."""
    told = os.environ.get("CUDA_VISIBLE_DEVICES")
    files = glob("/dev/nvidia[0-9]*")
    devices = [str(i) for i in range(len(files))] if told is None else told.split(",")
    return devices[number % len(devices)] if devices else None
