"""Refinement of maps: copies are matched exactly, poses nearly, and every variant does its part."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import creature, refused
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from spectra_kit import (
    InvalidInputError,
    Spectrum,
    TriangleMesh,
    robust_laplacian,
)
from spectra_kit.eigensolvers import eigensolve
from spectra_kit.functional_maps import (
    bijective_zoomout,
    functional_map_from_point_map,
    icp,
    zoomout,
    zoomout_many,
)
from spectra_kit.functional_maps.zoomout import schedule

N, K = 1500, 80


def solved(mesh: TriangleMesh, k: int = K) -> Spectrum:
    return eigensolve(robust_laplacian(mesh), k)


@pytest.fixture(scope="module")
def mesh() -> TriangleMesh:
    return creature(N)


@pytest.fixture(scope="module")
def spectrum(mesh) -> Spectrum:
    return solved(mesh)


@pytest.fixture(scope="module")
def shuffle() -> np.ndarray:
    return np.random.default_rng(0).permutation(N)


@pytest.fixture(scope="module")
def copy(mesh, shuffle) -> Spectrum:
    """The animal in millimetres, its points in another order; solved anew, so of other signs."""
    faces = np.argsort(shuffle)[mesh.faces]
    return solved(TriangleMesh(1000 * mesh.points[shuffle], faces))


@pytest.fixture(scope="module")
def bent() -> Spectrum:
    """The same animal in another pose: point i corresponds to point i."""
    return solved(creature(N, pose=1))


@pytest.fixture(scope="module")
def distances(mesh) -> np.ndarray:
    """Distances along the edges of the animal at rest / sqrt(area)."""
    i, j = mesh.edges.T
    lengths = np.linalg.norm(mesh.points[i] - mesh.points[j], axis=1)
    graph = (
        coo_array((lengths, (i, j)), shape=(N, N))
        .tocsr()
        .maximum(coo_array((lengths, (j, i)), shape=(N, N)).tocsr())
    )
    return dijkstra(graph) / np.sqrt(mesh.area)


def true_map(source: Spectrum, target: Spectrum, point_map: np.ndarray, k: int) -> np.ndarray:
    return functional_map_from_point_map(source, target, point_map, k=k)


@pytest.mark.parametrize(
    "options",
    [{}, {"step": 11}, {"samples": 900}, {"device": "cpu:0"}, {"device": "cpu:0", "samples": 900}],
    ids=str,
)
def test_a_copy_gives_the_permutation(spectrum, copy, shuffle, options) -> None:
    start = true_map(spectrum, copy, shuffle, 8)
    found = zoomout(spectrum, copy, start, k_final=K, **options)
    assert (found.point_map == shuffle).all()
    assert found.functional_map == pytest.approx(true_map(spectrum, copy, shuffle, K), abs=1e-12)


def test_a_start_may_be_cut(spectrum, bent) -> None:
    start = true_map(spectrum, bent, np.arange(N), 10)
    cut = zoomout(spectrum, bent, start, k_final=20, k_start=6)
    assert (cut.point_map == zoomout(spectrum, bent, start[:6, :6], k_final=20).point_map).all()


def test_both_ways_give_the_permutation_of_a_copy(spectrum, copy, shuffle) -> None:
    start = true_map(spectrum, copy, shuffle, 8)
    assert (bijective_zoomout(spectrum, copy, start, k_final=K, step=20).point_map == shuffle).all()


def test_a_noisy_point_map_is_repaired(spectrum, copy, shuffle) -> None:
    rng = np.random.default_rng(1)
    noisy = np.where(rng.random(N) < 0.4, rng.integers(N, size=N), shuffle)
    for options in ({}, {"k_start": 12}, {"samples": 600}):
        found = zoomout(spectrum, copy, noisy, k_final=K, **options)
        assert (found.point_map == shuffle).all()


def test_poses_are_matched_within_an_edge(mesh, spectrum, bent, distances) -> None:
    """From the true map of 10 modes: ZoomOut, in each variant, undoes the bend; ICP does not."""
    truth = np.arange(N)
    start = true_map(spectrum, bent, truth, 10)
    found = {
        "start": icp(spectrum, bent, start, iterations=0),
        "icp": icp(spectrum, bent, start),
        "zoomout": zoomout(spectrum, bent, start, k_final=K),
        "samples": zoomout(spectrum, bent, start, k_final=K, samples=700),
        "bijective": bijective_zoomout(spectrum, bent, start, k_final=K),
    }
    error = {name: distances[truth, it.point_map].mean() for name, it in found.items()}
    edge = np.linalg.norm(np.diff(mesh.points[mesh.edges], axis=1), axis=2).mean()
    edge /= np.sqrt(mesh.area)
    assert error["start"] > edge < error["icp"]
    assert max(error[n] for n in ("zoomout", "samples", "bijective")) < 0.1 * edge


def test_features_steer_where_the_modes_cannot_tell(mesh, spectrum, bent, distances) -> None:
    """Coordinates known at rest, and with noise in the pose, make a few modes enough."""
    truth = np.arange(N)
    start = true_map(spectrum, bent, truth, 6)
    known = (mesh.points - mesh.points.mean(axis=0)) / mesh.points.std(axis=0)
    noisy = known + 0.05 * np.random.default_rng(9).normal(size=known.shape)
    errors = [
        distances[truth, bijective_zoomout(spectrum, bent, start, k_final=12, features=f).point_map]
        for f in (None, (0 * known, 0 * noisy), (3 * known, 3 * noisy))
    ]
    assert (errors[0] == errors[1]).all()
    assert errors[2].mean() < 0.5 * errors[0].mean()


FEATURES = {
    r"shapes \(1500, p\) and \(1500, p\).* got \(1500, 2\) and \(1500, 3\)": (
        np.ones((N, 2)),
        np.ones((N, 3)),
    ),
    r"got \(1500,\) and \(1500, 1\)": (np.ones(N), np.ones((N, 1))),
    r"got \(2, 1\) and \(1500, 1\)": (np.ones((2, 1)), np.ones((N, 1))),
    r"`features\[1\]` must be finite": (np.ones((N, 1)), np.full((N, 1), np.nan)),
}


@pytest.mark.parametrize("message", FEATURES)
def test_features_must_fit(spectrum, bent, message) -> None:
    with pytest.raises(InvalidInputError, match=message):
        bijective_zoomout(spectrum, bent, np.eye(5), k_final=6, features=FEATURES[message])


def test_icp_stops_at_a_fixed_point(spectrum, copy, shuffle) -> None:
    start = true_map(spectrum, copy, shuffle, 60)
    few, many = (icp(spectrum, copy, start, iterations=i) for i in (1, 1000))
    assert (few.point_map == many.point_map).all()
    assert (few.point_map == shuffle).all()
    assert few.functional_map.shape == (60, 60)


def test_sizes_grow_by_the_step_and_end_together() -> None:
    assert schedule((4, 8), 20, 5) == [(13, 9), (18, 14), (20, 19), (20, 20)]
    assert schedule((20, 20), 20, 5) == []
    assert schedule((1, 1), 3, 1) == [(2, 2), (3, 3)]


def test_rectangular_starts_are_welcome(spectrum, copy, shuffle) -> None:
    C = functional_map_from_point_map(spectrum, copy, shuffle, k=(14, 9))
    for refine in (zoomout, bijective_zoomout):
        assert (refine(spectrum, copy, C, k_final=K).point_map == shuffle).all()


def test_nothing_to_add_converts_the_map(spectrum, copy, shuffle) -> None:
    C = true_map(spectrum, copy, shuffle, K)
    assert (zoomout(spectrum, copy, C, k_final=K).point_map == shuffle).all()
    assert (bijective_zoomout(spectrum, copy, C, k_final=K).point_map == shuffle).all()


def test_given_samples_and_seeds_decide(spectrum, bent) -> None:
    start = true_map(spectrum, bent, np.arange(N), 10)
    drawn = [
        zoomout(spectrum, bent, start, k_final=30, samples=300, seed=s).functional_map
        for s in (0, 0, 1)
    ]
    assert (drawn[0] == drawn[1]).all()
    assert (drawn[0] != drawn[2]).any()
    some = np.arange(0, N, 4)
    given = zoomout(spectrum, bent, start, k_final=30, samples=(some, some)).functional_map
    assert np.abs(given - drawn[0]).max() < 0.5
    everything = zoomout(spectrum, bent, start, k_final=30, samples=10**6)
    assert everything.point_map.shape == (N,)


def test_many_candidates_go_the_way_of_one(spectrum, bent) -> None:
    rng = np.random.default_rng(6)
    some = rng.choice(N, 200, replace=False)
    rows = [s.rescale(s.area**-0.5).eigenvectors[some] for s in (spectrum, bent)]
    right = true_map(spectrum, bent, np.arange(N), 8)
    signs = np.where(rng.random((5, 8)) < 0.5, -1.0, 1.0)
    maps = np.concatenate([right[None], right * signs[:, None]])
    refined, point_maps = zoomout_many(*rows, maps, k_final=30)
    assert refined.shape == (6, 30, 30)
    assert point_maps.shape == (6, 200)
    assert (point_maps[0] == np.arange(200)).mean() > 0.9
    for i in range(6):
        one, one_map = zoomout_many(*rows, maps[i : i + 1], k_final=30)
        assert (one_map[0] == point_maps[i]).all()
        assert one[0] == pytest.approx(refined[i], abs=1e-9)
    # The squared distances left over tell the right candidate from the others.
    left = [
        np.square(rows[1][:, :30] - rows[0][p, :30] @ C.T).sum()
        for C, p in zip(refined, point_maps, strict=True)
    ]
    assert np.argmin(left) == 0


def test_what_cannot_be_refined_is_refused(spectrum, bent) -> None:
    C = np.eye(10)
    few = bent.truncate(30)
    two = Spectrum(np.array([0.0, 0.0, *bent.eigenvalues[2:]]), bent.eigenvectors, bent.mass)
    for refine in (zoomout, bijective_zoomout):
        with pytest.raises(InvalidInputError, match=r"at most 30, got 60: .* 80 modes, .* 30;"):
            refine(spectrum, few, C, k_final=60)
        refused("k_final", "be at least", refine, spectrum, bent, C, k_final=0)
        with pytest.raises(InvalidInputError, match=r"of `initial`, \(10, 10\), got 9; end later"):
            refine(spectrum, bent, C, k_final=9)
        refused("step", "be at least", refine, spectrum, bent, C, k_final=20, step=0)
        with pytest.raises(InvalidInputError, match="same number of components, got 1 and 2 zero"):
            refine(spectrum, two, C, k_final=20)
        refused("initial", "be in [0,", refine, spectrum, bent, np.full(N, N), k_final=20)
        refused("k_start", "be in [1,", refine, spectrum, bent, C, k_final=20, k_start=11)
        with pytest.raises(InvalidInputError, match=r"`k_start` must be in \[1,"):
            refine(spectrum, bent, np.arange(N), k_final=20, k_start=21)
        refused("initial", "be finite", refine, spectrum, bent, C * np.nan, k_final=20)
    with pytest.raises(InvalidInputError, match="same number of components"):
        icp(spectrum, two, C)
    refused("functional_map", "have shape", icp, spectrum, bent, np.eye(81))
    refused("iterations", "be at least", icp, spectrum, bent, C, iterations=-1)


def test_a_device_that_is_not_there_is_refused(spectrum, bent) -> None:
    with pytest.raises(InvalidInputError, match=r"`device` .* got 'quantum' \(.*\); try 'cpu'"):
        zoomout(spectrum, bent, np.eye(5), k_final=6, device="quantum")


SAMPLES = {
    "`samples` must be at least 20, got 19": 19,
    r"`samples` must be a number, or two arrays .* got a ndarray": np.arange(30),
    r"`samples\[0\]` must be a non-empty list of indices, got shape \(0,\)": ([], range(30)),
    r"`samples\[1\]` must be a non-empty list of indices, got shape \(2, 15\)": (
        range(30),
        np.arange(30).reshape(2, 15),
    ),
    r"`samples\[0\]` must be in \[0, 1500\), got 1500": ([N], range(30)),
    r"`samples\[1\]` must hold at least `k_final` = 20 distinct points, got 1": (
        range(30),
        [3] * 30,
    ),
}


@pytest.mark.parametrize("message", SAMPLES)
def test_samples_must_fit(spectrum, bent, message) -> None:
    with pytest.raises(InvalidInputError, match=message):
        zoomout(spectrum, bent, np.eye(5), k_final=20, samples=SAMPLES[message])


def test_candidates_must_fit() -> None:
    rows, maps = np.random.default_rng(7).normal(size=(30, 12)), np.eye(4)[None]
    refused("target_rows", "have at least", zoomout_many, rows, rows[:, :11], maps, k_final=12)
    refused("target_rows", "hold at least", zoomout_many, rows, rows[:11], maps, k_final=12)
    refused("maps", "have shape (c,", zoomout_many, rows, rows, maps[0], k_final=12)
    with pytest.raises(InvalidInputError, match=r"k2 in \[1, 3\], got \(1, 4, 4\)"):
        zoomout_many(rows, rows, maps, k_final=3)
    refused("maps", "be finite", zoomout_many, rows, rows, np.full((1, 4, 4), np.inf), k_final=12)
