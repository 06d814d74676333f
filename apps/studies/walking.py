"""Paths, vectors and curvature beside other libraries, on real models and on dirty ones.

    python apps/studies/run.py walking OUT             # ten minutes; needs SPECTRA_KIT_DATA
    python apps/studies/run.py walking OUT --models bunny spot --dirty 40
    python apps/studies/run.py walking OUT --models animal --dirty 0      # made, without data

Models are those of `ood_public`, or made ones of studies/recipes.py. Of paths: the search from one
vertex, one path after it; how far lengths are from libigl's exact distances, in the worst case, and
from those of pygeodesic, where it is installed, with the seconds of their searches for these ten;
and how much longer than the shortest those are that potpourri3d's edge flips find. Of vectors: the
set-up with the first transport, and the next, of both; and the angle between both. Of curvature:
seconds, and the rank correlation of mean curvatures with those of libigl, which fits quadrics to
five rings, and of LaPy, which takes angles between faces. Seconds are by the clock, of the quicker
of two turns.

Dirty meshes are of the training pool, with a boundary, edges of more than two faces, or several
parts. A path is right where it is as long as the exact distance; potpourri3d's, which are shortest
among their neighbours, where they are at most a hundredth longer. Vectors are right where they
are numbers wherever a path leads.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from typing import Any

import igl
import numpy as np
import potpourri3d as pp3d
from scipy.stats import spearmanr

from spectra_kit import TriangleMesh, read
from spectra_kit._core.threads import thread_count
from spectra_kit.errors import SpectraKitError
from spectra_kit.geodesics import GeodesicPaths, VectorHeat, exact_distances
from spectra_kit.neo.train.pool import open_pool
from spectra_kit.operators import curvature
from studies.machine import describe_machine
from studies.recipes import MADE
from studies.report import Table, write_report
from studies.shapes import as_mesh, given_folder
from studies.store import Record

_MODELS = ["amo", "armadillo", "boot", "bunny", "chinese_lion", "cow", "hammer", "hippo", "horse"]
_MODELS += ["spot"]
_LONGER = 1.01  # than the shortest, at which a path of flips still counts as found
_PATHS = {
    **{"model": "", "points": "d", "search s": ".1f", "path ms": ".2f", "worst ms": ".1f"},
    **{"libigl s": ".1f", "apart": ".0e", "pygeodesic s": ".1f", "apart from it": ".0e"},
    **{"flips s": ".2f", "their length": ".4f", "longest": ".4f"},
}
_VECTORS = {
    **{"model": "", "points": "d", "first s": ".2f", "theirs s": ".2f", "next ms": ".0f"},
    **{"their next ms": ".0f", "median angle": ".1f", "95 %": ".1f"},
}
_CURVATURE = {
    **{"model": "", "points": "d", "ours s": ".2f", "libigl s": ".2f", "rank correlation": ".2f"},
    **{"LaPy s": ".2f", "with LaPy's": ".2f", "not known": ".1%"},
}
_DIRTY = {"verb": "", "who": "", "right": "d", "wrong": "d", "refused": "d"}


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--models", nargs="+", default=_MODELS, help="of ood_public (default: ten of them)")
    add("--targets", type=int, default=50, help="paths from each source (%(default)s)")
    add("--dirty", type=int, default=200, help="meshes of the pool (%(default)s)")


def measure(args: argparse.Namespace) -> None:
    warnings.simplefilter("ignore")
    paths, vectors, bent = list[Record](), list[Record](), list[Record]()
    for name in args.models:
        mesh = _model(name)
        about: Record = {"model": name, "points": mesh.n}
        paths.append(about | _of_paths(mesh, args.targets))
        vectors.append(about | _of_vectors(mesh))
        bent.append(about | _of_curvature(mesh))
    machine = describe_machine(threads=thread_count(), device="cpu")
    tables = [
        Table("Paths", paths, _PATHS),
        Table("Vectors", vectors, _VECTORS),
        Table("Curvature", bent, _CURVATURE),
        Table(f"{args.dirty} dirty meshes", _of_dirt(args.dirty) if args.dirty else [], _DIRTY),
    ]
    write_report(args.out, "walking", [], tables, machine)


def _model(name: str) -> TriangleMesh:
    if name in MADE:
        return as_mesh(MADE[name].make())
    return as_mesh(read(given_folder(None, "ood_public") / f"{name}.npz", kind="mesh"))


def _of_paths(mesh: TriangleMesh, count: int) -> Record:
    source, rng = int(mesh.referenced_vertices[0]), np.random.default_rng(0)
    search, paths = _timed(lambda: GeodesicPaths(mesh, source), turns=1)
    reached = np.flatnonzero(np.isfinite(paths.distances) & (paths.distances > 0))
    ends = rng.choice(reached, count).tolist()
    took = [_timed(partial(paths.to, end))[0] for end in ends]
    record: Record = {"search s": search, "path ms": 1e3 * np.mean(took)}
    record["worst ms"] = 1e3 * np.max(took)
    record |= _exactly(mesh, source, ends[:10], paths)
    try:
        made, solver = _timed(lambda: pp3d.EdgeFlipGeodesicSolver(mesh.points, mesh.faces))
        lines = [_timed(partial(solver.find_geodesic_path, source, end)) for end in ends[:10]]
    except (RuntimeError, ValueError):  # not manifold
        return record
    longer = [_length(line) / paths.distances[e] for (_, line), e in zip(lines, ends, strict=False)]
    flips = made + np.mean([seconds for seconds, _ in lines])
    return record | {"flips s": flips, "their length": np.mean(longer), "longest": max(longer)}


def _exactly(mesh: TriangleMesh, source: int, ends: list[int], paths: GeodesicPaths) -> Record:
    """Return how far lengths are from those of other exact solvers."""
    points, faces, none = np.array(mesh.points), np.array(mesh.faces), np.empty(0, np.int64)
    where = np.array([source]), none, np.array(ends), none
    seconds, theirs = _timed(lambda: igl.exact_geodesic(points, faces, *where), turns=1)
    own = np.array([paths.to(end).length for end in ends])
    record: Record = {"libigl s": seconds, "apart": np.abs(theirs / own - 1).max()}
    if (pygeodesic := _installed("pygeodesic.geodesic")) is None:
        return record
    solver = pygeodesic.PyGeodesicAlgorithmExact(points, faces)
    both = np.array([source]), np.array(ends)
    seconds, (found, _) = _timed(lambda: solver.geodesicDistances(*both), turns=1)
    return record | {"pygeodesic s": seconds, "apart from it": np.abs(found / own - 1).max()}


def _of_vectors(mesh: TriangleMesh) -> Record:
    source, given = _with_vector(mesh)
    first, (heat, ours) = _timed(lambda: _carried(VectorHeat(mesh), source, given))
    record: Record = {"first s": first}
    record["next ms"] = 1e3 * _timed(lambda: heat.transport(source, [given]))[0]
    try:
        seconds, (solver, theirs) = _timed(lambda: _their_vectors(mesh, source, given))
    except (RuntimeError, ValueError):
        return record
    record["theirs s"] = seconds
    again = _timed(lambda: solver.transport_tangent_vector(source, [1.0, 0.0]))[0]
    cosine = np.einsum("nr,nr->n", ours, theirs)
    cosine /= np.linalg.norm(ours, axis=1) * np.linalg.norm(theirs, axis=1)
    angles = np.degrees(np.arccos(np.clip(cosine[np.isfinite(cosine)], -1, 1)))
    record |= {"their next ms": 1e3 * again, "median angle": np.median(angles)}
    return record | {"95 %": np.quantile(angles, 0.95)}


def _of_curvature(mesh: TriangleMesh) -> Record:
    ours, found = _timed(lambda: curvature(mesh))
    points, faces = np.array(mesh.points), np.array(mesh.faces)
    theirs, (_, _, larger, smaller, _) = _timed(lambda: igl.principal_curvature(points, faces))
    known = np.isfinite(found.mean)
    alike = abs(spearmanr(found.mean[known], (larger + smaller)[known]).statistic)
    record: Record = {"ours s": ours, "libigl s": theirs, "rank correlation": alike}
    record["not known"] = 1 - known.mean()
    if (lapy := _installed("lapy")) is not None:
        seconds, bent = _timed(lambda: lapy.TriaMesh(points, faces).curvature(3), turns=1)
        alike = abs(spearmanr(found.mean[known], bent[4][known]).statistic)
        record |= {"LaPy s": seconds, "with LaPy's": alike}
    return record


def _of_dirt(count: int) -> list[Record]:
    tally: dict[tuple[str, str], list[int]] = {}
    for mesh in _dirty(count):
        for key, verb in _verbs(mesh).items():
            found = tally.setdefault(key, [0, 0, 0])
            try:
                found[0 if verb() else 1] += 1
            except (SpectraKitError, RuntimeError, ValueError):
                found[2] += 1
    return [
        {"verb": verb, "who": who, "right": right, "wrong": wrong, "refused": refused}
        for (verb, who), (right, wrong, refused) in tally.items()
    ]


def _verbs(mesh: TriangleMesh) -> dict[tuple[str, str], Callable[[], bool]]:
    """Return what is asked for, of whom, and whether the answer is right."""
    source, given = _with_vector(mesh)
    truth = exact_distances(mesh, source)
    reached = np.isfinite(truth)
    end = int(np.argmax(np.where(reached, truth, -1)))

    def path() -> bool:
        length = GeodesicPaths(mesh, source, targets=[end]).to(end).length
        return bool(abs(length - truth[end]) <= 1e-8 * truth[end])

    def their_path() -> bool:
        solver = pp3d.EdgeFlipGeodesicSolver(mesh.points, mesh.faces)
        return bool(_length(solver.find_geodesic_path(source, end)) <= _LONGER * truth[end])

    def transport() -> bool:
        return bool(np.isfinite(_carried(VectorHeat(mesh), source, given)[1][reached]).all())

    def their_transport() -> bool:
        return bool(np.isfinite(_their_vectors(mesh, source, given)[1][reached]).all())

    return {
        ("path", "spectra_kit"): path,
        ("path", "potpourri3d"): their_path,
        ("transport", "spectra_kit"): transport,
        ("transport", "potpourri3d"): their_transport,
    }


def _dirty(count: int) -> Iterator[TriangleMesh]:
    pool, found = open_pool(given_folder(None, "train_pool"), "train"), 0
    for i in np.random.default_rng(0).permutation(len(pool)):
        mesh = pool.mesh(int(i))
        clean = (mesh.unique_edges[1] == 2).all() and mesh.component_labels.max() == 0
        if not clean and not (mesh.faces == np.roll(mesh.faces, 1, axis=1)).any():
            yield mesh
            found += 1
        if found == count:
            return


def _with_vector(mesh: TriangleMesh) -> tuple[int, Any]:
    """Return a vertex, and a vector along its faces."""
    face = mesh.faces[int(np.argmax(mesh.face_areas))]
    return int(face[0]), mesh.points[face[1]] - mesh.points[face[0]]


def _carried(heat: VectorHeat, source: int, vector: Any) -> tuple[VectorHeat, Any]:
    return heat, heat.transport(source, [vector])


def _their_vectors(mesh: TriangleMesh, source: int, vector: Any) -> tuple[Any, Any]:
    solver = pp3d.MeshVectorHeatSolver(mesh.points, mesh.faces)
    x, y, _ = solver.get_tangent_frames()
    found = solver.transport_tangent_vector(source, [vector @ x[source], vector @ y[source]])
    return solver, found[:, :1] * x + found[:, 1:] * y


def _installed(module: str) -> Any:
    """Return a library that is beside us if it is installed."""
    try:
        return import_module(module)
    except ImportError:
        return None


def _length(line: Any) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _timed(call: Callable[[], Any], *, turns: int = 2) -> tuple[float, Any]:
    """Return the seconds of the quickest turn, and what the last returned."""
    least, found = np.inf, None
    for _ in range(turns):
        begin = time.perf_counter()
        found = call()
        least = min(least, time.perf_counter() - begin)
    return float(least), found
