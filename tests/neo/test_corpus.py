"""The corpus: samples with exact modes, whole shards on disk, pools of real meshes, a survey."""

import csv
import json
import re
import shutil
import sys
from collections import Counter
from dataclasses import replace

import inspect_corpus
import make_corpus
import numpy as np
import pytest
import validate_neo
from conftest import bumpy, produced_here
from inspect_corpus import Topology, read_config, survey, topology
from PIL import Image

from spectra_kit import Arpack, Cascade, Dense, eigensolve
from spectra_kit._sparse.slicing import sliced_eigenpairs
from spectra_kit.eigen.subspaces import AmbientFourier
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere, torus
from spectra_kit.neo.train import corpus, families, samples, surfaces
from spectra_kit.neo.train.corpus import generate, open_shards, report, write_shard
from spectra_kit.neo.train.evaluation import errors_of, typical
from spectra_kit.neo.train.families import FAMILIES
from spectra_kit.neo.train.pool import open_pool, pack_pool, varied
from spectra_kit.neo.train.samples import (
    FROM_POOL,
    CorpusConfig,
    Samples,
    exact_sample,
    make_sample,
    sample_mesh,
)
from spectra_kit.neo.train.surfaces import at_resolution
from spectra_kit.operators import delaunay_laplacian, robust_laplacian

TINY = CorpusConfig(seed=3, n_points=160, k=6, shard_size=4)


def everything(folder):
    opened = open_shards(folder)
    return opened.batch(np.arange(len(opened))).arrays()


def assert_same(folder, other):
    for name, array in everything(folder).items():
        np.testing.assert_array_equal(array, everything(other)[name])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("corpus")
    generate(path, 10, config=TINY)
    return path


# Samples


def test_sample_holds_the_lowest_modes_of_its_points():
    config = CorpusConfig(seed=2, n_points=400, k=12, nonuniform=0.0)
    unit, _, modes, _ = exact_sample(config, 0)
    area = (laplacian := robust_laplacian(PointCloud(unit.points))).mass.sum()
    np.testing.assert_allclose(unit.mass, laplacian.mass / area, rtol=1e-9)
    energy = np.sum(modes * (laplacian.stiffness @ modes), axis=0)
    # Independent truth: the dense symmetric problem.
    root = np.sqrt(unit.mass)
    exact = np.linalg.eigvalsh(laplacian.stiffness.toarray() / root[:, None] / root)[:12]
    np.testing.assert_allclose(energy, exact, atol=1e-5 * exact[-1])
    assert np.abs(unit.points).max() == pytest.approx(1.0)
    np.testing.assert_allclose(unit.points.mean(axis=0), 0, atol=1e-12)
    # The tolerance of the modes is far below what is stored.
    spectrum = eigensolve(laplacian, 12, Arpack())
    overlap = spectrum.eigenvectors.T @ (spectrum.mass[:, None] * modes)
    assert 1 - np.sum(overlap**2) / 12 / area < 1e-6
    kept = make_sample(config, 0)
    np.testing.assert_array_equal(kept.eigenvectors[0], modes.astype(np.float16))
    np.testing.assert_array_equal(kept.points[0], unit.points.astype(np.float32))


def test_no_mode_is_missing_of_many():
    """By blocks around one shift, on symmetric surfaces too: pairs have both their modes."""
    weights = dict.fromkeys(FAMILIES, 0.0) | {"symmetric": 1.0, "sheet": 1.0}
    config = CorpusConfig(seed=5, n_points=512, k=96, mesh_share=0.5, weights=weights)
    kinds, tol = set(), samples._TOL
    for index in range(5):
        unit, values, U, labels = exact_sample(config, index)
        kinds.add(labels["mesh"])
        exact = Dense().eigenpairs(unit, 97)
        np.testing.assert_allclose(values, exact.eigenvalues[:96], atol=1e-5 * values[-1])
        overlap = exact.eigenvectors.T @ (unit.mass[:, None] * U)  # the last may be one of a pair
        assert 1 - np.sum(overlap**2) / 96 < tol**2
        np.testing.assert_allclose(U.T @ (unit.mass[:, None] * U), np.eye(96), atol=tol**2)
    assert kinds == {0, 1}


def test_a_mode_that_blocks_passed_over_is_missed_by_no_sample(monkeypatch):
    def forgetful(*matrices, **options):
        found = sliced_eigenpairs(*matrices[:2], matrices[2] + 1, **options)
        kept = np.arange(matrices[2] + 1) != 40
        return found._replace(
            eigenvalues=found.eigenvalues[kept], eigenvectors=found.eigenvectors[:, kept]
        )

    monkeypatch.setattr(samples, "sliced_eigenpairs", forgetful)
    config = CorpusConfig(seed=5, n_points=512, k=96)
    unit, values, *_ = exact_sample(config, 0)
    np.testing.assert_allclose(values, Dense().eigenpairs(unit, 96).eigenvalues, atol=1e-9)


def apart(rng):
    triangle = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    return surfaces.join([triangle, triangle.with_points(triangle.points + [50.0, 0, 0])])


def empty(rng):
    raise InvalidInputError("empty")


def speck(rng):
    """So small and far away that its points fall on each other."""
    return TriangleMesh(1000 + 2.5e-13 * np.eye(3), [[0, 1, 2]])


def test_what_cannot_be_used_is_drawn_again_and_counted(monkeypatch):
    tries = iter([apart, empty, speck, apart, families.blob])
    monkeypatch.setattr(samples, "draw_family", lambda *_: 0)
    monkeypatch.setattr(families, "_deform", lambda mesh, rng, likely: mesh)
    monkeypatch.setitem(FAMILIES, "quadruped", (lambda rng: next(tries)(rng), 1.0))
    labels = make_sample(replace(TINY, nonuniform=0.0), 0).label(0)
    counted = {name: labels[f"rejected_{name}"] for name in samples.REASONS}
    assert counted == {"mesh": 1, "components": 2, "solve": 1}
    assert labels["nonuniform"] == 0


def test_crowded_samples_are_labelled_and_crowd():
    typical = {}
    for share in (1.0, 0.0):
        config = replace(TINY, nonuniform=share)
        made = [make_sample(config, index) for index in (1, 3, 4)]
        assert {int(sample.labels["nonuniform"][0]) for sample in made} == {share}
        typical[share] = sum(np.median(sample.mass) for sample in made)
    assert typical[1.0] < 0.92 * typical[0.0]  # most points are where they are many
    mesh = make_sample(replace(TINY, nonuniform=1.0, mesh_share=1.0), 1)
    assert mesh.labels["nonuniform"] == 0  # its vertices are where they are


def test_the_operator_comes_with_the_modes_and_meshes_with_their_own(pool):
    made = replace(of_pool(pool, pool_share=0.5), mesh_share=0.6, nonuniform=0.0)
    whole = [exact_sample(made, index) for index in range(8)]
    batch = Samples.joined([make_sample(made, index) for index in range(8)])
    assert {labels["mesh"] for *_, labels in whole} == {0, 1}
    real = {labels["family"] == FROM_POOL for *_, labels in whole if labels["mesh"]}
    assert real == {True, False}
    for i, (laplacian, values, U, labels) in enumerate(whole):
        n = labels["n"]
        assert batch.label(i) == labels
        assert laplacian.n == n
        assert n == 160 if not labels["mesh"] else 30 <= n <= 160
        # Independent truths: the dense problem of the operator, and the operator of what is there.
        root = np.sqrt(laplacian.mass)
        dense = np.linalg.eigvalsh(laplacian.stiffness.toarray() / root[:, None] / root)[:6]
        np.testing.assert_allclose(values, dense, rtol=1e-5, atol=1e-6)
        mesh = sample_mesh(made, labels)
        if labels["mesh"]:
            assert mesh.n == n
            theirs = delaunay_laplacian(mesh)
            mass = theirs.mass / theirs.area
            np.testing.assert_allclose(laplacian.mass, mass, rtol=1e-3, atol=1e-6)
            same = eigensolve(theirs, 6, Arpack()).eigenvalues * theirs.area
            np.testing.assert_allclose(values, same, rtol=1e-2, atol=1e-6)
        # In the shards: to float32, padded with what has no mass and no neighbours.
        L = batch.stiffness(i)
        assert abs(L[:n][:, :n] - laplacian.stiffness).max() < 1e-6 * abs(L).max()
        assert L[n:].nnz == L[:, n:].nnz == 0
        assert not batch.mass[i, n:].any()
        assert not batch.eigenvectors[i, n:].any()
        assert (batch.points[i, n:] == batch.points[i, n - 1]).all()
        energy = np.sum(U * (L[:n][:, :n] @ U), axis=0)
        np.testing.assert_allclose(energy, values, rtol=1e-4, atol=1e-4 * values[-1])


@pytest.mark.parametrize("n", [12, 42, 162, 642])
def test_meshes_come_at_a_resolution_in_one_part(n):
    rng, seen = np.random.default_rng(0), set()
    for _ in range(6):
        mesh = bumpy(642) if n > 162 else sphere(subdivisions=(12, 42, 162).index(n)).geometry
        away = mesh.with_points(0.1 * mesh.points + 9)
        found = at_resolution(surfaces.join([away, mesh]), rng, fewest=100, most=300)
        assert 50 <= found.n <= 300
        assert len(np.unique(found.component_labels)) == 1
        assert found.area == pytest.approx(mesh.area, rel=0.15)
        assert n > 300 or topology(found) == topology(mesh)
        seen.add(found.n)
    assert (seen == {n}) == (n == 162)  # what fits stays as it is


def test_meshes_with_edges_of_three_faces_are_subdivided_and_decimated():
    rng = np.random.default_rng(0)
    wing = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]]
    fins = TriangleMesh(wing, [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    for _ in range(4):
        found = at_resolution(fins, rng, fewest=100, most=1000)
        assert found.n >= 100
        assert found.area == pytest.approx(fins.area)
        assert topology(found) == topology(fins)
        corners = found.points[found.faces].reshape(-1, 3)  # each face with three of its own
        soup = TriangleMesh(corners, np.arange(len(corners)).reshape(-1, 3))
        assert topology(at_resolution(soup, rng, fewest=100, most=1000)) == topology(fins)
    assert 10 <= at_resolution(found, rng, fewest=20, most=50).n <= 50


def test_families_come_by_the_weights_of_the_configuration():
    names = list(FAMILIES)
    alone = replace(TINY, weights=dict.fromkeys(names, 0.0) | {"tube": 2.0, "sheet": 1.0})
    drawn = [names[samples.draw_source(alone, i, 0)["family"]] for i in range(90)]
    assert set(drawn) == {"tube", "sheet"}
    assert 45 < drawn.count("tube") < 75
    assert alone.fingerprint() != TINY.fingerprint()
    for weights, told in (
        ({"desk": 1.0}, r"`weights` must be of families .* got \['desk'\]"),
        ({"tube": -1.0}, "`weights` must not be negative"),
        (dict.fromkeys(names, 0.0), "`weights` must .* not all be zero"),
    ):
        with pytest.raises(InvalidInputError, match=told):
            replace(TINY, weights=weights)


# Generation


def test_written_corpus_is_orthonormal_and_counted(folder):
    points, mass, eigenvectors, *_ = everything(folder).values()
    assert points.shape == (10, 160, 3)
    np.testing.assert_allclose(mass.sum(axis=1), 1, rtol=1e-5)
    vectors = eigenvectors.astype(np.float64)
    gram = np.einsum("sni,sn,snj->sij", vectors, mass, vectors)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(6), gram.shape), atol=3e-3)
    counts = report(folder)
    assert counts.samples == sum(counts.families.values()) == 10
    assert [len(shard.mass) for shard in open_shards(folder).shards] == [4, 4, 2]


def test_many_workers_write_the_same_corpus(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(corpus, "produced", produced_here)  # tests of streams start processes
    told = []
    progress = lambda done, total: told.append((done, total))  # noqa: E731
    generate(tmp_path, 10, config=TINY, workers=2, progress=progress)
    assert told == [(i, 10) for i in range(1, 11)]
    assert_same(tmp_path, folder)


def test_an_interrupted_run_leaves_whole_shards_and_is_resumed(folder, tmp_path, monkeypatch):
    def interrupted(config, index):
        if index == 6:
            raise KeyboardInterrupt
        return make_sample(config, index)

    with monkeypatch.context() as patch:
        patch.setattr(corpus, "make_sample", interrupted)
        with pytest.raises(KeyboardInterrupt):
            generate(tmp_path, 10, config=TINY)
    assert report(tmp_path).samples == 4
    before = (tmp_path / "shard_0000" / "points.npy").stat().st_mtime_ns
    generate(tmp_path, 10, config=TINY)
    assert (tmp_path / "shard_0000" / "points.npy").stat().st_mtime_ns == before
    assert_same(tmp_path, folder)


@pytest.mark.parametrize("record", [b"{", b"[1]", b"null", b"\xff", b"[" * 100_000])
def test_a_damaged_record_is_refused(tmp_path, record):
    (tmp_path / "corpus.json").write_bytes(record)
    with pytest.raises(InvalidInputError, match=r"corpus.json: not a whole record of a corpus"):
        generate(tmp_path, 1, config=TINY)


@pytest.mark.parametrize(
    ("change", "n", "workers", "told"),
    [
        ({"seed": -1}, 1, 1, "`seed` must "),
        ({"k": 0}, 1, 1, "`k` must "),
        ({"n_points": 63}, 1, 1, "`n_points` must "),
        ({"n_points": 100, "k": 51}, 1, 1, "`n_points` must "),
        ({"shard_size": 0}, 1, 1, "`shard_size` must "),
        ({"nonuniform": 1.5}, 1, 1, "`nonuniform` must "),
        ({"pool": "x", "pool_share": 1.5}, 1, 1, "`pool_share` must "),
        ({"pool_share": 0.5}, 1, 1, "`pool` must "),
        ({}, 0, 1, "`n` must "),
        ({}, 4, 0, "`workers` must "),
        ({"seed": 9, "k": 5}, 10, 1, r"another configuration: \['k', 'seed'\] differ"),
        ({}, 12, 1, r"shard 2 of .* holds 2 samples where `n` asks"),
    ],
)
def test_what_does_not_fit_is_refused(folder, change, n, workers, told):
    with pytest.raises(InvalidInputError, match=told):
        generate(folder, n, config=replace(TINY, **change), workers=workers)
    assert json.loads((folder / "corpus.json").read_text())["seed"] == 3


def test_app_writes_a_corpus_and_reports(tmp_path, capsys):
    command = [str(tmp_path), "-n", "3", "--points", "100", "-k", "4", "--workers", "1"]
    assert make_corpus.main(command) == 0
    output = capsys.readouterr().out
    for told in ("3 samples", "drawn again because of", "3 made in"):
        assert told in output
    meshes = ["--family", "tube=3", "--mesh-share", "1"]
    options = [str(tmp_path / "meshes"), *command[1:], *meshes]
    assert make_corpus.main(options) == 0
    labels = open_shards(tmp_path / "meshes").labels
    assert labels["mesh"].tolist() == [1, 1, 1]
    stored = read_config(tmp_path / "meshes")
    assert (stored.weights, stored.mesh_share) == ({"tube": 3.0}, 1.0)
    capsys.readouterr()
    assert validate_neo.main([options[0], "--worst", "1"]) == 0
    output = capsys.readouterr().out
    assert re.search(r"^every mesh +3 ( +[\d.e+-]+){4}$", output, re.MULTILINE)
    assert len(output.partition("the worst")[2].splitlines()) == 2
    left = []
    for m in ("12", "24"):
        waves = [options[0], "--fourier", m, "--smoothing", "1", "--worst", "1"]
        assert validate_neo.main(waves) == 0
        row = re.search(r"^every mesh.*$", capsys.readouterr().out, re.MULTILINE)[0].split()
        left.append([float(number) for number in row[3:5]])
    assert left[1][0] < left[0][0]  # more waves leave less outside their span,
    assert left[0][1] < left[0][0]  # and smoothing less than the waves
    assert validate_neo.main([*waves[:-1], "3"]) == 0
    named = capsys.readouterr().out.partition("the worst")[2]
    left = re.findall(r"\d +[\d.e+-]+ +([\d.e+-]+) .* points", named)
    assert [float(span) for span in left] == sorted(map(float, left), reverse=True)
    assert len(set(left)) == 3
    waves = Cascade(subspace=AmbientFourier(m=12), coarsest=sys.maxsize, max_steps=1)
    some, every = (errors_of(waves, open_shards(tmp_path / "meshes"), most=n) for n in (2, None))
    assert {name: part.tolist() for name, part in some.items()} == {
        name: part[:2].tolist() for name, part in every.items()
    }
    assert typical(np.array([1e-4, 1e-2, 1e-3])) == pytest.approx(1e-3)
    for file in ("eigenvalues", "starts", "columns", "entries"):
        (tmp_path / "shard_0000" / f"{file}.npy").unlink()
    for wrong in ([str(tmp_path)], [options[0], "--most", "0"]):
        assert validate_neo.main(wrong) == 2
    output = capsys.readouterr().err
    assert "`corpus` must have operators" in output
    assert "`most` must be at least 1" in output
    with pytest.raises(InvalidInputError, match="`solver` must have a subspace"):
        errors_of(Cascade(), open_shards(tmp_path / "meshes"))
    assert make_corpus.main([*command, "--seed", "5"]) == 2
    assert "another configuration" in capsys.readouterr().err


# Shards


def random_samples(n):
    """Points, masses of sum one, and columns of size one."""
    rng = np.random.default_rng(0)
    mass = rng.uniform(0.5, 1.5, (n, 64))
    points, modes = rng.standard_normal((n, 64, 3)), rng.standard_normal((n, 64, 8))
    return points, mass / mass.sum(1, keepdims=True), modes


def test_shards_keep_samples_labels_and_order_and_are_never_overwritten(tmp_path):
    points, mass, modes = random_samples(5)
    whole = Samples(points, mass, modes, {"seed": np.arange(5)})
    late = whole[3:]
    write_shard(tmp_path, 1, replace(late, labels={**late.labels, "extra": [0, 0]}))
    write_shard(tmp_path, 0, whole[:3])
    with pytest.raises(InvalidInputError, match=r"shard 0 of .* exists; delete"):
        write_shard(tmp_path, 0, whole)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["shard_0000", "shard_0001"]
    (tmp_path / ".unfinished-x").mkdir()  # neither is a shard
    (tmp_path / "notes.txt").write_text("")
    opened = open_shards(tmp_path)
    assert (len(opened), opened.n_points, opened.k) == (5, 64, 8)
    assert opened.labels.keys() == {"seed"}
    np.testing.assert_array_equal(opened.labels["seed"], range(5))
    chosen = [4, 0, 3, 4]
    batch = opened.batch(chosen)
    twice = open_shards(tmp_path, tmp_path)
    np.testing.assert_array_equal(twice.labels["seed"], [*range(5), *range(5)])
    np.testing.assert_array_equal(batch.points, points[chosen].astype(np.float32))
    np.testing.assert_array_equal(batch.mass, mass[chosen].astype(np.float32))
    np.testing.assert_array_equal(batch.eigenvectors, modes[chosen].astype(np.float16))
    assert isinstance(opened.shards[0].points.base, np.memmap)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda p, m, u: (p[:, :-1], m, u, {}), r"arrays of shapes {'points': \(2, 64, 3\)"),
        (lambda p, m, u: (p, m, u[:1], {}), r"arrays of shapes {'points': \(1, 64, 3\)"),
        (lambda p, m, u: (p, m, u, {"seed": [1]}), "`seed` must have one integer for each of 2"),
        (
            lambda p, m, u: (p, 2 * m, u, {}),
            "`mass` must not be negative, and have rows",
        ),
        (lambda p, m, u: (p, m, u * np.nan, {}), "`eigenvectors` must be there and finite"),
        (lambda p, m, u: (p[:0], m[:0], u[:0], {}), r"must be one or more, .*\(0, 64, 3\)"),
        (lambda p, m, u: (p, m, u[..., :5], {}), r"must have the same \(points, modes\)"),
    ],
)
def test_bad_samples_are_refused(tmp_path, change, told):
    def write_and_open(*samples):
        write_shard(tmp_path, 1, Samples(*samples))
        open_shards(tmp_path)

    write_shard(tmp_path, 0, Samples(*random_samples(2)))
    with pytest.raises(InvalidInputError, match=told):
        write_and_open(*change(*random_samples(2)))


def test_shards_without_operators_are_read_beside_those_with_them(folder, tmp_path):
    first = open_shards(folder).batch(range(4))
    write_shard(tmp_path, 0, Samples(first.points, first.mass, first.eigenvectors, first.labels))
    write_shard(tmp_path, 1, first)
    both = open_shards(tmp_path)
    assert (open_shards(folder).has_operators, both.has_operators) == (True, False)
    assert not both.batch([3, 4]).has_operators
    kept = both.batch([6, 5])
    np.testing.assert_array_equal(kept.eigenvalues, first.eigenvalues[[2, 1]])
    for place, i in ((0, 2), (1, 1)):
        assert abs(kept.stiffness(place) - first.stiffness(i)).max() == 0
    for change in ({"starts": None}, {"entries": first.entries[:-1]}):
        with pytest.raises(InvalidInputError, match=r"`samples` must be one or more, in arrays of"):
            replace(first, **change)


def cut(path):
    path.write_bytes(path.read_bytes()[:-100])


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (shutil.rmtree, "must hold shards, got none"),
        (lambda shard: (shard / "mass.npy").unlink(), "not a whole shard .*No such file"),
        (lambda shard: cut(shard / "points.npy"), "not a whole shard .*; delete it, and generate"),
        (lambda shard: cut(shard / "labels.npz"), "not a whole shard"),
        (lambda shard: np.save(shard / "mass.npy", np.ones((2, 64))), "mass must be float32, got"),
        (
            lambda shard: np.save(shard / "points.npy", np.ones((2, 9, 3), "f4")),
            "shard_0000: `.*must .*; delete it, and generate",
        ),
        (
            lambda shard: [
                np.save(path, np.load(path)[:0]) for path in sorted(shard.glob("*.npy"))
            ],
            r"shard_0000: .*must be one or more, .*\(0, 64, 3\)",
        ),
        (lambda shard: np.savez(shard / "labels.npz", a=[0.5, 1]), "a must be int64, got"),
        (lambda shard: np.save(shard / "starts.npy", [0]), "not a whole shard .*eigenvalues.npy"),
        (lambda shard: np.savez(shard / "labels.npz", a=[1]), "one integer for each of 2 samples"),
    ],
)
def test_damaged_shards_are_refused(tmp_path, damage, told):
    damage(write_shard(tmp_path, 0, Samples(*random_samples(2), {"seed": [0, 1]})))
    with pytest.raises(InvalidInputError, match=told):
        open_shards(tmp_path)


# Pools of real meshes

MESHES = {
    "m3": (sphere(subdivisions=2).geometry, "train", "pool_01.npz"),
    "m1": (torus(n=300).geometry, "train", "pool_00.npz"),
    "m2": (sphere(subdivisions=1).geometry, "val", "pool_00.npz"),
    "m4": (rectangle(n=100).geometry, "train", "pool_01.npz"),
}


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    path = tmp_path_factory.mktemp("pool")
    for chunk in ("pool_00.npz", "pool_01.npz"):
        meshes = {name: row[0] for name, row in MESHES.items() if row[2] == chunk}
        np.savez(
            path / chunk,
            V=np.concatenate([mesh.points for mesh in meshes.values()]).astype(np.float16),
            F=np.concatenate([mesh.faces for mesh in meshes.values()]).astype(np.uint16),
            voff=np.cumsum([0, *(mesh.n for mesh in meshes.values())]),
            foff=np.cumsum([0, *(len(mesh.faces) for mesh in meshes.values())]),
            ids=list(meshes),
        )
    with (path / "manifest.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["id", "category", "split"])
        rows.writerows([name, "thing", row[1]] for name, row in MESHES.items())
    return path


def of_pool(folder, **change):
    return replace(TINY, **{"pool": folder, "pool_share": 1.0} | change)


def test_splits_are_kept_apart_and_ordered_by_name(pool):
    train, val = open_pool(pool, "train"), open_pool(pool, "val")
    assert (train.names, val.names) == (("m1", "m3", "m4"), ("m2",))
    assert (len(train), len(val)) == (3, 1)
    for i, name in enumerate(train.names):
        np.testing.assert_array_equal(train.mesh(i).faces, MESHES[name][0].faces)
        np.testing.assert_allclose(train.mesh(i).points, MESHES[name][0].points, atol=2e-3)
    assert train.digest != val.digest


def test_packed_pool_equals_the_unpacked_one_and_is_read_anew(pool, tmp_path):
    path = tmp_path / "small.npz"
    for split in ("val", "train"):
        packed, again = pack_pool(pool, path, split), open_pool(path, split)
        assert packed.digest == again.digest == open_pool(pool, split).digest
        assert packed.names == again.names
    ours, theirs = of_pool(pool), of_pool(path)
    assert ours.fingerprint() == theirs.fingerprint()
    here, there = make_sample(ours, 2), make_sample(theirs, 2)
    assert here.labels == there.labels
    np.testing.assert_array_equal(here.eigenvectors, there.eigenvectors)
    with pytest.raises(InvalidInputError, match=r"`split` must be one .* are in, got 'val'"):
        open_pool(path, "val")


def test_corpus_draws_only_meshes_of_its_split_and_as_many_as_its_share(pool, tmp_path):
    generate(tmp_path, 8, config=of_pool(pool))
    labels = open_shards(tmp_path).labels
    assert set(labels["pool"].tolist()) == {0, 1, 2}
    assert (labels["family"] == FROM_POOL).all()
    assert report(tmp_path).families["pool"] == 8
    assert make_sample(of_pool(pool, pool_split="val"), 1).label(0)["pool"] == 0
    with pytest.raises(InvalidInputError, match=r"another configuration: \['pool'\] differ"):
        generate(tmp_path, 8, config=of_pool(pool, pool_split="val"))
    mixed = [make_sample(of_pool(pool, pool_share=0.5), i).label(0) for i in range(8)]
    real = [label["family"] == FROM_POOL for label in mixed]
    assert 0 < sum(real) < 8
    assert [label["pool"] >= 0 for label in mixed] == real
    without = of_pool(pool, pool_share=0.0)
    assert without.fingerprint() == TINY.fingerprint()
    np.testing.assert_array_equal(make_sample(without, 0).points, make_sample(TINY, 0).points)


def test_rejections_are_counted(tmp_path):
    ball = sphere(subdivisions=1).geometry
    apart = surfaces.join([ball, ball.with_points(ball.points + [90.0, 0, 0])])
    np.savez(
        tmp_path / "pool.npz",
        V=np.concatenate([ball.points, apart.points]).astype(np.float16),
        F=np.concatenate([ball.faces, apart.faces]).astype(np.uint16),
        voff=[0, ball.n, ball.n + apart.n],
        foff=[0, len(ball.faces), len(ball.faces) + len(apart.faces)],
        ids=["a", "b"],
        split="train",
    )
    config = replace(TINY, n_points=200, nonuniform=0.0, pool=tmp_path / "pool.npz", pool_share=1.0)
    counts = generate(tmp_path / "corpus", 6, config=config)
    labels = open_shards(tmp_path / "corpus").labels
    assert not labels["pool"].any()  # only the ball in one piece
    assert counts.rejected["components"] == labels["rejected_components"].sum() > 0
    assert counts.rejected["mesh"] == counts.rejected["solve"] == 0
    assert counts.families["pool"] == counts.samples == 6


def test_meshes_are_varied_and_fit_the_unit_box_before(pool):
    mesh = open_pool(pool, "train").mesh(1)
    areas = [varied(mesh, np.random.default_rng(seed)).area for seed in range(20)]
    for seed in range(4):  # long edges are halved, but not of samples that are meshes
        split, kept = (varied(mesh, np.random.default_rng(seed), own_vertices=b) for b in (0, 1))
        assert kept.n == mesh.n < split.n
    unit = varied(mesh.with_points(100 * mesh.points), np.random.default_rng(0))
    np.testing.assert_allclose(unit.area, areas[0], rtol=1e-6)
    plain = np.isclose(areas, mesh.area, rtol=1e-2)
    assert 0 < plain.sum() < 15  # three of ten stay as they are


def test_sample_lies_on_its_mesh(pool):
    for made_of in (of_pool(pool), TINY):
        sample = make_sample(made_of, 1)
        again = sample_mesh(made_of, sample.label(0))
        points = sample.points[0].astype(np.float64)
        # Both in the frame of their principal axes: the same extents, up to sampling.
        size = np.linalg.svd(points - points.mean(0), compute_uv=False) / np.sqrt(len(points))
        dense = again.points[again.faces].mean(axis=1)
        weights = np.sqrt(again.face_areas / again.face_areas.sum())[:, None]
        truth = np.linalg.svd(weights * (dense - (weights**2 * dense).sum(0)), compute_uv=False)
        np.testing.assert_allclose(size / size[0], truth / truth[0], atol=0.15)


def test_bad_pools_are_refused(pool, tmp_path):
    (tmp_path / "text.npz").write_text("no")
    np.savez(tmp_path / "half.npz", V=np.zeros((1, 3)))
    for told, call, *arguments in (
        (r"must hold chunks pool_\*.npz and a manifest", open_pool, tmp_path, "train"),
        (r"text.npz: not a whole mesh pool", open_pool, tmp_path / "text.npz", "train"),
        (r"without \['F', 'voff', 'foff', 'ids'\]", open_pool, tmp_path / "half.npz", "train"),
        ("are in, got 'test'", open_pool, pool, "test"),
        (r"`target` must end in \.npz", pack_pool, pool, tmp_path / "small.bin", "train"),
        (r"`index` must be in \[0, 2\], got 3", open_pool(pool, "train").mesh, 3),
    ):
        with pytest.raises(InvalidInputError, match=told):
            call(*arguments)


# What a corpus is like


def test_topology_of_known_surfaces():
    ball, ring = sphere(subdivisions=2).geometry, torus(n=400).geometry
    assert topology(ball) == Topology(parts=1, closed=True, boundary=False, genus=0)
    both = surfaces.join([ball, ring.with_points(ring.points + 9.0)])
    assert topology(both) == Topology(parts=2, closed=True, boundary=False, genus=1)
    assert topology(rectangle(n=100).geometry) == Topology(1, False, True, None)
    # Poles of many coincident corners are closed, and so are unwelded triangles.
    assert topology(surfaces.superquadric((0.3, 0.3), [1, 1, 1])).genus == 0
    soup = np.arange(ball.faces.size).reshape(-1, 3)
    assert topology(TriangleMesh(ball.points[ball.faces].reshape(-1, 3), soup)) == topology(ball)
    fin = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]]
    fin = TriangleMesh(fin, [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    assert topology(fin) == Topology(1, False, True, None)


def test_survey_counts_and_measures(folder, tmp_path):
    assert read_config(folder) == TINY
    facts = survey(open_shards(folder), TINY, [5, 2, 0, 1])
    assert (facts["samples"], facts["surveyed"]) == (10, 4)
    assert json.loads(json.dumps(facts)) == facts
    found = [topology(sample_mesh(TINY, make_sample(TINY, i).label(0))) for i in (5, 2, 0, 1)]
    assert facts["genus"] == Counter(str(t.genus) for t in found if t.genus is not None)
    assert facts["closed"] == np.mean([t.closed for t in found])
    laplacian = robust_laplacian(PointCloud(make_sample(TINY, 2).points[0]))
    values = eigensolve(laplacian, 6, Arpack()).eigenvalues * laplacian.area
    one = survey(open_shards(folder), TINY, [2])
    assert one["lambda_1_area"]["median"] == pytest.approx(values[1], rel=2e-3)
    assert one["weyl_ratio"]["mode 5"]["max"] == pytest.approx(values[5] / (20 * np.pi), rel=2e-3)
    stored = replace(TINY, seed=8).fingerprint() | {"format": 1}
    (tmp_path / "corpus.json").write_text(json.dumps(stored))
    with pytest.raises(InvalidInputError, match=r"another configuration: \['format'\] differ"):
        read_config(tmp_path)


def test_the_app_draws_a_sheet_with_the_edges_of_meshes_and_a_table(tmp_path, capsys):
    made = tmp_path / "corpus"
    generate(made, 4, config=CorpusConfig(seed=3, n_points=200, k=8, mesh_share=0.5))
    meshes = open_shards(made).labels["mesh"] == 1
    sheet, black = tmp_path / "sheet.png", []
    for only in (np.flatnonzero(meshes), np.flatnonzero(~meshes)):
        argv = [str(made), str(sheet), "--surveyed", "1", "--only", *map(str, only)]
        code = inspect_corpus.main(argv)
        out, err = capsys.readouterr()
        if "OpenGL" in err:
            pytest.skip("no OpenGL library on this machine")
        assert code == 0, err
        assert "4 samples" in out
        with Image.open(sheet) as picture:
            grey = np.asarray(picture.convert("L"))
        assert 0.05 < (grey < 250).mean() < 0.9
        black.append((grey < 90).mean())
    assert black[0] > 3 * black[1], black
    facts = json.loads(sheet.with_suffix(".json").read_text())
    assert (facts["samples"], facts["surveyed"], facts["meshes"]) == (4, 1, meshes.mean())
    assert inspect_corpus.main([str(tmp_path / "nothing"), str(sheet)]) == 2
    assert "must hold a corpus" in capsys.readouterr().err
    assert inspect_corpus.main([str(made), str(sheet), "--only", "3", "10"]) == 2
    assert "indices of the 4 samples, got [10]" in capsys.readouterr().err
