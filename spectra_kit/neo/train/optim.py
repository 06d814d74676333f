"""Muon for the matrices, AdamW for the rest, and the warmup-stable-decay schedule."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import AdamW, Optimizer

from spectra_kit.errors import InvalidInputError

_QUINTIC = (3.4445, -4.7750, 2.0315)  # Newton-Schulz coefficients, Jordan et al. 2024


def orthogonalise(matrices: Tensor) -> Tensor:
    """Return (b, rows, columns) matrices with all singular values pushed to about one.

    Five steps of quintic Newton-Schulz iteration in the precision of the argument.
    """
    tall = matrices.shape[-2] > matrices.shape[-1]
    Z = matrices.mT if tall else matrices
    Z = Z / Z.norm(dim=(-2, -1), keepdim=True).clamp_min(1e-7)
    a, b, c = _QUINTIC
    for _ in range(5):
        A = Z @ Z.mT
        Z = a * Z + (b * A + c * A @ A) @ Z
    result: Tensor = Z.mT if tall else Z
    return result


class Muon(Optimizer):
    """Momentum orthogonalised by Newton-Schulz, with step sizes that match AdamW's.

    The update of `torch.optim.Muon` with ``adjust_lr_fn="match_rms_adamw"`` (a test compares
    them), but matrices of equal shape go through one batched product and, on a CPU, in float32:
    torch's always runs in bfloat16, which processors without such units emulate. Measured for
    the `small` network on two AVX2 cores: 1.7 s a step there, 0.1 s here.

    Takes matrices, and the step size as for AdamW. The decay is decoupled; the momentum, of the
    exponential average of gradients, is used in Nesterov's form. `apply` runs the shapes; the
    ``map`` of a thread pool runs them side by side.
    """

    def __init__(
        self,
        params: Iterable[Tensor],
        lr: float,
        *,
        weight_decay: float = 0.04,
        momentum: float = 0.95,
        apply: Callable[..., Iterable[None]] = map,
    ) -> None:
        self.apply = apply
        defaults = {"lr": lr, "weight_decay": weight_decay, "momentum": momentum}
        super().__init__(params, defaults)

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        """Update every parameter that has a gradient."""
        loss = None if closure is None else torch.enable_grad()(closure)()
        for group in self.param_groups:
            alike: dict[torch.Size, list[Tensor]] = defaultdict(list)
            for parameter in group["params"]:
                if parameter.grad is not None:
                    alike[parameter.shape].append(parameter)
            list(self.apply(partial(self._update, group), alike.values()))
        return loss

    @torch.no_grad()
    def _update(self, group: dict[str, Any], parameters: list[Tensor]) -> None:
        """Update parameters of one shape."""
        update = orthogonalise(torch.stack([self._blend(p, group) for p in parameters]))
        step = group["lr"] * 0.2 * math.sqrt(max(parameters[0].shape))
        for parameter, direction in zip(parameters, update, strict=True):
            parameter.mul_(1 - group["lr"] * group["weight_decay"])
            parameter.add_(direction.to(parameter.dtype), alpha=-step)

    def _blend(self, parameter: Tensor, group: dict[str, Any]) -> Tensor:
        assert parameter.grad is not None
        gradient = parameter.grad
        state = self.state[parameter]
        if not state:
            state["momentum_buffer"] = torch.zeros_like(gradient)
        average = state["momentum_buffer"].lerp_(gradient, 1 - group["momentum"])
        blend = gradient.lerp(average, group["momentum"])
        return blend.bfloat16() if blend.is_cuda else blend


def make_optimizers(
    network: nn.Module,
    *,
    lr: float,
    weight_decay: float = 0.04,
    apply: Callable[..., Iterable[None]] = map,
) -> tuple[Muon, AdamW]:
    """Split the parameters as the paper does.

    Matrices with both sizes above 32 go to `Muon`; biases, norms and latent queries to AdamW with
    betas (0.9, 0.99). See `Muon` for `apply`.
    """
    parameters = list(network.parameters())
    matrices = [p for p in parameters if p.ndim == 2 and min(p.shape) > 32]
    if not matrices:
        raise InvalidInputError(
            "network",
            "have a matrix with both sizes above 32, which Muon trains",
            "none",
            advice="make it wider",
        )
    chosen = {id(p) for p in matrices}
    rest = [p for p in parameters if id(p) not in chosen]
    return (
        Muon(matrices, lr, weight_decay=weight_decay, apply=apply),
        AdamW(rest, lr=lr, betas=(0.9, 0.99), weight_decay=weight_decay),
    )


@torch.no_grad()
def average_weights(average: nn.Module, network: nn.Module, step: int, decay: float) -> None:
    """Move averaged weights towards those of a network after its step number `step`, from 0.

    The exponential moving average, ``average = d average + (1 - d) network``; early on d is
    (1 + step) / (10 + step), so that the random initial weights are soon forgotten.
    """
    weight = 1 - min(decay, (1 + step) / (10 + step))
    torch._foreach_lerp_(list(average.parameters()), list(network.parameters()), weight)


def warmup_stable_decay(progress: float, *, warmup: float = 0.1, decay: float = 0.2) -> float:
    """Return the learning-rate factor at a share of the training, in [0, 1].

    Linear rise over the first `warmup`, one, then a linear fall to zero over the last `decay`,
    which are shares too. Ends of other shapes gave the same span error within 2 %.
    """
    return min(1.0, progress / warmup, max(0.0, 1.0 - progress) / decay)
