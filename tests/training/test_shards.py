"""The corpus on disk: whole shards, in order, never overwritten."""

import numpy as np
import pytest

from spectra_kit.errors import InvalidInputError
from spectra_kit.training.shards import open_shards, write_shard


def random_samples(n, seed):
    """Points, masses of sum one, and columns of size one."""
    rng = np.random.default_rng(seed)
    mass = rng.uniform(0.5, 1.5, (n, 64))
    return (
        rng.standard_normal((n, 64, 3)),
        mass / mass.sum(1, keepdims=True),
        rng.standard_normal((n, 64, 8)),
    )


def test_shards_keep_samples_labels_and_order(tmp_path):
    points, mass, modes = random_samples(5, 0)
    write_shard(tmp_path, 1, points[3:], mass[3:], modes[3:], {"seed": [3, 4], "extra": [0, 0]})
    write_shard(tmp_path, 0, points[:3], mass[:3], modes[:3], {"seed": [0, 1, 2]})
    corpus = open_shards(tmp_path)
    assert (len(corpus), corpus.n_points, corpus.k) == (5, 64, 8)
    assert corpus.labels.keys() == {"seed"}
    np.testing.assert_array_equal(corpus.labels["seed"], range(5))
    batch = corpus.batch([4, 0, 3, 4])
    np.testing.assert_array_equal(batch.points, points[[4, 0, 3, 4]].astype(np.float32))
    np.testing.assert_array_equal(batch.mass, mass[[4, 0, 3, 4]].astype(np.float32))
    np.testing.assert_array_equal(batch.eigenvectors, modes[[4, 0, 3, 4]].astype(np.float16))
    assert isinstance(corpus.shards[0].points, np.memmap)


def test_half_written_shards_are_invisible(tmp_path):
    points, mass, modes = random_samples(2, 0)
    (tmp_path / ".writing_x").mkdir()
    write_shard(tmp_path, 0, points, mass, modes, {})
    (tmp_path / "notes.txt").write_text("")
    assert len(open_shards(tmp_path)) == 2


def test_shards_are_never_overwritten(tmp_path):
    sample = random_samples(2, 0)
    write_shard(tmp_path, 0, *sample, {})
    with pytest.raises(InvalidInputError, match=r"shard 0 of .* exists; delete"):
        write_shard(tmp_path, 0, *random_samples(2, 1), {})
    np.testing.assert_array_equal(
        open_shards(tmp_path).batch([0]).points, sample[0][:1].astype(np.float32)
    )
    assert [path.name for path in tmp_path.iterdir()] == ["shard_0000"]


def test_bad_shards_are_refused(tmp_path):
    points, mass, modes = random_samples(2, 0)
    with pytest.raises(InvalidInputError, match=r"must have shapes \(s, n, 3\)"):
        write_shard(tmp_path, 0, points[:, :-1], mass, modes, {})
    with pytest.raises(InvalidInputError, match="label `seed` must have one integer for each of 2"):
        write_shard(tmp_path, 0, points, mass, modes, {"seed": [1]})
    with pytest.raises(InvalidInputError, match="`mass` must be positive with rows that sum to 1"):
        write_shard(tmp_path, 0, points, 2 * mass, modes, {})
    with pytest.raises(InvalidInputError, match="`eigenvectors` must be finite in the precision"):
        write_shard(tmp_path, 0, points, mass, modes * np.nan, {})
    with pytest.raises(InvalidInputError, match="must hold shards, got none"):
        open_shards(tmp_path / "nowhere")
    write_shard(tmp_path, 0, points, mass, modes, {})
    write_shard(tmp_path, 1, points, mass, modes[..., :5], {})
    with pytest.raises(InvalidInputError, match=r"must have the same \(points, modes\)"):
        open_shards(tmp_path)


@pytest.mark.parametrize(
    ("damage", "match"),
    [
        (lambda shard: (shard / "mass.npy").unlink(), "not a whole shard .*No such file"),
        (lambda shard: cut(shard / "points.npy"), "not a whole shard .*; delete it, and generate"),
        (lambda shard: cut(shard / "labels.npz"), "not a whole shard"),
        (lambda shard: np.save(shard / "mass.npy", np.ones((2, 64))), "mass must be float32, got"),
        (lambda shard: np.save(shard / "points.npy", np.ones((2, 9, 3), "f4")), "shard_0000: `poi"),
        (lambda shard: np.savez(shard / "labels.npz", a=[0.5, 1]), "label a must be int64, got"),
        (lambda shard: np.savez(shard / "labels.npz", a=[1]), "one integer for each of 2 samples"),
    ],
)
def test_damaged_shards_are_refused(tmp_path, damage, match):
    shard = write_shard(tmp_path, 0, *random_samples(2, 0), {"seed": [0, 1]})
    damage(shard)
    with pytest.raises(InvalidInputError, match=match):
        open_shards(tmp_path)


def cut(path):
    path.write_bytes(path.read_bytes()[:-100])
