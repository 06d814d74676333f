"""Match FAUST bodies both of which are cut: `parts --both`.

Planes and balls cut the reference body, and landmarks carry the cuts, as in `parts`. All bodies
are brought to one area before, so that parts share a unit. Errors are those of all landmarks that
both have left, found covered or not; overlaps those of what is covered, of either side, with what
both have.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra

from spectra_kit import prepare, spectrum
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.geodesics import edge_graph, pair_distances
from spectra_kit.geometry import TriangleMesh
from spectra_kit.maps import Carrier, Match, Prepared, match, match_part
from studies.machine import describe_machine
from studies.matching.parts import (
    KINDS,
    MODES,
    REFERENCE,
    cut_pairs,
    left_of,
    overlap,
    part_of,
)
from studies.matching.subjects import Subject
from studies.report import Table, write_report
from studies.shapes import vertex_areas
from studies.store import Record, Store
from studies.study import Result, Study, run

CONTENDERS = ("match", "match_part", "through")  #: The last with both parts on a third, whole body.
BOTH = ("planes", "balls", "disjoint")  #: How both bodies of a pair are cut.


class Found(NamedTuple):
    """What is told of two parts."""

    point_map: Ints  #: (n2,): -1 where nothing is known
    reached: Bools  #: (n1,): which points of the source the target has as well
    covered: Bools  #: (n2,): which points of the target the source has as well
    confidence: float
    convincing: bool


def found_alone(
    function: Callable[..., Match], source: TriangleMesh, target: TriangleMesh
) -> Found:
    """Match two parts by what knows of wholes alone."""
    found = function(source, target)
    covered = np.ones(target.n, dtype=bool) if found.covered is None else found.covered
    reached = np.zeros(source.n, dtype=bool)
    reached[found.point_map[covered]] = True
    return Found(found.point_map, reached, covered, found.confidence, found.convincing)


def found_through(whole: Prepared, body: TriangleMesh, *parts: TriangleMesh) -> Found:
    """Match two parts with a whole of their kind, and go through it from one to the other."""
    found = [match_part(prepare(spectrum(part, MODES), part), whole) for part in parts]
    one, other = (Carrier(part, body, to) for part, to in zip(parts, found, strict=True))
    convincing = all(match.convincing for match in found)
    confidence = min(match.confidence for match in found)
    if not (one.known & other.known).any():
        reached, covered = (np.zeros(part.n, dtype=bool) for part in parts)
        return Found(np.full(parts[1].n, -1), reached, covered, confidence, False)
    there, back = one.then(other.back), other.then(one.back)
    point_map = np.where(there.known, np.asarray(there.places.argmax(axis=1)).ravel(), -1)
    return Found(point_map, back.known, there.known, confidence, convincing)


class BothCut(NamedTuple):
    """Numbers of two FAUST bodies, both of which are cut, and the cuts."""

    source: int
    target: int
    kind: str
    seed: int

    def __str__(self) -> str:
        return f"{self.source:03d}-{self.target:03d}-{self.kind}-{self.seed}"


def both_cut(persons: Sequence[int], count: int, disjoint: int, *, seed: int = 0) -> list[BothCut]:
    """Draw bodies as `cut_pairs`: so many that share something, then those that do not."""
    drawn = cut_pairs(persons, count + disjoint, seed=seed)
    kinds = [BOTH[i % 2] for i in range(count)] + [BOTH[2]] * disjoint
    return [BothCut(p.part, p.whole, kind, p.seed) for p, kind in zip(drawn, kinds, strict=True)]


def both_landmarks(reference: Subject, cut: BothCut) -> tuple[Bools, Bools]:
    """Tell which landmarks are left of the source, and which of the target, (c,) each.

    Planes stand anywhere, and balls are along the surface; of each the largest piece is left, 30 to
    85 % of the area. Both share 20 to 80 % of the smaller, evenly drawn; or they lie on two sides
    of one cut, up to 15 % of the area apart.
    """
    mesh = reference.mesh
    persons = [cut.source // 10, cut.target // 10]  # the same seed cuts other persons elsewhere
    rng = np.random.default_rng([len(KINDS) + BOTH.index(cut.kind), cut.seed, *persons])
    mass = vertex_areas(mesh) / mesh.area
    graph = edge_graph(mesh)

    def ranks(balls: bool) -> Floats:
        """Return the share of the area that a cut through each vertex takes."""
        way = rng.normal(size=3)
        far = mesh.points @ way
        if balls:
            far = rng.choice([-1, 1]) * dijkstra(
                graph, directed=False, indices=rng.integers(mesh.n)
            )
        order = np.argsort(far, kind="stable")
        place = np.empty(mesh.n)
        place[order] = np.cumsum(mass[order])
        return place

    def piece(left: Bools) -> Bools:
        _, label = connected_components(graph[left][:, left], directed=False)
        out = np.zeros(mesh.n, dtype=bool)
        out[left] = label == np.bincount(label, mass[left]).argmax()
        return out

    wanted = rng.uniform(0.2, 0.8)
    while True:
        if cut.kind == "disjoint":
            place, first = ranks(bool(rng.integers(2))), rng.uniform(0.35, 0.6)
            one, other = piece(place < first), piece(place > first + rng.uniform(0, 0.15))
        else:
            one, other = (
                piece(ranks(cut.kind == "balls") < rng.uniform(0.35, 0.85)) for _ in range(2)
            )
        smaller = min(mass[one].sum(), mass[other].sum())
        shared = mass[one & other].sum() / smaller
        if smaller > 0.3 and (cut.kind == "disjoint" or abs(shared - wanted) < 0.03):
            return one[reference.landmarks], other[reference.landmarks]


# --- the study ---


@dataclass(frozen=True, eq=False, kw_only=True)
class BothParts(Study[str, BothCut]):
    """Maps between two parts: mean error on what both have, overlap of what is covered, doubts."""

    name = "both"
    fresh = False
    contenders: Sequence[str] = tuple(CONTENDERS)
    subjects: Mapping[str, Subject]

    def _bodies(self, cut: BothCut) -> tuple[Subject, Subject]:
        return self.subjects[f"tr_reg_{cut.source:03d}"], self.subjects[f"tr_reg_{cut.target:03d}"]

    def facts(self, contender: str, problem: BothCut) -> dict[str, object]:
        bodies = (self.subjects[REFERENCE], *self._bodies(problem))
        return {"bodies": [body.digest for body in bodies], "cut": list(problem), "by": contender}

    def measure(self, contender: str, problem: BothCut) -> Record:
        bodies = self._bodies(problem)
        left = both_landmarks(self.subjects[REFERENCE], problem)
        pieces = [part_of(body, kept) for body, kept in zip(bodies, left, strict=True)]
        meshes = [piece.mesh for piece in pieces]
        start = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DoubtfulMatchWarning)
            if contender == "through":
                whole = self.subjects[REFERENCE].mesh
                found = found_through(prepare(spectrum(whole, MODES), whole), whole, *meshes)
            else:
                function = match if contender == "match" else match_part
                found = found_alone(function, *meshes)
        seconds = time.process_time() - start
        places = []
        for body, piece in zip(bodies, pieces, strict=True):
            place = np.full(body.mesh.n, -1)
            place[piece.vertices] = np.arange(len(piece.vertices))
            places.append(place)
        marks = [place[body.landmarks] for place, body in zip(places, bodies, strict=True)]
        both = left[0] & left[1] & (marks[0] >= 0) & (marks[1] >= 0)
        record: Record = {
            "kind": problem.kind,
            "shared": float(both.sum() / min(kept.sum() for kept in left)),
            "confidence": found.confidence,
            "convincing": found.convincing,
            "covered": float(vertex_areas(meshes[1])[found.covered].sum() / meshes[1].area),
            "cpu_seconds": seconds,
        }
        sides = zip((found.reached, found.covered), bodies, pieces, left[::-1], strict=True)
        record["overlaps"] = [
            overlap(told, left_of(body, other)[piece.vertices], vertex_areas(piece.mesh))
            for told, body, piece, other in sides
        ]
        images = found.point_map[marks[1]]
        both &= images >= 0
        if both.any():
            found_at = pieces[0].vertices[images[both]]
            errors = pair_distances(bodies[0].mesh, bodies[0].landmarks[both], found_at)
            record["error"] = 100 * float(errors.mean()) / bodies[0].mesh.area ** 0.5
        return record


_WRONG = 8.0  # mean error from which on a map is wrong


def measure_both(args: argparse.Namespace, subjects: Mapping[str, Subject]) -> bool:
    """Do the same of pairs both bodies of which are cut, all brought to one area before."""
    sized = {
        name: replace(body, geometry=body.mesh.with_points(body.mesh.points / body.mesh.area**0.5))
        for name, body in subjects.items()
    }
    pairs = both_cut(args.persons, args.pairs, args.both, seed=args.seed)
    contenders = tuple(args.by or CONTENDERS)
    study = BothParts(folder=args.out, problems=pairs, subjects=sized, contenders=contenders)
    results = run(study, Store(args.out), jobs=0, retry=True, progress=True)
    columns = dict.fromkeys(("median", "mean", "worst"), ".1f") | {"overlap": ".2f"}
    whole = dict.fromkeys(("pairs", "right", "wrong", "wrong below 0.5", "convincing wrong"), "d")
    columns = {"by": "", "cut": "", **whole, **columns, "CPU s": ".1f"}
    tables = [Table("By the cut", summarize_both(results), columns)]
    write_report(args.out, "both", results, tables, describe_machine())
    return any(result.ok for result in results)


def summarize_both(results: Sequence[Result[str, BothCut]]) -> list[Record]:
    """Return how many maps were right, what was told of wrong ones, errors and overlaps.

    Of bodies that share nothing every map is wrong; the overlap is the median of both sides.
    """
    rows = []
    for by, kind in product(dict.fromkeys(r.contender for r in results), BOTH):
        some = [r.record for r in results if r.ok and (r.contender, kind) == (by, r.problem.kind)]
        errors = np.array([r.get("error", np.inf) for r in some])
        wrong = [r for r, error in zip(some, errors, strict=True) if error >= _WRONG]
        if some:
            row = {
                "by": by,
                "cut": kind,
                "pairs": len(some),
                "right": len(some) - len(wrong),
                "wrong": len(wrong),
                "wrong below 0.5": sum(r["confidence"] < 0.5 for r in wrong),
                "convincing wrong": sum(r["convincing"] for r in wrong),
                "CPU s": np.median([r["cpu_seconds"] for r in some]),
            }
            if kind != "disjoint":
                row |= {"median": np.median(errors), "mean": errors.mean(), "worst": errors.max()}
                row["overlap"] = np.median([r["overlaps"] for r in some])
            rows.append(row)
    return rows
