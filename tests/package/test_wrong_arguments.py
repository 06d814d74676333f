"""Whatever is passed in the place of an argument is refused by its name, or has a good result.

Every public function, constructor and method is called with good arguments, of which each in turn
is replaced by every entry of a table of wrong ones.
"""

from __future__ import annotations

import atexit
import importlib
import inspect
import pkgutil
import re
import shutil
import tempfile
import typing
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from scipy import sparse

import spectra_kit as sk
from spectra_kit import (
    datasets,
    features,
    geodesics,
    geometry,
    interop,
    learn,
    maps,
    neo,
    operators,
    show,
)
from spectra_kit._core.checked import _LATE
from spectra_kit.eigen import metrics, subspaces
from spectra_kit.errors import InvalidInputError, SpectraKitError

# Their arrays are checked by whom they serve; the command line has its own tests.
INNER = re.compile("_|catalogue|cli|errors")
PACKAGES = [name for _, name, _ in pkgutil.iter_modules(sk.__path__) if not INNER.match(name)]
# Tensors are torch's to check, where a compiler has to see through every line.
LEFT_TO_TORCH = {"NeoNetwork.forward", "NeoNetwork.features", "NeoNetwork.evaluate_chunked"}
# Called by `eigensolve`, `embed` and `train_classifier` alone, which have checked what they pass.
HOOKS = re.compile(
    r"\.eigenpairs$|\.begin$|\.of_points$|\.of_all$|\.values$|\.functions$|\.fit$|\.build$"
    r"|^(?!GivenBasis|Laplacian).*restricted$"
)


class Call(NamedTuple):
    """A public callable, and how it is called well."""

    name: str
    function: Callable[..., Any]  # of keywords alone
    good: dict[str, Any]
    owner: Any  # the instance of a method
    optional: set[str]  # arguments for which None is a value
    solvers: set[str]  # arguments that any solver may be


def public(module: Any) -> Iterator[tuple[str, Any]]:
    for name in getattr(module, "__all__", vars(module)):
        thing = getattr(module, name)
        if not name.startswith("_") and (
            inspect.isfunction(thing)
            or (inspect.isclass(thing) and not issubclass(thing, Exception | tuple | dict))
        ):
            here = hasattr(module, "__all__") or thing.__module__ == module.__name__
            if here and not getattr(thing, "_is_protocol", False):
                yield name, thing


@cache
def surface() -> dict[str, tuple[Callable[..., Any], bool]]:
    """Every public callable by name: functions, constructors, and methods, which are unbound."""
    return {name: (thing, is_method) for name, thing, is_method in _surface()}


def _surface() -> Iterator[tuple[str, Callable[..., Any], bool]]:
    seen = set()
    for module in (sk, *(importlib.import_module(f"spectra_kit.{name}") for name in PACKAGES)):
        for name, thing in public(module):
            if id(thing) in seen:
                continue
            seen.add(id(thing))
            if not HOOKS.search(name):
                yield name, thing, False
            if inspect.isclass(thing):
                for attribute, member in vars(thing).items():
                    full = f"{name}.{attribute}"
                    if attribute.startswith("_") or full in LEFT_TO_TORCH or HOOKS.search(full):
                        continue
                    if isinstance(member, classmethod):
                        yield full, getattr(thing, attribute), False
                    elif inspect.isfunction(member):
                        yield full, member, True


@cache
def examples() -> tuple[dict[str, Any], dict[str, Any]]:
    """Good arguments by name, or ``callable.name``; and one instance of each class, by its name."""
    ball = geometry.sphere(subdivisions=2).geometry
    x, y, z = ball.points.T
    mesh = ball.with_points(ball.points * (1 + 0.3 * np.sin(2 * x + y) + 0.2 * z)[:, None])
    laplacian = sk.robust_laplacian(mesh)
    spectrum = sk.eigensolve(laplacian, 40)
    n, same, identity = spectrum.n, np.arange(spectrum.n), np.eye(20)
    oriented = operators.oriented_triangles(mesh)
    slopes = operators.tangent_gradient(mesh)
    frames = operators.tangent_frames(mesh)
    triangulation = sk.intrinsic_delaunay(mesh)
    corners = np.eye(4, 3)
    tetrahedra = geometry.TetrahedralMesh(corners, [[0, 1, 2, 3]])
    prepared = sk.prepare(spectrum, mesh)
    heat_geodesics = sk.HeatGeodesics(mesh)
    field = heat_geodesics.distance(0)
    paths = geodesics.GeodesicPaths(mesh, 0)
    config = neo.NeoConfig(width=16, depth=1, heads=2, head_width=8, latents=4, m=16, k=8)
    network = neo.build_network(config)
    signature = features.heat_kernel_signature(spectrum)
    candidate = maps.Candidate(
        functional_map=identity, score=0.1, mismatches={"wave": 0.1}, mirrored=False
    )
    two = {"a": prepared, "b": prepared}
    collected = maps.CollectedPair(
        **{"source": "a", "target": "b", "score": 0.1, "score_alone": 0.1},
        **{"cycle_error": 0.1, "convincing": True},
    )
    collection = maps.Collection(
        **{"shapes": two, "frames": np.stack([identity] * 2), "mirrored": np.zeros(2, dtype=bool)},
        **{"groups": (("a", "b"),), "pairs": (collected,)},
    )
    found = maps.Match(
        **{"point_map": same, "functional_map": identity, "mirrored": False, "orientation": 1.0},
        **{"margin": 2.0, "mirror_margin": 2.0, "consistent": 1.0, "coverage": 1.5},
        **{"discontinuity": 0.0, "candidates": (candidate,)},
    )
    by_parts = maps.ComponentMatch(
        **{"point_map": same, "partner": np.zeros(1, int), "matches": {(0, 0): found}},
        **{"confidence": np.ones(1)},
    )
    panel = show.Panel(values=mesh.points[:, 0], limit=1.0)
    map_errors = maps.MapErrors(np.ones(n), same)
    given = subspaces.GivenBasis(spectrum.eigenvectors)
    pair = show.MatchedPair(source=mesh, target=mesh, point_map=same)
    run = show.SolverRun(name="a", stages={"factor": 1.0}, times=[0.1], residuals=[1e-9])
    recipe = learn.Recipe(embeddings=(features.ShapeDNA(count=4),), k=8)
    points = learn.Recipe(embeddings=(features.HeatKernelSignature(count=3),), k=8)
    halves = (mesh.points[:, 2] > 0).astype(int)
    classifier = learn.train_classifier(
        [mesh, ball], [0, 1], recipe=recipe, method=learn.NearestNeighbour()
    )
    segmenter = learn.train_segmenter(
        *([mesh], [halves]), recipe=points, method=learn.PointMLP(width=4),
        training=learn.Training(epochs=1),
    )  # fmt: skip
    index = learn.ShapeIndex(recipe, ("mesh.obj",), ("0",), recipe.vector(mesh)[None])
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    geometry.write(mesh, folder / "mesh.obj")
    plan = datasets.Plan(k=8, descriptors=("dna",), operators=("stiffness",))
    spectra = datasets.SpectrumStore(folder / "store")
    names = ("mesh.obj", "again.obj")
    inputs = [datasets.Input(name=name, path=folder / "mesh.obj") for name in names]
    report = datasets.compute_all(inputs, spectra, plan)
    done = report.completed[0][1]
    dataset = learn.StoreDataset(spectra)
    datasets.complete(spectra, "copy.obj", folder / "mesh.obj", plan)
    pair_of_names = datasets.Pair(source="mesh.obj", target="copy.obj")
    of_map = datasets.MapRecord(
        **{"key": "0" * 32, "score": 0.1, "margin": 2.0, "mirror_margin": 2.0, "coverage": 1.5},
        **{"orientation": 1.0, "confidence": 0.9, "mirrored": False},
        **{"ambiguous": False, "convincing": True, "doubts": ()},
    )
    thumbnail = show.Thumbnail(geometry=mesh, labels=halves, lines=("x",))
    quick = maps.MatchOptions(
        **{"orders": 1, "growing": 8, "turns": 1, "finalists": 1, "rounds": 1},
    )
    instances = (  # whose methods are called, or which are arguments of their kind
        *(mesh, mesh.as_cloud(), laplacian, spectrum, spectrum.provenance, spectrum.certificate),
        *(oriented, triangulation, prepared, heat_geodesics, field, field.poisson, field.heat),
        *(paths, paths.to(9), geodesics.logarithmic_map(mesh, 0), operators.curvature(mesh)),
        *(field.sources, config, network, neo.NeoSubspace(network), candidate, panel, pair, run),
        *(plan, spectra, inputs[0], report, done, done.record, pair_of_names, of_map),
        *(datasets.DaskEngine(scheduler="tcp://127.0.0.1:8786"), datasets.Matching()),
        *(dataset, recipe, classifier, segmenter, index, thumbnail, learn.Training(epochs=1)),
        *(show.View(), sk.RayleighRitz(), sk.Automatic(), given, map_errors),
        *(geodesics.WithinMemory(), frames, geodesics.VectorHeat(mesh)),
        *(metrics.compare_spectra(spectrum, spectrum), geometry.repair(mesh)),
        *(sk.eigen.ModeCount(verified=3, radius=0.1, floor=2.0), maps.Truth(same, same)),
        *(geometry.sample_with_origin(mesh, 50, seed=0), geometry.Normalization.unit_box(mesh)),
        *(geometry.Problem(1, "a hole", "mend it"), geodesics.FacePoint(0, (1.0, 0.0, 0.0))),
        *(collected, collection, found, by_parts, tetrahedra, maps.Carrier(mesh, mesh, same)),
        subspaces.canonical_frame(mesh.points, spectrum.mass),
        maps.precise_map(spectrum, spectrum, identity, mesh.faces),
    )
    arguments = (
        # Of the geometry and its spectrum.
        ("thing geometry", mesh),
        ("points queries source_points normals", ball.points),
        ("faces source_faces target_faces", mesh.faces),
        ("back point_map vertex_index face_index", same),
        ("Cascade.coarsest Neo.coarsest", 200),
        ("Truth.source Truth.target Truth.symmetric", same),
        ("errors f g symmetric point_arrays values Samples.interpolate.values", np.ones(n)),
        ("mass target_mass", spectrum.mass),
        ("inside", np.ones(n, dtype=bool)),
        ("keep", np.arange(n) > 0),
        ("image", np.pad(np.ones((3, 4, 5), int), 1)),
        ("spacing", 0.5),
        ("from_labels.labels", [1]),
        ("LabelSurface.label", 1),
        ("Overlay.values write_overlay.values", np.ones(n)),
        ("Overlay.names", {1: "cortex"}),
        ("write.point_data", {"u": np.ones(n)}),
        ("VectorHeat.transport.vectors transport_vectors.vectors", np.ones((2, 3))),
        ("VectorHeat.extend.values", np.ones(2)),
        ("TangentFrames.vectors.coordinates", np.ones(2 * n)),
        ("signed_distance.curves", [0, 1, 2]),
        ("along", same),
        ("Carrier.labels.labels", halves),
        ("Carrier.face_labels.labels", np.zeros(len(mesh.faces), int)),
        ("Carrier.face_values.values", np.ones(len(mesh.faces))),
        ("Carrier.landmarks.points", [0, 1]),
        ("Carrier.texture.coordinates", np.zeros((n, 2))),
        ("Carrier.then.other", maps.Carrier(mesh, mesh, same)),
        ("tensors", np.tile(np.eye(3), (len(mesh.faces), 1, 1))),
        ("Laplacian.consistent_mass", sk.laplacian(mesh, mass="consistent").consistent_mass),
        ("tetrahedral_laplacian.tensors", np.eye(3)[None]),
        ("vectors", np.ones((n, 3))),
        ("IntrinsicTriangulation.divergence.vectors", np.ones((len(triangulation.corners), 2))),
        ("rhs density potential diffuse.field", np.ones(n)),
        ("cut_open.values", corners[:, 0]),
        ("Laplacian.solve.fixed poisson.fixed", [0, 1]),
        ("fiedler_order.surface", ball.with_points(ball.points * [1, 1.3, 1.7])),
        ("spectral_segments.surface", geometry.creature(500)),
        ("spectral_segments.parts", 2),
        ("Laplacian.solve.values poisson.values", [0.5, 1.0]),
        ("dirichlet_energy.source dirichlet_energy.target", laplacian),
        ("laplacians", [laplacian]),
        ("geometries shapes", [mesh]),
        ("predict_many.points", [ball.points]),
        ("predict_many.mass", [spectrum.mass]),
        ("match.source match.target prepare.spectrum", spectrum),
        ("spectra", {"a": spectrum}),
        ("dirichlet eigenvalues", spectrum.eigenvalues),
        ("eigenfunctions eigenvectors", spectrum.eigenvectors),
        ("basis", spectrum.eigenvectors[:, :5]),
        ("functions", spectrum.eigenvectors[:, :4]),
        ("source_rows target_rows", spectrum.eigenvectors[:, :12]),
        ("excess coefficients Certificate.errors", np.ones(spectrum.k)),
        ("descriptors signature source_descriptors target_descriptors", signature),
        ("features", (signature, signature)),
        ("fit_functional_map.oriented", (oriented, oriented)),
        ("gradient", slopes),
        ("from_diffusion_net.operators", interop.to_diffusion_net(spectrum, laplacian, slopes)),
        ("score_map.source score_map.target match_part.part match_part.whole", prepared),
        ("Union.parts start subspace", given),
        ("embedding", features.HeatKernelSignature(count=4)),
        ("BasisFunctions.subspace", sk.eigen.subspaces.AmbientFourier(m=16)),
        ("Surface.given surface", mesh),
        ("Surface.solver", sk.Arpack()),
        ("embed_batch.embedding", features.Coordinates()),
        ("embed_batch.points", torch.rand(2, 9, 3)),
        ("embed_batch.mass", torch.ones(2, 9)),
        ("mesh_eigenvalues.points", torch.tensor(np.array(ball.points))),
        ("eigenvalues.stiffness", interop.to_diffusion_net(spectrum, laplacian, slopes).L),
        ("eigenvalues.mass", torch.tensor(np.array(spectrum.mass))),
        ("eigenvalues.fixed", [0, 1]),
        ("train_classifier.shapes train_segmenter.shapes", [mesh, ball]),
        ("train_classifier.labels", [0, 1]),
        ("train_segmenter.labels", [halves, halves]),
        ("train_classifier.recipe recipe", recipe),
        ("train_segmenter.recipe", points),
        ("train_classifier.method", learn.NearestNeighbour()),
        ("train_segmenter.method", learn.PointMLP(width=4)),
        ("train_classifier.names train_segmenter.names", ["a", "b"]),
        ("training", learn.Training(epochs=1)),
        ("labeller", classifier),
        ("Hierarchical.backbone", "pointnet++"),
        ("Recipe.points Training.points", 60),
        ("folder", "checkpoints"),
        ("index_folder.folder", "."),
        ("known", index),
        ("StoreDataset.store", spectra),
        ("StoreDataset.plan", plan),
        ("StoreDataset.transform", learn.normalized),
        ("items", [dataset[0]]),
        ("item", dataset[0]),
        ("load", geometry.read),
        ("thumbnails", [thumbnail]),
        # Distances and maps.
        ("distance", field.distance),
        ("DistanceField.sources", field.sources),
        ("functional_map initial", identity),
        ("maps", np.stack([identity[:10, :10]])),
        ("candidates", (candidate,)),
        ("MatchedPair.errors plot_correspondence.errors", map_errors),
        ("match.initial", same),
        ("Match.landmark_distances", np.ones(2)),
        ("match.landmarks fit_functional_map.landmarks", ([0, 1], [0, 1])),
        ("score_map.landmarks", (np.array([0, 1]), np.array([0, 1]))),
        ("Collection.shapes match_collection.shapes", two),
        ("Collection.frames", collection.frames),
        ("Collection.mirrored", collection.mirrored),
        ("Collection.groups", collection.groups),
        ("Collection.pairs", collection.pairs),
        ("Collection.pair.source Collection.candidate.source", "a"),
        ("Collection.pair.target Collection.candidate.target", "b"),
        ("Collection.pair.k", 30),
        ("Collection.pair.elastic match_collection.mirrored", False),
        # Many shapes.
        ("find_inputs.sources", ["mesh.obj"]),
        ("inputs", inputs),
        ("DaskEngine.scheduler_file DaskEngine.nworkers", None),
        ("compute_all.store complete.store", spectra),
        ("find_pairs.store match_all.store load_match.store", spectra),
        ("match_all.pairs", []),
        ("find_pairs.pairs", "all"),
        ("match_all.plan find_pairs.plan", plan),
        ("Matching.k", 30),
        ("Matching.key.source Matching.key.target", done.record),
        ("SpectrumStore.keep_map.source SpectrumStore.keep_map.target", "0" * 32),
        ("how", {"k": 5}),
        ("arrays", {"point_map": same}),
        ("Pair.source Pair.target", "mesh.obj"),
        ("load_match.key SpectrumStore.load_map.key SpectrumStore.has_map.key", "0" * 32),
        ("complete.file", "mesh.obj"),
        ("SpectrumStore.descriptor.name SpectrumStore.descriptor_key.name", "dna"),
        ("SpectrumStore.entries.kind", "shapes"),
        ("keep_operator.name", "stiffness"),
        ("load_operator.key", done.record.operators["stiffness"]),
        ("load_descriptor.key", done.record.descriptors["dna"]),
        ("SpectrumStore.shape.key", done.record.shape),
        ("SpectrumStore.load.key SpectrumStore.descriptor_key.spectrum", done.record.spectrum),
        ("shard.part shard.parts", 1),
        # Pictures.
        ("plot_correspondence.page plot_correspondences.page", show.Page(dpi=10)),
        ("plot_distance.page", show.Page(dpi=10)),
        ("plot_error_curves.errors", {"a": np.ones(4)}),
        ("fields", {"x": mesh.points[:, 0]}),
        ("pairs", [pair]),
        ("plot_panels.rows", [[panel]]),
        ("columns_named rows_named", ["a"]),
        ("runs", [run]),
        ("marks", {"day": 3.0}),
        ("plot_distance.sources plot_curves.marks", [[0.0, 0.0, 1.0]]),
        ("plot_fields.symmetric", True),
        # Numbers, words and functions, where those of `USUAL` are no good.
        ("MapErrors.at_points.n", n),
        ("samples cap animate_modes.width", 100),
        ("sample.n sample_with_origin.n", 50),
        ("max_iterations Prepared.truncate.k", 35),
        (
            "match.options match_collection.options match_part.options match_components.options",
            quick,
        ),
        ("k_final", 24),
        ("k_start zoomout_many.k_final", 10),
        ("creature.n_points creature_pair.n_source n_target", 520),
        ("dimension iterations", 2),
        ("farthest_points.start farthest_point_sampling.start", 0),
        ("wave_kernel_signature.width quantisation", 0.2),
        ("low", 0.0),
        ("limit", 5.0),
        ("spectral_distance.time eigensolve.mass weights", None),
        ("mirrored match.elastic", False),
        ("a b thresholds energies times", [0.5, 1.0]),
        ("dnas", [[1.0, 2.0], [1.0, 3.0]]),
        ("scales", np.geomspace(0.01, 1, 16)),
        ("centre lower coordinate", (0.0, 0.0, 0.0)),
        ("upper", (1.0, 1.0, 1.0)),
        ("modes ends", [1, 2]),
        ("landmarks shown sources starts targets vertices plot_signatures.points", [0, 1]),
        ("HeatGeodesics.distances.sources distance_matrix.sources", [0, 1]),
        ("distance_matrix.out", np.empty((2, n), np.float32)),
        ("distance_matrix.symmetric", False),
        ("distance_matrix.start", 0),
        ("indices", np.arange(50)),
        ("rows", np.arange(100)),
        ("plot_vectors.vectors", mesh.points),
        ("plot_curves.curves", [paths.to(9)]),
        ("direction", [0.3, 0.2, 0.1]),
        ("plot_vectors.page plot_curves.page", show.Page(dpi=10)),
        ("DistanceField.seconds", {"factor": 1.0}),
        ("save_weights.record", {"legs": []}),
        ("kind", "mesh"),
        ("NeoConfig.named.name name_or_path", "small"),
        ("Panel.lines Problem.remedies", ("x",)),
        ("move", lambda values: values),
        ("progress", lambda done, total: None),
        ("response", np.exp),
        ("told.word", str.upper),
        ("Spectrum.to_torch.dtype to_diffusion_net.dtype StoreDataset.dtype", torch.float32),
        # Files.
        ("path", "out.png"),
        ("read.path", "mesh.obj"),
        ("write.path", "out.ply"),
        ("read_overlay.path", "lh.curv"),
        ("write_overlay.path", "out.curv"),
        ("read_overlay.n", 9),
        ("Spectrum.save.path", "out.npz"),
        ("Spectrum.load.path", "spectrum.npz"),
        ("save_weights.path save_labeller.path ShapeIndex.save.path", "out.safetensors"),
        ("load_labeller.path", "labeller.safetensors"),
        ("ShapeIndex.load.path", "index.safetensors"),
        ("write_explorer.path", "out.html"),
        ("animate_modes.path", "out.gif"),
        ("Picture.path Explorer.path", Path("out.png")),
    )
    by_name = {name: value for names, value in arguments for name in names.split()}
    return by_name, {type(thing).__name__: thing for thing in instances}


def instances() -> dict[str, Any]:
    return examples()[1]


# Where nothing else tells.
USUAL = {int: 6, float: 0.5, str: "a", bool: True}

# Clouds have no area, a lone candidate no rival, and zero modes no relative error.
MAY_BE_INFINITE = {"diagnose", "match", "match_part", "Collection.pair", "compare_spectra"}

# What is right besides values of the kind of the example.
ALSO = {
    "sources": {"number"},
    "spacing": {"array"},
    "spectral_distance.time": {"number"},
    "accuracy_curve.thresholds": {"number"},
    "k": {"array"},
    "Laplacian.solve.values": {"number"},
    "poisson.values": {"number"},
    "schroedinger.potential": {"number"},
    "Refined.start": {"function"},
    "subspace": {"function"},
    "parts": {"function"},
    "fit_functional_map.k": {"array", "none"},
    "match.source": {"geometry"},
    "match.target": {"geometry"},
    "match_part.part": {"geometry"},
    "match_part.whole": {"geometry"},
    "prepare.spectrum": {"geometry"},
    "MatchedPair.point_map": {"number"},  # looked at with its geometries, when drawn
    "plot_spectrum.spectra": {"Spectrum"},
    "check_sources.geometry": {"Laplacian", "Spectrum"},
    "eigensolve_many.laplacians": {"array"},
    "laplacian_many.geometries": {"array"},
    "Plan.laplacians.shapes": {"array"},
    "to_pyvista.point_arrays": {"Spectrum", "array of b"},
    "Overlay.values": {"array of b"},
    "Surface.given": {"Laplacian", "Spectrum"},
    "surface": {"Laplacian", "Spectrum"},
    "write_explorer.names": {"array of U"},
    "MapRecord.doubts": {"array of U"},
    "Completed.replaced": {"array of U"},
    "engine": {"function"},
    "ShapeRecord.problems": {"array of U"},
    "ShapeRecord.warnings": {"array of U"},
}
#: Sequences that may be empty. An empty list is an array of floats to NumPy.
EMPTY = {
    *("Match.candidates", "Problem.remedies", "Panel.lines", "Thumbnail.lines"),
    *("Plan.descriptors", "Plan.operators", "StoreDataset.operators", "BatchReport.completed"),
    *("Collection.mirrored", "Collection.groups", "Collection.pairs"),
    *("compute_all.inputs", "match_all.pairs", "shard.inputs"),
}


class DrawnError(Exception):
    """Raised where drawing would begin: all that can be checked has been."""


def family(value: Any) -> str:
    """What kind of thing a value is, as a user would say."""
    if value is None:
        return "none"
    if isinstance(value, type):
        return "class"
    if isinstance(value, bool | np.bool_):
        return "flag"
    if isinstance(value, int | float | np.number) and not isinstance(value, complex):
        return "number"
    if isinstance(value, str | Path):
        return "text"
    if isinstance(value, Mapping):
        return "mapping"
    if isinstance(value, np.ndarray | list | tuple):
        try:
            kind = np.asarray(value)
        except (TypeError, ValueError):
            return "ragged"
        return "array" if kind.dtype.kind in "fiu" else f"array of {kind.dtype.kind}"
    if isinstance(value, geometry.TriangleMesh | geometry.PointCloud):
        return "geometry"
    if type(value).__module__.startswith("spectra_kit"):
        return type(value).__name__
    return "function" if callable(value) else type(value).__name__


@cache
def anything() -> dict[str, Any]:
    """What may arrive anywhere by mistake."""
    made = instances()
    return {
        "None": None,
        "a class": sk.Arpack,
        "an object": object(),
        "a word": "spam",
        "the empty word": "",
        "complex": 1j,
        "True": True,
        "nan": np.nan,
        "inf": np.inf,
        "-inf": -np.inf,
        "-1": -1,
        "2.5": 2.5,
        "10**30": 10**30,
        "1e30": 1e30,
        "[]": [],
        "{}": {},
        "words": ["a", "b"],
        "ragged": [[1.0], [1.0, 2.0]],
        "objects": np.array([object()]),
        "complex array": np.ones(3, dtype=complex),
        "array of no dimensions": np.array(3),
        "bytes": b"\x01\x02",
        "boolean array": np.ones(5, dtype=bool),
        "four axes": np.ones((2, 2, 2, 2)),
        "NaN array": np.full((162, 3), np.nan),
        "sparse": sparse.eye_array(5, format="csr"),
        "mapping": {"a": object()},
        **{kind: made[kind] for kind in ("TriangleMesh", "PointCloud", "Laplacian", "Spectrum")},
        "solver": sk.Arpack(),
        "function": lambda *_: None,
    }


def broken(value: Any) -> dict[str, Any]:
    """The same array, a little wrong."""
    if isinstance(value, torch.Tensor) or family(value) != "array":
        return {}
    array = np.array(value)
    if array.dtype.kind not in "fiu" or not array.size:
        return {}
    outside = array.copy()
    outside.flat[0] = np.nan if array.dtype.kind == "f" else 10**9
    negative = array.copy()
    negative.flat[-1] = -7
    return {
        "one short": array[:-1],
        "one axis more": array[None],
        "flat": array.ravel()[:, None],
        "transposed": array.T if array.ndim > 1 else array[:, None],
        "of objects": np.where(outside == array, array, object()),
        "of words": array.astype(str),
        "of complex": array.astype(complex),
        "one outside": outside,
        "one negative": negative,
        "one infinite": np.where(np.arange(array.size).reshape(array.shape) == 0, np.inf, array),
        "none": array[:0],
    }


def call_of(name: str) -> Call:
    thing, is_method = surface()[name]
    target = inspect.unwrap(thing.__init__ if inspect.isclass(thing) else thing)
    hints = typing.get_type_hints(target, localns=_LATE)
    good, optional, solvers, function, owner = {}, set(), set(), thing, None
    for p in inspect.signature(thing).parameters.values():
        if p.name == "self" and is_method:
            owner = instances()[name.split(".")[0]]
            function = partial(thing, owner)
            continue
        good[p.name] = example_of(name, p, thing, hints.get(p.name))
        if p.default is None or "None" in str(p.annotation):
            optional.add(p.name)
        if "Eigensolver" in str(p.annotation):
            solvers.add(p.name)
        if p.kind is p.VAR_POSITIONAL:
            function = partial(_spread, thing, p.name)
    return Call(name, function, good, owner, optional, solvers)


def _spread(function: Callable[..., Any], name: str, **arguments: Any) -> Any:
    return function(arguments[name])


def example_of(name: str, p: inspect.Parameter, owner: Any, hint: Any) -> Any:
    """A good value: told by name, of an instance, the default, or what has the kind asked for."""
    values, made = examples()
    short = name.rpartition(".")[2]
    for key in (f"{name}.{p.name}", f"{short}.{p.name}"):
        if key in values:
            return values[key]
    if inspect.isclass(owner) and getattr(made.get(name), p.name, None) is not None:
        return getattr(made[name], p.name)
    if p.default is not p.empty and p.default is not None:
        return p.default
    if p.name in values:
        return values[p.name]
    kinds = (hint, *typing.get_args(hint))
    for kind in kinds:
        if getattr(kind, "__name__", None) in made:
            return made[kind.__name__]
    for kind in kinds:
        if kind in USUAL:
            return USUAL[kind]
    if p.default is None:
        return None
    raise AssertionError(f"tell what `{p.name}` of {name} may be")


def finite(result: Any, depth: int = 3) -> bool:
    """Whether all numbers of a result are."""
    if isinstance(result, float | np.floating):
        return bool(np.isfinite(result))
    if isinstance(result, np.ndarray) and result.dtype.kind == "f":
        return bool(np.isfinite(result).all())
    if isinstance(result, torch.Tensor):
        return bool(torch.isfinite(result.to_dense()).all())
    if depth and isinstance(result, tuple | list):
        return all(finite(item, depth - 1) for item in result)
    if depth and is_dataclass(result):
        return all(finite(getattr(result, f.name), depth - 1) for f in fields(result))
    return True


def fault(call: Call, argument: str, wrong: Any) -> str:
    """Say what is bad about how a call with one wrong argument ended; nothing if it is fine."""
    empty = isinstance(wrong, list) and not wrong and f"{call.name}.{argument}" in EMPTY
    fits = empty or family(wrong) in kinds_of(call, argument)
    try:
        with warnings.catch_warnings(record=True) as doubts:
            warnings.simplefilter("always", UserWarning)
            warnings.simplefilter("error", RuntimeWarning)
            result = call.function(**call.good | {argument: wrong})
    except DrawnError:
        result = None
    except SpectraKitError as error:
        # Where two arguments do not fit together, either may be named.
        told = {argument} | (set(call.good) if fits else set())
        told |= {type(wrong).__name__, *getattr(call.owner, "__dataclass_fields__", ())}
        named = any(re.search(rf"\b{name}\b", str(error)) for name in told)
        written = isinstance(wrong, str) and wrong in str(error)
        return "" if named or written else f"does not name the argument: {error}"
    except Exception as error:  # noqa: BLE001  # whatever else comes is a fault
        return f"raises {type(error).__name__}: {str(error)[:150]}"
    if not fits:
        return f"takes {family(wrong)} for {family(call.good[argument])}"
    told_of = doubts or call.name in MAY_BE_INFINITE or inspect.isclass(call.function)
    return "" if told_of or finite(result) else "returns numbers that are not finite"


def kinds_of(call: Call, argument: str) -> set[str]:
    """Families of values that are right for an argument."""
    also = ALSO.get(f"{call.name}.{argument}", ALSO.get(argument, set()))
    solvers = {"Arpack"} if argument in call.solvers else set()
    return {family(call.good[argument])} | also | solvers


@cache
def written() -> Path:
    """A folder with the files that the examples name."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    geometry.write(instances()["TriangleMesh"], folder / "mesh.obj")
    geometry.write_overlay(np.ones(9), folder / "lh.curv")
    instances()["Spectrum"].save(folder / "spectrum.npz")
    learn.save_labeller(folder / "labeller.safetensors", instances()["Classifier"])
    instances()["ShapeIndex"].save(folder / "index.safetensors")
    return folder


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """A folder with what the examples read; nothing is drawn."""

    def drawn(*_: Any, **__: Any) -> None:
        raise DrawnError

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("spectra_kit.show.render.draw_requests", drawn)
    monkeypatch.setattr("matplotlib.figure.Figure", drawn)
    for path in written().iterdir():
        shutil.copy(path, tmp_path)


@pytest.mark.parametrize("name", surface())
def test_wrong_arguments_are_refused_by_name(name):
    call = call_of(name)
    with suppress(DrawnError):
        call.function(**call.good)
    faults = [
        f"{argument} = {label}: {bad}"
        for argument, good in call.good.items()
        for label, wrong in {**anything(), **broken(good)}.items()
        if not (wrong is None and argument in call.optional)
        if (bad := fault(call, argument, wrong))
    ]
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda e: sk.verify(e["Laplacian"], e["Spectrum"]),
            "`spectrum` must be a Spectrum, got a Laplacian; did you swap it with `laplacian`?",
        ),
        (
            lambda e: show.plot_modes(e["Spectrum"], e["TriangleMesh"]),
            "`geometry` must be a TriangleMesh or PointCloud, got a Spectrum; did you swap it with"
            " `spectrum`?",
        ),
        (
            lambda e: sk.match(e["Laplacian"], e["TriangleMesh"]),
            "`source` must be a TriangleMesh, PointCloud, Spectrum or Prepared, got a Laplacian",
        ),
        (
            lambda e: sk.eigensolve(e["Laplacian"], 5, sk.Dense),
            "`solver` must be an Eigensolver, got the class Dense; pass an instance of it",
        ),
        (
            lambda e: sk.PointCloud(np.ma.masked_less(np.eye(3), 1)),
            "`points` must be whole, got 6 masked entries; leave them out",
        ),
        (
            lambda e: sk.spectrum(e["TriangleMesh"], solvr=1),
            "spectrum takes no argument `solvr`; did you",
        ),
        (lambda e: show.Page(colour="red"), "Page takes no argument `colour`"),
    ],
)
def test_what_to_do_instead_is_told(call, message):
    with pytest.raises((InvalidInputError, TypeError)) as error:
        call(instances())
    assert str(error.value).startswith(message)


def test_words_of_numpy_are_words():
    """They are passed on as Python's, on which keys of stores depend; others are refused."""
    mesh, word = instances()["TriangleMesh"], np.array(["consistent", "spam"])
    found, same = (sk.laplacian(mesh, mass=mass) for mass in (word[0], "consistent"))
    assert found.operator == same.operator != sk.laplacian(mesh).operator
    assert repr(datasets.Plan(mass=word[0])) == repr(datasets.Plan(mass="consistent"))
    assert repr(sk.Neo(dtype=np.str_("float32"))) == repr(sk.Neo(dtype="float32"))
    assert sk.read("mesh.obj", kind=np.str_("mesh")).n == mesh.n
    for wrong in (word[1], np.array(word[:1]), 1, True):
        with pytest.raises(InvalidInputError, match="`mass` must be 'lumped' or 'consistent'"):
            sk.laplacian(mesh, mass=wrong)
