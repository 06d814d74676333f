"""What people have in hand goes in: five kinds of objects, through every function."""

from __future__ import annotations

import copy
import inspect
import pickle
import typing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista as pv
import trimesh
from test_wrong_arguments import DrawnError, call_of, here, instances, surface

import spectra_kit as sk
from spectra_kit import Spectrum, learn
from spectra_kit._core.checked import _LATE
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh

__all__ = ["here"]  # the fixture: a folder with a mesh in a file; nothing is drawn

KINDS = ("trimesh", "pyvista", "arrays", "path", "points")


def thing(kind: str, geometry: Any) -> Any:
    """The same geometry in other hands."""
    points, faces = np.array(geometry.points), getattr(geometry, "faces", None)
    cloud = faces is None
    if kind == "trimesh":
        make = trimesh.PointCloud if cloud else trimesh.Trimesh
        return make(points) if cloud else make(points, faces, process=False)
    if kind == "pyvista":
        return pv.PolyData(points) if cloud else pv.PolyData.from_regular_faces(points, faces)
    if kind == "path":
        path = Path("shape.xyz" if cloud else "shape.ply")
        sk.write(geometry, path)
        return str(path)
    return points if kind == "points" else (points, faces)


def taking_geometries() -> list[tuple[str, str]]:
    """Every public callable and its argument that is a geometry, by their annotations."""
    found = []
    for name, (target, _) in surface().items():
        function = target.__init__ if inspect.isclass(target) else target
        hints = typing.get_type_hints(inspect.unwrap(function), localns=_LATE)
        hints.pop("return", None)
        for argument, hint in hints.items():
            if any(kind in typing.get_args(hint) for kind in (Spectrum, sk.Prepared)):
                continue  # a geometry in its place costs a solve
            if any(kind in (TriangleMesh, PointCloud) for kind in (hint, *typing.get_args(hint))):
                found.append((name, argument))
    return found


def outcome(name: str, argument: str, value: Any) -> Any:
    """What comes of it: the type of the result, or the argument that is refused."""
    call = call_of(name)
    try:
        return type(call.function(**call.good | {argument: value}))
    except DrawnError:
        return "drawn"
    except InvalidInputError as error:
        return error.argument


def test_there_are_many_of_them() -> None:
    assert len(taking_geometries()) >= 40


@pytest.mark.parametrize(("name", "argument"), taking_geometries())
def test_everything_goes_in(name: str, argument: str) -> None:
    """With the same result, or the same refusal, as of the geometry itself; or refused by name."""
    own, known = call_of(name).good[argument], {}
    for kind in KINDS:
        other = own.as_cloud() if kind == "points" and isinstance(own, TriangleMesh) else own
        if isinstance(own, PointCloud) and kind == "arrays":
            other = instances()["TriangleMesh"]
        if id(other) not in known:
            known[id(other)] = outcome(name, argument, other), other
        assert outcome(name, argument, thing(kind, other)) == known[id(other)][0]


@pytest.mark.parametrize("kind", KINDS)
def test_points_and_faces_are_kept(kind: str) -> None:
    mesh = instances()["TriangleMesh"]
    made = sk.as_geometry(thing(kind, mesh))
    assert np.array_equal(made.points, mesh.points)
    assert isinstance(made, PointCloud if kind == "points" else TriangleMesh)
    if kind != "points":
        assert np.array_equal(made.faces, mesh.faces)
        by_own, by_other = (sk.spectrum(g, 5).eigenvalues for g in (mesh, thing(kind, mesh)))
        assert np.array_equal(by_own, by_other)


def test_geometries_stay_themselves() -> None:
    for own in (instances()["TriangleMesh"], instances()["PointCloud"]):
        assert sk.as_geometry(own) is own


@pytest.mark.parametrize(
    ("wrong", "got", "advice"),
    [
        (5, "5", "make one, too"),
        ({"points": 1}, "a dict", "make one, too"),
        (pv.Line(), "a PolyData", "curves are no surface"),
        (pv.ImageData(dimensions=(2, 2, 2)), "an ImageData", "extract_surface()"),
        (pv.MultiBlock(), "a MultiBlock", "combine().extract_surface()"),
        (trimesh.Scene(), "a Scene", "scene.to_mesh()"),
        (trimesh.load_path(np.eye(3)), "a Path3D", "curves"),
        (b"OFF", "a bytes", "make one, too"),
        ("none.ply", "'none.ply'", "there is no such file"),
        (np.zeros((3, 2)), "a ndarray", "`points` must have shape (n, 3)"),
        (([[0.0, 0, 0]], [[0, 1, 2]]), "a tuple", "`faces` must be in [0, 1), got 2"),
        ([[0.0], [1.0, 2.0]], "a list", "rows of one length"),
    ],
)
def test_what_cannot_be_one(wrong: Any, got: str, advice: str) -> None:
    with pytest.raises(InvalidInputError) as error:
        sk.laplacian(wrong)
    assert (error.value.argument, error.value.got) == ("geometry", got)
    assert error.value.expected == "be a TriangleMesh or PointCloud"
    assert advice in error.value.advice


def test_a_file_that_is_refused_is_told_as_read_tells_it() -> None:
    with pytest.raises(InvalidFileError) as error:
        sk.laplacian("none.ply")
    assert str(error.value.path) == "none.ply"
    assert str(error.value).startswith("none.ply: `geometry` must be a TriangleMesh or PointCloud")


def test_swapped_arguments_are_told_before_a_path_is_read() -> None:
    with pytest.raises(InvalidInputError) as error:
        sk.write("out.obj", instances()["TriangleMesh"])
    assert error.value.advice == "did you swap it with `path`?"


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("spectum", "did you mean sk.spectrum"),
        ("heat_geodesics", "did you mean sk.HeatGeodesics"),
        ("viscosity", r"dir\(spectra_kit\) lists what it has"),
    ],
)
def test_a_name_that_is_not_there_comes_with_one_that_is(name, hint) -> None:
    with pytest.raises(AttributeError, match=hint):
        getattr(sk, name)


def test_records_name_what_they_have() -> None:
    repaired = sk.geometry.repair(sk.geometry.sphere(subdivisions=1).geometry)
    with pytest.raises(AttributeError, match="Repaired has no attribute 'mesh'; it has geometry,"):
        repaired.mesh  # noqa: B018
    assert copy.deepcopy(repaired).geometry.n == pickle.loads(pickle.dumps(repaired)).geometry.n


def test_a_problem_shows_what_helps() -> None:
    problem = sk.geometry.Problem(2, "2 faces have no area", "drop them with {}", ("repair(mesh)",))
    assert repr(problem) == "Problem(2, '2 faces have no area: drop them with repair(mesh)')"


def test_a_missing_file_is_said_to_be_missing(tmp_path) -> None:
    with pytest.raises(sk.errors.InvalidFileError, match="there is no such labeller; looked from"):
        learn.load_labeller(tmp_path / "nothing.safetensors")
