"""What is measured: subspaces with a name, and everything that decides what they return."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from spectra_kit._types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo import NeoSubspace
from spectra_kit.neo.pretrained import load_pretrained
from spectra_kit.subspaces import AmbientFourier, Subspace, Union

Precision = Literal["float32", "bfloat16", "float16"]


@dataclass(frozen=True, eq=False)
class Weights:
    """A trained network by its name or file.

    Attributes
    ----------
    source : str or path
        As `neo.load_pretrained` takes it.
    """

    source: str | os.PathLike[str]

    @property
    def label(self) -> str:
        """Name of shipped weights, or the file's without suffix, or its run's."""
        path = Path(self.source)
        # The trainer calls all its files so; the folder tells the runs apart.
        return path.resolve().parent.name if path.name == "weights.safetensors" else path.stem

    @cached_property
    def sha256(self) -> str:
        """Of the file."""
        return load_pretrained(self.source).sha256

    @cached_property
    def m(self) -> int:
        """Functions that the network predicts in one pose."""
        return load_pretrained(self.source).config.m


def check_names(weights: Sequence[Weights]) -> None:
    """Raise InvalidInputError if two networks would be called the same in tables."""
    names = [w.label for w in weights]
    if len(set(names)) < len(names):
        raise InvalidInputError(
            f"`weights` must have different names, got {names}; rename the files"
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Method:
    """A subspace to solve in.

    Attributes
    ----------
    name : str
        For tables and figures.
    key : dict of str to object
        Everything that decides the basis and the time it takes, as JSON.
    subspace : Subspace
        The constant function is among its columns.
    columns : int
        Of the basis.
    device : str
        Where the algebra runs, and the network.
    poses : int
        In how many a network predicts; 0 without one.
    """

    name: str
    key: dict[str, object]
    subspace: Subspace
    columns: int
    device: str = "cpu"
    poses: int = 0
    # Loading the weights and the first kernel launches are no part of any solve.
    _warm: list[bool] = field(default_factory=list, init=False, repr=False)

    def basis(self, points: Floats, mass: Floats) -> torch.Tensor:
        """Return the basis on the device, shape (n, columns)."""
        if isinstance(self.subspace, NeoSubspace):  # its basis need not leave the device
            return self.subspace.predict(points, mass, self.subspace.frame(points, mass))
        basis = np.require(
            self.subspace(points, mass), requirements=["C", "W"]
        )  # as torch needs it
        return torch.from_numpy(basis).to(self.device)

    def warm_up(self) -> None:
        """Run once on a few points, so that a first measurement times like the next."""
        if not self._warm:
            self.basis(np.random.default_rng(0).standard_normal((64, 3)), np.ones(64))
            self._warm.append(True)


@dataclass(frozen=True)
class UnweightedAttention:
    """A network that is told that all points weigh the same; only the frame knows better.

    Attributes
    ----------
    network : NeoSubspace
        Asked with masses of one.
    """

    network: NeoSubspace

    def __call__(self, points: Floats, mass: Floats) -> NDArray[np.float32]:
        """See `Subspace`."""
        frame = self.network.frame(points, mass)
        return np.asarray(self.network.predict(points, np.ones(len(points)), frame).cpu().numpy())


def neo(
    weights: Weights,
    *,
    poses: Literal[1, 2, 4] = 1,
    dtype: Precision = "float32",
    device: str = "cpu",
    weighted: bool = True,
    name: str | None = None,
) -> Method:
    """Return a trained network as a method.

    Parameters
    ----------
    weights : Weights
        Which network.
    poses : {1, 2, 4}, default 1
        As `Neo` takes it.
    dtype : {"float32", "bfloat16", "float16"}, default "float32"
        Of the network.
    device : str, default "cpu"
        Of the network and the algebra.
    weighted : bool, default True
        False gives the attention masses of one (frame and Rayleigh-Ritz keep the true ones).
    name : str, optional
        By default the weights and the number of poses.

    Returns
    -------
    Method
        Its basis is that of `neo.NeoSubspace`.

    Examples
    --------
    >>> from spectra_kit.evaluation import Weights, neo
    >>> method = neo(Weights("small"), poses=2)
    >>> method.name, method.columns
    ('neo small, 2 poses', 513)
    """
    subspace = NeoSubspace(weights.source, poses=poses, dtype=dtype, device=device)
    options = {"poses": poses, "dtype": dtype, "weighted": weighted, "device": device}
    return Method(
        name=name or f"neo {weights.label}, {poses} pose{'s' * (poses > 1)}",
        key={"neo": weights.sha256, **options},
        subspace=subspace if weighted else UnweightedAttention(subspace),
        columns=1 + poses * weights.m,
        device=device,
        poses=poses,
    )


def fourier(m: int, bandwidth: float, *, device: str = "cpu") -> Method:
    """Return `AmbientFourier` as a method.

    Parameters
    ----------
    m : int
        Functions.
    bandwidth : float
        See `AmbientFourier`; the best one grows with m.
    device : str, default "cpu"
        Of the algebra.

    Returns
    -------
    Method
        With m columns.

    Examples
    --------
    >>> from spectra_kit.evaluation import fourier
    >>> fourier(193, 7.0).name
    'fourier m=193, bandwidth 7'
    """
    return Method(
        name=f"fourier m={m}, bandwidth {bandwidth:g}",
        key={"fourier": m, "bandwidth": bandwidth, "device": device},
        subspace=AmbientFourier(m=m, bandwidth=bandwidth),
        columns=m,
        device=device,
    )


def joined(parts: Sequence[Method]) -> Method:
    """Return the union of the subspaces of several methods as one.

    Parameters
    ----------
    parts : sequence of Method
        On one device.

    Returns
    -------
    Method
        With the columns of all.

    Examples
    --------
    >>> from spectra_kit.evaluation import fourier, joined
    >>> joined([fourier(40, 5.0), fourier(60, 9.0)]).columns
    100
    """
    return Method(
        name=" + ".join(part.name for part in parts),
        key={"union": [part.key for part in parts]},
        subspace=Union(*(part.subspace for part in parts)),
        columns=sum(part.columns for part in parts),
        device=parts[0].device,
        poses=max(part.poses for part in parts),
    )
