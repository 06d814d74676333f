"""Whatever is passed in the place of an argument is refused by its name, or has a good result.

Every public function, constructor and method is called with good arguments, of which each in turn
is replaced by every entry of a table of wrong ones.
"""

from __future__ import annotations

import importlib
import inspect
import re
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
    correspondence,
    descriptors,
    functional_maps,
    geodesics,
    geometry,
    interop,
    matching,
    metrics,
    neo,
    operators,
    subspaces,
    viz,
)
from spectra_kit._checked import _LATE
from spectra_kit.errors import InvalidInputError, SpectraKitError

PACKAGES = (
    "spectra_kit",
    *(
        f"spectra_kit.{name}"
        for name in (
            *("geometry", "operators", "eigensolvers", "subspaces", "spectra", "matching"),
            *("geodesics", "descriptors", "functional_maps", "correspondence", "metrics", "viz"),
            *("interop", "explorer", "neo"),
        )
    ),
)
# Tensors are torch's to check, where a compiler has to see through every line.
LEFT_TO_TORCH = {"NeoNetwork.forward", "NeoNetwork.features", "NeoNetwork.evaluate_chunked"}
# Called by `eigensolve` alone, which has checked what it hands on.
HOOKS = re.compile(r"\.eigenpairs$|^(?!GivenBasis|Laplacian).*restricted$")


WAVES = ("landmark_wave_kernel_signature", "wave_energies", "wave_kernel_signature")


class Call(NamedTuple):
    """A public callable, and how it is called well."""

    name: str
    function: Callable[..., Any]  # of keywords alone
    good: dict[str, Any]
    owner: Any  # the instance of a method
    optional: set[str]  # arguments for which None is a value


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


def surface() -> Iterator[tuple[str, Callable[..., Any], bool]]:
    """Every public callable by name: functions, constructors, and methods (unbound)."""
    seen = set()
    for package in PACKAGES:
        for name, thing in public(importlib.import_module(package)):
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
def example() -> dict[str, Any]:
    """Good arguments by name; ``callable.name`` where the name alone does not tell."""
    ball = geometry.sphere(subdivisions=2).geometry
    x, y, z = ball.points.T
    mesh = ball.with_points(ball.points * (1 + 0.3 * np.sin(2 * x + y) + 0.2 * z)[:, None])
    cloud = mesh.as_cloud()
    laplacian = sk.robust_laplacian(mesh)
    spectrum = sk.eigensolve(laplacian, 40)
    n, k = spectrum.n, spectrum.k
    same = np.arange(n)
    identity = np.eye(20)
    oriented = operators.oriented_triangles(mesh)
    triangulation = sk.intrinsic_delaunay(mesh)
    prepared = sk.prepare(spectrum, mesh)
    heat_geodesics = sk.HeatGeodesics(mesh)
    field = heat_geodesics.distance(0)
    comparison = metrics.compare_spectra(spectrum, spectrum)
    config = neo.NeoConfig(width=16, depth=1, heads=2, head_width=8, latents=4, m=16, k=8)
    network = neo.build_network(config)
    signature = descriptors.heat_kernel_signature(spectrum)
    candidate = matching.Candidate(
        functional_map=identity, score=0.1, mismatches={"wave": 0.1}, mirrored=False
    )
    panel = viz.Panel(values=mesh.points[:, 0], limit=1.0)
    precise = functional_maps.precise_map(spectrum, spectrum, identity, mesh.faces)
    count = sk.ModeCount(verified=3, radius=0.1, floor=2.0)
    samples = geometry.sample_with_origin(mesh, 50, seed=0)
    frame = subspaces.canonical_frame(mesh.points, spectrum.mass)
    repaired = geometry.repair(mesh)
    map_errors = correspondence.MapErrors(np.ones(n), same)
    normalization = geometry.Normalization.unit_box(mesh)
    given = subspaces.GivenBasis(spectrum.eigenvectors)
    return {
        **{
            f"{options.__name__}.{field.name}": field.default
            for options in (
                matching.MatchOptions,
                matching.ScoreWeights,
                functional_maps.FitWeights,
            )
            for field in fields(options)
        },
        # Instances whose methods are called.
        **{
            f"{type(thing).__name__}.self": thing
            for thing in (
                *(mesh, cloud, laplacian, spectrum, oriented, triangulation, heat_geodesics),
                *(
                    panel,
                    count,
                    prepared,
                    samples,
                    repaired,
                    geometry.Problem(1, "a hole", "mend it"),
                    normalization,
                    given,
                    spectrum.certificate,
                ),
                *(field.heat, field.sources, geodesics.FacePoint(0, (1.0, 0.0, 0.0))),
                *(sk.Arpack(), sk.Capped(), sk.Dense(), sk.Lobpcg(), sk.Multilevel(), sk.Neo()),
                *(sk.Polished(), sk.RayleighRitz(), sk.Refined(), geodesics.Automatic()),
                subspaces.Union(given),
                correspondence.Truth(same, same),
                correspondence.MapErrors(np.ones(3), np.arange(3)),
                viz.MatchedPair(source=mesh, target=mesh, point_map=same),
                viz.View(),
                neo.NeoSubspace(network),
            )
        },
        # Arguments.
        "a": [1.0, 2.0],
        "b": [1.0, 2.0],
        "back": same,
        "basis": spectrum.eigenvectors[:, :5],
        "bytes": 9,
        "candidates": (candidate,),
        "cap": 100,
        "centre": (0.0, 0.0, 0.0),
        "cloud": cloud,
        "coefficients": np.ones(k),
        "plot_fields.columns": 2,
        "plot_modes.columns": 2,
        "columns_named": ["a"],
        "comparison": comparison,
        "config": config,
        "consistent": 1.0,
        "coordinate": [0.0, 0.0, 0.0],
        "count": 4,
        "decimated": False,
        "description": "a surface",
        "descriptors": signature,
        "dimension": 2,
        "dirichlet": spectrum.eigenvalues,
        "distance": field.distance,
        "dnas": [[1.0, 2.0], [1.0, 3.0]],
        "Spectrum.to_torch.dtype": torch.float32,
        "to_diffusion_net.dtype": torch.float32,
        "duplicate_points": 0,
        "eigenfunctions": spectrum.eigenvectors,
        "eigenvalues": spectrum.eigenvalues,
        "eigenvectors": spectrum.eigenvectors,
        "ends": [1, 2],
        "energies": [0.5, 1.0],
        "coverage": 1.0,
        "error": 0.1,
        "errors": np.ones(n),
        "MatchedPair.errors": map_errors,
        "plot_correspondence.errors": map_errors,
        "plot_error_curves.errors": {"a": np.ones(4)},
        "excess": np.zeros(k),
        "f": np.ones(n),
        "face_index": np.arange(len(mesh.faces)),
        "faces": mesh.faces,
        "factor": 2.0,
        "features": (signature, signature),
        "fields": {"x": mesh.points[:, 0]},
        "NeoSubspace.predict.frame": frame,
        "functional_map": identity,
        "functions": spectrum.eigenvectors[:, :4],
        "g": np.ones(n),
        "geometry": mesh,
        "group": "a",
        "indices": np.arange(50),
        "initial": identity,
        "inside": np.ones(n, dtype=bool),
        "iterations": 2,
        "k": 6,
        "Prepared.truncate.k": 35,
        "k_final": 24,
        "zoomout_many.k_final": 12,
        "k_start": 10,
        "kind": "mesh",
        "landmarks": [0, 1],
        "match.landmarks": ([0, 1], [0, 1]),
        "mismatches.landmarks": (np.array([0, 1]), np.array([0, 1])),
        "fit_functional_map.landmarks": ([0, 1], [0, 1]),
        "laplacian": laplacian,
        "limit": 5.0,
        "lines": ("x",),
        "low": 0.0,
        "lower": (0.0, 0.0, 0.0),
        "maps": np.stack([identity[:10, :10]]),
        "margin": 1.5,
        "marks": {"day": 3.0},
        "mass": spectrum.mass,
        "max_iterations": 500,
        "mesh": mesh,
        "mirrored": False,
        "match.mirrored": False,
        "match.source": spectrum,
        "match.target": spectrum,
        "mismatches": {"wave": 0.1},
        "modes": [1, 2],
        "move": lambda values: values,
        "n": 100,
        "sample.n": 50,
        "sample_with_origin.n": 50,
        "Problem.remedies": ("a patch",),
        "told.word": str.upper,
        "n_modes": 5,
        "n_points": 500,
        "n_shown": 5,
        "n_sources": 1,
        "n_target": 520,
        "name": "a",
        "NeoConfig.named.name": "small",
        "name_or_path": "small",
        "network": network,
        "normals": ball.points,
        "operators": interop.to_diffusion_net(spectrum, laplacian),
        "orientation": 1.0,
        "fit_functional_map.oriented": (oriented, oriented),
        "mirror_margin": 1.5,
        "pairs": [viz.MatchedPair(source=mesh, target=mesh, point_map=same)],
        "Union.parts": given,
        "SolverRun.times": [0.1, 0.2],
        "DistanceField.sources": field.sources,
        "DistanceField.solver": field.solver,
        "Panel.lines": ("x",),
        "path": "out.png",
        "read.path": "mesh.obj",
        "write.path": "out.obj",
        "Spectrum.save.path": "out.npz",
        "Spectrum.load.path": "spectrum.npz",
        "save_weights.path": "out.safetensors",
        "write_explorer.path": "out.html",
        "animate_modes.path": "out.gif",
        "Picture.path": Path("out.png"),
        "Explorer.path": Path("out.html"),
        "check_sources.geometry": mesh,
        "Candidate.functional_map": identity,
        "point_map": same,
        "point_arrays": np.ones(n),
        "points": mesh.points,
        "nearest_rows.points": mesh.points,
        "pareto_front.points": [viz.ParetoPoint(name="a", group="b", seconds=1.0, error=0.1)],
        "plot_pareto.points": [viz.ParetoPoint(name="a", group="b", seconds=1.0, error=0.1)],
        "plot_signatures.points": [0, 1],
        "poisson": field.poisson,
        "precise": precise,
        "predicted": spectrum,
        "progress": lambda done, total: None,
        "provenance": spectrum.provenance,
        "quantisation": 1e-4,
        "queries": mesh.points,
        "reason": "",
        "record": {"legs": []},
        "SolverRun.residuals": [1.0, 0.1],
        "response": np.exp,
        "rows": np.arange(100),
        "plot_panels.rows": [[panel]],
        "rows_named": ["a"],
        "runs": [viz.SolverRun(name="a", stages={"factor": 1.0}, times=[0.1], residuals=[1e-9])],
        "samples": 100,
        "scales": np.geomspace(0.01, 1, 16),
        "score": 0.1,
        "seconds": 1.0,
        "DistanceField.seconds": {"solve": 1.0},
        "seed": 0,
        "shown": [0, 1],
        "signature": signature,
        "solver": sk.Dense(),
        **{
            f"{name}.{end}": prepared
            for name in ("mismatches", "orientation_of")
            for end in ("source", "target")
        },
        **{f"Truth.{end}": [0, 1] for end in ("source", "target", "symmetric")},
        **{f"dirichlet_energy.{end}": laplacian for end in ("source", "target")},
        **{
            f"{name}.{end}": mesh
            for name in ("MatchedPair", "plot_correspondence")
            for end in ("source", "target")
        },
        "source_descriptors": signature,
        "source_faces": mesh.faces,
        "source_points": mesh.points,
        "source_rows": spectrum.eigenvectors[:, :12],
        "sources": [0, 1],
        "plot_distance.sources": [[0.0, 0.0, 1.0]],
        "spectral_distance.time": None,
        "HeatGeodesics.distances.sources": [0, 1],
        "spacing": 0.1,
        "spectra": {"a": spectrum},
        "spectrum": spectrum,
        "square": 4.0,
        "stages": {"factor": 1.0},
        "start": given,
        "farthest_points.start": 0,
        "starts": [0, 1],
        "subspace": given,
        "neo_eigenpairs.subspace": neo.NeoSubspace(network),
        "symmetric": np.ones(3),
        "plot_fields.symmetric": True,
        "target_descriptors": signature,
        "target_faces": mesh.faces,
        "target_rows": spectrum.eigenvectors[:, :12],
        "targets": [0, 1],
        "thing": mesh,
        "thresholds": [1.0, 2.0],
        "time": 0.1,
        "time_step": 0.01,
        "times": [0.1, 1.0],
        "up": "z",
        "upper": (1.0, 1.0, 1.0),
        "values": np.ones(n),
        "score_of.values": {"wave": 0.1},
        "Samples.interpolate.values": np.ones(n),
        "vectors": np.ones((len(triangulation.corners), 2)),
        "vertex_index": same,
        "vertices": [0, 1],
        "weights": None,
        **{f"{name}.width": 0.2 for name in WAVES},
    }


# Clouds have no area, a lone candidate no rival, and zero modes no relative error.
MAY_BE_INFINITE = {"diagnose", "match", "compare_spectra"}

# What is right besides values of the kind of the example.
ALSO = {
    "sources": {"number"},
    "spectral_distance.time": {"number"},
    "accuracy_curve.thresholds": {"number"},
    "k": {"array"},
    "Refined.start": {"function"},
    "Polished.start": {"function"},
    "Lobpcg.start": {"function"},
    "Chebyshev.start": {"function"},
    "subspace": {"function"},
    "parts": {"function"},
    "fit_functional_map.k": {"array", "none"},
    "MatchedPair.point_map": {"number"},  # looked at with its geometries, when drawn
    "plot_spectrum.spectra": {"Spectrum"},
    "check_sources.geometry": {"Laplacian", "Spectrum"},
    "eigensolve.solver": {"Arpack"},
    "to_pyvista.point_arrays": {"Spectrum", "array of b"},
    "spectrum.solver": {"Arpack"},
    # Empty sequences, which are arrays of floats to NumPy.
    "Match.candidates": {"array"},
    "pareto_front.points": {"array"},
    "Panel.lines": {"array"},
    "Problem.remedies": {"array"},
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
    good = example()
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
        "mesh": good["mesh"],
        "cloud": good["cloud"],
        "Laplacian": good["laplacian"],
        "Spectrum": good["spectrum"],
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
    thing, is_method = next((t, m) for full, t, m in surface() if full == name)
    target = inspect.unwrap(thing.__init__ if inspect.isclass(thing) else thing)
    hints = typing.get_type_hints(target, localns=_LATE)
    good, optional, function, owner = {}, set(), thing, None
    for p in inspect.signature(thing).parameters.values():
        if p.name == "self" and is_method:
            owner = instances()[name.split(".")[0]]
            function = partial(thing, owner)
            continue
        good[p.name] = example_of(name, p, thing, hints.get(p.name))
        if p.default is None or "None" in str(p.annotation):
            optional.add(p.name)
        if p.kind is p.VAR_POSITIONAL:
            function = partial(_spread, thing, p.name)
    return Call(name, function, good, owner, optional)


def _spread(function: Callable[..., Any], name: str, **arguments: Any) -> Any:
    return function(arguments[name])


def example_of(name: str, p: inspect.Parameter, owner: Any, hint: Any) -> Any:
    """A good value: told by name, of an instance, the default, or what has the kind asked for."""
    values, made = example(), instances()
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
    for kind in (hint, *typing.get_args(hint)):
        if getattr(kind, "__name__", None) in made:
            return made[kind.__name__]
    if p.default is None:
        return None
    raise AssertionError(f"tell what `{p.name}` of {name} may be")


@cache
def instances() -> dict[str, Any]:
    """One of each class, as far as the examples hold one."""
    found = {type(value).__name__: value for value in example().values()}
    return found | {
        name.removesuffix(".self"): value
        for name, value in example().items()
        if name.endswith(".self")
    }


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
    fits = family(wrong) in kinds_of(call, argument)
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
    optional = {"none"} if argument in call.optional else set()
    return {family(call.good[argument])} | also | optional


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """A folder with what the examples read; nothing is drawn."""

    def drawn(*_: Any, **__: Any) -> None:
        raise DrawnError

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("spectra_kit.viz.render.draw_requests", drawn)
    monkeypatch.setattr("matplotlib.figure.Figure", drawn)
    geometry.write(example()["mesh"], "mesh.obj")
    example()["spectrum"].save("spectrum.npz")


@pytest.mark.parametrize("name", [name for name, _, _ in surface()])
def test_wrong_arguments_are_refused_by_name(name):
    call = call_of(name)
    with suppress(DrawnError):
        call.function(**call.good)
    faults = [
        f"{argument} = {label}: {bad}"
        for argument, good in call.good.items()
        for label, wrong in {**anything(), **broken(good)}.items()
        if (bad := fault(call, argument, wrong))
    ]
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda e: sk.verify(e["laplacian"], e["spectrum"]),
            "`spectrum` must be a Spectrum, got a Laplacian; did you swap it with `laplacian`\\?",
        ),
        (
            lambda e: viz.plot_fields("x.png", e["mesh"], e["points"]),
            r"`fields` must be a mapping of names .*, got a ndarray; write \{'name': values\}",
        ),
        (
            lambda e: viz.plot_modes(e["spectrum"], e["mesh"]),
            "`geometry` must be a TriangleMesh or PointCloud, got a Spectrum; did you swap it",
        ),
        (
            lambda e: sk.Refined(start=sk.Neo()),
            r"`start` must be a Subspace or None, got a Neo, .* Neo\(\).subspace",
        ),
        (
            lambda e: sk.eigensolve(e["laplacian"], 5, sk.Dense),
            "`solver` must be an Eigensolver, got the class Dense; pass an instance of it",
        ),
        (
            lambda e: e["spectrum"].to_torch(device="mps"),
            r"`device` must be one that torch can use here, got 'mps' .* try 'cpu'",
        ),
    ],
)
def test_what_to_do_instead_is_told(call, message):
    with pytest.raises(InvalidInputError, match=message):
        call(example())
