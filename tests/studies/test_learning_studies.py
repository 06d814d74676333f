"""The studies of classification and segmentation: protocol, marks, memory and commands."""

import json
from dataclasses import replace

import numpy as np
import pytest
from studies import run as command
from studies.learning import classification, labelled, segmentation
from studies.learning.classification import (
    FREE,
    TRAINED,
    Draws,
    Row,
    Vectors,
    View,
    classify_all,
    drawn,
    rows_named,
    shape_of,
)
from studies.learning.classify import summarize
from studies.learning.labelled import SEGMENTED, demo_set, read_set
from studies.learning.segment import held_out
from studies.learning.segmentation import Parts, PartsRow, marks, parts_rows
from studies.store import Store
from studies.study import run

from spectra_kit.errors import InvalidInputError

MESH = View("mesh", "exact")


@pytest.fixture(scope="module")
def shapes():
    return demo_set()


@pytest.fixture(autouse=True)
def fewer_modes(monkeypatch):
    monkeypatch.setattr(classification, "K", 64)
    monkeypatch.setattr(segmentation, "K", 24)


def scores_of(labels, classes):
    return np.eye(classes)[labels]


# --- sets ---


def write_set(path, shapes, *, whole):
    meshes = shapes.meshes
    arrays = {
        "V": np.concatenate([m.points for m in meshes]).astype(np.float32),
        "F": np.concatenate([m.faces for m in meshes]).astype(np.uint16),
        "voff": np.cumsum([0, *(m.n for m in meshes)]),
        "foff": np.cumsum([0, *(len(m.faces) for m in meshes)]),
    }
    if whole:
        arrays |= {"label": shapes.labels, "is_train16": shapes.is_train, "classes": shapes.classes}
    else:
        # Classes are counted from any number on.
        arrays |= {
            "vert_label": np.concatenate(shapes.vertex_labels) + 3,
            "face_label": np.concatenate(shapes.face_labels) + 3,
            "is_train": shapes.is_train,
        }
    np.savez(path, **arrays)


@pytest.mark.parametrize("whole", [False, True])
def test_a_packed_set_is_read_as_it_was(shapes, tmp_path, whole):
    write_set(tmp_path / "set.npz", shapes, whole=whole)
    found = read_set("set", tmp_path / "set.npz")
    for own, other in zip(shapes.meshes, found.meshes, strict=True):
        np.testing.assert_allclose(other.points, own.points, atol=1e-6)
        np.testing.assert_array_equal(other.faces, own.faces)
    assert found.train.tolist() == shapes.train.tolist()
    if whole:
        assert found.classes == shapes.classes
        np.testing.assert_array_equal(found.labels, shapes.labels)
    else:
        for name in ("vertex_labels", "face_labels"):
            for own, other in zip(getattr(shapes, name), getattr(found, name), strict=True):
                np.testing.assert_array_equal(other, own)


# --- draws ---


@pytest.mark.parametrize("validated", [False, True])
def test_examples_are_of_the_training_split_and_never_tested_on(shapes, validated):
    seen = set()
    for seed in range(10):
        known, tested = drawn(shapes, 2, [seed, 0], validated=validated)
        assert np.bincount(shapes.labels[known]).tolist() == [2, 2, 2]
        assert shapes.is_train[known].all()
        assert not set(known) & set(tested)
        assert shapes.is_train[tested].all() == validated
        seen |= {tuple(known)}
    assert len(seen) > 5
    assert drawn(shapes, 2, [0, 0], validated=False)[1].tolist() == shapes.test.tolist()


def draws_of(shapes, folder, *rows, validated=False):
    vectors = Vectors(folder=folder, contenders=[], problems=[], shapes=shapes, validated=validated)
    return Draws(
        folder=folder, contenders=rows, problems=[0, 1], shapes=shapes, vectors=vectors, draws=3
    )


def test_classes_are_told_by_heads_also_turned(shapes, tmp_path):
    row = Row(MESH, "heat", "nearest", 3)
    study = draws_of(shapes, tmp_path, row)
    results = classify_all(study, jobs=0)
    [cell] = summarize(results)
    assert cell["draws"] == 6
    assert cell["mean"] > 80
    # Turned meshes have the same spectra, but for rounding.
    assert cell["turned"] == pytest.approx(cell["mean"], abs=1e-9)
    confused = np.sum([r.record["confused"] for r in results], axis=0)
    assert confused.sum() == 6 * len(shapes.test)
    assert np.trace(confused) / confused.sum() == pytest.approx(cell["mean"] / 100)


def test_what_is_chosen_by_sees_no_test_shape(shapes, tmp_path, monkeypatch):
    seen = set()

    def noted(shapes, i, *options, **names):
        seen.add(i)
        return shape_of(shapes, i, *options, **names)

    monkeypatch.setattr(classification, "shape_of", noted)
    study = draws_of(shapes, tmp_path, Row(MESH, "dna", "nearest", 3), validated=True)
    results = classify_all(study, jobs=0)
    assert seen == set(shapes.train)
    assert all(result.record["turned"] == [] for result in results)
    assert np.sum([r.record["confused"] for r in results]) == 6 * 3  # one of each class is left


def test_the_rows_have_names(shapes):
    assert rows_named([str(row) for row in FREE + TRAINED], FREE + TRAINED) == FREE + TRAINED
    assert len({str(row) for row in FREE + TRAINED}) == len(FREE + TRAINED)
    with pytest.raises(InvalidInputError, match="`rows` must be of these"):
        rows_named(["dna by magic"], FREE)
    for name in SEGMENTED:
        assert len(set(parts_rows(name))) == len(parts_rows(name))


# --- marks ---


def test_what_is_all_right_has_all_marks(shapes):
    right = [(i, scores_of(shapes.vertex_labels[i], 3)) for i in shapes.test]
    # Faces across the border may go to either side: their own scores tell.
    found = marks(shapes, right)
    assert found["vertices"] == 1
    assert found["edges"] > 0.99
    wrong = [(i, scores_of(1 - shapes.vertex_labels[i], 3)) for i in shapes.test]
    found = marks(shapes, wrong)
    assert found["vertices"] == 0
    assert found["iou"] < 0.03


def test_a_class_for_all_has_the_marks_of_its_share(shapes):
    i = int(shapes.test[0])
    mesh, truth = shapes.meshes[i], shapes.face_labels[i]
    share = mesh.face_areas[truth == 0].sum() / mesh.area
    found = marks(shapes, [(i, scores_of(np.zeros(mesh.n, dtype=int), 3))])
    assert found["area"] == pytest.approx(share)
    assert found["faces"] == pytest.approx((truth == 0).mean())
    assert found["iou"] == pytest.approx(share / 2)  # of the two classes that there are
    beside = share + 0.15
    assert share < found["edges"] < beside


def test_shapes_count_alike_in_any_unit(shapes):
    answers = [(int(i), scores_of(1 - shapes.vertex_labels[i], 3)) for i in shapes.test]
    answers += [(int(i), scores_of(shapes.vertex_labels[i], 3)) for i in shapes.train]
    larger = tuple(
        m.with_points(m.points * (1 + 99 * (i % 2))) for i, m in enumerate(shapes.meshes)
    )
    one, other = marks(shapes, answers), marks(replace(shapes, meshes=larger), answers)
    assert other == pytest.approx(one)


# --- parts ---


@pytest.mark.slow
def test_parts_are_learned_and_kept(shapes, tmp_path):
    row = PartsRow("demo", MESH, "coordinates", "mlp", shots=9)
    first, known = shapes.test[0], np.random.default_rng(0).permutation(shapes.train)[0]
    twice = {
        name: tuple(getattr(shapes, name)[known if i == first else i] for i in range(18))
        for name in ("meshes", "vertex_labels", "face_labels")
    }
    shapes = replace(shapes, **twice)  # one of the test split is learned from, too
    study = Parts(folder=tmp_path, contenders=[row], problems=[0], sets={"demo": shapes}, epochs=2)
    (result,) = run(study, Store(tmp_path), jobs=0)
    record = result.record
    assert record["examples"] == 9
    assert record["seen"] == 1
    assert record["unseen"]["iou"] != record["iou"]
    assert [epoch for epoch, _ in record["curve"]] == [1, 2]
    assert 0 < record["iou"] <= 1
    assert record["turned"]["iou"] == pytest.approx(record["iou"], abs=0.2)
    from spectra_kit.learn import load_labeller

    saved = next(name for name in record["files"] if name.endswith(".safetensors"))
    labeller = load_labeller(tmp_path / saved)
    arrays = next(name for name in record["files"] if name.endswith(".npz"))
    with np.load(tmp_path / arrays) as labels:
        for i in shapes.test:
            told = labeller.segment(shapes.meshes[i]).labels
            np.testing.assert_array_equal(told, labels[str(i)])


def test_what_splits_a_set_is_part_of_the_key(shapes, tmp_path):
    row = PartsRow("demo", MESH, "coordinates", "mlp")
    count, keys = len(shapes.meshes), set()
    for validated in (False, True):
        for sources in ((), tuple("abc"[i % 3] for i in range(count)), ("a", "b") * (count // 2)):
            study = Parts(
                folder=tmp_path, contenders=[row], problems=[0], validated=validated,
                sets={"demo": replace(shapes, sources=sources)},
            )  # fmt: skip
            keys.add(study.key(row, 0))
    assert len(keys) == 4  # sources split the training split alone


def test_a_twin_of_what_is_held_out_is_not_learned_from(shapes, tmp_path):
    first, *others = shapes.train
    sources = tuple("a" if i == first else "b" for i in range(len(shapes.meshes)))
    meshes = list(shapes.meshes)
    meshes[others[0]] = meshes[first]
    twins = replace(shapes, meshes=tuple(meshes), sources=sources)
    held = Parts(folder=tmp_path, contenders=[], problems=[0], sets={"demo": twins}, validated=True)
    known, tested = held._split(twins, 0, 0)
    assert tested.tolist() == [first]
    assert sorted(known) == others[1:]
    with pytest.raises(InvalidInputError, match="shapes to learn from and others to test on"):
        held._split(replace(twins, sources=("a",) * len(sources)), 0, 0)


def test_a_source_of_the_training_split_is_held_out_to_choose_by(shapes, tmp_path):
    names = tuple("abc"[i % 3] for i in range(len(shapes.meshes)))
    sources = replace(shapes, sources=names)
    for seed in range(4):
        rows = [PartsRow("demo", MESH, "coordinates", "diffusion")]
        held = Parts(
            folder=tmp_path,
            contenders=rows,
            problems=[seed],
            sets={"demo": sources},
            validated=True,
        )
        known, tested = held._split(sources, 0, seed)
        assert {names[i] for i in tested} == {"abc"[seed % 3]}
        assert held_out(held) == [{"set": "demo", "seed": seed, "source": "abc"[seed % 3]}]
        assert set(known) | set(tested) == set(shapes.train)
        assert not set(known) & set(tested)
    with pytest.raises(InvalidInputError, match="`shots` must be at most 12"):
        replace(held, validated=False)._split(shapes, 13, 0)


# --- commands ---


@pytest.mark.slow
def test_both_commands_write_their_tables(shapes, tmp_path, monkeypatch):
    monkeypatch.setattr(labelled, "demo_set", lambda: shapes)
    out, row = tmp_path / "classes", "heat, nearest; mesh, exact"
    words = ["classification", str(out), "--set", "demo", "--rows", row, "--shots", "2"]
    assert command.main([*words, "--seeds", "1", "--draws", "2", "--jobs", "0"]) == 0
    [found] = json.loads((out / "classification.json").read_text())["tables"]["Per cent told right"]
    assert (found["row"], found["examples"], found["draws"]) == (row, 2, 2)
    out, row = tmp_path / "parts", "demo: coordinates, diffusion; mesh, exact; all; upright"
    words = ["segmentation", str(out), "--set", "demo", "--rows", row, "--epochs", "1"]
    assert command.main([*words, "--jobs", "0", "--no-pictures"]) == 0
    [found] = json.loads((out / "segmentation.json").read_text())["tables"]["Parts told right"]
    assert (found["row"], found["seeds"], found["epochs"]) == (row, 1, 1)
    assert {"new: iou", "to 0.80"} <= found.keys()
    assert command.main([*words[:5], "magic"]) == 2
