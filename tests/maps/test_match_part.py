"""Parts against wholes: what is covered, by which point, and what is no part at all."""

from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np
import pytest
from conftest import bumpy, creature, data_folder, refused
from scipy.spatial import cKDTree
from studies.matching.both_cut import both_cut, both_landmarks
from studies.matching.parts import REFERENCE, cut_landmarks, left_of, overlap, part_of
from studies.matching.subjects import subjects_in
from test_match import moved, prepared

from spectra_kit import TriangleMesh, robust_laplacian, spectrum
from spectra_kit.eigen import eigensolve
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.features import biharmonic_distances
from spectra_kit.geodesics import pair_distances
from spectra_kit.geometry import Component, largest_component
from spectra_kit.maps import MatchOptions, Prepared, match, match_part, partial, prepare
from spectra_kit.maps.deform import Contact
from spectra_kit.maps.partial import covered_by, likely_regions, limb_ends, region

K = 60
# A search of few candidates: enough for parts of the very same surface.
FEW = MatchOptions(orders=8, growing=16, turns=4, finalists=3, rounds=1)


def cut(mesh: TriangleMesh, left: np.ndarray) -> Component:
    return largest_component(TriangleMesh(mesh.points, mesh.faces[left[mesh.faces].all(axis=1)]))


@pytest.fixture(scope="module")
def mesh() -> TriangleMesh:
    return creature(700)


@pytest.fixture(scope="module")
def whole(mesh) -> Prepared:
    return prepared(mesh, K)


@pytest.fixture(scope="module")
def headless(mesh) -> Component:
    return cut(mesh, mesh.points[:, 0] < 0.6)


@pytest.fixture(scope="module")
def part(headless) -> Prepared:
    """Turned, and in another unit."""
    return prepared(moved(headless.mesh), K)


@pytest.fixture
def four_regions(monkeypatch) -> None:
    """Those that are likeliest: one of them is right, as a test below shows."""
    monkeypatch.setattr(partial, "_TRIED", 4)
    monkeypatch.setattr(partial, "_REFINED", 1)


@pytest.fixture
def few_regions(four_regions, monkeypatch) -> None:
    """Four of fifty, where these are enough."""
    monkeypatch.setattr(partial, "_ENDS", 4)
    monkeypatch.setattr(partial, "_SHARES", partial._SHARES[::3])


# --- the answer -----------------------------------------------------------------------------


@pytest.mark.usefixtures("few_regions")
def test_what_is_cut_off_a_copy_has_no_partner(mesh, headless, whole, part) -> None:
    found = match_part(part, whole, mirrored=False, options=FEW)
    left = np.isin(np.arange(mesh.n), headless.vertex_index)
    mass = whole.spectrum.mass
    assert overlap(found.covered, left, mass) > 0.97
    both = np.flatnonzero(found.covered & left)
    places = headless.vertex_index[found.point_map[both]]
    assert (places == both).mean() > 0.9
    apart = np.linalg.norm(mesh.points[places] - mesh.points[both], axis=1)
    assert apart.mean() < 0.01 * mesh.area**0.5
    assert not found.doubts
    # Functions of the part become functions that are 0 elsewhere: the constant keeps its integral.
    assert abs(found.functional_map[0, 0]) == pytest.approx(mass[found.covered].sum(), rel=1e-6)
    assert np.linalg.norm(found.functional_map, 2) < 1.2


@pytest.mark.usefixtures("few_regions")
def test_a_mirrored_part_is_seen_as_one(mesh, headless, whole) -> None:
    image = headless.mesh.with_points(headless.mesh.points * [1, -1, 1])
    found = match_part(prepared(image, K), whole, options=FEW)
    assert found.mirrored
    left = np.isin(np.arange(mesh.n), headless.vertex_index)
    assert overlap(found.covered, left, whole.spectrum.mass) > 0.95


@pytest.mark.slow
@pytest.mark.usefixtures("four_regions")
def test_a_limb_is_found(mesh, whole) -> None:
    """Head and neck; of the head alone some processors find less, as rounding picks the rival."""
    assert covers_what_is_left(mesh, whole, mesh.points[:, 0] > 0.2) > 0.95


@pytest.mark.usefixtures("few_regions")
def test_a_scan_may_have_a_hole(mesh, whole) -> None:
    left = np.linalg.norm(mesh.points - mesh.points[0], axis=1) >= 0.2
    assert covers_what_is_left(mesh, whole, left) > 0.97


def covers_what_is_left(mesh: TriangleMesh, whole: Prepared, left: np.ndarray) -> float:
    piece = cut(mesh, left)
    found = match_part(prepared(piece.mesh, K), whole, mirrored=False, options=FEW)
    kept = np.isin(np.arange(mesh.n), piece.vertex_index)
    return overlap(found.covered, kept, whole.spectrum.mass)


def test_a_closed_part_is_a_whole(whole) -> None:
    options = {"k": 30, "mirrored": False, "options": FEW}
    found = match_part(whole, whole, **options)
    assert found.covered.all()
    usual = match(whole, whole, **options)
    assert usual.covered is None
    np.testing.assert_array_equal(found.point_map, usual.point_map)
    refused("covered", "have the shape of", replace, found, covered=found.covered[1:])


def finer(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(*igl.upsample(mesh.points, mesh.faces))


def test_a_dense_surface_on_all_its_points_is_prepared_as_if_it_were_not_dense(mesh) -> None:
    fine = finer(mesh)
    modes = spectrum(fine, K)
    thin, full = (prepare(modes, fine, n_points=count) for count in (1000, fine.n))
    assert thin.spectrum.n < fine.n
    same = thin.on_all_points()
    assert full.on_all_points() is full
    for name in ("samples", "wave", "curvature", "form", "lengths"):
        np.testing.assert_array_equal(getattr(same, name), getattr(full, name))
    np.testing.assert_array_equal(same.surface.points, full.surface.points)


@pytest.mark.slow
@pytest.mark.usefixtures("few_regions")
def test_a_part_of_a_dense_surface_is_matched_on_all_points(mesh, headless) -> None:
    whole, piece = finer(mesh), finer(headless.mesh)
    dense = [prepare(spectrum(side, K), side, n_points=1000) for side in (piece, whole)]
    found = match_part(*dense, mirrored=False, options=FEW)
    assert len(found.covered) == whole.n
    left = cKDTree(piece.points).query(whole.points)[0] == 0
    assert overlap(found.covered, left, dense[1].whole.mass) > 0.97
    both = np.flatnonzero(found.covered & left)
    apart = np.linalg.norm(piece.points[found.point_map[both]] - whole.points[both], axis=1)
    assert apart.mean() < 0.01 * whole.area**0.5
    closed = match_part(dense[1], dense[1], k=30, mirrored=False, options=FEW)
    assert closed.covered.shape == (whole.n,)


@pytest.mark.usefixtures("few_regions")
def test_what_is_no_part_is_doubted(whole) -> None:
    ball = bumpy(642)
    half = cut(ball, ball.points[:, 2] > 0)
    with pytest.warns(DoubtfulMatchWarning, match="no convincing part"):
        found = match_part(prepared(half.mesh, K), whole, mirrored=False, options=FEW)
    assert not found.convincing
    assert {"score", "coverage"} & set(found.doubts)


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.usefixtures("four_regions")
def test_a_person_without_a_leg_matches_another() -> None:
    root = data_folder()
    if root is None or not (root / "faust_r").is_dir():
        pytest.skip("set SPECTRA_KIT_DATA to the folder of real shapes to run this")
    subjects = subjects_in(root / "faust_r")
    one, other = subjects["tr_reg_053"], subjects["tr_reg_076"]
    kept = cut_landmarks(subjects[REFERENCE], "leg", seed=100)
    piece, left = part_of(one, kept), left_of(other, kept)
    a, b = (
        prepare(eigensolve(robust_laplacian(mesh), 100), mesh) for mesh in (piece.mesh, other.mesh)
    )
    found = match_part(a, b, mirrored=False)
    assert overlap(found.covered, left, b.spectrum.mass) > 0.9
    both = kept & left[other.landmarks] & np.isin(one.landmarks, piece.vertices)
    places = piece.vertices[found.point_map[other.landmarks[both]]]
    errors = pair_distances(one.mesh, one.landmarks[both], places)
    assert 100 * errors.mean() < 3.5 * one.mesh.area**0.5


# --- what it is made of ---------------------------------------------------------------------


def test_limbs_end_where_all_else_is_far(mesh, whole) -> None:
    ends = limb_ends(whole)
    points = mesh.points
    # No point is farther from all others, by the distances themselves.
    squared = np.array(
        [
            whole.spectrum.mass @ biharmonic_distances(whole.spectrum, [int(i)])[0] ** 2
            for i in (*ends[:2], *np.random.default_rng(0).integers(mesh.n, size=20))
        ]
    )
    assert squared.argmax() == 0
    paws = points[ends[points[ends, 2] < points[:, 2].min() + 0.15]]
    assert len(paws) == 4
    assert points[ends, 0].min() < points[:, 0].min() + 0.1  # the tail


@pytest.mark.slow
def test_a_region_of_the_whole_is_likely_to_be_itself(mesh, whole, headless, part) -> None:
    left = np.isin(np.arange(mesh.n), headless.vertex_index)
    likely = likely_regions(part, whole, 4)
    assert len(likely) == 4
    overlaps = [
        overlap(np.isin(np.arange(mesh.n), piece.vertices), left, whole.spectrum.mass)
        for piece in likely
    ]
    assert max(overlaps) > 0.85
    everything = region(whole, np.ones(mesh.n, dtype=bool))
    assert everything.area == pytest.approx(1)
    assert region(whole, np.zeros(mesh.n, dtype=bool)) is None


def test_a_part_in_its_place_covers_itself(mesh, whole, headless) -> None:
    """But for what is beyond its border, up to the vertices that have the border nearest."""
    piece = prepared(headless.mesh, K)
    places = whole.surface.points
    there = headless.vertex_index
    back = cKDTree(places[there]).query(places)[1]
    covered = covered_by(piece, whole, Contact(places[there], there, back, gap=0.0))
    assert covered[there].all()
    left = np.isin(np.arange(mesh.n), there)
    assert overlap(covered, left, whole.spectrum.mass) > 0.97


@pytest.mark.data
def test_cuts_are_seeded_and_carried_to_other_bodies() -> None:
    root = data_folder()
    if root is None or not (root / "faust_r").is_dir():
        pytest.skip("set SPECTRA_KIT_DATA to the folder of real shapes to run this")
    subjects = subjects_in(root / "faust_r")
    body, other = subjects[REFERENCE], subjects["tr_reg_045"]
    for kind, low, high in (("arm", 0.85, 0.97), ("leg", 0.75, 0.92), ("half", 0.4, 0.7)):
        kept = cut_landmarks(body, kind, seed=3)
        np.testing.assert_array_equal(kept, cut_landmarks(body, kind, seed=3))
        assert (kept != cut_landmarks(body, kind, seed=4)).any()
        for subject in (body, other):
            left = left_of(subject, kept)
            piece = part_of(subject, kept)
            assert left[piece.vertices].all()
            np.testing.assert_array_equal(piece.mesh.points, subject.mesh.points[piece.vertices])
            assert low < piece.mesh.area / subject.mesh.area < high


@pytest.mark.data
def test_cuts_of_both_share_what_they_should() -> None:
    """The same each time, others of other seeds."""
    root = data_folder()
    if root is None or not (root / "faust_r").is_dir():
        pytest.skip("set SPECTRA_KIT_DATA to the folder of real shapes to run this")
    reference = subjects_in(root / "faust_r")[REFERENCE]
    cuts = both_cut([4, 5], 4, 2)
    assert [cut.kind for cut in cuts] == ["planes", "balls", "planes", "balls", *2 * ["disjoint"]]
    for cut in cuts:
        one, other = both_landmarks(reference, cut)
        np.testing.assert_array_equal((one, other), both_landmarks(reference, cut))
        assert (one != both_landmarks(reference, cut._replace(seed=99))[0]).any()
        assert 0.25 < min(one.mean(), other.mean()) < max(one.mean(), other.mean()) < 0.9
        shared = (one & other).sum() / min(one.sum(), other.sum())
        assert shared == 0 if cut.kind == "disjoint" else 0.1 < shared < 0.9


# --- refusals -------------------------------------------------------------------------------


def test_what_is_no_mesh_is_refused(mesh, whole, part) -> None:
    alone = prepare(whole.spectrum)
    cloud = prepared(mesh.as_cloud(), 30)
    for argument, expected, pair, options in (
        ("part", "be prepared of a mesh", (alone, whole), {}),
        ("whole", "be prepared of a mesh", (part, alone), {}),
        ("part", "be prepared of a mesh", (cloud, whole), {}),
        ("whole", "be prepared of a mesh", (part, cloud), {}),
        ("k", "be at least 30", (part, whole), {"k": 29}),
    ):
        refused(argument, expected, match_part, *pair, **options)
