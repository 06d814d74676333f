"""`Neo`: eigenpairs from a forward pass of the neural operator and a small dense problem."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Floats
from spectra_kit._sparse.blocks import device_clock, device_memory
from spectra_kit.eigen.base import Eigenpairs, Promise, block_size
from spectra_kit.eigen.cascade import Cascade
from spectra_kit.eigen.dense import Dense
from spectra_kit.eigen.subspaces.base import GivenBasis
from spectra_kit.operators.laplacian import Laplacian

if TYPE_CHECKING:
    import torch

    from spectra_kit.eigen.multigrid.cascade import Smoothed
    from spectra_kit.neo import NeoSubspace


@checked
@dataclass(frozen=True, kw_only=True, repr=False)
class Neo(Rebuilt):
    """The Neural Eigenspace Operator: predicts a subspace, then Rayleigh-Ritz on the same device.

    Approximate; the certificate says by how much, but not whether a mode was passed over of which
    the basis holds nothing, as on plates far thinner than long (`verify` shows it). Every connected
    component is predicted on its own, in its own canonical frame. Components with at most twice as
    many points as the subspace has functions are solved exactly by LAPACK.

    Parameters
    ----------
    weights : str or path, default "small"
        Name of shipped weights (`neo.pretrained.WEIGHTS`), or a ``.safetensors`` file. ``"base"``
        is a larger network: its functions miss a fifth less, at 1.7 times the time on a CPU.
    poses : {1, 2, 4}, default 1
        Sign flips of the canonical frame to predict in; the bases are joined.
    device : str or torch.device, default "cpu"
        "cpu" or "cuda"; never chosen for you.
    dtype : {"float32", "bfloat16", "float16"}, default "float32"
        Of the network. The eigenpairs are those of its basis in float64.
    chunk : int, default 65536
        Points whose temporaries are held at a time.
    coarsest : int, optional
        Points of a component that the network sees at most, well spread over the surface; the modes
        are carried to all others level by level, as `Cascade` does. Without it, and where there are
        fewer than twice as many points, the network sees all.
    max_steps, target, rank_tol
        As of `Cascade`. 0 steps leave the modes as they were predicted.

    Raises
    ------
    WeightsError
        If the weights are unknown, missing or damaged.

    References
    ----------
    *Learning Laplacian Eigenspace with Mass-Aware Neural Operators on Point Clouds*, SIGGRAPH 2026.

    Examples
    --------
    >>> from spectra_kit import Neo, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import creature
    >>> laplacian = robust_laplacian(creature(3000, seed=0))
    >>> exact, predicted = eigensolve(laplacian, 96), eigensolve(laplacian, 96, Neo())
    >>> bool(abs(predicted.eigenvalues[1:] / exact.eigenvalues[1:] - 1).mean() < 0.02)
    True
    """

    promise: ClassVar[Promise] = "approximate"
    of_surfaces: ClassVar[bool] = True
    weights: str | os.PathLike[str] = "small"
    poses: Literal[1, 2, 4] = 1
    device: str | torch.device = "cpu"
    dtype: Literal["float32", "bfloat16", "float16"] = "float32"
    chunk: int = 65536
    coarsest: int | None = None
    max_steps: int = 20
    target: float = 1e-3
    rank_tol: float = 1e-10

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", str(self.device))
        _ = self._cascade  # checks the options, and that the weights exist

    def __repr__(self) -> str:
        some = "" if self.coarsest is None else f"coarsest={self.coarsest}, "
        return (
            f"Neo({self.subspace!r}, {some}max_steps={self.max_steps}, target={self.target:g},"
            f" rank_tol={self.rank_tol:g})"
        )

    @cached_property
    def subspace(self) -> NeoSubspace:
        """The network as a subspace, for `Union`, `RayleighRitz` or as point features."""
        from spectra_kit.neo import NeoSubspace

        return NeoSubspace(
            self.weights,
            poses=self.poses,
            dtype=self.dtype,
            device=str(self.device),
            chunk=self.chunk,
        )

    @cached_property
    def _cascade(self) -> Cascade:
        """What carries the prediction to all points, and smooths it there."""
        return Cascade(
            subspace=self.subspace,
            target=self.target,
            coarsest=sys.maxsize if self.coarsest is None else self.coarsest,
            max_steps=self.max_steps,
            device=str(self.device),
            rank_tol=self.rank_tol,
        )

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`; on a device this is a batch of one."""
        if str(self.device) == "cpu":
            return self._alone(laplacian, k)
        try:
            (found,) = self.begin([laplacian], k)
        except MemoryError:  # rows in blocks take less
            return self._alone(laplacian, k)
        return found()

    def _alone(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        if self._is_small(laplacian):
            return Dense().eigenpairs(laplacian, k)._replace(errors=np.zeros(k))
        return self._cascade.eigenpairs(laplacian, k)

    def begin(self, laplacians: Sequence[Laplacian], k: int) -> list[Callable[[], Eigenpairs]]:
        """See `Eigensolver.begin`: the functions of all come from one forward pass.

        On a device all else is one batch as well.
        """
        rest: list[Callable[[], Eigenpairs]] = [
            partial(self._alone, laplacian, k) for laplacian in laplacians
        ]
        whole = [
            i
            for i, laplacian in enumerate(laplacians)
            if self.coarsest is None
            and laplacian.consistent_mass is None  # batches know none
            and not self._is_small(laplacian)
        ]
        clouds = [laplacians[i].points for i in whole], [laplacians[i].mass for i in whole]
        if str(self.device) != "cpu":
            # More modes than functions are refused one by one.
            if whole and k <= self.subspace.n_functions and self.subspace._pads(clouds[0]):
                for i, left in self._together(laplacians, whole, clouds, k):
                    rest[i] = left
            return rest
        start = time.perf_counter()
        with device_memory():
            columns = [basis.cpu().numpy() for basis in self.subspace.predict_many(*clouds)]
        share = (time.perf_counter() - start) / max(len(whole), 1)
        for i, own in zip(whole, columns, strict=True):
            rest[i] = partial(self._predicted, laplacians[i], k, own, share)
        return rest

    def _together(
        self,
        laplacians: Sequence[Laplacian],
        whole: Sequence[int],
        clouds: tuple[list[Floats], list[Floats]],
        k: int,
    ) -> Iterator[tuple[int, Callable[[], Eigenpairs]]]:
        """Yield what is left to do for those of the `whole` operators that one batch has solved."""
        from torch.linalg import LinAlgError  # type: ignore[attr-defined]

        from spectra_kit.eigen.multigrid.batched import predicted_and_smoothed

        found: list[Smoothed | None] = [None] * len(whole)
        clock, keep = device_clock(self.device), block_size(k, self._cascade.guard / 2)
        some = [laplacians[i] for i in whole]
        with device_memory():
            basis = self.subspace._padded(*clouds)
            clock.stage("subspace")
            with suppress(LinAlgError):  # of which LAPACK does not say whose matrix it is
                found = predicted_and_smoothed(
                    some,
                    basis,
                    k,
                    keep=keep,
                    target=self.target,
                    max_steps=self.max_steps,
                    rank_tol=self.rank_tol,
                    clock=clock,
                )
        share = {stage: seconds / len(whole) for stage, seconds in clock.seconds.items()}
        for i, laplacian, own in zip(whole, some, found, strict=True):
            if own is not None:
                yield i, partial(self._found, laplacian, own, k, share)

    def _found(
        self, laplacian: Laplacian, found: Smoothed, k: int, spent: dict[str, float]
    ) -> Eigenpairs:
        """Tell what a batch has found of an operator; a copy: the next batch takes its memory."""
        own = found._replace(eigenvectors=np.array(found.eigenvectors))
        return self._cascade._told(laplacian, own, k, Clock(spent=spent))

    def _predicted(
        self, laplacian: Laplacian, k: int, basis: NDArray[np.float32], seconds: float
    ) -> Eigenpairs:
        """Go on from the functions of the network, which took so many `seconds`."""
        pairs = replace(self._cascade, subspace=GivenBasis(basis)).eigenpairs(laplacian, k)
        stages = dict(pairs.seconds or {})
        return pairs._replace(seconds=stages | {"subspace": stages["subspace"] + seconds})

    def _is_small(self, laplacian: Laplacian) -> bool:
        """Whether to solve it exactly: there is nothing to gain from a guess."""
        return laplacian.n <= 2 * self.subspace.n_functions
