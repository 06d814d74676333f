"""Other devices than NumPy's, by torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spectra_kit.errors import InvalidInputError, MissingDependencyError

if TYPE_CHECKING:
    import torch


def checked_device(name: str) -> torch.device:
    """Return the device of this name, if torch is there and can compute in float64 on it."""
    try:
        import torch
    except ImportError as error:
        raise MissingDependencyError(
            f"`device` must be 'cpu' without PyTorch, got {name!r}: pip install torch"
        ) from error
    try:
        device = torch.device(name)
        torch.ones(1, dtype=torch.float64, device=device).cpu()
    # Without CUDA torch raises AssertionError, for an unknown name RuntimeError, and TypeError
    # where there is no float64.
    except (RuntimeError, AssertionError, TypeError) as error:
        reason = str(error).partition("\n")[0]
        raise InvalidInputError(
            f"`device` must be one on which torch can use float64 here, got {name!r} ({reason});"
            " try 'cpu'"
        ) from error
    return device
