"""`fit_functional_map`: the functional map that descriptors and operators ask for, exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_indices, check_weights, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps._energy import (
    Mask,
    commuting,
    few_combinations,
    laplacian_mask,
    minimise,
    multiplication_operators,
    preserved,
)
from spectra_kit.maps.convert import at_unit_area, check_components, check_sizes
from spectra_kit.operators.oriented import OrientedTriangles, orientation_operator

_RIDGE = 1e-12  # of |C|^2, where all else is of order 1: decides what nothing else does

Landmarks = tuple[ArrayLike, ArrayLike]


@checked
@dataclass(frozen=True, kw_only=True)
class FitWeights:
    """Weights of the terms of `fit_functional_map` beside the descriptors, which have 1.

    Parameters
    ----------
    commutativity : float, default 1.0
        With the Laplacians, ``|C Lambda_1 - Lambda_2 C|^2``, masked.
    multiplication : float, default 1.0
        With multiplication by each descriptor; 0 leaves it out.
    orientation : float, default 0.0
        With the orientation operator of each descriptor, which only maps that keep the orientation
        do; 0 leaves it out.
    landmarks : float, default 1.0
        Of carrying the delta function of each landmark to that of the other.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.FitWeights(orientation=1.0).multiplication
    1.0
    """

    commutativity: float = 1.0
    multiplication: float = 1.0
    orientation: float = 0.0
    landmarks: float = 1.0

    def __post_init__(self) -> None:
        check_weights(vars(self))


@checked
def fit_functional_map(
    source: Spectrum,
    target: Spectrum,
    source_descriptors: ArrayLike,
    target_descriptors: ArrayLike,
    *,
    k: int | tuple[int, int] = 30,
    mask: Mask = "resolvent",
    weights: FitWeights = FitWeights(),
    oriented: tuple[OrientedTriangles, OrientedTriangles] | None = None,
    mirrored: bool = False,
    landmarks: Landmarks | None = None,
) -> Floats:
    """Fit a functional map to descriptors that two surfaces have in common.

    Parameters
    ----------
    source, target : Spectrum
        Of the two surfaces, in any units, of as many components.
    source_descriptors, target_descriptors : array_like of shape (n1, p) and (n2, p)
        Functions that correspond, column by column, in one unit. What is constant in them does not
        matter. They weigh as they are: where columns should count alike, or the surfaces are in
        different units, pass them through `features.normalize_descriptors` first.
    k : int or (int, int), default 30
        Size of the map, or (source's, target's).
    mask : {"resolvent", "standard"}, default "resolvent"
        Commute with the resolvent of the Laplacian's square root, or with the Laplacian itself,
        which punishes the high modes most.
    weights : FitWeights
        Of all that counts beside the descriptors.
    oriented : (OrientedTriangles, OrientedTriangles), optional
        Of the source and of the target; needed for a positive weight of the orientation.
    mirrored : bool, default False
        Ask for a map that turns the orientation round instead, as between left and right.
    landmarks : (array_like of shape (l,), array_like of shape (l,)), optional
        Points of the source and the points of the target that correspond to them.

    Returns
    -------
    ndarray of shape (k2, k1)
        Between the surfaces at unit area. Constants go to constants exactly.

    Raises
    ------
    ConvergenceError
        If a large fit with operators is too badly conditioned for conjugate gradients.

    Notes
    -----
    Minimises, with A and B the coefficients of the descriptors, and each sum divided by its mean
    over random maps of the norm of an isometry, so that the weights have no unit::

                         |C A - B|^2
        + commutativity  sum_ij mask_ij C_ij^2
        + multiplication sum_p |C U1^T M1 diag(f_p) U1  -  U2^T M2 diag(g_p) U2 C|^2
        + orientation    sum_p |C O1(f_p)  -+  O2(g_p) C|^2,    O(f)_ij = integral of u_i df ^ du_j

    (Ovsjanikov et al. 2012; Nogneng and Ovsjanikov, *Informative Descriptor Preservation*, 2017;
    Ren et al. 2018 for the orientation, 2019 for the resolvent.) The energy is quadratic: the
    normal equations are solved by Cholesky factors, or above 2500 unknowns with operators by
    conjugate gradients to a relative residual of 1e-10. What no term decides, such as the sign of
    odd functions on a symmetric surface without an orientation term, is 0: the energy holds
    ``1e-12 |C|^2`` besides. The operators of descriptors count where both surfaces have modes, in
    the first ``min(k1, k2)`` rows and columns: a rectangular cut of the true map does not commute
    with them beyond.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.creature(800)
    >>> spectrum, f = sk.spectrum(mesh, 20), np.sin(3 * mesh.points)
    >>> copy = sk.spectrum(mesh.with_points(1000 * mesh.points), 20)
    >>> C = sk.maps.fit_functional_map(spectrum, copy, f, f, k=20)
    >>> bool(np.allclose(np.abs(C), np.eye(20), atol=1e-5))
    True
    """
    k1, k2 = check_sizes(k, source, target)
    check_components(source, target)
    source, target = at_unit_area(source), at_unit_area(target)
    f = _descriptors("source_descriptors", source_descriptors, source)
    g = _descriptors("target_descriptors", target_descriptors, target)
    if f.shape[1] != g.shape[1]:
        raise InvalidInputError(
            "`source_descriptors` and `target_descriptors` must have the same number of columns,"
            f" got {f.shape[1]} and {g.shape[1]}"
        )
    one, other = source.truncate(k1), target.truncate(k2)
    constants = one.project(np.ones(source.n)), other.project(np.ones(target.n))
    terms = [
        preserved("descriptors", one.project(f), other.project(g), constants, 1.0),
    ]
    if landmarks is not None:
        here, there = check_landmarks(landmarks, source.n, target.n)
        deltas = one.eigenvectors[here].T, other.eigenvectors[there].T
        terms.append(preserved("landmarks", *deltas, constants, weights.landmarks))
    operators = []
    if weights.multiplication or weights.orientation:
        f, g = few_combinations(source, target, f, g)
    if weights.multiplication:
        pair = multiplication_operators(one, k1, f), multiplication_operators(other, k2, g)
        operators.append(commuting("multiplication", *pair, weights.multiplication))
    if weights.orientation:
        first, second = _checked_triangles(oriented, source.n, target.n)
        pair = (
            orientation_operator(first, one.eigenvectors, f),
            orientation_operator(second, other.eigenvectors, g) * (-1 if mirrored else 1),
        )
        operators.append(commuting("orientation", *pair, weights.orientation))
    masked = laplacian_mask(mask, one.eigenvalues, other.eigenvalues)
    return minimise(weights.commutativity * masked + _RIDGE, terms, operators, constants)


def _descriptors(name: str, values: ArrayLike, spectrum: Spectrum) -> Floats:
    """Return `values` less their averages: multiplication by a constant commutes with any map."""
    f = real_array(name, values)
    if f.ndim != 2 or len(f) != spectrum.n or f.shape[1] == 0:
        raise InvalidInputError(
            name,
            f"have shape ({spectrum.n}, p), p >= 1 functions on the points of the spectrum",
            f.shape,
        )
    varying = f - spectrum.mass @ f / spectrum.area
    # A constant that rounding has left some noise of is still a constant.
    varying[:, spectrum.mass @ varying**2 <= 1e-24 * (spectrum.mass @ f**2)] = 0.0
    return np.asarray(varying)


def check_landmarks(
    landmarks: Landmarks, n_source: int, n_target: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the landmarks as checked indices of the source and of the target."""
    if not isinstance(landmarks, tuple) or len(landmarks) != 2:
        raise InvalidInputError(
            "landmarks",
            "be a pair (points of the source, points of the target), as a tuple",
            type(landmarks).__name__,
        )
    shapes = np.shape(landmarks[0]), np.shape(landmarks[1])
    if shapes[0] != shapes[1] or len(shapes[0]) != 1 or shapes[0] == (0,):
        raise InvalidInputError(
            "landmarks",
            "be two lists of one length, at least 1",
            f"shapes {shapes[0]} and {shapes[1]}",
            advice="pass None for no landmarks",
        )
    here = check_indices("landmarks of the source", landmarks[0], n_source)
    there = check_indices("landmarks of the target", landmarks[1], n_target)
    return here, there


def _checked_triangles(
    oriented: tuple[OrientedTriangles, OrientedTriangles] | None, n_source: int, n_target: int
) -> tuple[OrientedTriangles, OrientedTriangles]:
    if oriented is None:
        raise InvalidInputError(
            "oriented",
            "be given where the weight of the orientation is positive",
            "None",
            advice="pass oriented_triangles of both geometries",
        )
    if (counts := (oriented[0].n, oriented[1].n)) != (n_source, n_target):
        expected = f"be on the {n_source} and {n_target} points of the spectra"
        raise InvalidInputError("oriented", expected, f"{counts[0]} and {counts[1]}")
    return oriented
