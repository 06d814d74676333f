"""Other devices than NumPy's, by torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spectra_kit.errors import MissingDependencyError

if TYPE_CHECKING:
    import torch


def checked_device(name: str) -> torch.device:
    """Return the device of this name, if torch is there and can compute in float64 on it."""
    try:
        import torch  # noqa: F401

        from spectra_kit.linalg.torch_device import check_device
    except ImportError as error:
        raise MissingDependencyError(
            f"`device` must be 'cpu' without PyTorch, got {name!r}: pip install torch"
        ) from error
    return check_device(name)
