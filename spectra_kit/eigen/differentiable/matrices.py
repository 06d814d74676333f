"""`eigenvalues`: of a stiffness matrix and a mass, differentiable by both."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy import sparse
from torch import Tensor

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._sparse.torch_device import csr_like
from spectra_kit.eigen.automatic import Automatic
from spectra_kit.eigen.base import Eigensolver
from spectra_kit.eigen.differentiable.modes import whole_clusters
from spectra_kit.eigen.solve import eigensolve
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators import Laplacian

_LAYOUTS = (torch.sparse_coo, torch.sparse_csr)


@checked
def eigenvalues(
    stiffness: Tensor,
    mass: Tensor,
    k: int,
    *,
    solver: Eigensolver = Automatic(),  # noqa: B008
    points: Annotated[ArrayLike, Tensor] | None = None,
    fixed: ArrayLike = (),
) -> Tensor:
    """Return the k lowest eigenvalues of ``L u = lambda M u``, differentiable by L and M.

    Parameters
    ----------
    stiffness : Tensor of shape (n, n), sparse COO or CSR
        L, symmetric and positive semi-definite.
    mass : Tensor of shape (n,)
        The diagonal of M, positive.
    k : int
        Number of eigenvalues, zeros included.
    solver : Eigensolver, default Automatic()
        As of `eigensolve`.
    points : array_like or Tensor of shape (n, 3), optional
        Where the unknowns live, for solvers that ask: `Neo`, `Cascade`, `RayleighRitz`, `Refined`.
        `Arpack` and `Dense` do not. Nothing is differentiated by them.
    fixed : array_like of int, default ()
        Points held at zero (homogeneous Dirichlet).

    Returns
    -------
    Tensor of shape (k,), float64
        Those of `eigensolve`, on the device of `stiffness`. Computed in float64 on the CPU;
        gradients have the dtype and the device of what they belong to.

    Raises
    ------
    ConvergenceError, InvalidSpectrumError, OutOfMemoryError
        As `eigensolve`.

    Notes
    -----
    With M-orthonormal modes, ``d lambda_i / d L = u_i u_i^T``, on the entries that `stiffness` has,
    and ``d lambda_i / d M_jj = -lambda_i u_ij^2`` (Hellmann and Feynman). Each entry counts by
    itself, as in `torch.linalg.eigh`: who changes L_ij must change L_ji as well. Memory grows with
    n k and the number of entries. Who asks for second derivatives is refused.

    Eigenvalues that differ by no more than their errors (`Certificate.errors`, the rounding of L
    and M at least) are one cluster, and each has the gradient of their mean; where k cuts one, the
    rest is solved for. An approximate solver does not tell eigenvalues apart that differ by less
    than its errors, and what of its last cluster lies beyond k is unknown.

    Zero modes are differentiated as any other, for not every change of L keeps them: a potential
    lifts them. Where rows of dL sum to zero, so does what they contribute.

    References
    ----------
    Magnus, *On differentiating eigenvalues and eigenvectors*, Econometric Theory 1985.

    Examples
    --------
    Three points in a row, and two springs between them:

    >>> import torch
    >>> from spectra_kit.eigen.differentiable import eigenvalues
    >>> springs = torch.ones(2, dtype=torch.float64, requires_grad=True)
    >>> i, j = torch.tensor([0, 1]), torch.tensor([1, 2])
    >>> index = torch.stack([torch.cat([i, j, i, j]), torch.cat([i, j, j, i])])
    >>> entries = torch.cat([springs, springs, -springs, -springs])
    >>> L = torch.sparse_coo_tensor(index, entries, (3, 3), check_invariants=True)
    >>> values = eigenvalues(L, torch.ones(3), 3)
    >>> values[1].backward()
    >>> print(values.detach().numpy().round(3), springs.grad.numpy().round(3))
    [0. 1. 3.] [0.5 0.5]
    """
    if stiffness.layout not in _LAYOUTS or stiffness.ndim != 2 or not stiffness.is_floating_point():
        raise InvalidInputError(
            "stiffness",
            "be a real sparse tensor of shape (n, n), COO or CSR",
            f"{stiffness.layout} of shape {tuple(stiffness.shape)} and {stiffness.dtype}",
            advice="a dense one has .to_sparse()",
        )
    n = len(stiffness)
    if mass.layout != torch.strided or mass.shape != (n,) or not mass.is_floating_point():
        raise InvalidInputError(
            "mass",
            f"be a real tensor of shape ({n},)",
            f"{mass.layout} of shape {tuple(mass.shape)} and {mass.dtype}",
        )
    if stiffness.layout == torch.sparse_coo:
        stiffness = stiffness.coalesce()  # entries given twice are added, and so differentiated
    where = np.zeros((n, 3)) if points is None else array_of(points)
    given = stiffness, mass, k, solver, where, np.asarray(fixed)
    found: Tensor = _Eigenvalues.apply(*given)  # type: ignore[no-untyped-call]
    return found


def array_of(values: Any) -> Any:
    """Return a tensor's values where NumPy can see them; anything else as it is."""
    return values.detach().cpu().numpy() if isinstance(values, Tensor) else values


class _Eigenvalues(torch.autograd.Function):
    """What torch calls: values forth, derivatives back."""

    @staticmethod
    def forward(
        ctx: Any,
        stiffness: Tensor,
        mass: Tensor,
        k: int,
        solver: Eigensolver,
        points: Floats,
        fixed: Ints,
    ) -> Tensor:
        L, rows, columns = _scipy(stiffness)
        laplacian = Laplacian(
            L,
            array_of(mass).astype(np.float64),
            points,
            operator="tensors",
            fixed=fixed,
        )
        spectrum = eigensolve(laplacian, k, solver)
        if any(ctx.needs_input_grad):
            ctx.modes = whole_clusters(spectrum, laplacian, solver)
            ctx.rows, ctx.columns = rows, columns
            ctx.save_for_backward(stiffness, mass)
        return torch.tensor(np.array(spectrum.eigenvalues), device=stiffness.device)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        modes, (stiffness, mass) = ctx.modes, ctx.saved_tensors
        weights = modes.weights(array_of(gradient))
        by_entry, by_mass = np.zeros(len(ctx.rows)), np.zeros(len(mass))
        for j in np.flatnonzero(weights):  # one by one: no array has all modes at all entries
            u = np.ascontiguousarray(modes.eigenvectors[:, j])
            by_entry += weights[j] * u[ctx.rows] * u[ctx.columns]
            by_mass -= weights[j] * modes.eigenvalues[j] * u**2
        found = _like(stiffness.detach(), by_entry), torch.from_numpy(by_mass).to(mass)
        of = gradient, stiffness, mass
        asked = (
            first_derivative(one, *of) if needed else None
            for one, needed in zip(found, ctx.needs_input_grad, strict=False)
        )
        return *asked, *(None,) * 4


def _scipy(matrix: Tensor) -> tuple[sparse.csr_array, Any, Any]:
    """Return a sparse tensor for SciPy, and the row and column of each of its entries."""
    matrix = matrix.detach()
    values = array_of(matrix.values()).astype(np.float64)
    if matrix.layout == torch.sparse_coo:
        rows, columns = array_of(matrix.indices())
    else:
        ends, columns = array_of(matrix.crow_indices()), array_of(matrix.col_indices())
        rows = np.repeat(np.arange(len(matrix)), np.diff(ends))
    return sparse.csr_array((values, (rows, columns)), shape=tuple(matrix.shape)), rows, columns


def _like(matrix: Tensor, entries: Any) -> Tensor:
    """Return a sparse tensor with other entries at the same places."""
    values = torch.from_numpy(entries).to(matrix.values())
    if matrix.layout == torch.sparse_csr:
        return csr_like(matrix, values)
    return torch.sparse_coo_tensor(
        matrix.indices(), values, matrix.shape, is_coalesced=True, check_invariants=True
    )


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
