"""`match_part`: which points of a whole have a partner on a part of another surface, and which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from spectra_kit._core.checked import checked
from spectra_kit._core.threads import in_threads, single_threaded_blas
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import check_count, warn
from spectra_kit.eigen import Spectrum, spectrum
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.maps.convert import functional_map_from_point_map
from spectra_kit.maps.elastic import Met, meeting
from spectra_kit.maps.geodesic import edge_graph
from spectra_kit.maps.match import Search, match, spectral_map
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.options import DEFAULT, MatchOptions
from spectra_kit.maps.prepare import LOWEST_K, REFINED_K, Prepared, Surface, prepare
from spectra_kit.maps.regions import (
    LEAST_POINTS,
    Region,
    likely_regions,
    mesh_of,
    region,
)
from spectra_kit.maps.result import Candidate, Match
from spectra_kit.maps.score import (
    coverage_over_chance,
    orientation_of,
    scored,
)
from spectra_kit.maps.tears import torn
from spectra_kit.maps.topology import topology_of

_TRIED = 12  # regions that are matched
_REFINED = 3  # of which are followed
_ROUNDS = 3  # in which their borders move
_KEPT = 40  # modes of a map that outlive a move of the border
_LOOSE = 0.1  # at unit area of the part: how far from its border nothing pulls it
_FIRST_BENDS, _BENDS = 30, 4  # a border that nothing pulls needs more of them to settle
_REACH = 0.05  # at unit area of the whole: what is farther off the bent part is no partner
_SCORE = 0.4  # above which it is no part: the best of many regions is better than a map of wholes
_MIRRORED_BY = 1.5  # how many times better a mirrored part must be: regions differ in score, too
_ELSEWHERE = 0.1  # mean distance of images, from which on a candidate is a rival


@checked
def match_part(
    part: Prepared,
    whole: Prepared,
    *,
    mirrored: bool | None = None,
    k: int = 150,
    options: MatchOptions = DEFAULT,
) -> Match:
    """Find which points of a whole have a partner on a part of such a surface, and which.

    The part may lack a limb, half a body, or be a limb; it may have holes. Its size tells nothing:
    both may be in any unit, and of different persons.

    Parameters
    ----------
    part, whole : Prepared
        Connected meshes, prepared with their geometries; the whole best with 150 modes or more.
        They are matched on all their points, however dense, which takes its time.
    mirrored : bool, optional
        As of `match`.
    k : int, default 150
        Modes to end with, as of `match`.
    options : MatchOptions
        What is tried and believed; `convincing_score` counts below 0.4, as the best of many
        regions scores better than a map of wholes, and a mirrored part need be 1.5 times better,
        whatever `mirrored_by` says.

    Returns
    -------
    Match
        The part is the source, the whole the target. `covered` tells which points of the whole have
        a partner; the `point_map` of the others is the border of the part that is nearest. The
        `functional_map` takes functions on the part to functions on the whole that are 0 elsewhere:
        its singular values are at most about the root of the share that is covered. Candidates are
        maps to regions of the whole, each of which is at unit area.

    Raises
    ------
    InvalidInputError
        If `part` or `whole` was prepared of a cloud, or of a spectrum alone, or `k` is below 30.

    Warns
    -----
    DoubtfulMatchWarning
        If the map is not `Match.convincing`: the part may be none of this whole, or the whole is
        but a part itself. Two parts that overlap are not matched.

    See Also
    --------
    match : Of two wholes. A part without a boundary is matched by that, all being covered.

    Notes
    -----
    Regions of the whole beyond, and within, a distance of one or two ends of its limbs are compared
    with the part by what points see around them (wave kernel signatures) and by eigenvalues; the
    likeliest are matched as if they were wholes. Of the best, the part is bent onto the whole
    (`match` ends so, too), where its border shows how far the region reaches; that region is
    matched anew, and the one with the best score is the answer. A part whose border cuts
    through the middle of a whole without limbs is out of reach.

    Examples
    --------
    An animal without its head and neck:

    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> animal = sk.geometry.creature(1000)
    >>> left = animal.points[:, 0] < 0.6
    >>> cut = sk.TriangleMesh(animal.points, animal.faces[left[animal.faces].all(axis=1)])
    >>> rest = sk.geometry.largest_component(cut)
    >>> part, whole = (sk.prepare(sk.spectrum(m, 100), m) for m in (rest.mesh, animal))
    >>> found = sk.maps.match_part(part, whole, mirrored=False)
    >>> print((found.covered == left).mean())
    0.9...
    """
    sides = (part, whole)
    part, whole = (side.on_all_points() for side in sides)
    for name, side in (("part", part), ("whole", whole)):
        _check_mesh(name, side)
    k = min(check_count("k", k, low=LOWEST_K), part.spectrum.k, whole.spectrum.k)
    if not len(mesh_of(part).boundary_vertices):
        usual = match(*sides, mirrored=mirrored, k=k, options=options)
        return replace(usual, covered=np.ones(whole.spectrum.n, dtype=bool))
    ways = (False, True) if mirrored is None else (mirrored,)
    search = _PartSearch(part, whole, min(REFINED_K, k), options)
    with single_threaded_blas():
        trials = search.trials(ways)
        found = [search.ends([t for t in trials if t.candidate.mirrored == way]) for way in ways]
        if len(found) == 2 and found[1][0].value * _MIRRORED_BY < found[0][0].value:
            found.reverse()
        best, *others = found[0]
        chosen = best.trial
        side, bent = search.finished(chosen, k)
        rivals = [end.value for end in others if search.apart(end.trial, chosen) > _ELSEWHERE]
    assert part.surface is not None
    assert whole.surface is not None  # of meshes
    covered = covered_by(part, whole, bent)
    around = bent.back[chosen.piece.vertices]
    made = Match(
        point_map=bent.back,
        functional_map=_extended(part.spectrum, whole.spectrum, bent.back, covered, k),
        mirrored=chosen.candidate.mirrored,
        orientation=orientation_of(
            part, side, functional_map_from_point_map(part.spectrum, side.spectrum, around, k=k)
        ),
        margin=min(rivals) / best.value if rivals else float("inf"),
        mirror_margin=found[1][0].value / best.value if len(found) == 2 else float("inf"),
        consistent=1.0,
        coverage=coverage_over_chance(part.spectrum, side.spectrum, around),
        torn=_torn(part, side, around),
        candidates=(chosen.candidate, *(t.candidate for t in trials if t is not chosen)),
        options=replace(options, convincing_score=min(_SCORE, options.convincing_score)),
        covered=covered,
        rims=(topology_of(part.surface).rim, topology_of(whole.surface).rim),
    )
    if not made.convincing:
        open_ = "the whole is cut off, too; " * ("rims" in made.doubts)
        warn(
            f"no convincing part: {open_}its mismatch is {made.score:.2f} (right parts: below"
            f" {_SCORE:g}), and it covers {made.coverage:.2f} times as much as chance would",
            DoubtfulMatchWarning,
            advice="it may be no part of this surface; look at `covered`",
        )
    return made


def _torn(part: Prepared, side: Prepared, around: Ints) -> float:
    assert part.surface is not None
    assert side.surface is not None  # of meshes
    return torn(part.surface, side.surface, around)


@dataclass(frozen=True, eq=False)
class _Trial:
    """A region of the whole that the part may be, and a map of the part to it."""

    piece: Region
    side: Prepared  # the region
    candidate: Candidate

    @property
    def score(self) -> float:
        return self.candidate.score


class _End(NamedTuple):
    """Where a trial led, and the geometric mean of the scores there and where it began.

    Wrong regions grow alike to right ones as they move, so where each began counts as well.
    """

    trial: _Trial
    value: float


@dataclass(frozen=True, eq=False)
class _PartSearch:
    """The search for the region that a part is; with `low` modes until it is found."""

    part: Prepared
    whole: Prepared
    low: int
    options: MatchOptions

    def trials(self, ways: Sequence[bool]) -> list[_Trial]:
        """Return the candidates of all likely regions, the best first."""
        few = self.part.truncate(self.low)
        found = []
        for piece in likely_regions(self.part, self.whole, _TRIED):
            side = _prepared(piece, self.low)
            search = Search(few, side, None, self.options)
            for candidates in in_threads(search.candidates, ((way,) for way in ways)):
                found += [_Trial(piece, side, candidate) for candidate in candidates]
        return sorted(found, key=lambda trial: trial.score)

    def ends(self, trials: Sequence[_Trial]) -> list[_End]:
        """Return where trials lead, the best first; those far behind stay where they are."""
        ends = [self.followed(trial) for trial in trials[:_REFINED]]
        values = [np.sqrt(e.score * t.score) for e, t in zip(ends, trials, strict=False)]
        behind = [_End(trial, trial.score) for trial in trials[_REFINED:]]
        return sorted((*map(_End, ends, map(float, values)), *behind), key=lambda end: end.value)

    def followed(self, trial: _Trial) -> _Trial:
        """Return the trial that its border leads to, as long as each is better than the last."""
        for _ in range(_ROUNDS):
            bent = self._bent(trial)
            piece = region(self.whole, covered_by(self.part, self.whole, bent))
            if piece is None or len(piece.vertices) < LEAST_POINTS:
                break
            side = _prepared(piece, self.low)
            moved = self._retried(piece, side, bent.back[piece.vertices], trial)
            if moved.score >= trial.score:
                break
            trial = moved
        return trial

    def finished(self, trial: _Trial, k: int) -> tuple[Prepared, Met]:
        """Return the region with k modes, and the part bent onto the whole by as many."""
        side = _prepared(trial.piece, k)
        few = self.part.spectrum.eigenvectors[:, : self.low] @ trial.candidate.functional_map.T
        there = nearest(trial.side.spectrum.eigenvectors, few)
        start = functional_map_from_point_map(self.part.spectrum, side.spectrum, there, k=self.low)
        return side, self._bent_by(start, trial, side, k)

    def apart(self, one: _Trial, other: _Trial) -> float:
        """Return how far the images of a point of the part are apart, on average."""
        assert self.whole.surface is not None
        places = [self.whole.surface.points[self._image(trial)] for trial in (one, other)]
        return float(np.linalg.norm(places[0] - places[1], axis=1).mean())

    def _image(self, trial: _Trial) -> Ints:
        """Return where a trial takes the samples of the part."""
        C = trial.candidate.functional_map
        rows = self.part.spectrum.eigenvectors[self.part.samples, : C.shape[1]] @ C.T
        found = nearest(rows, trial.side.spectrum.eigenvectors[:, : len(C)])
        return np.asarray(trial.piece.vertices[found])

    def _retried(self, piece: Region, side: Prepared, around: Ints, trial: _Trial) -> _Trial:
        """Return the trial of a region, of which a point map to the part is known."""
        mirrored, few = trial.candidate.mirrored, self.part.truncate(self.low)
        k = min(_KEPT, self.low)
        start = functional_map_from_point_map(few.spectrum, side.spectrum, around, k=k)
        C = spectral_map(few, side, start, self.low)[0].functional_map
        return _Trial(piece, side, scored(few, side, C, mirrored=mirrored, options=self.options))

    def _loose(self, area: float) -> Surface:
        """Return the part at an area, without mass near its border: nothing pulls it there.

        The maps to a region end at the border of the region, right or wrong; the border of a bent
        part shall be where the rest of it says.
        """
        surface = self.part.surface
        assert surface is not None
        mesh = mesh_of(self.part)
        depth = dijkstra(
            edge_graph(mesh), directed=False, indices=mesh.boundary_vertices, min_only=True
        )
        held = depth >= min(_LOOSE, np.median(depth))
        return replace(surface, points=surface.points * area**0.5, mass=surface.mass * area * held)

    def _bent(self, trial: _Trial) -> Met:
        return self._bent_by(trial.candidate.functional_map, trial, trial.side, self.low)

    def _bent_by(self, start: Floats, trial: _Trial, side: Prepared, k: int) -> Met:
        """Bend the part onto the whole, at the size of the region, from a map to the region."""
        assert self.whole.surface is not None
        way_there = spectral_map(self.part, side, start, k)[1]
        return meeting(
            self._loose(trial.piece.area),
            self.whole.surface,
            trial.piece.vertices[way_there],
            mirrored=trial.candidate.mirrored,
            options=replace(self.options, first_bends=_FIRST_BENDS, bends=_BENDS),
        )


def covered_by(part: Prepared, whole: Prepared, bent: Met) -> Bools:
    """Tell which points of the whole lie on the part that was bent onto it.

    Not those that are beyond its border where that is nearest, by more than half the step from the
    neighbours to the border, or farther off than the reach; nor pieces of the rest that the part
    itself hardly touches.
    """
    assert whole.surface is not None
    mesh, points = mesh_of(part), whole.surface.points
    steps = _links(edge_graph(mesh))
    middle = (steps @ bent.points) / (steps @ np.ones(mesh.n))[:, None]
    border = np.isin(np.arange(mesh.n), mesh.boundary_vertices)
    there = bent.points[bent.back]
    outwards = there - middle[bent.back]
    step = ((points - there - 0.5 * outwards) * outwards).sum(axis=1)
    beyond = border[bent.back] & (step > 0)
    near = np.flatnonzero(~beyond & (np.linalg.norm(points - there, axis=1) < _REACH))
    links = _links(edge_graph(mesh_of(whole)))
    _, piece = connected_components(links[near][:, near], directed=False)
    touched = np.zeros(len(points))
    touched[bent.there] = 1.0
    touched = ((links @ touched + touched) > 0)[near]
    mass = whole.spectrum.mass[near]
    share = np.bincount(piece, mass * touched) / np.bincount(piece, mass)
    covered = np.zeros(len(points), dtype=bool)
    covered[near] = share[piece] > 0.5
    return covered


def _links(graph: sparse.csr_array) -> sparse.csr_array:
    """Return the graph with 1 for each edge."""
    out = graph.copy()
    out.data[:] = 1.0
    return out


def _prepared(piece: Region, k: int) -> Prepared:
    return prepare(spectrum(piece.mesh, k), piece.mesh).on_all_points()


def _extended(a: Spectrum, b: Spectrum, point_map: Ints, covered: Bools, k: int) -> Floats:
    """Return the functional map of functions that are 0 where nothing is covered, (k, k)."""
    rows = b.eigenvectors[covered, :k] * b.mass[covered, None]
    out: Floats = rows.T @ a.eigenvectors[point_map[covered], :k]
    return out


def _check_mesh(name: str, side: Prepared) -> None:
    surface = side.surface
    if surface is None or (surface.oriented.weights != 1).any():
        raise InvalidInputError(
            name,
            "be prepared of a mesh",
            "a spectrum alone" if surface is None else "a cloud",
            advice="pass the mesh to prepare",
        )
