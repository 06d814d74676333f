"""Subspaces to solve in: a network, plane waves, or several together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from spectra_kit._types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo import NeoSubspace
from spectra_kit.neo.pretrained import load_pretrained
from spectra_kit.subspaces import AmbientFourier

Poses = Literal[1, 2, 4]
Precision = Literal["float32", "bfloat16", "float16"]


class Method(ABC):
    """A subspace by its recipe: methods that are equal measure the same.

    Attributes
    ----------
    device : str
        Where its basis lies, and the algebra runs.
    """

    device: str

    def __str__(self) -> str:
        return self.name

    @property
    @abstractmethod
    def name(self) -> str:
        """For tables and figures."""

    @property
    @abstractmethod
    def columns(self) -> int:
        """Of the basis; the constant function is among them."""

    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """Return everything that decides the basis and the time it takes, as JSON."""

    @abstractmethod
    def basis(self, points: Floats, mass: Floats) -> torch.Tensor:
        """Return the functions on the device, shape (n, columns)."""


@dataclass(frozen=True, kw_only=True)
class Network(Method):
    """A trained network, as `neo.NeoSubspace` takes it.

    Attributes
    ----------
    weights : str
        A name, or a file.
    poses : {1, 2, 4}
        In how many it predicts.
    dtype : {"float32", "bfloat16", "float16"}
        Of the network.
    weighted : bool
        False gives the attention masses of one; frame and Rayleigh-Ritz keep the true ones.
    """

    weights: str
    poses: Poses = 1
    dtype: Precision = "float32"
    weighted: bool = True
    device: str = "cpu"

    @property
    def name(self) -> str:
        """Of the weights, and the number of poses."""
        return f"neo {label(self.weights)}, {self.poses} pose{'s' * (self.poses > 1)}"

    @property
    def m(self) -> int:
        """Functions in one pose."""
        return load_pretrained(self.weights).config.m

    @property
    def columns(self) -> int:
        """The constant, and m for each pose."""
        return 1 + self.poses * self.m

    def facts(self) -> dict[str, Any]:
        """See `Method`; the weights by their hash."""
        return {"neo": {**asdict(self), "weights": load_pretrained(self.weights).sha256}}

    def basis(self, points: Floats, mass: Floats) -> torch.Tensor:
        """See `Method`."""
        network = _loaded(self)
        frame = network.frame(points, mass)
        return network.predict(points, mass if self.weighted else np.ones(len(mass)), frame)


@cache
def _loaded(method: Network) -> NeoSubspace:
    return NeoSubspace(method.weights, poses=method.poses, dtype=method.dtype, device=method.device)


@dataclass(frozen=True, kw_only=True)
class Waves(Method):
    """`AmbientFourier`: m plane waves; the best bandwidth grows with m."""

    m: int
    bandwidth: float
    device: str = "cpu"

    @property
    def name(self) -> str:
        """Their number and bandwidth."""
        return f"fourier m={self.m}, bandwidth {self.bandwidth:g}"

    @property
    def columns(self) -> int:
        """All of them."""
        return self.m

    def facts(self) -> dict[str, Any]:
        """See `Method`."""
        return {"fourier": asdict(self)}

    def basis(self, points: Floats, mass: Floats) -> torch.Tensor:
        """See `Method`."""
        waves = AmbientFourier(m=self.m, bandwidth=self.bandwidth)(points, mass)
        writable = np.require(waves, requirements=["C", "W"])  # as torch needs it
        return torch.from_numpy(writable).to(self.device)


@dataclass(frozen=True)
class Joined(Method):
    """The functions of several methods of one device."""

    parts: tuple[Method, ...]

    @property
    def device(self) -> str:  # type: ignore[override]
        """Of the first."""
        return self.parts[0].device

    @property
    def name(self) -> str:
        """Of all."""
        return " + ".join(part.name for part in self.parts)

    @property
    def columns(self) -> int:
        """Of all."""
        return sum(part.columns for part in self.parts)

    def facts(self) -> dict[str, Any]:
        """See `Method`."""
        return {"union": [part.facts() for part in self.parts]}

    def basis(self, points: Floats, mass: Floats) -> torch.Tensor:
        """See `Method`."""
        return torch.cat([part.basis(points, mass) for part in self.parts], dim=1)


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
