"""An index over a folder: what is found, what is taken over, what is left out."""

import numpy as np
import pytest

from spectra_kit.embeddings import ShapeDNA, WaveSignature
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, creature, read, sphere, torus, write
from spectra_kit.learning import Recipe, ShapeIndex, index_folder

RECIPE = Recipe(embeddings=(ShapeDNA(count=12), WaveSignature(count=5)), k=24)


@pytest.fixture
def folder(tmp_path):
    for pose in range(3):
        write(creature(700, pose=pose), tmp_path / f"animal{pose}.off")
    for i, minor in enumerate((0.3, 0.35)):
        write(torus(n=600, minor=minor).geometry, tmp_path / f"ring{i}.ply")
    (tmp_path / "notes.txt").write_text("not a shape")
    return tmp_path


class Counted:
    """Reads files, and remembers which."""

    def __init__(self):
        self.names = []

    def __call__(self, path):
        self.names.append(path.rpartition("/")[2])
        return read(path)


def test_the_nearest_are_those_of_its_kind_in_any_unit(folder):
    index = index_folder(folder, RECIPE)
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


def test_itself_is_at_no_distance(folder):
    index = index_folder(folder, RECIPE)
    first = index.nearest(read(folder / "ring1.ply"), count=1)[0]
    assert first.name == "ring1.ply"
    assert first.distance == pytest.approx(0, abs=1e-9)


def test_only_what_is_new_is_embedded_again(folder):
    first = Counted()
    index = index_folder(folder, RECIPE, load=first)
    assert len(first.names) == 5
    write(torus(n=600, minor=0.2).geometry, folder / "ring0.ply")
    write(creature(700, seed=3), folder / "other.off")
    again = Counted()
    known = index_folder(folder, RECIPE, known=index, load=again)
    assert again.names == ["other.off", "ring0.ply"]
    fresh = index_folder(folder, RECIPE)
    assert known.names == fresh.names
    np.testing.assert_array_equal(known.vectors, fresh.vectors)


@pytest.mark.parametrize("change", ["recipe", "variant"])
def test_what_was_made_otherwise_is_not_taken_over(folder, change):
    index = index_folder(folder, RECIPE)
    again = Counted()
    recipe = RECIPE if change == "variant" else Recipe(embeddings=RECIPE.embeddings, k=25)
    variant = "repaired" if change == "variant" else ""
    index_folder(folder, recipe, known=index, load=again, variant=variant)
    assert len(again.names) == 5


def test_what_cannot_be_embedded_is_named_and_the_rest_goes_on(folder):
    ball = sphere(subdivisions=2).geometry
    two = np.concatenate([ball.points, ball.points + 9])
    write(TriangleMesh(two, np.concatenate([ball.faces, ball.faces + ball.n])), folder / "two.off")
    write(PointCloud(np.eye(3)), folder / "tiny.xyz")
    (folder / "broken.obj").write_text("v 1 2\n")
    told = []
    index = index_folder(folder, RECIPE, progress=lambda done, total: told.append((done, total)))
    assert len(index.names) == 5
    assert set(index.failures) == {"two.off", "tiny.xyz", "broken.obj"}
    assert "2 components" in index.failures["two.off"]
    assert told == [(i + 1, 8) for i in range(8)]


def test_a_saved_index_finds_the_same(folder, tmp_path):
    index = index_folder(folder, RECIPE)
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
        index_folder(tmp_path, RECIPE).nearest(creature(600))
