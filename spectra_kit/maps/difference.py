"""Where, and by how much, a map stretches a surface: shape difference operators."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.convert import check_functional_map


class ShapeDifference(NamedTuple):
    """What a map does to areas and to angles, as operators on functions of the source.

    Attributes
    ----------
    area : ndarray of shape (k1, k1)
        V, on coefficients of the source's modes: ``<f, V g>`` is the inner product of what f and g
        become on the target. The identity where areas stay as they are.
    conformal : ndarray of shape (k1 - z, k1 - z)
        R, the same for inner products of gradients, on modes outside the kernel of z. The identity
        where angles stay as they are.
    """

    area: Floats
    conformal: Floats


@checked
def shape_difference(
    source: Spectrum, target: Spectrum, functional_map: ArrayLike
) -> ShapeDifference:
    """Return the area-based and the conformal shape difference operator of a map.

    Rustamov, Ovsjanikov, Azencot, Ben-Chen, Chazal and Guibas, *Map-Based Exploration of Intrinsic
    Shape Differences and Variability*, ACM Transactions on Graphics 32(4), 2013.

    Parameters
    ----------
    source, target : Spectrum
        Of the two surfaces, in one unit: of a copy scaled by s, V is ``s**2 I`` and R is I.
    functional_map : array_like of shape (k2, k1)
        Source coefficients to target coefficients, at unit area, as everywhere here. Have k2 well
        above k1: what the target's modes cannot hold is lost, as if it had shrunk.

    Returns
    -------
    ShapeDifference
        ``V = C^T C`` and ``R = Lambda_1^-1 C^T Lambda_2 C``, with the map C in the unit of the
        surfaces. Eigenvectors of the largest eigenvalues live where the map stretches most.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.spectrum(sk.geometry.creature(500), 12)
    >>> V, R = sk.maps.shape_difference(spectrum, spectrum.rescale(3.0), np.eye(12))
    >>> bool(np.allclose(V, 9 * np.eye(12))), bool(np.allclose(R, np.eye(11)))
    (True, True)
    """
    C = check_functional_map("functional_map", functional_map, source, target)
    k2, k1 = C.shape
    z = source.n_zero_modes
    if k1 <= z:
        raise InvalidInputError(
            "functional_map", f"carry modes outside the source's kernel of {z}", f"{k1} modes"
        )
    C = (target.area / source.area) ** 0.5 * C
    moved = C[:, z:]
    energies = moved.T @ (target.eigenvalues[:k2, None] * moved)
    return ShapeDifference(np.asarray(C.T @ C), energies / source.eigenvalues[z:k1, None])
