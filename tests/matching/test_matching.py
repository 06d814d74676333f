"""Matches: copies are found exactly, mirrors seen as mirrors, poses not flipped, doubt admitted."""

from __future__ import annotations

import pickle
from functools import cache

import numpy as np
import pytest
from conftest import refused
from scipy.spatial.transform import Rotation

from spectra_kit import InvalidInputError, Spectrum, TriangleMesh, robust_laplacian
from spectra_kit.correspondence import Truth, geodesic_errors
from spectra_kit.eigensolvers import eigensolve
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.functional_maps import functional_map_from_point_map
from spectra_kit.geometry import (
    Geometry,
    PointCloud,
    creature,
    creature_pair,
    mirrored,
    permuted,
    rectangle,
    sphere,
)
from spectra_kit.matching import (
    Candidate,
    Match,
    MatchOptions,
    Prepared,
    coverage_over_chance,
    match,
    prepare,
)

K = 100
TURN = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
TURN *= np.linalg.det(TURN)


def solved(geometry: Geometry, k: int = K) -> Spectrum:
    return eigensolve(robust_laplacian(geometry), k)


@cache  # by identity: the fixtures below are prepared once
def prepared(geometry: Geometry, k: int = K) -> Prepared:
    return prepare(solved(geometry, k), geometry)


def moved(geometry: Geometry, scale: float = 25.4) -> Geometry:
    """The same surface turned, and in another unit."""
    return geometry.with_points(scale * geometry.points @ TURN)


@pytest.fixture(scope="module")
def mesh() -> TriangleMesh:
    return creature(700)


@pytest.fixture(scope="module")
def spectrum(mesh) -> Spectrum:
    return solved(mesh)


@pytest.fixture(scope="module")
def source(mesh, spectrum) -> Prepared:
    return prepare(spectrum, mesh)


@pytest.fixture(scope="module")
def copy(mesh) -> tuple[TriangleMesh, Spectrum, np.ndarray]:
    """The animal turned, in another unit and order, and its true map; solved anew."""
    shuffled, truth = permuted(mesh, seed=1)
    shuffled = moved(shuffled)
    return shuffled, solved(shuffled), truth


@pytest.fixture(scope="module")
def target(copy) -> Prepared:
    return prepare(copy[1], copy[0])


@pytest.fixture(scope="module")
def cloud(mesh) -> PointCloud:
    return mesh.as_cloud()


# --- copies ---------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [30, K])
@pytest.mark.parametrize("seen", ["geometry", "spectrum alone"])
def test_a_copy_gives_the_permutation(mesh, spectrum, copy, k, seen) -> None:
    shuffled, target, truth = copy
    geometries = (mesh, shuffled) if seen == "geometry" else (None, None)
    a, b = prepare(spectrum.truncate(k), geometries[0]), prepare(target.truncate(k), geometries[1])
    found = match(a, b)
    assert (found.point_map == truth).all()
    assert found.functional_map.shape == (k, k)
    C = functional_map_from_point_map(a.spectrum, b.spectrum, truth)
    assert found.functional_map == pytest.approx(C, abs=1e-9)
    assert found.score == pytest.approx(1e-3, rel=1e-3)
    assert found.margin > 5
    assert not found.ambiguous
    assert not found.mirrored
    assert found.orientation == (pytest.approx(1) if seen == "geometry" else None)


@pytest.mark.parametrize(("n", "seed"), [(500, 0), (1400, 3)])
def test_copies_of_other_sizes_and_animals(n, seed) -> None:
    mesh = creature(n, seed=seed)
    shuffled, truth = permuted(mesh, seed=2)
    found = match(prepared(mesh, 100), prepared(moved(shuffled, 1e-3), 100))
    assert (found.point_map == truth).all()


@pytest.mark.parametrize("options", [{"elastic": False}, {"k": 40}, {"mirrored": False}], ids=str)
def test_no_option_breaks_a_copy(source, target, copy, options) -> None:
    found = match(source, target, **options)
    assert (found.point_map == copy[2]).all()
    assert len(found.functional_map) == options.get("k", K)


def test_a_mesh_may_have_fewer_points_than_samples() -> None:
    ball = prepared(sphere(subdivisions=2).geometry, 40)
    assert (match(ball, ball).point_map == np.arange(162)).all()


@pytest.fixture(scope="module")
def holed(mesh) -> TriangleMesh:
    near = np.argsort(((mesh.points - mesh.points[0]) ** 2).sum(axis=1))[:12]
    kept = mesh.faces[~np.isin(mesh.faces, near).any(axis=1)]
    return TriangleMesh(mesh.points, kept).without_unreferenced()


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("inside_out", [False, True])
def test_scans_with_holes_have_an_outside(holed, mirror, inside_out) -> None:
    """However their faces are wound: a copy is no mirror image, and a mirror image is one."""
    copy = TriangleMesh(
        holed.points * ([-1, 1, 1] if mirror else 1),
        holed.faces[:, ::-1] if inside_out else holed.faces,
    )
    found = match(prepared(holed, 60), prepared(copy, 60))
    assert (found.point_map == np.arange(holed.n)).all()
    assert found.mirrored == mirror


@pytest.mark.parametrize("rolled_first", [True, False])
def test_a_rolled_sheet_matches_the_flat_one(rolled_first) -> None:
    """Its curvature varies, and that of the flat one does not: it must not be compared."""
    flat = rectangle(n=900).geometry
    x, y = flat.points[:, 0], flat.points[:, 1]
    turn = 0.9 * x + 0.6 * x**2  # faster and faster, so that the curvature varies
    steps = np.linspace(0, x.max(), 2001)
    heading = 0.9 * steps + 0.6 * steps**2
    along = np.cumsum(np.cos(heading)) * steps[1], np.cumsum(np.sin(heading)) * steps[1]
    rolled = flat.with_points(
        np.column_stack([np.interp(x, steps, along[0]), y, np.interp(x, steps, along[1])])
    )
    assert np.ptp(turn) > 1
    pair = [prepared(rolled, 60), prepared(flat, 60)]
    found = match(*(pair if rolled_first else pair[::-1]))
    assert np.isfinite(found.score)
    # A rectangle has four symmetries, and the map is near one of them.
    corner, far = flat.points.min(axis=0), flat.points.max(axis=0)
    for flips in np.ndindex(2, 2):
        image = flat.points.copy()
        for axis in range(2):
            if flips[axis]:
                image[:, axis] = corner[axis] + far[axis] - image[:, axis]
        apart = np.linalg.norm(flat.points[found.point_map] - image, axis=1)
        if apart.max() < 0.1:
            break
    else:
        pytest.fail("the map is near none of the four symmetries")


def test_a_spectrum_is_prepared_with_its_geometry(mesh, spectrum, source, copy) -> None:
    shuffled, target, truth = copy
    found = match(spectrum, target, source_geometry=mesh, target_geometry=shuffled, k=60)
    assert (found.point_map == truth).all()
    assert found.orientation == pytest.approx(1)
    alone = match(spectrum, target, k=60)
    assert alone.orientation is None
    assert (alone.point_map == truth).all()


def test_a_match_is_the_same_every_time_and_in_every_process(source, target) -> None:
    one = match(source, target)
    two = match(pickle.loads(pickle.dumps(source)), target)
    assert (one.point_map == two.point_map).all()
    assert (one.functional_map == two.functional_map).all()
    assert (one.margin, one.orientation) == (two.margin, two.orientation)
    back = pickle.loads(pickle.dumps(one))
    assert (back.point_map == one.point_map).all()
    assert [c.score for c in back.candidates] == [c.score for c in two.candidates]
    assert not back.point_map.flags.writeable


# --- mirrors --------------------------------------------------------------------------------


@pytest.mark.parametrize(("axis", "flipped"), [(0, False), (2, True)])
def test_a_mirrored_copy_is_seen_as_one(mesh, source, axis, flipped) -> None:
    image, truth = permuted(mirrored(mesh, axis=axis), seed=5)
    image = moved(TriangleMesh(image.points, image.faces[:, ::-1]) if flipped else image)
    target = prepared(image)
    for asked in (None, True):
        found = match(source, target, mirrored=asked)
        assert found.mirrored
        assert (found.point_map == truth).all()
        assert found.orientation == pytest.approx(-1)
        assert found.candidates[0].mirrored
        assert f"k={K}, mirrored" in repr(found)
    kept = match(source, target, mirrored=False)
    assert not kept.mirrored
    assert not any(c.mirrored for c in kept.candidates)
    assert kept.score > 50 * found.score


def test_a_copy_can_be_forced_to_be_mirrored(source, target) -> None:
    either, forced = (match(source, target, mirrored=m) for m in (None, True))
    assert not either.mirrored
    assert {c.mirrored for c in either.candidates} == {False, True}
    assert forced.mirrored
    assert forced.score > 50 * either.score


def test_a_spectrum_alone_cannot_tell_a_mirror(spectrum, mesh) -> None:
    image, truth = permuted(mirrored(mesh), seed=5)
    found = match(spectrum, solved(image))
    assert (found.point_map == truth).all()
    assert not found.mirrored
    assert found.orientation is None


# --- poses ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pose() -> tuple[TriangleMesh, TriangleMesh, Prepared, Prepared]:
    """Two poses of one animal, point i corresponding to point i."""
    source, target, _ = creature_pair(1000, seed=2)
    return source, target, prepared(source), prepared(target)


def mean_error(mesh: TriangleMesh, found: Match) -> float:
    truth = Truth.of_map(np.arange(len(found.point_map)))
    return float(geodesic_errors(mesh, found.point_map, truth).mean())


@pytest.mark.parametrize(("seed", "n_target"), [(0, None), (3, None), (0, 800)])
def test_poses_are_matched_and_not_flipped(seed, n_target) -> None:
    """Errors are in hundredths of the root of the area; edges are about 6 long."""
    source, target, truth = creature_pair(1000, n_target, seed=seed)
    found = match(prepared(source), prepared(target))
    errors = geodesic_errors(source, found.point_map, Truth.of_map(truth))
    assert errors.mean() < 2.0
    assert (errors > 15).mean() < 0.06  # a foot of the third animal is turned about itself
    assert not found.mirrored
    assert found.orientation > 0.85


def test_bending_improves_a_match(pose) -> None:
    mesh, _, a, b = pose
    found, stiff = match(a, b), match(a, b, elastic=False)
    assert mean_error(mesh, found) < mean_error(mesh, stiff) < 1.0
    assert found.score == stiff.score


def test_a_mirrored_pose_is_matched_when_told_so(pose) -> None:
    _, target, a, b = pose
    forced = match(a, prepared(mirrored(target)), mirrored=True)
    assert (forced.point_map == match(a, b).point_map).all()
    assert forced.orientation < -0.85


def test_poses_are_matched_without_their_geometry(pose) -> None:
    mesh, _, a, b = pose
    found = match(a.spectrum, b.spectrum)
    assert mean_error(mesh, found) < 4.0  # a limb may be turned about itself


# --- clouds ---------------------------------------------------------------------------------


@pytest.mark.parametrize("reflect", [False, True])
def test_clouds_have_sides_too(cloud, reflect) -> None:
    image, truth = permuted(mirrored(cloud) if reflect else cloud, seed=6)
    found = match(prepared(cloud), prepared(moved(image)))
    assert (found.point_map == truth).all()
    assert found.mirrored == reflect
    assert found.orientation == pytest.approx(-1 if reflect else 1, abs=1e-2)


@pytest.mark.parametrize("cloud_first", [False, True])
def test_a_mesh_and_its_cloud(mesh, source, cloud, cloud_first) -> None:
    sides = [source, prepared(cloud)]
    found = match(*(sides[::-1] if cloud_first else sides))
    errors = geodesic_errors(mesh, found.point_map, Truth.of_map(np.arange(mesh.n)))
    assert errors.mean() < 0.2
    assert not found.mirrored


@pytest.fixture(scope="module")
def pose_seen(pose) -> PointCloud:
    return pose[1].as_cloud()


@pytest.mark.parametrize("both", [False, True])
def test_a_pose_seen_as_a_cloud(pose, pose_seen, both) -> None:
    mesh, _, a, _ = pose
    found = match(prepared(mesh.as_cloud()) if both else a, prepared(pose_seen))
    assert mean_error(mesh, found) < 1.5
    assert not found.mirrored


# --- doubt ----------------------------------------------------------------------------------


@cache
def ellipsoids(axes: tuple[float, float, float]) -> tuple[TriangleMesh, TriangleMesh]:
    """One ellipsoid, in two sets of triangles."""
    ball = sphere(subdivisions=3).geometry
    return ball.with_points(ball.points * axes), ball.with_points((ball.points @ TURN) * axes)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulMatchWarning")
def test_a_map_of_a_surface_of_revolution_is_a_turn_or_ambiguous(seed) -> None:
    """Bases within its eigenspaces are what rounding makes them, and so is the map found."""
    ball = sphere(subdivisions=3).geometry
    turns = Rotation.random(2, random_state=seed).as_matrix()
    one, other = (ball.with_points((ball.points @ turn) * (1, 1, 1.7)) for turn in turns)
    found = match(prepared(one, 60), prepared(other, 60))
    images = one.points[found.point_map]
    # The nearest symmetry: about the axis by Procrustes, along it by sign.
    left, _, right = np.linalg.svd(images[:, :2].T @ other.points[:, :2])
    along = np.sign(images[:, 2] @ other.points[:, 2])
    nearest = np.column_stack([other.points[:, :2] @ (left @ right).T, along * other.points[:, 2]])
    assert found.ambiguous or np.linalg.norm(images - nearest, axis=1).mean() < 0.15


@pytest.mark.parametrize(("mirror", "sign"), [(False, 1), (True, -1)])
def test_an_ellipsoid_has_several_good_maps(mirror, sign) -> None:
    """Four rotations take it to itself, and four reflections; each is as good as another."""
    axes = (1, 1.3, 1.7)
    one, other = ellipsoids(axes)
    found = match(prepared(one, 80), prepared(other, 80), mirrored=mirror)
    assert found.margin < 1.2
    # The first three modes are nearly the coordinates.
    good = [c for c in found.candidates if c.score < 1.5 * found.score]
    signs = {tuple(np.sign(np.diag(c.functional_map)[1:4])) for c in good}
    assert len(signs) > 1
    images = (one.points / axes)[found.point_map]
    fit = np.linalg.lstsq(other.points / axes, images, rcond=None)[0]
    assert np.abs(np.abs(np.diag(fit)) - 1).max() < 0.02
    assert np.sign(np.diag(fit)).prod() == sign
    assert found.orientation * sign > 0.9


def test_unlike_surfaces_score_badly(source) -> None:
    with pytest.warns(DoubtfulMatchWarning, match="no convincing map: its mismatch is 0.[5-9]"):
        found = match(source, prepared(sphere(subdivisions=3).geometry))
    assert found.score > 0.4
    assert np.isfinite(found.margin)
    assert not found.convincing
    assert "not convincing" in repr(found)


@pytest.mark.parametrize(
    ("facts", "doubts"),
    [
        ({}, ()),
        ({"margin": 1.01}, ("margin",)),
        ({"margin": np.nan}, ("margin",)),
        ({"mirror_margin": 0.85}, ("mirror_margin",)),
        ({"mirror_margin": 1.01}, ()),
        ({"orientation": 0.4}, ("orientation",)),
        ({"orientation": -0.9}, ("orientation",)),
        ({"orientation": -0.9, "mirrored": True}, ()),
        ({"orientation": None}, ()),
        ({"consistent": 0.8}, ("consistent",)),
        ({"margin": 1.01, "coverage": 0.9}, ("margin", "coverage")),
        ({"score": 0.6}, ("score",)),
        ({"margin": 1.01, "options": MatchOptions(clear_margin=1.0)}, ()),
    ],
    ids=str,
)
def test_doubts_are_facts(facts, doubts) -> None:
    candidate = Candidate(
        functional_map=np.eye(3), score=facts.pop("score", 0.1), mismatches={}, mirrored=False
    )
    clear = {"margin": np.inf, "mirror_margin": np.inf, "orientation": 0.9, "mirrored": False}
    found = Match(
        **{**clear, "consistent": 1.0, "coverage": 1.5, **facts},
        point_map=np.arange(5), functional_map=np.eye(3), candidates=(candidate,),
    )  # fmt: skip
    assert found.doubts == doubts
    assert found.convincing == (not {"score", "coverage"} & set(doubts))
    assert found.ambiguous == bool(set(doubts) - {"score", "coverage"})


def test_coverage_is_measured_by_what_chance_would_cover() -> None:
    """Random maps cover as much as chance, whatever the numbers of points; good ones more."""
    rng = np.random.default_rng(0)
    fine, coarse = (eigensolve(robust_laplacian(creature(n)), 4) for n in (3000, 900))
    for a, b in ((fine, coarse), (coarse, fine), (fine, fine)):
        thrown = rng.choice(a.n, b.n, p=a.mass / a.area)
        if a.n >= b.n:
            assert coverage_over_chance(a, b, thrown) == pytest.approx(1, abs=0.15)
        assert coverage_over_chance(a, b, np.zeros(b.n, dtype=int)) < 0.01
    assert coverage_over_chance(fine, fine, np.arange(fine.n)) > 1.4


# --- landmarks ------------------------------------------------------------------------------


def test_landmarks_settle_a_symmetry() -> None:
    """Three points of an ellipsoid say which of its four rotations is meant."""
    one, _ = ellipsoids((1, 1.3, 1.7))
    shuffled, truth = permuted(one, seed=7)
    a, b = prepared(one, 80), prepared(shuffled, 80)
    here = np.array([0, 5, 17])
    for turned in (np.ones(3), np.array([-1.0, -1, 1]), np.array([1.0, -1, -1])):
        images = np.argmin(((one.points[:, None] - turned * one.points) ** 2).sum(axis=2), axis=0)
        there = np.argsort(truth)[images[here]]
        found = match(a, b, landmarks=(here, there))
        assert np.abs(turned * shuffled.points - one.points[found.point_map]).max() < 0.2


# --- refusals -------------------------------------------------------------------------------


def test_of_unequal_spectra_the_longer_is_truncated(source, spectrum, mesh) -> None:
    short = prepare(spectrum.truncate(60), mesh)
    np.testing.assert_array_equal(source.truncate(60).wave, short.wave)
    np.testing.assert_array_equal(source.truncate(60).surface.curvature, short.surface.curvature)
    assert source.truncate(K) is source
    both = match(short, short)
    for pair in ((source, short), (short, source)):
        found = match(*pair)
        np.testing.assert_array_equal(found.point_map, both.point_map)
        assert found.score == both.score
    refused("k", "be in [30,", source.truncate, 29)


def test_what_cannot_be_matched_is_refused(mesh, spectrum, source) -> None:
    alone = prepare(spectrum)

    def refused(argument: str, *pair: object, **options: object) -> None:
        with pytest.raises(InvalidInputError, match=f"^`{argument}") as caught:
            match(*pair, **options)
        assert "got" in str(caught.value)

    refused("mirrored", alone, alone, mirrored=False)
    refused("source", source, alone)
    refused("source", alone, source)
    refused("k", source, source, k=29)
    refused("source", mesh, source)
    refused("target", source, None)
    refused("source_geometry", source, source, source_geometry=mesh)
    refused("target_geometry", spectrum, source, target_geometry=mesh)
    refused("spectrum", source, spectrum.truncate(29))
    refused("landmarks", source, source, landmarks=([], []))
    refused("landmarks of the source", source, source, landmarks=([700], [0]))
