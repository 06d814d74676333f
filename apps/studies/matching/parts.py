r"""Match FAUST bodies without an arm, a leg or the lower half against other persons in other poses.

    python apps/studies/run.py parts OUT                  # 60 pairs of bodies 40-79
    python apps/studies/run.py parts OUT --persons 0 2 --pairs 9
    python apps/studies/run.py parts OUT --both 20        # both bodies of a pair are cut
    python apps/studies/run.py parts OUT --scenes 10      # several bodies, part by part

Errors are those of all landmarks that both bodies have left, found covered or not, along edges of
the uncut body, in hundredths of the root of its area; overlaps are of what is covered with what is
left, by area.

A cut is a plane in the reference body, `REFERENCE` of the data set, which stands upright at height
1. The landmarks that all bodies share carry it to the others, whatever their poses.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from spectra_kit import prepare, spectrum
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.geodesics import edge_graph, pair_distances
from spectra_kit.geometry import TriangleMesh, largest_component
from spectra_kit.maps import match_part
from studies.machine import describe_machine
from studies.matching.subjects import Subject, subjects_in
from studies.report import Table, write_report
from studies.shapes import given_folder
from studies.store import Record, Store
from studies.study import Result, Study, run

REFERENCE = "tr_reg_000"
_TILT = 15.0  # degrees, the most by which a plane leans
#: From where the plane may stand, to where, and the ends of what it takes off, in the reference.
_AXES = {
    "arm": (
        ((0.125, 0.78, 0.10), (0.095, 0.68, 0.08), ((0.02, 0.41, 0.11),)),
        ((0.355, 0.78, 0.10), (0.385, 0.68, 0.08), ((0.44, 0.39, 0.10),)),
    ),
    "leg": (
        ((0.185, 0.46, 0.10), (0.185, 0.33, 0.09), ((0.165, 0.01, 0.12),)),
        ((0.295, 0.46, 0.10), (0.305, 0.33, 0.09), ((0.32, 0.01, 0.12),)),
    ),
    "half": (
        ((0.24, 0.60, 0.12), (0.24, 0.50, 0.12), ((0.165, 0.01, 0.12), (0.32, 0.01, 0.12))),
    ),
}  # fmt: skip
KINDS = tuple(_AXES)  #: What is taken off: the half is the lower one.


@dataclass(frozen=True, eq=False)
class Part:
    """What is left of a body, and which of its vertices each vertex is."""

    mesh: TriangleMesh
    vertices: Ints  #: (n,): ascending


class CutPair(NamedTuple):
    """Numbers of two FAUST bodies, the first of which is cut, and the cut."""

    part: int
    whole: int
    kind: str
    seed: int

    def __str__(self) -> str:
        return f"{self.part:03d}-{self.whole:03d}-{self.kind}-{self.seed}"


def cut_pairs(persons: Sequence[int], count: int, *, seed: int = 0) -> list[CutPair]:
    """Draw bodies of different persons in different poses, kinds of cuts in turn.

    Body 10 p + q is person p in pose q. A larger number adds pairs to those of a smaller one.
    """
    rng, pairs = np.random.default_rng(seed), []
    for i in range(count):
        (one, other), (pose, another) = rng.permutation(persons)[:2], rng.permutation(10)[:2]
        kind = KINDS[i % len(KINDS)]
        pairs.append(CutPair(int(10 * one + pose), int(10 * other + another), kind, i))
    return pairs


def cut_landmarks(reference: Subject, kind: str, seed: int) -> Bools:
    """Choose a cut of a kind, and tell which landmarks are left, (c,).

    Seeds choose the side, where on its stretch the plane stands, and how it leans, by up to 15
    degrees. What lies beyond it and hangs together with the hand, the foot or the feet is taken.
    """
    rng = np.random.default_rng([KINDS.index(kind), seed])
    sides = _AXES[kind]
    first, last, ends = sides[rng.integers(len(sides))]
    start, stop = np.array(first), np.array(last)
    axis = (stop - start) / np.linalg.norm(stop - start)
    place = start + rng.uniform() * (stop - start)
    sideways = np.cross(axis, rng.normal(size=3))
    sideways *= np.tan(np.radians(_TILT * rng.uniform())) / np.linalg.norm(sideways)
    points = reference.mesh.points
    beyond = (points - place) @ (axis + sideways) > 0
    graph = edge_graph(reference.mesh)
    inside = sparse.diags_array(beyond.astype(np.float64))
    _, piece = connected_components(sparse.csr_array(inside @ graph @ inside), directed=False)
    tips = [int(((points - end) ** 2).sum(axis=1).argmin()) for end in ends]
    left: Bools = ~(beyond & np.isin(piece, piece[tips]))
    return left[reference.landmarks]


def left_of(subject: Subject, kept: Bools) -> Bools:
    """Tell which vertices of a subject are left where these landmarks are, (n,).

    Each vertex follows the landmark that is nearest along the edges.
    """
    _, _, nearest = dijkstra(
        edge_graph(subject.mesh),
        directed=False,
        indices=np.unique(subject.landmarks),
        min_only=True,
        return_predecessors=True,
    )
    votes = np.zeros(subject.mesh.n)
    np.add.at(votes, subject.landmarks, np.where(kept, 1.0, -1.0))
    return np.asarray(votes[nearest] >= 0)


def part_of(subject: Subject, kept: Bools) -> Part:
    """Cut a subject: the largest piece of the faces whose corners are all left."""
    left = left_of(subject, kept)
    faces = subject.mesh.faces[left[subject.mesh.faces].all(axis=1)]
    whole = TriangleMesh(subject.mesh.points, faces)
    piece = largest_component(whole)
    return Part(piece.mesh, piece.vertex_index)


def overlap(one: Bools, other: Bools, mass: Floats) -> float:
    """Return the intersection over the union of two regions, by area."""
    return float(mass[one & other].sum() / mass[one | other].sum())


# --- the study ---

MODES = 200  #: Of parts and wholes.


@dataclass(frozen=True, eq=False, kw_only=True)
class Parts(Study[str, CutPair]):
    """Maps of parts to whole bodies: mean error, overlap of what is covered, doubts."""

    name = "part"
    fresh = False
    contenders: Sequence[str] = ("match_part",)
    subjects: Mapping[str, Subject]

    def _bodies(self, pair: CutPair) -> tuple[Subject, Subject]:
        return self.subjects[f"tr_reg_{pair.part:03d}"], self.subjects[f"tr_reg_{pair.whole:03d}"]

    def facts(self, contender: str, problem: CutPair) -> dict[str, object]:
        bodies = (self.subjects[REFERENCE], *self._bodies(problem))
        cut = {"kind": problem.kind, "seed": problem.seed, "modes": MODES}
        return {"bodies": [body.digest for body in bodies], **cut}

    def measure(self, contender: str, problem: CutPair) -> Record:
        one, other = self._bodies(problem)
        kept = cut_landmarks(self.subjects[REFERENCE], problem.kind, problem.seed)
        piece, left = part_of(one, kept), left_of(other, kept)
        part, whole = (prepare(spectrum(m, MODES), m) for m in (piece.mesh, other.mesh))
        start = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DoubtfulMatchWarning)
            found = match_part(part, whole)
        seconds = time.process_time() - start
        both = kept & left[other.landmarks] & np.isin(one.landmarks, piece.vertices)
        places = piece.vertices[found.point_map[other.landmarks[both]]]
        errors = pair_distances(one.mesh, one.landmarks[both], places)
        return {
            "kind": problem.kind,
            "error": 100 * float(errors.mean()) / one.mesh.area**0.5,
            "overlap": overlap(np.asarray(found.covered), left, whole.spectrum.mass),
            "margin": found.margin,
            "score": found.score,
            "doubts": list(found.doubts),
            "cpu_seconds": seconds,
        }


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--data", type=Path, help="default: $SPECTRA_KIT_DATA/faust_r")
    add("--animals", type=Path, help="of scenes; default: $SPECTRA_KIT_DATA/smal_r")
    add("--persons", type=int, nargs="+", default=[4, 5, 6, 7], metavar="P")
    add("--pairs", type=int, default=60, metavar="N")
    add("--both", type=int, metavar="N", help="cut both bodies, and add N pairs that share nothing")
    add("--scenes", type=int, metavar="N", help="match scenes of several bodies instead, N pairs")
    names = "match", "match_part", "through"
    add("--by", nargs="+", choices=names, help="where both are cut; default: all")
    add("--seed", type=int, default=0, help="of the draw (%(default)s)")


def measure(args: argparse.Namespace) -> bool:
    """Match and report; return whether there is a result."""
    subjects = subjects_in(given_folder(args.data, "faust_r"))
    if args.scenes is not None:
        from studies.matching.scenes import measure_scenes

        animals = subjects_in(given_folder(args.animals, "smal_r"))
        return measure_scenes(args, {**subjects, **animals})
    if args.both is not None:
        from studies.matching.both_cut import measure_both

        return measure_both(args, subjects)
    pairs = cut_pairs(args.persons, args.pairs, seed=args.seed)
    study = Parts(folder=args.out, problems=pairs, subjects=subjects)
    results = run(study, Store(args.out), jobs=0, retry=True, progress=True)
    columns = {"cut": "", "pairs": "d", "CPU s": ".1f"}
    columns |= {f"{name} error": ".2f" for name in _FIGURES}
    columns |= {f"{name} overlap": ".3f" for name in _FIGURES}
    tables = [Table("By the cut", summarize(results), columns)]
    write_report(args.out, "parts", results, tables, describe_machine())
    return any(result.ok for result in results)


_FIGURES = ("median", "mean", "worst")


def summarize(results: Sequence[Result[str, CutPair]]) -> list[Record]:
    """Return median, mean and worst of errors and overlaps, for each kind and for all."""
    rows = []
    for kind in (*KINDS, "all"):
        some = [r.record for r in results if r.ok and kind in (r.record["kind"], "all")]
        if some:
            e, o, s = (np.array([r[x] for r in some]) for x in ("error", "overlap", "cpu_seconds"))
            row = {"cut": kind, "pairs": len(some), "CPU s": np.median(s)}
            for values, worst, what in ((e, e.max(), "error"), (o, o.min(), "overlap")):
                told = (np.median(values), values.mean(), worst)
                row |= {f"{name} {what}": x for name, x in zip(_FIGURES, told, strict=True)}
            rows.append(row)
    return rows
