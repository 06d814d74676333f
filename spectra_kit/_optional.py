"""Packages that users may go without: the extras of pyproject, imported where they are needed."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from spectra_kit.errors import MissingDependencyError

_PACKAGES = {  # extra -> what pip calls the package
    "amg": "pyamg",
    "backbones": "torch_geometric",
    "tensorboard": "tensorboard",
    "video": "imageio-ffmpeg",
}


def optional(module: str, *, extra: str, needed_by: str, otherwise: str = "") -> ModuleType:
    """Import a module of an optional package.

    Parameters
    ----------
    module : str
        What to import.
    extra : str
        The extra of spectra_kit that installs it.
    needed_by : str
        What cannot be done without it, as the subject of a sentence.
    otherwise : str, optional
        What can be done instead.

    Returns
    -------
    module

    Raises
    ------
    MissingDependencyError
        If it is not installed.

    Examples
    --------
    >>> from spectra_kit._optional import optional
    >>> optional("no_such_module", extra="video", needed_by="an MP4")
    Traceback (most recent call last):
    spectra_kit.errors.MissingDependencyError: an MP4 needs imageio-ffmpeg; pip install
    'spectra_kit[video]'
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingDependencyError(
            f"{needed_by} needs {_PACKAGES[extra]}",
            advice=f"pip install 'spectra_kit[{extra}]'" + (otherwise and f"; or {otherwise}"),
        ) from error
