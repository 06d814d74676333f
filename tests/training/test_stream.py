"""The stream: the samples of the corpus, made by processes, read while they come in."""

import multiprocessing
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere
from spectra_kit.training.corpus import CorpusConfig, WorkerError, generate, make_sample
from spectra_kit.training.shards import open_shards
from spectra_kit.training.stream import SampleStream
from spectra_kit.training.surfaces import join

TINY = CorpusConfig(seed=3, n_points=100, k=4, shard_size=4)


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    path = tmp_path_factory.mktemp("shards")
    generate(path, 16, config=TINY)
    return path


def assert_same(corpus, other, indices):
    """The samples `indices` of `corpus` equal those of the same number in `other`."""
    ours = corpus.batch(np.searchsorted(corpus.labels["index"], indices))
    theirs = other.batch(np.searchsorted(other.labels["index"], indices))
    np.testing.assert_array_equal(ours.points, theirs.points)
    np.testing.assert_array_equal(ours.mass, theirs.mass)
    np.testing.assert_array_equal(ours.eigenvectors, theirs.eigenvectors)


def test_stream_equals_the_corpus_and_saves_the_same_shards(shards, tmp_path):
    with SampleStream(TINY, workers=2, capacity=64, folder=tmp_path) as stream:
        assert stream.ready(9, timeout=300)
        corpus = stream.corpus()
        report = stream.report()
    assert (corpus.n_points, corpus.k) == (100, 4)
    assert corpus.batch([0]).eigenvectors.dtype == np.float16
    assert len(corpus) >= 9
    np.testing.assert_array_equal(corpus.labels["index"], np.arange(len(corpus)))
    assert_same(corpus, open_shards(shards), np.arange(9))
    assert report.samples >= len(corpus)
    assert sum(report.families.values()) == report.samples
    saved = open_shards(tmp_path)
    assert len(saved) % 4 == 0
    assert_same(saved, open_shards(shards), np.arange(8))


def test_stream_goes_on_behind_the_shards_that_are_there(shards, tmp_path):
    generate(tmp_path, 8, config=TINY)
    with SampleStream(TINY, workers=1, capacity=64, folder=tmp_path) as stream:
        assert len(stream) == 8
        assert stream.ready(8, timeout=0)
        assert stream.report().samples >= 8
        assert stream.ready(13, timeout=300)
        corpus = stream.corpus()
    assert_same(corpus, open_shards(shards), np.arange(13))
    assert len(open_shards(tmp_path)) >= 12


def test_a_bounded_folder_keeps_the_newest_shards(tmp_path):
    with SampleStream(TINY, workers=1, capacity=8, folder=tmp_path, bounded=True) as stream:
        assert stream.capacity == 8
        while stream.report().samples < 17:
            time.sleep(0.02)
    kept = open_shards(tmp_path).labels["index"]
    assert len(kept) == 8
    assert kept[0] > 0
    with SampleStream(TINY, workers=1, capacity=8, start=int(kept[0]), folder=tmp_path) as stream:
        assert stream.ready(8, timeout=0)


def test_start_skips_samples_and_closing_ends_the_processes():
    with SampleStream(TINY, workers=1, capacity=64, start=6) as stream:
        assert stream.ready(1, timeout=300)
    assert not multiprocessing.active_children()
    corpus = stream.corpus()  # what is there stays readable
    assert corpus.labels["index"][0] == 6
    expected = make_sample(TINY, 6)
    np.testing.assert_array_equal(corpus.batch([0]).points[0], expected.points.astype(np.float32))


def test_the_oldest_samples_make_room_and_views_stay():
    with SampleStream(TINY, workers=1, capacity=8) as stream:
        assert stream.ready(3, timeout=300)
        early = stream.corpus()
        before = early.batch(np.arange(len(early))).eigenvectors
        while stream.corpus().labels["index"][0] < 12:
            assert len(stream) <= 8
            time.sleep(0.02)
        late, report = stream.corpus(), stream.report()
    assert 7 <= len(late) <= 8
    np.testing.assert_array_equal(np.diff(late.labels["index"]), 1)
    assert report.samples >= 19  # those that are gone are counted
    np.testing.assert_array_equal(early.batch(np.arange(len(early))).eigenvectors, before)
    # A reader looks a few times a second: on a quick machine the first may be gone by then.
    for position, index in enumerate(early.labels["index"][:3]):
        found, expected = early.batch([position]), make_sample(TINY, int(index))
        for name in ("points", "mass", "eigenvectors"):
            ours = getattr(found, name)[0]
            np.testing.assert_array_equal(ours, getattr(expected, name).astype(ours.dtype))


def test_reading_waits_for_nothing():
    stream = SampleStream(TINY, workers=1, capacity=8)
    corpus = stream.corpus()
    assert (len(corpus), corpus.n_points, corpus.k, len(stream)) == (0, 100, 4, 0)
    assert stream.report().samples == 0
    with stream:
        assert not stream.ready(8, timeout=0)


def test_a_dead_worker_is_an_error_and_not_a_hang():
    with SampleStream(TINY, workers=1, capacity=1000) as stream:
        assert stream.ready(1, timeout=300)
        (worker,) = multiprocessing.active_children()
        worker.kill()
        with pytest.raises(WorkerError, match="has died"):
            stream.ready(1000, timeout=300)
        with pytest.raises(WorkerError, match="has died"):
            stream.corpus()
        with pytest.raises(WorkerError, match="has died"):
            stream.report()


def test_an_interrupt_ends_the_processes(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import multiprocessing, signal, os, time\n"
        "from spectra_kit.training.corpus import CorpusConfig\n"
        "from spectra_kit.training.stream import SampleStream\n"
        "if __name__ == '__main__':\n"
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "    config = CorpusConfig(seed=0, n_points=100, k=4)\n"
        "    try:\n"
        "        with SampleStream(config, workers=2, capacity=64) as stream:\n"
        "            stream.ready(1, timeout=300)\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "            time.sleep(300)\n"
        "    except KeyboardInterrupt:\n"
        "        print(multiprocessing.active_children())\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=300, check=True
    )
    assert done.stdout.strip() == "[]"
    assert done.stderr == ""


def test_rejections_are_counted(tmp_path):
    ball = sphere(subdivisions=1).geometry
    apart = join([ball, ball.with_points(ball.points + [90.0, 0, 0])])
    np.savez(
        tmp_path / "pool.npz",
        V=np.concatenate([ball.points, apart.points]).astype(np.float16),
        F=np.concatenate([ball.faces, apart.faces]).astype(np.uint16),
        voff=[0, ball.n, ball.n + apart.n],
        foff=[0, len(ball.faces), len(ball.faces) + len(apart.faces)],
        ids=["a", "b"],
        split="train",
    )
    config = replace(TINY, n_points=400, nonuniform=0.0, pool=tmp_path / "pool.npz", pool_share=1.0)
    with SampleStream(config, workers=1, capacity=64) as stream:
        assert stream.ready(6, timeout=300)
        labels, report = stream.corpus().labels, stream.report()  # samples may come in between
    assert not labels["pool"].any()  # only the ball in one piece
    assert report.rejected["components"] >= labels["rejected_components"].sum() > 0
    assert report.rejected["mesh"] == report.rejected["solve"] == 0
    assert report.families["pool"] == report.samples


def test_foreign_folders_are_refused(shards, tmp_path):
    def enter(config=TINY, **options):
        with SampleStream(config, workers=1, capacity=8, **options):
            pytest.fail("entered")

    with pytest.raises(InvalidInputError, match=r"another configuration: \['seed'\] differ"):
        enter(replace(TINY, seed=4), folder=shards)
    with pytest.raises(InvalidInputError, match="must hold the samples from `start` = 4 on"):
        enter(folder=shards, start=4)
    with pytest.raises(InvalidInputError, match="`start` must be a multiple of the shard size 4"):
        enter(folder=shards, start=6)
    generate(tmp_path, 6, config=TINY)
    with pytest.raises(InvalidInputError, match="must hold whole shards of 4, got 6 samples"):
        enter(folder=tmp_path)


@pytest.mark.parametrize(
    ("change", "match"),
    [({"workers": 0}, "workers"), ({"capacity": 0}, "capacity"), ({"start": -1}, "start")],
)
def test_counts_are_checked(change, match):
    with pytest.raises(InvalidInputError, match=f"`{match}` must be at least"):
        SampleStream(TINY, **({"workers": 1, "capacity": 8} | change))
    with pytest.raises(InvalidInputError, match=r"`n` must be in \[1, 8\]"):
        SampleStream(TINY, workers=1, capacity=8).ready(9, timeout=0)
