"""ZoomOut and ICP: refine a map by going back and forth between points and modes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_indices, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.convert import (
    Correspondence,
    at_unit_area,
    check_components,
    check_functional_map,
    check_point_map,
    induced,
)
from spectra_kit.maps.nearest import check_rows, nearest, nearest_columns, nearest_torch

_START = 20  # modes with which a point map starts: enough to tell the limbs of a body apart
_CHUNK = 2**20  # scores of `zoomout_many` held at a time: 4 MB of float32


@checked
def zoomout(
    source: Spectrum,
    target: Spectrum,
    initial: ArrayLike,
    *,
    k_final: int,
    k_start: int | None = None,
    step: int = 5,
    samples: int | tuple[ArrayLike, ArrayLike] | None = None,
    seed: int = 0,
    device: str = "cpu",
) -> Correspondence:
    """Refine a functional map or a point map by spectral upsampling.

    Parameters
    ----------
    source, target : Spectrum
        Of the two surfaces, in any units, of as many components, with at least `k_final` modes.
    initial : array_like of shape (k2, k1) or (n2,)
        A functional map of source to target, or the source point of each target point.
    k_final : int
        Number of modes to end with.
    k_start : int, optional
        Number of modes to start with: of a functional map, by default all that it has; of a point
        map, by default 20 or `k_final`, whichever is less.
    step : int, default 5
        Modes to add in each iteration.
    samples : int or (indices, indices), optional
        How many points to choose at random on each surface, or the source and the target points
        to work on: several times `k_final`. Only one last step then sees all points.
    seed : int, default 0
        Of the choice of samples.
    device : str, default "cpu"
        Where to compute: with NumPy on ``"cpu"``, else with torch, for instance ``"cuda"``.

    Returns
    -------
    Correspondence
        The point map, and the functional map of `k_final` x `k_final` that it induces.

    Notes
    -----
    Each iteration projects the point map onto `step` more modes and looks up the nearest row of
    ``U1 @ C.T`` for each row of ``U2`` (Melzi et al. 2019, algorithm 1). With samples the
    projection is the least-squares fit on them (their section 4.4); one QR factorisation serves
    every size, for leading columns have leading factors.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> s = sk.spectrum(sk.geometry.creature(500), 30)
    >>> refined = sk.maps.zoomout(s, s, np.eye(8), k_final=30)
    >>> bool((refined.point_map == np.arange(500)).all())
    True
    """
    a, b = checked_pair(source, target, k_final)
    check_count("step", step, low=1)
    C = starting_map(a, b, initial, k_start)
    arrays = a.eigenvectors, b.eigenvectors, b._weighed(b.eigenvectors), C
    rows = None if samples is None else checked_samples(samples, a.n, b.n, k_final, seed)
    if device == "cpu":
        return Correspondence(*_zoom(*arrays, rows, k_final, step))
    import torch

    from spectra_kit._sparse.torch_device import check_device

    place = check_device(device)
    A, B, weighted, start = (torch.tensor(np.array(x), device=place) for x in arrays)
    solve = partial(torch.linalg.solve_triangular, upper=True)
    find, qr = nearest_torch, torch.linalg.qr
    found = _zoom(A, B, weighted, start, rows, k_final, step, find, qr, solve)
    return Correspondence(*(x.cpu().numpy() for x in found))


def _zoom(
    A: Any,
    B: Any,
    weighted: Any,
    C: Any,
    samples: tuple[Ints, Ints] | None,
    k_final: int,
    step: int,
    find: Callable[..., Any] = nearest,
    qr: Callable[..., Any] = np.linalg.qr,
    solve: Callable[..., Any] = solve_triangular,
) -> tuple[Any, Any]:
    """Return point map and functional map, from arrays or, with other tools, from tensors."""

    def project(values: Any, k: int) -> Any:
        return weighted[:, :k].T @ values

    def fit(values: Any, k: int) -> Any:
        return solve(R[:k, :k], Q[:, :k].T @ values)

    rows1, rows2, represent = A, B, project
    if samples is not None:
        rows1, rows2, represent = A[samples[0]], B[samples[1]], fit
        Q, R = qr(rows2)
    for k1, k2 in schedule(C.shape, k_final, step):
        p = find(rows2[:, : len(C)], rows1[:, : C.shape[1]] @ C.T, exact=False)
        C = represent(rows1[p][:, :k1], k2)
    if samples is not None:  # one step on all points evens out the noise of the samples
        p = find(B[:, : len(C)], A[:, : C.shape[1]] @ C.T, exact=False)
        C = project(A[p], k_final)
    p = find(B[:, : len(C)], A[:, : C.shape[1]] @ C.T, exact=True)
    return p, project(A[p], k_final)


@checked
def zoomout_many(
    source_rows: ArrayLike,
    target_rows: ArrayLike,
    maps: ArrayLike,
    *,
    k_final: int,
    step: int = 2,
) -> tuple[Floats, Ints]:
    """Refine many candidate maps of one pair at once, on a few hundred samples, as `zoomout` does.

    Parameters
    ----------
    source_rows, target_rows : array_like of shape (s1, k) and (s2, k)
        Eigenvectors at samples, at unit area; k and s2 are `k_final` or more.
    maps : array_like of shape (c, k2, k1)
        Candidates, all of one size.
    k_final : int
        Number of modes to end with.
    step : int, default 2
        Modes to add in each iteration.

    Returns
    -------
    maps : ndarray of shape (c, k_final, k_final)
        Refined candidates: the least-squares fits on the samples.
    point_maps : ndarray of shape (c, s2)
        Source sample of each target sample, by the refined maps.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> rows = np.random.default_rng(0).normal(size=(50, 10))
    >>> maps, point_maps = sk.maps.zoomout_many(rows, rows, np.eye(4)[None], k_final=10)
    >>> bool((point_maps[0] == np.arange(50)).all())
    True
    """
    check_count("step", step, low=1)
    check_count("k_final", k_final, low=1)
    rows1, rows2 = check_rows("source_rows", source_rows), check_rows("target_rows", target_rows)
    for name, rows in (("source_rows", rows1), ("target_rows", rows2)):
        if rows.shape[1] < k_final:
            raise InvalidInputError(
                name, f"have at least `k_final` = {k_final} columns", rows.shape
            )
    if len(rows2) < k_final:
        raise InvalidInputError(
            "target_rows", f"hold at least `k_final` = {k_final} samples", len(rows2)
        )
    shape = np.shape(maps)
    if len(shape) != 3 or not (1 <= shape[1] <= k_final and 1 <= shape[2] <= k_final):
        raise InvalidInputError(
            "maps", f"have shape (c, k2, k1) with k1 and k2 in [1, {k_final}]", shape
        )
    return many_zoomed(rows1, rows2, real_array("maps", maps), k_final, step)


def many_zoomed(
    rows1: Floats, rows2: Floats, candidates: Floats, k_final: int, step: int
) -> tuple[Floats, Ints]:
    """Do the same with checked arrays."""
    Q, R = np.linalg.qr(rows2[:, :k_final])
    sizes = schedule(candidates.shape[1:], k_final, step)
    fits = [solve_triangular(R[:k, :k], Q[:, :k].T) for _, k in sizes]
    out = np.empty((len(candidates), k_final, k_final))
    point_maps = np.empty((len(candidates), len(rows2)), dtype=np.int64)
    chunk = max(1, _CHUNK // (len(rows1) * len(rows2)))
    for a in range(0, len(candidates), chunk):
        C = candidates[a : a + chunk]
        for (k1, _), fit in zip(sizes, fits, strict=True):
            C = fit @ rows1[_nearest_each(rows1, rows2, C)][..., :k1]
        out[a : a + chunk], point_maps[a : a + chunk] = C, _nearest_each(rows1, rows2, C)
    return out, point_maps


def _nearest_each(rows1: Floats, rows2: Floats, C: Floats) -> Ints:
    """Return the nearest row of ``rows1 @ C.T`` to each row of `rows2` for each map: (c, s2)."""
    images = (C @ rows1[:, : C.shape[2]].T).astype(np.float32)  # (c, k2, s1)
    return nearest_columns(images, rows2[:, : C.shape[1]])


def schedule(shape: tuple[int, int], k_final: int, step: int) -> list[tuple[int, int]]:
    """Return the sizes (k1, k2) after that of a (k2, k1) map, `step` more modes each time."""
    k2, k1 = shape
    count = -(-(k_final - min(k1, k2)) // step)
    return [(min(k1 + i * step, k_final), min(k2 + i * step, k_final)) for i in range(1, count + 1)]


@checked
def bijective_zoomout(
    source: Spectrum,
    target: Spectrum,
    initial: ArrayLike,
    *,
    k_final: int,
    k_start: int | None = None,
    step: int = 5,
    features: tuple[ArrayLike, ArrayLike] | None = None,
) -> Correspondence:
    """Refine a map by ZoomOut in both directions, kept each other's inverse.

    Twice the work of `zoomout` for each step.

    Parameters
    ----------
    source, target, initial, k_final, k_start, step
        As of `zoomout`.
    features : (array_like of shape (n1, p), array_like of shape (n2, p)), optional
        Functions known on the source and on the target, such as smoothed mean curvature: more
        columns in which neighbours are to be near. The scale is their weight: a column with mean
        square 1 counts like one mode; a scale of 2 counts like four.

    Returns
    -------
    Correspondence
        The point map, and the functional map of `k_final` x `k_final` that it induces.

    Notes
    -----
    A bijection that preserves areas has ``C_21 = C_12^T``. Each iteration finds the point maps of
    both directions, and takes the mean of the functional map of one and the transpose of the
    other's: the best fit to both at once (the coupling of MapTree, Ren et al. 2020, with one
    matrix in place of two).

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> s = sk.spectrum(sk.geometry.creature(500), 30)
    >>> refined = sk.maps.bijective_zoomout(s, s, np.eye(8), k_final=30, step=11)
    >>> bool((refined.point_map == np.arange(500)).all())
    True
    """
    a, b = checked_pair(source, target, k_final)
    check_count("step", step, low=1)
    C = starting_map(a, b, initial, k_start)
    more1, more2 = _checked_features(features, a.n, b.n)
    return both_ways(a, b, C, k_final, step, (more1, more2))


def both_ways(
    a: Spectrum, b: Spectrum, C: Floats, k_final: int, step: int, features: tuple[Floats, Floats]
) -> Correspondence:
    """Do the same with spectra at unit area and checked arrays."""
    more1, more2 = features
    for k1, k2 in schedule(C.shape, k_final, step):
        A, B = a.eigenvectors[:, : C.shape[1]], b.eigenvectors[:, : len(C)]
        to_source = nearest(np.hstack([B, more2]), np.hstack([A @ C.T, more1]))
        to_target = nearest(np.hstack([A, more1]), np.hstack([B @ C, more2]))
        C = 0.5 * (induced(a, b, to_source, k1, k2) + induced(b, a, to_target, k2, k1).T)
    A, B = a.eigenvectors[:, : C.shape[1]], b.eigenvectors[:, : len(C)]
    point_map = nearest(np.hstack([B, more2]), np.hstack([A @ C.T, more1]), exact=True)
    return Correspondence(point_map, induced(a, b, point_map, k_final, k_final))


@checked
def icp(
    source: Spectrum, target: Spectrum, functional_map: ArrayLike, *, iterations: int = 10
) -> Correspondence:
    """Refine a functional map of fixed size: alternate nearest rows and the best isometry.

    `zoomout` reaches further; this improves a map without adding modes to it.

    Parameters
    ----------
    source, target : Spectrum
        Of the two surfaces, in any units.
    functional_map : array_like of shape (k2, k1)
        Source coefficients to target coefficients.
    iterations : int, default 10
        How often to repeat; it ends sooner once the point map stays the same.

    Returns
    -------
    Correspondence
        The point map, and the functional map that it induces, of the given size.

    Notes
    -----
    The functional map of each iteration is the one with singular values 1 nearest to that of the
    point map (Ovsjanikov et al. 2012, section 6.2): isometries have orthonormal maps.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> s = sk.spectrum(sk.geometry.creature(500), 20)
    >>> start = np.eye(20) + 0.05 * np.random.default_rng(0).normal(size=(20, 20))
    >>> bool((sk.maps.icp(s, s, start).point_map == np.arange(500)).all())
    True
    """
    check_count("iterations", iterations, low=0)
    check_components(source, target)
    C = check_functional_map("functional_map", functional_map, source, target)
    (k2, k1), a, b = C.shape, at_unit_area(source), at_unit_area(target)
    A, B = a.eigenvectors[:, :k1], b.eigenvectors[:, :k2]
    point_map = nearest(B, A @ C.T, exact=True)
    for _ in range(iterations):
        left, _, right = np.linalg.svd(induced(a, b, point_map, k1, k2), full_matrices=False)
        last, point_map = point_map, nearest(B, A @ (left @ right).T, exact=True)
        if (point_map == last).all():
            break
    return Correspondence(point_map, induced(a, b, point_map, k1, k2))


def _checked_features(
    features: tuple[ArrayLike, ArrayLike] | None, n1: int, n2: int
) -> tuple[Floats, Floats]:
    if features is None:
        return np.empty((n1, 0)), np.empty((n2, 0))
    shapes = [np.shape(f) for f in features]
    p = shapes[0][1] if shapes[0][1:] else 0
    if shapes != [(n1, p), (n2, p)]:
        raise InvalidInputError(
            "features",
            f"be two arrays of shapes ({n1}, p) and ({n2}, p), of the source and of the target",
            " and ".join(map(str, shapes)),
        )
    return real_array("features[0]", features[0]), real_array("features[1]", features[1])


def starting_map(a: Spectrum, b: Spectrum, initial: ArrayLike, k_start: int | None) -> Floats:
    """Return the functional map to start from, of at most the modes of the spectra."""
    if np.ndim(initial) == 1:
        k = min(_START, a.k, b.k) if k_start is None else k_start
        check_count("k_start", k, low=1, high=min(a.k, b.k))
        point_map = check_point_map("initial", initial, a.n, b.n)
        return b.truncate(k).project(a.eigenvectors[point_map, :k])
    if np.ndim(initial) == 2 and max(np.shape(initial)) > min(a.k, b.k):
        raise InvalidInputError(
            "k_final",
            f"be at least the size of `initial`, {np.shape(initial)}",
            min(a.k, b.k),
            advice="end later, or cut `initial`",
        )
    C = check_functional_map("initial", initial, a, b)
    if k_start is None:
        return C
    check_count("k_start", k_start, low=1, high=min(C.shape))
    return C[:k_start, :k_start]


def checked_pair(source: Spectrum, target: Spectrum, k: int) -> tuple[Spectrum, Spectrum]:
    """Return the first `k` modes of both, at unit area; refuse pairs that cannot be refined."""
    check_components(source, target)
    check_count("k_final", k, low=1)
    if k > min(source.k, target.k):
        raise InvalidInputError(
            "k_final",
            f"be at most {min(source.k, target.k)}",
            f"{k}: the source has {source.k} modes, the target {target.k}",
            advice="compute more modes or end sooner",
        )
    return at_unit_area(source.truncate(k)), at_unit_area(target.truncate(k))


def checked_samples(
    samples: int | tuple[ArrayLike, ArrayLike], n1: int, n2: int, k_final: int, seed: int
) -> tuple[Ints, Ints]:
    """Return the source and the target points to work on: given, or chosen at random."""
    if isinstance(samples, int | np.integer):
        count = check_count("samples", samples, low=k_final)
        rng = np.random.default_rng(check_count("seed", seed, low=0))
        first, second = (
            np.sort(rng.choice(n, min(count, n), replace=False)).astype(np.int64) for n in (n1, n2)
        )
        return first, second
    if not isinstance(samples, tuple | list) or len(samples) != 2:
        raise InvalidInputError(
            "samples",
            "be a number, or two arrays of indices (of the source, of the target)",
            f"a {type(samples).__name__}",
        )
    for i in range(2):
        if np.ndim(samples[i]) != 1 or np.size(samples[i]) == 0:
            raise InvalidInputError(
                f"samples[{i}]", "be a non-empty list of indices", f"shape {np.shape(samples[i])}"
            )
    first = check_indices("samples[0]", samples[0], n1)
    second = check_indices("samples[1]", samples[1], n2)
    distinct = len(np.unique(second))
    if distinct < k_final:
        raise InvalidInputError(
            "samples[1]",
            f"hold at least `k_final` = {k_final} distinct points",
            distinct,
            advice="sample more or end sooner",
        )
    return first, second
