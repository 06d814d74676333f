"""What maps carry: regions, landmarks, vectors and textures of one body on another, and back.

    python apps/studies/run.py carry OUT                  # FAUST and SMAL, twelve pairs each
    python apps/studies/run.py carry OUT --sets faust_r --pairs 4

Each pair is matched as `match(..., precise=True)` does it, without landmarks. Errors are straight
lines between where a landmark is carried to and where it is, in hundredths of the root of the area:
*map* of the map itself, at the target's landmarks, *forth* of the source's landmarks carried, and
*back* of the way back. *IoU* is of twelve regions around points far from each other, in the mean;
*right* and *wrong* are the confidence of labels that are so. *Angle* is the median one between the
carried gradient of the distance from a landmark and the gradient of the distance from where that
is, of five landmarks; *undefined* the share of vectors that are not carried. *Texture* is how far
coordinates are off, in the median, that went there and back, in hundredths of the width of the
texture; six charts with seams.
"""

from __future__ import annotations

import argparse
import warnings
from typing import Any

import numpy as np

from spectra_kit import match, prepare
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.geodesics import FacePoint, exact_distances, farthest_point_sampling
from spectra_kit.geometry import TriangleMesh
from spectra_kit.maps import Carrier
from spectra_kit.operators import gradient
from studies.machine import describe_machine
from studies.matching.subjects import Subject, subjects_in, truth_between
from studies.report import Table, write_report
from studies.shapes import given_folder
from studies.store import Record

_REGIONS, _LANDMARKS = 12, 200
_COLUMNS = {
    **{"set": "", "pair": "", "map": ".2f", "forth": ".2f", "back": ".2f", "IoU": ".3f"},
    **{"right": ".2f", "wrong": ".2f", "angle": ".1f", "undefined": ".1%", "texture": ".2f"},
}


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--sets", nargs="+", default=["faust_r", "smal_r"], help="folders of SPECTRA_KIT_DATA")
    add("--pairs", type=int, default=12, help="of each, drawn at random (%(default)s)")


def measure(args: argparse.Namespace) -> None:
    """Match, carry and report."""
    rows = list[Record]()
    for name in args.sets:
        subjects = list(subjects_in(given_folder(None, name)).values())
        rng, own = np.random.default_rng(0), list[Record]()
        for _ in range(args.pairs):
            one, other = (subjects[i] for i in rng.permutation(len(subjects))[:2])
            told: Record = {"set": name, "pair": f"{one.name} to {other.name}"}
            own.append(told | carried(one, other))
        numbers = [key for key, form in _COLUMNS.items() if form]
        rows += own
        for what, of in (("mean", np.mean), ("median", np.median)):
            row: Record = {"set": name, "pair": what}
            rows.append(row | {key: float(of([r[key] for r in own])) for key in numbers})
    tables = [Table("What is carried", rows, _COLUMNS)]
    write_report(args.out, "carry", [], tables, describe_machine())


def carried(one: Subject, other: Subject) -> Record:
    """Return what came of carrying between two subjects."""
    a, b, truth = one.mesh, other.mesh, truth_between(one, other)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtfulMatchWarning)
        found = match(prepare(a), prepare(b), precise=True)
    carrier, (there, here) = Carrier(a, b, found), (truth.source, truth.target)
    record: Record = {"map": _apart(carrier.values(a.points)[here], a.points[there], a)}
    some, five = (np.linspace(0, len(here) - 1, n).astype(int) for n in (_LANDMARKS, 5))
    places = np.array([_place(point, b) for point in carrier.landmarks(there[some])])
    record["forth"] = _apart(places, b.points[here[some]], b)
    record["back"] = _apart(carrier.back.values(b.points)[there], b.points[here], b)
    seeds = farthest_point_sampling(a, _REGIONS).tolist()
    regions = np.argmin([exact_distances(a, seed) for seed in seeds], axis=0)
    labels = carrier.labels(regions)
    true, own, sure = regions[there], labels.labels[here], labels.confidence[here]
    shares = [_iou(true == region, own == region) for region in range(_REGIONS)]
    record["IoU"] = float(np.mean(shares))
    wrong = true != own
    record |= {"right": sure[~wrong].mean(), "wrong": sure[wrong].mean() if wrong.any() else np.nan}
    return record | _vectors(carrier, there[five], here[five]) | {"texture": _texture(carrier)}


def _vectors(carrier: Carrier, source: Ints, target: Ints) -> Record:
    """Compare vectors away from some landmarks: where a body touches itself, one says little."""
    angles = []
    for points in zip(source.tolist(), target.tolist(), strict=True):
        away, there = (
            gradient(mesh, exact_distances(mesh, point))
            for mesh, point in zip((carrier.source, carrier.target), points, strict=True)
            if isinstance(mesh, TriangleMesh)
        )
        carried = carrier.vectors(away)
        cosine = np.einsum("nr,nr->n", carried, there)
        cosine /= np.linalg.norm(carried, axis=1) * np.linalg.norm(there, axis=1)
        angles.append(np.degrees(np.arccos(cosine.clip(-1, 1))))
    return {"angle": float(np.nanmedian(angles)), "undefined": float(np.isnan(angles).mean())}


def _texture(carrier: Carrier) -> float:
    """Return the median distance of coordinates that go to the target and back, in hundredths."""
    coordinates, faces = _charts(carrier.source)
    there = carrier.texture(coordinates, faces)
    known = np.nan_to_num(there).reshape(-1, 2)
    again = carrier.back.texture(known, np.arange(len(known)).reshape(-1, 3))
    apart = np.linalg.norm(again - coordinates[faces], axis=2)
    return 100 * float(np.nanmedian(apart)) / float(np.ptp(coordinates, axis=0).max())


def _charts(mesh: Any) -> tuple[Floats, Ints]:
    """Return a texture in six charts, by the side of a box that each face looks to, side by side.

    Corners of one chart share their coordinates, those of two have one each.
    """
    a, b, c = np.moveaxis(mesh.points[mesh.faces], 1, 0)
    normal, size = np.cross(b - a, c - a), np.ptp(mesh.points, axis=0).max()
    axis = np.abs(normal).argmax(axis=1)
    side = 2 * axis + (normal[np.arange(len(axis)), axis] > 0)
    named, inverse = np.unique(
        np.stack([np.repeat(side, 3), mesh.faces.ravel()]), axis=1, return_inverse=True
    )
    charts, points = named
    plane = np.array([[1, 2], [0, 2], [0, 1]])[charts // 2]
    flat = np.take_along_axis(mesh.points[points], plane, axis=1)
    return flat + 1.5 * size * charts[:, None] * [1, 0], inverse.reshape(-1, 3)


def _place(point: int | FacePoint | None, mesh: TriangleMesh) -> Floats:
    if point is None:
        return np.full(3, np.nan)
    return point.position(mesh) if isinstance(point, FacePoint) else np.array(mesh.points[point])


def _apart(points: Floats, truth: Floats, mesh: TriangleMesh) -> float:
    """Return the mean distance in hundredths of the root of the area."""
    away = np.linalg.norm(points - truth, axis=1)
    return 100 * float(np.nanmean(away)) / float(np.sqrt(mesh.area))


def _iou(one: Bools, other: Bools) -> float:
    """Return the points of both over those of either."""
    return float((one & other).sum()) / max(float((one | other).sum()), 1.0)
