"""Networks that label shapes or their points, from any embedding.

A network is a frozen dataclass of its sizes; ``build(inputs, outputs)`` returns the module. It maps
a `Batch`, or a `ShapeBatch`, of b shapes with up to n points to features (b, n, D). Read
`DiffusionNet` last.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.utils.rnn import pad_sequence

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.learn.tensors import moved
from spectra_kit.neo.backbones import PointNetPlusPlus, PointTransformer
from spectra_kit.neo.model import NeoConfig

_BACKBONES: dict[str, type[PointNetPlusPlus] | type[PointTransformer]] = {
    "pointnet++": PointNetPlusPlus,
    "point-transformer": PointTransformer,
}
#: What of a `Batch` a network may ask for beside features, points and masses.
Need = Literal["spectrum", "slopes"]


class Batch(NamedTuple):
    """Shapes of up to n points, padded; all in the unit of length that makes their area one."""

    features: Tensor  #: (b, n, c)
    points: Tensor  #: (b, n, 3)
    mass: Tensor  #: (b, n), zero at padding; the others sum to one
    eigenvalues: Tensor | None = None  #: (b, k)
    eigenvectors: Tensor | None = None  #: (b, n, k), zero at padding
    slopes: tuple[Tensor, Tensor] | None = None  #: (b n, b n), sparse: along the tangents

    def to(self, device: str | torch.device) -> Batch:
        """Return the same on a device."""
        return Batch(*(moved(part, device) for part in self))


@runtime_checkable
class Network(Protocol):
    """Sizes of a network, which ``build`` makes."""

    @property
    def sees(self) -> frozenset[Need]:
        """What of a `Batch` it needs beside features, points and masses."""
        ...

    def build(self, inputs: int, outputs: int) -> nn.Module:
        """Return a module from a `Batch` with so many features to (b, n, outputs)."""
        ...


def _layers(*sizes: int, dropout: float = 0.0) -> nn.Sequential:
    """Linear layers, each followed by a norm of each row and SiLU."""
    parts: list[nn.Module] = []
    for one, other in pairwise(sizes):
        parts += [nn.Linear(one, other), nn.LayerNorm(other), nn.SiLU()]
        if dropout:
            parts.append(nn.Dropout(dropout))
    return nn.Sequential(*parts)


def _features(batch: Batch, inputs: int) -> Tensor:
    """Return the features of a batch, if a network was built for as many."""
    if (given := batch.features.shape[-1]) != inputs:
        raise InvalidInputError(
            "features",
            f"have the {inputs} channels that the network was built for",
            given,
            advice=f"build({given}, outputs) makes one for these",
        )
    return batch.features


class _NoOperator:
    @property
    def sees(self) -> frozenset[Need]:
        """Nothing else."""
        return frozenset()


@checked
@dataclass(frozen=True, kw_only=True)
class PointMLP(_NoOperator):
    """The same layers at each point, which sees nothing of the others.

    Parameters
    ----------
    width : int, default 128
        Channels.
    depth : int, default 3
        Layers.
    """

    width: int = 128
    depth: int = 3

    def __post_init__(self) -> None:
        check_count("width", self.width, low=1)
        check_count("depth", self.depth, low=1)

    def build(self, inputs: int, outputs: int) -> nn.Module:
        """Return the module."""
        return _PointMLP(self, inputs, outputs)


class _PointMLP(nn.Module):
    def __init__(self, sizes: PointMLP, inputs: int, outputs: int) -> None:
        super().__init__()
        self.inputs = inputs
        self.layers = _layers(inputs, *[sizes.width] * sizes.depth)
        self.out = nn.Linear(sizes.width, outputs)

    def forward(self, batch: Batch) -> Tensor:
        out: Tensor = self.out(self.layers(_features(batch, self.inputs)))
        return out


@checked
@dataclass(frozen=True, kw_only=True)
class PointNet(_NoOperator):
    """Layers at each point, the largest value of each channel over all, and layers of both.

    Parameters
    ----------
    width : int, default 64
        Channels at first; twice and four times as many follow.

    References
    ----------
    C. R. Qi, H. Su, K. Mo, L. J. Guibas, "PointNet: deep learning on point sets for 3D
    classification and segmentation", CVPR, 2017.
    """

    width: int = 64

    def __post_init__(self) -> None:
        check_count("width", self.width, low=1)

    def build(self, inputs: int, outputs: int) -> nn.Module:
        """Return the module."""
        return _PointNet(self.width, inputs, outputs)


class _PointNet(nn.Module):
    def __init__(self, width: int, inputs: int, outputs: int) -> None:
        super().__init__()
        self.inputs = inputs
        self.near = _layers(inputs, width, width)
        self.far = _layers(width, 2 * width, 4 * width)
        self.both = _layers(5 * width, 2 * width, width)
        self.out = nn.Linear(width, outputs)

    def forward(self, batch: Batch) -> Tensor:
        near = self.near(_features(batch, self.inputs))
        far = self.far(near).masked_fill(batch.mass[..., None] == 0, -torch.inf).amax(1)
        far = far[:, None].expand(-1, near.shape[1], -1)
        out: Tensor = self.out(self.both(torch.cat([near, far], dim=-1)))
        return out


@checked
@dataclass(frozen=True, kw_only=True)
class Hierarchical(_NoOperator):
    """PointNet++ or Point Transformer of PyTorch Geometric: coordinates, and what is known of them.

    They are those of `NeoConfig.backbone`, with as many weights as a NEO network of this width and
    depth has.

    Parameters
    ----------
    backbone : {"pointnet++", "point-transformer"}
        Which.
    width, depth : int
        Of the NEO network that has as many weights.
    features : bool, default True
        See the features of a `Batch`, too, and not coordinates alone.
    """

    backbone: Literal["pointnet++", "point-transformer"]
    width: int = 64
    depth: int = 1
    features: bool = True

    def build(self, inputs: int, outputs: int) -> nn.Module:
        """Return the module."""
        return _Hierarchical(self, inputs if self.features else 0, outputs)


class _Hierarchical(nn.Module):
    def __init__(self, sizes: Hierarchical, known: int, outputs: int) -> None:
        super().__init__()
        config = NeoConfig(
            width=sizes.width,
            depth=sizes.depth,
            backbone=sizes.backbone,
            m=1,
            k=1,
            waves=0,
            heads=1,  # these play no part
            head_width=1,
            latents=1,
        )
        self.backbone = _BACKBONES[sizes.backbone](config, known)
        del self.backbone.head  # that of NEO plays no part, either
        self.known = known
        # So many norms of each point by itself leave features that are nearly the same of all
        # shapes: without what they have in common, a head learns to tell them apart.
        self.norm = nn.BatchNorm1d(sizes.width)
        self.out = nn.Linear(sizes.width, outputs)

    def forward(self, batch: Batch) -> Tensor:
        # Neighbours and centres are searched among all points: padding must not be one.
        known_of = _features(batch, self.known) if self.known else batch.features
        answers = []
        for points, mass, features in zip(batch.points, batch.mass, known_of, strict=True):
            own = mass > 0
            known = features[own][None] if self.known else None
            answers.append(self.backbone.features(points[own][None], mass[own][None], known)[0])
        told = self.out(self.norm(torch.cat(answers))).split(list(map(len, answers)))
        out = pad_sequence(told, batch_first=True)
        return F.pad(out, (0, 0, 0, batch.points.shape[1] - out.shape[1]))


@checked
@dataclass(frozen=True, kw_only=True)
class DiffusionNet:
    """Heat that spreads for times which are learned, slopes of it, and layers at each point.

    Parameters
    ----------
    width : int, default 64
        Channels.
    depth : int, default 4
        Blocks.
    dropout : float, default 0.5
        Inside the layers of each block, in training.

    Notes
    -----
    Slopes enter by products ``g_a . (A g)_a`` with a real A, as the authors have it for surfaces
    without a known outer side: turned tangents and mirrored surfaces change nothing.

    References
    ----------
    N. Sharp, S. Attaiki, K. Crane, M. Ovsjanikov, "DiffusionNet: discretization agnostic learning
    on surfaces", ACM Transactions on Graphics 41(3), 2022.
    """

    width: int = 64
    depth: int = 4
    dropout: float = 0.5

    def __post_init__(self) -> None:
        check_count("width", self.width, low=1)
        check_count("depth", self.depth, low=1)
        if not 0 <= self.dropout < 1:
            raise InvalidInputError("dropout", "be in [0, 1)", self.dropout)

    @property
    def sees(self) -> frozenset[Need]:
        """Spectrum and slopes."""
        return frozenset({"spectrum", "slopes"})

    def build(self, inputs: int, outputs: int) -> nn.Module:
        """Return the module."""
        return _DiffusionNet(self, inputs, outputs)


class _DiffusionNet(nn.Module):
    def __init__(self, sizes: DiffusionNet, inputs: int, outputs: int) -> None:
        super().__init__()
        self.inputs = inputs
        self.enter = nn.Linear(inputs, sizes.width)
        self.blocks = nn.ModuleList(
            _DiffusionBlock(sizes.width, sizes.dropout) for _ in range(sizes.depth)
        )
        self.out = nn.Linear(sizes.width, outputs)

    def forward(self, batch: Batch) -> Tensor:
        if batch.eigenvectors is None or batch.slopes is None:
            raise InvalidInputError(
                "batch", "hold modes and 'gradient', for DiffusionNet", "one without"
            )
        x = self.enter(_features(batch, self.inputs))
        for block in self.blocks:
            x = block(x, batch)
        out: Tensor = self.out(x)
        return out


class _DiffusionBlock(nn.Module):
    def __init__(self, width: int, dropout: float) -> None:
        super().__init__()
        self.root_time = nn.Parameter(torch.full((width,), 0.05))  # of an area of one
        self.turn = nn.Linear(width, width, bias=False)
        self.layers = nn.Sequential(
            _layers(3 * width, width, width, dropout=dropout), nn.Linear(width, width)
        )

    def forward(self, x: Tensor, batch: Batch) -> Tensor:
        assert batch.eigenvectors is not None
        assert batch.eigenvalues is not None
        assert batch.slopes is not None
        b, n, c = x.shape
        U = batch.eigenvectors  # (b, n, k)
        decay = torch.exp(-batch.eigenvalues[..., None] * self.root_time.square())  # (b, k, c)
        spread = U @ (decay * (U.transpose(1, 2) @ (batch.mass[..., None] * x)))
        flat = spread.reshape(b * n, c)
        along, across = (torch.mm(slope, flat) for slope in batch.slopes)
        products = along * self.turn(along) + across * self.turn(across)
        out: Tensor = x + self.layers(
            torch.cat([x, spread, torch.tanh(products).view(b, n, c)], dim=-1)
        )
        return out


def pooled(values: Tensor, mass: Tensor) -> Tensor:
    """Return the mean over the area of each shape, (b, c), of (b, n, c)."""
    return (mass[..., None] * values).sum(1) / mass.sum(1, keepdim=True)
