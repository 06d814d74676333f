"""Collections: cycles close, wrong pairs are overruled, strangers are named, work goes on."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache, partial
from itertools import combinations, permutations
from pathlib import Path

import numpy as np
import pytest
from conftest import creature, refused
from test_match import QUICK

from spectra_kit import InvalidInputError, spectrum
from spectra_kit.errors import DoubtfulMatchWarning, InvalidFileError
from spectra_kit.geometry import TriangleMesh, mirrored, permuted, torus
from spectra_kit.maps import (
    Collection,
    Prepared,
    Truth,
    functional_map_from_point_map,
    geodesic_errors,
    match_collection,
    prepare,
    score_map,
)
from spectra_kit.maps.calibration import confidence_of
from spectra_kit.maps.synchronise import Clusters, Found, apart, graph, groups

K = 60
POSES = ("1", "2", "3")
matched_together = partial(match_collection, options=QUICK)


def prepared(mesh: TriangleMesh) -> Prepared:
    return prepare(spectrum(mesh, K), mesh)


@cache
def pose(name: str) -> tuple[TriangleMesh, np.ndarray]:
    """One animal in a pose, its points shuffled, and where each of them was."""
    mesh, order = permuted(creature(600, pose=int(name)), seed=int(name))
    return mesh, np.asarray(order)


@cache
def poses() -> dict[str, Prepared]:
    return {name: prepared(pose(name)[0]) for name in POSES}


@cache
def truth(source: str, target: str) -> np.ndarray:
    """The source point of each target point."""
    return np.argsort(pose(source)[1])[pose(target)[1]]


def error(source: str, target: str, point_map: np.ndarray) -> float:
    """In hundredths of the root of the area."""
    goal = Truth.of_map(truth(source, target))
    return float(geodesic_errors(pose(source)[0], point_map, goal).mean())


@pytest.fixture(scope="module")
def stranger() -> Prepared:
    return prepared(torus(n=700).geometry)


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    """Folder of pairs that are matched already."""
    return tmp_path_factory.mktemp("pairs")


@pytest.fixture(scope="module")
def collection(stranger, kept) -> Collection:
    return matched_together({"ring": stranger, **poses()}, folder=kept)


# --- one animal in some poses, and a ring ----------------------------------------------------


def test_every_pair_is_right_and_cycles_close(collection) -> None:
    maps = {pair: collection.pair(*pair) for pair in permutations(POSES, 2)}
    assert max(error(*pair, one.point_map) for pair, one in maps.items()) < 1
    assert not any(one.mirrored for one in maps.values())
    for i, j, k in combinations(POSES, 3):  # where a point of i comes from, by way of k and j
        way = maps[k, i].point_map
        around = maps[i, j].point_map[maps[j, k].point_map[way]]
        same = Truth.of_map(np.arange(len(way)))
        assert geodesic_errors(pose(i)[0], around, same).mean() < 1


def test_implied_maps_compose_exactly(collection) -> None:
    Y = collection.frames
    eye = np.eye(Y.shape[1])
    assert Y.shape[0] == 4
    assert Y @ Y.transpose(0, 2, 1) == pytest.approx(np.broadcast_to(eye, Y.shape), abs=1e-9)
    there, on, back = Y[2] @ Y[1].T, Y[3] @ Y[2].T, Y[1] @ Y[3].T
    assert back @ on @ there == pytest.approx(eye, abs=1e-9)


def test_a_stranger_is_named_and_its_maps_are_doubtful(collection) -> None:
    assert collection.foreign == ("ring",)
    assert collection.groups == (POSES, ("ring",))
    errors = collection.cycle_errors
    assert set(errors) == {"ring", *POSES}
    assert max(errors[name] for name in POSES) < 0.01 < errors["ring"]
    assert "foreign: ring" in repr(collection)
    with pytest.warns(DoubtfulMatchWarning, match="unconnected"):
        found = collection.pair("ring", "1", elastic=False)
    assert found.unconnected
    assert not found.convincing
    assert not collection.pair("1", "3", elastic=False).unconnected


def test_what_no_convincing_pair_connects_is_doubtful_however_good(collection) -> None:
    loose = replace(collection, groups=(("1", "2"), ("3",), ("ring",)))
    with pytest.warns(DoubtfulMatchWarning, match="unconnected"):
        found = loose.pair("1", "3", elastic=False)
    assert found.doubts == ("unconnected",)
    assert not found.convincing
    assert found.confidence == collection.pair("1", "3", elastic=False).confidence / 2 <= 0.5


@pytest.mark.slow
def test_a_stranger_moves_nothing(collection, kept) -> None:
    alone = matched_together(poses(), folder=kept)
    for pair in combinations(POSES, 2):
        ours, theirs = collection.candidate(*pair), alone.candidate(*pair)
        assert float(apart(ours.functional_map, theirs.functional_map)) < 1e-3


def test_a_map_without_a_rival_is_no_surer_for_it(collection) -> None:
    one = collection.pair("1", "2", elastic=False)
    assert one.margin == np.inf
    facts = {"score": one.score, "discontinuity": one.discontinuity, "coverage": one.coverage}
    assert one.confidence == confidence_of(**facts, margin=1.0)


def test_pairs_tell_what_they_were_by_themselves(collection) -> None:
    for one in collection.pairs:
        assert one.convincing == ("ring" not in (one.source, one.target))
        if one.convincing:  # grown both ways, it fits no worse than what the pair had found
            assert one.score <= 1.01 * one.score_alone


def test_a_copy_of_a_collection_is_one(collection) -> None:
    copy = pickle.loads(pickle.dumps(collection))
    assert copy.pair("1", "2", elastic=False).point_map.tolist() == (
        collection.pair("1", "2", elastic=False).point_map.tolist()
    )
    with pytest.raises(ValueError, match="read-only"):
        copy.frames[0] = 0


# --- what it does not depend on ---------------------------------------------------------------


def test_units_and_numbers_of_modes_may_differ() -> None:
    other = pose("2")[0].with_points(25.4 * pose("2")[0].points)
    more = prepare(spectrum(other, K + 15), other)
    found = matched_together({"1": poses()["1"], "2": more})
    assert {shape.spectrum.k for shape in found.shapes.values()} == {K}
    assert error("1", "2", found.pair("1", "2").point_map) < 1
    assert found.pair("1", "2", k=30).functional_map.shape == (30, 30)


def test_without_geometries_spectra_alone_are_matched() -> None:
    mesh = creature(600)
    copies, truths = zip(*(permuted(mesh, seed=i) for i in range(3)), strict=True)
    found = matched_together({str(i): prepare(spectrum(m, K)) for i, m in enumerate(copies)})
    for i, j in permutations(range(3), 2):
        right = np.argsort(truths[i])[truths[j]]
        assert (found.pair(str(i), str(j)).point_map == right).all()


def test_a_mirror_image_is_seen_as_one() -> None:
    image = prepared(mirrored(pose("1")[0]))
    found = matched_together({"1": poses()["1"], "2": poses()["2"], "image": image})
    assert found.mirrored.tolist() in ([False, False, True], [True, True, False])
    one = found.pair("2", "image")
    assert one.mirrored
    assert error("2", "1", one.point_map) < 1
    upright = matched_together({"1": poses()["1"], "image": image}, mirrored=False)
    assert not upright.mirrored.any()


# --- wrong pairs ------------------------------------------------------------------------------


def test_wrong_pairs_are_overruled_by_the_others() -> None:
    """One pair has nothing but wrong maps, and of all others the wrong one comes first."""
    names = (*POSES, "4")
    shapes = [*poses().values(), prepared(pose("4")[0])]
    rng = np.random.default_rng(0)
    right = {
        (i, j): functional_map_from_point_map(
            shapes[i].spectrum, shapes[j].spectrum, truth(names[i], names[j]), k=K
        )
        for i, j in combinations(range(4), 2)
    }
    flips = np.where(rng.random((2, K)) < 0.5, -1.0, 1.0)
    flips[:, 0] = 1

    def matched(i: int, j: int) -> Found:
        C = right[i, j]
        maps = [flip[:, None] * C for flip in flips] + ([C] if (i, j) != (1, 3) else [])
        scores = [score_map(shapes[i], shapes[j], one).score for one in maps]
        if (i, j) != (1, 3):  # claims that do not hold
            scores[0] = 0.9 * min(scores)
        return Found(np.array(maps), np.array(scores), np.zeros(len(maps)), convincing=True)

    told = list[int]()
    near = 1.0 - np.eye(4)
    frames = Clusters(shapes, near, matched, QUICK).joined(3, told.append)
    assert set(frames.found) == set(right)
    assert told == [2, 3, 4]
    for (i, j), C in right.items():
        implied = frames.maps[j] @ frames.maps[i].T
        assert float(apart(implied, C)) < 0.1 < float(apart(matched(i, j).maps[0], C))


# --- which pairs ------------------------------------------------------------------------------


def test_few_pairs_are_matched_and_all_are_connected() -> None:
    points = np.random.default_rng(1).random((50, 2))
    points[25:] += 10  # far from the others
    apart_ = np.linalg.norm(points[:, None] - points, axis=2)
    pairs = graph(apart_, 3)
    assert len(pairs) <= 3 * 50 + 49
    assert all(i < j for i, j in pairs)
    for i, row in enumerate(apart_):
        nearest = [j for j in np.argsort(row) if j != i][:3]
        assert all((min(i, j), max(i, j)) in pairs for j in nearest)
    found = dict.fromkeys(pairs, Found(*(np.empty(0),) * 3, convincing=True))
    assert set(groups(50, found)) == {0}


def test_equal_surfaces_are_connected_too() -> None:
    assert len(graph(np.zeros((4, 4)), 1)) >= 3


def test_convincing_pairs_make_groups() -> None:
    doubtful = Found(*(np.empty(0),) * 3, convincing=False)
    sure = doubtful._replace(convincing=True)
    label = groups(5, {(0, 3): sure, (1, 4): sure, (0, 1): doubtful, (2, 3): doubtful})
    assert label[0] == label[3] != label[1] == label[4] != label[2]
    assert len(set(groups(3, {}))) == 3


# --- interrupted ------------------------------------------------------------------------------


@pytest.mark.slow
def test_interrupted_it_goes_on_with_what_was_kept(collection, kept, tmp_path) -> None:
    folder, shapes = tmp_path / "pairs", poses()
    seen = list[tuple[int, int]]()

    def stop(done: int, total: int) -> None:
        seen.append((done, total))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        matched_together(shapes, folder=folder, progress=stop)
    assert seen == [(2, 3)]
    before = {file.name: file.stat().st_mtime_ns for file in folder.iterdir()}
    assert before
    found, again = (matched_together(shapes, folder=folder) for _ in range(2))
    assert {name: (folder / name).stat().st_mtime_ns for name in before} == before
    anew = matched_together(shapes, folder=kept)  # which were all found without a break
    assert (found.frames == anew.frames).all()
    assert (again.frames == anew.frames).all()
    assert found.pairs == anew.pairs
    # Another question is another file.
    matched_together({name: shapes[name] for name in POSES[:2]}, folder=folder, mirrored=False)
    assert len(list(folder.iterdir())) == len(found.pairs) + 1
    for file in folder.iterdir():
        file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(InvalidFileError, match="kept pair of a collection"):
        matched_together(shapes, folder=folder)


# --- refused ----------------------------------------------------------------------------------


def test_what_is_no_collection_is_refused(collection) -> None:
    one, two = poses()["1"], poses()["2"]
    blind = prepare(two.spectrum)
    for argument, expected, shapes, options in (
        ("shapes", "hold at least two surfaces, got 0", {}, {}),
        ("shapes", "hold at least two surfaces, got 1", {"1": one}, {}),
        (
            "shapes",
            "all have their geometry, or none, got none for '2'",
            {"1": one, "2": blind},
            {},
        ),
        ("mirrored", "be False or None", {"1": one, "2": two}, {"mirrored": True}),
        ("neighbours", "be at least 1", {"1": one, "2": two}, {"neighbours": 0}),
        ("folder", "be one, or not be there", {"1": one, "2": two}, {"folder": __file__}),
    ):
        refused(argument, expected, match_collection, shapes, **options)
    with pytest.raises(InvalidInputError, match="`shapes`"):
        match_collection([one, two])
    known = "be the name of a surface of the collection, got 'cat'"
    for method in (collection.pair, collection.candidate):
        refused("source", known, method, "cat", "1")
        refused("target", known, method, "1", "cat")
    refused("k", "be at least 30", collection.pair, "1", "2", k=29)
