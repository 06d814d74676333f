"""The canonical frame: a pose and size of a cloud that its rigid motions and rescalings share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_mass, check_points, quantity
from spectra_kit.errors import InvalidInputError

#: The four proper sign flips of a frame, shape (4, 3): multiply posed coordinates by a row.
POSES: Floats = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
POSES.flags.writeable = False

_NO_SKEWNESS = 1e-9  # below this a third moment is rounding: the sign rule must not read it


class Frame(NamedTuple):
    """A similarity transform into [-1, 1]^3.

    Attributes
    ----------
    centre : ndarray of shape (3,)
        Mass-weighted centroid, in length.
    rotation : ndarray of shape (3, 3)
        Proper rotation; its columns are the new axes.
    scale : float
        Largest absolute coordinate after centring and rotating, in length.
    """

    centre: Floats
    rotation: Floats
    scale: float

    def pose(self, points: NDArray[np.floating]) -> Floats:
        """Return `points` of shape (n, 3) in this frame, dimensionless."""
        return np.asarray((points - self.centre) @ self.rotation / self.scale)


@checked
def canonical_frame(points: ArrayLike, mass: ArrayLike) -> Frame:
    """Return the principal frame of a weighted cloud.

    The axes are those of the mass-weighted covariance, by descending variance. Of the four proper
    orientations (`POSES`) the one with the largest summed skewness is taken, so the axis whose
    third moment says least is the one that gives way to right-handedness.

    Where variances coincide or third moments vanish (a sphere, a box) the frame is one of several
    equally good ones: the same input always gives the same frame, a rotated copy may not.

    Parameters
    ----------
    points : array_like of shape (n, 3)
        Coordinates, in length.
    mass : array_like of shape (n,)
        Positive weights; only their ratios matter.

    Returns
    -------
    Frame
        The posed cloud ``(points - centre) @ rotation / scale`` has largest absolute coordinate 1.

    Examples
    --------
    >>> from spectra_kit.eigen.subspaces import canonical_frame
    >>> points = [[0, 0, 0], [4, 0, 0], [0, 2, 0], [0, 0, 1]]
    >>> frame = canonical_frame(points, [1, 1, 1, 1])
    >>> frame.centre
    array([1.  , 0.5 , 0.25])
    >>> float(abs(frame.pose(points)).max())
    1.0
    """
    points = check_points("points", points)
    mass = check_mass("mass", mass, len(points))
    weights = mass / mass.sum()
    # Centred twice: far from the origin the first mean is off by rounding of the offset.
    centre = weights @ points
    centre = centre + weights @ (points - centre)
    centred = points - centre
    extent = np.abs(centred).max()
    if extent <= 1e-12 * np.abs(points).max():
        raise InvalidInputError(
            "points",
            "not share one location",
            f"{quantity(len(points), 'point')} within {extent:.3g} of {points[0].tolist()}",
            advice="a frame needs at least two distinct points",
        )
    centred = centred / extent
    _, axes = np.linalg.eigh(centred.T @ (weights[:, None] * centred))
    axes = axes[:, ::-1]
    # LAPACK's signs are arbitrary: fix them, so that ties below are settled the same everywhere.
    axes = axes * np.where(axes[np.abs(axes).argmax(axis=0), range(3)] < 0, -1.0, 1.0)
    axes = axes * np.array([1.0, 1.0, np.linalg.det(axes)]).round()
    turned = centred @ axes
    skewness = weights @ (turned * turned * turned)  # a power takes twenty times as long
    skewness[np.abs(skewness) < _NO_SKEWNESS] = 0.0
    rotation = axes * POSES[(POSES @ skewness).argmax()]
    return Frame(centre, rotation, float(extent * np.abs(centred @ rotation).max()))
