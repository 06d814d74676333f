"""The descriptors by their names, and their columns brought to one size and rid of their unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.features.gps import global_point_signature
from spectra_kit.features.heat import heat_kernel_signature
from spectra_kit.features.shape_dna import shape_dna
from spectra_kit.features.wave import wave_kernel_signature

#: By their names in a plan, a store, its tables and on the command line.
DESCRIPTORS: Mapping[str, Callable[..., Floats]] = MappingProxyType(
    {
        "hks": heat_kernel_signature,
        "wks": wave_kernel_signature,
        "gps": global_point_signature,
        "dna": shape_dna,
    }
)


@checked
def normalize_descriptors(
    spectrum: Spectrum, descriptors: ArrayLike, *, center: bool = False
) -> Floats:
    """Scale each column of descriptors to root mean square 1 over the surface.

    What is left has no unit: columns of surfaces in different units can be compared.

    Parameters
    ----------
    spectrum : Spectrum
        Of the surface; only its mass is used.
    descriptors : array_like of shape (n, d)
        One function on the surface in each column.
    center : bool, default False
        Subtract the average over the area first, which is most of a heat kernel signature and
        tells no two points apart.

    Returns
    -------
    ndarray of shape (n, d)
        Columns with ``mass @ column**2 == area``, without a unit.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.zeros(1), np.full((2, 1), 0.5), np.full(2, 2.0))
    >>> sk.features.normalize_descriptors(spectrum, [[3.0], [1.0]], center=True)
    array([[ 1.],
           [-1.]])
    """
    columns = real_array("descriptors", descriptors)
    if columns.ndim != 2 or len(columns) != spectrum.n:
        raise InvalidInputError(
            "descriptors",
            f"have shape ({spectrum.n}, d) like the points of `spectrum`",
            columns.shape,
        )
    squared = spectrum.mass @ columns**2
    if center:
        columns = columns - spectrum.mass @ columns / spectrum.area
        # A constant that rounding has left some noise of is still a constant.
        squared = np.where(spectrum.mass @ columns**2 > 1e-24 * squared, squared, 0.0)
    if not squared.all():
        found = "constant" if center else "zero"
        raise InvalidInputError(
            "descriptors",
            f"have no {found} column",
            f"one in column {int(np.argmin(squared))}",
            advice="leave it out",
        )
    return columns / np.sqrt(spectrum.mass @ columns**2 / spectrum.area)
