"""The commands that search a folder and that label."""

import json

import numpy as np
import pytest
from conftest import creature, joined, moved
from running import printed, record, refusal

from spectra_kit.cli import main
from spectra_kit.features import HeatKernelSignature, ShapeDNA
from spectra_kit.geometry import PointCloud, sphere, torus, write
from spectra_kit.learn import (
    NearestNeighbour,
    PointMLP,
    Recipe,
    ShapeIndex,
    Training,
    save_labeller,
    train_classifier,
    train_segmenter,
)


@pytest.fixture(scope="module")
def shapes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shapes")
    for pose in range(3):
        write(creature(600, pose=pose), folder / f"animal{pose}.off")
    write(torus(n=600).geometry, folder / "ring.ply")
    return folder


@pytest.fixture(scope="module")
def labellers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("labellers")
    animal, ring = creature(600), torus(n=600).geometry
    recipe = Recipe(embeddings=(ShapeDNA(count=8),), k=20)
    whole = train_classifier(
        [animal, ring], [0, 1], recipe=recipe, method=NearestNeighbour(), names=["animal", "ring"]
    )
    parts = train_segmenter(
        [animal], [(animal.points[:, 2] > 0).astype(int)], names=["low", "high"],
        recipe=Recipe(embeddings=(HeatKernelSignature(count=6),), k=20), method=PointMLP(width=8),
        training=Training(epochs=3),
    )  # fmt: skip
    save_labeller(folder / "whole.safetensors", whole)
    save_labeller(folder / "parts.safetensors", parts)
    return folder


def test_animals_are_like_animals(shapes, capsys):
    found = record(capsys, "similar", shapes / "animal1.off", shapes, "-k", 40, "--count", 3)
    assert found["indexed"] == 4
    assert found["left_out"] == {}
    names = [near["name"] for near in found["neighbours"]]
    assert names[0] == "animal1.off"
    assert set(names) == {"animal0.off", "animal1.off", "animal2.off"}
    text, _ = printed(capsys, "similar", shapes / "animal1.off", shapes, "-k", 40)
    assert "nearest of 4 shapes" in text
    assert text.rindex("animal1.off") < text.rindex("animal2.off") < text.rindex("ring.ply")


def test_an_index_is_kept_and_is_of_the_same_samples_alone(shapes, tmp_path, capsys):
    index = tmp_path / "index.safetensors"
    arguments = ("similar", shapes / "animal0.off", shapes, "-k", 30, "--index", index)
    plain = record(capsys, *arguments)
    before = index.read_bytes()
    assert record(capsys, *arguments) == plain
    assert index.read_bytes() == before
    kept = ShapeIndex.load(index)
    sampled = record(capsys, *arguments, "--cloud", 400)
    assert sampled["neighbours"] != plain["neighbours"]
    assert set(kept.digests).isdisjoint(ShapeIndex.load(index).digests)


def test_what_is_left_out_is_told(shapes, tmp_path, capsys):
    write(creature(600), tmp_path / "animal.off")
    write(PointCloud(np.eye(3)), tmp_path / "tiny.xyz")
    ball = sphere(subdivisions=2).geometry
    write(joined(ball, moved(ball, 9, 9, 9)), tmp_path / "two.off")
    arguments = ("similar", shapes / "ring.ply", tmp_path, "-k", 30, "--json")
    out, err = printed(capsys, *arguments)
    assert "warning: left out: tiny.xyz: " in err
    found = json.loads(out)
    assert list(found["left_out"]) == ["tiny.xyz", "two.off"]
    assert "--largest" in found["left_out"]["two.off"]
    assert [near["name"] for near in found["neighbours"]] == ["animal.off"]


def test_searches_that_cannot_be(shapes, tmp_path, capsys):
    asked = ("similar", shapes / "ring.ply")
    assert "hold meshes or clouds" in refusal(capsys, *asked, tmp_path)
    write(PointCloud(np.eye(3)), tmp_path / "tiny.xyz")
    assert main([*map(str, asked), str(tmp_path)]) == 2
    assert "could be embedded" in capsys.readouterr().err
    assert "--count" in refusal(capsys, *asked, shapes, "--count", 0)
    assert ".safetensors" in refusal(capsys, *asked, shapes, "--index", tmp_path / "index.npz")


def test_a_shape_is_named(shapes, labellers, capsys):
    found = record(capsys, "label", shapes / "animal2.off", labellers / "whole.safetensors")
    assert (found["label"], found["name"]) == (0, "animal")
    assert found["scores"] == {"animal": 1.0, "ring": 0.0}
    text, _ = printed(capsys, "label", shapes / "animal2.off", labellers / "whole.safetensors")
    assert text.splitlines()[0].endswith("animal2.off: animal")


def test_parts_are_written(shapes, labellers, tmp_path, capsys):
    output = tmp_path / "parts.npz"
    found = record(
        capsys, "label", shapes / "animal0.off", labellers / "parts.safetensors", "-o", output
    )
    assert [part["name"] for part in found["parts"]] == ["low", "high"]
    assert sum(part["share"] for part in found["parts"]) == pytest.approx(1)
    with np.load(output) as file:
        assert file["labels"].shape == (600,)
        assert file["face_labels"].shape == (1196,)
        assert file["names"].tolist() == ["low", "high"]
        np.testing.assert_array_equal(file["scores"].argmax(axis=1), file["labels"])


def test_labels_that_cannot_be(shapes, labellers, tmp_path, capsys):
    asked = ("label", shapes / "ring.ply", labellers / "whole.safetensors")
    assert "--output" in refusal(capsys, *asked, "-o", tmp_path / "a.npz")
    assert "labeller" in refusal(capsys, "label", shapes / "ring.ply", shapes / "ring.ply")
    absent = refusal(capsys, "label", shapes / "ring.ply", tmp_path / "none.safetensors")
    assert "there is no such labeller" in absent
