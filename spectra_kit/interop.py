"""Adapters to and from pyFM, geomfum and DiffusionNet, arrays in and arrays out; and to PyVista.

Each ``to_*`` returns what that toolkit stores, under its own names; each ``from_*`` takes these
and returns a `Spectrum`. Their tiny negative eigenvalues (rounding of zero modes) become zero;
larger ones are refused. Meshes of other toolkits need no adapter: see `geometry.as_geometry`.

Functional maps of pyFM and geomfum are, as ours, (k2, k1), and take functions from the first
surface to the second; their point maps, ``p2p_21``, are ours as they are. But theirs are between
modes in the unit of each surface, ours between surfaces of area 1: `to_pyfm_map` and its kin carry
them over. A map belongs to the modes it was made of, with their signs: hand over the spectra too,
or the point map alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import as_array, check_mass
from spectra_kit.eigen import Provenance, Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import GeometryLike, TriangleMesh
from spectra_kit.maps.convert import check_functional_map
from spectra_kit.operators.laplacian import Laplacian, check_dimension, split_mass
from spectra_kit.operators.tangent import TangentGradient

if TYPE_CHECKING:
    import torch

_ORTHONORMAL = 1e-4
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
    dimension: int = 2,
) -> Spectrum:
    """Make a spectrum of anybody's eigenpairs.

    Parameters
    ----------
    eigenvalues : array_like of shape (k,)
        Ascending, in 1/length^2.
    eigenvectors : array_like of shape (n, k)
        Columns, M-orthonormal to 1e-4.
    mass : array_like of shape (n,), or array or sparse array of shape (n, n)
        The mass they are orthonormal in, in length^2, of volumes in length^3: lumped, or the full
        matrix of finite elements.
    solver : str, default "user"
        For the provenance.
    dimension : int, default 2
        3 for modes of a volume.

    Returns
    -------
    Spectrum
        Without a certificate; ``.certify(laplacian)`` adds one.

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
    vectors = np.asarray(eigenvectors, dtype=np.float64)
    lumped, matrix = split_mass("mass", mass, len(vectors))
    diagonal = check_mass("mass", lumped, len(vectors))
    floor = -_NEGATIVE * 4 * np.pi / diagonal.sum() ** (2 / check_dimension(dimension))
    if values.size and values.min() < floor:
        raise InvalidInputError(
            "eigenvalues",
            "be >= 0 up to rounding",
            f"{values.min():.3g}",
            advice="a negative semi-definite Laplacian needs its sign turned",
        )
    spectrum = Spectrum(
        np.maximum(values, 0.0),
        vectors,
        diagonal if matrix is None else matrix,
        dimension=dimension,
        provenance=Provenance(solver=solver, name="" if solver == "user" else solver.lower()),
    )
    if (error := spectrum.orthonormality_error()) > _ORTHONORMAL:
        raise InvalidInputError(
            "eigenvectors",
            "be M-orthonormal",
            f"|U^T M U - I| up to {error:.2e}",
            advice="is `mass` the one they were computed with, in the same unit? That of finite"
            " elements is a matrix, not its row sums: pass it whole",
        )
    return spectrum


@checked
def to_pyvista(geometry: GeometryLike, **point_arrays: ArrayLike | Spectrum) -> Any:
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
    M = spectrum.consistent_mass
    return PyfmArrays(
        stiffness=sparse.csc_matrix(laplacian.stiffness),
        mass=sparse.diags(spectrum.mass) if M is None else sparse.csc_matrix(M),
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
def to_pyfm_map(functional_map: ArrayLike, source: Spectrum, target: Spectrum) -> Floats:
    """Return a functional map as pyFM has it, between modes in the unit of each surface.

    Parameters
    ----------
    functional_map : array_like of shape (k2, k1)
        Source coefficients to target coefficients, at unit area, as of `maps` and
        `Match`.
    source, target : Spectrum
        Whose modes it is in, in the units in which pyFM has them, as `to_pyfm` hands them over.

    Returns
    -------
    ndarray of shape (k2, k1)
        Its ``FM_12``: ``functional_map`` times the root of ``target.area / source.area``.

    Notes
    -----
    ``FM_to_p2p(..., use_adj=True)`` of it is the point map that
    `maps.point_map_from_functional_map` finds with ``adjoint=True``. Without, which is
    pyFM's default, it compares rows whose lengths differ by ``target.area / source.area``, and
    finds other points, the more the further areas are apart: give it surfaces of one area, by
    ``spectrum.rescale(spectrum.area**-0.5)``. Neither need be the ``point_map`` of a `Match`, which
    says more than its modes do: that one is pyFM's ``p2p_21`` as it is.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> s = sk.Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
    >>> sk.interop.to_pyfm_map(np.eye(2), s, s.rescale(3.0))
    array([[3., 0.],
           [0., 3.]])
    """
    C = check_functional_map("functional_map", functional_map, source, target)
    return np.asarray(C * (target.area / source.area) ** 0.5)


@checked
def from_pyfm_map(functional_map: ArrayLike, source: Spectrum, target: Spectrum) -> Floats:
    """Return pyFM's ``FM_12`` as a functional map at unit area: see `to_pyfm_map`."""
    C = check_functional_map("functional_map", functional_map, source, target)
    return np.asarray(C * (source.area / target.area) ** 0.5)


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
def to_geomfum_map(functional_map: ArrayLike, source: Spectrum, target: Spectrum) -> Floats:
    """Return a functional map as geomfum has it, which is as pyFM does: see `to_pyfm_map`."""
    return to_pyfm_map(functional_map, source, target)


@checked
def from_geomfum_map(functional_map: ArrayLike, source: Spectrum, target: Spectrum) -> Floats:
    """Return geomfum's ``fmap_matrix`` as a functional map at unit area: see `to_pyfm_map`."""
    return from_pyfm_map(functional_map, source, target)


@checked
def to_diffusion_net(
    spectrum: Spectrum,
    laplacian: Laplacian,
    gradient: TangentGradient,
    *,
    device: str = "cpu",
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
    device : str, default "cpu"
        Where they are to live.
    dtype : torch.dtype, optional
        float32 by default, as DiffusionNet has it.

    Returns
    -------
    DiffusionNetTensors
        A tuple of seven.

    Notes
    -----
    Its layers see no unit: weights know the one they were trained in. Its own scripts centre the
    points and divide them by the largest distance from their centre. Sharp, Attaiki, Crane and
    Ovsjanikov, *DiffusionNet: discretization agnostic learning on surfaces*, ACM Transactions on
    Graphics 41(3), 2022.

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
    evals, evecs, mass = spectrum.to_torch(device=device, dtype=dtype)
    L, grad_x, grad_y = (
        _coo_tensor(matrix, dtype).to(device)
        for matrix in (laplacian.stiffness, gradient.x, gradient.y)
    )
    frames = torch.tensor(gradient.frames, dtype=dtype, device=device)
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
