"""`match_part`: which points of a whole have a partner on a part of another surface, and which.

Regions of the whole are tried: what lies within a distance of one or two ends of limbs
(`limb_ends`), and what lies beyond, the likest to the part first (`likely_regions`). The modes of a
region come from those of the whole, as in partial functional maps (Rodola et al., *Partial
Functional Correspondence*, CGF 2017): it costs no solve. Eigenvalues alone find regions, too
(Rampini et al., *Correspondence-Free Region Localization for Partial Shape Similarity via
Hamiltonian Spectrum Alignment*, 3DV 2019), but of other people's bodies they find the wrong ones
more often.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import igl
import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra

from spectra_kit._core.checked import checked
from spectra_kit._core.threads import in_threads, single_threaded_blas
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import check_count
from spectra_kit._core.warn import warn
from spectra_kit._sparse.ritz import ritz_pairs
from spectra_kit.eigen import Spectrum, spectrum
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.features import wave_kernel_signature
from spectra_kit.geodesics.edges import edge_graph
from spectra_kit.geometry import GeometryLike, TriangleMesh, largest_component
from spectra_kit.maps.calibration import CONVINCING_PART
from spectra_kit.maps.convert import induced
from spectra_kit.maps.deform import Contact, contact
from spectra_kit.maps.match import LastSteps, matched, spectral_map
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.prepare import LOWEST_K, REFINED_K, Prepared, prepared, truncated
from spectra_kit.maps.result import DEFAULT, Candidate, Match, MatchOptions
from spectra_kit.maps.score import coverage_over_chance, orientation_of, scored
from spectra_kit.maps.search import Search
from spectra_kit.maps.subsample import neighbours
from spectra_kit.maps.surface import Surface, discontinuity, topology_of
from spectra_kit.operators import cotan_laplacian

_TRIED = 12  # regions that are matched
_REFINED = 3  # of which are followed
_ROUNDS = 3  # in which their borders move
_KEPT = 40  # modes of a map that outlive a move of the border
_LOOSE = 0.1  # at unit area of the part: how far from its border nothing pulls it
_BENDS = 30, 4  # first and then: a border that nothing pulls needs more of them to settle
_REACH = 0.05  # at unit area of the whole: what is farther off the bent part is no partner
_MIRRORED_BY = 1.5  # how many times better a mirrored part must be: regions differ in score, too
_ELSEWHERE = 0.1  # mean distance of images, from which on a candidate is a rival
LEAST_POINTS = 200  # of a region that can be matched
_BETWEEN = 0.3  # at unit area, the distance between ends of limbs: toes of a foot are one
_ENDS = 8  # ends of limbs, at most
_SHARES = 1 / (1 + np.exp(-np.linspace(-3.2, 0.6, 11)))  # of the area: taken off, or left
_RITZ = 150  # modes of the whole that make those of a region
_FEW = 20  # eigenvalues that are compared
_COMPARED, _ENERGIES, _QUANTILES = 40, 30, 40  # modes, and what is compared of their signatures
_DEPENDENT = 1e-2  # relative; functions smaller on the region, or nearly dependent, are left out


@checked
def match_part(
    part: GeometryLike | Prepared,
    whole: GeometryLike | Prepared,
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
    part, whole : TriangleMesh or Prepared
        Connected meshes, or their files, or what was prepared of meshes; the whole best with 150
        modes or more. They are matched on all their points, however dense, which takes its time.
    mirrored : bool, optional
        As of `match`.
    k : int, default 150
        Modes to end with, as of `match`.
    options : MatchOptions
        What is tried; a mirrored part need be 1.5 times better, whatever `mirrored_by` says.

    Returns
    -------
    Match
        The part is the source, the whole the target. `covered` tells which points of the whole have
        a partner; the `point_map` of the others is the border of the part that is nearest. The
        `functional_map` takes functions on the part to functions on the whole that are 0 elsewhere:
        its singular values are at most about the root of the share that is covered. Candidates are
        maps to regions of the whole, each of which is at unit area.

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
    with the part by wave kernel signatures and by eigenvalues; the likeliest are matched as if they
    were wholes. Of the best, the part is bent onto the whole, as in `match`, where its border shows
    how far the region reaches; that region is matched anew, and the one with the best score is the
    answer. A part whose border cuts through the middle of a whole without limbs is out of reach.
    The guide (docs/matching.md) matches an animal without its head with a whole one.

    Examples
    --------
    An egg without its tip; few candidates find a part of the very same surface:

    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> egg = ball.with_points(ball.points * (1 + 0.3 * ball.points[:, :1]) * [3, 1, 0.7])
    >>> left = egg.points[:, 0] < 2.3
    >>> cut = sk.TriangleMesh(egg.points, egg.faces[left[egg.faces].all(axis=1)])
    >>> rest = sk.geometry.largest_component(cut).mesh
    >>> part, whole = (sk.prepare(sk.spectrum(mesh, 40), mesh) for mesh in (rest, egg))
    >>> few = sk.maps.MatchOptions(orders=1, growing=1, turns=1, finalists=1, rounds=1)
    >>> found = sk.maps.match_part(part, whole, mirrored=False, options=few)
    >>> print((found.covered == left).mean())
    0.9...
    """
    sides = [side if isinstance(side, Prepared) else prepared(side) for side in (part, whole)]
    part, whole = (side.on_all_points() for side in sides)
    for name, side in (("part", part), ("whole", whole)):
        if side.geometry is None or not side.geometry.is_mesh:
            got = "a spectrum alone" if side.geometry is None else "a cloud"
            advice = "pass the mesh to prepare"
            raise InvalidInputError(name, "be prepared of a mesh", got, advice=advice)
    k = min(check_count("k", k, low=LOWEST_K), part.spectrum.k, whole.spectrum.k)
    if not len(part.surface.mesh.boundary_vertices):
        usual = matched(sides[0], sides[1], LastSteps(k), mirrored, options)
        return replace(usual, covered=np.ones(whole.spectrum.n, dtype=bool))
    ways = (False, True) if mirrored is None else (mirrored,)
    search = _PartSearch(part, whole, min(REFINED_K, k), options)
    with single_threaded_blas():
        trials = search.trials(ways)
        found = [search.ends([t for t in trials if t.candidate.mirrored == way]) for way in ways]
        if len(found) == 2 and found[1][0].value * _MIRRORED_BY < found[0][0].value:
            found.reverse()
        chosen, *others = found[0]
        side, bent = search.finished(chosen, k)
        rivals = [other.value for other in others if search.apart(other, chosen) > _ELSEWHERE]
    candidates = [trial.candidate for trial in trials]
    covered = covered_by(part, whole, bent)
    around = bent.back[chosen.piece.vertices]
    made = Match(
        point_map=bent.back,
        functional_map=_extended(part.spectrum, whole.spectrum, bent.back, covered, k),
        mirrored=chosen.candidate.mirrored,
        orientation=orientation_of(part, side, induced(part.spectrum, side.spectrum, around, k, k)),
        margin=min(rivals) / chosen.value if rivals else float("inf"),
        mirror_margin=found[1][0].value / chosen.value if len(found) == 2 else float("inf"),
        consistent=1.0,
        coverage=coverage_over_chance(part.spectrum.mass, side.spectrum.mass, around),
        discontinuity=discontinuity(part.surface, side.surface, around),
        candidates=(chosen.candidate, *(c for c in candidates if c is not chosen.candidate)),
        covered=covered,
        convincing_score=CONVINCING_PART,
        rims=(topology_of(part.surface).rim, topology_of(whole.surface).rim),
        n_source=part.spectrum.n,
    )
    if not made.convincing:
        _warn_of(made)
    return made


def _warn_of(made: Match) -> None:
    open_ = "the whole is cut off, too; " * ("rims" in made.doubts)
    warn(
        f"no convincing part: {open_}its mismatch is {made.score:.2f} (right parts:"
        f" below {CONVINCING_PART:g}), and it covers {made.coverage:.2f} times as much as"
        " chance would",
        DoubtfulMatchWarning,
        advice="it may be no part of this surface; look at `covered`",
    )


@dataclass(frozen=True, eq=False)
class _Trial:
    """A region of the whole that the part may be, and a map of the part to it."""

    piece: Region
    side: Prepared  # the region
    candidate: Candidate
    began: float | None = None  # the score of the trial that led here

    @property
    def score(self) -> float:
        return self.candidate.score

    @property
    def value(self) -> float:
        """The score, or the geometric mean of those here and where it began.

        Wrong regions grow alike to right ones as they move.
        """
        return self.score if self.began is None else float(np.sqrt(self.score * self.began))


@dataclass(frozen=True, eq=False)
class _PartSearch:
    """The search for the region that a part is; with `low` modes until it is found."""

    part: Prepared
    whole: Prepared
    low: int
    options: MatchOptions

    def trials(self, ways: Sequence[bool]) -> list[_Trial]:
        """Return the candidates of all likely regions, the best first."""
        few = truncated(self.part, self.low)
        found = []
        for piece in likely_regions(self.part, self.whole, _TRIED):
            side = piece.prepared(self.low)
            search = Search(few, side, None, self.options)
            for candidates in in_threads(search.candidates, ((way,) for way in ways)):
                found += [_Trial(piece, side, candidate) for candidate in candidates]
        return sorted(found, key=lambda trial: trial.score)

    def ends(self, trials: Sequence[_Trial]) -> list[_Trial]:
        """Return where trials lead, the best first; those far behind stay where they are."""
        ends = [replace(self.followed(trial), began=trial.score) for trial in trials[:_REFINED]]
        return sorted((*ends, *trials[_REFINED:]), key=lambda end: end.value)

    def followed(self, trial: _Trial) -> _Trial:
        """Return the trial that its border leads to, as long as each is better than the last."""
        for _ in range(_ROUNDS):
            bent = self._bent(trial.candidate.functional_map, trial, trial.side, self.low)
            piece = region(self.whole, covered_by(self.part, self.whole, bent))
            if piece is None or len(piece.vertices) < LEAST_POINTS:
                break
            side = piece.prepared(self.low)
            moved = self._retried(piece, side, bent.back[piece.vertices], trial)
            if moved.score >= trial.score:
                break
            trial = moved
        return trial

    def finished(self, trial: _Trial, k: int) -> tuple[Prepared, Contact]:
        """Return the region with k modes, and the part bent onto the whole by as many."""
        side = trial.piece.prepared(k)
        few = self.part.spectrum.eigenvectors[:, : self.low] @ trial.candidate.functional_map.T
        there = nearest(trial.side.spectrum.eigenvectors, few)
        start = induced(self.part.spectrum, side.spectrum, there, self.low, self.low)
        return side, self._bent(start, trial, side, k)

    def apart(self, one: _Trial, other: _Trial) -> float:
        """Return how far the images of a point of the part are apart, on average."""
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
        mirrored, few = trial.candidate.mirrored, truncated(self.part, self.low)
        k = min(_KEPT, self.low)
        start = induced(few.spectrum, side.spectrum, around, k, k)
        C = spectral_map(few, side, start, self.low)[0].functional_map
        return _Trial(piece, side, scored(few, side, C, mirrored))

    def _loose(self, area: float) -> Surface:
        """Return the part at an area, without mass near its border: nothing pulls it there.

        The maps to a region end at the border of the region, right or wrong; the border of a bent
        part shall be where the rest of it says.
        """
        surface, mesh = self.part.surface, self.part.surface.mesh
        border = mesh.boundary_vertices
        depth = dijkstra(edge_graph(mesh), directed=False, indices=border, min_only=True)
        held = depth >= min(_LOOSE, np.median(depth))
        return replace(surface, points=surface.points * area**0.5, mass=surface.mass * area * held)

    def _bent(self, start: Floats, trial: _Trial, side: Prepared, k: int) -> Contact:
        """Bend the part onto the whole, at the size of the region, from a map to the region."""
        way_there = spectral_map(self.part, side, start, k)[1]
        return contact(
            self._loose(trial.piece.area),
            self.whole.surface,
            trial.piece.vertices[way_there],
            mirrored=trial.candidate.mirrored,
            rounds=self.options.rounds,
            bends=_BENDS,
        )


def covered_by(part: Prepared, whole: Prepared, bent: Contact) -> Bools:
    """Tell which points of the whole lie on the part that was bent onto it.

    Not those that are beyond its border where that is nearest, by more than half the step from the
    neighbours to the border, or farther off than the reach; nor pieces of the rest that the part
    itself hardly touches.
    """
    mesh, points = part.surface.mesh, whole.surface.points
    steps = neighbours(mesh.faces, mesh.n)
    middle = (steps @ bent.points) / (steps @ np.ones(mesh.n))[:, None]
    border = np.isin(np.arange(mesh.n), mesh.boundary_vertices)
    there = bent.points[bent.back]
    outwards = there - middle[bent.back]
    step = ((points - there - 0.5 * outwards) * outwards).sum(axis=1)
    beyond = border[bent.back] & (step > 0)
    near = np.flatnonzero(~beyond & (np.linalg.norm(points - there, axis=1) < _REACH))
    links = neighbours(whole.surface.mesh.faces, len(points))
    _, piece = connected_components(links[near][:, near], directed=False)
    touched = np.zeros(len(points))
    touched[bent.there] = 1.0
    touched = ((links @ touched + touched) > 0)[near]
    mass = whole.spectrum.mass[near]
    share = np.bincount(piece, mass * touched) / np.bincount(piece, mass)
    covered = np.zeros(len(points), dtype=bool)
    covered[near] = share[piece] > 0.5
    return covered


def _extended(a: Spectrum, b: Spectrum, point_map: Ints, covered: Bools, k: int) -> Floats:
    """Return the functional map of functions that are 0 where nothing is covered, (k, k)."""
    rows = b._weighed(b.eigenvectors[:, :k])[covered]
    return np.asarray(rows.T @ a.eigenvectors[point_map[covered], :k])


# --- regions -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Region:
    """A connected region of a surface as a mesh of its own."""

    mesh: TriangleMesh
    vertices: Ints  # (n,): of the surface, ascending
    area: float  # of the surface's 1

    def prepared(self, k: int) -> Prepared:
        """Return it with k modes of its own, to be matched on all its points."""
        return prepared(spectrum(self.mesh, k), self.mesh).on_all_points()


def region(whole: Prepared, kept: Bools) -> Region | None:
    """Return the largest piece of the triangles with at least two corners kept, if there is one.

    Not of those with three: they would all lie on one side of the line between the vertices.
    """
    mesh = whole.surface.mesh
    faces = mesh.faces[kept[mesh.faces].sum(axis=1) >= 2]
    if not len(faces):
        return None
    return _piece(whole, TriangleMesh(mesh.points, faces))


def _piece(whole: Prepared, mesh: TriangleMesh) -> Region:
    """Return the largest piece of a mesh of some of the triangles of a whole."""
    piece = largest_component(mesh)
    return Region(piece.mesh, piece.vertex_index, piece.mesh.area / whole.surface.mesh.area)


def likely_regions(part: Prepared, whole: Prepared, count: int) -> list[Region]:
    """Return `count` regions of the whole, or all there are: those likest to the part.

    By the mean difference of the logarithms of wave kernel signatures, the lowest with the lowest,
    the next with the next, and by that of eigenvalues; in turn, the likest first. Regions of a
    family differ in their area alone, so each names one by each measure. The whole is a family.
    """
    k = min(_COMPARED, part.spectrum.k, whole.spectrum.k)
    wanted = _seen(part.spectrum.truncate(k))

    cotan_laplacian(whole.surface.mesh)  # refuses triangles without cotangents, once for all

    def unlikeness(piece: Region) -> tuple[float, float]:
        corners = piece.mesh.points, np.array(piece.mesh.faces)
        stiffness, mass = -igl.cotmatrix(*corners), igl.massmatrix(*corners).diagonal()
        basis = whole.spectrum.eigenvectors[piece.vertices, :_RITZ]
        pairs = ritz_pairs(stiffness, mass, basis, k, rank_tol=_DEPENDENT)
        if len(pairs.eigenvalues) < k:  # too small for the modes of the whole to tell
            return np.inf, np.inf
        values = np.append(0.0, pairs.eigenvalues[1:])
        found = Spectrum(values, pairs.eigenvectors, mass)
        seen = _seen(found.rescale(found.area**-0.5))
        return float(np.abs(seen[0] - wanted[0]).mean()), float(np.abs(seen[1] - wanted[1]).mean())

    families = [family for family in _families(whole) if family]
    measured = [[(unlikeness(piece), piece) for piece in family] for family in families]
    ranked = []
    for way in (0, 1):
        best = [min(family, key=lambda found: found[0][way]) for family in measured]
        ranked.append([piece for _, piece in sorted(best, key=lambda found: found[0][way])])
    in_turn = [piece for pair in zip(*ranked, strict=True) for piece in pair]
    return list(dict.fromkeys(in_turn))[:count]


def _seen(unit: Spectrum) -> tuple[Floats, Floats]:
    """Return the logarithms that are compared: of `_signatures`, and of eigenvalues."""
    return np.log(_signatures(unit)), np.log(unit.eigenvalues[1:_FEW])


def _signatures(unit: Spectrum) -> Floats:
    """Return quantiles of wave kernel signatures over the area, (q, e), for each energy."""
    signatures = wave_kernel_signature(unit, count=_ENERGIES)
    order = np.argsort(signatures, axis=0)
    ranked = np.take_along_axis(signatures, order, axis=0)
    shares = np.cumsum(unit.mass[order], axis=0) / unit.area
    at = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    columns = [np.interp(at, x, y) for x, y in zip(shares.T, ranked.T, strict=True)]
    return np.column_stack(columns)


def limb_ends(whole: Prepared) -> Ints:
    """Return the points at the ends of limbs, the farthest from all others first.

    Local maxima of the mean squared biharmonic distance to all points, which is
    ``sum(u^2 / lambda^2)`` over the modes and a constant; see `features.biharmonic_distances`.
    """
    spectrum = whole.spectrum.nonzero()
    far = ((spectrum.eigenvectors / spectrum.eigenvalues) ** 2).sum(axis=1)
    graph = edge_graph(whole.surface.mesh)
    around = np.maximum.reduceat(far[graph.indices], graph.indptr[:-1])
    tops = np.flatnonzero(far >= around)
    tops = tops[np.argsort(-far[tops], kind="stable")]
    apart = dijkstra(graph, directed=False, indices=tops)[:, tops]
    ends: list[int] = []
    for i in range(len(tops)):
        if (apart[i, ends] > _BETWEEN).all():
            ends.append(i)
    return tops[ends[:_ENDS]]


def _families(whole: Prepared) -> Iterator[list[Region]]:
    """Yield the whole, then regions beyond, and within, a distance of one or two ends of limbs."""
    yield [_piece(whole, whole.surface.mesh)]
    mass, graph = whole.spectrum.mass, edge_graph(whole.surface.mesh)
    ends = limb_ends(whole)
    distances = dijkstra(graph, directed=False, indices=ends)
    for count in (1, 2):
        for chosen in combinations(range(len(ends)), count):
            order = np.argsort(distances[list(chosen)].min(axis=0), kind="stable")
            place = np.empty(len(order))
            place[order] = np.cumsum(mass[order])
            for kept in (place[None] > _SHARES[:, None], place[None] <= _SHARES[:, None]):
                pieces = (region(whole, row) for row in kept)
                wanted = kept @ mass
                yield [
                    piece
                    for piece, area in zip(pieces, wanted, strict=True)
                    if piece is not None
                    and piece.area > 0.9 * area
                    and len(piece.vertices) >= LEAST_POINTS
                ]
