"""The global point signature: a surface embedded by its own modes."""

from __future__ import annotations

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._types import Floats
from spectra_kit._validate import check_count
from spectra_kit.descriptors._checks import outside_kernel
from spectra_kit.spectra import Spectrum


@checked
def global_point_signature(spectrum: Spectrum, count: int | None = None) -> Floats:
    """Each point as its values in the first modes, over the roots of their eigenvalues (GPS).

    Parameters
    ----------
    spectrum : Spectrum
        k modes; zero modes are left out.
    count : int, optional
        Number of modes; by default all outside the kernel.

    Returns
    -------
    ndarray of shape (n, count)
        ``u_i(x) / sqrt(lambda_i)``, dimensionless. Signs, and bases inside eigenspaces, are those
        of the spectrum: compare two surfaces by what does not see them, as the distances
        within each (`commute_time_distances` are the square root of the area times these).

    Raises
    ------
    InvalidInputError
        If all modes are zero modes, or `count` is below 1 or above the number of the others.

    Notes
    -----
    Rustamov (2007). Inner products of rows are Green's function of the Laplacian,
    which on a surface has no finite value on the diagonal: norms grow as the root of log k.

    References
    ----------
    R. M. Rustamov, "Laplace-Beltrami eigenfunctions for deformation invariant shape
    representation", Symposium on Geometry Processing, 2007.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit import Spectrum
    >>> from spectra_kit.descriptors import global_point_signature
    >>> spectrum = Spectrum(np.array([0.0, 4.0, 25.0]), np.eye(3), np.ones(3))
    >>> global_point_signature(spectrum)
    array([[0. , 0. ],
           [0.5, 0. ],
           [0. , 0.2]])
    """
    modes = outside_kernel(spectrum)
    if count is not None:
        modes = modes.truncate(check_count("count", count, low=1, high=modes.k))
    return np.asarray(modes.eigenvectors / np.sqrt(modes.eigenvalues))
