"""Point maps, functional maps and maps into triangles: their checks, and one kind from another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.threads import in_threads, ranges
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_faces, check_indices, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.nearest import nearest

_BLOCK = 2**18  # coordinates of rows at a time: a hundred times as many while they are projected


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Correspondence(Rebuilt):
    """A point map with the functional map that it induces.

    Attributes
    ----------
    point_map : ndarray of shape (n2,)
        Source point of each target point.
    functional_map : ndarray of shape (k2, k1)
        ``U2.T @ M2 @ U1[point_map]`` at unit area: source coefficients to target coefficients.
    """

    point_map: Ints
    functional_map: Floats

    def __repr__(self) -> str:
        k2, k1 = self.functional_map.shape
        return f"Correspondence({len(self.point_map)} points, functional map {k2} x {k1})"


@checked
def functional_map_from_point_map(
    source: Spectrum,
    target: Spectrum,
    point_map: ArrayLike,
    *,
    k: int | tuple[int, int] | None = None,
) -> Floats:
    """Represent a point map in the modes of two spectra.

    Parameters
    ----------
    source, target : Spectrum
        Of the two surfaces, in any units.
    point_map : array_like of shape (n2,)
        Source point of each target point.
    k : int or (int, int), optional
        Number of modes, or (source's, target's); all by default.

    Returns
    -------
    ndarray of shape (k2, k1)
        ``U2.T @ M2 @ U1[point_map]`` at unit area (Ovsjanikov et al. 2012, section 4).

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> s = sk.Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
    >>> sk.maps.functional_map_from_point_map(s, s, [1, 0])
    array([[0., 1.],
           [1., 0.]])
    """
    k1, k2 = check_sizes(k, source, target)
    point_map = check_point_map("point_map", point_map, source.n, target.n)
    return induced(at_unit_area(source), at_unit_area(target), point_map, k1, k2)


@checked
def point_map_from_functional_map(
    source: Spectrum, target: Spectrum, functional_map: ArrayLike, *, adjoint: bool = False
) -> Ints:
    """Recover a point map: the nearest source point of each target point in the spectral domain.

    Parameters
    ----------
    source, target : Spectrum
        Of the two surfaces, in any units.
    functional_map : array_like of shape (k2, k1)
        Source coefficients to target coefficients, at unit area.
    adjoint : bool, default False
        Look for rows of ``U2 @ C`` among those of ``U1`` instead of rows of ``U2`` among those of
        ``U1 @ C.T``: the distance is then measured in source coefficients.

    Returns
    -------
    ndarray of shape (n2,)
        Source point of each target point; exact, see `nearest_rows`.

    Notes
    -----
    The rows are delta functions projected onto the modes: C_12 should carry that of a source point
    to that of its image (Ovsjanikov et al. 2012, section 6.1).

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> s = sk.Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
    >>> sk.maps.point_map_from_functional_map(s, s, [[0.0, 1.0], [1.0, 0.0]])
    array([1, 0])
    """
    C = check_functional_map("functional_map", functional_map, source, target)
    k2, k1 = C.shape
    A, B = (at_unit_area(s).eigenvectors for s in (source, target))
    if adjoint:
        return nearest(B[:, :k2] @ C, A[:, :k1], exact=True)
    return nearest(B[:, :k2], A[:, :k1] @ C.T, exact=True)


def induced(source: Spectrum, target: Spectrum, point_map: Ints, k1: int, k2: int) -> Floats:
    """Return the (k2, k1) functional map of a checked point map between surfaces of unit area."""
    values = source.eigenvectors[point_map, :k1]
    return target.truncate(k2).project(values)


@checked
def precise_map(
    source: Spectrum, target: Spectrum, functional_map: ArrayLike, faces: ArrayLike
) -> sparse.csr_array:
    """Recover from a functional map where on the source's triangles each target point lies.

    Parameters
    ----------
    source, target, functional_map
        As of `point_map_from_functional_map`.
    faces : array_like of shape (f, 3)
        Triangles of the source, where the map goes; not of the target.

    Returns
    -------
    csr_array of shape (n2, n1)
        Barycentric coordinates: rows of at most three positive entries that sum to 1. The map times
        values on the source's vertices, or its vertices themselves, gives those on the target.

    Notes
    -----
    Ezuz and Ben-Chen 2017, Deblurring and denoising of maps between shapes, section 4.1: each row
    of ``U2`` is projected onto the triangles spanned by the rows of ``U1 @ C.T``. Only triangles
    around the nearest row are tried, where the original searches all of them.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.creature(500)
    >>> s = sk.spectrum(mesh, 20)
    >>> P = sk.maps.precise_map(s, s, np.eye(20), mesh.faces)
    >>> bool(np.allclose(P @ mesh.points, mesh.points))
    True
    """
    C = check_functional_map("functional_map", functional_map, source, target)
    triangles = check_faces("faces of the source", faces, source.n)
    k2, k1 = C.shape
    images = at_unit_area(source).eigenvectors[:, :k1] @ C.T
    rows = at_unit_area(target).eigenvectors[:, :k2]
    closest = nearest(rows, images, exact=True)
    return into_triangles(rows, images, triangles, closest)


@checked
def functional_map_from_precise_map(
    source: Spectrum,
    target: Spectrum,
    precise: sparse.csr_array,
    *,
    k: int | tuple[int, int] | None = None,
) -> Floats:
    """Represent a map given by barycentric coordinates in the modes of two spectra.

    Parameters
    ----------
    source, target : Spectrum
        Of the two surfaces, in any units.
    precise : sparse array of shape (n2, n1)
        As `precise_map` returns it: each row mixes source points.
    k : int or (int, int), optional
        Number of modes, or (source's, target's); all by default.

    Returns
    -------
    ndarray of shape (k2, k1)
        ``U2.T @ M2 @ (precise @ U1)`` at unit area.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> from scipy import sparse
    >>> s = sk.Spectrum([0.0, 1.0], np.eye(2), np.ones(2))
    >>> P = sparse.csr_array([[0.0, 1.0], [0.5, 0.5]])
    >>> sk.maps.functional_map_from_precise_map(s, s, P)
    array([[0. , 1. ],
           [0.5, 0.5]])
    """
    k1, k2 = check_sizes(k, source, target)
    if precise.shape != (target.n, source.n):
        raise InvalidInputError(
            "precise",
            f"have shape ({target.n}, {source.n}), one row for each target point",
            precise.shape,
        )
    precise = sparse.csr_array(precise)
    real_array("data of precise", precise.data)
    values = precise @ at_unit_area(source).eigenvectors[:, :k1]
    return at_unit_area(target).truncate(k2).project(values)


def into_triangles(
    rows: Floats, images: Floats, triangles: Ints, closest: Ints
) -> sparse.csr_array:
    """Return barycentric coordinates of the points nearest to `rows` on triangles of `images`.

    Of rows (n2, d) on triangles (f, 3) of images (n1, d), as (n2, n1); of each row those triangles
    that its `closest` image, (n2,), is a corner of. Threads share the rows.
    """
    n1, n2 = len(images), len(rows)
    around = sparse.csr_array(
        (np.ones(triangles.size), (triangles.ravel(), np.repeat(np.arange(len(triangles)), 3))),
        shape=(n1, len(triangles)),
    )

    def project(start: int, stop: int) -> tuple[Ints, Ints, Floats]:
        candidates = around[closest[start:stop]].tocoo()
        point, face = candidates.coords
        weights, squared = nearest_on_triangles(rows[start:stop][point], images[triangles[face]])
        order = np.lexsort((squared, point))
        first = order[np.unique(point[order], return_index=True)[1]]
        # Where the closest is a corner of none, the row stays with it.
        bare = np.setdiff1d(np.arange(stop - start), point)
        values = np.concatenate([weights[first].ravel(), np.ones(len(bare))])
        columns = np.concatenate([triangles[face[first]].ravel(), closest[start:stop][bare]])
        return np.concatenate([np.repeat(point[first], 3), bare]) + start, columns, values

    share = max(1, _BLOCK // rows.shape[1])
    parts = in_threads(project, ranges(n2, share))
    at, columns, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    result = sparse.csr_array((values, (at, columns)), shape=(n2, n1))
    result.eliminate_zeros()
    return result


def nearest_on_triangles(points: Floats, corners: Floats) -> tuple[Floats, Floats]:
    """Return barycentric coordinates (c, 3) of, and squared distances (c,) to, the nearest points.

    `points` are (c, d), the triangles' `corners` (c, 3, d), degenerate ones included.
    """
    a, b, c = (corners[:, i] for i in range(3))
    weights = [_inside(points, a, b, c)]
    for i in range(3):  # and the nearest points of the three sides
        j = (i + 1) % 3
        side = corners[:, j] - corners[:, i]
        t = np.einsum("cd,cd->c", points - corners[:, i], side)
        t = np.clip(t / np.maximum(np.einsum("cd,cd->c", side, side), 1e-300), 0, 1)
        on_side = np.zeros((len(points), 3))
        on_side[:, i], on_side[:, j] = 1 - t, t
        weights.append(on_side)
    options = np.stack(weights)
    apart = np.einsum("oci,cid->ocd", options, corners) - points
    squared = np.einsum("ocd,ocd->oc", apart, apart)
    squared[0, (options[0] < 0).any(axis=1)] = np.inf
    best, each = squared.argmin(axis=0), np.arange(len(points))
    return options[best, each], squared[best, each]


def _inside(points: Floats, a: Floats, b: Floats, c: Floats) -> Floats:
    """Barycentric coordinates of the feet of the perpendiculars; negative in flat triangles."""
    u, v, w = b - a, c - a, points - a
    uu, uv, vv = (np.einsum("cd,cd->c", x, y) for x, y in ((u, u), (u, v), (v, v)))
    wu, wv = (np.einsum("cd,cd->c", w, x) for x in (u, v))
    determinant = uu * vv - uv**2
    flat = determinant <= 1e-12 * uu * vv
    scale = np.where(flat, 0.0, 1 / np.where(flat, 1.0, determinant))
    s, t = (vv * wu - uv * wv) * scale, (uu * wv - uv * wu) * scale
    foot = np.column_stack([1 - s - t, s, t])
    foot[flat] = -1
    return foot


def check_point_map(
    name: str, values: ArrayLike, n_source: int, n_target: int | None = None
) -> Ints:
    """Return `values` as the source point of each target point: int64 of shape (n_target,)."""
    shape = np.shape(values)
    if len(shape) != 1 or (n_target is not None and shape != (n_target,)):
        backwards = n_source != n_target and shape == (n_source,)
        hint = " (it seems to run from source to target)" if backwards else ""
        raise InvalidInputError(
            name,
            f"have shape ({n_target or 'n2'},), the source point of each target point",
            f"{shape}{hint}",
        )
    return check_indices(name, values, n_source)


def check_functional_map(
    name: str, values: ArrayLike, source: Spectrum, target: Spectrum
) -> Floats:
    """Return `values` as finite float64 of shape (k2, k1), within the modes of the spectra."""
    shape = np.shape(values)
    if len(shape) != 2 or not (1 <= shape[0] <= target.k and 1 <= shape[1] <= source.k):
        raise InvalidInputError(
            name,
            f"have shape (k2, k1) with k2 of the target's {target.k} modes and k1 of the"
            f" source's {source.k}",
            shape,
            advice="compute more modes or truncate the map",
        )
    return real_array(name, values)


def check_sizes(
    k: int | tuple[int, int] | None, source: Spectrum, target: Spectrum
) -> tuple[int, int]:
    """Return (k1, k2) from one number for both, one for each, or None for all modes."""
    k1, k2 = (source.k, target.k) if k is None else (k, k) if not isinstance(k, tuple) else k
    return (
        check_count("k of the source", k1, low=1, high=source.k),
        check_count("k of the target", k2, low=1, high=target.k),
    )


def check_components(source: Spectrum, target: Spectrum) -> None:
    """Refuse two shapes whose modes cannot correspond one to one, as their kernels differ."""
    if source.dimension != target.dimension:
        raise InvalidInputError(
            "`source` and `target` must both be of surfaces, or of volumes, got one of each"
        )
    a, b = source.n_zero_modes, target.n_zero_modes
    if a != b:
        raise InvalidInputError(
            "`source` and `target` must have the same number of components, got"
            f" {a} and {b} zero modes; match component by component"
            " (geometry.components)"
        )


def at_unit_area(spectrum: Spectrum) -> Spectrum:
    """Return the spectrum of the surface scaled to area 1, of a volume to volume 1."""
    area = spectrum.area
    return spectrum if abs(area - 1.0) < 1e-12 else spectrum._of_size_one()
