"""Batches: they follow from the step, show every sample, and come the same way on every path."""

import threading
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from spectra_kit.eigen.subspaces.frame import POSES, canonical_frame
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.model import NeoConfig
from spectra_kit.neo.train import loader as loading
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.corpus import Corpus
from spectra_kit.neo.train.loader import (
    Loader,
    for_validation,
    posed,
    random_rotations,
    rotations,
)
from spectra_kit.neo.train.samples import CorpusConfig, Samples
from spectra_kit.neo.train.stream import SampleStream, drawn, window

CPU = torch.device("cpu")


def samples(n=24, seed=0):
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((n, 64, 3)) * rng.uniform(0.3, 1, (n, 1, 3)) + 5
    mass = rng.uniform(0.5, 1.5, (n, 64))
    return Samples(points, mass / mass.sum(1, keepdims=True), rng.standard_normal((n, 64, 8)))


WHOLE = samples()
CORPUS = Corpus([WHOLE[:12], WHOLE[12:]])


def config(frame="principal", **options):
    network = NeoConfig(
        width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=8, frame=frame
    )
    return TrainConfig(**{"network": network, "steps": 10, "batch": 4, **options})


def feed(settings, source=CORPUS, **options):
    return Loader(source, settings, CPU, **options)


def assert_equal(one, other):
    for a, b in zip(one[:3], other[:3], strict=True):
        assert torch.equal(a, b)


def test_rotations_are_scipys_and_random_ones_uniform():
    vectors = np.vstack([np.zeros(3), np.random.default_rng(0).normal(size=(20, 3))])
    ours = rotations(torch.from_numpy(vectors).float()).numpy()
    np.testing.assert_allclose(ours, Rotation.from_rotvec(vectors).as_matrix(), atol=1e-6)
    turns = random_rotations(torch.randn(4000, 4, generator=torch.Generator().manual_seed(0)))
    eye = torch.eye(3).expand(4000, 3, 3)
    torch.testing.assert_close(turns @ turns.mT, eye, atol=1e-5, rtol=0)
    torch.testing.assert_close(torch.linalg.det(turns), torch.ones(4000))
    # Haar measure: entries have mean 0 and variance 1/3; each image of an axis is uniform in z.
    assert turns.mean(0).abs().max() < 0.05
    assert (turns.square().mean(0) - 1 / 3).abs().max() < 0.03
    assert (turns[:, 2].abs().mean(0) - 0.5).abs().max() < 0.03


@pytest.mark.parametrize("frame", ["principal", "none"])
def test_batches_follow_from_the_step_wherever_samples_are_kept(frame):
    settings = config(frame=frame)
    points, mass, modes, _ = feed(settings)(2)
    assert (points.shape, mass.shape, modes.shape) == ((4, 64, 3), (4, 64), (4, 64, 8))
    assert points.abs().max() <= 1 + 1e-6
    kept, read = feed(settings, resident=True), feed(settings)
    for step in (0, 1, 7, 2):
        assert_equal(kept(step), read(step))
    assert_equal((points, mass, modes, ()), read(2))
    assert not torch.equal(points, read(3)[0])
    shares = [feed(settings, share=part)(2) for part in (slice(0, 1), slice(1, 4))]
    for *parts, expected in zip(*shares, read(2)[:3], strict=False):
        torch.testing.assert_close(torch.cat(parts), expected)


def test_the_next_batch_is_read_while_the_step_waits(monkeypatch):
    readers, ready = [], threading.Semaphore(0)

    def noted(*arguments):
        readers.append(threading.current_thread())
        ready.release()
        return posed(*arguments)

    with feed(config()) as batches:  # closed, so that its thread is not noted below
        expected = batches(1)
    monkeypatch.setattr(loading, "posed", noted)
    with feed(config()) as batches:
        batches(0)
        assert ready.acquire(timeout=60)
        assert ready.acquire(timeout=60)
        assert_equal(batches(1), expected)
    assert threading.current_thread() not in readers
    assert not any(reader.is_alive() for reader in readers)


def test_an_epoch_shows_every_sample_once():
    batches = feed(config())
    seen = torch.cat([batches(step)[1] for step in range(6)])
    assert {row.numpy().tobytes() for row in seen} == {mass.tobytes() for mass in WHOLE.mass}


def test_points_masses_and_modes_stay_together():
    points, mass, modes, _ = feed(config(jitter=0.0, flips=0.0, batch=24))(0)
    lookup = {
        w.tobytes(): (p, u)
        for x, ws, us in zip(WHOLE.points, WHOLE.mass, WHOLE.eigenvectors, strict=True)
        for p, w, u in zip(canonical_frame(x, ws).pose(x), ws, us, strict=True)
    }
    for p, w, u in zip(
        *(part.flatten(0, 1).numpy() for part in (points, mass, modes)), strict=True
    ):
        expected = lookup[w.tobytes()]
        np.testing.assert_allclose(p, expected[0], atol=1e-5)
        np.testing.assert_array_equal(u, expected[1])


def test_flips_are_the_four_proper_ones_equally_often():
    points, mass, *_ = feed(config(jitter=0.0, batch=400))(0)
    plain = {
        w.tobytes(): canonical_frame(x, w).pose(x)
        for x, w in zip(WHOLE.points, WHOLE.mass, strict=True)
    }
    counts = np.zeros(4)
    for x, w in zip(points.numpy(), mass.numpy(), strict=True):
        fits = [np.allclose(x, plain[w.tobytes()] * flip, atol=1e-5) for flip in POSES]
        assert sum(fits) == 1
        counts += fits
    assert (counts > 70).all()


def test_jitter_turns_and_shrinks_a_little():
    still, *_ = feed(config(jitter=0.0, flips=0.0))(0)
    moved, *_ = feed(config(jitter=0.03, flips=0.0))(0)
    size = moved.abs().amax((1, 2))
    assert (size > 0.97).all()
    assert (size < 1).all()
    # Distances between points change by one factor per cloud: no shear.
    moved, still = (torch.cdist(x, x).flatten(1)[:, 1:64] for x in (moved, still))
    assert ((moved / still).std(1) < 1e-4).all()


@pytest.mark.parametrize("resident", [False, True])
def test_a_stream_shows_what_is_there(resident):
    made = samples(48, 1)
    stream = SampleStream(CorpusConfig(seed=0, n_points=64, k=8), workers=1, capacity=24)

    def come(first, stop):
        for i in range(first, stop):
            stream._samples.append(made[i : i + 1])
        stream._next = stop

    def seen(steps):
        return {row.numpy().tobytes() for step in steps for row in batches(step)[1]}

    def masses(first, stop):
        return {mass.tobytes() for mass in made.mass[first:stop]}

    batches = feed(config(batch=8), stream, resident=resident)
    with pytest.raises(InvalidInputError, match=r"got none; wait with `ready`"):
        batches(0)
    for first, stop, steps in ((0, 8, [0]), (8, 16, [2, 3]), (16, 24, [6, 7, 8])):
        come(first, stop)
        batches = feed(config(batch=8), stream, resident=resident)
        assert seen(steps) == masses(0, stop)
    come(24, 40)  # the oldest make room
    batches(9)  # which was read before
    assert seen([12, 13, 14]) == masses(16, 40)


def test_windows_of_a_stream_move_on_and_show_each_sample_so_often():
    settings, shown = config(shown=3, batch=6), np.zeros(3000)
    for step in range(1200):
        first, stop = window(settings, step, 60)
        numbers = drawn(settings, step, 60)
        assert 0 <= first <= numbers.min() <= numbers.max() < stop <= first + 60
        assert len(set(numbers)) == 6
        np.testing.assert_array_equal(numbers, drawn(settings, step, 60))
        shown[numbers] += 1
    assert stop == 24 + 2 * step
    assert shown[100:2300].mean() == pytest.approx(3, rel=0.02)
    assert 0.8 < shown[100:2300].var() / 3 < 1.2  # as chance has it
    other = replace(settings, seed=1)
    assert not np.array_equal(drawn(other, step, 60), drawn(settings, step, 60))


@pytest.mark.parametrize("frame", ["principal", "none"])
def test_validation_shows_whole_samples_the_same_way_every_time(frame):
    settings = config(frame=frame)
    batch = posed(CORPUS.batch(range(4)), settings)
    points, mass, modes, _ = for_validation(batch, settings, 0)
    torch.testing.assert_close(points.abs().amax((1, 2)), torch.ones(4))
    assert (mass.shape, modes.dtype) == ((4, 64), torch.float32)
    assert_equal((points, mass, modes, ()), for_validation(batch, settings, 0))
