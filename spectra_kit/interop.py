"""Adapters to and from pyFM, geomfum and DiffusionNet, arrays in and arrays out; and to PyVista.

Each ``to_*`` returns what that toolkit stores, under its own names; each ``from_*`` takes these
and returns a `Spectrum`. Their tiny negative eigenvalues (rounding of zero modes) become zero;
larger ones are refused. Meshes of other toolkits need no adapter: see `geometry.as_geometry`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._checked import checked
from spectra_kit._validate import as_array, check_mass
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.operators.laplacian import Laplacian, lumped_diagonal
from spectra_kit.operators.tangent import TangentGradient
from spectra_kit.spectra import Provenance, Spectrum

if TYPE_CHECKING:
    import torch

_NEGATIVE = 1e-6  # relative to Weyl's spacing 4 pi / area: ARPACK's rounding of a zero mode


class PyfmArrays(TypedDict):
    """Attributes of pyFM's ``TriMesh``."""

    stiffness: sparse.csc_matrix
    mass: sparse.dia_matrix
    eigenvalues: Any
    eigenvectors: Any


class GeomfumArrays(TypedDict):
    """Arguments of geomfum's ``Laplacian`` and ``LaplaceEigenBasis``."""

    stiffness_matrix: sparse.csc_matrix
    mass_matrix: sparse.dia_matrix
    vals: Any
    vecs: Any


class DiffusionNetTensors(NamedTuple):
    """What DiffusionNet's ``get_operators`` returns, in its order, under its names.

    Attributes
    ----------
    frames : torch.Tensor of shape (n, 3, 3)
        Rows are the first axis of the tangent plane, the second, and the outward normal.
    mass : torch.Tensor of shape (n,)
        In length^2.
    L : torch.Tensor of shape (n, n), sparse COO
        The weak Laplacian, positive semi-definite.
    evals : torch.Tensor of shape (k,)
        In 1/length^2.
    evecs : torch.Tensor of shape (n, k)
        In 1/length.
    gradX, gradY : torch.Tensor of shape (n, n), sparse COO
        Slopes along the two axes, in 1/length.
    """

    frames: torch.Tensor
    mass: torch.Tensor
    L: torch.Tensor
    evals: torch.Tensor
    evecs: torch.Tensor
    gradX: torch.Tensor  # noqa: N815
    gradY: torch.Tensor  # noqa: N815


@checked
def from_arrays(
    eigenvalues: ArrayLike,
    eigenvectors: ArrayLike,
    mass: Annotated[ArrayLike, sparse.sparray],
    *,
    solver: str = "user",
) -> Spectrum:
    """Make a spectrum of anybody's eigenpairs.

    Parameters
    ----------
    eigenvalues : array_like of shape (k,)
        Ascending, in 1/length^2.
    eigenvectors : array_like of shape (n, k)
        M-orthonormal columns.
    mass : array_like of shape (n,), or diagonal sparse array of shape (n, n)
        Lumped mass, in length^2.
    solver : str, default "user"
        For the provenance.

    Returns
    -------
    Spectrum
        Without a certificate; ``.certify(laplacian)`` adds one.

    Raises
    ------
    InvalidInputError
        If the columns are not M-orthonormal to 1e-4, or eigenvalues are clearly negative.
    InvalidSpectrumError
        If shapes disagree or eigenvalues descend.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> sk.interop.from_arrays([-1e-15, 2.0], np.eye(2), np.ones(2)).eigenvalues
    array([0., 2.])
    """
    values = np.array(eigenvalues, dtype=np.float64)
    if np.ndim(eigenvectors) != 2 or not np.size(eigenvectors):
        raise InvalidInputError("eigenvectors", "have shape (n, k)", np.shape(eigenvectors))
    diagonal = check_mass("mass", lumped_diagonal(mass), len(np.asarray(eigenvectors)))
    floor = -_NEGATIVE * 4 * np.pi / diagonal.sum()
    if values.size and values.min() < floor:
        raise InvalidInputError(
            "eigenvalues",
            "be >= 0 up to rounding",
            f"{values.min():.3g}",
            advice="a negative semi-definite Laplacian needs its sign turned",
        )
    spectrum = Spectrum(
        np.maximum(values, 0.0),
        np.asarray(eigenvectors, dtype=np.float64),
        diagonal,
        provenance=Provenance(solver=solver, name="" if solver == "user" else solver.lower()),
    )
    if (error := spectrum.orthonormality_error()) > 1e-4:
        raise InvalidInputError(
            "eigenvectors",
            "be M-orthonormal",
            f"|U^T M U - I| up to {error:.2e}",
            advice="is `mass` the one they were computed with, in the same unit?",
        )
    return spectrum


@checked
def to_pyvista(geometry: Geometry, **point_arrays: ArrayLike | Spectrum) -> Any:
    """Return a PyVista mesh with results on its points, to draw, filter or write on.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    **point_arrays : array_like of shape (n,) or (n, c), or Spectrum
        By name. The modes of a spectrum become arrays ``name_0``, ``name_1`` and so on.

    Returns
    -------
    pyvista.PolyData
        A copy: points, triangles if there are any, and `point_data`.

    Raises
    ------
    InvalidInputError
        If an array has not one row for each point.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=1).geometry
    >>> sk.interop.to_pyvista(ball, mode=sk.spectrum(ball, 2)).point_data.keys()
    ['mode_0', 'mode_1']
    """
    import pyvista

    made: Any = pyvista.PolyData(np.array(geometry.points))
    if isinstance(geometry, TriangleMesh):
        faces: Any = np.array(geometry.faces)
        made = pyvista.PolyData.from_regular_faces(made.points, faces)
    for name, values in point_arrays.items():
        spectral = isinstance(values, Spectrum)
        array = as_array(name, values.eigenvectors if isinstance(values, Spectrum) else values)
        if array.ndim not in (1, 2) or len(array) != geometry.n or array.dtype.kind not in "fiub":
            raise InvalidInputError(
                name,
                f"hold numbers, a row for each of {geometry.n} points",
                f"shape {array.shape} of {array.dtype}",
            )
        columns = {f"{name}_{i}": column for i, column in enumerate(array.T)}
        made.point_data.update(columns if spectral else {name: array})
    return made


@checked
def to_pyfm(spectrum: Spectrum, laplacian: Laplacian) -> PyfmArrays:
    """Return the attributes that make a pyFM ``TriMesh`` use this spectrum.

    Assign them after construction, ``for name, a in arrays.items(): setattr(mesh, name, a)``;
    ``mesh.process(k)`` with k <= spectrum.k then keeps them.

    Parameters
    ----------
    spectrum : Spectrum
    laplacian : Laplacian
        The one it was computed from.

    Returns
    -------
    dict
        ``stiffness`` and ``mass`` (sparse, (n, n)), ``eigenvalues`` (k,), ``eigenvectors`` (n, k).
    """
    _check_pair(spectrum, laplacian)
    return PyfmArrays(
        stiffness=sparse.csc_matrix(laplacian.stiffness),
        mass=sparse.diags(spectrum.mass),
        eigenvalues=np.array(spectrum.eigenvalues),
        eigenvectors=np.array(spectrum.eigenvectors),
    )


@checked
def from_pyfm(
    eigenvalues: ArrayLike, eigenvectors: ArrayLike, mass: Annotated[ArrayLike, sparse.sparray]
) -> Spectrum:
    """Return the spectrum of ``mesh.eigenvalues, mesh.eigenvectors, mesh.mass`` of pyFM."""
    return from_arrays(eigenvalues, eigenvectors, mass, solver="pyFM")


@checked
def to_geomfum(spectrum: Spectrum, laplacian: Laplacian) -> GeomfumArrays:
    """Return the arrays of geomfum's ``Laplacian`` and ``LaplaceEigenBasis``.

    Parameters
    ----------
    spectrum, laplacian
        As of `to_pyfm`.

    Returns
    -------
    dict
        ``stiffness_matrix``, ``mass_matrix`` (sparse, (n, n)), ``vals`` (k,), ``vecs`` (n, k).
    """
    arrays = to_pyfm(spectrum, laplacian)
    return GeomfumArrays(
        stiffness_matrix=arrays["stiffness"],
        mass_matrix=arrays["mass"],
        vals=arrays["eigenvalues"],
        vecs=arrays["eigenvectors"],
    )


@checked
def from_geomfum(
    eigenvalues: ArrayLike, eigenvectors: ArrayLike, mass: Annotated[ArrayLike, sparse.sparray]
) -> Spectrum:
    """Return the spectrum of geomfum's ``basis.vals, basis.vecs, laplacian.mass_matrix``."""
    return from_arrays(eigenvalues, eigenvectors, mass, solver="geomfum")


@checked
def to_diffusion_net(
    spectrum: Spectrum,
    laplacian: Laplacian,
    gradient: TangentGradient,
    *,
    dtype: torch.dtype | None = None,
) -> DiffusionNetTensors:
    """Return what DiffusionNet's layers take, in the place of its ``get_operators``.

    Parameters
    ----------
    spectrum, laplacian
        As of `to_pyfm`.
    gradient : TangentGradient
        ``tangent_gradient(geometry, oriented=True)``: with its gradients turned by learned angles,
        which is its default, the network tells a surface from its mirror image.
    dtype : torch.dtype, optional
        float32 by default, as DiffusionNet has it.

    Returns
    -------
    DiffusionNetTensors
        A tuple of seven.

    Raises
    ------
    InvalidInputError
        If they are not of the same points.

    Notes
    -----
    Its layers see no unit: weights know the one they were trained in. Its own scripts centre the
    points and divide them by the largest distance from their centre.

    References
    ----------
    N. Sharp, S. Attaiki, K. Crane, M. Ovsjanikov, "DiffusionNet: discretization agnostic learning
    on surfaces", ACM Transactions on Graphics 41(3), 2022.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> from spectra_kit.operators import tangent_gradient
    >>> mesh = sk.geometry.creature(600)
    >>> laplacian = sk.robust_laplacian(mesh)
    >>> frames, mass, L, evals, evecs, gradX, gradY = sk.interop.to_diffusion_net(
    ...     sk.eigensolve(laplacian, 16), laplacian, tangent_gradient(mesh, oriented=True)
    ... )
    >>> gradX.shape
    torch.Size([600, 600])
    """
    import torch

    _check_pair(spectrum, laplacian)
    if len(gradient.frames) != spectrum.n:
        raise InvalidInputError(
            "gradient", f"be the one of `spectrum` ({spectrum.n} points)", len(gradient.frames)
        )
    dtype = torch.float32 if dtype is None else dtype
    evals, evecs, mass = spectrum.to_torch(dtype=dtype)
    L, grad_x, grad_y = (
        _coo_tensor(matrix, dtype) for matrix in (laplacian.stiffness, gradient.x, gradient.y)
    )
    frames = torch.tensor(gradient.frames, dtype=dtype)
    return DiffusionNetTensors(frames, mass, L, evals, evecs, grad_x, grad_y)


def _coo_tensor(matrix: sparse.csr_array, dtype: torch.dtype) -> torch.Tensor:
    import torch

    entries = sparse.coo_array(matrix)
    return torch.sparse_coo_tensor(
        torch.tensor(np.vstack([entries.row, entries.col]), dtype=torch.int64),
        torch.tensor(entries.data, dtype=dtype),
        entries.shape,
        check_invariants=True,
    ).coalesce()


@checked
def from_diffusion_net(operators: tuple[Any, ...]) -> Spectrum:
    """Return the spectrum inside DiffusionNet's operators.

    Parameters
    ----------
    operators : tuple
        ``(frames, mass, L, evals, evecs, gradX, gradY)`` as its ``get_operators`` and
        `to_diffusion_net` return them, or the four ``(mass, L, evals, evecs)``. Tensors on any
        device.

    Returns
    -------
    Spectrum
        Without a certificate.

    Raises
    ------
    InvalidInputError
        If `operators` has neither seven nor four entries.
    """
    if len(operators) == 7:
        operators = operators[1:5]
    if len(operators) != 4:
        raise InvalidInputError(
            "operators",
            "be (frames, mass, L, evals, evecs, gradX, gradY) or (mass, L, evals, evecs)",
            f"{len(operators)} entries",
        )
    mass, _, evals, evecs = operators
    arrays = (np.asarray(_to_cpu(a), dtype=np.float64) for a in (evals, evecs, mass))
    return from_arrays(*arrays, solver="DiffusionNet")


def _to_cpu(array: Any) -> Any:
    """Return a tensor's values where NumPy can see them."""
    return array.detach().cpu() if hasattr(array, "detach") else array


def _check_pair(spectrum: Spectrum, laplacian: Laplacian) -> None:
    if spectrum.n != laplacian.n:
        raise InvalidInputError(
            "laplacian", f"be the one of `spectrum` ({spectrum.n} points)", laplacian.n
        )
