"""ZoomOut: refine a map by going back and forth between points and ever more modes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.checks import checked_pair, checked_samples, starting_map
from spectra_kit.maps.convert import Correspondence
from spectra_kit.maps.nearest import check_rows, nearest, nearest_torch

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

    Raises
    ------
    InvalidInputError
        If a map does not fit the spectra, `k_final` is below the start or above the number of
        modes, the numbers of components differ, the samples are too few or out of range, or torch
        cannot use `device`.

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
    arrays = a.eigenvectors, b.eigenvectors, b.mass, C
    rows = None if samples is None else checked_samples(samples, a.n, b.n, k_final, seed)
    if device == "cpu":
        refined = _zoom(*arrays, rows, k_final, step, _NUMPY)
    else:
        import torch

        from spectra_kit._sparse.torch_device import check_device

        place = check_device(device)

        A, B, mass, start = (torch.tensor(x, device=place) for x in map(np.array, arrays))
        tools = _Tools(nearest_torch, torch.linalg.qr, _solve_torch)
        on_device = _zoom(A, B, mass, start, rows, k_final, step, tools)
        refined = tuple(x.cpu().numpy() for x in on_device)
    return Correspondence(*refined)


class _Tools(NamedTuple):
    """What the loop needs of NumPy or torch beyond operators."""

    find: Callable[..., Any]
    qr: Callable[[Any], tuple[Any, Any]]
    solve: Callable[[Any, Any], Any]


def _zoom(
    A: Any,
    B: Any,
    mass: Any,
    C: Any,
    samples: tuple[Ints, Ints] | None,
    k_final: int,
    step: int,
    tools: _Tools,
) -> tuple[Any, Any]:
    """Return point map and functional map, from arrays or tensors."""
    weighted = mass[:, None] * B

    def project(values: Any, k: int) -> Any:
        return weighted[:, :k].T @ values

    def fit(values: Any, k: int) -> Any:
        return tools.solve(R[:k, :k], Q[:, :k].T @ values)

    rows1, rows2, represent = A, B, project
    if samples is not None:
        rows1, rows2, represent = A[samples[0]], B[samples[1]], fit
        Q, R = tools.qr(rows2)
    for k1, k2 in schedule(C.shape, k_final, step):
        p = tools.find(rows2[:, : len(C)], rows1[:, : C.shape[1]] @ C.T, exact=False)
        C = represent(rows1[p][:, :k1], k2)
    if samples is not None:  # one step on all points evens out the noise of the samples
        p = tools.find(B[:, : len(C)], A[:, : C.shape[1]] @ C.T, exact=False)
        C = project(A[p], k_final)
    p = tools.find(B[:, : len(C)], A[:, : C.shape[1]] @ C.T, exact=True)
    return p, project(A[p], k_final)


def _solve_torch(R: Any, Y: Any) -> Any:
    import torch

    return torch.linalg.solve_triangular(R, Y, upper=True)


_NUMPY = _Tools(nearest, np.linalg.qr, solve_triangular)


@checked
def zoomout_many(
    source_rows: ArrayLike,
    target_rows: ArrayLike,
    maps: ArrayLike,
    *,
    k_final: int,
    step: int = 2,
) -> tuple[Floats, Ints]:
    """Refine many candidate maps of one pair at once, on a few hundred samples.

    Parameters
    ----------
    source_rows : array_like of shape (s1, k)
        Eigenvectors at samples of the source, at unit area; k >= `k_final`.
    target_rows : array_like of shape (s2, k)
        The same for the target; s2 >= `k_final`.
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

    Raises
    ------
    InvalidInputError
        If a shape does not fit, a value is not finite, or there are fewer target samples than
        `k_final`.

    Notes
    -----
    Each candidate goes through what `zoomout` does with samples.

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
    candidates = real_array("maps", maps)
    Q, R = np.linalg.qr(rows2[:, :k_final])
    sizes = schedule(shape[1:], k_final, step)
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
    scores = rows2[:, : C.shape[1]].astype(np.float32) @ images
    scores -= 0.5 * (images**2).sum(axis=1)[:, None]
    return np.asarray(scores.argmax(axis=2))


def schedule(shape: tuple[int, int], k_final: int, step: int) -> list[tuple[int, int]]:
    """Return the sizes (k1, k2) after that of a (k2, k1) map, `step` more modes each time."""
    k2, k1 = shape
    count = -(-(k_final - min(k1, k2)) // step)
    return [(min(k1 + i * step, k_final), min(k2 + i * step, k_final)) for i in range(1, count + 1)]
