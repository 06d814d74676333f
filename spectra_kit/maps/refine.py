"""Refinements that see both directions of a map, or keep its size."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.checks import (
    at_unit_area,
    check_components,
    check_functional_map,
    checked_pair,
    starting_map,
)
from spectra_kit.maps.convert import Correspondence, induced
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.zoomout import schedule


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

    Raises
    ------
    InvalidInputError
        As `zoomout`; if `features` do not fit the points or each other, or are not finite.

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

    Raises
    ------
    InvalidInputError
        If `functional_map` does not fit the spectra, or the numbers of components differ.

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
