"""Packages for a machine without network: wheels in a folder, unpacked without an installer."""

from __future__ import annotations

import importlib.util
import os
import platform
import re
import subprocess
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path

from spectra_kit.errors import MissingDependencyError

#: What training needs beside torch, NumPy and SciPy, which such machines have.
NEEDED = ("numba", "llvmlite", "cholespy", "qdldl", "threadpoolctl")
_GLIBCS = ("2_28", "2_27", "2_24", "2_17")


def fits(wheel: str, *, python: tuple[int, int], machine: str) -> bool:
    """Return whether a wheel of this file name runs on a Python of this version under Linux.

    Examples
    --------
    >>> from spectra_kit.training.wheels import fits
    >>> fits("a-1.0-cp312-cp312-manylinux_2_17_x86_64.whl", python=(3, 12), machine="x86_64")
    True
    >>> fits("a-1.0-cp311-cp311-manylinux_2_17_x86_64.whl", python=(3, 12), machine="x86_64")
    False
    """
    pythons, abis, platforms = wheel.removesuffix(".whl").split("-")[-3:]
    minors = {
        int(minor)
        for major, minor in re.findall(r"\bcp(\d)(\d+)", pythons.replace(".", " "))
        if int(major) == python[0]
    }
    stable = "abi3" in abis.split(".")
    speaks = "py3" in pythons.split(".") or any(
        minor == python[1] or (stable and minor <= python[1]) for minor in minors
    )
    return speaks and any(
        tag == "any" or ("linux" in tag and tag.endswith("_" + machine))
        for tag in platforms.split(".")
    )


def use_wheels(folder: str | os.PathLike[str]) -> list[str]:
    """Make the packages that training needs importable, from wheels where they are not installed.

    Parameters
    ----------
    folder : path
        Holds ``.whl`` files; those that fit are unpacked beside them, once.

    Returns
    -------
    list of str
        The packages that came from wheels.

    Raises
    ------
    MissingDependencyError
        If a package is neither installed nor there as a wheel that fits.
    """
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if not missing:
        return []
    python, machine = sys.version_info[:2], platform.machine()
    site = Path(folder) / f"unpacked-cp{python[0]}{python[1]}"
    for name in missing:
        found = [path for path in Path(folder).glob("*.whl") if path.name.startswith(f"{name}-")]
        good = [path for path in found if fits(path.name, python=python, machine=machine)]
        if not good:
            raise MissingDependencyError(
                f"training needs the package {name}, which is neither installed nor in {folder} as"
                f" a wheel for Python {python[0]}.{python[1]} on {machine} (found"
                f" {[path.name for path in found]}); run with --pack where there is a network"
            )
        with zipfile.ZipFile(max(good)) as archive:
            archive.extractall(site)
    sys.path.append(str(site.resolve()))  # spawned processes inherit it
    importlib.invalidate_caches()
    return missing


def download_wheels(
    folder: str | os.PathLike[str], *, python: str = "3.12", machine: str = "x86_64"
) -> list[Path]:
    """Fetch wheels of the packages that training needs, in the versions installed here.

    Parameters
    ----------
    folder : path
        Where to; made if missing.
    python, machine : str
        What the other machine runs.

    Returns
    -------
    list of Path
        The wheels in the folder.

    Raises
    ------
    MissingDependencyError
        If pip cannot get one of them.
    """
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
    command += ["--only-binary=:all:", "--implementation", "cp", "--python-version", python]
    for glibc in _GLIBCS:
        command += ["--platform", f"manylinux_{glibc}_{machine}"]
    command += ["--platform", f"manylinux2014_{machine}", "--dest", str(folder)]
    command += [f"{name}=={version(name)}" for name in NEEDED]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise MissingDependencyError(
            f"pip could not download {', '.join(NEEDED)} for Python {python} on {machine}:"
            f" {done.stderr.strip()}"
        )
    return sorted(Path(folder).glob("*.whl"))
