"""`match`: a map between two surfaces that is not flipped, and how sure that is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.threads import in_threads, single_threaded_blas
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, quantity, warn
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.features import normalize_descriptors, wave_kernel_signature
from spectra_kit.geometry import Geometry
from spectra_kit.maps.alignment import bent, placed_candidates, side_of
from spectra_kit.maps.candidates import sign_candidates
from spectra_kit.maps.checks import check_point_map
from spectra_kit.maps.convert import Correspondence, functional_map_from_point_map
from spectra_kit.maps.elastic import meeting
from spectra_kit.maps.everywhere import (
    all_placed,
    by_bending,
    by_modes,
    on_matched,
)
from spectra_kit.maps.fit import Landmarks, check_landmarks, fit_functional_map
from spectra_kit.maps.landmarks import ENOUGH, Pairs, kept, left_by, located
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.options import DEFAULT, MatchOptions
from spectra_kit.maps.precise import into_triangles
from spectra_kit.maps.prepare import (
    CURVATURE_SCALE,
    LOWEST_K,
    REFINED_K,
    Prepared,
    curvatures,
    prepare,
)
from spectra_kit.maps.refine import bijective_zoomout
from spectra_kit.maps.result import Candidate, Match
from spectra_kit.maps.score import (
    coverage_over_chance,
    orientation_of,
    scored,
)
from spectra_kit.maps.tears import torn
from spectra_kit.maps.topology import clustered, compared
from spectra_kit.maps.zoomout import zoomout_many

_SEEN_FROM = 12  # landmarks at most: all are fitted, but the time grows with what each sees
_LANDMARK_ENERGIES = 20  # of the wave kernel signature seen from each landmark
_SAME = 0.05  # squared difference per mode below which two maps are one
_RIVAL = 0.15  # the same, below which one is no rival of the other
_CONTEST = 1.15  # candidates whose scores are within that factor of the best are bent as well
_CONTENDERS = 4  # how many at most, the best among them
_LAST_STEPS = 3  # from the refined modes to the end


@checked
def match(
    source: Prepared | Spectrum,
    target: Prepared | Spectrum,
    *,
    source_geometry: Geometry | None = None,
    target_geometry: Geometry | None = None,
    landmarks: Landmarks | None = None,
    initial: ArrayLike | None = None,
    mirrored: bool | None = None,
    k: int = 150,
    elastic: bool = True,
    precise: bool = False,
    options: MatchOptions = DEFAULT,
) -> Match:
    """Find which point of the source corresponds to each point of the target.

    Parameters
    ----------
    source, target : Prepared or Spectrum
        Connected surfaces, in any units; a `Prepared` one saves time over many pairs.
    source_geometry, target_geometry : TriangleMesh or PointCloud, optional
        Of a `Spectrum`: the surface, for its sides and its curvature. Without them the match may
        be flipped, and its `orientation` is None.
    landmarks : (array_like of shape (l,), array_like of shape (l,)), optional
        Source and target points known to correspond. They make one more candidate, or two from
        three on, and count in the scores. What the map takes near to where it belongs is set right;
        the others are told: see `Match.landmark_distances`.
    initial : array_like of shape (n2,), optional
        The source point of each target point, as far as it is known: of surfaces that are aligned
        or tracked, the nearest one. Nothing else is searched for; it is refined.
    mirrored : bool, optional
        Whether maps turn the surface over. Both are tried without it, and those that do not are
        preferred, unless a mirrored one is 3 times better: as a mirrored copy is, but not one
        that is bent as well and looks much like its mirror image. Say so where it is known.
    k : int, default 150
        Modes to end with; fewer where a spectrum has fewer. Of the longer one the modes beyond
        the shorter are left out, as descriptors depend on all modes.
    elastic : bool, default True
        Whether to bend the source onto the target in the end, where both geometries are given.
    precise : bool, default False
        Whether to find where on the triangles of the source each target point lies as well: needs
        both geometries.
    options : MatchOptions
        What is tried and believed.

    Returns
    -------
    Match
        The point map, the functional map, and how sure they are.

    Raises
    ------
    InvalidInputError
        If a spectrum has fewer than 30 modes, no constant mode or several components, `k` is below
        30, `mirrored` or `precise` is given without both geometries, landmarks are empty, unpaired
        or out of range, or `initial` is no map of all target points to source points.

    Warns
    -----
    DoubtfulMatchWarning
        If the map is not `Match.convincing`, or does not keep the landmarks.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> animal = sk.geometry.creature(600)
    >>> image = sk.geometry.mirrored(animal)
    >>> a, b = (sk.prepare(sk.spectrum(m, 60), m) for m in (animal, image))
    >>> found = sk.match(a, b)
    >>> found.mirrored, bool((found.point_map == np.arange(600)).all())
    (True, True)
    """
    a = _prepared("source", source, source_geometry)
    b = _prepared("target", target, target_geometry)
    k = min(check_count("k", k, low=LOWEST_K), a.spectrum.k, b.spectrum.k)
    seen = a.surface is not None
    if seen != (b.surface is not None):
        raise InvalidInputError(
            "source",
            "come with its geometry as `target` does, or both without",
            f"only that of the {'source' if seen else 'target'}",
            advice="pass the other one, too",
        )
    if mirrored is not None and not seen:
        raise InvalidInputError(
            "mirrored",
            "be None without both geometries",
            mirrored,
            advice="pass source_geometry and target_geometry",
        )
    if precise and not seen:
        raise InvalidInputError(
            "precise",
            "be False without both geometries",
            precise,
            advice="pass source_geometry and target_geometry",
        )
    ways = (False, True) if mirrored is None and seen else (bool(mirrored),)
    known = None if landmarks is None else check_landmarks(landmarks, a.whole.n, b.whole.n)
    if initial is not None:
        initial = check_point_map("initial", initial, a.whole.n, b.whole.n)
    fewer = min(a.spectrum.k, b.spectrum.k)
    a, b = a.truncate(fewer), b.truncate(fewer)
    pairs = None if known is None else _matched_on(known, a, b)
    with single_threaded_blas():  # small products: the threads are ours
        search = Search(a, b, pairs, options)
        if initial is None:
            found = in_threads(search.candidates, ((way,) for way in ways))
        else:
            found = [[search.known(on_matched(a, b, initial), mirrored)]]
        if len(found) == 2 and found[1][0].score * options.mirrored_by < found[0][0].score:
            found.reverse()
        return matched_from(
            *(a, b, found),
            k=k,
            elastic=elastic,
            options=options,
            precise=precise,
            landmarks=known,
        )


def matched_from(
    a: Prepared,
    b: Prepared,
    found: Sequence[Sequence[Candidate]],
    *,
    k: int,
    elastic: bool,
    options: MatchOptions,
    precise: bool = False,
    landmarks: Pairs | None = None,
) -> Match:
    """Refine one of the first candidates found, those of either orientation; the best first."""
    k = min(k, a.spectrum.k, b.spectrum.k)
    wholes = None if a.surface is None or b.surface is None else (all_placed(a), all_placed(b))
    apart, lost_from = None, np.inf
    with single_threaded_blas():
        chosen = _settled(a, b, found[0], options)
        point_map, on_faces = _refined(a, b, chosen, k, elastic, options, precise)
        if landmarks is not None and wholes is not None:
            apart, lost_from = left_by(wholes[0], point_map, landmarks)
            point_map, on_faces = kept(point_map, on_faces, landmarks, apart <= lost_from)
        functional_map = functional_map_from_point_map(a.whole, b.whole, point_map, k=k)
    matched = on_matched(a, b, point_map)
    seen = None if a.surface is None or b.surface is None else (a.surface, b.surface)
    opposite = [c.score for c in found[-1]] if len(found) == 2 else []
    rivals = [c.score for c in found[0] if _apart(c, chosen) > _RIVAL]
    others = [c for way in found for c in way if c is not chosen]
    result = Match(
        point_map=point_map,
        functional_map=functional_map,
        mirrored=chosen.mirrored,
        orientation=orientation_of(a, b, functional_map),
        margin=min(rivals) / chosen.score if rivals else float("inf"),
        mirror_margin=min(opposite) / chosen.score if opposite else float("inf"),
        consistent=min(
            1.0 if side.surface is None else side.surface.oriented.consistent for side in (a, b)
        ),
        coverage=coverage_over_chance(a.spectrum, b.spectrum, matched),
        torn=None if seen is None else torn(*seen, matched),
        candidates=(chosen, *others),
        precise=on_faces,
        options=options,
        clustered=max(clustered(side.spectrum.eigenvalues) for side in (a, b)),
        **({} if wholes is None else compared(*wholes)),
        landmark_distances=apart,
        lost_from=lost_from,
    )
    told_of(result)
    return result


def told_of(found: Match) -> None:
    """Warn of a match that does not convince, or keep its landmarks."""
    held = found.landmarks_held
    lost = ""
    if held is not None and not held.all():
        assert found.landmark_distances is not None
        lost = (
            f"{(~held).sum()} of {quantity(len(held), 'landmark')} are lost: the map leads"
            f" {found.landmark_distances.max():.2g} times the root of the area away from them (at"
            f" most {found.lost_from:.2g} is exact enough)"
        )
    if found.convincing and not lost:
        return
    doubts = [doubt for doubt in found.doubts if not (lost and doubt == "landmark_distances")]
    against = "; ".join(filter(None, (", ".join(doubts), lost))) or "nothing alone"
    convincing = "a map in doubt" if found.convincing else "no convincing map"
    told = f"{convincing}: its confidence is {found.confidence:.2f}; what speaks against it: "
    if lost:
        advice = "look there: the map may be wrong, or these contradict each other"
        warn(told + against, DoubtfulMatchWarning, advice=advice)
        return
    warn(
        told + against,
        DoubtfulMatchWarning,
        advice="the surfaces may not correspond; look at the map, give {}, or try another"
        " {} (150 match best)",
        remedies=("landmarks", "k"),
    )


def _settled(
    a: Prepared, b: Prepared, candidates: Sequence[Candidate], options: MatchOptions
) -> Candidate:
    """Return the best candidate; where bodies of one kind meet, by how near the bent source comes.

    Of one body in two poses modes can hardly tell the front from the back, but the right map brings
    the source down onto the target, to the spacing of its points. Of two species no map does, and
    how near one comes tells nothing.
    """
    best, *others = candidates
    rivals = [c for c in others if c.score <= _CONTEST * best.score]
    close = _distinct([best, *rivals], _RIVAL)[:_CONTENDERS]
    if len(close) == 1 or a.surface is None or b.surface is None:
        return best
    gaps = [_left(a, b, c, options) for c in close]
    spacing = 1 / np.sqrt(min(a.spectrum.n, b.spectrum.n))  # at unit area
    if min(gaps) > spacing:
        return best
    costs = [c.score * gap**2 for c, gap in zip(close, gaps, strict=True)]
    return close[int(np.argmin(costs))]


def _left(a: Prepared, b: Prepared, candidate: Candidate, options: MatchOptions) -> float:
    """Return the distance to the target that is left once the source is bent by a candidate."""
    C = candidate.functional_map
    rows1, rows2 = a.spectrum.eigenvectors[:, : len(C)] @ C.T, b.spectrum.eigenvectors[:, : len(C)]
    there = nearest(rows1, rows2)
    assert a.surface is not None
    assert b.surface is not None
    mirrored = candidate.mirrored
    return meeting(a.surface, b.surface, there, mirrored=mirrored, options=options).gap


def _distinct(candidates: Iterable[Candidate], apart: float) -> list[Candidate]:
    """Return the candidates by score, without those that all but repeat a better one."""
    kept: list[Candidate] = []
    for c in sorted(candidates, key=lambda c: c.score):
        if all(_apart(c, other) > apart for other in kept):
            kept.append(c)
    return kept


def _matched_on(landmarks: Pairs, a: Prepared, b: Prepared) -> Pairs:
    """Return landmarks, or on dense surfaces the points that stand for them."""
    one, other = landmarks
    if a.dense is not None:
        one = a.dense.closest[one]
    if b.dense is not None:
        other = b.dense.closest[other]
    return one, other


def _refined(
    a: Prepared,
    b: Prepared,
    chosen: Candidate,
    k: int,
    elastic: bool,
    options: MatchOptions,
    precise: bool = False,
) -> tuple[Ints, sparse.csr_array | None]:
    """Return the map of all points that a candidate is refined to, and the one into triangles."""
    start = _sharpened(a, b, chosen.functional_map[:k, :k])
    if not elastic or a.surface is None or b.surface is None:
        point_map, here, there = by_modes(a, b, _zoomed(a, b, start, k)[0])
    else:
        _, way_there = spectral_map(a, b, start, k)
        mirrored = chosen.mirrored
        point_map, here, there = by_bending(a, b, way_there, mirrored=mirrored, options=options)
    faces = all_placed(a).oriented.faces if precise else None
    on_faces = None if faces is None else into_triangles(there, here, faces, point_map)
    return point_map, on_faces


def _sharpened(a: Prepared, b: Prepared, functional_map: Floats) -> Floats:
    """Return a map of bent surfaces with all but its lowest modes found anew, by modes alone.

    Positions hold a map together while it is searched for; hands and feet, whose poses differ, come
    out sharper without them.
    """
    low, k = LOWEST_K, len(functional_map)
    if a.surface is None or b.surface is None or k <= low:
        return functional_map
    rows1, rows2 = a.spectrum.eigenvectors[a.samples, :k], b.spectrum.eigenvectors[b.samples, :k]
    start = functional_map[None, :low, :low]
    maps, _ = zoomout_many(rows1, rows2, start, k_final=k, step=6)
    sharp: Floats = maps[0]
    return sharp


def spectral_map(a: Prepared, b: Prepared, start: Floats, k: int) -> tuple[Correspondence, Ints]:
    """Refine a functional map to k modes; return also the target point of each source point."""
    found, features = _zoomed(a, b, start, k)
    rows1 = a.spectrum.eigenvectors[:, :k] @ found.functional_map.T
    rows2 = b.spectrum.eigenvectors[:, :k]
    if features is not None:
        rows1, rows2 = np.hstack([rows1, features[0]]), np.hstack([rows2, features[1]])
    return found, nearest(rows1, rows2)


def _zoomed(
    a: Prepared, b: Prepared, start: Floats, k: int
) -> tuple[Correspondence, tuple[Floats, Floats] | None]:
    """Refine a functional map to k modes; return also what joined them."""
    step = -(-(k - len(start)) // _LAST_STEPS)
    curved = curvatures(a, b)
    features = curved and (CURVATURE_SCALE * curved[0], CURVATURE_SCALE * curved[1])
    found = bijective_zoomout(
        a.spectrum, b.spectrum, start, k_final=k, step=max(step, 1), features=features
    )
    return found, features


class Search:
    """The search for candidates of one pair."""

    def __init__(
        self, a: Prepared, b: Prepared, landmarks: Pairs | None, options: MatchOptions
    ) -> None:
        self._a, self._b, self._landmarks, self._options = a, b, landmarks, options
        self._fits = [] if landmarks is None else self._fitted(landmarks)

    def candidates(self, mirrored: bool) -> list[Candidate]:
        """Return the refined candidates that mirror, or those that do not; the best first."""
        a, b, options = self._a, self._b, self._options
        maps = list(sign_candidates(a, b, mirrored=mirrored, options=options))
        bends = curvatures(a, b) is not None  # else normals tell nothing of who is whom
        sides = (side_of(a, mirrored=mirrored), side_of(b)) if bends else None
        if sides is not None:
            placed = (
                self._scored(C, mirrored, rough=True)
                for C in placed_candidates(*sides, options.turns)
            )
            maps += [c.functional_map for c in _distinct(placed, _SAME)[: options.placed]]
        maps += [fit for fit in self._fits if self._mirrors(fit) == mirrored]
        rough = (self._scored(C, mirrored, rough=True) for C in maps)
        grown = _distinct(rough, _SAME)
        starts = [c.functional_map for c in grown[: options.finalists]]
        if sides is not None:
            refined = [bent(*sides, C) for C in starts]
            return _distinct(
                (
                    self._scored(one.functional_map, mirrored, alignment=one.distance)
                    for one in refined
                ),
                _SAME,
            )
        k = min(REFINED_K, a.spectrum.k, b.spectrum.k)
        rows1, rows2 = (
            a.spectrum.eigenvectors[a.samples, :k],
            b.spectrum.eigenvectors[b.samples, :k],
        )
        maps_, _ = zoomout_many(rows1, rows2, np.stack(starts), k_final=k, step=6)
        return _distinct((self._scored(C, mirrored) for C in maps_), _SAME)

    def known(self, point_map: Ints, mirrored: bool | None) -> Candidate:
        """Return what a map of all points comes to in the refined modes; unrefined."""
        a, b = self._a.spectrum, self._b.spectrum
        C = functional_map_from_point_map(a, b, point_map, k=min(REFINED_K, a.k, b.k))
        return self._scored(C, self._mirrors(C) if mirrored is None else mirrored)

    def _mirrors(self, C: Floats) -> bool:
        return (orientation_of(self._a, self._b, C) or 1.0) < 0

    def _fitted(self, landmarks: Pairs) -> list[Floats]:
        """Return functional maps that fit the landmarks: by what is seen from them, and how far."""
        count, every = _LANDMARK_ENERGIES, -(-len(landmarks[0]) // _SEEN_FROM)
        f, g = (
            normalize_descriptors(
                side.spectrum,
                np.hstack(
                    [
                        side.wave,
                        wave_kernel_signature(
                            side.spectrum, count=count, landmarks=points[::every]
                        ),
                    ]
                ),
            )
            for side, points in zip((self._a, self._b), landmarks, strict=True)
        )
        source, target, k = self._a.spectrum, self._b.spectrum, LOWEST_K
        fits = [fit_functional_map(source, target, f, g, k=k, landmarks=landmarks)]
        one, other = self._a.surface, self._b.surface
        if one is not None and other is not None and len(landmarks[0]) >= ENOUGH:
            there = located(one, other, landmarks)
            fits.append(functional_map_from_point_map(source, target, there, k=k))
        return fits

    def _scored(
        self, C: Floats, mirrored: bool, *, rough: bool = False, alignment: float | None = None
    ) -> Candidate:
        return scored(
            *(self._a, self._b, C),
            mirrored=mirrored,
            landmarks=self._landmarks,
            rough=rough,
            alignment=alignment,
            options=self._options,
        )


def _apart(c: Candidate, other: Candidate) -> float:
    """Return the squared difference of two maps, per mode."""
    C = c.functional_map
    return float(((C - other.functional_map) ** 2).sum() / len(C))


def _prepared(name: str, side: Prepared | Spectrum, geometry: Geometry | None) -> Prepared:
    if isinstance(side, Prepared):
        if geometry is not None:
            raise InvalidInputError(
                f"{name}_geometry",
                "be left out for a prepared surface",
                "one",
                advice="pass it to prepare",
            )
        return side
    return prepare(side, geometry)
