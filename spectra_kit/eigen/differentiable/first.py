"""First derivatives alone: who asks for second ones is told, instead of given zeros."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from spectra_kit.errors import InvalidInputError


def first_derivative(gradient: Tensor, *of: Tensor) -> Tensor:
    """Return a gradient that refuses to be differentiated by what it is a function of.

    `torch.autograd.function.once_differentiable` does so for weights that have a gradient
    themselves; a plain sum of eigenvalues would silently have second derivatives of zero.
    """
    if not torch.is_grad_enabled():  # nobody has said ``create_graph=True``
        return gradient
    found: Tensor = _First.apply(gradient, *of)  # type: ignore[no-untyped-call]
    return found


class _First(torch.autograd.Function):
    """The identity, that cannot be differentiated."""

    @staticmethod
    def forward(ctx: Any, gradient: Tensor, *of: Tensor) -> Tensor:
        return gradient.clone()

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        raise InvalidInputError(
            "eigenvalues have first derivatives alone",
            advice="take second ones by differences of the first",
        )
