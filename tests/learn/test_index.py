"""An index over a folder: what is found, what is taken over, what is left out."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import creature

from spectra_kit.eigen import Neo
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.features import ShapeDNA, WaveKernelSignature
from spectra_kit.geometry import PointCloud, TriangleMesh, read, sphere, torus, write
from spectra_kit.learn import Recipe, ShapeIndex, index_folder
from spectra_kit.neo import NeoConfig, NeoNetwork, save_weights

RECIPE = Recipe(embeddings=(ShapeDNA(count=12), WaveKernelSignature(count=5)), k=24)


@pytest.fixture(scope="module")
def shapes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shapes")
    for pose in range(3):
        write(creature(700, pose=pose), folder / f"animal{pose}.off")
    for i, minor in enumerate((0.3, 0.35)):
        write(torus(n=600, minor=minor).geometry, folder / f"ring{i}.ply")
    (folder / "notes.txt").write_text("not a shape")
    return folder


@pytest.fixture(scope="module")
def index(shapes):
    return index_folder(shapes, RECIPE)


@pytest.fixture
def folder(shapes, tmp_path):
    return Path(shutil.copytree(shapes, tmp_path / "shapes"))


@pytest.fixture
def embedded(monkeypatch):
    """Numbers of points of the shapes that were embedded."""
    seen, vector = [], Recipe.vector
    monkeypatch.setattr(
        Recipe, "vector", lambda self, shape: seen.append(shape.n) or vector(self, shape)
    )
    return seen


def test_the_nearest_are_those_of_its_kind_in_any_unit(index):
    assert index.names == ("animal0.off", "animal1.off", "animal2.off", "ring0.ply", "ring1.ply")
    asked = creature(1100, pose=1)
    found = index.nearest(TriangleMesh(40 * asked.points + 3, asked.faces), count=4)
    assert {near.name for near in found[:3]} == {"animal0.off", "animal1.off", "animal2.off"}
    distances = [near.distance for near in found]
    assert distances == sorted(distances)
    assert distances[2] < 0.5 * distances[3]
    spread = index.vectors.std(axis=0)
    gaps = np.abs(index.vectors[3] - RECIPE.vector(asked)) / spread
    nearest = index.nearest(asked, count=9)
    assert len(nearest) == 5
    assert dict(nearest)["ring0.ply"] == pytest.approx(gaps.mean())


def test_itself_is_at_no_distance(folder, index):
    first = index.nearest(read(folder / "ring1.ply"), count=1)[0]
    assert first.name == "ring1.ply"
    assert first.distance == pytest.approx(0, abs=1e-9)


def test_only_what_is_new_is_embedded_again(folder, index, embedded):
    write(torus(n=800, minor=0.2).geometry, folder / "ring0.ply")
    write(creature(900, seed=3), folder / "other.off")
    (folder / "animal0.off").rename(folder / "renamed.off")
    known = index_folder(folder, RECIPE, known=index)
    assert len(embedded) == 2
    assert min(embedded) > 700
    fresh = index_folder(folder, RECIPE)
    assert known.names == fresh.names
    np.testing.assert_array_equal(known.vectors, fresh.vectors)


def test_what_was_made_otherwise_is_not_taken_over(folder, index, embedded):
    index_folder(folder, Recipe(embeddings=RECIPE.embeddings, k=25), known=index)
    assert len(embedded) == 5
    embedded.clear()
    index_folder(folder, RECIPE, known=index, load=lambda path: read(path).as_cloud()
                 if path.endswith(".off") else read(path))  # fmt: skip
    assert len(embedded) == 3


# What these predict, who have learned nothing, need not come near enough on every processor.
@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_other_weights_under_the_same_name_are_other_weights(folder, tmp_path, embedded):
    path = tmp_path / "w.safetensors"
    config = NeoConfig(width=16, depth=1, heads=2, head_width=8, latents=4, m=40, k=24)
    torch.manual_seed(0)
    save_weights(path, NeoNetwork(config), {})
    recipe = Recipe(embeddings=RECIPE.embeddings, k=24, solver=Neo(weights=str(path)))
    for animal in folder.glob("animal*"):
        animal.unlink()
    index = index_folder(folder, recipe)
    embedded.clear()
    index_folder(folder, recipe, known=index)
    assert embedded == []
    save_weights(path, NeoNetwork(config), {})
    index_folder(folder, recipe, known=index)
    assert len(embedded) == 2


def test_folders_and_broken_links_among_the_files_are_passed_over(folder, index):
    (folder / "scans.ply").mkdir()
    (folder / "gone.off").symlink_to(folder / "nowhere.off")
    assert len(index_folder(folder, RECIPE, known=index).names) == 5


def test_what_cannot_be_embedded_is_named_and_the_rest_goes_on(folder, index):
    ball = sphere(subdivisions=2).geometry
    two = np.concatenate([ball.points, ball.points + 9])
    write(TriangleMesh(two, np.concatenate([ball.faces, ball.faces + ball.n])), folder / "two.off")
    write(PointCloud(np.eye(3)), folder / "tiny.xyz")
    (folder / "broken.obj").write_text("v 1\n")
    told = []
    found = index_folder(
        folder, RECIPE, known=index, progress=lambda done, total: told.append((done, total))
    )
    assert len(found.names) == 5
    assert set(found.failures) == {"two.off", "tiny.xyz", "broken.obj"}
    assert "2 components" in str(found.failures["two.off"])
    assert told == [(i + 1, 8) for i in range(8)]


def test_a_saved_index_finds_the_same(index, tmp_path):
    index.save(tmp_path / "index.safetensors")
    again = ShapeIndex.load(tmp_path / "index.safetensors")
    assert (again.names, again.digests, again.recipe) == (index.names, index.digests, RECIPE)
    asked = creature(900, pose=2)
    assert again.nearest(asked) == index.nearest(asked)
    data = (tmp_path / "index.safetensors").read_bytes()
    (tmp_path / "index.safetensors").write_bytes(data[:-9])
    with pytest.raises(InvalidFileError):
        ShapeIndex.load(tmp_path / "index.safetensors")


def test_folders_without_shapes(tmp_path):
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(InvalidInputError, match="`folder` must hold meshes or clouds"):
            index_folder(folder, RECIPE)
    write(PointCloud(np.eye(3)), tmp_path / "tiny.xyz")
    with pytest.raises(InvalidInputError, match="hold a shape at least"):
        index_folder(tmp_path, RECIPE).nearest(PointCloud(np.eye(3)))
