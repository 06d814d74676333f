"""Maps into the triangles of the source, by barycentric coordinates, instead of to its vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.threads import in_threads, ranges
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_faces, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.checks import at_unit_area, check_functional_map, check_sizes
from spectra_kit.maps.nearest import nearest

_BLOCK = 2**18  # coordinates of rows at a time: a hundred times as many while they are projected


@checked
def precise_map(
    source: Spectrum, target: Spectrum, functional_map: ArrayLike, faces: ArrayLike
) -> sparse.csr_array:
    """Recover from a functional map where on the source's triangles each target point lies.

    Parameters
    ----------
    source, target : Spectrum
        Of the two surfaces, in any units.
    functional_map : array_like of shape (k2, k1)
        Source coefficients to target coefficients, at unit area.
    faces : array_like of shape (f, 3)
        Triangles of the source, where the map goes; not of the target.

    Returns
    -------
    csr_array of shape (n2, n1)
        Barycentric coordinates: rows of at most three positive entries that sum to 1. The map times
        values on the source's vertices, or its vertices themselves, gives those on the target.

    Raises
    ------
    InvalidInputError
        If `functional_map` does not fit the spectra, or `faces` do not fit the source.

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

    Raises
    ------
    InvalidInputError
        If `precise` is not sparse, not finite or of another shape, or there are fewer modes than
        `k`.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from spectra_kit import Spectrum
    >>> from spectra_kit.maps import functional_map_from_precise_map
    >>> s = Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
    >>> functional_map_from_precise_map(s, s, sparse.csr_array([[0.0, 1.0], [0.5, 0.5]]))
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
        weights, squared = _project(rows[start:stop][point], images[triangles[face]])
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


def _project(points: Floats, corners: Floats) -> tuple[Floats, Floats]:
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
