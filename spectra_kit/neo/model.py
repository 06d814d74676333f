"""The NEO network: points and masses in, m functions that span the low modes out.

The mass-aware Low-Rank Spatial Attention backbone of the NEO paper, "Training and Architecture",
in one file. Read `NeoNetwork.forward` first. Letters: B clouds, N points, D width, H heads,
d head width, a = H d attention width, r latents, m outputs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import check_positive
from spectra_kit.errors import InvalidInputError

_EXPONENTS = torch.linspace(-2, 6, 24)  # frequencies 2^-2 ... 2^6 half-turns per unit of length
_NO_MASS = torch.finfo(torch.float32).tiny
ENCODED = 3 + 2 * 3 * len(_EXPONENTS)  # channels of `encode`


@checked
@dataclass(frozen=True, kw_only=True)
class NeoConfig:
    """The hyper-parameters that a weights file carries.

    Parameters
    ----------
    width, depth : int
        Channels per point D and number of blocks.
    heads, head_width : int
        Attention heads and channels per head.
    latents : int
        Latent tokens r of each block.
    m : int
        Output functions: two for each of the `waves`, the others free. Where as many as `width`
        are free, these are the residual stream itself; else see `FreeHead`.
    k : int, default 96
        Modes whose span the network is trained to cover.
    waves : int, default 0
        How many plane waves the network modulates, each for two of the m functions; 0 is the
        paper's architecture.
    bandwidth : float, default 7
        Standard deviation of the waves' frequencies, in radians per unit of posed coordinates.
    mass_aware : bool, default True
        False leaves the masses out of the attention: the paper's ablation.
    backbone : {"neo", "pointnet++", "point-transformer"}, default "neo"
        What turns points into features of width D: the paper's network, or one of those that it
        compares with; see `build_network`.
    frame : {"principal", "none"}, default "principal"
        Pose the network expects: the canonical frame of the cloud, or any pose that is centred
        and scaled into [-1, 1]^3. At equal short training (2,000 samples) the span error on
        other clouds was 0.074 with the first and 0.090 with uniform random rotations.

    Examples
    --------
    >>> from spectra_kit.neo import NeoConfig
    >>> NeoConfig.named("base").m
    256
    """

    width: int
    depth: int
    heads: int
    head_width: int
    latents: int
    m: int
    k: int = 96
    waves: int = 0
    bandwidth: float = 7.0
    mass_aware: bool = True
    backbone: Literal["neo", "pointnet++", "point-transformer"] = "neo"
    frame: Literal["principal", "none"] = "principal"

    def __post_init__(self) -> None:
        sizes = (self.width, self.depth, self.heads, self.head_width, self.latents, self.k)
        if min(sizes) < 1 or self.m < self.k:
            raise InvalidInputError(f"sizes of a network must be positive with m >= k, got {self}")
        if not 0 <= 2 * self.waves < self.m:
            raise InvalidInputError("waves", "be in [0, m / 2)", self.waves)
        check_positive("bandwidth", self.bandwidth)

    @property
    def attention_width(self) -> int:
        """Channels of all heads together."""
        return self.heads * self.head_width

    @classmethod
    def named(cls, name: str) -> NeoConfig:
        """Return a configuration by its name.

        ``"small"``, which trains on a laptop, and ``"base"`` are ours, with modulated waves.
        ``"paper-base"``, ``"paper-deep"`` and ``"paper-large"`` are the paper's (Table "NEO Model
        Configurations"); its 16.9 M parameters of Large fit 4 heads of 72, not the printed 8 of
        32. ``"base"`` is ``"paper-base"`` with 32 waves beside the functions of the paper.
        """
        if name not in _NAMED:
            raise InvalidInputError("name", f"be one of {sorted(_NAMED)}", repr(name))
        return _NAMED[name]


_NAMED = {
    "small": NeoConfig(width=128, depth=4, heads=4, head_width=32, latents=64, m=256, waves=32),
    "base": NeoConfig(width=192, depth=4, heads=4, head_width=48, latents=192, m=256, waves=32),
    "paper-base": NeoConfig(width=192, depth=4, heads=4, head_width=48, latents=192, m=192),
    "paper-deep": NeoConfig(width=192, depth=8, heads=4, head_width=48, latents=192, m=192),
    "paper-large": NeoConfig(width=256, depth=6, heads=4, head_width=72, latents=256, m=256),
}


def encode(points: Tensor) -> Tensor:
    """Return [x, sin(pi 2^e x), cos(pi 2^e x)] of points (..., 3) as (..., 147), in float32."""
    points = points.float()
    angles = points.unsqueeze(-1) * (math.pi * 2.0 ** _EXPONENTS.to(points.device))
    angles = angles.flatten(-2)  # (..., 72): x at all frequencies, then y, then z
    return torch.cat([points, angles.sin(), angles.cos()], dim=-1)


class SwiGLU(nn.Module):
    """Gated feed-forward layer, W_down(SiLU(W_gate x) * W_up x)."""

    def __init__(self, width: int, out: int | None = None) -> None:
        super().__init__()
        hidden = 16 * math.ceil(int(width * 8 / 3) / 16)
        self.gate = nn.Linear(width, hidden)
        self.up = nn.Linear(width, hidden)
        self.down = nn.Linear(hidden, out or width)

    def forward(self, x: Tensor) -> Tensor:
        """Return features (..., out) of features (..., width)."""
        out: Tensor = self.down(F.silu(self.gate(x)) * self.up(x))
        return out


def _norm(width: int) -> nn.LayerNorm:
    return nn.LayerNorm(width, bias=False)


class _Attention(nn.Module):
    """What both attentions share: heads, and layer norm on queries and keys."""

    def __init__(self, config: NeoConfig) -> None:
        super().__init__()
        self.heads, self.head_width = config.heads, config.head_width
        self.norm_q, self.norm_k = _norm(config.head_width), _norm(config.head_width)

    def split(self, x: Tensor) -> Tensor:
        return x.view(*x.shape[:-1], self.heads, self.head_width).transpose(-2, -3)  # (B, H, N, d)

    def merge(self, x: Tensor) -> Tensor:
        return x.transpose(-2, -3).flatten(-2)  # (B, N, a)


class DownAttention(_Attention):
    """Points to latents: a quadrature over the surface, by log-mass in the logits."""

    def __init__(self, config: NeoConfig) -> None:
        super().__init__(config)
        a = config.attention_width
        self.queries = nn.Parameter(torch.empty(config.heads, config.latents, config.head_width))
        self.key, self.value = nn.Linear(config.width, a), nn.Linear(config.width, a)
        self.out = nn.Linear(a, a)

    def forward(self, x: Tensor, log_mass: Tensor) -> Tensor:
        """Gather (B, N, D) with log-mass (B, N) into (B, r, a)."""
        q, k, v = self._qkv(x, log_mass)
        z = F.scaled_dot_product_attention(q, k, F.pad(v, (0, 1)), scale=self._scale)
        return self._out(z[..., :-1])  # (B, r, a)

    def streamed(self, chunks: Iterator[tuple[Tensor, Tensor]]) -> Tensor:
        """Return `forward` of the concatenated (x, log_mass) chunks, holding one at a time."""
        peak, below, above = torch.tensor(-torch.inf), torch.tensor(0.0), torch.tensor(0.0)
        for x, log_mass in chunks:
            q, k, v = self._qkv(x, log_mass)
            logits = (self._scale * q @ k.transpose(-1, -2)).float()  # (B, H, r, chunk)
            old, peak = peak.to(logits.device), logits.amax(-1, keepdim=True).maximum(peak)
            weights = logits.sub_(peak).exp_()
            shrink = (old - peak).exp()
            below = below * shrink + weights.sum(-1, keepdim=True)
            above = above * shrink + weights @ v.float()
        return self._out((above / below).to(self.queries.dtype))

    @property
    def _scale(self) -> float:
        return 1 / math.sqrt(self.head_width)

    def _qkv(self, x: Tensor, log_mass: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        # The log-mass rides as one more channel of the keys against a constant one of the
        # queries: the same logits as an additive mask, and fused kernels accept it.
        k = self.norm_k(self.split(self.key(x)))
        bias = log_mass.to(k.dtype)[..., None, :, None].expand(*k.shape[:-1], 1)
        q = F.pad(self.norm_q(self.queries), (0, 1), value=math.sqrt(self.head_width))
        q = q.expand(*x.shape[:-2], *q.shape).to(k.dtype)
        return q, torch.cat([k, bias], dim=-1), self.split(self.value(x))

    def _out(self, z: Tensor) -> Tensor:
        out: Tensor = self.out(self.merge(z))
        return out


class CrossAttention(_Attention):
    """Features of width D read latents: points do, and latents themselves.

    Latents are no samples of the surface, so no mass here.
    """

    def __init__(self, config: NeoConfig, width: int) -> None:
        super().__init__(config)
        a = config.attention_width
        self.query, self.out = nn.Linear(width, a), nn.Linear(a, width)
        self.key, self.value = nn.Linear(a, a), nn.Linear(a, a)

    def forward(self, x: Tensor, z: Tensor) -> Tensor:
        """Read (B, r, a) at features (B, N, D), as (B, N, D)."""
        q, k = self.norm_q(self.split(self.query(x))), self.norm_k(self.split(self.key(z)))
        mixed = F.scaled_dot_product_attention(q, k, self.split(self.value(z)))
        out: Tensor = self.out(self.merge(mixed))
        return out


class Block(nn.Module):
    """Pre-norm block: latent bottleneck, then point-wise feed-forward. Latents start afresh."""

    def __init__(self, config: NeoConfig) -> None:
        super().__init__()
        a = config.attention_width
        self.norm1, self.norm2 = _norm(config.width), _norm(config.width)
        self.down = DownAttention(config)
        self.latent_norm1, self.latent_ffn1 = _norm(a), SwiGLU(a)
        self.latent_norm2, self.latent_attention = _norm(a), CrossAttention(config, a)
        self.latent_norm3, self.latent_ffn2 = _norm(a), SwiGLU(a)
        self.latent_norm4 = _norm(a)
        self.up = CrossAttention(config, config.width)
        self.ffn = SwiGLU(config.width)

    def forward(self, h: Tensor, log_mass: Tensor) -> Tensor:
        """Return the points' next features, (B, N, D)."""
        z = self.process(self.down(self.norm1(h), log_mass))
        return self.update(h, z)

    def process(self, z: Tensor) -> Tensor:
        """Mix the latents (B, r, a) among themselves."""
        z = z + self.latent_ffn1(self.latent_norm1(z))
        normed = self.latent_norm2(z)
        z = z + self.latent_attention(normed, normed)
        z = z + self.latent_ffn2(self.latent_norm3(z))
        mixed: Tensor = self.latent_norm4(z)
        return mixed

    def update(self, h: Tensor, z: Tensor) -> Tensor:
        """Return the points' next features (B, N, D), each from its own and the latents."""
        h = h + self.up(self.norm1(h), z)
        out: Tensor = h + self.ffn(self.norm2(h))
        return out


class FreeHead(nn.Module):
    """Functions beside the waves, of which there may be fewer than D, as many, or more.

    Fewer are linear functions of the residual stream, and as many are the stream itself, as in the
    paper. More are D linear ones and, beyond these, gated ones: the outputs of a linear layer span
    at most D + 1 dimensions, whatever their number.
    """

    def __init__(self, config: NeoConfig) -> None:
        super().__init__()
        width, self.count = config.width, config.m - 2 * config.waves
        if self.count != width:
            self.linear = nn.Linear(width, min(width, self.count))
        if self.count > width:
            self.norm, self.ffn = _norm(width), SwiGLU(width, self.count - width)

    def forward(self, h: Tensor, points: Tensor) -> Tensor:
        """Return (..., free) of features (..., D); the points play no part."""
        if self.count == h.shape[-1]:
            return h
        out: Tensor = self.linear(h)
        return out if self.count < h.shape[-1] else torch.cat([out, self.ffn(self.norm(h))], dim=-1)


class WaveHead(nn.Module):
    """Free functions, and plane waves that the network turns and scales from point to point.

    For every fixed frequency w there are two outputs, (1 + g) cos(w x) - h sin(w x) and
    (1 + g) sin(w x) + h cos(w x), with gates g and h predicted at the point; the other ``m - 2
    waves`` outputs are free. Fine detail is in the waves from the start, so the network learns
    envelopes, which are smooth, instead of oscillations.
    """

    frequencies: Tensor

    def __init__(self, config: NeoConfig) -> None:
        super().__init__()
        self.free = FreeHead(config)
        drawn = np.random.default_rng(0).normal(scale=config.bandwidth, size=(config.waves, 3))
        # In the weights file, for no generator is promised to draw the same for ever; rounded so
        # that both half precisions hold them exactly.
        self.register_buffer("frequencies", torch.from_numpy(drawn).bfloat16().float())
        self.norm = _norm(config.width)
        self.gates = nn.Linear(config.width, 2 * config.waves)

    def forward(self, h: Tensor, points: Tensor) -> Tensor:
        """Return (..., m) of features (..., D) at posed points (..., 3)."""
        # A sum, not a matrix product, which autocast would round: phases need float32.
        angles = (points.float().unsqueeze(-2) * self.frequencies.float()).sum(-1)
        cos, sin = angles.cos().to(h.dtype), angles.sin().to(h.dtype)
        g, turn = self.gates(self.norm(h)).chunk(2, dim=-1)
        gain = 1 + g
        waves = [gain * cos - turn * sin, gain * sin + turn * cos]
        return torch.cat([self.free(h, points), *waves], dim=-1)


class NeoNetwork(nn.Module):
    """The neural operator F(X, w) of the paper, Eq. "attn_mass" and Fig. "backbone".

    Equivariant to permutations of the points, invariant to the scale of the masses, and a true
    quadrature: splitting a point into copies that share its mass leaves all outputs unchanged, and
    so do more points without mass.

    Parameters
    ----------
    config : NeoConfig
        Sizes. Weights start random; seed torch, or load a pretrained file.

    Examples
    --------
    >>> import torch
    >>> from spectra_kit.neo import NeoConfig, NeoNetwork
    >>> network = NeoNetwork(NeoConfig.named("small"))
    >>> points = torch.rand(2, 50, 3) - 0.5
    >>> network(points, torch.ones(2, 50)).shape
    torch.Size([2, 50, 256])
    """

    @checked
    def __init__(self, config: NeoConfig) -> None:
        super().__init__()
        self.config = config
        self.lift = nn.Linear(ENCODED, config.width)
        self.blocks = nn.ModuleList(Block(config) for _ in range(config.depth))
        self.head = WaveHead(config) if config.waves else FreeHead(config)
        for module in self.modules():
            if isinstance(module, _Attention):
                for name, parameter in module.named_parameters():
                    if parameter.ndim > 1:
                        nn.init.trunc_normal_(parameter, std=0.02)
                    elif name.endswith("bias"):
                        nn.init.zeros_(parameter)

    def forward(self, points: Tensor, mass: Tensor) -> Tensor:
        """Predict basis functions (B, N, m), not orthonormal, in the precision of the weights.

        Points (B, N, 3) are posed, in [-1, 1]^3. Of the masses (B, N) only the ratios matter;
        points of none change nothing at the others.
        """
        out: Tensor = self.head(self.features(points, mass), points)
        return out

    def features(self, points: Tensor, mass: Tensor) -> Tensor:
        """Return the residual stream (B, N, D) that the head reads; arguments as of `forward`."""
        h: Tensor = self.lift(encode(points).to(self.lift.weight.dtype))
        log_mass = self._log_mass(mass)
        for block in self.blocks:
            h = block(h, log_mass)
        return h

    @torch.no_grad()
    def evaluate_chunked(
        self, points: Tensor, mass: Tensor, *, chunk: int = 65536, out: Tensor | None = None
    ) -> Tensor:
        """Return `forward` of one cloud, with temporaries of `chunk` points instead of N.

        What grows with N is one row of D features and the output. The down-attention adds up
        softmax numerators and denominators over chunks in float32, so the result differs from
        `forward` by rounding alone. Points are (N, 3) and masses (N,). The functions (N, m) are
        written to `out`, in its precision, or to new memory in that of the weights.
        """
        parts = [slice(i, i + chunk) for i in range(0, len(points), chunk)]
        h = self._features_in(parts, points, mass)
        if out is None:
            out = torch.empty(len(points), self.config.m, dtype=h.dtype, device=h.device)
        for part in parts:
            out[part] = self.head(h[part], points[part])
        return out

    def _features_in(self, parts: list[slice], points: Tensor, mass: Tensor) -> Tensor:
        """Return the features (N, D) of one cloud, made one part at a time."""
        log_mass, dtype = self._log_mass(mass), self.lift.weight.dtype
        h = torch.empty(len(points), self.config.width, dtype=dtype, device=points.device)
        for part in parts:
            h[part] = self.lift(encode(points[part]).to(dtype))
        for block in self.blocks:
            assert isinstance(block, Block)
            z = block.process(
                block.down.streamed((block.norm1(h[part]), log_mass[part]) for part in parts)
            )
            for part in parts:
                h[part] = block.update(h[part], z)
        return h

    def _log_mass(self, mass: Tensor) -> Tensor:
        if not self.config.mass_aware:
            return torch.zeros_like(mass, dtype=torch.float32)
        # Relative to the mean: a constant shift that softmax ignores and float16 needs. Padding, of
        # no mass, gets weights of 1e-38, which leave sums as they are and gradients finite.
        mass = mass.float()
        return (mass / mass.mean(dim=-1, keepdim=True)).clamp(min=_NO_MASS).log()
