"""Match scenes of several bodies, part by part: `parts --scenes`.

A scene is a FAUST body and an animal of SMAL, side by side; its partner has others of the same
kinds, in any order, with a speck beside them. In every second pair the source has two animals of
different kinds instead, and the body no partner.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.geodesics import pair_distances
from spectra_kit.geometry import TriangleMesh, sphere
from spectra_kit.maps import match_components
from studies.machine import describe_machine
from studies.matching.subjects import Subject, truth_between
from studies.report import Table, write_report
from studies.store import Record, Store
from studies.study import Study, run

#: Kind -> what the names of its subjects hold.
KINDS = {"person": "tr_reg", "hippo": "hippo", "cow": "cow", "lion": "lion", "dog": "dog"}


class ScenePair(NamedTuple):
    """Names of the subjects of both scenes."""

    source: tuple[str, ...]
    target: tuple[str, ...]

    def __str__(self) -> str:
        return "--".join("+".join(side) for side in self)


def kind_of(name: str) -> str | None:
    """Return the kind of a subject, by its name."""
    return next((kind for kind, held in KINDS.items() if held in name.lower()), None)


def scene_pairs(names: Sequence[str], count: int, *, seed: int = 0) -> list[ScenePair]:
    """Draw pairs of scenes; a larger number adds pairs to those of a smaller one."""
    rng, pairs = np.random.default_rng(seed), []
    of = {kind: [name for name in names if kind_of(name) == kind] for kind in KINDS}
    animals = [kind for kind in KINDS if kind != "person"]
    for i in range(count):
        animal, another = rng.permutation(animals)[:2]
        drawn = [[str(name) for name in rng.permutation(of[k])[:2]] for k in ("person", animal)]
        here, there = (list(side) for side in zip(*drawn, strict=True))
        if i % 2:
            here[0] = str(rng.choice(of[another]))
        if rng.integers(2):
            there.reverse()
        pairs.append(ScenePair(tuple(here), tuple(there)))
    return pairs


def scene(subjects: Sequence[Subject]) -> TriangleMesh:
    """Stand subjects side by side, each at unit area."""
    points, faces, n = [], [], 0
    for i, subject in enumerate(subjects):
        mesh = subject.mesh
        points.append(mesh.points / np.sqrt(mesh.area) + [3.0 * i, 0, 0])
        faces.append(mesh.faces + n)
        n += mesh.n
    return TriangleMesh(np.vstack(points), np.vstack(faces))


@dataclass(frozen=True, eq=False, kw_only=True)
class Scenes(Study[str, ScenePair]):
    """Maps between scenes: which parts get which partner, and the errors of the right ones."""

    name = "scene"
    fresh = False
    contenders: Sequence[str] = ("match_components",)
    subjects: Mapping[str, Subject]

    def facts(self, contender: str, problem: ScenePair) -> dict[str, object]:
        return {"bodies": [[self.subjects[name].digest for name in side] for side in problem]}

    def measure(self, contender: str, problem: ScenePair) -> Record:
        here, there = ([self.subjects[name] for name in side] for side in problem)
        source, target = scene(here), scene(there)
        speck = sphere(subdivisions=1).geometry
        target = TriangleMesh(
            np.vstack([target.points, 0.02 * speck.points - 2]),
            np.vstack([target.faces, speck.faces + target.n]),
        )
        start = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DoubtfulMatchWarning)
            found = match_components(source, target)
        record: Record = {"cpu_seconds": time.process_time() - start, "parts": []}
        kinds = [kind_of(subject.name) for subject in here]
        first = np.cumsum([0, *(subject.mesh.n for subject in here)])
        second = np.cumsum([0, *(subject.mesh.n for subject in there)])
        for j, subject in enumerate(there):
            kind = kind_of(subject.name)
            wanted = kinds.index(kind) if kind in kinds else -1
            told: Record = {"kind": kind, "wanted": wanted, "found": int(found.partner[j])}
            told["confidence"] = float(found.confidence[j])
            if wanted >= 0 and (wanted, j) in found.matches:
                truth = truth_between(here[wanted], subject)
                at = found.matches[wanted, j].point_map[truth.target]
                if found.partner[j] >= 0:
                    at = found.point_map[second[j] + truth.target] - first[wanted]
                apart = pair_distances(here[wanted].mesh, truth.source, at)
                told["error"] = 100 * float(apart.mean()) / here[wanted].mesh.area ** 0.5
            record["parts"].append(told)
        record["speck"] = int(found.partner[-1])
        return record


def measure_scenes(args: argparse.Namespace, subjects: Mapping[str, Subject]) -> bool:
    """Do the same of scenes."""
    pairs = scene_pairs(list(subjects), args.scenes, seed=args.seed)
    study = Scenes(folder=args.out, problems=pairs, subjects=subjects)
    results = run(study, Store(args.out), jobs=0, retry=True, progress=True)
    records = [result.record for result in results if result.ok]
    parts = [part for record in records for part in record["parts"]]
    some = [part for part in parts if part["wanted"] >= 0]
    groups = {kind: [part for part in some if part["kind"] == kind] for kind in KINDS}
    groups |= {"all": some, "without a partner": [p for p in parts if p["wanted"] < 0]}
    rows = [{"kind": kind, **_summary(group)} for kind, group in groups.items()]
    columns = {"kind": "", **dict.fromkeys(("parts", "right", "none", "wrong"), "d")}
    columns |= dict.fromkeys(("median error", "worst error", "confidence"), ".2f")
    write_report(args.out, "scenes", results, [Table("Parts", rows, columns)], describe_machine())
    return bool(records)


def _summary(parts: Sequence[Record]) -> Record:
    """Return how many got the right partner, none, or a wrong one, and errors of the first."""
    found = [(p["found"] == p["wanted"], p["found"] < 0) for p in parts]
    errors = [p["error"] for p in parts if p["found"] == p["wanted"] and "error" in p]
    row: Record = {
        "parts": len(parts),
        "right": sum(right for right, _ in found),
        "none": sum(none and not right for right, none in found),
        "wrong": sum(not right and not none for right, none in found),
    }
    if parts:
        row["confidence"] = np.median([p["confidence"] for p in parts])
    if errors:
        row |= {"median error": np.median(errors), "worst error": max(errors)}
    return row
