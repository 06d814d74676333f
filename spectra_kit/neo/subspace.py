"""`NeoSubspace`: a trained network as a subspace, pose and size of the input taken care of."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch.nn.utils.rnn import pad_sequence

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.validate import check_count, check_mass, check_points
from spectra_kit._sparse.torch_device import check_device, torch_threads
from spectra_kit.eigen.subspaces.frame import POSES, Frame, canonical_frame
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.model import NeoNetwork
from spectra_kit.neo.pretrained import find_weights, load_pretrained, weights_digest

_DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}


@checked
@dataclass(frozen=True, repr=False)
class NeoSubspace(Rebuilt):
    """A function of (points, mass) that returns the basis a network predicts.

    The points are first moved into the frame that the network was trained in, so the basis does
    not depend on the position, rotation and unit of the input (up to rounding, where the frame
    of `canonical_frame` is unique). The first column is the constant function: the exact kernel
    of a connected cloud.

    Parameters
    ----------
    network : str, path or NeoNetwork, default "small"
        Name or file of pretrained weights, loaded at the first call; or a network.
    poses : {1, 2, 4}, default 1
        Proper sign flips of the frame to predict in; the bases are joined. Costs as many times
        the time and memory, and covers much of what a single prediction misses.
    dtype : {"float32", "bfloat16", "float16"}, default "float32"
        Precision of weights and activations. Most CPUs emulate the other two, slowly.
    device : str, default "cpu"
        Where to compute.
    chunk : int, default 65536
        Points whose temporaries are held at a time. Smaller clouds go through in one piece.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.neo import NeoConfig, NeoNetwork, NeoSubspace
    >>> subspace = NeoSubspace(NeoNetwork(NeoConfig.named("small")), poses=2)
    >>> points = np.random.default_rng(0).normal(size=(500, 3))
    >>> subspace(points, np.ones(500)).shape
    (500, 513)
    """

    of_surfaces: ClassVar[bool] = True
    network: str | os.PathLike[str] | NeoNetwork = "small"
    poses: Literal[1, 2, 4] = 1
    dtype: Literal["float32", "bfloat16", "float16"] = "float32"
    device: str = "cpu"
    chunk: int = 65536

    def __post_init__(self) -> None:
        check_count("chunk", self.chunk, low=1)
        check_device(self.device)
        if not isinstance(self.network, NeoNetwork):
            find_weights(self.network)

    def __call__(self, points: ArrayLike, mass: ArrayLike) -> NDArray[np.float32]:
        """Predict a basis (n, 1 + poses * m), not orthonormal; the first column is one.

        Points (n, 3) are those of one connected surface, in length. Masses (n,) are positive, in
        length^2; only their ratios matter.
        """
        return np.asarray(self.tensor(points, mass).cpu().numpy())

    def tensor(self, points: ArrayLike, mass: ArrayLike) -> torch.Tensor:
        """Return the same basis as a tensor that stays on `device`."""
        return self.predict(points, mass, self.frame(points, mass))

    def __repr__(self) -> str:
        network = self.network
        named = "<NeoNetwork>" if isinstance(network, NeoNetwork) else repr(os.fspath(network))
        return (
            f"NeoSubspace({named}, poses={self.poses}, dtype={self.dtype!r},"
            f" device={self.device!r}, sha256={weights_digest(network)!r})"
        )

    @property
    def n_functions(self) -> int:
        """Number of columns of the basis: the constant, and m for each pose."""
        return 1 + self.poses * self._model.config.m

    @property
    def principal(self) -> bool:
        """Whether it sees points in their principal frame, in which rotations change nothing."""
        network = self.network if isinstance(self.network, NeoNetwork) else self._model
        return network.config.frame == "principal"

    def functions(self, posed: torch.Tensor, mass: torch.Tensor) -> torch.Tensor:
        """Return the mean over the poses, (b, n, m), at posed points (b, n, 3) of masses (b, n).

        Gradients reach the points, and the weights of a network that was given.
        """
        given = self.network if isinstance(self.network, NeoNetwork) else None
        model = given.to(posed.device) if given else self._model
        place = posed.device if given else self.device
        x, weights = posed.to(place), mass.to(place)
        flips = torch.tensor(POSES[: self.poses]).to(x)
        total: torch.Tensor = sum(model(x * flip, weights) for flip in flips) / self.poses
        return total.to(posed)

    def frame(self, points: ArrayLike, mass: ArrayLike) -> Frame:
        """Return the similarity transform that the network expects."""
        points = check_points("points", points)
        mass = check_mass("mass", mass, len(points))
        if self.principal:
            return canonical_frame(points, mass)
        centre = mass @ points / mass.sum()
        return Frame(centre, np.eye(3), float(np.abs(points - centre).max()))

    @torch.no_grad()
    def predict(self, points: ArrayLike, mass: ArrayLike, frame: Frame) -> torch.Tensor:
        """Return the basis as a float32 tensor of shape (n, 1 + poses * m) on `device`."""
        posed, weights = _posed(points, mass, frame)
        if len(posed) <= self.chunk:
            return self._forward(posed.unsqueeze(0), weights.unsqueeze(0))[0]
        return self._forward(posed, weights, chunk=self.chunk)

    @torch.no_grad()
    def predict_many(
        self, points: Sequence[ArrayLike], mass: Sequence[ArrayLike]
    ) -> list[torch.Tensor]:
        """Predict bases of several clouds in one forward pass, as float32 tensors on `device`.

        Smaller clouds are padded by points without mass, which change nothing at the others but
        rounding. A network that does not heed masses sees one cloud after the other.
        """
        if len(points) != len(mass):
            raise InvalidInputError("points", f"be as many as `mass`, {len(mass)}", len(points))
        if not len(points):
            return []
        if not self._pads(points):
            return [self.tensor(*cloud) for cloud in zip(points, mass, strict=True)]
        bases = self._padded(points, mass)
        return [basis[: len(x)] for basis, x in zip(bases, points, strict=True)]  # type: ignore[arg-type]

    @torch.no_grad()
    def _padded(self, points: Sequence[ArrayLike], mass: Sequence[ArrayLike]) -> torch.Tensor:
        """Predict the same as one tensor (b, N, 1 + poses * m), padded at the ends of its rows."""
        clouds = zip(points, mass, strict=True)
        seen = [_posed(x, w, self.frame(x, w)) for x, w in clouds]
        padded = (pad_sequence(list(part), batch_first=True) for part in zip(*seen, strict=True))
        return self._forward(*padded)

    def _pads(self, points: Sequence[ArrayLike]) -> bool:
        """Whether clouds can share a pass: points without mass change nothing at the others."""
        config, largest = self._model.config, max(map(len, points))  # type: ignore[arg-type]
        return largest <= self.chunk and config.backbone == "neo" and config.mass_aware

    def _forward(self, posed: torch.Tensor, weights: torch.Tensor, **chunked: int) -> torch.Tensor:
        """Return the bases (..., N, 1 + poses * m) of posed clouds (..., N, 3), masses (..., N)."""
        posed, weights, model = posed.to(self.device), weights.to(self.device), self._model
        basis = torch.ones(*weights.shape, self.n_functions, device=self.device)
        flips = torch.tensor(POSES[: self.poses], dtype=torch.float32, device=self.device)
        with torch_threads():
            for part, flip in zip(basis[..., 1:].chunk(self.poses, -1), flips, strict=True):
                if chunked:
                    model.evaluate_chunked(posed * flip, weights, **chunked, out=part)
                else:
                    part.copy_(model(posed * flip, weights))
        return basis

    @cached_property
    def _model(self) -> NeoNetwork:
        if not isinstance(self.network, NeoNetwork):
            _, digest = find_weights(self.network)
            return _loaded(os.fspath(self.network), digest, self.device, self.dtype)
        return copy.deepcopy(self.network).eval().to(self.device, _DTYPES[self.dtype])


@lru_cache(maxsize=4)
def _loaded(name_or_path: str, sha256: str, device: str, dtype: str) -> NeoNetwork:
    """Return the network of a file, the same for all who ask: reading it takes half a prediction.

    Nobody changes it, and a file of other content has another hash.
    """
    return load_pretrained(name_or_path).network.to(device, _DTYPES[dtype])


def _posed(points: ArrayLike, mass: ArrayLike, frame: Frame) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a cloud as the network sees it."""
    points = check_points("points", points)
    mass = check_mass("mass", mass, len(points))
    return torch.from_numpy(frame.pose(points)).float(), torch.from_numpy(
        mass / mass.mean()
    ).float()
