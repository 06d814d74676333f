"""What a measurement ran on, as far as it decides the figures."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import spectra_kit
from spectra_kit._core.version import VERSION
from studies.store import Record, code_digest

_PACKAGES = (
    *("numpy", "scipy", "torch", "numba", "libigl", "potpourri3d"),
    *("robust_laplacian", "lapy", "pyFM"),
)
_SHARE = 0.85  # of the memory that is available


def describe_machine(
    *, name: str = "", threads: int = 1, device: str = "cpu", commit: str = ""
) -> Record:
    """Return processor, cores, memory, accelerator, versions and commit, as JSON.

    By default the name is what the machine calls itself, and the commit is asked of git. The
    accelerator is named where the device is "cuda".
    """
    return {
        "name": name or platform.node(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": threads,
        "memory_bytes": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        "accelerator": _accelerator() if device.startswith("cuda") else "",
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {
            "spectra_kit": VERSION,
            **{name: found for name in _PACKAGES if (found := _version(name))},
        },
        "commit": commit or current_commit(),
        "code": code_digest(),
    }


def machine_line(machine: Record) -> str:
    """Return what `describe_machine` found as a sentence of Markdown."""
    where = machine["accelerator"] or machine["processor"]
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    return (
        f"{machine['name']}: {where}, {machine['cores']} cores, threads: {machine['threads']};"
        f" commit {machine['commit'] or 'unknown'}, code {machine['code']}; {versions}."
    )


def current_commit() -> str:
    """Return the commit of the working tree, "-dirty" where sources differ, "" outside git."""
    package = str(Path(spectra_kit.__file__).parent)

    def asked(*words: str) -> str:
        command = ["git", "-C", package, *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        head = asked("rev-parse", "--short=12", "HEAD")
        changed = asked("status", "--porcelain", "--untracked-files=no", package)
    except (OSError, subprocess.CalledProcessError):  # no git, or no repository
        return ""
    return head + ("-dirty" if changed else "")


def most_memory() -> float:
    """Return the bytes that one process may take, infinity where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return float("inf")
    fields = dict(line.split(":", 1) for line in lines)
    return _SHARE * int(fields["MemAvailable"].split()[0]) * 1024


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _accelerator() -> str:
    import torch

    return torch.cuda.get_device_name(0) if torch.cuda.is_available() else ""


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
