"""Embeddings by functions of space: the points alone, plane waves, or what a network predicts."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import Rebuilt, check_count, check_positive
from spectra_kit.eigen.subspaces import Frame, canonical_frame
from spectra_kit.eigen.subspaces.frame import POSES
from spectra_kit.errors import InvalidInputError
from spectra_kit.features.base import Change, Embedding, Pooled, Surface
from spectra_kit.neo.model import NeoNetwork
from spectra_kit.neo.pretrained import find_weights, load_pretrained, weights_digest

Pose = Literal["principal", "given"]


class _Functions(Pooled):
    """What they share: they see posed points, one cloud or a padded batch."""

    frame: Pose

    @property
    def invariant_to(self) -> frozenset[Change]:
        """Scale and sampling; in the principal frame rotation, too, where that frame is unique."""
        turned: frozenset[Change] = frozenset({"rotation"} if self.frame == "principal" else ())
        return turned | {"scale", "sampling"}

    def values(self, posed: Tensor, mass: Tensor) -> Tensor:
        """Return (b, n, c) at posed points (b, n, 3) of masses (b, n), 0 at padding."""
        raise NotImplementedError

    def of_points(self, surface: Surface) -> Floats:
        """Return (n, c)."""
        points = torch.tensor(surface.laplacian.points)[None]
        with torch.no_grad():
            values = embed_batch(points, torch.tensor(surface.mass)[None], self)
        return values[0].cpu().double().numpy()


@checked
def embed_batch(points: Tensor, mass: Tensor, embedding: Embedding) -> Tensor:
    """Return the numbers of `embed` for the points of many clouds at once.

    Parameters
    ----------
    points : Tensor of shape (b, n, 3)
        Clouds of up to n points.
    mass : Tensor of shape (b, n)
        Their masses, whose ratios alone matter; 0 tells what is padding.
    embedding : Coordinates, PositionalEncoding, PlaneWaves or NeoFunctions
        A function of points.

    Returns
    -------
    Tensor of shape (b, n, c), float32
        On the device of the points. Gradients reach the points, with the frame of each cloud held
        still: it may jump where axes change places.

    Raises
    ------
    InvalidInputError
        If the shapes do not fit, a mass is negative, a cloud has no mass or lies in one place, or
        the embedding is not a function of points.

    Examples
    --------
    >>> import torch
    >>> from spectra_kit.features import PositionalEncoding, embed_batch
    >>> points = torch.rand(2, 50, 3, generator=torch.Generator().manual_seed(0))
    >>> embed_batch(points, torch.ones(2, 50), PositionalEncoding(levels=4)).shape
    torch.Size([2, 50, 27])
    """
    if not isinstance(embedding, _Functions):
        raise InvalidInputError(
            "embedding",
            "be a function of points",
            type(embedding).__name__,
            advice="call `embed` with each shape, whose operator it needs",
        )
    if points.ndim != 3 or points.shape[-1] != 3 or mass.shape != points.shape[:2]:
        found = f"{tuple(points.shape)} and {tuple(mass.shape)}"
        raise InvalidInputError("points", "have shape (b, n, 3), and `mass` (b, n)", found)
    frames = [_frame(x, w, embedding.frame) for x, w in zip(points, mass, strict=True)]
    centres, rotations, scales = (
        torch.as_tensor(np.array(part)).to(points.device, torch.float64)
        for part in zip(*frames, strict=True)
    )
    posed = (points.double() - centres[:, None]) @ rotations / scales[:, None, None]
    weights = mass / mass.sum(dim=1, keepdim=True)
    values = embedding.values(posed.float(), weights.float())
    return values * (mass > 0)[..., None]


def _frame(points: Tensor, mass: Tensor, pose: Pose) -> Frame:
    w = mass.detach().cpu().double().numpy()
    if (w < 0).any() or not (w > 0).any():
        raise InvalidInputError("mass", "be positive at the points, zero at padding", "others")
    x, w = points.detach().cpu().double().numpy()[w > 0], w[w > 0]
    if pose == "principal":
        return canonical_frame(x, w)
    centre = w @ x / w.sum()
    scale = float(np.abs(x - centre).max())
    if scale == 0:
        raise InvalidInputError("points", "lie in more than one place", "a cloud of one")
    return Frame(centre, np.eye(3), scale)


@checked
@dataclass(frozen=True, kw_only=True)
class Coordinates(_Functions):
    """The coordinates themselves, centred and scaled into the unit box.

    Parameters
    ----------
    frame : {"given", "principal"}, default "given"
        As the points come, or turned into their principal axes.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> points = sk.features.embed(sk.geometry.creature(800), sk.features.Coordinates())
    >>> points.shape, float(abs(points).max())
    ((800, 3), 1.0)
    """

    frame: Pose = "given"

    def values(self, posed: Tensor, mass: Tensor) -> Tensor:
        """Return (b, n, 3)."""
        return posed


@checked
@dataclass(frozen=True, kw_only=True)
class PositionalEncoding(_Functions):
    """Coordinates, and their sines and cosines at frequencies that double.

    Parameters
    ----------
    levels : int, default 10
        Frequencies: half a wave in the unit box, and each twice the one before.
    frame : {"given", "principal"}, default "given"
        As of `Coordinates`.

    Raises
    ------
    InvalidInputError
        If `levels` is less than 1.

    References
    ----------
    B. Mildenhall et al., "NeRF: representing scenes as neural radiance fields for view synthesis",
    ECCV, 2020.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> cloud = sk.geometry.creature(800)
    >>> sk.features.embed(cloud, sk.features.PositionalEncoding()).shape
    (800, 63)
    """

    levels: int = 10
    frame: Pose = "given"

    def __post_init__(self) -> None:
        check_count("levels", self.levels, low=1)

    def values(self, posed: Tensor, mass: Tensor) -> Tensor:
        """Return (b, n, 3 + 6 levels)."""
        frequencies = torch.pi * 2.0 ** torch.arange(self.levels, device=posed.device)
        angles = (posed[..., None, :] * frequencies[:, None]).flatten(-2)
        return torch.cat([posed, angles.sin(), angles.cos()], dim=-1)


@checked
@dataclass(frozen=True, kw_only=True)
class PlaneWaves(_Functions):
    """Cosines and sines of random plane waves: what a trained network has to beat.

    Parameters
    ----------
    count : int, default 64
        Waves, of which there are a cosine and a sine each.
    bandwidth : float, default 7
        Standard deviation of their vectors' components, in radians per unit of the frame.
    seed : int, default 0
        Of these.
    frame : {"given", "principal"}, default "principal"
        As of `Coordinates`.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range.

    References
    ----------
    A. Rahimi, B. Recht, "Random features for large-scale kernel machines", NeurIPS, 2007.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> cloud = sk.geometry.creature(800)
    >>> sk.features.embed(cloud, sk.features.PlaneWaves(count=20)).shape
    (800, 40)
    """

    count: int = 64
    bandwidth: float = 7.0
    seed: int = 0
    frame: Pose = "principal"

    def __post_init__(self) -> None:
        check_count("count", self.count, low=1)
        check_positive("bandwidth", self.bandwidth)
        check_count("seed", self.seed, low=0)

    def values(self, posed: Tensor, mass: Tensor) -> Tensor:
        """Return (b, n, 2 count)."""
        drawn = np.random.default_rng(self.seed).standard_normal((3, self.count))
        phase = posed @ torch.from_numpy(self.bandwidth * drawn).to(posed)
        return torch.cat([phase.cos(), phase.sin()], dim=-1)


@checked
@dataclass(frozen=True, kw_only=True, repr=False)
class NeoFunctions(_Functions, Rebuilt):
    """The functions that a network of NEO predicts, before any operator is asked.

    The form that follows the operator, magnitudes of its Ritz vectors, is `GlobalPoints` of a
    predicted spectrum: ``embed(shape, GlobalPoints(), solver=Neo())``.

    Parameters
    ----------
    network : str, path or NeoNetwork, default "small"
        Name or file of pretrained weights, loaded at the first call; or a network, whose weights
        receive gradients in `embed_batch`.
    poses : {1, 4}, default 4
        Mean over the four proper flips of the principal frame, among which the choice is a matter
        of third moments; or that of these alone, at a quarter of the time.
    masses : bool, default True
        Tell the network the masses of the points. The paper's classifiers do not.

    Raises
    ------
    InvalidInputError
        If an option has another value than those above.
    WeightsError
        If there are no such weights.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> cloud = sk.geometry.creature(800)
    >>> sk.features.embed(cloud, sk.features.NeoFunctions(poses=1)).shape
    (800, 256)
    """

    network: str | os.PathLike[str] | NeoNetwork = "small"
    poses: Literal[1, 4] = 4
    masses: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.network, NeoNetwork):
            find_weights(self.network)

    def __repr__(self) -> str:
        network = self.network
        named = "<NeoNetwork>" if isinstance(network, NeoNetwork) else repr(os.fspath(network))
        return (
            f"NeoFunctions(network={named}, poses={self.poses}, masses={self.masses},"
            f" sha256={weights_digest(network)!r})"
        )

    @property
    def frame(self) -> Pose:  # type: ignore[override]
        """The frame that the network was trained in."""
        return "principal" if self._model.config.frame == "principal" else "given"

    def values(self, posed: Tensor, mass: Tensor) -> Tensor:
        """Return (b, n, m)."""
        weights = mass if self.masses else (mass > 0).to(mass)
        flips = torch.tensor(POSES[: self.poses]).to(posed)
        model = self._model.to(posed.device)
        total: Tensor = sum(model(posed * flip, weights) for flip in flips) / self.poses
        return total

    @cached_property
    def _model(self) -> NeoNetwork:
        if isinstance(self.network, NeoNetwork):
            return self.network
        return load_pretrained(self.network).network.eval()
