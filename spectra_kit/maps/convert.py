"""From point maps to functional maps and back; the conventions are those of the package."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import Rebuilt
from spectra_kit.eigen import Spectrum
from spectra_kit.maps.checks import (
    at_unit_area,
    check_functional_map,
    check_point_map,
    check_sizes,
)
from spectra_kit.maps.nearest import nearest


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

    Raises
    ------
    InvalidInputError
        If `point_map` has another length, holds an index out of range, or there are fewer
        modes than `k`.

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

    Raises
    ------
    InvalidInputError
        If `functional_map` is not finite or larger than the spectra.

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
