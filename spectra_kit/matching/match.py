"""`match`: a map between two surfaces that is not flipped, and how sure that is."""

from __future__ import annotations

from typing import Literal

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._types import Floats, Ints
from spectra_kit._validate import check_count, warn
from spectra_kit.descriptors import landmark_wave_kernel_signature, normalize_descriptors
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.functional_maps import (
    bijective_zoomout,
    fit_functional_map,
    functional_map_from_point_map,
    zoomout_many,
)
from spectra_kit.functional_maps.fit import Landmarks, check_landmarks
from spectra_kit.functional_maps.nearest import nearest
from spectra_kit.geometry import Geometry
from spectra_kit.linalg.threads import in_threads, single_threaded_blas
from spectra_kit.matching.candidates import GROWN, sign_candidates
from spectra_kit.matching.elastic import elastic_point_map
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
Sides = Literal["kept", "reversed", "either"]

_SAME = 0.05  # squared difference per mode below which two maps are one
_RIVAL = 0.15  # the same, below which one is no rival of the other
_SEEN = 20  # energies of the wave kernel signature seen from each landmark
_FINALISTS = 6  # candidates that are refined
_REFINED = 60  # modes they are refined to
_STEPS = 3  # from there to the end
_CURVATURE = 2.0  # scale of each curvature in those steps: it counts like four modes
_MIRRORED = 1.5  # how many times better a mirroring map must be to be believed


@checked
def match(
    source: Prepared | Spectrum,
    target: Prepared | Spectrum,
    *,
    source_geometry: Geometry | None = None,
    target_geometry: Geometry | None = None,
    landmarks: Landmarks | None = None,
    sides: Sides = "either",
    k: int = 150,
    elastic: bool = True,
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
    sides : {"either", "kept", "reversed"}
        Whether maps may turn the surface over. ``either`` prefers those that do not, unless a
        mirroring one is 1.5 times better: as a mirrored copy is, but not one that is bent as well
        and looks much like its mirror image. Say ``reversed`` where that is known.
    k : int, default 150
        Modes to end with; fewer where a spectrum has fewer. Of the longer one the modes beyond
        the shorter are left out, as descriptors depend on all modes.
    elastic : bool, default True
        Whether to bend the source onto the target in the end, where both geometries are given.

    Returns
    -------
    Match
        The point map, the functional map, and how sure they are.

    Raises
    ------
    InvalidInputError
        If a spectrum has fewer than 30 modes or several components, `k` is below 30, reversed
        sides are asked for without both geometries, or landmarks are empty, unpaired or out of
        range.

    Warns
    -----
    DoubtfulMatchWarning
        If the map is not `Match.convincing`.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit import match, prepare
    >>> from spectra_kit.eigensolvers import eigensolve
    >>> from spectra_kit.geometry import creature, mirrored
    >>> from spectra_kit.operators import robust_laplacian
    >>> animal = creature(600)
    >>> image = mirrored(animal)
    >>> a, b = (prepare(eigensolve(robust_laplacian(m), 60), m) for m in (animal, image))
    >>> found = match(a, b)
    >>> found.mirrored, bool((found.point_map == np.arange(600)).all())
    (True, True)
    """
    a = _prepared("source", source, source_geometry)
    b = _prepared("target", target, target_geometry)
    if sides not in ("either", "kept", "reversed"):
        raise InvalidInputError(f"`sides` must be 'either', 'kept' or 'reversed', got {sides!r}")
    k = min(check_count("k", k, low=LOWEST_K), a.spectrum.k, b.spectrum.k)
    has_sides = a.surface is not None
    if has_sides != (b.surface is not None):
        raise InvalidInputError(
            "`source` and `target` must come both with their geometry or both without, got only"
            f" that of the {'source' if has_sides else 'target'}; pass the other one, too"
        )
    if sides != "either" and not has_sides:
        raise InvalidInputError(
            f"`sides={sides!r}` needs both geometries, got none;"
            " pass source_geometry and target_geometry"
        )
    ways = {"either": (False, True), "kept": (False,), "reversed": (True,)}[sides]
    pairs = None if landmarks is None else check_landmarks(landmarks, a.spectrum.n, b.spectrum.n)
    fewer = min(a.spectrum.k, b.spectrum.k)
    a, b = a.truncate(fewer), b.truncate(fewer)
    with single_threaded_blas():  # small products: the threads are ours
        found = _both_ways(a, b, ways if has_sides else (False,), pairs)
        if len(found) == 2 and found[1][0].score * _MIRRORED < found[0][0].score:
            found.reverse()
        chosen = found[0][0]
        point_map, functional_map = _refined(a, b, chosen, k, elastic)
    opposite = [c.score for c in found[-1]] if len(found) == 2 else []
    rivals = [c.score for c in found[0][1:] if _apart(c, chosen) > _RIVAL]
    made = Match(
        point_map=point_map,
        functional_map=functional_map,
        mirrored=chosen.reversing,
        orientation=orientation_of(a, b, functional_map),
        margin=min(rivals) / chosen.score if rivals else float("inf"),
        other_side=min(opposite) / chosen.score if opposite else float("inf"),
        consistent=min(
            1.0 if side.surface is None else side.surface.oriented.consistent for side in (a, b)
        ),
        coverage=coverage_over_chance(a.spectrum, b.spectrum, point_map),
        candidates=tuple(c for way in found for c in way),
    )
    if not made.convincing:
        warn(
            f"no convincing map: its mismatch is {made.score:.2f} (right maps: below 0.47), and it"
            f" covers {made.coverage:.2f} times as much as chance would (right maps: 1.1 and more);"
            " the surfaces may not correspond; look at the map, give `landmarks`, or try another"
            " `k` (150 match best)",
            DoubtfulMatchWarning,
        )
    return made


def _refined(
    a: Prepared, b: Prepared, chosen: Candidate, k: int, elastic: bool
) -> tuple[Ints, Floats]:
    """Return the point map and the functional map that a candidate is refined to."""
    start = chosen.functional_map[:k, :k]
    step = -(-(k - len(start)) // _STEPS)
    curved = curvatures(a, b)
    features = curved and (_CURVATURE * curved[0], _CURVATURE * curved[1])
    result = bijective_zoomout(
        a.spectrum, b.spectrum, start, k_final=k, step=max(step, 1), features=features
    )
    if not elastic or a.surface is None or b.surface is None:
        return result.point_map, result.functional_map
    rows1 = a.spectrum.eigenvectors[:, :k] @ result.functional_map.T
    rows2 = b.spectrum.eigenvectors[:, :k]
    if features is not None:
        rows1, rows2 = np.hstack([rows1, features[0]]), np.hstack([rows2, features[1]])
    way_there = nearest(rows1, rows2)
    point_map = elastic_point_map(a.surface, b.surface, way_there, mirrored=chosen.reversing)
    return point_map, functional_map_from_point_map(a.spectrum, b.spectrum, point_map, k=k)


def _both_ways(
    a: Prepared, b: Prepared, ways: tuple[bool, ...], landmarks: Pairs | None
) -> list[list[Candidate]]:
    """Return the candidates of each way round, looked for side by side."""
    fit = None if landmarks is None else _landmark_fit(a, b, landmarks)
    found: list[list[Candidate]] = [[] for _ in ways]

    def look(i: int) -> None:
        found[i] = _candidates(a, b, ways[i], landmarks, fit)

    in_threads(look, [(i,) for i in range(len(ways))])
    return found


def _candidates(
    a: Prepared, b: Prepared, reversing: bool, landmarks: Pairs | None, fit: Floats | None
) -> list[Candidate]:
    """Return the refined candidates of one way round, the best first."""
    maps = list(sign_candidates(a, b, reversing=reversing))
    if fit is not None and ((orientation_of(a, b, fit) or 1.0) < 0) == reversing:
        maps.append(fit)
    grown = [_scored(a, b, C, reversing, landmarks, rough=True) for C in maps]
    finalists = _distinct(grown)[:_FINALISTS]
    k = min(_REFINED, a.spectrum.k, b.spectrum.k)
    refined, _ = zoomout_many(
        a.spectrum.eigenvectors[a.samples, :k],
        b.spectrum.eigenvectors[b.samples, :k],
        np.stack([c.functional_map for c in finalists]),
        k_final=k,
        step=6,
    )
    return _distinct([_scored(a, b, C, reversing, landmarks) for C in refined])


def _landmark_fit(a: Prepared, b: Prepared, landmarks: Pairs) -> Floats:
    """Return the functional map that fits the landmarks and what is seen from them."""
    f, g = (
        normalize_descriptors(
            side.spectrum,
            np.hstack(
                [
                    side.wave,
                    landmark_wave_kernel_signature(side.spectrum, points, count=_SEEN),
                ]
            ),
        )
        for side, points in zip((a, b), landmarks, strict=True)
    )
    return fit_functional_map(a.spectrum, b.spectrum, f, g, k=GROWN, landmarks=landmarks)


def _scored(
    a: Prepared,
    b: Prepared,
    C: Floats,
    reversing: bool,
    landmarks: Pairs | None,
    *,
    rough: bool = False,
) -> Candidate:
    values = mismatches(a, b, C, reversing=reversing, landmarks=landmarks, rough=rough)
    return Candidate(
        functional_map=C, score=score_of(values), mismatches=values, reversing=reversing
    )


def _apart(c: Candidate, other: Candidate) -> float:
    """Return the squared difference of two maps, per mode."""
    C = c.functional_map
    return float(((C - other.functional_map) ** 2).sum() / len(C))


def _distinct(candidates: list[Candidate]) -> list[Candidate]:
    """Return the candidates by score, without those that all but repeat a better one."""
    kept: list[Candidate] = []
    for c in sorted(candidates, key=lambda c: c.score):
        if all(_apart(c, other) > _SAME for other in kept):
            kept.append(c)
    return kept


def _prepared(name: str, side: Prepared | Spectrum, geometry: Geometry | None) -> Prepared:
    if isinstance(side, Prepared):
        if geometry is not None:
            raise InvalidInputError(
                f"`{name}_geometry` must be left out for a prepared surface, got one;"
                " pass it to prepare"
            )
        return side
    return prepare(side, geometry)
