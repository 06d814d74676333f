"""The Laplacian of a volume by linear elements on its tetrahedra."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import box_unit
from spectra_kit.geometry.tetrahedra import TetrahedralMesh, cross, scaled_sides
from spectra_kit.operators.checks import symmetric_tensors
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.operators.triangle_calculus import linear_mass

_LARGEST = 1e85  # extents, whose cubes are numbers; as those of the inverse are
_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]).T


@checked
def tetrahedral_laplacian(
    mesh: TetrahedralMesh,
    *,
    mass: Literal["lumped", "consistent"] = "lumped",
    tensors: ArrayLike | None = None,
) -> Laplacian:
    """Build the Laplacian of a volume by linear finite elements, or ``-div(D grad u)``.

    Parameters
    ----------
    mesh : TetrahedralMesh, path-like, or mesh of another library
        As `TetrahedralMesh.of` takes it, without unreferenced vertices, flat and repeated cells; of
        any orientation.
    mass : {"lumped", "consistent"}, default "lumped"
        A quarter of each cell to each of its corners, which approximates eigenvalues from below as
        a rule; or the integrals of products, with which they are bounds from above.
    tensors : array_like of shape (m,) or (m, 3, 3), optional
        D of each of m cells, positive definite, without a unit: how well it conducts, in all
        directions alike or not. One by default.

    Returns
    -------
    Laplacian
        Of dimension 3, with mass in the cubed length unit of `mesh`. Nothing flows through the
        boundary (Neumann); ``.dirichlet(mesh.boundary_vertices)`` holds it at zero.

    Notes
    -----
    The weight of an edge is a sixth of the sum, over its cells, of the opposite edge's length times
    the cotangent of the angle between the faces that meet there: negative where such angles are
    obtuse. Errors of eigenvalues fall with the square of the edges. See Strang and Fix, *An
    Analysis of the Finite Element Method*, Prentice-Hall, 1973.

    Examples
    --------
    A cube of five tetrahedra:

    >>> import spectra_kit as sk
    >>> points = [[i // 4, i // 2 % 2, i % 2] for i in range(8)]
    >>> cells = [[0, 1, 2, 4], [3, 1, 2, 7], [5, 1, 4, 7], [6, 2, 4, 7], [1, 2, 4, 7]]
    >>> laplacian = sk.operators.tetrahedral_laplacian((points, cells))
    >>> round(laplacian.area, 12), laplacian.dimension
    (1.0, 3)
    >>> sk.eigensolve(laplacian, 4).eigenvalues.round(2)
    array([0.  , 3.62, 3.62, 3.62])
    """
    clock = Clock()
    _check_usable(mesh)
    options = "" if mass == "lumped" else f", mass={mass!r}"
    D = None
    if tensors is not None:
        D, options = symmetric_tensors("tensors", tensors, len(mesh.cells)), options + ", tensors"
        if (least := np.linalg.eigvalsh(D).min()) <= 0:
            got = f"a smallest eigenvalue of {least:.3g}"
            raise InvalidInputError("tensors", "be positive definite", got)
    return Laplacian(
        *matrices(mesh, mass, D),
        mesh.points,
        operator=f"tetrahedral_laplacian(mesh{options})",
        seconds=clock.total,
        dimension=3,
    )


def matrices(
    mesh: TetrahedralMesh, mass: str, tensors: Floats | None = None
) -> tuple[sparse.csr_array, Any]:
    """Return the stiffness, and the mass: as a diagonal (n,), or as a matrix."""
    volumes, weights = mesh.cell_volumes, np.empty((len(mesh.cells), 6))
    for block, (a, b, c), exponents in scaled_sides(mesh):
        # Normals of the faces opposite the corners, twice as long as the faces are large.
        normals = np.stack([cross(c - a, b - a), cross(b, c), cross(c, a), cross(a, b)])
        first, second = normals[_EDGES]
        if tensors is not None:
            second = np.einsum("brs,esb->erb", tensors[block], second)
        sixfold = np.abs((a * normals[1]).sum(axis=0))
        products = (first * second).sum(axis=1) / (6 * sixfold)
        weights[block] = np.ldexp(products, exponents).T
    n = mesh.n
    ends = np.sort(mesh.cells.astype(np.int32)[:, _EDGES.T], axis=2).reshape(-1, 2).T

    upper = sparse.csr_array(sparse.coo_array((weights.ravel(), tuple(ends)), shape=(n, n)))
    beside = upper + upper.T
    stiffness = sparse.csr_array(beside - sparse.diags_array(beside.sum(axis=1)))
    if mass == "consistent":
        return stiffness, linear_mass(mesh.cells, volumes, n)
    return stiffness, np.bincount(mesh.cells.ravel(), np.repeat(volumes / 4, 4), minlength=n)


def _check_usable(mesh: TetrahedralMesh) -> None:
    """Refuse what has no mass, no gradients, or other volumes than those of its cells."""
    if not 1 / _LARGEST < box_unit(mesh.points) < _LARGEST:
        raise InvalidInputError(
            "mesh",
            f"have an extent between {1 / _LARGEST:g} and {_LARGEST:g}",
            f"{quantity(mesh.n, 'vertex')} within about {box_unit(mesh.points):g}",
            advice="choose another unit of length",
        )
    unused = np.ones(mesh.n, dtype=bool)
    unused[mesh.cells] = False
    if unused.any():
        raise InvalidInputError(
            "mesh",
            "have a cell at every vertex",
            f"{quantity(unused.sum(), 'unused vertex')} (the first is {np.argmax(unused)})",
            advice="drop them with TetrahedralMesh.of(mesh).without_unreferenced()",
        )
    if (flat := mesh.degenerate_cells()).any():
        raise InvalidInputError(
            "mesh",
            "have cells that enclose a volume, each once",
            f"{quantity(flat.sum(), 'flat or repeated cell')} (the first is {np.argmax(flat)})",
            advice="drop them with TetrahedralMesh.of(mesh).without_degenerate_cells()",
        )
    if many := int((mesh._faces[1] > 2).sum()):
        expected, got = "have faces of one cell or two", f"{quantity(many, 'face')} of more"
        raise InvalidInputError("mesh", expected, got, advice="cells overlap there: mesh it anew")
