"""Exact nearest neighbours of rows, a block at a time: nothing of size (q, n) is ever held."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.threads import (
    in_threads,
    ranges,
    shares,
    single_threaded_blas,
    thread_count,
)
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import real_array
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    import torch


_BLOCK = 2**19  # scores at a time and thread: 2 MB of float32, which stays in the cache
_DEVICE_BLOCK = 2**26  # 256 MB of float32 on another device


@checked
def nearest_rows(
    queries: ArrayLike, points: ArrayLike, *, exact: bool = True, device: str = "cpu"
) -> Ints:
    """Find the row of `points` nearest to each row of `queries`.

    Parameters
    ----------
    queries : array_like of shape (q, d)
        Rows to find a neighbour for.
    points : array_like of shape (n, d)
        Rows to choose among.
    exact : bool, default True
        Decide in float64 where float32 cannot; without, rounding of the single-precision scores
        decides between neighbours at nearly one distance.
    device : str, default "cpu"
        Where to compute: with NumPy on ``"cpu"``, else with torch, for instance ``"cuda"``.

    Returns
    -------
    ndarray of shape (q,)
        Indices into `points`; the lowest of those at the same distance. Where two surfaces lie on
        each other, ``nearest_rows(target.points, source.points)`` is a point map (p2p_21).

    Notes
    -----
    The nearest point has the largest score ``q . p - |p|^2 / 2``: one matrix product in float32.
    A row is decided again, by distances in float64, where another score comes within the bound on
    the rounding error, ``gamma (|q| + |p|_max / 2) |p|_max`` with ``gamma = (d + 4) 2^-23`` (twice
    the classical bound of an inner product, so that it covers both scores). At 20 to 150 columns
    this is quicker than a k-d tree, let alone the float64 product.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.nearest_rows([[0.1, 0.0], [0.9, 0.2]], [[0.0, 0.0], [1.0, 0.0]])
    array([0, 1])
    """
    Q, X = check_rows("queries", queries), check_rows("points", points)
    if Q.shape[1] != X.shape[1]:
        raise InvalidInputError(
            f"`queries` and `points` must have rows of one length, got {Q.shape[1]} and"
            f" {X.shape[1]}; truncate both to the same modes"
        )
    if device == "cpu":
        return nearest(Q, X, exact=exact)
    import torch

    from spectra_kit._sparse.torch_device import check_device

    place = check_device(device)

    there = (torch.tensor(np.array(rows), device=place) for rows in (Q, X))  # torch wants to write
    return nearest_torch(*there, exact=exact).cpu().numpy()


def nearest(Q: Floats, X: Floats, *, exact: bool = False) -> Ints:
    """Do the same with checked arrays; threads share the rows of `Q`."""
    single = np.asarray(X, dtype=np.float32)
    transposed = np.ascontiguousarray(single.T)
    half_squares = 0.5 * np.einsum("nd,nd->n", single, single)
    bound = _rounding(Q, X) if exact and len(X) > 1 else None
    out = np.empty(len(Q), dtype=np.int64)
    rows = max(16, _BLOCK // len(X))

    def search(start: int, stop: int) -> None:
        scores = np.empty((min(rows, stop - start), len(X)), dtype=np.float32)
        for a in range(start, stop, rows):
            b = min(a + rows, stop)
            block, each = scores[: b - a], np.arange(b - a)
            np.matmul(Q[a:b].astype(np.float32), transposed, out=block)
            block -= half_squares
            found = block.argmax(axis=1)
            if bound is not None:
                best = block[each, found]
                block[each, found] = -np.inf
                open_rows = np.flatnonzero(best - block.max(axis=1) <= bound[a:b])
                block[open_rows, found[open_rows]] = best[open_rows]
                for i in open_rows:
                    rivals = np.flatnonzero(block[i] >= best[i] - bound[a + i])
                    squared = ((X[rivals] - Q[a + i]) ** 2).sum(axis=1)
                    found[i] = rivals[squared.argmin()]
            out[a:b] = found

    share = -(-len(Q) // thread_count())
    # Shares are whole blocks: a small problem is not worth a second thread.
    share = -(-share // rows) * rows
    with single_threaded_blas():
        in_threads(search, ranges(len(Q), max(share, 1)))
    return out


def nearest_torch(Q: torch.Tensor, X: torch.Tensor, *, exact: bool = True) -> torch.Tensor:
    """Do the same with float64 tensors, on the device where they are."""
    import torch

    single = X.to(torch.float32)
    half_squares = 0.5 * (single**2).sum(dim=1)
    rows = max(16, _DEVICE_BLOCK // len(X))
    largest = torch.linalg.vector_norm(X, dim=1).max()
    gamma = (X.shape[1] + 4) * 2.0**-23
    out = []
    for a in range(0, len(Q), rows):
        block = Q[a : a + rows]
        scores = block.to(torch.float32) @ single.T - half_squares
        if not exact or len(X) == 1:
            out.append(scores.argmax(dim=1))
            continue
        two, index = scores.topk(2, dim=1)
        found = index[:, 0]
        bound = gamma * (torch.linalg.vector_norm(block, dim=1) + largest / 2) * largest
        for i in torch.nonzero(two[:, 0] - two[:, 1] <= bound)[:, 0].tolist():
            rivals = torch.nonzero(scores[i] >= two[i, 0] - bound[i])[:, 0]
            squared = ((X[rivals] - block[i]) ** 2).sum(dim=1)
            found[i] = rivals[squared.argmin()]
        out.append(found)
    return torch.cat(out)


def nearest_each_way(rows1: Floats, rows2: Floats) -> tuple[Ints, Ints]:
    """Return which row of the first is nearest to each of the second, and the reverse; few rows."""
    first, second = rows1.astype(np.float32), rows2.astype(np.float32)
    squares = (second**2).sum(axis=1)[:, None] + (first**2).sum(axis=1) - 2 * second @ first.T
    return squares.argmin(axis=1), squares.argmin(axis=0)


def nearest_columns(columns: NDArray[np.float32], rows: Floats) -> Ints:
    """Return which column is nearest to each row (r, d), of each of many sets (c, d, s): (c, r)."""
    scores = rows.astype(np.float32) @ columns
    scores -= 0.5 * (columns**2).sum(axis=1)[:, None]
    return np.asarray(scores.argmax(axis=2))


def nearest_within(
    ways: sparse.csr_array, source: tuple[Floats, Ints], target: tuple[Floats, Ints]
) -> Ints:
    """Return the row of the source nearest to each row of the target, of those that are allowed.

    Of both sides: rows of all points, and the cell of each point. `ways`, (cells of the target,
    cells of the source), is not zero where points of one may go to points of the other.
    """
    rows1, members1, starts1 = source[0], *_members(source[1], ways.shape[1])
    rows2, members2, starts2 = target[0], *_members(target[1], ways.shape[0])
    out = np.empty(len(rows2), dtype=np.int64)

    def search(first: int, last: int) -> None:
        for s in range(first, last):
            here = members2[starts2[s] : starts2[s + 1]]
            cells = ways.indices[ways.indptr[s] : ways.indptr[s + 1]]
            pool = np.concatenate([members1[starts1[c] : starts1[c + 1]] for c in cells])
            points = rows1[pool]
            scores = rows2[here] @ points.T - 0.5 * np.einsum("pd,pd->p", points, points)
            out[here] = pool[scores.argmax(axis=1)]

    in_threads(search, shares(ways.shape[0]))
    return out


def _members(cells: Ints, count: int) -> tuple[Ints, Ints]:
    """Return the points sorted by their cells, and where each cell begins."""
    starts = np.concatenate([[0], np.cumsum(np.bincount(cells, minlength=count))])
    return np.argsort(cells, kind="stable"), starts


def _rounding(Q: Floats, X: Floats) -> Floats:
    """Bound the error of a difference of two float32 scores of each query: (q,)."""
    largest = float(np.sqrt(np.einsum("nd,nd->n", X, X).max()))
    norms = np.sqrt(np.einsum("qd,qd->q", Q, Q))
    gamma = (X.shape[1] + 4) * 2.0**-23
    return np.asarray(gamma * (norms + largest / 2) * largest)


def check_rows(name: str, values: ArrayLike) -> Floats:
    """Return `values` as finite float64 of shape (rows, d), neither of them 0."""
    if np.ndim(values) != 2 or 0 in np.shape(values):
        raise InvalidInputError(
            name,
            "be two-dimensional and not empty, one row for each point",
            f"shape {np.shape(values)}",
        )
    return real_array(name, values)
