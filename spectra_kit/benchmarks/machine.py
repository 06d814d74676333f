"""What a measurement ran on, as far as it decides the figures."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES: tuple[str, ...] = ("spectra_kit", "numpy", "scipy", "torch", "cholespy", "qdldl")
_PACKAGES += ("numba", "libigl", "robust_laplacian", "pyamg", "lapy")


def describe_machine(*, devices: tuple[str, ...] = ("cpu",)) -> dict[str, object]:
    """Return processor, cores, memory, accelerator and versions, as JSON.

    Parameters
    ----------
    devices : tuple of str, default ("cpu",)
        With "cuda" the accelerator is named too.

    Returns
    -------
    dict
        With an empty string where there is no accelerator.

    Examples
    --------
    >>> from spectra_kit.benchmarks import describe_machine
    >>> sorted(describe_machine())
    ['accelerator', 'cores', 'memory_bytes', 'processor', 'python', 'system', 'versions']
    """
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_bytes": _memory(),
        "accelerator": _accelerator() if "cuda" in devices else "",
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: found for name in _PACKAGES if (found := _version(name))},
    }


def current_commit() -> str:
    """Return the commit of the working tree, "-dirty" where sources differ, "" outside git."""
    here = Path(__file__).parent
    ask = ["git", "-C", str(here)]
    try:
        head = subprocess.run(
            [*ask, "rev-parse", "--short=12", "HEAD"], capture_output=True, text=True, check=True
        ).stdout.strip()
        changed = subprocess.run(
            [*ask, "status", "--porcelain", "--untracked-files=no", str(here.parent)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
    except (OSError, subprocess.CalledProcessError):  # no git, or no repository
        return ""
    return head + ("-dirty" if changed.strip() else "")


def available_memory() -> int | None:
    """Return the bytes that can be taken without swapping; None where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return None
    fields = dict(line.split(":", 1) for line in lines)
    return int(fields["MemAvailable"].split()[0]) * 1024


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _memory() -> int:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _accelerator() -> str:
    import torch

    return torch.cuda.get_device_name(0) if torch.cuda.is_available() else ""


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
