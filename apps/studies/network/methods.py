"""Subspaces to solve in: a network, plane waves, or several together."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from spectra_kit._core.types import Floats
from spectra_kit.eigen import Cascade, Eigensolver, Neo
from spectra_kit.eigen.subspaces import AmbientFourier
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo import NeoSubspace, load_pretrained

Poses = Literal[1, 2, 4]
Precision = Literal["float32", "bfloat16", "float16"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Method:
    """A subspace with a name."""

    name: str  #: For tables and figures.
    group: Literal["network", "plane waves", "both"]  #: What its functions come from.
    facts: dict[str, Any]  #: Everything that decides the basis and the time it takes, as JSON.
    #: From points and mass to the functions on the device, shape (n, columns); the constant is
    #: among them.
    basis: Callable[[Floats, Floats], torch.Tensor]
    columns: int  #: Of the basis.
    device: str = "cpu"  #: Where the basis lies, and the algebra runs.
    poses: int = 0  #: In how many a network predicts; 0 without one, or where it is not alone.
    #: What solves, where the modes are smoothed after Rayleigh-Ritz in the basis.
    solver: Eigensolver | None = None

    def __str__(self) -> str:
        return self.name


def network(
    weights: str,
    *,
    poses: Poses = 1,
    dtype: Precision = "float32",
    weighted: bool = True,
    steps: int = 0,
    device: str = "cpu",
) -> Method:
    """Return a trained network as a method, by its name or file.

    If it is not `weighted`, the attention gets masses of one; frame and Rayleigh-Ritz keep the
    true ones. With `steps` of smoothing at most, it is `Neo`.
    """
    subspace = NeoSubspace(weights, poses=poses, dtype=dtype, device=device)

    def basis(points: Floats, mass: Floats) -> torch.Tensor:
        frame = subspace.frame(points, mass)
        return subspace.predict(points, mass if weighted else np.ones(len(mass)), frame)

    options = {"poses": poses, "dtype": dtype, "weighted": weighted, "device": device}
    solver = Neo(weights=weights, poses=poses, dtype=dtype, device=device, max_steps=steps)
    return Method(
        name=f"neo {label(weights)}, {poses} pose{'s' * (poses > 1)}{_smoothed(steps)}",
        group="network",
        facts={"neo": load_pretrained(weights).sha256, **options, **_steps(steps)},
        basis=basis,
        columns=1 + poses * functions_of(weights),
        device=device,
        poses=poses,
        solver=solver if steps else None,
    )


def waves(m: int, bandwidth: float, *, steps: int = 0, device: str = "cpu") -> Method:
    """Return `AmbientFourier` as a method: m plane waves; the best bandwidth grows with m.

    With `steps` of smoothing at most, those that `Neo` makes.
    """
    subspace = AmbientFourier(m=m, bandwidth=bandwidth)
    solver = Cascade(subspace=subspace, coarsest=sys.maxsize, max_steps=steps, device=device)

    def basis(points: Floats, mass: Floats) -> torch.Tensor:
        writable = np.require(subspace(points, mass), requirements=["C", "W"])  # as torch needs it
        return torch.from_numpy(writable).to(device)

    return Method(
        name=f"fourier m={m}, bandwidth {bandwidth:g}{_smoothed(steps)}",
        group="plane waves",
        facts={"fourier": m, "bandwidth": bandwidth, "device": device, **_steps(steps)},
        basis=basis,
        columns=m,
        device=device,
        solver=solver if steps else None,
    )


def joined(parts: Sequence[Method]) -> Method:
    """Return the functions of several methods of one device together."""
    return Method(
        name=" + ".join(part.name for part in parts),
        group="both",
        facts={"union": [part.facts for part in parts]},
        basis=lambda points, mass: torch.cat([part.basis(points, mass) for part in parts], dim=1),
        columns=sum(part.columns for part in parts),
        device=parts[0].device,
    )


def _smoothed(steps: int) -> str:
    if steps == 1:
        return ", one step"
    return f", smoothed in at most {steps} steps" if steps else ""


def _steps(steps: int) -> dict[str, int]:
    return {"steps": steps} if steps else {}  # none: as it was before there were any


def functions_of(weights: str) -> int:
    """Return how many functions a network predicts in one pose."""
    return load_pretrained(weights).config.m


def label(weights: str) -> str:
    """Name of shipped weights, or the file's without suffix, or its run's."""
    path = Path(weights)
    # The trainer calls all its files so; the folder tells the runs apart.
    return path.resolve().parent.name if path.name == "weights.safetensors" else path.stem


def check_labels(weights: Sequence[str]) -> None:
    """Raise InvalidInputError if two networks would be called the same in tables."""
    names = [label(one) for one in weights]
    if len(set(names)) < len(names):
        raise InvalidInputError(
            "weights", "have different names", str(names), advice="rename the files"
        )
