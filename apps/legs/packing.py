"""What travels to a machine without network: packages that training needs, and real meshes."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path

#: What training needs beside torch, NumPy and SciPy, which such machines have.
NEEDED = (
    *("lazy-loader", "libigl", "llvmlite", "numba", "robust_laplacian"),
    *("safetensors", "threadpoolctl"),
)
POOL = "pool_{}.npz"  # in the packed folder, by split
_GLIBCS = ("2_28", "2_27", "2_24", "2_17")


def download_wheels(folder: Path, python: str, *, machine: str = "x86_64") -> list[Path]:
    """Fetch what training needs, as installed here, for Linux and this version of Python."""
    from spectra_kit.errors import MissingDependencyError

    target = folder / python
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
    command += ["--only-binary=:all:", "--implementation", "cp", "--python-version", python]
    for glibc in _GLIBCS:
        command += ["--platform", f"manylinux_{glibc}_{machine}"]
    command += ["--platform", f"manylinux2014_{machine}", "--dest", str(target)]
    command += [f"{name}=={version(name)}" for name in NEEDED]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise MissingDependencyError(
            f"pip could not download {', '.join(NEEDED)} for Python {python} on {machine}:"
            f" {done.stderr.strip()}"
        )
    return sorted(target.glob("*.whl"))


def use_wheels(folder: Path) -> None:
    """Make the wheels for this Python importable, before what is installed; unpack them once.

    What is installed may be older than what training needs.
    """
    wheels = folder / f"{sys.version_info.major}.{sys.version_info.minor}"
    site, part = wheels / "unpacked", wheels / "unpacking"
    if wheels.is_dir() and not site.is_dir():
        for wheel in wheels.glob("*.whl"):
            with zipfile.ZipFile(wheel) as archive:
                archive.extractall(part)
        part.rename(site)
    if site.is_dir():
        sys.path.insert(0, str(site.resolve()))  # processes that are spawned inherit it


def pack_pools(meshes: Path, folder: Path) -> list[Path]:
    """Write each split of a folder of real meshes into one small file."""
    from spectra_kit.neo.train.pool import pack_pool

    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for split in ("train", "val"):
        files.append(folder / POOL.format(split))
        pack_pool(meshes, files[-1], split)
    return files
