"""How good a candidate map is, without ground truth."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_indices, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.checks import check_point_map
from spectra_kit.maps.lengths import changed
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.options import DEFAULT, MatchOptions
from spectra_kit.maps.prepare import Prepared, curvatures
from spectra_kit.maps.result import Candidate

_CURVATURES = 2  # of the smoothed ones that are scored, from the finest
_ROUGH_SAMPLES = 200
_LEAST = 1e-3  # below which mismatches count as equally good


@checked
def mismatches(
    source: Prepared,
    target: Prepared,
    functional_map: Floats,
    *,
    mirrored: bool = False,
    landmarks: tuple[Ints, Ints] | None = None,
    rough: bool = False,
) -> dict[str, float]:
    """Return what a map of good surfaces keeps small, each in [0, about 1], dimensionless.

    Parameters
    ----------
    source, target : Prepared
        The surfaces.
    functional_map : ndarray of shape (k, k)
        Of source to target.
    mirrored : bool, default False
        Whether it is meant to mirror.
    landmarks : (ndarray of shape (l,), ndarray of shape (l,)), optional
        Source and target points known to correspond.
    rough : bool, default False
        Look for the images of 200 samples among the samples only; else those of all samples among
        all points.

    Returns
    -------
    dict of str to float
        ``embedding``: distance of the rows ``U2`` to their nearest in ``U1 C^T``, relative to their
        length; ``spacing``: ``|C diag(lambda1) - diag(lambda2) C|^2 / |lambda2|^2``, zero for
        isometries; ``wave``: relative difference of the wave kernel signatures; ``curvature``: that
        of the smoothed mean curvatures, both ways, where both surfaces bend; ``orientation``:
        (1 - t) / 2 with the orientation t of `orientation_of`; ``lengths``: that of the lengths of
        ways between 60 samples of either side, unless `rough`; ``landmarks``: biharmonic distance
        between where the map takes the landmarks and where they belong, relative to the root mean
        square of the source. The candidates of a `match` have an ``alignment`` besides, which a map
        does not have by itself: how far the source, bent by it in its lowest modes, stays from the
        target in positions, normals and curvature.

    Raises
    ------
    InvalidInputError
        If the map is not square, has more rows than either surface has modes or is not finite, or a
        landmark is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> animal = sk.geometry.creature(600)
    >>> a = sk.prepare(sk.spectrum(animal, 60), animal)
    >>> identity = sk.maps.mismatches(a, a, np.eye(60))
    >>> max(identity.values()) < 1e-9
    True
    """
    a, b = source.spectrum, target.spectrum
    functional_map = _square(functional_map, source, target)
    k, few = len(functional_map), _ROUGH_SAMPLES
    every1, every2 = np.arange(a.n), np.arange(b.n)
    pool1, pool2 = (source.samples, target.samples) if rough else (every1, every2)
    there, here = (every1[:few], every2[:few]) if rough else (source.samples, target.samples)
    rows1 = a.eigenvectors[pool1, :k] @ functional_map.T
    rows2 = b.eigenvectors[pool2, :k]
    back, forth = nearest(rows2[here], rows1), nearest(rows1[there], rows2)
    wave1, wave2 = source.wave[pool1], target.wave[pool2]
    waves = _relative(wave1[back], wave2[here]) + _relative(wave1[there], wave2[forth])
    values = {
        "embedding": float(np.linalg.norm(rows2[here] - rows1[back]) / np.linalg.norm(rows2[here])),
        "spacing": _spacing_error(functional_map, a.eigenvalues[:k], b.eigenvalues[:k]),
        "wave": waves / 2,
    }
    if landmarks is not None:
        on_source, on_target = (
            check_indices("landmarks", points, spectrum.n)
            for points, spectrum in zip(landmarks, (a, b), strict=True)
        )
        found = nearest(b.eigenvectors[on_target, :k], rows1)
        values["landmarks"] = _biharmonic(a, pool1[found], on_source)
    if source.surface is not None and target.surface is not None and not rough:
        ends1, ends2 = len(source.surface.lengths), len(target.surface.lengths)
        values["lengths"] = changed(
            source.surface.lengths, target.surface.lengths, back[:ends2], forth[:ends1]
        )
    curved = curvatures(source, target)
    if curved is not None:
        curved1, curved2 = curved[0][pool1, :_CURVATURES], curved[1][pool2, :_CURVATURES]
        there_and_back = _curvature_error(curved1[back], curved2[here]) * _curvature_error(
            curved1[there], curved2[forth]
        )
        values["curvature"] = float(np.sqrt(there_and_back))
    kept = orientation_of(source, target, functional_map)
    if kept is not None:
        values["orientation"] = (1 + kept if mirrored else 1 - kept) / 2
    return values


@checked
def score_of(values: dict[str, float], *, options: MatchOptions = DEFAULT) -> float:
    """Return the weighted geometric mean of `mismatches`: the lower, the better.

    Parameters
    ----------
    values : dict of str to float
        Of `mismatches`.
    options : MatchOptions
        Whose weights count.

    Returns
    -------
    float
        Dimensionless, at least 0.001: mismatches below that count as equally good.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> print(sk.maps.score_of({"curvature": 0.5, "wave": 0.1}))
    0.476
    """
    weights = asdict(options.weights)
    if not values or not set(values) <= set(weights):
        expected = f"hold some of {sorted(weights)}, as `mismatches` returns them"
        raise InvalidInputError("values", expected, sorted(values))
    total = sum(weights[name] for name in values)
    logs = sum(weights[name] * np.log(max(value, 0.0) + _LEAST) for name, value in values.items())
    return float(np.exp(logs / total))


def scored(
    source: Prepared,
    target: Prepared,
    functional_map: Floats,
    *,
    mirrored: bool,
    landmarks: tuple[Ints, Ints] | None = None,
    rough: bool = False,
    alignment: float | None = None,
    options: MatchOptions,
) -> Candidate:
    """Return a map with its mismatches and score; the `alignment` counts where it is known."""
    values = mismatches(
        *(source, target, functional_map),
        mirrored=mirrored,
        landmarks=landmarks,
        rough=rough,
    )
    if alignment is not None:
        values["alignment"] = alignment
    score = score_of(values, options=options)
    return Candidate(
        functional_map=functional_map, score=score, mismatches=values, mirrored=mirrored
    )


@checked
def orientation_of(source: Prepared, target: Prepared, functional_map: Floats) -> float | None:
    """Return the orientation of a map: near 1 if it keeps it, near -1 for a mirror image.

    Parameters
    ----------
    source, target : Prepared
        The surfaces.
    functional_map : ndarray of shape (k, k)
        Of source to target.

    Returns
    -------
    float or None
        None without both geometries.

    Notes
    -----
    The correlation of the area forms ``T[a, b, c] = integral of u_a du_b ^ du_c`` of the target's
    20 lowest modes with those of the source's, carried over by the map.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> from spectra_kit.geometry import creature, mirrored
    >>> from spectra_kit.maps import orientation_of, prepare
    >>> animal = sk.geometry.creature(600)
    >>> spectrum = sk.spectrum(animal, 30)
    >>> a, b = prepare(spectrum, animal), prepare(spectrum, mirrored(animal))
    >>> print(orientation_of(a, a, np.eye(30)), orientation_of(a, b, np.eye(30)))
    1.0 -1.0
    """
    functional_map = _square(functional_map, source, target)
    if source.surface is None or target.surface is None:
        return None
    form1, form2 = source.surface.form, target.surface.form
    m = min(20, len(functional_map), len(form1), len(form2))
    C = functional_map[:m, :m]
    carried = np.einsum("ia,jb,kc,abc->ijk", C, C, C, form1[:m, :m, :m], optimize=True)
    form = form2[:m, :m, :m]
    return float(np.vdot(carried, form) / (np.linalg.norm(carried) * np.linalg.norm(form)))


@checked
def coverage_over_chance(source: Spectrum, target: Spectrum, point_map: Ints) -> float:
    """Return the area that a map reaches, over what as many random points would reach.

    Parameters
    ----------
    source, target : Spectrum
        Of the surfaces, in any units.
    point_map : ndarray of shape (n2,)
        Source point of each target point.

    Returns
    -------
    float
        Above 1 for maps that spread the target over the source.

    Notes
    -----
    Of N points thrown at an area of 1, a share ``1 - exp(-N m)`` of the vertices with area m is
    hit. Target points that crowd in one place count as the ``1 / sum(m^2)`` that they amount to,
    and as no more than the source's, all of which many more would hit.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit import eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.maps import coverage_over_chance
    >>> ball = eigensolve(robust_laplacian(sphere(subdivisions=3).geometry), 4)
    >>> every, one = np.arange(ball.n), np.zeros(ball.n, dtype=int)
    >>> print(coverage_over_chance(ball, ball, every), coverage_over_chance(ball, ball, one))
    1.58 0.00
    """
    point_map = check_point_map("point_map", point_map, source.n, target.n)
    share1, share2 = source.mass / source.area, target.mass / target.area
    thrown = min(1 / (share2 @ share2), 1 / (share1 @ share1))
    chance = float(share1 @ -np.expm1(-thrown * share1))
    return float(share1[np.unique(point_map)].sum()) / chance


def _square(functional_map: Floats, source: Prepared, target: Prepared) -> Floats:
    """Return the map as a finite array of shape (k, k), k within the modes of both."""
    array = real_array("functional_map", functional_map)
    most = min(source.spectrum.k, target.spectrum.k)
    if array.ndim != 2 or array.shape[0] != array.shape[1] or not 1 <= len(array) <= most:
        raise InvalidInputError(
            "functional_map", f"have shape (k, k), 1 <= k <= {most}", array.shape
        )
    return array


def _biharmonic(spectrum: Spectrum, found: Ints, wanted: Ints) -> float:
    """Return the root mean square distance of pairs of points, relative to that of all points."""
    nonzero = spectrum.nonzero()
    embedding = nonzero.eigenvectors / nonzero.eigenvalues
    apart = ((embedding[found] - embedding[wanted]) ** 2).sum(axis=1).mean()
    return float(np.sqrt(apart / (2 * (spectrum.mass @ embedding**2).sum())))


def _spacing_error(C: Floats, values1: Floats, values2: Floats) -> float:
    """Return how far `C` is from commuting with the Laplacians."""
    gaps = C * (values1[None] - values2[:, None])
    return float((gaps**2).sum() / (values2**2).sum())


def _relative(x: Floats, y: Floats) -> float:
    """Return the mean of |x - y| / (x + y) of positive quantities."""
    return float((np.abs(x - y) / (x + y + 1e-300)).mean())


def _curvature_error(x: Floats, y: Floats) -> float:
    """Return the mean difference, relative to the mean size, averaged over columns."""
    return float((np.abs(x - y).mean(axis=0) / np.abs(y).mean(axis=0)).mean())
