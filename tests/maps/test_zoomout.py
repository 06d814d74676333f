"""Refinement of maps: copies are matched exactly, poses nearly, and every variant does its part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import creature, refused
from scipy.spatial.distance import cdist

from spectra_kit import InvalidInputError, Spectrum, TriangleMesh, robust_laplacian
from spectra_kit.eigen import eigensolve
from spectra_kit.maps import (
    Correspondence,
    Truth,
    bijective_zoomout,
    functional_map_from_point_map,
    geodesic_errors,
    icp,
    zoomout,
    zoomout_many,
)

N, K = 700, 60
SAME = np.arange(N)


def solved(mesh: TriangleMesh) -> Spectrum:
    return eigensolve(robust_laplacian(mesh), K)


@pytest.fixture(scope="module")
def spectrum() -> Spectrum:
    return solved(creature(N))


@pytest.fixture(scope="module")
def shuffle() -> np.ndarray:
    return np.random.default_rng(0).permutation(N)


@pytest.fixture(scope="module")
def copy(shuffle) -> Spectrum:
    """The animal in millimetres, its points in another order; solved anew, so of other signs."""
    mesh = creature(N)
    return solved(TriangleMesh(1000 * mesh.points[shuffle], np.argsort(shuffle)[mesh.faces]))


@pytest.fixture(scope="module")
def bent() -> Spectrum:
    """The same animal in another pose: point i corresponds to point i."""
    return solved(creature(N, pose=1))


@pytest.mark.parametrize(
    "options", [{}, {"step": 11, "samples": 500}, {"device": "cpu:0", "samples": 500}], ids=str
)
def test_a_copy_gives_the_permutation(spectrum, copy, shuffle, options) -> None:
    start = functional_map_from_point_map(spectrum, copy, shuffle, k=(14, 9))
    found = zoomout(spectrum, copy, start, k_final=K, **options)
    assert (found.point_map == shuffle).all()
    assert not found.functional_map.flags.writeable
    expected = functional_map_from_point_map(spectrum, copy, shuffle)
    assert found.functional_map == pytest.approx(expected, abs=1e-12)
    # A point map that is wrong at two of five points will do, and nothing need be added.
    rng = np.random.default_rng(1)
    noisy = np.where(rng.random(N) < 0.4, rng.integers(N, size=N), shuffle)
    assert (zoomout(spectrum, copy, noisy, k_final=K, **options).point_map == shuffle).all()
    assert (zoomout(spectrum, copy, expected, k_final=K, **options).point_map == shuffle).all()


def test_both_ways_and_icp_give_the_permutation_of_a_copy(spectrum, copy, shuffle) -> None:
    start = functional_map_from_point_map(spectrum, copy, shuffle, k=(14, 9))
    for C, step in ((start, 20), (functional_map_from_point_map(spectrum, copy, shuffle), 5)):
        found = bijective_zoomout(spectrum, copy, C, k_final=K, step=step)
        assert (found.point_map == shuffle).all()
        assert found.functional_map.shape == (K, K)
    few, many = (icp(spectrum, copy, C[:50, :50], iterations=i) for i in (1, 1000))
    assert (few.point_map == many.point_map).all()  # it stops at a fixed point
    assert (few.point_map == shuffle).all()
    assert few.functional_map.shape == (50, 50)


def test_steps_are_those_of_the_definition(spectrum, bent) -> None:
    """Of Melzi et al.: the nearest rows of the map, projected onto the modes of the next size."""

    def point_map(C):
        return icp(spectrum, bent, C, iterations=0).point_map

    start = functional_map_from_point_map(spectrum, bent, SAME, k=10)
    for k_start, sizes in ((None, (13,)), (6, (11, 14))):
        C = start[:k_start, :k_start]
        for k in sizes:
            C = functional_map_from_point_map(spectrum, bent, point_map(C), k=k)
        found = zoomout(spectrum, bent, start, k_final=sizes[-1], k_start=k_start)
        assert (found.point_map == point_map(C)).mean() > 0.99
    # Both ways: the mean of the map of one and the transpose of the other's.
    there = functional_map_from_point_map(spectrum, bent, point_map(start), k=13)
    way_back = icp(bent, spectrum, start.T, iterations=0).point_map
    back = functional_map_from_point_map(bent, spectrum, way_back, k=13)
    both = bijective_zoomout(spectrum, bent, start, k_final=13)
    assert (both.point_map == point_map((there + back.T) / 2)).mean() > 0.99
    assert (both.point_map != point_map(there)).mean() > 0.01
    ends = [
        zoomout(spectrum, bent, point_map(start), k_final=15, **k).point_map
        for k in ({}, {"k_start": 15}, {"k_start": 4})
    ]
    assert (ends[0] == ends[1]).all()  # with 20 modes, or as many as there are
    assert (ends[0] != ends[2]).any()


def mean_error(found: Correspondence) -> float:
    return float(geodesic_errors(creature(N), found.point_map, Truth.of_map(SAME)).mean())


def test_poses_are_matched(spectrum, bent) -> None:
    """From the true map of 10 modes: ZoomOut, in each variant, undoes the bend; ICP does not."""
    start = functional_map_from_point_map(spectrum, bent, SAME, k=10)
    assert min(mean_error(icp(spectrum, bent, start, iterations=i)) for i in (0, 10)) > 2
    assert mean_error(zoomout(spectrum, bent, start, k_final=K)) < 0.1
    assert mean_error(zoomout(spectrum, bent, start, k_final=K, samples=400)) < 0.1
    assert mean_error(bijective_zoomout(spectrum, bent, start, k_final=K)) < 0.1


def test_features_steer_where_the_modes_cannot_tell(spectrum, bent) -> None:
    """Coordinates known at rest, and with noise in the pose, make a few modes enough."""
    points = creature(N).points
    start = functional_map_from_point_map(spectrum, bent, SAME, k=6)
    known = (points - points.mean(axis=0)) / points.std(axis=0)
    noisy = known + 0.05 * np.random.default_rng(9).normal(size=known.shape)
    plain, nothing, steered = (
        bijective_zoomout(spectrum, bent, start, k_final=12, features=f)
        for f in (None, (0 * known, 0 * noisy), (3 * known, 3 * noisy))
    )
    assert (plain.point_map == nothing.point_map).all()
    assert mean_error(steered) < 0.5 * mean_error(plain)


def test_given_samples_and_seeds_decide(spectrum, bent) -> None:
    start = functional_map_from_point_map(spectrum, bent, SAME, k=10)
    some = np.random.default_rng(0)
    drawn = np.sort(some.choice(N, 300, replace=False)), np.sort(some.choice(N, 300, replace=False))
    first, again, other, given = (
        zoomout(spectrum, bent, start, k_final=30, **options).functional_map
        for options in (
            {"samples": 300}, {"samples": 300, "seed": 0}, {"samples": 300, "seed": 1},
            {"samples": drawn},
        )
    )  # fmt: skip
    assert (first == again).all()
    assert (first != other).any()
    assert (first == given).all()
    assert zoomout(spectrum, bent, start, k_final=30, samples=10**6).point_map.shape == (N,)


def test_many_candidates_go_the_way_of_one(spectrum, bent) -> None:
    rng = np.random.default_rng(6)
    some = rng.choice(N, 200, replace=False)
    rows = [s.rescale(s.area**-0.5).eigenvectors[some] for s in (spectrum, bent)]
    right = functional_map_from_point_map(spectrum, bent, SAME, k=8)
    signs = np.where(rng.random((5, 8)) < 0.5, -1.0, 1.0)
    maps = np.concatenate([right[None], right * signs[:, None]])
    refined, point_maps = zoomout_many(*rows, maps, k_final=30)
    assert refined.shape == (6, 30, 30)
    assert (point_maps[0] == np.arange(200)).mean() > 0.9
    for i in (0, 4):
        one, one_map = zoomout_many(*rows, maps[i : i + 1], k_final=30)
        assert (one_map[0] == point_maps[i]).all()
        assert one[0] == pytest.approx(refined[i], abs=1e-9)
    # The squared distances left over tell the right candidate from the others.
    left = [
        np.square(rows[1][:, :30] - rows[0][p, :30] @ C.T).sum()
        for C, p in zip(refined, point_maps, strict=True)
    ]
    assert np.argmin(left) == 0
    # A map of the last size already sends each point to the nearest image, as float64 has it.
    C = rng.standard_normal((3, 3))
    source, target = rows[0][:, :3], rows[1][:, :3]
    [to] = zoomout_many(source, target, C[None], k_final=3)[1]
    apart = cdist(target, source @ C.T)
    assert apart[np.arange(200), to] == pytest.approx(apart.min(axis=1), abs=1e-5)


def test_what_cannot_be_refined_is_refused(spectrum, bent) -> None:
    C, ones = np.eye(10), np.ones((N, 1))
    two = Spectrum(np.array([0.0, 0.0, *bent.eigenvalues[2:]]), bent.eigenvectors, bent.mass)
    for argument, expected, options in (
        ("k_final", "be at least 1", {"k_final": 0}),
        ("k_final", "be at least the size of `initial`", {"k_final": 9}),
        ("step", "be at least", {"step": 0}),
        ("initial", "be in [0,", {"initial": np.full(N, N)}),
        ("k_start", "be in [1, 10]", {"k_start": 11}),
        ("k_start", "be in [1, 20]", {"initial": SAME, "k_start": 21}),
        ("initial", "be finite", {"initial": C * np.nan}),
        ("source` and `target", "have the same number of components", {"target": two}),
        ("source` and `target", "both be of surfaces", {"target": replace(bent, dimension=3)}),
        ("k_final", "be at most 15, got 20: the source has 60", {"target": bent.truncate(15)}),
    ):
        for refine in (zoomout, bijective_zoomout):
            given = {"source": spectrum, "target": bent, "initial": C, "k_final": 20, **options}
            refused(argument, expected, refine, **given)
    for argument, expected, features in (
        ("features", "be two arrays of shapes", (np.ones((N, 2)), np.ones((N, 3)))),
        ("features", "be two arrays of shapes", (np.ones(N), ones)),
        ("features", "be two arrays of shapes", (np.ones((2, 1)), ones)),
        ("features[1]", "be finite", (ones, np.nan * ones)),
    ):
        refused(argument, expected, bijective_zoomout, spectrum, bent, C, k_final=20,
                features=features)  # fmt: skip
    for argument, expected, samples in (
        ("samples", "be at least 20, got 19", 19),
        ("samples[0]", "be a non-empty list of indices", ([], range(30))),
        ("samples[1]", "be a non-empty list of indices", (range(30), np.ones((2, 15), int))),
        ("samples[0]", "be in [0,", ([N], range(30))),
        ("samples[1]", "hold at least `k_final` = 20 distinct", (range(30), [3] * 30)),
    ):
        refused(argument, expected, zoomout, spectrum, bent, C, k_final=20, samples=samples)
    with pytest.raises(InvalidInputError, match=r"`samples` must be a number, or two arrays"):
        zoomout(spectrum, bent, C, k_final=20, samples=np.arange(30))
    refused("source` and `target", "have the same number", icp, spectrum, two, C)
    refused("functional_map", "have shape", icp, spectrum, bent, np.eye(81))
    refused("iterations", "be at least", icp, spectrum, bent, C, iterations=-1)
    rows, maps = np.random.default_rng(7).normal(size=(30, 12)), np.eye(4)[None]
    for argument, expected, given, k_final in (
        ("target_rows", "have at least", (rows, rows[:, :11], maps), 12),
        ("target_rows", "hold at least", (rows, rows[:11], maps), 12),
        ("maps", "have shape (c,", (rows, rows, maps[0]), 12),
        ("maps", "have shape (c, k2, k1) with k1 and k2 in [1, 3]", (rows, rows, maps), 3),
        ("maps", "be finite", (rows, rows, np.full((1, 4, 4), np.inf)), 12),
    ):
        refused(argument, expected, zoomout_many, *given, k_final=k_final)
