"""How good a map is without ground truth, as a whole and at each point."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_indices, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.calibration import confidence_at, score_of
from spectra_kit.maps.convert import check_point_map
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.prepare import Prepared, curvatures, on_matched, truncated
from spectra_kit.maps.result import Candidate, Match
from spectra_kit.maps.subsample import around
from spectra_kit.maps.surface import changed, lengths_of

Pairs = tuple[Ints, Ints]

_CURVATURES = 2  # of the smoothed ones that are scored, from the finest
_ROUGH_SAMPLES = 200
_ORIENTED = 20  # modes whose area forms tell the orientation of a map
_ROUNDS = 3  # of averaging over neighbours
_TORN = 3.0  # times as long, or as an average one: a link between samples is torn
_LEAST_TORN = 0.01  # share that right maps tear as well: less says no more
_SHORT = 0.3  # of an edge: images nearer than that are at one place


@checked
def score_map(
    source: Prepared,
    target: Prepared,
    functional_map: Floats,
    *,
    mirrored: bool = False,
    landmarks: tuple[Ints, Ints] | None = None,
    rough: bool = False,
) -> Candidate:
    """Score a map by what maps of good surfaces keep small.

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
    Candidate
        The map with its score and these mismatches, each in [0, about 1], dimensionless.
        ``embedding``: distance of the rows ``U2`` to their nearest in ``U1 C^T``, relative to their
        length; ``spacing``: ``|C diag(lambda1) - diag(lambda2) C|^2 / |lambda2|^2``, zero for
        isometries; ``wave``: relative difference of the wave kernel signatures; ``curvature``: that
        of the smoothed mean curvatures, both ways, where both surfaces bend; ``orientation``:
        (1 - t) / 2, where t, the correlation of the area forms of both surfaces' 20 lowest modes as
        the map carries them over, is 1 if it keeps the orientation and -1 if it mirrors;
        ``lengths``: that of the lengths of ways between 60 samples of either side, unless `rough`;
        ``landmarks``: biharmonic distance between where the map takes the landmarks and where they
        belong, relative to the root mean square of the source. The candidates of a `match` have an
        ``alignment`` besides, which a map does not have by itself: how far the source, bent by it
        in its lowest modes, stays from the target in positions, normals and curvature.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> animal = sk.geometry.creature(600)
    >>> a = sk.prepare(sk.spectrum(animal, 60), animal)
    >>> identity = sk.maps.score_map(a, a, np.eye(60))
    >>> print(f"{identity.score:.3f}", max(identity.mismatches.values()) < 1e-9)
    0.001 True
    """
    C = real_array("functional_map", functional_map)
    most = min(source.spectrum.k, target.spectrum.k)
    if C.ndim != 2 or C.shape[0] != C.shape[1] or not 1 <= len(C) <= most:
        raise InvalidInputError("functional_map", f"have shape (k, k), 1 <= k <= {most}", C.shape)
    if landmarks is not None:
        here, there = landmarks
        landmarks = (
            check_indices("landmarks", here, source.spectrum.n),
            check_indices("landmarks", there, target.spectrum.n),
        )
    return scored(source, target, C, mirrored, landmarks, rough=rough)


def scored(
    source: Prepared,
    target: Prepared,
    functional_map: Floats,
    mirrored: bool,
    landmarks: Pairs | None = None,
    *,
    rough: bool = False,
    alignment: float | None = None,
) -> Candidate:
    """Return a map with its mismatches and score; the `alignment` counts where it is known."""
    values = _mismatches(source, target, functional_map, landmarks, rough)
    kept = orientation_of(source, target, functional_map)
    if kept is not None:
        values["orientation"] = (1 + kept if mirrored else 1 - kept) / 2
    if alignment is not None:
        values["alignment"] = alignment
    return Candidate(
        functional_map=functional_map,
        score=score_of(values),
        mismatches=values,
        mirrored=mirrored,
    )


def _mismatches(
    source: Prepared,
    target: Prepared,
    functional_map: Floats,
    landmarks: Pairs | None,
    rough: bool,
) -> dict[str, float]:
    """Return what `score_map` tells of a map, but for its orientation."""
    a, b = source.spectrum, target.spectrum
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
        on_source, on_target = landmarks
        found = nearest(b.eigenvectors[on_target, :k], rows1)
        values["landmarks"] = _biharmonic(a, pool1[found], on_source)
    if source.geometry is not None and target.geometry is not None and not rough:
        ends1, ends2 = len(source.lengths), len(target.lengths)
        values["lengths"] = changed(source.lengths, target.lengths, back[:ends2], forth[:ends1])
    curved = curvatures(source, target)
    if curved is not None:
        curved1, curved2 = curved[0][pool1, :_CURVATURES], curved[1][pool2, :_CURVATURES]
        there_and_back = _curvature_error(curved1[back], curved2[here]) * _curvature_error(
            curved1[there], curved2[forth]
        )
        values["curvature"] = float(np.sqrt(there_and_back))
    return values


def bends_apart(source: Prepared, target: Prepared, there: Ints, back: Ints) -> float:
    """Return how little the surfaces bend alike where they meet: 1 less a correlation, 0 to 2.

    Of their finest smoothed mean curvatures, the mean of both ways: `there` is the target point
    that each source point meets, `back` the source point of each target point.
    """
    both = curvatures(source, target)
    if both is None:
        return 1.0
    (x, y), (m1, m2) = (one[:, 0] for one in both), (source.spectrum.mass, target.spectrum.mass)
    alike = (_correlation(x, y[there], m1) + _correlation(y, x[back], m2)) / 2
    return max(1 - alike, 0.0)


def _correlation(x: Floats, y: Floats, mass: Floats) -> float:
    """Return that of two functions on a surface."""
    x, y = (f - mass @ f / mass.sum() for f in (x, y))
    scale = np.sqrt((mass @ x**2) * (mass @ y**2))
    return float(mass @ (x * y) / scale) if scale else 0.0


def unlike_cost(source: Prepared, target: Prepared, candidate: Candidate) -> float:
    """Return what to choose by between unlike bodies: score, tears, and what looks alike.

    Maps that take a tail for a leg are told from right ones by two things that need no likeness
    of the bodies. Neighbouring samples of either side stay together. And a point that looks like
    another elsewhere on its own side, as left legs like right ones and a tail like no leg, has an
    image that looks as much like the image of that other.
    """
    C, k = candidate.functional_map, len(candidate.functional_map)
    rows1 = source.spectrum.eigenvectors[:, :k] @ C.T
    rows2 = target.spectrum.eigenvectors[:, :k]
    back, forth = nearest(rows2[target.samples], rows1), nearest(rows1[source.samples], rows2)
    both = _torn_and_changed(target, source, back), _torn_and_changed(source, target, forth)
    torn, altered = np.mean(both, axis=0)
    return float(candidate.score * np.sqrt(altered) * (torn + _LEAST_TORN) ** 0.25)


def _torn_and_changed(here: Prepared, there: Prepared, images: Ints) -> tuple[float, float]:
    """Return the share of links that are torn, and how far likeness within a side is altered."""
    points, wave = here.surface.points[here.samples], here.wave[here.samples]
    long, image = (lengths_of(at, here.links) for at in (points, there.surface.points[images]))
    torn = (image > _TORN * np.maximum(long, long.mean())).mean()
    looks, twins = there.wave[images], here.twins
    altered = np.abs(_differ(looks, looks[twins]) - _differ(wave, wave[twins])).mean()
    return float(torn), float(altered)


def orientation_of(source: Prepared, target: Prepared, functional_map: Floats) -> float | None:
    """Return the orientation of a map: near 1 if it keeps it, near -1 for a mirror image.

    The correlation of the area forms ``T[a, b, c] = integral of u_a du_b ^ du_c`` of the target's
    20 lowest modes with those of the source's, carried over by the map. None without geometries.
    """
    if source.geometry is None or target.geometry is None:
        return None
    form1, form2 = source.form, target.form
    m = min(_ORIENTED, len(functional_map), len(form1), len(form2))
    C = functional_map[:m, :m]
    carried = np.einsum("ia,jb,kc,abc->ijk", C, C, C, form1[:m, :m, :m], optimize=True)
    form = form2[:m, :m, :m]
    return float(np.vdot(carried, form) / (np.linalg.norm(carried) * np.linalg.norm(form)))


def coverage_over_chance(source_mass: Floats, target_mass: Floats, point_map: Ints) -> float:
    """Return the area that a map reaches, over what as many random points would reach."""
    source, target = source_mass / source_mass.sum(), target_mass / target_mass.sum()
    thrown = min(1 / (target @ target), 1 / (source @ source))
    chance = float(source @ -np.expm1(-thrown * source))
    return float(source[np.unique(point_map)].sum()) / chance


@checked
def local_confidence(found: Match, source: Prepared, target: Prepared) -> Floats:
    """Return how likely each target point is mapped to the right place.

    Parameters
    ----------
    found : Match
        From `match` of these two; of a part no confidence is known.
    source, target : Prepared
        With their geometries.

    Returns
    -------
    ndarray of shape (n2,)
        In [0, 1]: how likely the image is within 8 hundredths of the root of the source's area.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> animal = sk.geometry.creature(600)
    >>> a = sk.prepare(sk.spectrum(animal, 60), animal)
    >>> sure = sk.maps.local_confidence(sk.match(a, a, mirrored=False), a, a)
    >>> sure.shape, bool(sure.mean() > 0.8)
    ((600,), True)
    """
    for name, side in (("source", source), ("target", target)):
        if side.geometry is None:
            raise InvalidInputError(name, "come with its geometry", repr(side))
    if found.covered is not None:
        raise InvalidInputError(
            "found", "map wholes", "a part", advice="`covered` is all that is known of its points"
        )
    seen = seen_at_points(found, source, target)
    return confidence_at(found.confidence, *seen.T)[target.closest]


def seen_at_points(found: Match, source: Prepared, target: Prepared) -> Floats:
    """Return how far signatures and curvatures differ, and how stretched edges are, (n, 3).

    Averaged over neighbours, at the points that the target is matched on.
    """
    p = check_point_map("found", found.point_map, source.whole.n, target.whole.n)
    p = on_matched(source, target, p)
    k = min(source.spectrum.k, target.spectrum.k)
    here, there = truncated(source, k), truncated(target, k)
    points, n, edges = there.surface.points, there.spectrum.n, there.surface.edges
    long = lengths_of(points, edges)
    image = lengths_of(here.surface.points, p[edges])
    bent = np.abs(np.log((image + _SHORT * long) / ((1 + _SHORT) * long)))
    ends = np.bincount(edges.ravel(), minlength=n)
    stretch = np.bincount(edges.ravel(), np.repeat(bent, 2), n) / np.maximum(ends, 1)
    wave1, wave2 = here.wave[p], there.wave
    wave = (np.abs(wave1 - wave2) / (wave1 + wave2 + 1e-300)).mean(axis=1)
    curvature = np.abs(here.curvature[p] - there.curvature).mean(axis=1)
    near = around(there.surface.oriented.faces, n)
    mean = sparse.diags_array(1 / np.asarray(near.sum(axis=1)).ravel()) @ near
    seen = np.column_stack([wave, curvature, stretch])
    for _ in range(_ROUNDS):
        seen = mean @ seen
    return np.asarray(seen)


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
    return float(_differ(x, y).mean())


def _differ(x: Floats, y: Floats) -> Floats:
    """Return the same of each row."""
    return np.asarray((np.abs(x - y) / (x + y + 1e-300)).mean(axis=1))


def _curvature_error(x: Floats, y: Floats) -> float:
    """Return the mean difference, relative to the mean size, averaged over columns."""
    return float((np.abs(x - y).mean(axis=0) / np.abs(y).mean(axis=0)).mean())
