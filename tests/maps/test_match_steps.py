"""What `match` is made of: curvature, bending, scores and candidates, each held to its formula."""

from __future__ import annotations

import re
from ast import literal_eval
from dataclasses import replace

import numpy as np
import pytest
from conftest import creature, data_folder, refused
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from test_match import prepared

from spectra_kit import TriangleMesh, robust_laplacian
from spectra_kit.eigen import eigensolve
from spectra_kit.geometry import creature_pair, mirrored, permuted, rectangle, sphere
from spectra_kit.maps import (
    MatchOptions,
    Prepared,
    Truth,
    functional_map_from_point_map,
    geodesic_errors,
    match,
    prepare,
    score_map,
)
from spectra_kit.maps.calibration import score_of
from spectra_kit.maps.candidates import SAMPLES, bent, rigid_candidates, side_of, sign_candidates
from spectra_kit.maps.deform import PULL, _bending, _rotations, _weighted_edges, contact
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.score import (
    bends_apart,
    coverage_over_chance,
    orientation_of,
    unlike_cost,
)
from spectra_kit.maps.search import Search
from spectra_kit.maps.surface import (
    Surface,
    changed,
    lengths_of,
    outward_normals,
    smoothed_mean_curvature,
)
from spectra_kit.operators import oriented_triangles

K = 60
QUICK = MatchOptions(orders=8, growing=32, turns=6, finalists=6)
ANIMALS = ("dog_alph", "muybridge_132_133_07")


@pytest.fixture(scope="module")
def mesh() -> TriangleMesh:
    return creature(1000)


@pytest.fixture(scope="module")
def source(mesh) -> Prepared:
    return prepared(mesh, K)


@pytest.fixture(scope="module")
def copy(mesh) -> tuple[Prepared, np.ndarray]:
    shuffled, truth = permuted(mesh, seed=1)
    return prepared(shuffled, K), truth


@pytest.fixture(scope="module")
def image(mesh) -> Prepared:
    return prepared(mirrored(mesh), K)


def true_map(source: Prepared, target: Prepared, point_map: np.ndarray) -> np.ndarray:
    return functional_map_from_point_map(source.spectrum, target.spectrum, point_map)


# --- preparation ----------------------------------------------------------------------------


def test_a_unit_does_not_matter(mesh, source) -> None:
    tripled = mesh.with_points(mesh.points * 3 / mesh.area**0.5)
    same = prepare(source.spectrum.rescale(3.0), tripled)
    assert same.spectrum.area == pytest.approx(1)
    assert (same.samples == source.samples).all()
    assert same.wave == pytest.approx(source.wave, rel=1e-9)
    curvature, mass = source.curvature, source.surface.mass
    assert mass @ curvature == pytest.approx(np.zeros(4), abs=1e-9)
    assert mass @ curvature**2 == pytest.approx(np.ones(4))
    for one, other, names in (
        (same.surface, source.surface, ("points", "mass")),
        (same, source, ("curvature", "form")),
    ):
        for name in names:
            assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-8)


def test_a_flat_sheet_has_no_curvature() -> None:
    flat = prepared(rectangle(n=400).geometry, 40)
    assert (flat.curvature == 0).all()
    assert repr(flat) == f"Prepared(n={flat.spectrum.n}, k=40, from spectrum and geometry)"
    assert repr(prepare(flat.spectrum)).endswith("from spectrum alone)")


# --- curvature ------------------------------------------------------------------------------


def test_normals_of_a_ball_point_outwards() -> None:
    ball = sphere(subdivisions=3, radius=2.5).geometry
    for geometry in (ball, TriangleMesh(ball.points, ball.faces[:, ::-1]), ball.as_cloud()):
        normals = outward_normals(geometry.points, oriented_triangles(geometry))
        assert normals == pytest.approx(ball.points / 2.5, abs=0.02)
        assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(ball.n))


@pytest.mark.parametrize("radius", [1.0, 0.2])
def test_the_mean_curvature_of_a_ball(radius) -> None:
    """The coordinates are its first modes, so smoothing only scales them: 2 H = 2 / r."""
    ball = sphere(subdivisions=3, radius=radius).geometry
    spectrum = eigensolve(robust_laplacian(ball), 30)
    modes = (5, 15, 29)
    curvature = smoothed_mean_curvature(spectrum, ball.points, oriented_triangles(ball), modes)
    first, cut = 2 / radius**2, spectrum.eigenvalues[list(modes)]
    expected = 2 / radius * np.exp(-first / cut)
    assert curvature == pytest.approx(np.broadcast_to(expected, curvature.shape), rel=2e-2)


# --- bending --------------------------------------------------------------------------------


def in_frame(mesh: TriangleMesh, mass: np.ndarray | None = None) -> Surface:
    mass = np.ones(mesh.n) if mass is None else mass
    return Surface(points=mesh.points, mass=mass, oriented=oriented_triangles(mesh))


def test_edges_have_cotangent_weights(mesh) -> None:
    import igl

    i, j, w = _weighted_edges(in_frame(mesh))
    cotangents = igl.cotmatrix(mesh.points, mesh.faces)
    expected = np.asarray(cotangents[i, j]).ravel()
    assert w == pytest.approx(expected, abs=1e-9)
    assert (i < j).all()
    assert (w > 0).all()
    off = cotangents.copy()
    off.setdiag(0)
    assert len(w) == (off > 1e-12).sum() // 2


def energy(mesh: TriangleMesh, mass: np.ndarray, bent: np.ndarray, goals: np.ndarray) -> float:
    """How much a bend stretches, with the best rotation at each end of each edge, and how far."""
    i, j, w = _weighted_edges(in_frame(mesh))
    total = PULL * float(mass @ ((bent - goals) ** 2).sum(axis=1))
    for v in range(mesh.n):
        at = (i == v) | (j == v)
        x, y = mesh.points[i[at]] - mesh.points[j[at]], bent[i[at]] - bent[j[at]]
        R, _ = Rotation.align_vectors(y, x, w[at])
        total += 0.5 * float(w[at] @ ((y - R.apply(x)) ** 2).sum(axis=1))
    return total


def test_bending_lowers_the_energy_every_time() -> None:
    mesh, pose = creature(500), creature(500, pose=2)
    mass = robust_laplacian(mesh).mass / mesh.area
    bend, _ = _bending(in_frame(mesh, mass), PULL)
    bent, goals = mesh.points, pose.points
    energies = [energy(mesh, mass, bent, goals)]
    for _ in range(2):
        bent = bend(bent, goals, 1)
        energies.append(energy(mesh, mass, bent, goals))
    assert (np.diff(energies) < 0).all()
    assert np.abs(bent - goals).max() < 0.5 * np.abs(mesh.points - goals).max()
    moved = mesh.points @ Rotation.from_rotvec([1, 2, -0.5]).as_matrix().T + [3, 4, 5]
    assert bend(moved, moved, 5) == pytest.approx(moved, abs=1e-9)  # a rigid motion is no bend


def test_rotations_are_those_of_the_singular_value_decomposition() -> None:
    """Flat, reflected and tiny covariances, too; where they leave a choice, one as good."""
    rng = np.random.default_rng(1)
    given = rng.standard_normal((400, 3, 3))
    given[:100, :, 2] *= 1e-3
    given[100:150, :, 2] = 0.0
    given[150:170, :, 1:] = 0.0
    given[170:180] = 0.0
    given[180:200] = np.eye(3) * rng.choice([-1.0, 1.0], size=(20, 3, 1))
    given *= 10.0 ** rng.uniform(-8, 3, size=(400, 1, 1))
    u, _, vt = np.linalg.svd(given)
    vt[np.linalg.det(u @ vt) < 0, 2] *= -1
    found, wanted = _rotations(given), np.swapaxes(u @ vt, 1, 2)
    np.testing.assert_allclose(found @ np.swapaxes(found, 1, 2), np.tile(np.eye(3), (400, 1, 1)),
                               atol=1e-9)  # fmt: skip
    np.testing.assert_allclose(np.linalg.det(found), 1.0, atol=1e-9)
    traces = np.einsum("nij,nji->n", found, given), np.einsum("nij,nji->n", wanted, given)
    np.testing.assert_allclose(*traces, rtol=1e-9)
    certain = np.r_[0:150, 200:400]
    np.testing.assert_allclose(found[certain], wanted[certain], atol=1e-8)


def test_bending_repairs_a_noisy_map(source, image) -> None:
    truth = np.arange(source.spectrum.n)
    near = np.linalg.norm(source.surface.points[:, None] - source.surface.points, axis=2)
    noisy = np.argsort(near, axis=1)[truth, np.random.default_rng(2).integers(12, size=len(truth))]
    assert (noisy != truth).mean() > 0.8
    for target, reflect in ((source, False), (image, True)):
        found = contact(source.surface, target.surface, noisy, mirrored=reflect, rounds=5).back
        assert (found == truth).all()


# --- candidates -----------------------------------------------------------------------------


def test_mirrored_candidates_are_those_of_the_mirror_image(source, image) -> None:
    truth = true_map(source, image, np.arange(source.spectrum.n))[:30, :30]
    left = [
        ((maps - truth) ** 2).sum(axis=(1, 2)).min()
        for maps in (
            sign_candidates(source, image, mirrored=mirrored, orders=32, growing=96)
            for mirrored in (True, False)
        )
    ]
    assert left[0] < 0.5 < left[1]


def test_a_random_map_covers_what_chance_does_however_finely_the_target_is_sampled() -> None:
    mass, rng = np.ones(400), np.random.default_rng(0)
    thrown = rng.integers(400, size=400)
    once = coverage_over_chance(mass, mass, thrown)
    assert once == pytest.approx(1, abs=0.06)
    ten = coverage_over_chance(mass, np.repeat(mass, 10) / 10, np.repeat(thrown, 10))
    assert ten == pytest.approx(once)


# --- candidates laid onto the target ---------------------------------------------------------


def turned(mesh: TriangleMesh, source: Prepared, *, image: bool = False) -> Prepared:
    """Elsewhere, in another unit, with the modes of the source."""
    made = mirrored(mesh) if image else mesh
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    made = TriangleMesh(2.5 * made.points @ turn + [3.0, -1.0, 2.0], made.faces)
    return prepare(source.spectrum.rescale(2.5 * np.sqrt(mesh.area)), made)


@pytest.mark.parametrize("image", [False, True])
def test_a_turned_copy_lies_on_its_source(mesh, source, image) -> None:
    """Nothing is known of how the two lie: the first candidate is the identity, all but exact."""
    sides = (
        side_of(source, mirrored=image),
        side_of(turned(mesh, source, image=image)),
    )
    C = rigid_candidates(*sides, MatchOptions().turns)[0]
    assert np.linalg.norm(C - np.eye(30)) < 0.05 * np.sqrt(30)
    made = bent(*sides, C)
    assert made.functional_map == pytest.approx(np.eye(60), abs=1e-8)
    assert made.distance < 1e-6


def test_normals_of_modes_are_those_of_triangles(source) -> None:
    """With more modes they come nearer: these leave out what is smaller than a limb."""
    side, surface = side_of(source), source.surface
    chosen = source.samples[:SAMPLES]
    points = surface.points - surface.mass @ surface.points
    axes = np.linalg.lstsq(points, source.spectrum.eigenvectors @ side.positions, rcond=None)[0]
    exact = outward_normals(surface.points, surface.oriented)[chosen] @ axes
    agree = [
        float((side.bent_normals(side.positions[:k]) * exact).sum(axis=1).mean()) for k in (8, 40)
    ]
    assert agree[0] < agree[1]
    assert agree[1] > 0.85


# --- lengths --------------------------------------------------------------------------------


def test_lengths_are_those_along_the_surface_and_the_same_for_a_copy(source, copy) -> None:
    target, truth = copy
    here, there = source.lengths, target.lengths
    ends = source.samples[: len(here)]
    np.testing.assert_array_equal(here[np.arange(len(here)), ends], 0)
    between = here[:, ends]
    np.testing.assert_allclose(between, between.T, rtol=1e-12)
    straight = np.linalg.norm(source.surface.points[ends][:, None] - source.surface.points, axis=2)
    assert (here >= straight * (1 - 1e-12)).all()
    back, forth = truth[target.samples[: len(there)]], np.argsort(truth)[ends]
    assert changed(here, there, back, forth) < 1e-12
    rolled = np.roll(forth, 7)
    assert changed(here, there, back, rolled) > 0.1
    assert changed(there, here, rolled, back) == pytest.approx(changed(here, there, back, rolled))


def test_a_surface_is_bent_onto_its_copy_and_nowhere_else(source, copy) -> None:
    """The true map leaves no distance; one that takes the animal to its other end does."""
    target, truth = copy
    there = np.argsort(truth)
    places = source.surface.points[:, 0]
    ranks = np.argsort(np.argsort(places))
    reversed_ends = np.argsort(places)[::-1][ranks]  # head to tail
    true, wrong = (
        contact(source.surface, target.surface, there[way], mirrored=False, rounds=5).gap
        for way in (np.arange(len(there)), reversed_ends)
    )
    assert true < 1e-9
    assert wrong > 0.01


# --- scores ---------------------------------------------------------------------------------


@pytest.mark.parametrize("rough", [False, True])
def test_nothing_is_wrong_with_the_true_map(source, copy, rough) -> None:
    target, truth = copy
    points = np.array([3, 500, 77])
    asked = {"rough": rough, "landmarks": (points, points)}
    identity = score_map(source, source, np.eye(K), **asked).mismatches
    assert set(identity) == {
        "embedding", "spacing", "wave", "curvature", "orientation", "landmarks"
    } | ({"lengths"} if not rough else set())  # fmt: skip
    if rough:  # the landmarks are looked for among the samples
        assert 0 < identity.pop("landmarks") < 0.05
    assert max(map(abs, identity.values())) < 1e-12
    assert score_of(identity) == pytest.approx(1e-3)
    if not rough:
        values = score_map(source, target, true_map(source, target, truth)).mismatches
        assert max(map(abs, values.values())) < 1e-6
    alone = prepare(source.spectrum)
    seen = score_map(alone, source, np.eye(K)).mismatches
    assert set(seen) == {"embedding", "spacing", "wave"}


def test_a_wrong_map_has_much_against_it(source) -> None:
    signs = np.where(np.random.default_rng(5).random(K) < 0.5, -1.0, 1.0)
    points = np.array([3, 500, 77])
    values = score_map(source, source, np.diag(signs), landmarks=(points, points)).mismatches
    assert values.pop("spacing") == 0  # it commutes with the Laplacian all the same
    assert min(values.values()) > 0.04
    assert max(values.values()) < 1.5
    rotated = np.linalg.qr(np.random.default_rng(6).normal(size=(K, K)))[0]
    assert score_map(source, source, rotated).mismatches["spacing"] > 0.1


def test_samples_are_linked_where_their_cells_meet(source) -> None:
    surface = source.surface
    every = np.random.default_rng(7).permutation(source.spectrum.n)  # each is its own cell
    linked = np.unique(np.sort(every[surface.links_between(every)], axis=1), axis=0)
    np.testing.assert_array_equal(linked, surface.edges)
    points = surface.points[source.samples]
    assert len(np.unique(source.links)) == len(points)
    assert lengths_of(points, source.links).max() < 8 * cKDTree(points).query(points, k=2)[0].max()


def test_a_foot_looks_like_another_foot_and_tips_of_tail_and_head_like_nothing() -> None:
    animal = prepared(creature(2000), K)
    points, wave = animal.surface.points[animal.samples], animal.wave[animal.samples]
    twins = points[animal.twins]
    assert np.linalg.norm(points - twins, axis=1).min() > 0.2  # each is elsewhere
    unlike = (np.abs(wave - wave[animal.twins]) / (wave + wave[animal.twins])).mean(axis=1)
    feet = points[:, 2] < points[:, 2].min() + 0.05
    assert twins[feet, 2].max() < points[:, 2].min() + 0.1
    assert unlike[[points[:, 0].argmin(), points[:, 0].argmax()]].min() > 1.5 * unlike[feet].max()


def test_what_bends_alike_meets_in_a_right_map_alone() -> None:
    one, other, truth = creature_pair(1000, 900, seed=1)
    a, b = prepared(one, K), prepared(other, K)
    points = a.surface.points
    there = nearest(points, points[truth])
    low, high = points.min(axis=0), points.max(axis=0)
    turned = nearest((low + high) * [1, 1, 0] + points * [-1, -1, 1], points)  # about the vertical
    every = np.arange(a.spectrum.n)
    assert bends_apart(a, a, every, every) == pytest.approx(0, abs=1e-12)
    right = bends_apart(a, b, there, truth)
    assert right < 0.5
    assert bends_apart(a, b, there[turned], turned[truth]) > right + 0.3
    sheet = prepared(rectangle(n=400).geometry, K)
    every = np.arange(sheet.spectrum.n)
    assert bends_apart(sheet, sheet, every, every) == 1  # nothing to go by


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_right_candidates_keep_neighbours_and_what_looks_alike(seed) -> None:
    one, other, truth = creature_pair(1000, 900, seed=seed)
    a, b = prepared(one, 100), prepared(other, 100)
    found = Search(a, b, None, QUICK).candidates(False)
    errors, costs = [], []
    for candidate in found:
        C = candidate.functional_map
        k = len(C)
        p = nearest(b.spectrum.eigenvectors[:, :k], a.spectrum.eigenvectors[:, :k] @ C.T)
        errors.append(np.linalg.norm(a.surface.points[p] - a.surface.points[truth], axis=1).mean())
        costs.append(unlike_cost(a, b, replace(candidate, score=1.0)))
    right = np.array(errors) < 0.05
    assert 0 < right.sum() < len(found)
    assert max(np.array(costs)[right]) < min(np.array(costs)[~right])
    itself = replace(found[0], functional_map=np.eye(K), score=1.0)
    assert unlike_cost(a, a, itself) == pytest.approx(0, abs=1e-9)


@pytest.mark.skipif(data_folder() is None, reason="set SPECTRA_KIT_DATA to the real shapes")
def test_the_tail_of_a_dog_is_no_leg_of_a_cat() -> None:
    files = [np.load(data_folder() / "smal_r" / f"{name}.npz") for name in ANIMALS]
    dog, cat = (TriangleMesh(file["V"], file["F"].astype(np.int64)) for file in files)
    found = match(dog, cat, mirrored=False)
    truth = Truth(*(file["corres"] for file in files))
    assert geodesic_errors(dog, found.point_map, truth).mean() < 6  # by scores alone 19


def test_the_orientation_of_a_map(source, copy, image) -> None:
    target, truth = copy
    assert orientation_of(source, source, np.eye(K)) == pytest.approx(1)
    C = true_map(source, target, truth)
    assert orientation_of(source, target, C) == pytest.approx(1)
    assert orientation_of(source, target, 2 * C) == pytest.approx(1)  # of any scale
    there = true_map(source, image, np.arange(len(truth)))
    assert orientation_of(source, image, there) == pytest.approx(-1)
    for turned, expected in ((True, 0), (False, 1)):
        values = score_map(source, image, there, mirrored=turned).mismatches
        assert values["orientation"] == pytest.approx(expected, abs=1e-9)
    assert orientation_of(image, source, there.T) == pytest.approx(-1)
    assert orientation_of(source, prepare(target.spectrum), C) is None
    rotated = np.linalg.qr(np.random.default_rng(6).normal(size=(K, K)))[0]
    assert abs(orientation_of(source, source, rotated)) < 0.2


def test_the_score_is_a_geometric_mean() -> None:
    assert score_of({"wave": 0.2, "spacing": 0.2, "curvature": 0.2}) == pytest.approx(0.201)
    low, high = score_of({"wave": 0.1, "embedding": 0.3}), score_of({"wave": 0.1, "embedding": 0.4})
    assert 0.1 < low < high < 0.4
    assert score_of({"wave": 0.0, "embedding": -1e-17}) == pytest.approx(1e-3)


def test_options_out_of_range_are_refused() -> None:
    refused("turns", "be at least 1", MatchOptions, turns=0)
    refused("mirrored_by", "be a finite weight", MatchOptions, mirrored_by=np.nan)


def test_options_are_what_their_documentation_says() -> None:
    told = dict(
        re.findall(r"^ *(\w+) : .*, default (.+)$", str(MatchOptions.__doc__), re.MULTILINE)
    )
    assert {name: literal_eval(value) for name, value in told.items()} == vars(MatchOptions())
