"""The corpus: families of surfaces, samples with exact modes, interruptible generation."""

import itertools
import json
import multiprocessing
import shutil
import subprocess
import sys
import time
from collections import deque
from dataclasses import replace
from pathlib import Path

import make_corpus
import numpy as np
import pytest
from scipy.spatial import cKDTree

from spectra_kit import Arpack, eigensolve
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, sphere
from spectra_kit.operators import robust_laplacian
from spectra_kit.training import bodies, corpus, families, samples, surfaces
from spectra_kit.training.corpus import (
    CorpusConfig,
    WorkerError,
    generate,
    make_sample,
    produced,
    report,
)
from spectra_kit.training.families import FAMILIES, draw_family, make_mesh
from spectra_kit.training.shards import open_shards

TINY = CorpusConfig(seed=3, n_points=160, k=6, shard_size=4)
OF_ONE_PIECE = [
    "quadruped",
    "biped",
    "organism",
    "blob",
    "porous",
    "machined",
    "symmetric",
    "sculpture",
    "lattice",
]


def everything(folder):
    corpus_ = open_shards(folder)
    return vars(corpus_.batch(np.arange(len(corpus_))))


def assert_same(folder, other):
    for name, array in everything(folder).items():
        np.testing.assert_array_equal(array, everything(other)[name])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("corpus")
    generate(path, 10, config=TINY)
    return path


# Surfaces


@pytest.mark.parametrize("family", FAMILIES)
def test_meshes_follow_from_the_seed_and_are_of_order_one(family):
    for seed in (0, (7, 1), 2):
        mesh = make_mesh(family, seed)
        assert 0.3 < np.ptp(mesh.points, axis=0).max() < 20
        assert mesh.area > 0.01
        if family in OF_ONE_PIECE:
            assert not mesh.component_labels.any()
    again = make_mesh(family, seed)
    np.testing.assert_array_equal(mesh.points, again.points)
    np.testing.assert_array_equal(mesh.faces, again.faces)


def test_families_hold_closed_open_and_multi_part_surfaces():
    def whole(family, seed):
        return make_mesh(family, seed).with_merged_vertices().without_unreferenced()

    assert any(len(whole("blob", seed).boundary_vertices) == 0 for seed in range(6))
    assert all(len(whole("sheet", seed).boundary_vertices) for seed in range(4))
    for family, seed in itertools.product(("assembly", "furniture", "vehicle"), range(4)):
        # Of many parts, before holes may take some.
        assert FAMILIES[family][0](np.random.default_rng(seed)).component_labels.max() > 0


def test_families_are_drawn_by_their_weights():
    rng = np.random.default_rng(0)
    counts = np.bincount([draw_family(rng) for _ in range(20_000)], minlength=len(FAMILIES))
    weights = np.array([weight for _, weight in FAMILIES.values()], dtype=float)
    np.testing.assert_allclose(counts / 20_000, weights / weights.sum(), atol=0.012)


def test_bend_twist_and_rotation_keep_what_they_should():
    rng = np.random.default_rng(0)
    grid = np.meshgrid(np.linspace(0, 2, 90), np.linspace(0, 1, 40), [0.0], indexing="ij")
    sheet = surfaces.grid_mesh(np.stack(grid, axis=-1)[:, :, 0])
    bent = sheet.with_points(surfaces.bend(sheet.points, 2.5))
    assert bent.area == pytest.approx(sheet.area, rel=1e-3)  # bending a plate is an isometry
    turned = surfaces.twist(sheet.points, 1.0)
    radius = np.hypot(sheet.points[:, 1], sheet.points[:, 2])
    np.testing.assert_allclose(np.hypot(turned[:, 1], turned[:, 2]), radius, atol=1e-12)
    rotations = np.array([surfaces.random_rotation(rng) for _ in range(4000)])
    np.testing.assert_allclose(rotations[0] @ rotations[0].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    # Uniform on SO(3): the tilt of any axis is uniform in its cosine, mean |cos| = 1/2.
    assert np.abs(rotations[:, 2, 2]).mean() == pytest.approx(0.5, abs=0.02)
    line = np.zeros((5, 3))  # flat things do not turn into NaN
    for deform in (surfaces.bend, surfaces.twist, surfaces.taper):
        np.testing.assert_array_equal(deform(line, 0.3), line)


def test_half_turned_tubes_close_without_a_pinch():
    t = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    circle = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    for turns in (0.0, 0.5, 1.5):
        tube = surfaces.sweep(circle, 0.2, closed=True, aspect=0.5, turns=turns)
        a, b = tube.points[tube.edges].transpose(1, 0, 2)
        assert np.linalg.norm(a - b, axis=1).max() < 0.13
        assert tube.n - len(tube.unique_edges[0]) + len(tube.faces) == 0  # a torus
        # A thin tube has the area of its centre line times its rim (here 1.4 % more).
        rim = 0.2 * np.pi * (3 * 1.5 - np.sqrt(3.5 * 2.5))
        assert tube.area == pytest.approx(2 * np.pi * rim, rel=0.03)


def test_bisection_cuts_edges_and_keeps_the_surface_whole():
    ball = sphere(subdivisions=1).geometry
    long = ball.with_points(ball.points * [1, 1, 4])
    fine = surfaces.bisected(long, 0.2)
    a, b = fine.points[fine.edges].transpose(1, 0, 2)
    assert np.linalg.norm(a - b, axis=1).max() <= 0.2
    assert fine.area == pytest.approx(long.area)
    assert (fine.with_merged_vertices().unique_edges[1] == 2).all()  # no crack opens
    assert surfaces.largest_part(surfaces.join([ball, fine])).area == pytest.approx(fine.area)


def test_symmetric_things_have_a_mirror():
    for seed in range(4):
        points = FAMILIES["symmetric"][0](np.random.default_rng(seed)).points
        tree = cKDTree(points)
        cell = np.quantile(tree.query(points, 2)[0][:, 1], 0.99)
        mirrored = (points * mirror for mirror in ([-1, 1, 1], [1, -1, 1]))
        gaps = [np.quantile(tree.query(twin)[0], 0.95) for twin in mirrored]
        assert min(gaps) < 1.5 * cell  # grids have no mirrors, so points have none


def test_crumbs_and_unknown_families_are_refused():
    with pytest.raises(InvalidInputError, match="`field` must have a surface of 400 faces"):
        bodies.polygonized(lambda p: np.linalg.norm(p, axis=1) - 0.05, -np.ones(3), np.ones(3))
    with pytest.raises(InvalidInputError, match="`family` must be one of"):
        make_mesh("unicorn", 0)


# Samples


def test_sample_holds_the_lowest_modes_of_its_points():
    sample = make_sample(CorpusConfig(seed=2, n_points=400, k=12, nonuniform=0.0), 0)
    area = (laplacian := robust_laplacian(PointCloud(sample.points))).mass.sum()
    np.testing.assert_allclose(sample.mass, laplacian.mass / area, rtol=1e-9)
    energy = np.sum(sample.eigenvectors * (laplacian.stiffness @ sample.eigenvectors), axis=0)
    # Independent truth: the dense symmetric problem.
    root = np.sqrt(sample.mass)
    exact = np.linalg.eigvalsh(laplacian.stiffness.toarray() / root[:, None] / root)[:12]
    np.testing.assert_allclose(energy, exact, rtol=1e-6, atol=1e-6 * exact[-1])
    assert np.abs(sample.points).max() == pytest.approx(1.0)
    np.testing.assert_allclose(sample.points.mean(axis=0), 0, atol=1e-12)


def test_the_tolerance_of_the_modes_is_far_below_what_is_stored():
    sample = make_sample(CorpusConfig(seed=4, n_points=700, k=40), 1)
    spectrum = eigensolve(robust_laplacian(PointCloud(sample.points)), 40, Arpack())
    exact = spectrum.eigenvectors / np.sqrt(spectrum.mass.sum() ** -1)
    overlap = exact.T @ (sample.mass[:, None] * sample.eigenvectors)
    assert 1 - np.sum(overlap**2) / 40 < 1e-6


def test_surfaces_do_not_follow_from_the_draw_of_their_family(monkeypatch):
    first: dict[str, list[float]] = {name: [] for name in FAMILIES}

    def recording(name):
        def ball(rng):
            first[name].append(rng.random())
            return sphere(subdivisions=1).geometry

        return ball

    for name, (_, weight) in FAMILIES.items():
        monkeypatch.setitem(FAMILIES, name, (recording(name), weight))
    for i in range(200):
        make_sample(replace(TINY, n_points=64, k=2), i)
    for draws in first.values():
        if len(draws) > 9:  # uniform numbers: a spread of 0.4 or less has a chance below 0.2 %
            assert np.ptp(draws) > 0.4


def apart(rng):
    triangle = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    return surfaces.join([triangle, triangle.with_points(triangle.points + [50.0, 0, 0])])


def empty(rng):
    raise InvalidInputError("empty")


def speck(rng):
    """So small and far away that its points fall on each other."""
    return TriangleMesh(1000 + 2.5e-13 * np.eye(3), [[0, 1, 2]])


@pytest.mark.parametrize(
    ("reason", "first"), [("components", [apart] * 2), ("mesh", [empty]), ("solve", [speck])]
)
def test_what_cannot_be_used_is_drawn_again_and_counted(monkeypatch, reason, first):
    tries = iter([*first, families.blob])
    monkeypatch.setattr(samples, "draw_family", lambda rng: 0)
    monkeypatch.setattr(families, "_deform", lambda mesh, rng, likely: mesh)
    monkeypatch.setitem(FAMILIES, "quadruped", (lambda rng: next(tries)(rng), 1.0))
    labels = make_sample(replace(TINY, nonuniform=0.0), 0).labels
    counted = {name: labels[f"rejected_{name}"] for name in samples.REASONS}
    assert counted == dict.fromkeys(samples.REASONS, 0) | {reason: len(first)}
    assert labels["nonuniform"] == 0


def test_crowded_samples_are_labelled():
    assert make_sample(replace(TINY, nonuniform=1.0), 0).labels["nonuniform"] == 1


# Generation


def test_written_corpus_is_orthonormal_and_counted(folder):
    points, mass, eigenvectors = everything(folder).values()
    assert points.shape == (10, 160, 3)
    np.testing.assert_allclose(mass.sum(axis=1), 1, rtol=1e-5)
    vectors = eigenvectors.astype(np.float64)
    gram = np.einsum("sni,sn,snj->sij", vectors, mass, vectors)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(6), gram.shape), atol=3e-3)
    counts = report(folder)
    assert counts.samples == sum(counts.families.values()) == 10
    assert [len(shard.mass) for shard in open_shards(folder).shards] == [4, 4, 2]


def test_workers_in_other_processes_make_the_same_samples_bit_for_bit(folder, tmp_path):
    told = []
    progress = lambda done, total: told.append((done, total))  # noqa: E731
    generate(tmp_path, 10, config=TINY, workers=2, progress=progress)
    assert told == [(i, 10) for i in range(1, 11)]
    assert_same(tmp_path, folder)


def test_a_process_that_dies_is_an_error():
    with produced(TINY, itertools.count(), 1) as made:
        next(made)
        (worker,) = multiprocessing.active_children()
        worker.kill()
        with pytest.raises(WorkerError, match=r"has died.*start again with fewer `workers`"):
            deque(made, maxlen=0)
    assert not multiprocessing.active_children()


def test_processes_end_with_the_one_that_started_them(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import itertools, multiprocessing, time\n"
        "from spectra_kit.training.corpus import CorpusConfig, produced\n"
        "if __name__ == '__main__':\n"
        "    config = CorpusConfig(seed=0, n_points=100, k=4)\n"
        "    with produced(config, itertools.count(), 1) as made:\n"
        "        next(made)\n"
        "        print(multiprocessing.active_children()[0].pid, flush=True)\n"
        "        time.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    parent.kill()
    parent.communicate()
    for _ in range(600):
        if not _alive(worker):
            return
        time.sleep(0.1)
    pytest.fail("the worker lives on")


def _alive(pid: int) -> bool:
    try:  # an ended process that nobody waited for counts as ended
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):  # the latter if it ends while it is read
        return False


def test_generation_resumes_and_keeps_what_is_there(folder, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    shutil.rmtree(copy / "shard_0001")
    before = (copy / "shard_0000" / "points.npy").stat().st_mtime_ns
    generate(copy, 10, config=TINY)
    assert (copy / "shard_0000" / "points.npy").stat().st_mtime_ns == before
    assert_same(copy, folder)


def test_interruption_leaves_whole_shards(tmp_path, monkeypatch):
    original = corpus.make_sample

    def interrupted(config, index):
        if index == 6:
            raise KeyboardInterrupt
        return original(config, index)

    monkeypatch.setattr(corpus, "make_sample", interrupted)
    with pytest.raises(KeyboardInterrupt):
        generate(tmp_path, 8, config=TINY)
    assert report(tmp_path).samples == 4


def test_another_configuration_or_length_is_refused(folder):
    with pytest.raises(InvalidInputError, match=r"another configuration: \['k', 'seed'\] differ"):
        generate(folder, 10, config=replace(TINY, seed=9, k=5))
    assert json.loads((folder / "corpus.json").read_text())["seed"] == 3
    with pytest.raises(InvalidInputError, match=r"shard 2 of .* holds 2 samples where `n` asks"):
        generate(folder, 12, config=TINY)


@pytest.mark.parametrize("record", [b"{", b"[1]", b"null", b"\xff", b"[" * 100_000])
def test_a_damaged_record_is_refused(tmp_path, record):
    (tmp_path / "corpus.json").write_bytes(record)
    with pytest.raises(InvalidInputError, match=r"corpus.json: not a whole record of a corpus"):
        generate(tmp_path, 1, config=TINY)


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"seed": -1}, "seed"),
        ({"k": 0}, "k"),
        ({"n_points": 63}, "n_points"),
        ({"n_points": 100, "k": 51}, "n_points"),
        ({"shard_size": 0}, "shard_size"),
        ({"nonuniform": 1.5}, "nonuniform"),
        ({"pool": "x", "pool_share": 1.5}, "pool_share"),
        ({"pool_share": 0.5}, "pool"),
    ],
)
def test_configuration_is_checked(change, argument):
    with pytest.raises(InvalidInputError, match=f"`{argument}` must "):
        replace(TINY, **change)


@pytest.mark.parametrize(("n", "workers", "match"), [(0, 1, "`n`"), (4, 0, "`workers`")])
def test_counts_are_checked(tmp_path, n, workers, match):
    with pytest.raises(InvalidInputError, match=match):
        generate(tmp_path, n, config=TINY, workers=workers)


def test_app_writes_a_corpus_and_reports(tmp_path, capsys):
    command = [str(tmp_path), "-n", "3", "--points", "100", "-k", "4", "--workers", "1"]
    assert make_corpus.main(command) == 0
    output = capsys.readouterr().out
    for told in ("3 samples", "drawn again because of", "3 made in"):
        assert told in output
    assert make_corpus.main([*command, "--seed", "5"]) == 1
    assert "another configuration" in capsys.readouterr().err
