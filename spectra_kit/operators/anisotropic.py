"""Anisotropic Laplacians: heat flows faster along some directions of a mesh than along others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_positive, quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.seams import warn_of_seams
from spectra_kit.geometry.shapes import MeshLike, TriangleMesh
from spectra_kit.geometry.vectors import frames_of
from spectra_kit.operators.checks import check_faces_usable, symmetric_tensors, units_of
from spectra_kit.operators.curvature import curvature
from spectra_kit.operators.laplacian import Laplacian

_STILL = 1e-12  # share of the heat that flows, below which the operator is singular to rounding


@checked
def anisotropic_laplacian(
    mesh: MeshLike, strength: float, *, scale: float | None = None
) -> Laplacian:
    """Build a Laplacian for heat that flows more slowly along directions in which a mesh bends.

    Andreux, Rodola, Aubry and Cremers, *Anisotropic Laplace-Beltrami Operators for Shape Analysis*,
    NORDIA 2014, as in their program, and in LaPy's ``Solver(mesh, aniso=strength)``.

    Parameters
    ----------
    mesh : TriangleMesh
        With n vertices. Faces have an area.
    strength : float
        In length, positive: along a direction of principal curvature k flows ``exp(-strength |k|)``
        of the heat that flows on a plane.
    scale : float, optional
        As of `curvature`.

    Returns
    -------
    Laplacian
        Neumann; mass in the squared length unit of `mesh`, a third of each face at its corners.

    Warns
    -----
    DoubtfulCurvatureWarning
        As of `curvature`. Faces take the mean shape operator of the corners where it is known, and
        are isotropic without any.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.torus(n=800).geometry
    >>> for strength in (1e-9, 0.5):
    ...     flow = sk.operators.anisotropic_laplacian(mesh, strength)
    ...     print(sk.eigensolve(flow, 4).eigenvalues.round(2))
    [0.   1.03 1.03 3.6 ]
    [0.   0.68 0.68 1.41]
    """
    clock = Clock()
    check_positive("strength", strength)
    bent, frames = curvature(mesh, scale=scale), _planes(mesh)[0][:, :2]
    shape = np.einsum("nk,nkr,nks->nrs", bent.principal, bent.directions, bent.directions)
    known = ~np.isnan(shape[:, :1, :1])
    mean = np.where(known, shape, 0.0)[mesh.faces].sum(axis=1)
    mean /= np.maximum(known[mesh.faces].sum(axis=1), 1)
    bends, axes = np.linalg.eigh(np.einsum("far,frs,fbs->fab", frames, mean, frames))
    flow = np.exp(-strength * np.abs(bends))
    if not flow.min() > _STILL:
        raise InvalidInputError(
            "strength",
            "leave some heat to flow where the mesh bends most",
            f"{strength:g} beside a curvature of {np.abs(bends).max():.3g}",
        )
    along = np.einsum("fak,far->fkr", axes, frames)
    built = tensor_laplacian(mesh, np.einsum("fk,fkr,fks->frs", flow, along, along))
    operator = f"anisotropic_laplacian(mesh, {strength:g}, scale={scale})"
    return replace(built, operator=operator, seconds=clock.total)


@checked
def tensor_laplacian(mesh: MeshLike, tensors: ArrayLike) -> Laplacian:
    """Build the operator ``-div(D grad u)`` with a tensor D on each face.

    Parameters
    ----------
    mesh : TriangleMesh
        With n vertices and f faces. Faces have an area.
    tensors : array_like of shape (f,) or (f, 3, 3)
        D in coordinates of space, without a unit, symmetric, and positive definite in the plane of
        its face; what leads out of that does not count. The identity gives `cotan_laplacian`. A
        number is the same in all directions.

    Returns
    -------
    Laplacian
        Neumann: no heat leaves, ``n . D grad u = 0``. Mass in the squared length unit of `mesh`, a
        third of each face at its corners. Edge weights may be negative.

    Examples
    --------
    A sheet on which heat flows four times as fast along x is like one of half the width:

    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> sheet = sk.geometry.rectangle(n=2000, width=2.0, height=1.5).geometry
    >>> tensors = np.tile(np.diag([4.0, 1.0, 1.0]), (len(sheet.faces), 1, 1))
    >>> fast = sk.operators.tensor_laplacian(sheet, tensors)
    >>> print(sk.eigensolve(fast, 3).eigenvalues.round(1))
    [0.  4.4 9.9]
    >>> print(sk.geometry.rectangle(width=1.0, height=1.5, k=3).eigenvalues.round(1))
    [0.  4.4 9.9]
    """
    clock = Clock()
    check_faces_usable(mesh)
    warn_of_seams(mesh)
    D = symmetric_tensors("tensors", tensors, len(mesh.faces))
    frames, sides, doubled = _planes(mesh)
    flat = np.einsum("far,frs,fbs->fab", frames[:, :2], D, frames[:, :2])
    least = np.linalg.eigvalsh(flat)[:, 0]
    if not (least > 0).all():
        raise InvalidInputError(
            "tensors",
            "be positive definite in the planes of faces",
            f"a smallest eigenvalue of {least.min():.3g}",
        )
    # The gradient of a corner's hat function is the side opposite, turned, over twice the area.
    slopes = np.cross(frames[:, 2:], sides)
    energies = np.einsum("fcr,frs,fds->fcd", slopes, D, slopes) / (2 * doubled[:, None, None])
    rows, columns = np.repeat(mesh.faces, 3, axis=1).ravel(), np.tile(mesh.faces, 3).ravel()
    stiffness = sparse.csr_array((energies.ravel(), (rows, columns)), shape=(mesh.n, mesh.n))
    mass = np.bincount(mesh.faces.ravel(), np.repeat(doubled / 6, 3), mesh.n)
    return Laplacian(
        (stiffness + stiffness.T) / 2,
        mass * units_of(mesh) ** 2,
        mesh.points,
        operator="tensor_laplacian(mesh)",
        seconds=clock.total,
    )


def _planes(mesh: TriangleMesh) -> tuple[Floats, Floats, Floats]:
    """Return frames of faces and sides opposite their corners, (f, 3, 3), and twice their areas."""
    if (flat := int(mesh.degenerate_faces(1e-14).sum())) > 0:
        raise InvalidInputError(
            "mesh",
            "have faces with a plane",
            quantity(flat, "face") + " of zero area",
            advice="drop them with {}",
            remedies=("mesh.without_degenerate_faces()",),
        )
    corners = (mesh.points / units_of(mesh)[:, None])[mesh.faces]
    sides = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
    across = np.cross(sides[:, 0], sides[:, 1])
    doubled = np.linalg.norm(across, axis=1)
    return frames_of(across / doubled[:, None]), sides, doubled
