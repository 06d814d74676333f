"""Packages that users may go without: the extras of pyproject, imported where they are needed."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from spectra_kit.errors import MissingDependencyError

_PACKAGES = {  # extra -> what pip calls the package
    "batch": "distributed",
    "backbones": "torch_geometric",
    "brain": "nibabel",
    "learn": "scikit-learn",
    "meshio": "meshio",
    "tensorboard": "tensorboard",
    "video": "imageio-ffmpeg",
}


def optional(module: str, *, extra: str, needed_by: str, otherwise: str = "") -> ModuleType:
    """Import a module that an extra of spectra_kit installs.

    If it is not there, say what `needed_by` names cannot be done, and what can be done `otherwise`.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingDependencyError(
            f"{needed_by} needs {_PACKAGES[extra]}",
            advice=f"pip install 'spectra_kit[{extra}]'" + (otherwise and f"; or {otherwise}"),
        ) from error
