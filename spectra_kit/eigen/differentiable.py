"""Eigenvalues as functions that PyTorch can differentiate: of matrices, and of vertices.

It stands above operators and solvers: each of them may be called, and none knows of it. So to solve
imports no torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy import sparse
from torch import Tensor

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._sparse.torch_device import csr_like
from spectra_kit.eigen.accuracy import error_units
from spectra_kit.eigen.automatic import Automatic
from spectra_kit.eigen.base import Eigensolver
from spectra_kit.eigen.solve import eigensolve
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import TriangleMesh
from spectra_kit.operators import Laplacian, laplacian
from spectra_kit.operators.differentiable import differentiable_laplacian

__all__ = ["eigenvalues", "mesh_eigenvalues"]

Operator = Literal["robust", "cotan", "delaunay"]
Boundary = Literal["neumann", "dirichlet"]
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
    L, rows, columns = _scipy(stiffness)
    where = np.zeros((n, 3)) if points is None else _array_of(points)
    masses = _array_of(mass).astype(np.float64)
    built = Laplacian(L, masses, where, operator="tensors", fixed=np.asarray(fixed))

    def back(modes: _Modes, weights: Floats) -> tuple[Tensor, Tensor]:
        by_entry, by_mass = np.zeros(len(rows)), np.zeros(n)
        for j in np.flatnonzero(weights):  # one by one: no array has all modes at all entries
            u = np.ascontiguousarray(modes.eigenvectors[:, j])
            by_entry += weights[j] * u[rows] * u[columns]
            by_mass -= weights[j] * modes.eigenvalues[j] * u**2
        return _like(stiffness.detach(), by_entry), torch.from_numpy(by_mass).to(mass)

    return _differentiable(built, k, solver, back, stiffness, mass)


@checked
def mesh_eigenvalues(
    points: Tensor,
    faces: Annotated[ArrayLike, Tensor],
    k: int,
    *,
    operator: Operator = "robust",
    boundary: Boundary = "neumann",
    solver: Eigensolver = Automatic(),  # noqa: B008
) -> Tensor:
    """Return the k lowest eigenvalues of a triangle mesh, differentiable by its vertices.

    Parameters
    ----------
    points : Tensor of shape (n, 3)
        Vertices.
    faces : array_like or Tensor of int, shape (f, 3)
        Indices of vertices.
    k : int
        Number of eigenvalues, zeros included.
    operator : {"robust", "cotan", "delaunay"}, default "robust"
        As of `laplacian`. The cheapest is "cotan".
    boundary : {"neumann", "dirichlet"}, default "neumann"
        As of `laplacian`.
    solver : Eigensolver, default Automatic()
        As of `eigensolve`.

    Returns
    -------
    Tensor of shape (k,), float64
        In 1/length^2: those of ``eigensolve(laplacian(mesh), k)``, on the device of `points`.
        Computed in float64 on the CPU; the gradient has the dtype and the device of `points`.

    Raises
    ------
    ConvergenceError, InvalidSpectrumError, OutOfMemoryError
        As `eigensolve`.

    Notes
    -----
    ``d lambda = u^T (dL - lambda dM) u`` for a mode with ``u^T M u = 1``: a sum over triangles, of
    which each is differentiated by the lengths of its sides. It is exact for the discrete operator,
    not only in the limit of fine meshes. The triangles of "robust" and "delaunay" come from edge
    flips and, where some are nearly degenerate, longer sides; the gradient goes back through both.
    As points move, these operators jump a little where an edge flips; "cotan" does not. The
    gradient is that of the triangles there are.

    Clusters of eigenvalues, and second derivatives, are as of `eigenvalues`. Zero modes have no
    gradient: exactly zero.

    References
    ----------
    Cosmo et al., *Isospectralization, or how to hear shape, style, and correspondence*, CVPR 2019.

    Examples
    --------
    Whichever way a ball is stretched, the three equal eigenvalues above zero fall, in the mean:

    >>> import torch
    >>> from spectra_kit.eigen.differentiable import mesh_eigenvalues
    >>> from spectra_kit.geometry import sphere
    >>> ball = sphere(subdivisions=3).geometry
    >>> stretch = torch.ones(3, dtype=torch.float64, requires_grad=True)
    >>> values = mesh_eigenvalues(torch.tensor(ball.points) * stretch, ball.faces, 4)
    >>> values[1:].mean().backward()
    >>> print(values.detach().numpy().round(1), stretch.grad.numpy().round(1))
    [0. 2. 2. 2.] [-1.3 -1.3 -1.3]
    """
    if not points.is_floating_point() or points.layout != torch.strided:
        raise InvalidInputError(
            "points", "be a dense tensor of real numbers", f"{points.layout} of {points.dtype}"
        )
    mesh = TriangleMesh(_array_of(points).astype(np.float64), _array_of(faces))
    if not points.requires_grad:
        return _differentiable(
            laplacian(mesh, operator=operator, boundary=boundary), k, solver, None, points
        )
    trace = differentiable_laplacian(mesh, operator, boundary)

    def back(modes: _Modes, weights: Floats) -> tuple[Tensor]:
        weights[: modes.n_zero] = 0.0
        found = trace.gradient(modes.eigenvalues, modes.eigenvectors, weights)
        return (torch.from_numpy(found).to(points),)

    return _differentiable(trace.laplacian, k, solver, back, points)


def _array_of(values: Any) -> Any:
    """Return a tensor's values where NumPy can see them; anything else as it is."""
    return values.detach().cpu().numpy() if isinstance(values, Tensor) else values


def _scipy(matrix: Tensor) -> tuple[sparse.csr_array, Any, Any]:
    """Return a sparse tensor for SciPy, and the row and column of each of its entries."""
    matrix = matrix.detach()
    values = _array_of(matrix.values()).astype(np.float64)
    if matrix.layout == torch.sparse_coo:
        rows, columns = _array_of(matrix.indices())
    else:
        ends, columns = _array_of(matrix.crow_indices()), _array_of(matrix.col_indices())
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


#: Takes modes, and a weight of each, to gradients by the tensors that they are functions of.
Back = Callable[["_Modes", Floats], Sequence[Tensor]]


def _differentiable(
    built: Laplacian, k: int, solver: Eigensolver, back: Back | None, *of: Tensor
) -> Tensor:
    """Return the eigenvalues of an operator, as a function of the tensors it was built of."""
    found: Tensor = _Eigenvalues.apply(built, k, solver, back, *of)  # type: ignore[no-untyped-call]
    return found


class _Eigenvalues(torch.autograd.Function):
    """What torch calls: values forth, derivatives back."""

    @staticmethod
    def forward(
        ctx: Any, built: Laplacian, k: int, solver: Eigensolver, back: Back | None, *of: Tensor
    ) -> Tensor:
        spectrum = eigensolve(built, k, solver)
        if any(ctx.needs_input_grad):
            ctx.modes, ctx.back = _whole_clusters(spectrum, built, solver), back
            ctx.save_for_backward(*of)
        return torch.tensor(np.array(spectrum.eigenvalues), device=of[0].device)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        of = ctx.saved_tensors
        found = ctx.back(ctx.modes, ctx.modes.weights(_array_of(gradient)))
        asked = (
            _first_derivative(one, gradient, *of) if needed else None
            for one, needed in zip(found, ctx.needs_input_grad[4:], strict=True)
        )
        return *(None,) * 4, *asked


def _first_derivative(gradient: Tensor, *of: Tensor) -> Tensor:
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


_MORE = 4  # modes to ask for at once, where those found cut a cluster


class _Modes(NamedTuple):
    """The k modes that were asked for, and those that complete the last cluster.

    Of several equal eigenvalues, the eigenvectors are any basis, and the change of one of them is
    no derivative: a perturbation splits them, and which way depends on it. Their sum is
    differentiable, so each gets the gradient of their mean.
    """

    eigenvalues: Floats  #: (k',), k' >= k
    eigenvectors: Floats  #: (n, k')
    cluster: Ints  #: (k',), from 0
    n_zero: int  #: Leading modes without energy.

    def weights(self, given: Floats) -> Floats:
        """Share the weights (k,) of the eigenvalues among all members (k',) of their clusters."""
        total = np.bincount(self.cluster[: len(given)], given, minlength=self.cluster[-1] + 1)
        return np.asarray((total / np.bincount(self.cluster))[self.cluster])


def _whole_clusters(spectrum: Spectrum, laplacian: Laplacian, solver: Eigensolver) -> _Modes:
    """Find what belongs together, and the modes that the last cluster lacks.

    Of an approximate spectrum the last cluster is taken as it is: no count tells what is missing.
    """
    k, n_free = spectrum.k, len(laplacian.free)
    more, cluster = _MORE, _clusters(spectrum, laplacian)
    if _is_complete(spectrum, laplacian):
        n_whole = k
    else:
        while True:
            wide = min(k + more, n_free)
            spectrum = eigensolve(laplacian, wide, solver)
            cluster = _clusters(spectrum, laplacian)
            n_whole = int(np.searchsorted(cluster, cluster[k - 1], side="right"))
            if n_whole < wide or wide == n_free:
                break
            more *= 2
    assert spectrum.certificate is not None
    return _Modes(
        spectrum.eigenvalues[:n_whole],
        spectrum.eigenvectors[:, :n_whole],
        cluster[:n_whole],
        min(spectrum.certificate.n_zero_modes, n_whole),
    )


def _is_complete(spectrum: Spectrum, laplacian: Laplacian) -> bool:
    """Whether no eigenvalue beyond the last one may belong to its cluster, as far as is known."""
    certificate = spectrum.certificate
    assert certificate is not None
    if spectrum.k == len(laplacian.free) or certificate.level != "verified":
        return True
    assert certificate.count is not None
    return bool(
        certificate.count.floor > spectrum.eigenvalues[-1] + _errors(spectrum, laplacian)[-1]
    )


def _clusters(spectrum: Spectrum, laplacian: Laplacian) -> Ints:
    """Number the clusters: neighbours that differ by no more than their errors are one.

    Zero modes, which are known exactly, are one of their own.
    """
    errors = _errors(spectrum, laplacian)
    apart = np.diff(spectrum.eigenvalues) > errors[1:] + errors[:-1]
    assert spectrum.certificate is not None
    n_zero = spectrum.certificate.n_zero_modes
    apart[: max(n_zero - 1, 0)] = False
    apart[n_zero - 1 : n_zero] = n_zero > 0
    return np.append(0, np.cumsum(apart))


def _errors(spectrum: Spectrum, laplacian: Laplacian) -> Floats:
    """Return how far each eigenvalue may be off, in 1/length^2: by rounding at least."""
    certificate = spectrum.certificate
    assert certificate is not None
    least = np.full(spectrum.k, laplacian._rounding)
    if certificate.errors is None:
        return least
    units = error_units(certificate, spectrum.eigenvalues, laplacian)
    return np.asarray(np.maximum(certificate.errors * units, least))
