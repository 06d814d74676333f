"""Matches: copies are found exactly, mirrors seen as mirrors, poses not flipped, doubt admitted."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import creature, refused

from spectra_kit import Spectrum, TriangleMesh, robust_laplacian
from spectra_kit.eigen import eigensolve
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.geometry import (
    Geometry,
    creature_pair,
    mirrored,
    permuted,
    rectangle,
    sphere,
    write,
)
from spectra_kit.maps import (
    Candidate,
    Match,
    MatchOptions,
    Prepared,
    Truth,
    coverage,
    functional_map_from_point_map,
    geodesic_errors,
    match,
    prepare,
)
from spectra_kit.maps.calibration import confidence_of
from spectra_kit.maps.surface import discontinuity

K = 100
# A search of fewer candidates: enough where the answer is clear.
QUICK = MatchOptions(orders=8, growing=32, turns=6, finalists=4)
TURN = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
TURN *= np.linalg.det(TURN)


@cache  # by identity: the fixtures below are prepared once
def prepared(geometry: Geometry, k: int = K) -> Prepared:
    return prepare(eigensolve(robust_laplacian(geometry), k), geometry)


def moved(geometry: Geometry, scale: float = 25.4) -> Geometry:
    """The same surface turned, and in another unit."""
    return geometry.with_points(scale * geometry.points @ TURN)


@pytest.fixture(scope="module")
def mesh() -> TriangleMesh:
    return creature(700)


@pytest.fixture(scope="module")
def spectrum(mesh) -> Spectrum:
    return eigensolve(robust_laplacian(mesh), K)


@pytest.fixture(scope="module")
def source(mesh, spectrum) -> Prepared:
    return prepare(spectrum, mesh)


# --- copies ---------------------------------------------------------------------------------


def test_a_copy_gives_the_permutation_in_every_process(mesh, spectrum, source) -> None:
    """Turned, in another unit and order, and solved anew; prepared, copied or neither."""
    shuffled, truth = permuted(mesh, seed=1)
    shuffled = moved(shuffled)
    target = eigensolve(robust_laplacian(shuffled), K)
    geometries = {"source_geometry": mesh, "target_geometry": shuffled}
    found, alone = match(spectrum, target, k=30, **geometries), match(spectrum, target)
    for one, k in ((found, 30), (alone, K)):
        assert (one.point_map == truth).all()
        C = functional_map_from_point_map(spectrum, target, truth, k=k)
        assert one.functional_map == pytest.approx(C, abs=1e-9)
        assert one.score == pytest.approx(1e-3, rel=1e-3)
        assert one.margin > 5
        assert not one.ambiguous
        assert not one.mirrored
    assert (found.orientation, alone.orientation) == (pytest.approx(1), None)
    assert {c.mirrored for c in found.candidates} == {False, True}
    again = match(pickle.loads(pickle.dumps(source)), prepare(target, shuffled), k=30)
    back = pickle.loads(pickle.dumps(found))
    assert not back.point_map.flags.writeable
    for other in (again, back):
        np.testing.assert_array_equal(other.functional_map, found.functional_map)
        assert (other.margin, other.orientation) == (found.margin, found.orientation)
        assert [c.score for c in other.candidates] == [c.score for c in found.candidates]


def test_meshes_and_files_are_prepared_by_the_way(mesh, tmp_path) -> None:
    """With 150 modes each."""
    write(mesh, tmp_path / "animal.ply")
    found = match(tmp_path / "animal.ply", mesh, k=60, options=QUICK)
    assert (found.point_map == np.arange(mesh.n)).all()
    assert found.functional_map.shape == (60, 60)
    made = prepare(mesh)
    assert made.spectrum.k == 150
    assert made.geometry is not None
    refused("geometry", "be left out where", prepare, mesh, mesh)


def test_scans_with_holes_have_an_outside(mesh) -> None:
    """However their faces are wound: a copy with all of them turned is no mirror image."""
    near = np.argsort(((mesh.points - mesh.points[0]) ** 2).sum(axis=1))[:12]
    kept = mesh.faces[~np.isin(mesh.faces, near).any(axis=1)]
    holed = TriangleMesh(mesh.points, kept).without_unreferenced()
    turned = TriangleMesh(holed.points, holed.faces[:, ::-1])
    found = match(prepared(holed, 60), prepared(turned, 60), elastic=False, options=QUICK)
    assert (found.point_map == np.arange(holed.n)).all()
    assert not found.mirrored


def test_a_rolled_sheet_matches_the_flat_one() -> None:
    """Its curvature varies, and that of the flat one does not: it must not be compared."""
    flat = rectangle(n=400).geometry
    x, y, _ = flat.points.T
    steps = np.linspace(0, x.max(), 2001)
    heading = 0.9 * steps + 0.6 * steps**2  # faster and faster, so that the curvature varies
    along = np.cumsum(np.cos(heading)) * steps[1], np.cumsum(np.sin(heading)) * steps[1]
    rolled = [np.interp(x, steps, along[0]), y, np.interp(x, steps, along[1])]
    pair = [prepared(flat.with_points(np.column_stack(rolled)), 40), prepared(flat, 40)]
    for sides in (pair, pair[::-1]):
        images = flat.points[match(*sides, elastic=False, options=QUICK).point_map]
        # A rectangle has four symmetries, and the map is near one of them.
        ends = flat.points.min(axis=0) + flat.points.max(axis=0)
        apart = [
            np.linalg.norm(images - np.where([a, b, 0], ends - flat.points, flat.points), axis=1)
            for a, b in np.ndindex(2, 2)
        ]
        assert min(gaps.max() for gaps in apart) < 0.1


# --- mirrors, poses, clouds -----------------------------------------------------------------


def test_a_mirrored_copy_is_seen_as_one(mesh, source) -> None:
    image, truth = permuted(mirrored(mesh, axis=2), seed=5)
    image = moved(TriangleMesh(image.points, image.faces[:, ::-1]))
    found, kept, stubborn = (
        match(source, prepared(image), **asked)
        for asked in (
            {},
            {"mirrored": False, "options": QUICK},
            {"options": replace(QUICK, mirrored_by=1e6)},
        )
    )
    assert (found.mirrored, kept.mirrored, stubborn.mirrored) == (True, False, False)
    assert (found.point_map == truth).all()
    assert found.orientation == pytest.approx(-1)
    assert found.candidates[0].mirrored
    assert f"k={K}, mirrored" in repr(found)
    assert not any(c.mirrored for c in kept.candidates)
    assert kept.score > 50 * found.score
    assert stubborn.mirror_margin < 0.02


def mean_error(mesh: TriangleMesh, found: Match) -> float:
    truth = Truth.of_map(np.arange(len(found.point_map)))
    return float(geodesic_errors(mesh, found.point_map, truth).mean())


def test_poses_are_matched_and_not_flipped() -> None:
    """Errors are in hundredths of the root of the area; edges are about 6 long."""
    source, target, truth = creature_pair(800, 700, seed=3)
    found = match(prepared(source), prepared(target))
    errors = geodesic_errors(source, found.point_map, Truth.of_map(truth))
    assert errors.mean() < 2.0
    assert (errors > 15).mean() < 0.06  # a foot of the third animal is turned about itself
    assert not found.mirrored
    assert found.orientation > 0.85


def test_bending_improves_a_match_and_clouds_do_as_well() -> None:
    mesh, bent, _ = creature_pair(700, seed=2)
    a, b, cloud = prepared(mesh), prepared(bent), prepared(bent.as_cloud())
    found, stiff, forced, seen = (
        match(a, b, options=QUICK),
        match(a, b, elastic=False, mirrored=False, options=QUICK),
        match(a, prepared(mirrored(bent)), mirrored=True, options=QUICK),
        match(a, cloud, options=QUICK),
    )
    assert mean_error(mesh, found) < mean_error(mesh, stiff) < 1.0
    assert found.score == stiff.score
    assert (forced.point_map == found.point_map).all()
    assert forced.orientation < -0.85
    assert mean_error(mesh, seen) < 1.5
    assert not seen.mirrored


def test_clouds_have_sides_too(mesh) -> None:
    cloud = mesh.as_cloud()
    image, truth = permuted(mirrored(cloud), seed=6)
    found = match(prepared(cloud, 60), prepared(moved(image), 60), options=QUICK)
    assert (found.point_map == truth).all()
    assert found.mirrored
    assert found.orientation == pytest.approx(-1, abs=1e-2)


# --- doubt ----------------------------------------------------------------------------------


def test_unlike_surfaces_score_badly(source) -> None:
    """One of them has fewer points than samples are asked for."""
    with pytest.warns(DoubtfulMatchWarning, match="no convincing map: its confidence is 0.[0-4]"):
        found = match(source, prepared(sphere(subdivisions=2).geometry, 60), options=QUICK)
    assert found.score > 0.4
    assert np.isfinite(found.margin)
    assert not found.convincing
    assert "not convincing" in repr(found)


@pytest.mark.parametrize(
    ("facts", "doubts"),
    [
        ({}, ()),
        ({"margin": 0.99}, ("margin",)),
        ({"margin": np.nan}, ("margin",)),
        ({"mirror_margin": 0.85}, ("mirror_margin",)),
        ({"mirror_margin": 1.01}, ()),
        ({"orientation": 0.4}, ("orientation",)),
        ({"orientation": -0.9}, ("orientation",)),
        ({"orientation": -0.9, "mirrored": True}, ()),
        ({"orientation": None}, ()),
        ({"consistent": 0.8}, ("consistent",)),
        ({"margin": 0.99, "coverage": 0.9}, ("margin", "coverage")),
        ({"score": 0.6}, ("score",)),
        ({"discontinuity": 0.05}, ("discontinuity",)),
        ({"discontinuity": None}, ()),
        ({"score": 0.41, "convincing_score": 0.4}, ("score",)),
        ({"margin": 1.02}, ()),
        ({"genera": (0, 1)}, ("genera",)),
        ({"genera": (2, 2)}, ()),
        ({"rims": (0.2, 0.6)}, ()),
        ({"rims": (1.5, 0.1)}, ("rims",)),
        ({"rims": (0.8, 0.7)}, ()),
        ({"rims": (0.8, 0.7), "score": 0.3}, ("rims",)),
        ({"landmark_distances": np.array([0.0, 0.1]), "lost_from": 0.2}, ()),
        ({"landmark_distances": np.array([0.0, 0.3]), "lost_from": 0.2}, ("landmark_distances",)),
        ({"orientation": 0.1, "coverage": 0.9}, ("orientation", "coverage")),
        ({"score": 0.43, "coverage": 1.05}, ("coverage", "score")),
        ({"initial": True}, ("initial",)),
        ({"unconnected": True}, ("unconnected",)),
    ],
    ids=str,
)
def test_doubts_are_facts(facts, doubts) -> None:
    candidate = Candidate(
        functional_map=np.eye(3), score=facts.pop("score", 0.1), mismatches={}, mirrored=False
    )
    clear = {"margin": np.inf, "mirror_margin": np.inf, "orientation": 0.9, "mirrored": False}
    found = Match(
        **{**clear, "consistent": 1.0, "coverage": 1.5, "discontinuity": 0.0, **facts},
        point_map=np.arange(5), functional_map=np.eye(3), candidates=(candidate,),
    )  # fmt: skip
    assert found.doubts == doubts
    told = len({"orientation", "coverage", "discontinuity", "genera"} & set(doubts))
    alone = {"rims", "score", "unconnected"} & set(doubts)
    assert found.convincing == (found.confidence >= 0.5 and told < 2 and not alone)
    assert found.ambiguous == bool(
        {"margin", "mirror_margin", "orientation", "consistent"} & set(doubts)
    )


@pytest.mark.parametrize(
    ("clustered", "score", "landmarks", "shared", "alike"),
    [
        (2.0, 0.3, 0.0, 0.0, 1),
        (1.0, 0.3, 0.0, 0.0, 0),  # no round surface
        (2.0, 0.5, 0.0, 0.0, 0),  # the other is clearly worse
        (2.0, 0.3, 0.9, 0.0, 0),  # or leaves the landmarks
        (2.0, 0.3, 0.0, 0.9, 0),  # or is nearly the same
    ],
)
def test_maps_of_round_surfaces_share_the_confidence(
    clustered, score, landmarks, shared, alike
) -> None:
    turned = shared * np.eye(4) + (1 - shared) * np.eye(4)[::-1]
    one, other = (
        Candidate(functional_map=C, score=s, mismatches={"landmarks": m}, mirrored=False)
        for C, s, m in ((np.eye(4), 0.2, 0.01), (turned, score, landmarks))
    )
    facts = {"margin": 1.5, "mirror_margin": 2.0, "orientation": 0.9, "mirrored": False}
    found = Match(
        **facts, consistent=1.0, coverage=1.5, discontinuity=0.0, clustered=clustered,
        point_map=np.arange(5), functional_map=np.eye(4), candidates=(one, other),
    )  # fmt: skip
    alone = confidence_of(score=0.2, discontinuity=0.0, margin=1.5, coverage=1.5)
    assert found.alike == alike
    assert found.confidence == alone / (1 + alike)
    assert (found.ambiguous, found.convincing) == (alike > 0, alike == 0)


def test_confidence_falls_with_all_that_speaks_against_a_map() -> None:
    """And is a probability, whatever the evidence."""
    good = {"score": 0.2, "discontinuity": 0.001, "margin": 1.3, "coverage": 1.5}
    bad = {"score": 0.6, "discontinuity": 0.08, "margin": 1.0, "coverage": 1.0}
    best, worst = confidence_of(**good), confidence_of(**bad)
    assert 0 <= worst < 0.5 < best <= 1
    assert confidence_of(**good, against=["genera", "rims"]) < best
    assert confidence_of(**good, against=["orientation"]) < confidence_of(
        **good, against=["genera"]
    )
    for name, value in bad.items():
        assert worst < confidence_of(**{**good, name: value}) < best
    sure = confidence_of(**{**good, "margin": np.inf})
    assert sure == confidence_of(**{**good, "margin": 2.0})  # more says no more
    assert confidence_of(**{**good, "margin": None}) == confidence_of(**{**good, "margin": 1.0})


def test_a_map_is_torn_where_neighbours_part(mesh, source) -> None:
    """None of the identity is, most of a map at random, or the edges of one point that is moved."""
    surface, every = source.surface, np.arange(mesh.n)
    assert discontinuity(surface, surface, every) == 0.0
    assert discontinuity(surface, surface, np.random.default_rng(0).permutation(mesh.n)) > 0.5
    far = int(np.linalg.norm(surface.points - surface.points[0], axis=1).argmax())
    edges = surface.edges
    moved_one = every.copy()
    moved_one[0] = far  # all of its edges lead far, and no other
    assert discontinuity(surface, surface, moved_one) == (edges == 0).any(axis=1).mean()


def test_coverage_is_measured_by_what_chance_would_cover() -> None:
    """Random maps cover as much as chance, whatever the numbers of points; good ones more."""
    rng = np.random.default_rng(0)
    fine, coarse = (eigensolve(robust_laplacian(creature(n)), 4) for n in (1000, 700))
    for a, b in ((fine, coarse), (coarse, fine), (fine, fine)):
        thrown = rng.choice(a.n, b.n, p=a.mass / a.area)
        if a.n >= b.n:
            assert coverage(thrown, a.mass, b.mass) == pytest.approx(1, abs=0.15)
        assert coverage(np.zeros(b.n, dtype=int), a.mass, b.mass) < 0.01
    assert coverage(np.arange(fine.n), fine.mass, fine.mass) > 1.4


# --- landmarks ------------------------------------------------------------------------------


def test_landmarks_settle_a_symmetry() -> None:
    """Three points of an ellipsoid say which of its four rotations is meant."""
    ball = sphere(subdivisions=3).geometry
    one = ball.with_points(ball.points * (1, 1.3, 1.7))
    shuffled, truth = permuted(one, seed=7)
    a, b = prepared(one, 50), prepared(shuffled, 50)
    found = match(a, b, elastic=False)
    kept = [candidate.score for candidate in found.candidates if not candidate.mirrored]
    assert 5 * max(kept[:4]) < kept[4]  # one is as good as another, and far better than the rest
    here = np.array([0, 5, 17])
    for turned in (np.array([-1.0, -1, 1]), np.array([1.0, -1, -1])):
        images = np.argmin(((one.points[:, None] - turned * one.points) ** 2).sum(axis=2), axis=0)
        there = np.argsort(truth)[images[here]]
        found = match(a, b, landmarks=(here, there), mirrored=False, options=QUICK)
        assert np.abs(turned * shuffled.points - one.points[found.point_map]).max() < 0.2


# --- refusals -------------------------------------------------------------------------------


def test_of_unequal_spectra_the_longer_is_truncated(source, spectrum, mesh) -> None:
    short = prepare(spectrum.truncate(60), mesh)
    np.testing.assert_array_equal(source.truncate(60).wave, short.wave)
    np.testing.assert_array_equal(source.truncate(60).curvature, short.curvature)
    assert source.truncate(K) is source
    quick = {"k": 30, "elastic": False, "mirrored": False, "options": QUICK}
    both = match(short, short, **quick)
    for pair in ((source, short), (short, source)):
        found = match(*pair, **quick)
        np.testing.assert_array_equal(found.point_map, both.point_map)
        assert found.score == both.score
    refused("k", "be in [30,", source.truncate, 29)


def test_what_cannot_be_matched_is_refused(mesh, spectrum, source) -> None:
    alone = prepare(spectrum)
    for argument, expected, pair, options in (
        ("mirrored", "be None without", (alone, alone), {"mirrored": False}),
        ("source", "come with its geometry", (source, alone), {}),
        ("source", "come with its geometry", (alone, source), {}),
        ("k", "be at least 30", (source, source), {"k": 29}),
        ("source_geometry", "be left out", (source, source), {"source_geometry": mesh}),
        ("target_geometry", "be left out", (spectrum, source), {"target_geometry": mesh}),
        ("spectrum", "have at least 30 modes", (source, spectrum.truncate(29)), {}),
        ("landmarks", "be two lists", (source, source), {"landmarks": ([], [])}),
        ("landmarks of the source", "be in", (source, source), {"landmarks": ([700], [0])}),
    ):
        refused(argument, expected, match, *pair, **options)
    values = np.array([0.0, 0.0, *spectrum.eigenvalues[2:]])
    two = Spectrum(values, spectrum.eigenvectors, spectrum.mass)
    fixed = Spectrum(spectrum.eigenvalues[1:], spectrum.eigenvectors[:, 1:], spectrum.mass)
    for argument, expected, given in (
        ("spectrum", "be of one connected surface", (two,)),
        ("spectrum", "hold the constant mode", (fixed,)),
        ("spectrum", "be of a surface", (replace(spectrum, dimension=3),)),
        ("geometry", "be the mesh or cloud of the spectrum", (spectrum, creature(600))),
        ("geometry", "be in the unit of", (spectrum, mesh.with_points(10 * mesh.points))),
    ):
        refused(argument, expected, prepare, *given)
    refused("n_samples", "be at least 200", prepare, spectrum, n_samples=199)


def test_a_map_needs_the_winding_of_most_faces() -> None:
    """What neighbours tell is as good as what the file says: the very same is prepared."""
    mesh = creature(900)
    spectrum, faces = eigensolve(robust_laplacian(mesh), 40), np.array(mesh.faces)
    faces[::2] = faces[::2, ::-1]
    with pytest.warns(DoubtfulMatchWarning, match="wound against the others"):
        mixed = prepare(spectrum, TriangleMesh(mesh.points, faces))
    truth, seen = prepare(spectrum, mesh), mixed
    assert seen.surface.oriented.consistent == 1
    np.testing.assert_allclose(seen.form, truth.form, atol=1e-12)
    np.testing.assert_allclose(seen.curvature, truth.curvature, atol=1e-9)
