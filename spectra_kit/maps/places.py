"""Places on triangles, as sparse rows of weights of their corners, and what is read off there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from spectra_kit._core.threads import thread_count
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import as_array, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.convert import check_point_map, into_triangles

_TRIED = 3  # images nearest to a row


def located(
    rows: Floats, images: Floats, triangles: Ints, known: Bools
) -> tuple[sparse.csr_array, Floats]:
    """Return where rows (m, d) lie on triangles of known images (n, d), and how far from there.

    Triangles around the three images nearest to each are tried: of an obtuse triangle, the one that
    is nearest to a point inside may be beyond it.
    """
    some, faces = np.flatnonzero(known), triangles[known[triangles].all(axis=1)]
    count = min(_TRIED, len(some))
    _, nearest = cKDTree(images[some]).query(rows, k=[*range(1, count + 1)], workers=thread_count())
    best, apart = sparse.csr_array((len(rows), len(images))), np.full(len(rows), np.inf)
    for column in nearest.T:
        places = into_triangles(rows, images, faces, some[column])
        away = np.linalg.norm(rows - places @ images, axis=1)
        better = away < apart
        best = chosen(~better, best) + chosen(better, places)
        apart[better] = away[better]
    return best, apart


def chosen(which: Bools, places: sparse.csr_array) -> sparse.csr_array:
    """Return the same with all other rows empty."""
    kept = sparse.csr_array(sparse.diags_array(which.astype(np.float64)) @ places)
    kept.eliminate_zeros()
    return kept


def faces_of(places: sparse.csr_array, triangles: Ints) -> Ints:
    """Return the first triangle on which each place lies; -1 where its points have none in common.

    Of those with its corners: two that have the same three are not told apart.
    """
    support = sparse.csr_array(places != 0).astype(np.int8)
    column, first = triangles.ravel(), np.arange(0, triangles.size + 1, 3)
    ones = np.ones(len(column), np.int8)
    corners = sparse.csr_array((ones, column, first), (len(triangles), places.shape[1]))
    shared = sparse.coo_array(support @ corners.T)
    row, face = shared.coords
    whole = shared.data == np.diff(support.indptr)[row]
    found = np.full(places.shape[0], len(triangles), dtype=np.int64)
    np.minimum.at(found, row[whole], face[whole])
    return np.where(found < len(triangles), found, -1)


def weights_in(places: sparse.csr_array, faces: Ints, triangles: Ints) -> Floats:
    """Return the barycentric coordinates (m, 3) of places in their faces; zero in face -1."""
    entries = places.tocoo()
    row, column = entries.coords
    weights = np.zeros((places.shape[0], 3))
    for corner in range(3):
        here = (faces[row] >= 0) & (triangles[faces[row], corner] == column)
        weights[row[here], corner] = entries.data[here]
    return weights


def as_places(name: str, along: Any, n1: int, n2: int) -> sparse.csr_array:
    """Return a point map (n2,), or a precise one (n2, n1), as the latter."""
    if sparse.issparse(along):
        if along.shape != (n2, n1):
            raise InvalidInputError(name, f"have shape ({n2}, {n1})", along.shape)
        real_array(f"data of {name}", along.data)
        return sparse.csr_array(along)
    point_map = check_point_map(name, as_array(name, along), n1, n2)
    return sparse.csr_array((np.ones(n2), point_map, np.arange(n2 + 1)), (n2, n1))


def carried_values(places: sparse.csr_array, known: Bools | None, values: ArrayLike) -> Floats:
    """Return values of points (n1, ...) at places (n2, n1); NaN where they are not known."""
    given = real_array("values", values)
    check_rows("values", given, places.shape[1])
    carried = (places @ given.reshape(len(given), -1)).reshape(-1, *given.shape[1:])
    if known is not None:
        carried[~known] = np.nan
    return np.asarray(carried)


def check_rows(name: str, array: NDArray[Any], n: int) -> None:
    """Refuse values that are not one for each of n points or faces."""
    if not array.ndim or len(array) != n:
        raise InvalidInputError(name, f"have shape ({n}, ...)", array.shape)


def coded(name: str, labels: ArrayLike, n: int, what: str) -> tuple[Ints, Ints]:
    """Return the labels that there are, and which of these each point or face has."""
    given = as_array(name, labels)
    if given.dtype.kind not in "biu" or given.shape != (n,):
        expected = f"be integers of shape ({n},), one for each {what} of the source"
        raise InvalidInputError(name, expected, f"{given.dtype} of shape {given.shape}")
    found, codes = np.unique(given.astype(np.int64), return_inverse=True)
    return found, codes


def voted(places: sparse.csr_array, codes: Ints, count: int) -> Ints:
    """Return which of some labels has most weight at each place; of equal ones the first."""
    each = (np.ones(len(codes)), codes, np.arange(len(codes) + 1))
    votes = places @ sparse.csr_array(each, (len(codes), count))
    return np.asarray(votes.argmax(axis=1)).ravel()
