"""The set of real shapes: what a recipe promises, and what the set must hold."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from studies.recipes import REAL, STEPS, Recipe, meshes_of

from spectra_kit._core.fingerprint import shape_digest
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import TriangleMesh, sphere, write
from spectra_kit.operators import robust_laplacian

BALL = sphere(subdivisions=3).geometry
TRAITS = {"smooth", "CAD", "scanned", "noisy", "uneven", "many parts", "with boundary"}


def after(steps, *, source=None, path=None, seed=0):
    file = path / "ball.off"
    if not file.exists():
        write(BALL, file)
    return Recipe(name="x", sources=source or (str(file),), steps=steps, seed=seed).make()


def step(name, value, geometry=BALL):
    return STEPS[name](geometry, value, np.random.default_rng(0))


def test_the_set_is_large_varied_and_split_without_a_shared_source():
    meshes = [member for member in REAL.values() if member.kind == "mesh"]
    clouds = [member for member in REAL.values() if member.kind == "cloud"]
    assert len(meshes) >= 10
    assert len(clouds) >= 5
    assert {trait for member in REAL.values() for trait in member.traits} == TRAITS
    sides = [{s for m in REAL.values() if m.held_back == held for s in m.sources}
             for held in (False, True)]  # fmt: skip
    assert not sides[0] & sides[1]
    for kind in (meshes, clouds):
        held = sum(member.held_back for member in kind)
        assert len(kind) / 3 < held < 2 * len(kind) / 3
    assert not any("creature" in source for m in REAL.values() for source in m.sources)


@pytest.mark.parametrize(("name", "value"), [("noise", 0.2), ("graded", 2), ("uneven", 400)])
def test_the_same_recipe_makes_the_same_arrays_and_another_seed_others(tmp_path, name, value):
    first, again = (after(((name, value),), path=tmp_path) for _ in range(2))
    other = after(((name, value),), path=tmp_path, seed=1)
    assert shape_digest(first) == shape_digest(again) != shape_digest(other)


def test_midpoints_keep_the_surface_and_loop_comes_nearer_to_a_ball():
    flat, smooth = step("midpoint", 2), step("loop", 2)
    assert flat.n == smooth.n == 2 + 16 * (BALL.n - 2)
    assert flat.area == pytest.approx(BALL.area, rel=1e-12)

    def roundness(mesh):
        radius = np.linalg.norm(mesh.points, axis=1)
        return radius.std() / radius.mean()

    assert roundness(smooth) < roundness(flat) / 2


def test_graded_meshes_are_closed_uneven_and_of_the_same_area():
    graded = step("graded", 2)
    assert graded.area == pytest.approx(BALL.area, rel=1e-12)
    assert not len(graded.boundary_vertices)
    assert np.ptp(np.log(graded.face_areas)) > np.log(9)
    assert len(graded.faces) > 1.5 * len(BALL.faces)


def test_noise_is_a_share_of_the_spacing():
    edges = BALL.points[BALL.unique_edges[0]]
    spacing = np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1).mean()
    assert (step("noise", 0.2).points - BALL.points).std() == pytest.approx(0.2 * spacing, rel=0.1)
    cloud = step("sample", 500)
    moved = step("noise", 0.2, cloud).points - cloud.points
    assert 0 < moved.std() < 0.2 * np.sqrt(BALL.area / 500)


def test_uneven_clouds_are_denser_somewhere_and_bare_nowhere():
    cloud = step("uneven", 4000)
    counts = np.histogramdd(cloud.points, bins=[2, 2, 2])[0]
    assert counts.min() > 4000 / 8 / 2.5
    assert counts.max() > 1.5 * counts.min()
    assert np.abs(np.corrcoef(np.arange(4000), cloud.points[:, 0])[0, 1]) < 0.05  # in no order


def test_meshes_side_by_side_do_not_touch_and_differ_in_size(tmp_path):
    files = [tmp_path / f"{i}.off" for i in range(5)]
    for file in files:
        write(BALL, file)
    row = after((), source=tuple(map(str, files)), path=tmp_path)
    labels = row.component_labels
    assert len(np.unique(labels)) == robust_laplacian(row).kernel_dimension == 5
    parts = [row.points[labels == part] for part in np.unique(labels)]
    parts.sort(key=lambda part: part[:, 0].min())
    for a, b in pairwise(parts):
        assert a[:, 0].max() < b[:, 0].min()
    sizes = [np.ptp(part[:, 0]) for part in parts]
    assert 1.2 < max(sizes) / min(sizes) <= 4


def test_missing_data_are_told_and_leave_no_shape(tmp_path, monkeypatch):
    monkeypatch.setenv("SPECTRA_KIT_DATA", str(tmp_path))
    igea, parts = REAL["igea"], REAL["40 parts"]
    assert igea.missing == "no data: ood_public/igea; set SPECTRA_KIT_DATA"
    assert parts.missing == "no data: train_pool:40; set SPECTRA_KIT_DATA"
    with pytest.raises(InvalidInputError, match="ood_public/igea"):
        igea.make()
    assert meshes_of(REAL) == ()
    before = replace(igea).facts
    (tmp_path / "ood_public").mkdir()
    write(BALL, tmp_path / "ood_public" / "igea.npz")
    (shape,) = meshes_of(REAL)
    assert (shape.name, shape.mesh.n) == ("igea", BALL.n)
    assert replace(igea).facts != before


@pytest.mark.data
@pytest.mark.parametrize("name", ["hippo", "40 parts", "12 parts", "bunny cloud"])
def test_members_are_what_they_are_called(name):
    member = REAL[name]
    if member.missing:
        pytest.skip(member.missing)
    geometry = member.make()
    assert 20_000 <= geometry.n <= 500_000
    assert shape_digest(geometry) == shape_digest(member.make())
    assert isinstance(geometry, TriangleMesh) == (member.kind == "mesh")
    if isinstance(geometry, TriangleMesh):
        parts = {"hippo": 3, "40 parts": 40, "12 parts": 12}[name]
        assert len(np.unique(geometry.component_labels)) == parts
