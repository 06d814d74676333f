"""Embeddings by functions of space: the points alone, plane waves, or what a network predicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit.eigen.base import check_dimension_of
from spectra_kit.eigen.subspaces import Frame, Subspace, canonical_frame
from spectra_kit.errors import InvalidInputError
from spectra_kit.features._spectra import Change
from spectra_kit.features.embedding import Embedding, Pooled, Surface

if TYPE_CHECKING:
    import torch

Pose = Literal["principal", "given"]


class _OfSpace(Pooled):
    """What they share: they see posed points, one cloud or a padded batch."""

    frame: Pose | None

    @property
    def pose(self) -> Pose:
        """The frame in which they see the points."""
        return self.frame or "principal"

    @property
    def invariant_to(self) -> frozenset[Change]:
        """Scale and sampling; in the principal frame rotation, too, where that frame is unique."""
        turned: frozenset[Change] = frozenset({"rotation"} if self.pose == "principal" else ())
        return turned | {"scale", "sampling"}

    def values(self, posed: torch.Tensor, mass: torch.Tensor) -> torch.Tensor:
        """Return (b, n, c) at posed points (b, n, 3) of masses (b, n), 0 at padding."""
        raise NotImplementedError

    def of_points(self, surface: Surface) -> Floats:
        """Return (n, c)."""
        import torch

        check_dimension_of(self, surface.laplacian)
        points = torch.tensor(surface.laplacian.points)[None]
        with torch.no_grad():
            values = _embedded(points, torch.tensor(surface.mass)[None], self)
        return values[0].cpu().double().numpy()


@checked
def embed_batch(points: torch.Tensor, mass: torch.Tensor, embedding: Embedding) -> torch.Tensor:
    """Return the numbers of `embed` for the points of many clouds at once.

    Parameters
    ----------
    points : Tensor of shape (b, n, 3)
        Clouds of up to n points.
    mass : Tensor of shape (b, n)
        Their masses, whose ratios alone matter; 0 tells what is padding.
    embedding : Coordinates, PositionalEncoding or BasisFunctions
        A function of points.

    Returns
    -------
    Tensor of shape (b, n, c), float32
        On the device of the points. Gradients reach the points, with the frame of each cloud held
        still: it may jump where axes change places.

    Examples
    --------
    >>> import torch
    >>> from spectra_kit.features import PositionalEncoding, embed_batch
    >>> points = torch.rand(2, 50, 3, generator=torch.Generator().manual_seed(0))
    >>> embed_batch(points, torch.ones(2, 50), PositionalEncoding(levels=4)).shape
    torch.Size([2, 50, 27])
    """
    if not isinstance(embedding, _OfSpace):
        raise InvalidInputError(
            "embedding",
            "be a function of points",
            type(embedding).__name__,
            advice="call `embed` with each shape, whose operator it needs",
        )
    if points.ndim != 3 or points.shape[-1] != 3 or mass.shape != points.shape[:2]:
        found = f"{tuple(points.shape)} and {tuple(mass.shape)}"
        raise InvalidInputError("points", "have shape (b, n, 3), and `mass` (b, n)", found)
    return _embedded(points, mass, embedding)


def _embedded(points: torch.Tensor, mass: torch.Tensor, embedding: _OfSpace) -> torch.Tensor:
    import torch

    frames = [_frame(x, w, embedding.pose) for x, w in zip(points, mass, strict=True)]
    centres, rotations, scales = (
        torch.as_tensor(np.array(part)).to(points.device, torch.float64)
        for part in zip(*frames, strict=True)
    )
    posed = (points.double() - centres[:, None]) @ rotations / scales[:, None, None]
    weights = mass / mass.sum(dim=1, keepdim=True)
    values = embedding.values(posed.float(), weights.float())
    return values * (mass > 0)[..., None]


def _frame(points: torch.Tensor, mass: torch.Tensor, pose: Pose) -> Frame:
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
class Coordinates(_OfSpace):
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

    def values(self, posed: torch.Tensor, mass: torch.Tensor) -> torch.Tensor:
        """Return (b, n, 3)."""
        return posed


@checked
@dataclass(frozen=True, kw_only=True)
class PositionalEncoding(_OfSpace):
    """Coordinates, and their sines and cosines at frequencies that double.

    Mildenhall et al., *NeRF: Representing Scenes as Neural Radiance Fields for View Synthesis*,
    ECCV 2020.

    Parameters
    ----------
    levels : int, default 10
        Frequencies: half a wave in the unit box, and each twice the one before.
    frame : {"given", "principal"}, default "given"
        As of `Coordinates`.

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

    def values(self, posed: torch.Tensor, mass: torch.Tensor) -> torch.Tensor:
        """Return (b, n, 3 + 6 levels)."""
        import torch

        frequencies = torch.pi * 2.0 ** torch.arange(self.levels, device=posed.device)
        angles = (posed[..., None, :] * frequencies[:, None]).flatten(-2)
        return torch.cat([posed, angles.sin(), angles.cos()], dim=-1)


@checked
@dataclass(frozen=True, kw_only=True)
class BasisFunctions(_OfSpace):
    """The functions of a subspace, before any operator is asked: plane waves, or a network's.

    The form that follows the operator, magnitudes of Ritz vectors, is `GlobalPointSignature` of a
    predicted spectrum: ``embed(cloud, GlobalPointSignature(), solver=Neo())``.

    Parameters
    ----------
    subspace : NeoSubspace or AmbientFourier
        Whose functions: those that a network predicts, the mean over its ``poses``; or random plane
        waves, without the constant and the coordinates, m - 4 in all: what a trained network has to
        beat. A network that is given itself receives gradients in `embed_batch`.
    masses : bool, default True
        Tell the subspace the masses of the points. The paper's classifiers do not.
    frame : {"principal", "given"}, optional
        As of `Coordinates`; by default that which the subspace is made for.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> cloud = sk.geometry.creature(800)
    >>> waves = sk.eigen.subspaces.AmbientFourier(m=44, bandwidth=7.0)
    >>> sk.features.embed(cloud, sk.features.BasisFunctions(subspace=waves)).shape
    (800, 40)
    >>> sk.features.embed(cloud, sk.features.BasisFunctions(subspace=sk.Neo().subspace)).shape
    (800, 256)
    """

    subspace: Subspace
    masses: bool = True
    frame: Pose | None = None

    def __post_init__(self) -> None:
        if not hasattr(self.subspace, "functions"):
            raise InvalidInputError(
                "subspace",
                "be of functions of space",
                type(self.subspace).__name__,
                advice="AmbientFourier and NeoSubspace are",
            )

    @property
    def pose(self) -> Pose:
        """The frame that was chosen, or that of the subspace."""
        turned = getattr(self.subspace, "principal", True)
        return self.frame or ("principal" if turned else "given")

    def values(self, posed: torch.Tensor, mass: torch.Tensor) -> torch.Tensor:
        """Return (b, n, m), or (b, n, m - 4) of plane waves."""
        subspace: Any = self.subspace
        weights = mass if self.masses else (mass > 0).to(mass)
        found: torch.Tensor = subspace.functions(posed, weights)
        return found
