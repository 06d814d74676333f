"""`mesh_eigenvalues`: of the Laplacians of a mesh, differentiable by its vertices."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from spectra_kit._core.checked import checked
from spectra_kit.eigen.automatic import Automatic
from spectra_kit.eigen.base import Eigensolver
from spectra_kit.eigen.differentiable.matrices import array_of, first_derivative
from spectra_kit.eigen.differentiable.modes import whole_clusters
from spectra_kit.eigen.solve import eigensolve
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import TriangleMesh
from spectra_kit.operators import laplacian
from spectra_kit.operators.differentiable import differentiable_laplacian

Operator = Literal["robust", "cotan", "delaunay"]
Boundary = Literal["neumann", "dirichlet"]


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
    given = points, array_of(faces), k, operator, boundary, solver
    found: Tensor = _MeshEigenvalues.apply(*given)  # type: ignore[no-untyped-call]
    return found


class _MeshEigenvalues(torch.autograd.Function):
    """What torch calls: values forth, derivatives back."""

    @staticmethod
    def forward(
        ctx: Any,
        points: Tensor,
        faces: Any,
        k: int,
        operator: Operator,
        boundary: Boundary,
        solver: Eigensolver,
    ) -> Tensor:
        mesh = TriangleMesh(array_of(points).astype(np.float64), faces)
        if ctx.needs_input_grad[0]:
            ctx.trace = differentiable_laplacian(mesh, operator, boundary)
            built = ctx.trace.laplacian
        else:
            built = laplacian(mesh, operator=operator, boundary=boundary)
        spectrum = eigensolve(built, k, solver)
        if ctx.needs_input_grad[0]:
            ctx.modes = whole_clusters(spectrum, built, solver)
            ctx.save_for_backward(points)
        return torch.tensor(np.array(spectrum.eigenvalues), device=points.device)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        modes, (points,) = ctx.modes, ctx.saved_tensors
        weights = modes.weights(array_of(gradient))
        weights[: modes.n_zero] = 0.0
        by_points = ctx.trace.gradient(modes.eigenvalues, modes.eigenvectors, weights)
        found = torch.from_numpy(by_points).to(points)
        return first_derivative(found, gradient, points), *(None,) * 5
