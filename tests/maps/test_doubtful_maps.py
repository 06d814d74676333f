"""Maps of what has none, of what has many, of parts; and what is known before: it is kept."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh
from conftest import creature, refused
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from test_match import QUICK

from spectra_kit import TriangleMesh, robust_laplacian
from spectra_kit.eigen import eigensolve
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.geometry import (
    Geometry,
    creature_pair,
    disk,
    largest_component,
    mirrored,
    permuted,
    rectangle,
    sphere,
    torus,
)
from spectra_kit.maps import Match, Prepared, match, match_part, partial, prepare
from spectra_kit.maps.surface import clustered, topology_of

K = 50
STIFF = {"elastic": False, "options": QUICK}


@cache
def prepared(geometry: Geometry, k: int = K) -> Prepared:
    return prepare(eigensolve(robust_laplacian(geometry), k), geometry)


def doubted(*pair: Geometry, **options: object) -> Match:
    with pytest.warns(DoubtfulMatchWarning):
        return match(*map(prepared, pair), **options)


def ball_with(radius: np.ndarray) -> TriangleMesh:
    ball = sphere(subdivisions=3).geometry
    return ball.with_points(ball.points * np.reshape(radius, (-1, 1)))


def part_of(mesh: TriangleMesh, kept: np.ndarray) -> TriangleMesh:
    faces = mesh.faces[kept[mesh.faces].all(axis=1)]
    return largest_component(TriangleMesh(mesh.points, faces)).mesh


# --- what a surface is ----------------------------------------------------------------------


@pytest.mark.parametrize("holes", [0, 1, 3])
@pytest.mark.parametrize(
    ("mesh", "genus"),
    [(sphere(subdivisions=3).geometry, 0), (torus(n=800).geometry, 1)],
    ids=["ball", "ring"],
)
def test_handles_are_counted(mesh, genus, holes) -> None:
    """Holes are no handles."""
    apart = [0, mesh.n // 3, 2 * mesh.n // 3][:holes]
    centres = [int(mesh.faces[(mesh.faces == v).any(axis=1)][0, 0]) for v in apart]
    left_out = np.isin(mesh.faces, centres).any(axis=1)
    holed = TriangleMesh(mesh.points, mesh.faces[~left_out]).without_unreferenced()
    found = topology_of(prepared(holed, 30).surface)
    assert found.genus == genus
    assert (found.rim > 0) == (holes > 0)


def rim_of(mesh: TriangleMesh) -> float:
    return topology_of(prepared(mesh, 30).surface).rim


@pytest.mark.parametrize("cosine", [-0.5, 0.0, 0.6])
def test_rims_of_caps_are_known(cosine) -> None:
    """Beyond a circle of latitude of a sphere is the less, the more the sphere faces as it does."""
    ball = sphere(subdivisions=5).geometry
    cap = part_of(ball, ball.points[:, 2] <= cosine)
    wide = np.pi * (1 - cosine**2) * (1 - max(cosine, 0))  # the circle, less what looks through it
    area = 2 * np.pi * (1 + cosine)
    assert rim_of(cap) == pytest.approx(np.sqrt(4 * np.pi * wide / area), rel=0.05)


@pytest.mark.parametrize("width", [1.0, 3.0])
def test_the_rim_of_a_flat_sheet_is_the_border_of_a_disc_as_large(width) -> None:
    """Whatever its form, and turned over; that of a disc is its border itself."""
    sheet = rectangle(width=width, height=1.0, n=900).geometry
    for faces in (sheet.faces, sheet.faces[:, ::-1]):
        flat = TriangleMesh(sheet.points, faces)
        assert rim_of(flat) == pytest.approx(np.sqrt(4 * np.pi), rel=1e-9)
    assert rim_of(disk().geometry) == pytest.approx(2 * np.pi / np.sqrt(np.pi), rel=1e-9)


def test_rims_of_a_tube_are_those_of_its_two_ends_and_gaps_in_it_are_none() -> None:
    """However ragged these are: the plane of a hole in a wall is that of the wall."""
    n = 60
    i, j = np.divmod(np.arange(n * n), n)
    turn = 2 * np.pi * j / n
    points = np.column_stack([np.cos(turn), np.sin(turn), 5 * i / (n - 1)])
    a, b = np.arange(n * (n - 1)), (i * n + (j + 1) % n)[: n * (n - 1)]
    tube = TriangleMesh(
        points, np.vstack([np.column_stack(t) for t in ((a, b, a + n), (b, b + n, a + n))])
    )
    ends = np.sqrt(4 * np.pi * 2 * np.pi / tube.area)
    assert rim_of(tube) == pytest.approx(ends, rel=0.02)
    rng = np.random.default_rng(0)
    gap = np.linalg.norm(tube.points - [1, 0, 2.5], axis=1) < 0.5
    at_rim = gap[tube.faces].any(axis=1)
    torn = at_rim & (gap[tube.faces].all(axis=1) | (rng.random(len(at_rim)) < 0.5))
    torn = largest_component(TriangleMesh(tube.points, tube.faces[~torn])).mesh
    assert rim_of(torn) == pytest.approx(ends * np.sqrt(tube.area / torn.area), rel=0.02)


def test_what_is_no_surface_has_no_genus() -> None:
    assert topology_of(prepared(creature(600).as_cloud(), 30).surface).genus is None
    ball = sphere(subdivisions=2).geometry
    cut = TriangleMesh(ball.points, ball.faces[np.arange(len(ball.faces)) % 7 > 0])
    rim = topology_of(prepared(part_of(cut, np.ones(cut.n, bool)), 30).surface)
    assert rim.genus is None  # its holes meet at corners


def test_eigenvalues_in_clusters_are_seen() -> None:
    """The exact ones of a sphere; by chance (Poisson, Weyl's law) the mean is 1."""
    degrees = np.arange(5)
    assert clustered(np.repeat(degrees * (degrees + 1.0), 2 * degrees + 1)) > 3
    rng = np.random.default_rng(0)
    drawn = [clustered(np.cumsum([0, *rng.exponential(size=10)])) for _ in range(4000)]
    assert np.mean(drawn) == pytest.approx(1, abs=0.1)  # quotients of sums: nearly independent
    ratio = (1 + 5**0.5) / 2
    pairs = np.sort([(m * np.pi) ** 2 + (n * np.pi / ratio) ** 2 for m, n in np.ndindex(5, 5)])
    assert clustered(pairs) < 1.5


# --- no answer, or many ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "other",
    [creature(600), torus(n=600).geometry, sphere(subdivisions=3).geometry],
    ids=["animal", "ring", "ball"],
)
def test_noise_is_no_map_of_anything(other) -> None:
    ball = sphere(subdivisions=3).geometry
    noise = np.random.default_rng(0).normal(size=ball.points.shape)
    found = doubted(ball.with_points(ball.points + 0.3 * noise), other, **STIFF)
    assert not found.convincing
    assert {"score", "alike"} & set(found.doubts)


def test_a_ring_is_no_ball() -> None:
    found = doubted(torus(n=600).geometry, sphere(subdivisions=3).geometry, **STIFF)
    assert found.genera == (1, 0)
    assert "genera" in found.doubts
    assert not found.convincing


x, y, z = sphere(subdivisions=3).geometry.points.T
ROUND = {
    "ball": np.ones_like(x),
    "spindle": 1 + 0.5 * z**2,
    "nearly round": 1 + 0.05 * x * y,
}


@pytest.mark.parametrize("radius", ROUND.values(), ids=ROUND.keys())
def test_round_surfaces_are_ambiguous_until_told(radius) -> None:
    """By twelve landmarks, or by where the points are."""
    one = ball_with(radius)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    other, truth = permuted(ball_with(radius + 0.02 * np.sin(5 * x + 3 * z)), seed=2)
    moved = other.with_points(other.points @ turn)
    found = doubted(one, moved, mirrored=False, **STIFF)
    assert found.ambiguous
    assert found.alike
    assert found.confidence <= 0.5
    there = np.arange(0, one.n, one.n // 12)
    by_landmarks = match(
        *map(prepared, (one, moved)), landmarks=(truth[there], there), options=QUICK, mirrored=False
    )
    near = cKDTree(one.points).query(other.points)[1]
    by_places = match(*map(prepared, (one, other)), initial=near, mirrored=False, options=QUICK)
    spacing = np.sqrt(4 * np.pi / one.n)
    for told in (by_landmarks, by_places):
        assert not told.alike
        assert told.convincing
        apart = np.linalg.norm(one.points[told.point_map] - one.points[truth], axis=1)
        assert apart.mean() < 3 * spacing


def test_two_parts_are_not_taken_for_wholes(monkeypatch) -> None:
    """Nor a part for a whole, however well they fit; but small holes hide nothing."""
    for name, value in (("_TRIED", 2), ("_REFINED", 1), ("_ENDS", 4)):
        monkeypatch.setattr(partial, name, value)
    monkeypatch.setattr(partial, "_SHARES", partial._SHARES[::3])
    one, other, rest = creature(700, pose=1), creature(700, pose=2), creature(700, pose=0)
    front, back = part_of(one, rest.points[:, 0] < 0.1), part_of(other, rest.points[:, 0] > -0.1)
    for pair in ((front, back), (front, other)):
        found = doubted(*pair, **STIFF)
        assert "rims" in found.doubts
        assert not found.convincing
        assert found.confidence < 0.4
    with pytest.warns(DoubtfulMatchWarning, match="the whole is cut off, too"):
        found = match_part(prepared(front), prepared(back), mirrored=False, options=QUICK)
    assert not found.convincing
    assert found.confidence < 0.4
    middle = np.linalg.norm(rest.points - rest.points[0], axis=1) > 0.08
    holed = [part_of(mesh, middle) for mesh in (one, other)]
    found = match(*map(prepared, holed), **STIFF)
    assert min(found.rims) > 0
    assert found.convincing


def test_many_small_holes_are_no_cut() -> None:
    """Whose borders together are longer than that of a part."""
    one, other = creature(1000, pose=1), creature(1000, pose=2)
    holed = part_of(one, ~np.isin(np.arange(1000), [100, 400, 650, 900]))
    found = match(prepared(holed), prepared(other), **STIFF)
    sides = np.sort(np.concatenate([holed.faces[:, [c - 1, c]] for c in range(3)]), axis=1)
    edges, uses = np.unique(sides, axis=0, return_counts=True)
    ends = holed.points[edges[uses == 1]]
    border = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum() / np.sqrt(holed.area)
    assert border > 0.6
    assert 0 < found.rims[0] < border / 2
    assert found.rims[1] == 0
    assert "rims" not in found.doubts
    assert found.convincing


def test_a_gap_in_a_plane_has_no_rim() -> None:
    """A box with a triangle missing in one side, turned at random: rounding is no length."""
    box = trimesh.creation.box(extents=(1.0, 1.3, 0.7))
    for _ in range(3):
        box = box.subdivide()
    side = np.flatnonzero(box.face_normals[:, 2] > 0.9)
    middle = side[np.linalg.norm(box.triangles_center[side, :2] - [0.05, 0.1], axis=1).argmin()]
    faces, rng = np.delete(box.faces, middle, axis=0), np.random.default_rng(0)
    for turn in Rotation.random(6, rng=rng):
        holed = TriangleMesh(turn.apply(box.vertices), faces)
        assert rim_of(holed) == pytest.approx(0, abs=1e-6)


def test_gaps_in_a_wall_are_no_cut() -> None:
    """Eight in the trunk, of 5 % of the area: as wide as what a leg leaves."""
    one, other, rest = (creature(1500, pose=pose) for pose in (1, 2, 0))
    x, _, z = rest.points.T
    trunk = np.flatnonzero((x > -0.6) & (x < 0.5) & (z > -0.1))
    chosen = rest.points[np.random.default_rng(0).choice(trunk, 8)]
    left = cKDTree(chosen).query(rest.points)[0] > 0.1
    holed = part_of(one, left)
    assert holed.area < 0.95 * one.area
    around = len(holed.boundary_vertices) * np.sqrt(holed.area / holed.n)  # edges of about a length
    assert around / np.sqrt(8 * holed.area) > 0.5  # what eight round holes of that length count
    found = match(prepared(holed), prepared(other), mirrored=False, options=QUICK)
    assert found.rims[0] < 0.5
    assert found.convincing


# --- what is known before -------------------------------------------------------------------


def test_landmarks_hold_or_are_told() -> None:
    """Where they are right, in the map; four exchanged ones are named as lost."""
    one, other, truth = creature_pair(700, 600, seed=2)
    a, b = prepared(one), prepared(other)
    there = np.arange(0, 600, 50)
    here = truth[there]
    found = match(a, b, landmarks=(here, there), precise=True, options=QUICK)
    assert found.landmarks_held.all()
    assert (found.point_map[there] == here).all()
    assert (found.precise @ one.points)[there] == pytest.approx(one.points[here])
    wrong = here.copy()
    wrong[:4] = here[[6, 7, 8, 9]]
    with pytest.warns(DoubtfulMatchWarning, match="4 of 12 landmarks are lost"):
        mixed = match(a, b, landmarks=(wrong, there), options=QUICK)
    assert "landmark_distances" in mixed.doubts
    assert not mixed.landmarks_held[:4].any()
    held = mixed.landmarks_held
    assert (mixed.point_map[there[held]] == wrong[held]).all()
    assert mixed.confidence < found.confidence


@pytest.mark.parametrize("kind", ["mesh", "cloud", "mirrored", "alone"])
def test_an_initial_map_is_refined(kind) -> None:
    """From the points nearest to where noise takes them, a copy is found again; nothing else is."""
    mesh = creature(600)
    copy, truth = permuted(mesh, seed=4)
    noise = 0.03 * np.random.default_rng(0).normal(size=copy.points.shape)
    near = cKDTree(mesh.points).query(copy.points + noise)[1]
    assert (near != truth).mean() > 0.2
    if kind == "mirrored":
        image = mirrored(copy)
        copy = TriangleMesh(image.points, image.faces)
    one, other = (m.as_cloud() if kind == "cloud" else m for m in (mesh, copy))
    a, b = prepared(one), prepared(other)
    if kind == "alone":
        a, b = prepare(a.spectrum), prepare(b.spectrum)
    found = match(a, b, initial=near)
    # Modes alone cannot tell the two sides of a thin limb.
    assert (found.point_map == truth).mean() >= (0.95 if kind == "alone" else 1)
    assert len(found.candidates) == 1
    assert found.doubts == ("initial",)
    assert found.convincing
    assert not found.ambiguous
    assert found.mirrored == (kind == "mirrored")
    refused("initial", "have shape (600,)", match, a, b, initial=near[:-1])
    refused("initial", "be in [0, 600)", match, a, b, initial=near + 600)


def test_an_initial_map_of_dense_surfaces_is_one_of_all_points() -> None:
    mesh = creature(2400)
    side = prepare(eigensolve(robust_laplacian(mesh), K), mesh, n_points=1000)
    assert side.subsample is not None
    found = match(side, side, initial=np.arange(mesh.n), mirrored=False)
    assert (found.point_map == np.arange(mesh.n)).mean() > 0.9


def test_sheets_may_be_open() -> None:
    sheet = rectangle(n=400).geometry
    assert (
        "rims"
        not in match(prepared(sheet, 40), prepared(sheet, 40), mirrored=False, **STIFF).doubts
    )
