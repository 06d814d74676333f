"""`low_pass`: a shape rebuilt from the lowest modes of its own spectrum."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import PointCloud, TriangleMesh

Kind = TypeVar("Kind", TriangleMesh, PointCloud)

_CONSTANT = 1e-6  # how far from 1 the modes may rebuild it


@checked
def low_pass(geometry: Kind, spectrum: Spectrum) -> Kind:
    """Rebuild a shape from the modes of its spectrum: what is finer than these is gone.

    Vallet and Lévy, *Spectral Geometry Processing with Manifold Harmonics*, Eurographics 2008.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    spectrum : Spectrum
        On these points, with constants among its modes: not of a Laplacian that holds points at
        zero, and not its `nonzero` part. `truncate` leaves fewer modes.

    Returns
    -------
    TriangleMesh or PointCloud
        Of the same kind, with the same faces; points move to ``U U^T M x``, and the centre of the
        area stays. Of k modes, waves shorter than about ``sqrt(pi area / k)`` are gone.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> rough = ball.with_points(ball.points * np.linspace([1.02], [0.98], ball.n))
    >>> smooth = sk.eigen.low_pass(rough, sk.spectrum(rough, 16))
    >>> bool(np.linalg.norm(smooth.points, axis=1).std() < 0.01)
    True
    """
    if spectrum.n != geometry.n:
        raise InvalidInputError("spectrum", f"be of these {geometry.n} points", spectrum.n)
    ones = spectrum.reconstruct(spectrum.project(np.ones(spectrum.n)))
    if not np.abs(ones - 1).max() <= _CONSTANT:
        raise InvalidInputError(
            "spectrum",
            "have constants among its modes",
            f"some that come as near as {np.abs(ones - 1).max():.1g}",
            advice="take that of a Laplacian without fixed points, with a mode more for each part",
        )
    centre = spectrum.mass @ geometry.points / spectrum.area  # far from 0 digits would be lost
    offsets = geometry.points - centre
    return geometry.with_points(centre + spectrum.reconstruct(spectrum.project(offsets)))
