"""Classifiers and segmenters: what they learn, carry, save, resume and refuse."""

import json
import sys
import time
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from conftest import creature, refused
from safetensors import safe_open
from safetensors.torch import save

from spectra_kit._core.fingerprint import sealed
from spectra_kit.eigen import Neo
from spectra_kit.errors import InvalidFileError, InvalidInputError, MissingDependencyError
from spectra_kit.features import (
    BasisFunctions,
    Coordinates,
    HeatKernelSignature,
    ShapeDNA,
    WaveKernelSignature,
)
from spectra_kit.geometry import PointCloud, TriangleMesh, sample, sphere, torus
from spectra_kit.learn import (
    DiffusionNet,
    Hierarchical,
    LinearDiscriminant,
    NearestNeighbour,
    PointMLP,
    PointNet,
    Recipe,
    ShapeIndex,
    SupportVectors,
    Training,
    load_labeller,
    save_labeller,
    train_classifier,
    train_segmenter,
)
from spectra_kit.learn.examples import prepared
from spectra_kit.learn.fitting import _loss, fit, predicted
from spectra_kit.learn.labellers import carried
from spectra_kit.neo import NeoSubspace, load_pretrained

DNA = Recipe(embeddings=(ShapeDNA(count=10), WaveKernelSignature(count=6)), k=20)
POINTS = Recipe(embeddings=(HeatKernelSignature(count=6),), k=20)
HEADS = [NearestNeighbour(), LinearDiscriminant(), SupportVectors()]


@pytest.fixture(scope="module")
def shapes():
    """Animals and rings, sampled twice each: the second of each kind to test on."""
    kinds = [creature(1500, seed=s).as_cloud() for s in range(3)]
    kinds += [torus(n=1500, minor=m).geometry for m in (0.3, 0.35, 0.4)]
    clouds = [
        PointCloud(shape.points[np.random.default_rng(i).permutation(shape.n)[:500]])
        for i, shape in enumerate(kinds)
    ]
    return clouds, np.repeat([0, 1], 3)


def north(mesh):
    return (mesh.points[:, 2] > 0).astype(int)


@pytest.mark.parametrize("method", [*HEADS, PointNet(width=8)], ids=str)
def test_what_was_not_seen_is_told_right_in_any_unit_and_place(shapes, method):
    clouds, labels = shapes
    known = [0, 1, 3, 4]
    recipe = POINTS if isinstance(method, PointNet) else DNA
    found = train_classifier(
        [clouds[i] for i in known],
        labels[known],
        recipe=recipe,
        method=method,
        names=["animal", "ring"],
        training=Training(epochs=15, points=200),
    )
    for i, name in ((2, "animal"), (5, "ring")):
        told = found.classify(clouds[i])
        assert told.name == name
        assert told.scores.sum() == pytest.approx(1)
        moved = found.classify(PointCloud(1e3 * clouds[i].points[:, [1, 2, 0]] + 7))
        assert moved.name == name
        np.testing.assert_allclose(moved.scores, told.scores, atol=1e-3)


@pytest.mark.parametrize(("backbone", "epochs"), [("pointnet++", 8), ("point-transformer", 12)])
def test_hierarchical_networks_tell_a_turned_egg_from_a_ring(backbone, epochs):
    egg = PointCloud(sphere(subdivisions=3).geometry.points[::2] * [1, 1, 2.5])
    shapes = [egg, torus(n=300, minor=0.3).geometry]
    recipe = Recipe(embeddings=(Coordinates(),))
    _, curve = fit(
        recipe,
        Hierarchical(backbone=backbone, width=16, features=False),
        [prepared(recipe, shape)[0] for shape in shapes] * 4,
        [torch.tensor(i) for i in range(2)] * 4,
        classes=2,
        training=Training(epochs=epochs, points=64, rate=5e-3, smoothing=0.0),
    )
    # Who knows nothing has log 2, and stays there.
    assert np.mean([seen["loss"] for seen in curve[-epochs // 4 :]]) < 0.9 * np.log(2)


def test_one_example_a_class_is_enough_for_each_head(shapes):
    clouds, _ = shapes
    for head in HEADS:
        found = train_classifier([clouds[0], clouds[3]], [0, 1], recipe=DNA, method=head)
        assert found.classify(clouds[4]).label == 1


def test_the_nearest_is_so_by_the_sum_of_scaled_differences():
    rng = np.random.default_rng(0)
    vectors, labels = rng.normal(size=(30, 5)) * [1, 10, 100, 1e-3, 1], np.arange(30)
    asked = rng.normal(size=(8, 5)) * [1, 10, 100, 1e-3, 1]
    gaps = np.abs(asked[:, None] - vectors) / vectors.std(axis=0)
    found = NearestNeighbour().fit(vectors, labels).predict(asked)
    assert found.tolist() == gaps.sum(axis=2).argmin(axis=1).tolist()
    plain = NearestNeighbour(scaled=False).fit(vectors, labels).predict(asked)
    assert plain.tolist() == np.abs(asked[:, None] - vectors).sum(2).argmin(1).tolist()


def test_discriminants_find_the_direction_that_tells():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(600, 1)) * 3
    labels = np.arange(600) % 2
    vectors = np.hstack([noise + labels[:, None], noise]) + 0.2 * rng.normal(size=(600, 2))
    right = [
        (head.fit(vectors[:300], labels[:300]).predict(vectors[300:]) == labels[300:]).mean()
        for head in (LinearDiscriminant(), NearestNeighbour())
    ]
    # The difference of the columns has a spread of 0.28 around classes that are 1 apart.
    assert right[0] > 0.85
    assert right[1] < right[0]


@pytest.mark.parametrize(
    ("method", "recipe"),
    [
        (PointMLP(width=16), Recipe(embeddings=(Coordinates(frame="principal"),), k=20)),
        (DiffusionNet(width=16, depth=2, dropout=0.0), POINTS),
        (
            PointNet(width=8),
            Recipe(
                embeddings=(BasisFunctions(subspace=NeoSubspace(), masses=False),),
                k=20,
                solver=Neo(),
            ),
        ),
    ],
    ids=str,
)
def test_parts_are_learned_and_carried_to_other_samplings(method, recipe):
    mesh = creature(900)
    legs = (mesh.points[:, 2] < np.quantile(mesh.points[:, 2], 0.4)).astype(int)
    found = train_segmenter(
        [mesh], [legs], recipe=recipe, method=method, training=Training(epochs=30, rate=1e-2)
    )
    told = found.segment(mesh)
    assert (told.labels == legs).mean() > 0.95
    assert told.face_labels.shape == (len(mesh.faces),)
    faces = legs[mesh.faces]
    whole = np.ptp(faces, axis=1) == 0
    assert (told.face_labels[whole] == faces[whole, 0]).mean() > 0.95
    np.testing.assert_allclose(told.scores.sum(axis=1), 1, atol=1e-6)
    other = creature(1400)
    truth = (other.points[:, 2] < np.quantile(mesh.points[:, 2], 0.4)).astype(int)
    assert (found.segment(other).labels == truth).mean() > 0.9
    cloud = found.segment(other.as_cloud())
    assert cloud.face_labels is None


def test_scores_between_samples_are_theirs_by_nearness():
    ends, scores = PointCloud([[0, 0, 0], [1, 0, 0]]), np.array([[1.0, 0.0], [0.0, 1.0]])
    asked = PointCloud([[0.25, 0, 0], [1, 0, 0]])
    assert carried(ends, scores, asked) == pytest.approx(np.array([[0.75, 0.25], [0, 1]]), abs=1e-8)


def test_labels_of_samples_are_carried_to_the_vertices():
    mesh = creature(2500)
    recipe = Recipe(embeddings=(Coordinates(frame="principal"),), k=20, points=900)
    found = train_segmenter(
        [mesh], [north(mesh)], recipe=recipe, method=PointMLP(width=32),
        training=Training(epochs=60, rate=1e-2),
    )  # fmt: skip
    told = found.segment(mesh)
    assert told.labels.shape == (mesh.n,)
    away = np.abs(mesh.points[:, 2]) > 0.05 * np.ptp(mesh.points[:, 2])
    assert (told.labels == north(mesh))[away].mean() > 0.97


def test_faces_teach_what_votes_at_their_corners_do_not():
    # A belt narrower than the edges: most of its vertices have more faces outside it.
    ball = sphere(subdivisions=3).geometry
    belt = np.abs(ball.points[ball.faces].mean(axis=1)[:, 2]) < 0.05
    votes = np.bincount(ball.faces.ravel(), np.repeat(belt - 0.5, 3), minlength=ball.n) > 0

    def found(labels, of, points=None):
        told = train_segmenter(
            [ball], [labels.astype(int)], of=of, names=["ball", "belt"],
            recipe=Recipe(embeddings=(Coordinates(),), k=20, upright=True, points=points),
            method=PointMLP(width=32), training=Training(epochs=60, rate=2e-2, smoothing=0.0),
        ).segment(ball)  # fmt: skip
        return told.labels == 1, told.face_labels == 1

    def overlap(one, other):
        return (one & other).sum() / (one | other).sum()

    by_faces, by_votes = found(belt, "faces")[1], found(votes, "points")[1]
    assert overlap(by_votes, belt) < 0.6
    assert overlap(by_faces, belt) > 0.9
    # Samples have the label of the face that they lie on.
    high = ball.points[ball.faces].mean(axis=1)[:, 2] > 0
    assert overlap(found(high, "faces", points=1000)[0], north(ball) == 1) > 0.95


def test_what_is_unknown_teaches_nothing():
    generator = torch.Generator().manual_seed(0)
    logits = torch.randn(2, 50, 3, generator=generator, requires_grad=True)
    truth = torch.randint(-1, 3, (2, 50), generator=generator)
    known = truth >= 0
    loss = _loss(logits, truth, 0.1)
    expected = torch.nn.functional.cross_entropy(logits[known], truth[known], label_smoothing=0.1)
    torch.testing.assert_close(loss, expected)
    (slope,) = torch.autograd.grad(loss, logits)
    assert (slope[~known] == 0).all()
    assert (slope[known].abs().sum(-1) > 0).all()
    nothing = _loss(logits, torch.full_like(truth, -1), 0.1)
    assert nothing == 0
    assert (torch.autograd.grad(nothing, logits)[0] == 0).all()


def test_a_batch_of_which_nothing_is_known_does_no_harm():
    mesh = creature(600)
    unknown = np.full(mesh.n, -1)
    recipe = Recipe(embeddings=(Coordinates(frame="principal"),), k=20)
    found = train_segmenter(
        [mesh, mesh], [north(mesh), unknown], recipe=recipe, method=PointMLP(width=16),
        training=Training(epochs=60, batch=1, rate=5e-3),
    )  # fmt: skip
    assert (found.segment(mesh).labels == north(mesh)).mean() > 0.9


def test_samples_must_hold_an_example_of_each_class():
    mesh = creature(3000)
    labels = np.full(mesh.n, -1)
    labels[:2] = 0, 1
    recipe = Recipe(embeddings=(Coordinates(),), k=20, points=60)
    with pytest.raises(InvalidInputError, match="have an example of each class"):
        train_segmenter([mesh], [labels], recipe=recipe, method=PointMLP(width=4))


def test_where_shapes_stand_upright_up_counts():
    ball = sphere(subdivisions=3).geometry
    right = []
    for upright in (True, False):
        found = train_segmenter(
            [ball], [north(ball)], method=PointMLP(width=16),
            recipe=Recipe(embeddings=(Coordinates(),), k=20, upright=upright),
        )  # fmt: skip
        right.append((found.segment(ball).labels == north(ball)).mean())
    assert right[0] > 0.95
    assert right[1] < 0.7  # of a ball that is turned at random, nobody can tell


def test_same_seed_same_network_another_another():
    mesh = creature(600)
    recipe = Recipe(embeddings=(HeatKernelSignature(count=4), Coordinates()), k=20)
    network = DiffusionNet(width=8, depth=1)  # with dropout
    scores = [
        train_segmenter(
            [mesh], [north(mesh)], recipe=recipe, method=network,
            training=Training(epochs=3, copies=1, seed=seed),
        ).segment(mesh).scores
        for seed in (0, 0, 1)
    ]  # fmt: skip
    np.testing.assert_array_equal(scores[0], scores[1])
    assert np.abs(scores[0] - scores[2]).max() > 1e-3


class StoppedError(Exception):
    pass


def test_an_interrupted_run_goes_on_to_the_same_end(tmp_path):
    mesh = creature(600)
    recipe = Recipe(embeddings=(HeatKernelSignature(count=4), Coordinates()), k=20)
    network, training = DiffusionNet(width=8, depth=1), Training(epochs=5, points=None)
    example, _ = prepared(recipe, mesh, network.sees)
    labels = torch.from_numpy(north(mesh))

    def run(folder, watch=None):
        return fit(
            recipe, network, [example, example], [labels, labels], classes=2,
            training=training, folder=folder, watch=watch,
        )  # fmt: skip

    def stop(model, epoch):
        if epoch == 4:
            raise StoppedError
        return {}

    whole, curve = run(None)
    with pytest.raises(StoppedError):
        run(tmp_path, stop)
    resumed, again = run(tmp_path)
    assert [one["epoch"] for one in again] == [1, 2, 3, 4, 5]
    assert again == curve
    np.testing.assert_array_equal(
        predicted(resumed, recipe, example), predicted(whole, recipe, example)
    )
    other = Training(epochs=5, rate=1e-3)
    turned, _ = prepared(recipe, creature(600, pose=1), network.sees)
    for shown, told in (([turned, example], [labels, labels]), ([example] * 2, [1 - labels] * 2)):
        with pytest.raises(InvalidInputError, match="or of other examples"):
            fit(recipe, network, shown, told, classes=2, training=training, folder=tmp_path)
    with pytest.raises(InvalidInputError, match="hold a checkpoint of the same run"):
        fit(recipe, network, [example, example], [labels, labels], classes=2, training=other,
            folder=tmp_path)  # fmt: skip


@pytest.mark.parametrize("method", [*HEADS, PointNet(width=8)], ids=str)
def test_a_saved_classifier_tells_the_same(shapes, method, tmp_path):
    clouds, labels = shapes
    recipe = POINTS if isinstance(method, PointNet) else DNA
    found = train_classifier(
        clouds, labels, recipe=recipe, method=method, training=Training(epochs=2)
    )
    save_labeller(tmp_path / "a.safetensors", found)
    again = load_labeller(tmp_path / "a.safetensors")
    assert repr(again) == repr(found)
    for cloud in clouds[:2]:
        np.testing.assert_array_equal(again.classify(cloud).scores, found.classify(cloud).scores)


def test_a_saved_segmenter_tells_the_same(tmp_path):
    mesh = creature(600)
    recipe = Recipe(
        embeddings=(HeatKernelSignature(count=4), Coordinates()), k=20, solver=Neo(poses=1)
    )
    found = train_segmenter(
        [mesh], [north(mesh)], recipe=recipe, method=DiffusionNet(width=8, depth=2),
        training=Training(epochs=2), names=["south", "north"],
    )  # fmt: skip
    save_labeller(tmp_path / "a.safetensors", found)
    again = load_labeller(tmp_path / "a.safetensors")
    assert (again.names, again.recipe, again.method) == (found.names, found.recipe, found.method)
    np.testing.assert_array_equal(again.segment(mesh).scores, found.segment(mesh).scores)


def test_a_network_of_ones_own_is_not_saved(tmp_path):
    network = load_pretrained("small").network
    recipe = Recipe(embeddings=(BasisFunctions(subspace=NeoSubspace(network)),), k=20)
    mesh = creature(600)
    found = train_segmenter(
        [mesh], [north(mesh)], recipe=recipe, method=PointMLP(width=4),
        training=Training(epochs=1),
    )  # fmt: skip
    with pytest.raises(InvalidInputError, match=r"got NeoNetwork; save the network's weights"):
        save_labeller(tmp_path / "a.safetensors", found)
    assert not list(tmp_path.iterdir())


def rewritten(path, change, *, seal=True):
    """Write a file of learning again with what `change` does to its content and tensors."""
    with safe_open(path, "pt") as file:
        content = json.loads(file.metadata()["spectra_kit.learning"])
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    content["sha256"] = "0" * 64
    change(content, tensors)
    data = save(tensors, {"spectra_kit.learning": json.dumps(content)})
    path.write_bytes(sealed(data) if seal else data)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Files of a segmenter, of a classifier by a head, and of an index."""
    folder, ball = tmp_path_factory.mktemp("saved"), sphere(subdivisions=2).geometry
    recipe = Recipe(embeddings=(Coordinates(),), upright=True)
    segmenter = train_segmenter(
        [ball], [north(ball)], recipe=recipe, method=PointMLP(width=8), training=Training(epochs=1)
    )
    save_labeller(folder / "segmenter.safetensors", segmenter)
    both = [ball, torus(n=400).geometry]
    classifier = train_classifier(both, [0, 1], recipe=DNA, method=NearestNeighbour())
    save_labeller(folder / "classifier.safetensors", classifier)
    ShapeIndex(DNA, ("a", "b"), ("c", "d"), np.eye(2)).save(folder / "index.safetensors")
    return folder


@pytest.mark.parametrize("name", ["segmenter", "classifier", "index"])
def test_no_bit_turns_unseen(saved, tmp_path, name):
    load = ShapeIndex.load if name == "index" else load_labeller
    data, path = (saved / f"{name}.safetensors").read_bytes(), tmp_path / "a.safetensors"
    rng = np.random.default_rng(0)
    for place in [*rng.integers(8, len(data), 40), len(data) - 1]:
        changed = bytearray(data)
        changed[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(changed)
        with pytest.raises(InvalidFileError, match=str(path)):
            load(path)
    path.write_bytes(data)
    load(path)


@pytest.mark.parametrize("name", ["segmenter", "classifier", "index"])
def test_files_of_release_0_2_0_are_read_without_a_checksum(saved, tmp_path, name):
    path = tmp_path / "a.safetensors"
    path.write_bytes((saved / f"{name}.safetensors").read_bytes())

    def old(content, _):
        del content["sha256"]
        content["format"] = 1

    rewritten(path, old, seal=False)
    (ShapeIndex.load if name == "index" else load_labeller)(path)
    rewritten(path, lambda content, _: content.update(format=2, sha256=None), seal=False)
    with pytest.raises(InvalidFileError, match="another checksum than it says"):
        (ShapeIndex.load if name == "index" else load_labeller)(path)


def method(**options):
    return lambda content, _: content["method"].update(options)


def inputs(count):
    return lambda content, _: content.update({"network inputs": count})


@pytest.mark.parametrize(
    ("name", "change", "problem"),
    [
        ("segmenter", method(depth=10**5), "`depth` must be at most 16, the tensors there are"),
        ("segmenter", method(depth=10**9), "`depth` must be at most 16, the tensors there are"),
        ("segmenter", method(depth=2), "`tensors` must be those of the method"),
        ("segmenter", method(width=9), "`tensors` must be those of the method"),
        ("segmenter", method(width=10**9), "tensors"),
        ("segmenter", method(width=-8), "`width` must be at least 1"),
        ("segmenter", inputs(10**9), "`tensors` must be those of the method"),
        ("segmenter", inputs("3"), "`inputs` must be an integer"),
        ("segmenter", method(type="PointNet"), "not a whole labeller"),
        ("segmenter", method(type="DiffusionNet"), "`tensors` must be those of the method"),
        ("segmenter", method(type="Recipe"), "not a whole labeller"),
        ("segmenter", lambda content, _: content.update(kind="Judge"), "not a whole labeller"),
        ("segmenter", lambda content, _: content["names"].append("c"), "`tensors` must be those"),
        ("segmenter", lambda _, t: t.update(more=t["mean"] + 0), "`tensors` must be those"),
        ("segmenter", lambda _, t: t["mean"].fill_(torch.nan), "`tensors` must be finite"),
        ("classifier", method(neighbours=9), "`vectors` must have 9 rows or more"),
        ("classifier", lambda content, _: content["recipe"].update(k=-6), "`k` must be at least 1"),
        ("classifier", lambda _, t: t["labels"].add_(64), "`labels` must be in [0, 2), got"),
        ("classifier", lambda _, t: t["labels"].sub_(1), "`labels` must be in [0, 2), got -1"),
        ("classifier", lambda _, t: t.update(labels=t["labels"] * 0.5), "`labels` must hold int"),
        ("classifier", lambda _, t: t.update(labels=t["labels"][:1]), "must be 2 integers"),
        ("classifier", lambda _, t: t.pop("vectors"), "not a whole labeller"),
        ("classifier", lambda content, _: content["names"].pop(), "in [0, 1)"),
        ("index", lambda _, t: t.update(vectors=t["vectors"][:1]), "`vectors` must have 2 rows"),
        ("index", lambda content, _: content.update(names="ab"), "`names` must"),
        ("index", lambda content, _: content["recipe"].update(k=0), "`k` must be at least 1"),
    ],
)  # fmt: skip
def test_files_that_say_what_cannot_be_are_refused_at_once(saved, tmp_path, name, change, problem):
    path = tmp_path / "a.safetensors"
    path.write_bytes((saved / f"{name}.safetensors").read_bytes())
    rewritten(path, change)
    start = time.process_time()
    with pytest.raises(InvalidFileError) as caught:
        (ShapeIndex.load if name == "index" else load_labeller)(path)
    assert time.process_time() - start < 1
    assert str(caught.value).startswith(f"{path}: ")
    assert problem in str(caught.value)


def test_an_index_of_other_columns_than_its_recipe_gives(saved, tmp_path):
    index = ShapeIndex.load(saved / "index.safetensors")
    refused("recipe", "give as many numbers as the index has columns, 2", index.nearest,
            creature(600))  # fmt: skip


def test_weights_are_no_labeller(tmp_path):
    from spectra_kit.neo import NeoConfig, NeoNetwork, save_weights

    tiny = NeoConfig(width=16, depth=1, heads=2, head_width=8, latents=4, m=16, k=8)
    save_weights(tmp_path / "a.safetensors", NeoNetwork(tiny), {})
    with pytest.raises(InvalidFileError, match="not a whole labeller"):
        load_labeller(tmp_path / "a.safetensors")


BALL = sphere(subdivisions=2).geometry


@pytest.mark.parametrize(
    ("labels", "names", "message"),
    [
        ([0], None, r"`labels` must have shape \(2,\), one for each of the shapes, got \(1,\)"),
        ([0, 2], None, r"an example of each class, got none of class 1 \('1'\)"),
        ([0, 1], ["a", "b", "c"], r"got none of class 2 \('c'\)"),
        ([0, 1], ["a", "a"], "`names` must be words, each for one class"),
        ([0, 1], ["a", ""], "`names` must be words, each for one class"),
        ([0, 10**12], None, "`labels` must be less than 65536, got 1000000000000"),
        ([0, 3], ["a", "b"], "`labels` must be less than 2, the number of names, got 3"),
        ([0, 0], None, "`labels` must be of two classes or more, got 1"),
        ([0, -1], None, "`labels` must be 0 or more, got -1"),
        ([0.0, 1.0], None, "hold integers, the numbers of the classes, got dtype float64"),
    ],
)
def test_labels_that_do_not_fit(labels, names, message):
    with pytest.raises(InvalidInputError, match=message):
        train_classifier([BALL, BALL], labels, recipe=DNA, method=NearestNeighbour(), names=names)


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ([north(BALL)], "`labels` must hold an array for each of 2 shapes, got 1"),
        ([north(BALL), north(BALL)[:-1]], r"`labels\[1\]` must have shape \(162,\)"),
        ([north(BALL), north(BALL) - 2], r"`labels\[1\]` must be -1 or more, got -2"),
        ([0 * north(BALL)] * 2, "of two classes or more"),
        ([2 * north(BALL)] * 2, "got none of class 1"),
    ],
)
def test_labels_of_points_that_do_not_fit(labels, message):
    with pytest.raises(InvalidInputError, match=message):
        train_segmenter([BALL, BALL], labels, recipe=POINTS, method=PointMLP(width=4))


def test_labels_of_faces_that_do_not_fit():
    low, method = np.zeros(len(BALL.faces), dtype=int), PointMLP(width=4)
    low[:9] = 1
    with pytest.raises(InvalidInputError, match=r"\(320,\), one for each of the faces, got \(162,"):
        train_segmenter([BALL], [north(BALL)], of="faces", recipe=POINTS, method=method)
    cloud = BALL.as_cloud()
    with pytest.raises(InvalidInputError, match=r"`shapes\[1\]` must be a mesh.*got PointCloud"):
        train_segmenter([BALL, cloud], [low, low], of="faces", recipe=POINTS, method=method)
    with pytest.raises(InvalidInputError, match=r"`points` must be None.*labels are of faces"):
        train_segmenter(
            [BALL], [low], of="faces", recipe=POINTS, method=method, training=Training(points=9)
        )


def test_shapes_that_cannot_be_told():
    known = train_classifier(
        [BALL, torus(n=400).geometry], [0, 1], recipe=DNA, method=NearestNeighbour()
    )
    two = TriangleMesh(
        np.concatenate([BALL.points, BALL.points + 5]),
        np.concatenate([BALL.faces, BALL.faces + BALL.n]),
    )
    told = r"be connected.*got 2 components; .*label them one"
    with pytest.raises(InvalidInputError, match=told):
        known.classify(two)
    with pytest.raises(InvalidInputError, match="point"):
        known.classify(PointCloud([[0.0, 0, 0]]))
    with pytest.raises(InvalidInputError, match="`k` must be"):
        known.classify(sphere(subdivisions=0).geometry)  # 12 points, 20 modes


def test_another_length_than_the_heads_is_refused():
    known = train_classifier(
        [BALL, torus(n=400).geometry], [0, 1], recipe=DNA, method=NearestNeighbour()
    )
    longer = Recipe(embeddings=(ShapeDNA(count=12), WaveKernelSignature(count=6)), k=20)
    other = type(known)(known.names, longer, known.method, known.learned, known.examples)
    with pytest.raises(InvalidInputError, match="as the head was fitted to, 70, got 72"):
        other.classify(BALL)


def test_more_neighbours_than_examples():
    refused("vectors", "have 3 rows or more, the neighbours, got 2",
            NearestNeighbour(neighbours=3).fit, np.eye(2), np.arange(2))  # fmt: skip


def test_some_points_of_shapes_whose_operator_is_seen():
    with pytest.raises(InvalidInputError, match="be None, all points, for a network that sees"):
        train_segmenter(
            [BALL], [north(BALL)], recipe=POINTS, method=DiffusionNet(width=4, depth=1),
            training=Training(epochs=1, points=50),
        )  # fmt: skip


def test_missing_packages_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.neighbors", None)
    with pytest.raises(MissingDependencyError, match=r"scikit-learn; pip install .*\[learn\]"):
        NearestNeighbour().fit(np.eye(2), np.arange(2))
    monkeypatch.setitem(sys.modules, "torch_geometric.nn", None)
    with pytest.raises(MissingDependencyError, match="backbones"):
        Hierarchical(backbone="pointnet++").build(3, 2)


def test_of_a_mesh_sampled_points_are_seen():
    mesh = creature(1000)
    recipe = Recipe(embeddings=(ShapeDNA(count=8),), k=12, points=400, seed=3)
    plain = Recipe(embeddings=(ShapeDNA(count=8),), k=12)
    np.testing.assert_array_equal(recipe.vector(mesh), plain.vector(sample(mesh, 400, seed=3)))


@dataclass(frozen=True)
class Broken:
    """An embedding that gives no number."""

    invariant_to: frozenset = frozenset({"rotation", "scale"})

    def of_points(self, surface):
        return np.full((surface.laplacian.n, 1), np.nan)

    def of_all(self, surface):
        return np.array([np.nan])


def test_numbers_that_are_none_are_refused():
    recipe = Recipe(embeddings=(Broken(),), k=12)
    for ask in (recipe.vector, lambda shape: prepared(recipe, shape)):
        with pytest.raises(InvalidInputError, match="`embedding` must give finite numbers"):
            ask(BALL)


def test_a_head_of_ones_own_is_not_taken_for_another(tmp_path):
    own = type("NearestNeighbour", (), {"fit": lambda self, v, y: NearestNeighbour().fit(v, 1 - y)})
    own = dataclass(frozen=True)(own)
    found = train_classifier([BALL, torus(n=400).geometry], [0, 1], recipe=DNA, method=own())
    with pytest.raises(InvalidInputError, match="options that a file can name"):
        save_labeller(tmp_path / "a.safetensors", found)


@pytest.mark.parametrize("head", HEADS, ids=str)
def test_examples_that_heads_cannot_take(head):
    for vectors, labels, message in (
        ([[0.0], [np.nan]], [0, 1], "`vectors` must be finite"),
        ([0.0, 1.0], [0, 1], "`vectors` must have shape"),
        ([[0.0], [1.0]], [0, 1, 2], "`labels` must be 2 integers"),
        ([[0.0], [1.0]], [0.0, 1.0], "`labels` must be 2 integers"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            head.fit(vectors, labels)


def test_a_checkpoint_of_another_kind(tmp_path):
    from spectra_kit.neo.train import checkpoint

    checkpoint.write(tmp_path, {"step": 3})
    recipe = Recipe(embeddings=(Coordinates(),), k=20)
    with pytest.raises(InvalidInputError, match="hold a checkpoint of the same run"):
        train_segmenter(
            [BALL], [north(BALL)], recipe=recipe, method=PointMLP(width=4), folder=tmp_path
        )
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInputError, match="`folder` must be a folder"):
        train_segmenter(
            [BALL], [north(BALL)], recipe=recipe, method=PointMLP(width=4),
            folder=tmp_path / "file",
        )  # fmt: skip


@pytest.mark.parametrize("device", ["cpu"] + ["cuda"] * torch.cuda.is_available())
def test_what_is_trained_anywhere_labels_on_the_cpu(device):
    ball = sphere(subdivisions=2).geometry
    high = (ball.points[:, 2] > 0).astype(int)
    known = train_segmenter(
        [ball], [high], recipe=Recipe(embeddings=(Coordinates(),), upright=True),
        method=PointMLP(width=8), training=Training(epochs=60, rate=5e-3), device=device,
    )  # fmt: skip
    assert {part.device.type for part in known.learned.parameters()} == {"cpu"}
    assert (known.segment(ball).labels == high).mean() > 0.95
    known.learned.to(device)
    assert (known.segment(ball).labels == high).mean() > 0.95


def test_a_device_that_is_not_there():
    shapes = [sphere(subdivisions=1).geometry, torus(n=100).geometry]
    refused("device", "be one that torch can use here, got 'tpu9'", train_classifier, shapes,
            [0, 1], recipe=Recipe(embeddings=(Coordinates(),)), method=PointNet(width=8),
            device="tpu9")  # fmt: skip
