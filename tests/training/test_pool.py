"""The pool of real meshes: splits, packing, and corpora made from it."""

import csv

import numpy as np
import pytest

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import rectangle, sphere, torus
from spectra_kit.training.corpus import CorpusConfig, generate, make_sample, report
from spectra_kit.training.pool import open_pool, pack_pool, varied
from spectra_kit.training.samples import FROM_POOL, sample_mesh
from spectra_kit.training.shards import open_shards

MESHES = {
    "m3": (sphere(subdivisions=2).geometry, "train", "pool_01.npz"),
    "m1": (torus(n=300).geometry, "train", "pool_00.npz"),
    "m2": (sphere(subdivisions=1).geometry, "val", "pool_00.npz"),
    "m4": (rectangle(n=100).geometry, "train", "pool_01.npz"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("pool")
    for chunk in ("pool_00.npz", "pool_01.npz"):
        names = [name for name, row in MESHES.items() if row[2] == chunk]
        meshes = [MESHES[name][0] for name in names]
        np.savez(
            path / chunk,
            V=np.concatenate([mesh.points for mesh in meshes]).astype(np.float16),
            F=np.concatenate([mesh.faces for mesh in meshes]).astype(np.uint16),
            voff=np.cumsum([0, *(mesh.n for mesh in meshes)]),
            foff=np.cumsum([0, *(len(mesh.faces) for mesh in meshes)]),
            ids=np.array(names),
        )
    with (path / "manifest.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["id", "category", "split"])
        rows.writerows([name, "thing", row[1]] for name, row in MESHES.items())
    return path


def config(folder, **change):
    share = {"pool": folder, "pool_share": 1.0, "seed": 5, "n_points": 160, "k": 6, "shard_size": 4}
    return CorpusConfig(**(share | change))


def test_splits_are_kept_apart_and_ordered_by_name(folder):
    train, val = open_pool(folder, "train"), open_pool(folder, "val")
    assert train.names == ("m1", "m3", "m4")
    assert val.names == ("m2",)
    assert (len(train), len(val)) == (3, 1)
    for i, name in enumerate(train.names):
        np.testing.assert_array_equal(train.mesh(i).faces, MESHES[name][0].faces)
        np.testing.assert_allclose(train.mesh(i).points, MESHES[name][0].points, atol=2e-3)
    assert train.digest != val.digest


def test_packed_pool_equals_the_unpacked_one_and_is_read_anew(folder, tmp_path):
    path = tmp_path / "small.npz"
    for split in ("val", "train"):
        packed, again = pack_pool(folder, path, split), open_pool(path, split)
        assert packed.digest == again.digest == open_pool(folder, split).digest
        assert packed.names == again.names
    ours, theirs = config(folder), config(path)
    assert ours.fingerprint() == theirs.fingerprint()
    here, there = make_sample(ours, 2), make_sample(theirs, 2)
    assert here.labels == there.labels
    np.testing.assert_array_equal(here.points, there.points)
    np.testing.assert_array_equal(here.eigenvectors, there.eigenvectors)
    with pytest.raises(InvalidInputError, match=r"`split` must be one .* are in, got 'val'"):
        open_pool(path, "val")


def test_corpus_draws_only_meshes_of_its_split(folder, tmp_path):
    for split, allowed in (("train", {0, 1, 2}), ("val", {0})):
        path = tmp_path / split
        generate(path, 12, config=config(folder, pool_split=split))
        labels = open_shards(path).labels
        assert set(labels["pool"].tolist()) == allowed
        assert (labels["family"] == FROM_POOL).all()
        assert report(path).families["pool"] == 12
    with pytest.raises(InvalidInputError, match=r"another configuration: \['pool'\] differ"):
        generate(path, 20, config=config(folder))


def test_share_mixes_meshes_and_families(folder):
    labels = [make_sample(config(folder, pool_share=0.5), i).labels for i in range(12)]
    real = [label["family"] == FROM_POOL for label in labels]
    assert 0 < sum(real) < 12
    assert [label["pool"] >= 0 for label in labels] == real


def test_without_a_share_the_pool_changes_nothing(folder):
    ours = config(folder, pool_share=0.0, seed=9)
    theirs = config(None, pool_share=0.0, seed=9)
    assert ours.fingerprint() == theirs.fingerprint()
    np.testing.assert_array_equal(make_sample(ours, 0).points, make_sample(theirs, 0).points)


def test_meshes_are_varied_and_fit_the_unit_box_before(folder):
    mesh = open_pool(folder, "train").mesh(1)
    areas = [varied(mesh, np.random.default_rng(seed)).area for seed in range(20)]
    unit = varied(mesh.with_points(100 * mesh.points), np.random.default_rng(0))
    np.testing.assert_allclose(unit.area, areas[0], rtol=1e-6)
    plain = np.isclose(areas, mesh.area, rtol=1e-2)
    assert 0 < plain.sum() < 15  # three of ten stay as they are


def test_sample_lies_on_its_mesh(folder):
    for made_of in (config(folder), config(None, pool_share=0.0)):
        labels = make_sample(made_of, 1).labels
        again = sample_mesh(made_of, labels)
        np.testing.assert_array_equal(again.points, sample_mesh(made_of, dict(labels)).points)
        points = make_sample(made_of, 1).points
        # Both in the frame of their principal axes: the same extents, up to sampling.
        size = np.linalg.svd(points - points.mean(0), compute_uv=False) / np.sqrt(len(points))
        dense = again.points[again.faces].mean(axis=1)
        weights = np.sqrt(again.face_areas / again.face_areas.sum())[:, None]
        truth = np.linalg.svd(weights * (dense - (weights**2 * dense).sum(0)), compute_uv=False)
        np.testing.assert_allclose(size / size[0], truth / truth[0], atol=0.15)


def test_bad_pools_are_refused(folder, tmp_path):
    with pytest.raises(InvalidInputError, match=r"must hold chunks pool_\*.npz and a manifest"):
        open_pool(tmp_path, "train")
    (tmp_path / "text.npz").write_text("no")
    with pytest.raises(InvalidInputError, match=r"text.npz: not a whole mesh pool"):
        open_pool(tmp_path / "text.npz", "train")
    np.savez(tmp_path / "half.npz", V=np.zeros((1, 3)))
    with pytest.raises(InvalidInputError, match=r"without \['F', 'voff', 'foff', 'ids'\]"):
        open_pool(tmp_path / "half.npz", "train")
    with pytest.raises(InvalidInputError, match="are in, got 'test'"):
        open_pool(folder, "test")
    with pytest.raises(InvalidInputError, match=r"`target` must end in \.npz"):
        pack_pool(folder, tmp_path / "small.bin", "train")
    with pytest.raises(InvalidInputError, match=r"`index` must be in \[0, 2\], got 3"):
        open_pool(folder, "train").mesh(3)
