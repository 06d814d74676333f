"""`match`: a map between two surfaces that is not flipped, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.threads import single_threaded_blas
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import check_count
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, GeometryLike
from spectra_kit.maps.convert import (
    Correspondence,
    at_unit_area,
    check_point_map,
    induced,
    into_triangles,
)
from spectra_kit.maps.deform import PULL, PULL_UNLIKE, Contact, by_bending, by_modes, contact
from spectra_kit.maps.fit import Landmarks, check_landmarks
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.prepare import (
    CURVATURE_SCALE,
    LOWEST_K,
    Prepared,
    curvatures,
    on_matched,
    prepared,
    truncated,
)
from spectra_kit.maps.result import DEFAULT, Candidate, Match, MatchOptions, warn_of
from spectra_kit.maps.score import (
    Pairs,
    bends_apart,
    coverage_over_chance,
    orientation_of,
    unlike_cost,
)
from spectra_kit.maps.search import Search, difference, distinct, on_few, on_samples, searched
from spectra_kit.maps.surface import Surface, clustered, discontinuity, topologies
from spectra_kit.maps.zoomout import both_ways

_RIVAL = 0.15  # the same, below which one is no rival of the other
_CONTEST = 1.15  # candidates whose scores are within that factor of the best are bent as well
_CONTENDERS = 6  # how many at most, the best among them
_MET = 1.25  # spacings that bodies of one kind come near: 0.9 to 1.16, species 0.9 to 2.3
_LAST_STEPS = 3  # from the refined modes to the end
_FAR = 3.0  # steps between neighbours beyond which a landmark is lost
_NEAR = 0.05  # the same at unit area, where steps are finer: bending is rigid below that length


@checked
def match(
    source: GeometryLike | Spectrum | Prepared,
    target: GeometryLike | Spectrum | Prepared,
    *,
    source_geometry: GeometryLike | None = None,
    target_geometry: GeometryLike | None = None,
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
    source, target : TriangleMesh, PointCloud, Spectrum or Prepared
        Connected surfaces, in any units, or their files; of meshes and clouds the lowest 150 modes
        are solved for. A `Prepared` one saves time over many pairs.
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
        Whether to bend each surface onto the other in the end, where both geometries are given.
    precise : bool, default False
        Whether to find where on the triangles of the source each target point lies as well: needs
        both geometries.
    options : MatchOptions
        What is tried and believed.

    Returns
    -------
    Match
        The point map, the functional map, and how sure they are.

    Warns
    -----
    DoubtfulMatchWarning
        If the map is not `Match.convincing`, or does not keep the landmarks.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> animal = sk.geometry.creature(600)
    >>> found = sk.match(animal, sk.geometry.mirrored(animal), k=60)
    >>> found.mirrored, bool((found.point_map == np.arange(600)).all())
    (True, True)
    """
    a = _prepared("source", source, source_geometry)
    b = _prepared("target", target, target_geometry)
    check_count("k", k, low=LOWEST_K)
    seen = a.geometry is not None
    if seen != (b.geometry is not None):
        raise InvalidInputError(
            "source",
            "come with its geometry as `target` does, or both without",
            f"only that of the {'source' if seen else 'target'}",
            advice="pass the other one, too",
        )
    for name, value, blind in (("mirrored", mirrored, None), ("precise", precise, False)):
        if value != blind and not seen:
            raise InvalidInputError(
                name,
                f"be {blind} without both geometries",
                value,
                advice="pass source_geometry and target_geometry",
            )
    if landmarks is not None:
        landmarks = check_landmarks(landmarks, a.whole.n, b.whole.n)
    if initial is not None:
        initial = check_point_map("initial", initial, a.whole.n, b.whole.n)
    last = LastSteps(k, elastic, precise)
    return matched(a, b, last, mirrored, options, landmarks, initial)


class LastSteps(NamedTuple):
    """How the chosen candidate becomes a match: see `match`."""

    k: int
    elastic: bool = True
    precise: bool = False


def matched(
    a: Prepared,
    b: Prepared,
    last: LastSteps,
    mirrored: bool | None,
    options: MatchOptions,
    landmarks: Pairs | None = None,
    initial: Ints | None = None,
) -> Match:
    """Do the same with checked arguments."""
    fewer = min(a.spectrum.k, b.spectrum.k)
    a, b = truncated(a, fewer), truncated(b, fewer)
    if initial is None:
        found = searched(a, b, mirrored, options, landmarks)
    else:
        with single_threaded_blas():
            search = Search(a, b, on_few(a, b, landmarks), options)
            found = [[search.known(on_matched(a, b, initial), mirrored)]]
    given = initial is not None
    return matched_from(a, b, found, last, options, landmarks, initial=given)


def matched_from(
    a: Prepared,
    b: Prepared,
    found: Sequence[Sequence[Candidate]],
    last: LastSteps,
    options: MatchOptions,
    landmarks: Pairs | None = None,
    *,
    initial: bool = False,
    unconnected: bool = False,
) -> Match:
    """Refine one of the first candidates found, those of either orientation; the best first.

    Where they come from, `initial` and `unconnected` are attributes of the match.
    """
    last = last._replace(k=min(last.k, a.spectrum.k, b.spectrum.k))
    seen = a.geometry is not None and b.geometry is not None
    apart, lost_from = None, np.inf
    with single_threaded_blas():
        chosen, unlike = _settled(a, b, found[0], options.rounds)
        point_map, on_faces = _refined(a, b, chosen, last, options.rounds, unlike=unlike)
        if landmarks is not None and seen:
            apart, lost_from = _left_by(a.whole_surface, point_map, landmarks)
            point_map, on_faces = _kept(point_map, on_faces, landmarks, apart <= lost_from)
        functional_map = induced(a.whole, b.whole, point_map, last.k, last.k)
    on_few = on_matched(a, b, point_map)
    opposite = [c.score for c in found[-1]] if len(found) == 2 else []
    rivals = [c.score for c in found[0] if difference(c, chosen) > _RIVAL]
    others = [c for way in found for c in way if c is not chosen]
    result = Match(
        point_map=point_map,
        functional_map=functional_map,
        mirrored=chosen.mirrored,
        orientation=orientation_of(a, b, functional_map),
        margin=min(rivals) / chosen.score if rivals else float("inf"),
        mirror_margin=min(opposite) / chosen.score if opposite else float("inf"),
        consistent=min(
            side.surface.oriented.consistent if side.geometry else 1.0 for side in (a, b)
        ),
        coverage=coverage_over_chance(a.spectrum.mass, b.spectrum.mass, on_few),
        discontinuity=discontinuity(a.surface, b.surface, on_few) if seen else None,
        candidates=(chosen, *others),
        precise=on_faces,
        clustered=max(clustered(side.spectrum.eigenvalues) for side in (a, b)),
        **(topologies(a.whole_surface, b.whole_surface) if seen else {}),
        landmark_distances=apart,
        lost_from=lost_from,
        n_source=a.whole.n,
        initial=initial,
        unconnected=unconnected,
    )
    warn_of(result)
    return result


def _settled(
    a: Prepared, b: Prepared, candidates: Sequence[Candidate], rounds: int
) -> tuple[Candidate, bool]:
    """Return the best candidate; of those that score much alike, by what scores do not see.

    Of one body in two poses modes can hardly tell the front from the back, but the right map brings
    the source down onto the target, to the spacing of its points, and what bends alike together:
    toes onto toes and noses onto noses. Of two species no map does, and how near one comes tells
    nothing: see `unlike_cost`. Returns also whether there is none.
    """
    best = candidates[0]
    if a.geometry is None or b.geometry is None:
        return best, False
    rivals = (c for c in candidates if c.score <= _CONTEST * best.score)
    close = distinct(rivals, _RIVAL)[:_CONTENDERS]
    if len(close) == 1:
        return best, False
    met = [_contact(a, b, c, rounds) for c in close]
    spacing = 1 / np.sqrt(min(a.spectrum.n, b.spectrum.n))  # at unit area
    unlike = min(one.gap for one in met) > _MET * spacing
    if unlike:
        costs = [unlike_cost(a, b, c) for c in close]
    else:
        costs = [
            c.score * one.gap**2 * bends_apart(a, b, one.there, one.back)
            for c, one in zip(close, met, strict=True)
        ]
    return close[int(np.argmin(costs))], unlike


def _contact(a: Prepared, b: Prepared, candidate: Candidate, rounds: int) -> Contact:
    """Return who meets whom once the source is bent by a candidate."""
    C, mirrored = candidate.functional_map, candidate.mirrored
    rows1, rows2 = a.spectrum.eigenvectors[:, : len(C)] @ C.T, b.spectrum.eigenvectors[:, : len(C)]
    there = nearest(rows1, rows2)
    return contact(a.surface, b.surface, there, mirrored=mirrored, rounds=rounds)


def _refined(
    a: Prepared, b: Prepared, chosen: Candidate, last: LastSteps, rounds: int, *, unlike: bool
) -> tuple[Ints, sparse.csr_array | None]:
    """Return the map of all points that a candidate is refined to, and the one into triangles.

    Between `unlike` bodies positions hold it to the end, and the source gives way more.
    """
    k = last.k
    start = chosen.functional_map[:k, :k]
    if not unlike:
        start = _sharpened(a, b, start)
    if not last.elastic or a.geometry is None or b.geometry is None:
        point_map, here, there = by_modes(a, b, _zoomed(a, b, start, k)[0])
    else:
        _, way_there = spectral_map(a, b, start, k)
        pull = PULL_UNLIKE if unlike else PULL
        asked: dict[str, Any] = {"mirrored": chosen.mirrored, "rounds": rounds, "pull": pull}
        point_map, here, there = by_bending(a, b, way_there, **asked)
    if not last.precise:
        return point_map, None
    return point_map, into_triangles(there, here, a.whole_surface.oriented.faces, point_map)


def _sharpened(a: Prepared, b: Prepared, functional_map: Floats) -> Floats:
    """Return a map of bent surfaces with all but its lowest modes found anew, by modes alone.

    Positions hold a map together while it is searched for; hands and feet, whose poses differ, come
    out sharper without them.
    """
    low, k = LOWEST_K, len(functional_map)
    if a.geometry is None or b.geometry is None or k <= low:
        return functional_map
    return np.asarray(on_samples(a, b, functional_map[None, :low, :low], k)[0])


def spectral_map(a: Prepared, b: Prepared, start: Floats, k: int) -> tuple[Correspondence, Ints]:
    """Refine a functional map to k modes; return also the target point of each source point."""
    found, (more1, more2) = _zoomed(a, b, start, k)
    rows1 = a.spectrum.eigenvectors[:, :k] @ found.functional_map.T
    rows2 = b.spectrum.eigenvectors[:, :k]
    return found, nearest(np.hstack([rows1, more1]), np.hstack([rows2, more2]))


def _zoomed(
    a: Prepared, b: Prepared, start: Floats, k: int
) -> tuple[Correspondence, tuple[Floats, Floats]]:
    """Refine a functional map to k modes; return also what joined them."""
    step = max(1, -(-(k - len(start)) // _LAST_STEPS))
    features = np.empty((a.spectrum.n, 0)), np.empty((b.spectrum.n, 0))
    if (curved := curvatures(a, b)) is not None:
        features = CURVATURE_SCALE * curved[0], CURVATURE_SCALE * curved[1]
    one, other = (at_unit_area(side.spectrum.truncate(k)) for side in (a, b))
    return both_ways(one, other, start, k, step, features), features


def _prepared(
    name: str, side: Geometry | Spectrum | Prepared, geometry: Geometry | None
) -> Prepared:
    if isinstance(side, Spectrum):
        return prepared(side, geometry)
    if geometry is not None:
        raise InvalidInputError(
            f"{name}_geometry", f"be left out where `{name}` is no Spectrum", "one"
        )
    return side if isinstance(side, Prepared) else prepared(side)


def _left_by(source: Surface, point_map: Ints, landmarks: Pairs) -> tuple[Floats, float]:
    """Return how far a map leads from each landmark, (l,), and how far is too far; at unit area."""
    here, there = landmarks
    apart: Floats = np.linalg.norm(source.points[point_map[there]] - source.points[here], axis=1)
    return apart, max(_FAR * source.spacing, _NEAR)


def _kept(
    point_map: Ints, on_faces: sparse.csr_array | None, landmarks: Pairs, held: Bools
) -> tuple[Ints, sparse.csr_array | None]:
    """Return a map, to points and into triangles, that leads right to the landmarks it holds."""
    here, there = landmarks[0][held], landmarks[1][held]
    out = point_map.copy()
    out[there] = here
    if on_faces is not None:
        rows = on_faces.tolil()
        rows[there] = 0.0
        rows[there, here] = 1.0
        on_faces = sparse.csr_array(rows)
    return out, on_faces
