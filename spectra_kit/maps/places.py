"""Places on triangles, as sparse rows of weights of their corners, and what is read off there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from spectra_kit._core.threads import thread_count
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import as_array, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.convert import check_point_map, into_triangles, nearest_on_triangles

_ROUNDED = 1e-3  # off 1 in the sum of weights, as float16 makes it
_EXACT = 1e-12  # the same of float64
_PAIRS = 1 << 19  # of rows and triangles, that are compared at a time


def located(
    rows: Floats, images: Floats, triangles: Ints, known: Bools, limit: float
) -> tuple[sparse.csr_array, Floats]:
    """Return where rows (m, d) lie on triangles of known images (n, d), and how far from there.

    That is the nearest of all triangles where one lies within the `limit`, and elsewhere one of
    those around the nearest image. A triangle that is nearer than what was found has its middle
    within that distance and its own radius: those of each size are searched by their middles.
    """
    some, faces = np.flatnonzero(known), triangles[known[triangles].all(axis=1)]
    closest = some[cKDTree(images[some]).query(rows, workers=thread_count())[1]]
    best = into_triangles(rows, images, faces, closest)
    apart = np.linalg.norm(rows - best @ images, axis=1)
    corners = images[faces]
    middles = corners.mean(axis=1)
    radii = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1, initial=0.0)
    sizes = np.frexp(radii)[1]
    for size in np.unique(sizes[radii > 0]):
        alike, asked = np.flatnonzero(sizes == size), np.flatnonzero(apart > 0)
        tree, reach = cKDTree(middles[alike]), np.minimum(apart[asked], limit) + 2.0**size
        counts = tree.query_ball_point(rows[asked], reach, return_length=True)
        for cut in _runs(counts):
            near = tree.query_ball_point(rows[asked[cut]], reach[cut])
            row = np.repeat(asked[cut], counts[cut])
            face = alike[np.concatenate(near).astype(np.int64)]
            weights, squares = nearest_on_triangles(rows[row], corners[face])
            order = np.lexsort((squares, row))
            first = order[np.unique(row[order], return_index=True)[1]]
            better = first[np.sqrt(squares[first]) < apart[row[first]]]
            apart[row[better]] = np.sqrt(squares[better])
            found = _rows(row[better], faces[face[better]], weights[better], best.shape)
            best = chosen(~np.isin(np.arange(len(rows)), row[better]), best) + found
    return best, apart


def _runs(counts: Ints) -> Iterator[slice]:
    """Cut rows with so many pairs each into runs of not too many pairs."""
    starts = np.flatnonzero(np.diff(np.cumsum(counts) // _PAIRS, prepend=-1))
    ends = np.append(starts, len(counts))
    for start, stop in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        if counts[start:stop].any():
            yield slice(start, stop)


def _rows(row: Ints, corners: Ints, weights: Floats, shape: tuple[int, int]) -> sparse.csr_array:
    """Return sparse rows of weights of three corners each."""
    entries = (weights.ravel(), (np.repeat(row, 3), corners.ravel()))
    found = sparse.csr_array(sparse.coo_array(entries, shape=shape))
    found.eliminate_zeros()
    return found


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
    """Return a point map (n2,), or a precise one (n2, n1), as the latter.

    Weights that sum to 1 but for their rounding are made to; rows without any stay so.
    """
    if not sparse.issparse(along):
        point_map = check_point_map(name, as_array(name, along), n1, n2)
        return sparse.csr_array((np.ones(n2), point_map, np.arange(n2 + 1)), (n2, n1))
    if along.shape != (n2, n1):
        raise InvalidInputError(name, f"have shape ({n2}, {n1})", along.shape)
    places = sparse.csr_array(along, dtype=np.float64, copy=True)
    real_array(f"data of {name}", places.data)
    places.eliminate_zeros()
    sums, some = places.sum(axis=1), np.diff(places.indptr) > 0
    if (bad := some & (np.abs(sums - 1) > _ROUNDED)).any():
        raise InvalidInputError(
            name,
            "have rows of weights that sum to 1, or are empty",
            f"{sums[bad][0]:.6g} in row {int(np.argmax(bad))}",
            advice="divide rows by their sums, if that is what they mean",
        )
    if (np.abs(sums - 1)[some] > _EXACT).any():
        places = sparse.csr_array(sparse.diags_array(1 / np.where(some, sums, 1.0)) @ places)
    return places


def carried_values(places: sparse.csr_array, known: Bools | None, values: ArrayLike) -> Floats:
    """Return values of points (n1, ...) at places (n2, n1); NaN where they are not known."""
    given = real_array("values", values)
    check_rows("values", given, places.shape[1])
    if not given.size:
        raise InvalidInputError("values", "hold a column or more", given.shape)
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
    if given.size and int(given.max()) > np.iinfo(np.int64).max:
        raise InvalidInputError(name, "fit into 64 bits with their sign", int(given.max()))
    found, codes = np.unique(given.astype(np.int64), return_inverse=True)
    return found, codes


def voted(places: sparse.csr_array, codes: Ints, count: int) -> Ints:
    """Return which of some labels has most weight at each place; of equal ones the first."""
    each = (np.ones(len(codes)), codes, np.arange(len(codes) + 1))
    votes = places @ sparse.csr_array(each, (len(codes), count))
    return np.asarray(votes.argmax(axis=1)).ravel()
