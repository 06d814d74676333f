"""Iterative closest points in the spectral domain."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._checked import checked
from spectra_kit._validate import check_count
from spectra_kit.functional_maps.checks import (
    at_unit_area,
    check_components,
    check_functional_map,
)
from spectra_kit.functional_maps.convert import Correspondence, induced
from spectra_kit.functional_maps.nearest import nearest
from spectra_kit.spectra import Spectrum


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
    >>> from spectra_kit.eigensolvers import eigensolve
    >>> from spectra_kit.functional_maps import icp
    >>> from spectra_kit.geometry import creature
    >>> from spectra_kit.operators import robust_laplacian
    >>> s = eigensolve(robust_laplacian(creature(500)), 20)
    >>> start = np.eye(20) + 0.05 * np.random.default_rng(0).normal(size=(20, 20))
    >>> bool((icp(s, s, start).point_map == np.arange(500)).all())
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
