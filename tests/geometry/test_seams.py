"""Surfaces whose vertices are repeated along seams: told, joined on request; and faces turned."""

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from conftest import bumpy, creature, joined, moebius, moved, refused

import spectra_kit as sk
from spectra_kit import PointCloud, TriangleMesh
from spectra_kit.errors import SplitSurfaceWarning
from spectra_kit.geometry import diagnose, rectangle, repair, sphere, torus, write
from spectra_kit.operators import intrinsic_delaunay

RNG = np.random.default_rng
TOLD = r"boundary edges lie on others.*geometry\.repair\(mesh\)"


def corners(mesh: TriangleMesh, noise: float = 0.0) -> TriangleMesh:
    """Each face with corners of its own, as flat shading and STL have them."""
    points = mesh.points[mesh.faces].reshape(-1, 3)
    points += noise * RNG(0).standard_normal(points.shape)
    return TriangleMesh(points, np.arange(len(points)).reshape(-1, 3))


def islands(mesh: TriangleMesh, which: np.ndarray, noise: float = 0.0) -> TriangleMesh:
    """The faces of each number with vertices of their own, as charts of a texture have them."""
    parts = [TriangleMesh(mesh.points, mesh.faces[which == i]) for i in np.unique(which)]
    cut = joined(*(part.without_unreferenced() for part in parts))
    return cut.with_points(cut.points + noise * RNG(1).standard_normal((cut.n, 3)))


def slit(mesh: TriangleMesh, noise: float = 0.0) -> TriangleMesh:
    """One part with a cut in it: vertices along half a meridian are there twice."""
    x, y, _ = mesh.points.T
    on = np.flatnonzero((np.abs(y) < 1e-9) & (x > 0.5))
    copy = np.arange(mesh.n)
    copy[on] = mesh.n + np.arange(len(on))
    left = mesh.points[mesh.faces].mean(axis=1)[:, 1] < 0
    faces = np.where(left[:, None], copy[mesh.faces], mesh.faces)
    points = np.vstack([mesh.points, mesh.points[on]])
    return TriangleMesh(points + noise * RNG(2).standard_normal(points.shape), faces)


def far_away(mesh: TriangleMesh) -> TriangleMesh:
    return mesh.with_points((mesh.points + 30).astype(np.float32).astype(np.float64))


def ring() -> TriangleMesh:
    return torus(n=400).geometry


def octants(mesh: TriangleMesh) -> np.ndarray:
    return (mesh.points[mesh.faces].mean(axis=1) > 0) @ [1, 2, 4]


BALL = sphere(subdivisions=2).geometry
CUT: dict[str, tuple[TriangleMesh, TriangleMesh]] = {
    "corners": (BALL, corners(BALL)),
    "corners, rounded": (BALL, corners(BALL, 1e-7)),
    "corners, rounded to float32 far away": (BALL, far_away(corners(BALL, 1e-6))),
    "charts": (ring(), islands(ring(), octants(ring()))),
    "charts, rounded": (ring(), islands(ring(), octants(ring()), 1e-6)),
    "random charts": (bumpy(), islands(bumpy(), RNG(0).integers(0, 5, 1280), 1e-7)),
    "slit": (ring(), slit(ring())),
    "slit, rounded": (ring(), slit(ring(), 1e-7)),
    "two charts of a scan with a rim": (
        rectangle(n=400).geometry,
        islands(rectangle(n=400).geometry, octants(moved(rectangle(n=400).geometry, -0.5, 0, 0))),
    ),
    "in other units, rounded": (
        moved(BALL, 0, 0, 0, scale=1e6),
        moved(corners(BALL, 1e-7), 0, 0, 0, scale=1e6),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CUT)
def test_what_is_cut_is_told_and_repair_gives_the_spectrum_of_the_whole(name: str) -> None:
    whole, cut = CUT[name]
    with pytest.warns(SplitSurfaceWarning, match=TOLD) as told:
        sk.spectrum(cut, 6)
    assert len(told) == 1
    found, repaired = diagnose(cut), repair(cut)
    assert found.seam_edges > 0
    assert not found.is_clean
    assert diagnose(repaired.geometry).is_clean
    assert repaired.geometry.n == whole.n
    assert repaired.report.merged_points + repaired.report.near_points == cut.n - whole.n
    assert ("rounded" in name) <= (repaired.report.near_points > 0)
    moved_by = np.linalg.norm(repaired.restore(repaired.geometry.points) - cut.points, axis=1)
    assert moved_by.max() < 0.01 * np.sqrt(whole.area / len(whole.faces))
    truth, again = (  # no flips, that rounding decides where four points are on a circle
        sk.eigensolve(sk.cotan_laplacian(mesh), 8).eigenvalues
        for mesh in (whole, repaired.geometry)
    )
    rounding = 1e-9 if found.near_points == 0 else 1e-4
    np.testing.assert_allclose(again, truth, rtol=rounding, atol=1e-9 * truth[-1])


@pytest.mark.parametrize(
    "operator",
    [
        sk.robust_laplacian,
        sk.cotan_laplacian,
        sk.delaunay_laplacian,
        intrinsic_delaunay,
        sk.laplacian,
        sk.HeatGeodesics,
        lambda mesh: sk.laplacian(mesh, operator="cotan"),
        lambda mesh: sk.spectrum(mesh, 4),
    ],
)
def test_every_operator_tells_once(operator: Callable[[TriangleMesh], object]) -> None:
    with pytest.warns(SplitSurfaceWarning) as told:
        operator(corners(sphere(subdivisions=1).geometry))
    assert [str(one.message) for one in told] == [
        "240 boundary edges lie on others, whose 198 vertices repeat earlier ones: the surface"
        " falls into 80 parts, and has 1 if they are joined; join them with geometry.repair(mesh)"
    ]


def test_a_slit_is_told_as_one() -> None:
    with pytest.warns(SplitSurfaceWarning, match="the surface is slit open there, in 1 part;"):
        sk.laplacian(slit(ring()))


def strip(*, gap: float) -> TriangleMesh:
    """Two sheets side by side, a gap apart."""
    sheet = rectangle(n=100).geometry
    return joined(sheet, moved(sheet, 1 + gap, 0, 0))


def stacked(gap: float) -> TriangleMesh:
    sheet = rectangle(n=100).geometry
    return joined(sheet, moved(sheet, 0, 0, gap))


def tin_cans(n: int = 12) -> TriangleMesh:
    """Many open parts that run into each other, as those of an aircraft do."""
    can = TriangleMesh(BALL.points, BALL.faces[BALL.points[BALL.faces].mean(1)[:, 2] < 0.8])
    can = can.without_unreferenced()
    return joined(*(moved(can, *RNG(i).random(3), scale=0.3) for i in range(n)))


def touching_at_a_point() -> TriangleMesh:
    sheet = rectangle(n=100).geometry
    corner = sheet.points.min(axis=0)
    return joined(sheet, sheet.with_points(2 * corner - sheet.points))


def square(n: int) -> TriangleMesh:
    return rectangle(n=n, height=1.0).geometry


def tiled(*resolutions: int) -> TriangleMesh:
    """Squares in a row, each with as many points as is said: sides of one and the next differ."""
    tiles = map(square, resolutions)
    return joined(*(moved(tile, i, 0, 0) for i, tile in enumerate(tiles)))


def box(noise: float) -> TriangleMesh:
    """Six squares with other points on each, so that no two sides fit."""
    sides = []
    for i, n in enumerate((49, 64, 100, 121, 81, 144)):
        points = np.roll(square(n).points + [0, 0, i % 2], i // 2, axis=1)
        sides.append(TriangleMesh(points, square(n).faces))
    whole = joined(*sides)
    return whole.with_points(whole.points + noise * RNG(3).standard_normal((whole.n, 3)))


@pytest.mark.parametrize("noise", [0.0, 1e-7])
def test_faces_are_cut_where_vertices_of_others_lie_inside_their_edges(noise: float) -> None:
    row = tiled(400, 1600, 900)
    row = row.with_points(row.points + noise * RNG(3).standard_normal((row.n, 3)))
    told = "vertices lie inside boundary edges of other faces: the surface falls into 3 parts, and "
    with pytest.warns(SplitSurfaceWarning, match=told):
        sk.robust_laplacian(row)
    assert diagnose(row).hanging_vertices > 60
    repaired = repair(row)
    assert diagnose(repaired.geometry).is_clean
    assert repaired.report.hanging_vertices == diagnose(row).hanging_vertices
    modes = sk.spectrum(repaired.geometry, 5)
    x, y = np.mgrid[:5, :3]  # a rectangle of 3 by 1, whose boundary is free
    exact = np.sort((np.pi**2 * (x**2 / 9 + y**2)).ravel())[:5]
    np.testing.assert_allclose(modes.eigenvalues, exact, rtol=3e-3, atol=1e-9)
    closed = repair(box(noise)).geometry
    assert diagnose(closed).euler_characteristic == 2
    assert diagnose(closed).boundary_edges == 0
    np.testing.assert_allclose(closed.area, 6, rtol=1e-5)


APART: dict[str, TriangleMesh] = {
    "stacked closely, with other points": joined(
        rectangle(n=100).geometry, moved(rectangle(n=144).geometry, 0, 0, 1e-5)
    ),
    "a cap whose corner lies on its side": TriangleMesh(
        [[0, 0, 0], [2, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1, 2], [0, 2, 3]]
    ),
    "side by side": strip(gap=0.01),
    "stacked": stacked(1e-3),
    "stacked closely": stacked(1e-5),
    "tin cans": tin_cans(),
    "touching at a point": touching_at_a_point(),
    "touching at a corner of two balls": joined(BALL, moved(BALL, 2, 0, 0)),
    "open at a thin slit": slit(ring()).with_points(
        slit(ring()).points + 0.005 * (np.arange(slit(ring()).n) >= ring().n)[:, None]
    ),
    "whole": BALL,
    "two parts": joined(BALL, moved(BALL, 5, 0, 0)),
    "one triangle": TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]),
    "one-sided": moebius(),
}


@pytest.mark.parametrize("name", APART)
def test_what_is_only_near_or_touches_in_a_point_is_left_apart(name: str) -> None:
    mesh = APART[name]
    with warnings.catch_warnings():
        warnings.simplefilter("error", SplitSurfaceWarning)
        sk.robust_laplacian(mesh)
    assert diagnose(mesh).seam_edges == diagnose(mesh).hanging_vertices == 0
    assert repair(mesh).report.near_points == 0


def test_a_tolerance_joins_what_lies_nearer_and_moves_no_point_farther() -> None:
    mesh = strip(gap=0.01)
    repaired = repair(mesh, tolerance=0.011)
    assert len(np.unique(repaired.geometry.component_labels)) == 1
    assert repaired.report.near_points == 2 * mesh.n - mesh.n - repaired.geometry.n
    assert repair(mesh, tolerance=0.009).report.near_points == 0
    assert repair(corners(BALL, 1e-7), tolerance=0.0).geometry.n == 3 * len(BALL.faces)
    back = repaired.restore(repaired.geometry.points)
    assert np.linalg.norm(back - mesh.points, axis=1).max() <= 0.011
    refused("tolerance", "be a length", repair, mesh, tolerance=-1.0)


def test_a_row_of_points_is_not_drawn_together() -> None:
    row = PointCloud(np.c_[0.6 * np.arange(50), np.zeros((50, 2))])
    repaired = repair(row, tolerance=1.0)
    assert repaired.report.near_points == 25
    back = repaired.restore(repaired.geometry.points)
    assert np.linalg.norm(back - row.points, axis=1).max() <= 1.0
    cloud = PointCloud(RNG(0).random((500, 3)))
    repaired = repair(cloud, tolerance=0.1)
    kept, back = repaired.geometry.points, repaired.restore(repaired.geometry.points)
    apart = np.linalg.norm(kept[:, None] - kept, axis=2) + np.eye(len(kept))
    assert apart.min() > 0.1
    assert np.linalg.norm(back - cloud.points, axis=1).max() <= 0.1


@pytest.mark.parametrize("ending", ["glb", "obj", "ply", "off", "npz"])
def test_files_with_corners_of_their_own_give_the_closed_surface(ending: str, tmp_path) -> None:
    path = tmp_path / f"flat.{ending}"
    write(corners(BALL), path)
    with pytest.warns(SplitSurfaceWarning, match=TOLD):
        assert sk.spectrum(path, 3).n_zero_modes == 3
    mended = repair(sk.geometry.read(path)).geometry
    assert mended.n == BALL.n
    assert diagnose(mended).euler_characteristic == 2


# --- winding ------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.001, 0.1, 0.4])
@pytest.mark.parametrize("mesh", [BALL, ring(), creature(600), rectangle(n=300).geometry])
def test_faces_against_their_neighbours_are_turned_the_fewer_of_them(mesh, share) -> None:
    faces, chosen = np.array(mesh.faces), RNG(0).random(len(mesh.faces)) < share
    chosen[0] = True
    faces[chosen] = faces[chosen][:, ::-1]
    mixed = TriangleMesh(mesh.points, faces)
    found = diagnose(mixed)
    assert found.turned_faces == chosen.sum()
    assert found.clashing_edges == 0
    assert any("wound against" in str(problem) for problem in found.problems)
    repaired = repair(mixed)
    assert repaired.report.turned_faces == chosen.sum()
    corner = np.argmin(mesh.faces, axis=1)[:, None]  # faces may begin with another corner
    for f in (0, 1, 2):
        step = np.take_along_axis(mesh.faces, (corner + f) % 3, axis=1)
        turned = repaired.geometry.faces
        first = np.argmin(turned, axis=1)[:, None]
        np.testing.assert_array_equal(np.take_along_axis(turned, (first + f) % 3, axis=1), step)


def test_every_part_is_turned_on_its_own_and_none_needlessly() -> None:
    inside_out = TriangleMesh(BALL.points, BALL.faces[:, ::-1])
    both = joined(BALL, moved(inside_out, 5, 0, 0))
    assert repair(both).report.turned_faces == 0
    np.testing.assert_array_equal(repair(both).geometry.faces, both.faces)


def test_what_has_one_side_is_told_not_refused() -> None:
    strip = moebius(n=60, m=6)
    found, repaired = diagnose(strip), repair(strip)
    assert found.clashing_edges == 5  # one line across the strip of five quads
    assert "no turning makes agree" in str(found.problems[0])
    assert diagnose(repaired.geometry).clashing_edges == 5
    faces = np.array(strip.faces)
    faces[::3] = faces[::3, ::-1]
    assert diagnose(TriangleMesh(strip.points, faces)).clashing_edges <= 10
    assert sk.spectrum(strip, 4).n_zero_modes == 1


def test_seams_are_joined_before_faces_are_turned() -> None:
    mesh = corners(BALL, 1e-7)
    faces = np.array(mesh.faces)
    faces[::4] = faces[::4, ::-1]
    repaired = repair(TriangleMesh(mesh.points, faces))
    assert repaired.report.turned_faces == len(faces[::4])
    assert diagnose(repaired.geometry).is_clean
