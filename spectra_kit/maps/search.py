"""The search for candidates of one pair: from signs and orders of modes, turns, and landmarks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from spectra_kit._core.threads import in_threads, single_threaded_blas
from spectra_kit._core.types import Floats, Ints
from spectra_kit.features import normalize_descriptors, wave_kernel_signature
from spectra_kit.maps.candidates import bent, rigid_candidates, side_of, sign_candidates
from spectra_kit.maps.convert import induced
from spectra_kit.maps.fit import fit_functional_map
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.prepare import LOWEST_K, REFINED_K, Prepared, curvatures
from spectra_kit.maps.result import Candidate, MatchOptions
from spectra_kit.maps.score import Pairs, orientation_of, scored
from spectra_kit.maps.surface import Surface
from spectra_kit.maps.zoomout import many_zoomed

_SEEN_FROM = 12  # landmarks at most: all are fitted, but the time grows with what each sees
_LANDMARK_ENERGIES = 20  # of the wave kernel signature seen from each landmark
_SAME = 0.05  # squared difference per mode below which two maps are one
_RIGID = 8  # candidates that come of laying the source onto the target
_ENOUGH = 3  # landmarks: distances that tell a point from all others, but for symmetries
_SHORT = 0.05  # at unit area: distances from them count by their ratios, but for such short ones


def searched(
    a: Prepared,
    b: Prepared,
    mirrored: bool | None,
    options: MatchOptions,
    landmarks: Pairs | None = None,
) -> list[list[Candidate]]:
    """Return the candidates of either orientation, the best first; both have as many modes."""
    ways = (False, True) if mirrored is None and a.geometry else (bool(mirrored),)
    with single_threaded_blas():  # small products: the threads are ours
        search = Search(a, b, on_few(a, b, landmarks), options)
        found = in_threads(search.candidates, ((way,) for way in ways))
    if len(found) == 2 and found[1][0].score * options.mirrored_by < found[0][0].score:
        found.reverse()
    return found


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
        effort = {"orders": options.orders, "growing": options.growing}
        maps = list(sign_candidates(a, b, mirrored=mirrored, **effort))
        bends = curvatures(a, b) is not None  # else normals tell nothing of who is whom
        sides = (side_of(a, mirrored=mirrored), side_of(b)) if bends else None
        if sides is not None:
            turned = rigid_candidates(*sides, options.turns)
            laid = (self._scored(C, mirrored, rough=True) for C in turned)
            maps += [c.functional_map for c in distinct(laid, _SAME)[:_RIGID]]
        maps += [fit for fit in self._fits if self._mirrors(fit) == mirrored]
        grown = distinct((self._scored(C, mirrored, rough=True) for C in maps), _SAME)
        starts = [c.functional_map for c in grown[: options.finalists]]
        if sides is not None:
            refined = [bent(*sides, C) for C in starts]
            made = (self._scored(C, mirrored, alignment=distance) for C, distance in refined)
            return distinct(made, _SAME)
        k = min(REFINED_K, a.spectrum.k, b.spectrum.k)
        zoomed = on_samples(a, b, np.stack(starts), k)
        return distinct((self._scored(C, mirrored) for C in zoomed), _SAME)

    def known(self, point_map: Ints, mirrored: bool | None) -> Candidate:
        """Return what a map of all points comes to in the refined modes; unrefined."""
        a, b = self._a.spectrum, self._b.spectrum
        k = min(REFINED_K, a.k, b.k)
        C = induced(a, b, point_map, k, k)
        return self._scored(C, self._mirrors(C) if mirrored is None else mirrored)

    def _mirrors(self, C: Floats) -> bool:
        return (orientation_of(self._a, self._b, C) or 1.0) < 0

    def _fitted(self, landmarks: Pairs) -> list[Floats]:
        """Return functional maps that fit the landmarks: by what is seen from them, and how far."""
        count, every = _LANDMARK_ENERGIES, -(-len(landmarks[0]) // _SEEN_FROM)
        descriptors = []
        for side, points in zip((self._a, self._b), landmarks, strict=True):
            seen = wave_kernel_signature(side.spectrum, count=count, landmarks=points[::every])
            known = np.hstack([side.wave, seen])
            descriptors.append(normalize_descriptors(side.spectrum, known))
        source, target, k = self._a.spectrum, self._b.spectrum, LOWEST_K
        fits = [fit_functional_map(source, target, *descriptors, k=k, landmarks=landmarks)]
        if self._a.geometry and self._b.geometry and len(landmarks[0]) >= _ENOUGH:
            there = _located(self._a.surface, self._b.surface, landmarks)
            fits.append(induced(source, target, there, k, k))
        return fits

    def _scored(
        self, C: Floats, mirrored: bool, *, rough: bool = False, alignment: float | None = None
    ) -> Candidate:
        sides, known = (self._a, self._b), self._landmarks
        return scored(*sides, C, mirrored, known, rough=rough, alignment=alignment)


def on_few(a: Prepared, b: Prepared, landmarks: Pairs | None) -> Pairs | None:
    """Return landmarks of all points as those that the surfaces are matched on."""
    return None if landmarks is None else (a.closest[landmarks[0]], b.closest[landmarks[1]])


def on_samples(a: Prepared, b: Prepared, maps: Floats, k: int) -> Floats:
    """Return maps (c, j, j) refined to k modes on the samples of both, (c, k, k)."""
    rows1, rows2 = (side.spectrum.eigenvectors[side.samples, :k] for side in (a, b))
    return many_zoomed(rows1, rows2, maps, k, 6)[0]


def distinct(candidates: Iterable[Candidate], apart: float) -> list[Candidate]:
    """Return the candidates by score, without those that all but repeat a better one."""
    kept = list[Candidate]()
    for c in sorted(candidates, key=lambda c: c.score):
        if all(difference(c, other) > apart for other in kept):
            kept.append(c)
    return kept


def difference(c: Candidate, other: Candidate) -> float:
    """Return the squared difference of two maps, per mode."""
    C = c.functional_map
    return float(((C - other.functional_map) ** 2).sum() / len(C))


def _located(source: Surface, target: Surface, landmarks: Pairs) -> Ints:
    """Return the source point as far from all landmarks as each target point is, (n2,)."""
    here, there = (
        np.log(side.lengths_from(points) + _SHORT).T
        for side, points in zip((source, target), landmarks, strict=True)
    )
    return nearest(there, here)
