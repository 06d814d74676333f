"""The stream: the samples of the corpus, made by processes, read while they come in."""

import multiprocessing
import os
import shutil
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import produced_here

from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.model import NeoConfig
from spectra_kit.neo.train import stream as streaming
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.corpus import WorkerError, generate, open_shards
from spectra_kit.neo.train.samples import CorpusConfig, make_sample
from spectra_kit.neo.train.stream import SampleStream

TINY = CorpusConfig(seed=3, n_points=100, k=4, shard_size=4)
AS_THEY_COME = TrainConfig(network=NeoConfig.named("small"), steps=1, batch=5, shown=0)


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    path = tmp_path_factory.mktemp("shards")
    generate(path, 12, config=TINY)
    return path


@pytest.fixture
def in_this_process(monkeypatch):
    monkeypatch.setattr(streaming, "produced", produced_here)


def assert_same(corpus, other, indices):
    """The samples `indices` of `corpus` equal those of the same number in `other`."""
    ours = corpus.batch(np.searchsorted(corpus.labels["index"], indices))
    theirs = other.batch(np.searchsorted(other.labels["index"], indices))
    assert ours.has_operators
    for name, array in ours.arrays().items():
        np.testing.assert_array_equal(array, theirs.arrays()[name])


@pytest.mark.usefixtures("in_this_process")
def test_stream_equals_the_corpus_and_goes_on_behind_what_is_saved(shards, tmp_path):
    for here, enough in ((0, 10), (8, 12)):
        with SampleStream(TINY, workers=2, capacity=64, folder=tmp_path) as stream:
            assert len(stream) >= here
            assert stream.ready(max(1, here), timeout=300 * (not here))
            assert stream.ready(enough, timeout=300)
            corpus, made = stream.corpus(), stream.made
        assert (corpus.n_points, corpus.k) == (100, 4)
        np.testing.assert_array_equal(corpus.labels["index"], np.arange(len(corpus)))
        assert_same(corpus, open_shards(shards), np.arange(enough))
        assert made >= len(corpus)
        assert len(open_shards(tmp_path)) % 4 == 0
        assert_same(open_shards(tmp_path), open_shards(shards), np.arange(8))


def test_a_stream_removes_no_shards_but_its_own(shards):
    stream = SampleStream(TINY, workers=1, capacity=4, folder=shards, start=400)
    with pytest.raises(InvalidInputError, match="`folder` must have been begun by a stream"):
        stream.__enter__()
    assert len(open_shards(shards)) == 12


@pytest.mark.usefixtures("in_this_process")
def test_the_oldest_samples_make_room_and_views_stay(tmp_path):
    options = {"workers": 1, "capacity": 8, "folder": tmp_path}
    with SampleStream(TINY, start=4, **options) as stream:
        assert stream.ready(3, timeout=300)
        early = stream.corpus()
        before = early.batch(np.arange(len(early))).eigenvectors
        while stream.corpus().labels["index"][0] < 12:
            assert len(stream) <= 8
            time.sleep(0.02)
        late = stream.corpus()
    assert stream.capacity == len(late) == 8
    np.testing.assert_array_equal(np.diff(late.labels["index"]), 1)
    assert stream.made >= 16  # those that are gone are counted
    np.testing.assert_array_equal(early.batch(np.arange(len(early))).eigenvectors, before)
    index = int(early.labels["index"][0])
    assert index >= 4
    np.testing.assert_array_equal(early.batch([0]).points, make_sample(TINY, index).points)
    kept = open_shards(tmp_path).labels["index"]
    assert len(kept) == 8
    assert kept[0] > 4
    with SampleStream(TINY, start=int(kept[0]), **options) as again:
        assert again.ready(8, timeout=0)


@pytest.mark.usefixtures("in_this_process")
def test_windows_wait_for_what_they_show_and_no_more_is_made(tmp_path):
    options = {"workers": 1, "capacity": 8, "folder": tmp_path, "ahead": 4}
    with SampleStream(TINY, **options) as stream:
        for first, stop in ((0, 6), (2, 10), (24, 28)):
            window = stream.window(first, stop)
            np.testing.assert_array_equal(window.labels["index"], np.arange(first, stop))
            points = make_sample(TINY, first).points
            np.testing.assert_array_equal(window.batch([0]).points, points)
            time.sleep(0.2)
            assert stop <= first + len(stream) <= stop + 4 + 1
        for first, stop in ((4, 8), (34, 34)):
            with pytest.raises(InvalidInputError, match="windows must move on, in a stream with"):
                stream.window(first, stop)
    with pytest.raises(InvalidInputError, match="`stop` must be a sample that the closed stream"):
        stream.window(24, 99)
    there = open_shards(tmp_path).labels["index"]
    assert there[0] > 4  # those long forgotten are gone
    # It goes on from any sample: with what is saved, and by itself where that has a gap.
    shutil.rmtree(tmp_path / "shard_0005")
    for start in (16, 0):
        with SampleStream(TINY, start=start, **options) as again:
            indices = again.window(start + 2, start + 9).labels["index"]
            np.testing.assert_array_equal(indices, start + np.arange(2, 9))
    with (
        pytest.raises(InvalidInputError, match=r"and ahead = None"),
        SampleStream(TINY, workers=1, capacity=8) as stream,
    ):
        stream.window(0, 4)


@pytest.mark.usefixtures("in_this_process")
def test_a_corpus_grows_by_a_stream_that_keeps_its_shards(shards, tmp_path):
    generate(tmp_path, 8, config=TINY)
    options = {"workers": 1, "capacity": 4, "folder": tmp_path, "keep": True}
    with SampleStream(TINY, **options) as stream:
        while stream.made < 12:
            time.sleep(0.02)
        assert len(stream) == 4
    grown = open_shards(tmp_path)
    assert len(grown) >= 12
    np.testing.assert_array_equal(grown.labels["index"], np.arange(len(grown)))
    assert_same(grown, open_shards(shards), np.arange(12))
    for start in (4, 400):
        with pytest.raises(InvalidInputError, match="hold whole shards of the samples from"):
            SampleStream(TINY, start=start, **options).__enter__()
    with pytest.raises(InvalidInputError, match="let the stream `keep` its shards"):
        SampleStream(TINY, workers=1, capacity=4, folder=tmp_path).__enter__()
    assert len(open_shards(tmp_path)) == len(grown)


@pytest.mark.usefixtures("in_this_process")
def test_a_run_waits_for_no_more_samples_than_are_made_ahead(monkeypatch):
    monkeypatch.setattr(streaming, "_PATIENCE", 1e9)
    with SampleStream(TINY, workers=1, capacity=64, ahead=4) as stream:
        stream.begin(AS_THEY_COME)
        assert stream.made == 4


def test_a_run_tells_that_it_waits_for_its_first_sample(monkeypatch):
    told = threading.Event()

    def late(config, indices, workers):
        assert told.wait(30)
        yield make_sample(config, next(indices))

    monkeypatch.setattr(streaming, "produced", late)
    monkeypatch.setattr(streaming, "_PATIENCE", 0.0)
    monkeypatch.setattr(streaming, "warn", lambda *_: told.set())
    with SampleStream(TINY, workers=1, capacity=64) as stream:
        stream.begin(AS_THEY_COME)
        assert told.is_set()
        assert len(stream) == 1


def test_reading_waits_for_nothing():
    stream = SampleStream(TINY, workers=1, capacity=8)
    assert (stream.n_points, stream.k, len(stream), stream.made) == (100, 4, 0, 0)
    assert not stream.ready(8, timeout=0)
    stream.close()
    assert not stream.ready(8, timeout=1e9)  # none will come


def test_a_worker_makes_the_same_has_one_thread_and_is_missed_when_dead(shards, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with SampleStream(TINY, workers=1, capacity=1000) as stream:
        assert stream.ready(1, timeout=300)
        assert_same(stream.corpus(), open_shards(shards), np.arange(1))  # bit for bit
        (worker,) = multiprocessing.active_children()
        # As it was when the libraries were loaded.
        told = set(Path(f"/proc/{worker.pid}/environ").read_text().split("\0"))
        assert told >= {f"{name}_NUM_THREADS=1" for name in ("OMP", "OPENBLAS", "MKL")}
        assert os.environ["OMP_NUM_THREADS"] == "2"
        assert "MKL_NUM_THREADS" not in os.environ
        os.kill(worker.pid, signal.SIGINT)  # which it leaves to this process
        assert stream.ready(stream.made + 4, timeout=300)
        worker.kill()
        with pytest.raises(WorkerError, match=r"has died.*start again with fewer `workers`"):
            stream.ready(1000, timeout=300)
        with pytest.raises(WorkerError, match="has died"):
            stream.corpus()


@pytest.mark.usefixtures("in_this_process")
def test_foreign_folders_and_bad_counts_are_refused(shards, tmp_path):
    generate(tmp_path, 3, config=TINY)
    (tmp_path / "stream").touch()  # as if a stream had begun it
    for told, options in (
        (r"another configuration: \['seed'\] differ", {"seed": 4, "folder": shards}),
        ("hold whole shards of the samples from `start` = 0 on", {"folder": tmp_path}),
        ("`start` must be a multiple of the shard size 4", {"folder": shards, "start": 6}),
        ("`workers` must be at least", {"workers": 0}),
        ("`capacity` must be at least", {"capacity": 0}),
        ("`start` must be at least", {"start": -1}),
        (r"`n` must be in \[1, 8\]", {}),
    ):
        config = replace(TINY, seed=options.pop("seed", 3))
        with (
            pytest.raises(InvalidInputError, match=told),
            SampleStream(config, **{"workers": 1, "capacity": 8} | options) as stream,
        ):
            stream.ready(9, timeout=0)
