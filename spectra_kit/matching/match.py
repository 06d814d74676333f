"""`match`: a map between two surfaces that is not flipped, and how sure that is."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._types import Floats, Ints
from spectra_kit._validate import check_count, warn
from spectra_kit.descriptors import landmark_wave_kernel_signature, normalize_descriptors
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.functional_maps import (
    Correspondence,
    bijective_zoomout,
    fit_functional_map,
    functional_map_from_point_map,
    zoomout_many,
)
from spectra_kit.functional_maps.fit import Landmarks, check_landmarks
from spectra_kit.functional_maps.nearest import nearest
from spectra_kit.geometry import Geometry
from spectra_kit.linalg.threads import in_threads, single_threaded_blas
from spectra_kit.matching.candidates import sign_candidates
from spectra_kit.matching.elastic import elastic_point_map
from spectra_kit.matching.options import DEFAULT, MatchOptions
from spectra_kit.matching.prepare import LOWEST_K, Prepared, curvatures, prepare
from spectra_kit.matching.result import Candidate, Match
from spectra_kit.matching.score import (
    coverage_over_chance,
    mismatches,
    orientation_of,
    score_of,
)
from spectra_kit.spectra import Spectrum

Pairs = tuple[Ints, Ints]


@checked
def match(
    source: Prepared | Spectrum,
    target: Prepared | Spectrum,
    *,
    source_geometry: Geometry | None = None,
    target_geometry: Geometry | None = None,
    landmarks: Landmarks | None = None,
    mirrored: bool | None = None,
    k: int = 150,
    elastic: bool = True,
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
        Source and target points known to correspond. They make one more candidate and count in
        the scores; the final map is free to leave them by a little.
    mirrored : bool, optional
        Whether maps turn the surface over. Both are tried without it, and those that do not are
        preferred, unless a mirrored one is 1.5 times better: as a mirrored copy is, but not one
        that is bent as well and looks much like its mirror image. Say so where it is known.
    k : int, default 150
        Modes to end with; fewer where a spectrum has fewer. Of the longer one the modes beyond
        the shorter are left out, as descriptors depend on all modes.
    elastic : bool, default True
        Whether to bend the source onto the target in the end, where both geometries are given.
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
        30, `mirrored` is given without both geometries, or landmarks are empty, unpaired or out of
        range.

    Warns
    -----
    DoubtfulMatchWarning
        If the map is not `Match.convincing`.

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
    ways = (False, True) if mirrored is None and seen else (bool(mirrored),)
    pairs = None if landmarks is None else check_landmarks(landmarks, a.spectrum.n, b.spectrum.n)
    fewer = min(a.spectrum.k, b.spectrum.k)
    a, b = a.truncate(fewer), b.truncate(fewer)
    with single_threaded_blas():  # small products: the threads are ours
        search = _Search(a, b, pairs, options)
        found = in_threads(search.candidates, ((way,) for way in ways))
        if len(found) == 2 and found[1][0].score * options.mirrored_by < found[0][0].score:
            found.reverse()
        chosen = found[0][0]
        point_map, functional_map = _refined(a, b, chosen, k, elastic, options)
    opposite = [c.score for c in found[-1]] if len(found) == 2 else []
    rivals = [c.score for c in found[0][1:] if _apart(c, chosen) > options.rival]
    made = Match(
        point_map=point_map,
        functional_map=functional_map,
        mirrored=chosen.mirrored,
        orientation=orientation_of(a, b, functional_map),
        margin=min(rivals) / chosen.score if rivals else float("inf"),
        mirror_margin=min(opposite) / chosen.score if opposite else float("inf"),
        consistent=min(
            1.0 if side.surface is None else side.surface.oriented.consistent for side in (a, b)
        ),
        coverage=coverage_over_chance(a.spectrum, b.spectrum, point_map),
        candidates=tuple(c for way in found for c in way),
        options=options,
    )
    if not made.convincing:
        warn(
            f"no convincing map: its mismatch is {made.score:.2f} (right maps: below"
            f" {options.convincing_score:g}), and it covers {made.coverage:.2f} times as much as"
            f" chance would (right maps: {options.convincing_coverage:g} and more)",
            DoubtfulMatchWarning,
            advice="the surfaces may not correspond; look at the map, give {}, or try another"
            " {} (150 match best)",
            remedies=("landmarks", "k"),
        )
    return made


def _refined(
    a: Prepared, b: Prepared, chosen: Candidate, k: int, elastic: bool, options: MatchOptions
) -> tuple[Ints, Floats]:
    """Return the point map and the functional map that a candidate is refined to."""
    found, way_there = spectral_map(a, b, chosen.functional_map[:k, :k], k, options)
    if not elastic or a.surface is None or b.surface is None:
        return found.point_map, found.functional_map
    point_map = elastic_point_map(
        a.surface, b.surface, way_there, mirrored=chosen.mirrored, options=options
    )
    return point_map, functional_map_from_point_map(a.spectrum, b.spectrum, point_map, k=k)


def spectral_map(
    a: Prepared, b: Prepared, start: Floats, k: int, options: MatchOptions
) -> tuple[Correspondence, Ints]:
    """Refine a functional map to k modes; return also the target point of each source point."""
    step = -(-(k - len(start)) // options.last_steps)
    curved = curvatures(a, b)
    scale = options.curvature_scale
    features = curved and (scale * curved[0], scale * curved[1])
    found = bijective_zoomout(
        a.spectrum, b.spectrum, start, k_final=k, step=max(step, 1), features=features
    )
    rows1 = a.spectrum.eigenvectors[:, :k] @ found.functional_map.T
    rows2 = b.spectrum.eigenvectors[:, :k]
    if features is not None:
        rows1, rows2 = np.hstack([rows1, features[0]]), np.hstack([rows2, features[1]])
    return found, nearest(rows1, rows2)


class _Search:
    """The search for candidates of one pair."""

    def __init__(
        self, a: Prepared, b: Prepared, landmarks: Pairs | None, options: MatchOptions
    ) -> None:
        self._a, self._b, self._landmarks, self._options = a, b, landmarks, options
        self._fit = None if landmarks is None else self._fitted(landmarks)

    def candidates(self, mirrored: bool) -> list[Candidate]:
        """Return the refined candidates that mirror, or those that do not; the best first."""
        a, b, options = self._a, self._b, self._options
        maps = list(sign_candidates(a, b, mirrored=mirrored, options=options))
        fit = self._fit
        if fit is not None and ((orientation_of(a, b, fit) or 1.0) < 0) == mirrored:
            maps.append(fit)
        grown = self._distinct(self._scored(C, mirrored, rough=True) for C in maps)
        k = min(options.refined_modes, a.spectrum.k, b.spectrum.k)
        refined, _ = zoomout_many(
            a.spectrum.eigenvectors[a.samples, :k],
            b.spectrum.eigenvectors[b.samples, :k],
            np.stack([c.functional_map for c in grown[: options.finalists]]),
            k_final=k,
            step=6,
        )
        return self._distinct(self._scored(C, mirrored) for C in refined)

    def _fitted(self, landmarks: Pairs) -> Floats:
        """Return the functional map that fits the landmarks and what is seen from them."""
        count = self._options.landmark_energies
        f, g = (
            normalize_descriptors(
                side.spectrum,
                np.hstack(
                    [side.wave, landmark_wave_kernel_signature(side.spectrum, points, count=count)]
                ),
            )
            for side, points in zip((self._a, self._b), landmarks, strict=True)
        )
        source, target, k = self._a.spectrum, self._b.spectrum, self._options.grown_modes
        return fit_functional_map(source, target, f, g, k=k, landmarks=landmarks)

    def _scored(self, C: Floats, mirrored: bool, *, rough: bool = False) -> Candidate:
        options = self._options
        values = mismatches(
            self._a,
            self._b,
            C,
            mirrored=mirrored,
            landmarks=self._landmarks,
            rough=rough,
            options=options,
        )
        score = score_of(values, options=options)
        return Candidate(functional_map=C, score=score, mismatches=values, mirrored=mirrored)

    def _distinct(self, candidates: Iterable[Candidate]) -> list[Candidate]:
        """Return the candidates by score, without those that all but repeat a better one."""
        kept: list[Candidate] = []
        for c in sorted(candidates, key=lambda c: c.score):
            if all(_apart(c, other) > self._options.same for other in kept):
                kept.append(c)
        return kept


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
