"""An attempt at parts of which neither holds the other: pairs of likely regions, matched as wholes.

Regions of either part, as `match_part` tries them, and what lies near to its border or far from it,
are paired by their eigenvalues and signatures, in one unit; the likest pairs are matched as wholes.
The best are followed: one part is bent onto the other, and where either lies on the other beyond no
border is the next pair of regions.

Not in the package, as it is wrong too often: right, within 8 hundredths, in two of four pairs of
bodies 0-39 with which it was made, and in two of four of bodies 40-79, at 3.4 and 4.9; of the
others one covers what is right at an error of 15, and has a confidence of 0.95. A disjoint pair had
0.02. What is missing are likelier pairs of regions. 30 CPU seconds a pair.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import igl
import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra

from spectra_kit import spectrum
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._sparse.ritz import ritz_pairs
from spectra_kit.eigen import Spectrum
from spectra_kit.features import wave_kernel_signature
from spectra_kit.geodesics import edge_graph
from spectra_kit.geometry import TriangleMesh
from spectra_kit.maps import Candidate, MatchOptions, Prepared, prepare
from spectra_kit.maps.convert import induced
from spectra_kit.maps.deform import contact
from spectra_kit.maps.match import spectral_map
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.partial import Region, limb_ends, region
from spectra_kit.maps.score import scored
from spectra_kit.maps.search import Search
from spectra_kit.maps.subsample import neighbours
from spectra_kit.maps.surface import Surface

_QUICK = MatchOptions(orders=8, growing=24, turns=8, finalists=3)
_SHARES = 1 / (1 + np.exp(-np.linspace(-2.0, 1.2, 8)))  # of the area of a part
_ENDS, _RITZ, _COMPARED, _FEW, _QUANTILES = 6, 100, 30, 20, 40
_LEAST = 0.08  # area of a region, relative to the larger part
_BY_VALUES, _BY_BOTH = (
    10,
    10,
)  # pairs that are matched: likest by eigenvalues, and by signatures too
_OVERLAP = 0.75  # of two regions that are one
_FOLLOWED, _ROUNDS, _K = 6, 3, 60
_SMALL = 0.25  # exponent: small regions look alike by chance
_SMALL_END = 0.5  # the same, of where a trial leads
_DOUBTFUL, _STEEP = 0.005, 6.0
_REACH = 0.06  # of the root of the larger area: what is farther off the bent part is no partner


@dataclass(frozen=True, eq=False)
class Part:
    """A part in a common unit, at its own unit area, and its likely regions."""

    side: Prepared
    area: float  # in the common unit

    @property
    def surface(self) -> Surface:
        """The part in the common unit."""
        own = self.side.surface
        scale = self.area**0.5
        return replace(own, points=own.points * scale, mass=own.mass * self.area)


@dataclass(frozen=True, eq=False)
class Likely:
    """What a region is compared by."""

    inside: Bools
    area: float
    signatures: Floats
    values: Floats


@dataclass(frozen=True, eq=False)
class Trial:
    """A pair of regions and a map between them; `there` is where the bent source lies."""

    regions: tuple[Region, Region]
    sides: tuple[Prepared, Prepared]
    candidate: Candidate
    area: float

    @property
    def value(self) -> float:
        return float(self.candidate.score / self.area**_SMALL)


@dataclass(frozen=True, eq=False)
class Answer:
    """What is common to two parts."""

    point_map: Ints
    source_covered: Bools
    covered: Bools
    score: float
    cost: float  # see `_cost`
    area: float
    margin: float
    gap: float

    @property
    def confidence(self) -> float:
        """How likely it is right: a logistic of the cost alone, set by eye on tuning pairs."""
        return float(1 / (1 + (self.cost / _DOUBTFUL) ** _STEEP))

    @property
    def convincing(self) -> bool:
        return self.confidence >= 0.5


def match_region_pairs(source: TriangleMesh, target: TriangleMesh) -> Answer:
    """Find what two parts in one unit have in common, and which point is which."""
    unit = max(source.area, target.area)
    parts = [Part(prepare(spectrum(m, 100), m), m.area / unit) for m in (source, target)]
    trials = _trials(parts[0], parts[1])
    ends = [_followed(parts, trial) for trial in trials[:_FOLLOWED]]
    ends.sort(key=_cost)
    best, back, covered, gap = ends[0]
    rivals = [
        _cost(end)
        for end in ends[1:]
        if _share(_of(end[0], 0), _of(best, 0), parts[0]) < 0.5
        or _share(_of(end[0], 1), _of(best, 1), parts[1]) < 0.5
    ]
    cost = _cost(ends[0])
    margin = min(rivals, default=np.inf) / cost
    return Answer(back, *covered, best.candidate.score, cost, best.area, margin, gap)


def _cost(end: tuple[Trial, Ints, tuple[Bools, Bools], float]) -> float:
    """Return how unlikely an end is: a right one lies close, and is not small."""
    return float(end[0].candidate.score * end[3] / end[0].area ** _SMALL_END)


def _of(trial: Trial, which: int) -> Ints:
    return trial.regions[which].vertices


def _share(one: Ints, other: Ints, part: Part) -> float:
    mass = part.side.spectrum.mass
    both = mass[np.intersect1d(one, other)].sum()
    return float(both / (mass[one].sum() + mass[other].sum() - both))


def _likely(part: Part) -> list[Likely]:
    side, found = part.side, []
    mesh, mass, graph = side.surface.mesh, side.spectrum.mass, edge_graph(side.surface.mesh)
    ends = dijkstra(graph, directed=False, indices=limb_ends(side)[:_ENDS])
    rim = dijkstra(graph, directed=False, indices=mesh.boundary_vertices, min_only=True)
    distances = np.vstack([ends, rim])
    kept = [np.ones(mesh.n, dtype=bool)]
    for count in (1, 2):
        for chosen in combinations(range(len(distances)), count):
            order = np.argsort(distances[list(chosen)].min(axis=0), kind="stable")
            place = np.empty(len(order))
            place[order] = np.cumsum(mass[order])
            kept += [*(place > _SHARES[:, None]), *(place <= _SHARES[:, None])]
    for row in kept:
        piece = region(side, row)
        if piece is None or len(piece.vertices) < 200 or piece.area < 0.85 * mass[row].sum():
            continue
        area = piece.area * part.area
        corners = piece.mesh.points, np.array(piece.mesh.faces)
        stiffness, weights = -igl.cotmatrix(*corners), igl.massmatrix(*corners).diagonal()
        basis = side.spectrum.eigenvectors[piece.vertices, :_RITZ]
        pairs = ritz_pairs(stiffness, weights, basis, _COMPARED, rank_tol=1e-2)
        if area < _LEAST or len(pairs.eigenvalues) < _COMPARED:
            continue
        values = np.append(0.0, pairs.eigenvalues[1:])
        own = Spectrum(values, pairs.eigenvectors, weights)
        waves = np.log(wave_kernel_signature(own.rescale(own.area**-0.5), count=30))
        steps = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
        inside = np.isin(np.arange(mesh.n), piece.vertices)
        logs = np.log(values[1:_FEW] / part.area)
        found.append(Likely(inside, area, np.quantile(waves, steps, axis=0).ravel(), logs))
    return found


def _trials(source: Part, target: Part) -> list[Trial]:
    """Return the likest pairs of regions with the best map of each, the best first."""
    parts, likely = (source, target), (_likely(source), _likely(target))
    waves, values = (
        np.array([np.abs(others - getattr(one, name)).mean(axis=1) for one in likely[0]])
        for name in ("signatures", "values")
        for others in [np.array([getattr(other, name) for other in likely[1]])]
    )
    picked: list[tuple[int, int]] = []

    def new(i: int, j: int) -> bool:
        return all(
            any(
                _share(np.flatnonzero(side[x].inside), np.flatnonzero(side[y].inside), part)
                < _OVERLAP
                for side, part, x, y in zip(likely, parts, (i, j), other, strict=True)
            )
            for other in picked
        )

    both = waves / waves.std() + values / values.std()
    for unlike, count in ((values, _BY_VALUES), (both, _BY_BOTH)):
        stop = len(picked) + count
        for at in np.argsort(unlike, axis=None)[:6000]:
            i, j = divmod(int(at), unlike.shape[1])
            if len(picked) < stop and new(i, j):
                picked.append((i, j))
    trials = []
    for pair in picked:
        pieces = [
            region(part.side, found[at].inside)
            for part, found, at in zip(parts, likely, pair, strict=True)
        ]
        if pieces[0] is not None and pieces[1] is not None:
            sides = pieces[0].prepared(_K), pieces[1].prepared(_K)
            candidate = Search(*sides, None, _QUICK).candidates(False)[0]
            trials.append(_trial(parts, (pieces[0], pieces[1]), sides, candidate))
    return sorted(trials, key=lambda trial: trial.value)


def _trial(
    parts: tuple[Part, Part] | list[Part],
    pieces: tuple[Region, Region],
    sides: tuple[Prepared, Prepared],
    candidate: Candidate,
) -> Trial:
    areas = [piece.area * part.area for piece, part in zip(pieces, parts, strict=True)]
    return Trial(pieces, sides, candidate, min(areas))


def _followed(parts: list[Part], trial: Trial) -> tuple[Trial, Ints, tuple[Bools, Bools], float]:
    """Return where a trial leads, the map it ends in, what is covered, and the gap left there."""
    best = trial, *_bent(parts, trial)[1:]
    end: tuple[Trial, Ints, tuple[Bools, Bools], float] = best
    for _ in range(_ROUNDS):
        pieces = [region(p.side, kept) for p, kept in zip(parts, end[2], strict=True)]
        if any(piece is None or len(piece.vertices) < 200 for piece in pieces):
            break
        one, other = pieces
        assert one is not None
        assert other is not None
        sides = one.prepared(_K), other.prepared(_K)
        place = np.full(parts[0].side.spectrum.n, -1)
        place[one.vertices] = np.arange(len(one.vertices))
        tree = nearest(parts[0].surface.points[end[1][other.vertices]], one.mesh.points)
        around = place[end[1][other.vertices]]
        around = np.where(around >= 0, around, tree)
        start = induced(sides[0].spectrum, sides[1].spectrum, around, 40, 40)
        C = spectral_map(*sides, start, _K)[0].functional_map
        moved = _trial(parts, (one, other), sides, scored(*sides, C, False))
        end = moved, *_bent(parts, moved)[1:]
        best = min(best, end, key=_cost)
    return best


def _bent(parts: list[Part], trial: Trial) -> tuple[Floats, Ints, tuple[Bools, Bools], float]:
    """Bend the source onto the target where the regions meet; tell what lies on each other."""
    (one, other), sides = trial.regions, trial.sides
    C = trial.candidate.functional_map
    way = other.vertices[spectral_map(*sides, C[:30, :30], _K)[1]]
    source, target = parts[0].surface, parts[1].surface
    there = np.zeros(len(source.points), dtype=np.int64)
    there[one.vertices] = way
    held = np.zeros(len(source.points))
    held[one.vertices] = 1.0
    loose = replace(source, mass=source.mass * held)
    bent = contact(loose, target, there, mirrored=False, rounds=5, bends=(30, 4))
    meshes = parts[0].side.surface.mesh, parts[1].side.surface.mesh
    covered = (
        _covered(bent.points, meshes[0], target.points, meshes[1], bent.back),
        _covered(target.points, meshes[1], bent.points, meshes[0], bent.there),
    )
    gaps = np.linalg.norm(bent.points[bent.back] - target.points, axis=1)[covered[0]]
    gap = float(gaps.mean()) if len(gaps) else np.inf
    return bent.points, bent.back, (covered[1], covered[0]), gap


def _covered(
    part: Floats, mesh: TriangleMesh, whole: Floats, other: TriangleMesh, back: Ints
) -> Bools:
    """Tell which points of a surface lie on another, near it and beyond no border of it."""
    steps = neighbours(mesh.faces, mesh.n)
    middle = (steps @ part) / (steps @ np.ones(mesh.n))[:, None]
    border = np.isin(np.arange(mesh.n), mesh.boundary_vertices)
    outwards = part[back] - middle[back]
    step = ((whole - part[back] - 0.5 * outwards) * outwards).sum(axis=1)
    on = ~(border[back] & (step > 0)) & (np.linalg.norm(whole - part[back], axis=1) < _REACH)
    at = np.flatnonzero(on)
    links = neighbours(other.faces, len(whole))
    covered = np.zeros(len(whole), dtype=bool)
    if len(at):
        _, piece = connected_components(links[at][:, at], directed=False)
        covered[at] = piece == np.bincount(piece).argmax()
    return covered
