"""The backbones that the paper compares with, under the heads of the NEO network.

PointNet++ and Point Transformer from the layers of PyTorch Geometric, an optional package. Read
`PointNetPlusPlus.features` first. PyTorch Geometric searches neighbours and farthest points with
compiled packages that few platforms have wheels of; here SciPy's k-d trees and a loop do.

Both see the surface at three resolutions: all N points, then the farthest 400 and 100 of them (the
paper's ratios of 0.2 and 0.25 at its 2,048 points; as counts, so that the coarse levels are the
same for any N). Neither is a quadrature: masses are one more input channel, the logarithm
of each relative to the mean. Letters: B clouds, N points, M centres, D width, c channels.
"""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn import functional as F

from spectra_kit._core.checked import checked
from spectra_kit._core.optional import optional
from spectra_kit.neo.model import ENCODED, FreeHead, NeoConfig, NeoNetwork, WaveHead, encode

_CENTRES = (400, 100)
_RADII = (0.2, 0.4)  # of the balls around them, in posed coordinates
_NEIGHBOURS = 16  # that a point attends to


class _Hierarchical(NeoNetwork):
    """What both backbones share: sizes, input, and evaluation of large clouds.

    Channels are multiples of c, so that the weights are as many as NEO's of the same width and
    depth; heads and latents of the configuration play no part. Normalisation is per point.
    """

    _TERMS: int  # weights of the backbone in units of c^2

    def __init__(self, config: NeoConfig, known: int = 0) -> None:
        nn.Module.__init__(self)  # not NeoNetwork's, which would make its blocks
        self.config = config
        # A NEO block has about 35 D^2 weights: as many in all, whatever width and depth. The last
        # two layers take 2 D^2; a linear one from c to D > c channels would have rank c alone.
        c = config.width * math.sqrt((35 * config.depth - 2) / self._TERMS)
        self.channels = 2 * max(1, round(c / 2))
        self.enter = _mlp(ENCODED + 1 + known, self.channels, self.channels)
        self.widen = _mlp(self.channels, config.width)
        self.out = nn.Linear(config.width, config.width)
        self.head = WaveHead(config) if config.waves else FreeHead(config)

    def _features_in(self, parts: list[slice], points: Tensor, mass: Tensor) -> Tensor:
        """Return the features of one cloud at once: they depend on neighbours in other parts."""
        return self.features(points[None], mass[None])[0]

    def _lifted(self, points: Tensor, mass: Tensor, known: Tensor | None) -> Tensor:
        """First features (B N, c) of the points, and of what else is known of them."""
        parts = [encode(points), self._log_mass(mass).unsqueeze(-1)]
        parts += [] if known is None else [known]
        lifted: Tensor = self.enter(
            torch.cat(parts, dim=-1).flatten(0, 1).to(self.out.weight.dtype)
        )
        return lifted


class PointNetPlusPlus(_Hierarchical):
    """PointNet++ for one function value per point: two set abstractions, one global, and back.

    Channels are c, 2c, 4c and 8c on the way down, as in the paper's table of hyper-parameters.
    Activations are SiLU.

    Qi et al., *PointNet++: Deep Hierarchical Feature Learning on Point Sets in a Metric Space*,
    NeurIPS 2017.
    """

    _TERMS = 153

    def __init__(self, config: NeoConfig, known: int = 0) -> None:
        super().__init__(config, known)
        c, conv = self.channels, _geometric().PointNetConv
        self.down1 = conv(_mlp(c + 3, c, c, 2 * c), add_self_loops=False)
        self.down2 = conv(_mlp(2 * c + 3, 2 * c, 2 * c, 4 * c), add_self_loops=False)
        self.whole = _mlp(4 * c + 3, 4 * c, 8 * c)
        self.up3 = _mlp(12 * c, 4 * c, 4 * c)
        self.up2 = _mlp(6 * c, 2 * c, 2 * c)
        self.up1 = _mlp(3 * c, c, c)

    def features(self, points: Tensor, mass: Tensor, known: Tensor | None = None) -> Tensor:
        """Return features (B, N, D); see `NeoNetwork.features`. Of points, more may be known."""
        x0 = self._lifted(points, mass, known)
        p0 = points.float()
        p1 = farthest_points(p0, _CENTRES[0])
        p2 = farthest_points(p1, _CENTRES[1])
        q0, q1, q2 = (p.flatten(0, 1).to(x0.dtype) for p in (p0, p1, p2))
        x1 = self.down1((x0, None), (q0, q1), balls(p0, p1, _RADII[0]))
        x2 = self.down2((x1, None), (q1, q2), balls(p1, p2, _RADII[1]))
        whole = self.whole(torch.cat([x2, q2], dim=1)).view(*p2.shape[:2], -1).amax(1)
        x2 = self.up3(torch.cat([x2, whole.repeat_interleave(p2.shape[1], dim=0)], dim=1))
        x1 = self.up2(torch.cat([x1, interpolate(x2, p2, p1)], dim=1))
        x0 = self.up1(torch.cat([x0, interpolate(x1, p1, p0)], dim=1))
        features: Tensor = self.out(self.widen(x0))
        return features.view(*points.shape[:2], -1)


class PointTransformer(_Hierarchical):
    """Point Transformer for one function value per point: vector attention among 16 neighbours.

    Channels are c, 2c and 4c on the three levels, one block on each on the way down and on the
    way up.

    Zhao et al., *Point Transformer*, ICCV 2021.
    """

    _TERMS = 234

    def __init__(self, config: NeoConfig, known: int = 0) -> None:
        super().__init__(config, known)
        c = self.channels
        self.encoders = nn.ModuleList(_Attention(size) for size in (c, 2 * c, 4 * c))
        self.downs = nn.ModuleList(_mlp(size, 2 * size) for size in (c, 2 * c))
        self.ups = nn.ModuleList(_mlp(2 * size, size) for size in (c, 2 * c))
        self.skips = nn.ModuleList(_mlp(size, size) for size in (c, 2 * c))
        self.decoders = nn.ModuleList(_Attention(size) for size in (c, 2 * c))

    def features(self, points: Tensor, mass: Tensor, known: Tensor | None = None) -> Tensor:
        """Return features (B, N, D); see `NeoNetwork.features`. Of points, more may be known."""
        levels = [points.float()]
        for count in _CENTRES:
            levels.append(farthest_points(levels[-1], count))
        graphs = [(p.flatten(0, 1), _graph(p)) for p in levels]
        x = self.encoders[0](self._lifted(points, mass, known), *graphs[0])
        skipped = []
        for i, down in enumerate(self.downs):
            skipped.append(x)
            x = down(x)[nearest(levels[i], levels[i + 1], _NEIGHBOURS)].amax(1)
            x = self.encoders[i + 1](x, *graphs[i + 1])
        for i in (1, 0):
            up = interpolate(self.ups[i](x), levels[i + 1], levels[i])
            x = self.decoders[i](self.skips[i](skipped[i]) + up, *graphs[i])
        features: Tensor = self.out(self.widen(x))
        return features.view(*points.shape[:2], -1)


class _Attention(nn.Module):
    """Residual block of Point Transformer: linear, vector attention, linear."""

    def __init__(self, c: int) -> None:
        super().__init__()
        self.before = _mlp(c, c)
        self.attention = _geometric().PointTransformerConv(
            c,
            c,
            pos_nn=_mlp(3, c, c, plain_last=True),
            attn_nn=_mlp(c, c, c, plain_last=True),
            add_self_loops=False,  # every point is its own nearest neighbour
        )
        self.norm, self.after = nn.LayerNorm(c), nn.Linear(c, c)

    def forward(self, x: Tensor, points: Tensor, edges: Tensor) -> Tensor:
        mixed = self.attention(self.before(x), points.to(x.dtype), edges)
        out: Tensor = x + self.after(F.silu(self.norm(mixed)))
        return out


@torch.no_grad()
def farthest_points(points: Tensor, count: int) -> Tensor:
    """Return (B, M, 3) of points (B, N, 3): each as far as possible from those before it.

    M is `count`, or N where that is less. The first is the farthest in a fixed direction, one
    that no symmetric cloud is square to, so that the order of the points plays no part.
    """
    clouds = torch.arange(len(points), device=points.device)
    chosen, gap = [], torch.full(points.shape[:2], torch.inf, device=points.device)
    last = (points * points.new_tensor([1.0, 0.618, 0.382])).sum(-1).argmax(1)
    for _ in range(min(count, points.shape[1])):
        chosen.append(points[clouds, last])
        gap = gap.minimum((points - chosen[-1].unsqueeze(1)).square().sum(-1))
        last = gap.argmax(1)
    return torch.stack(chosen, dim=1)


def nearest(points: Tensor, centres: Tensor, k: int) -> Tensor:
    """Return the rows (B M, k) in points (B N, 3) that are nearest to each of B M centres."""
    k, n = min(k, points.shape[1]), points.shape[1]
    found = [
        cKDTree(x).query(c, k=np.arange(1, k + 1))[1] + i * n
        for i, (x, c) in enumerate(zip(_arrays(points), _arrays(centres), strict=True))
    ]
    return torch.from_numpy(np.concatenate(found)).to(points.device)


def balls(points: Tensor, centres: Tensor, radius: float) -> Tensor:
    """Return edges (2, E) from the rows of B N points to the B M centres within `radius`."""
    edges = []
    for i, (x, c) in enumerate(zip(_arrays(points), _arrays(centres), strict=True)):
        pairs = cKDTree(x).sparse_distance_matrix(cKDTree(c), radius, output_type="ndarray")
        edges.append(np.stack([pairs["i"] + i * len(x), pairs["j"] + i * len(c)]))
    return torch.from_numpy(np.concatenate(edges, axis=1)).to(points.device)


def interpolate(x: Tensor, centres: Tensor, points: Tensor) -> Tensor:
    """Return features (B N, c) of points (B, N, 3) from those (B M, c) of centres (B, M, 3).

    The mean of the three nearest centres, weighted by the inverse squares of their distances.
    """
    rows = nearest(centres, points, 3)
    gaps = centres.flatten(0, 1)[rows] - points.flatten(0, 1).unsqueeze(1)
    weights = 1 / gaps.square().sum(-1, keepdim=True).clamp(min=1e-16)
    weights = (weights / weights.sum(1, keepdim=True)).to(x.dtype)
    return (weights * x[rows]).sum(1)


def _graph(points: Tensor) -> Tensor:
    """Edges (2, E) to every one of B N points from its nearest, itself among them."""
    sources = nearest(points, points, _NEIGHBOURS)
    targets = torch.arange(len(sources), device=points.device).unsqueeze(1).expand_as(sources)
    return torch.stack([sources.flatten(), targets.flatten()])


def _arrays(points: Tensor) -> Any:
    return points.detach().cpu().numpy()


def _mlp(*channels: int, plain_last: bool = False) -> nn.Module:
    """Linear layers, each followed by a norm of every row by itself, and SiLU."""
    module: nn.Module = _geometric().MLP(
        list(channels),
        act="silu",
        norm="layer_norm",
        norm_kwargs={"mode": "node"},  # the default would mix the clouds of a batch
        plain_last=plain_last,
    )
    return module


def _geometric() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of torch.jit, used on import
        return optional("torch_geometric.nn", extra="backbones", needed_by="this backbone")


#: What `NeoConfig.backbone` may name.
BACKBONES: dict[str, type[NeoNetwork]] = {
    "neo": NeoNetwork,
    "pointnet++": PointNetPlusPlus,
    "point-transformer": PointTransformer,
}


@checked
def build_network(config: NeoConfig) -> NeoNetwork:
    """Return the network that a configuration describes, with random weights.

    Parameters
    ----------
    config : NeoConfig
        Sizes and backbone.

    Returns
    -------
    NeoNetwork
        Or a subclass with another backbone under the same heads.

    Examples
    --------
    >>> from spectra_kit.neo import NeoConfig, build_network
    >>> build_network(NeoConfig.named("small")).config.backbone
    'neo'
    """
    return BACKBONES[config.backbone](config)
