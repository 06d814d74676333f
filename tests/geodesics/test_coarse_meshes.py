"""Coarse meshes: exact distances in place of the heat method, or a word about its errors."""

import numpy as np
import pytest
from conftest import creature, joined, moved
from geodesic_truths import by_libigl, cube, flat_square, middle_of, relative_error, soup, too_large

from spectra_kit.errors import DoubtfulDistanceWarning, SplitSurfaceWarning
from spectra_kit.geodesics import (
    Direct,
    Exact,
    FacePoint,
    HeatGeodesics,
    check_sources,
    geodesic_distance,
)
from spectra_kit.geometry import TriangleMesh, rectangle, repair, sphere


def bipyramid(sides: int) -> tuple[np.ndarray, list[list[int]]]:
    """Two flat pyramids over a polygon, with needles for faces."""
    turn = 2 * np.pi * np.arange(sides) / sides
    rim = np.c_[5 * np.cos(turn), 5 * np.sin(turn), 0 * turn]
    faces = [[i, (i + 1) % sides, sides] for i in range(sides)]
    faces += [[(i + 1) % sides, i, sides + 1] for i in range(sides)]
    return np.vstack([rim, [[0, 0, 0.2], [0, 0, -0.2]]]), faces


COARSE = {
    "square": (flat_square(), [0, 1, np.sqrt(2), 1]),
    "a large square": (flat_square(1e6), [0, 1e6, np.sqrt(2) * 1e6, 1e6]),
    # A path to the far corner crosses two unfolded squares.
    "cube": (cube(), np.sqrt([0, 1, 1, 2, 1, 2, 2, 5])),
    "ball": (sphere(subdivisions=0).geometry, None),
    "bipyramid": (TriangleMesh(*bipyramid(5)), None),
}


@pytest.mark.parametrize("name", COARSE)
def test_coarse_meshes_take_exact_distances_and_the_heat_method_is_doubted(name) -> None:
    mesh, truth = COARSE[name]
    truth = by_libigl(mesh, 0) if truth is None else truth
    field = geodesic_distance(mesh, 0)
    assert field.distance == pytest.approx(truth, rel=1e-8)
    assert (field.solver, field.choice) == (Exact(), "exact: at most 2000 vertices")
    assert "iterations" not in repr(field)
    heat = HeatGeodesics(mesh)
    with too_large as told:
        off = relative_error(heat.distance(0), field.distance)
    assert off > 0.0375
    assert f"by {off:.0%}" in str(told[0].message)
    with too_large:  # of which it was told already; other sources are no better
        heat.distances([mesh.n - 1])


def test_a_coarse_part_is_told_of_beside_a_fine_one() -> None:
    """By as much as alone; of the other nothing is said."""
    coarse = sphere(subdivisions=0).geometry
    off = relative_error(by_heat(coarse, 0), by_libigl(coarse, 0))
    heat = HeatGeodesics(joined(creature(1500), moved(coarse, 9, 0, 0)))
    heat.distance(0)
    with pytest.warns(DoubtfulDistanceWarning, match=f"from vertex 1500 are off by {off:.0%}"):
        heat.distance(1500)


def by_heat(mesh: TriangleMesh, source: int) -> np.ndarray:
    with too_large:
        return HeatGeodesics(mesh).distance(source).distance


def test_coarse_meshes_in_parts_are_told_of() -> None:
    ball = sphere(subdivisions=1).geometry
    loose = soup(ball)
    with pytest.warns(SplitSurfaceWarning, match="80 parts, and has 1 if they are joined"):
        assert geodesic_distance(loose, 0).reached.sum() == 3
    joined = repair(loose)
    found = geodesic_distance(joined.geometry, joined.new_index[0]).distance
    assert joined.restore(found) == pytest.approx(
        by_libigl(ball, ball.faces[0, 0])[ball.faces].ravel()
    )


def test_triangles_too_thin_for_exact_distances_take_the_heat_method() -> None:
    ball = sphere(subdivisions=1).geometry
    needle = ball.with_points(ball.points * [1e7, 1, 1])
    assert geodesic_distance(needle, 5).poisson is not None


@pytest.mark.parametrize("shape", [sphere(subdivisions=3), rectangle(n=300), rectangle(n=1200)])
def test_well_resolved_meshes_are_not_doubted(shape) -> None:
    mesh, source = shape.geometry, middle_of(shape.geometry)
    assert relative_error(HeatGeodesics(mesh).distance(source), by_libigl(mesh, source)) < 0.0375


def test_each_part_is_doubted_by_its_own_triangles() -> None:
    fine, coarse = sphere(subdivisions=3).geometry, cube()
    heat = HeatGeodesics(joined(fine, moved(coarse, 5, 5, 5)))
    heat.distance(0)
    with too_large:
        heat.distance(fine.n)


def test_what_only_the_heat_method_has_is_left_to_it() -> None:
    mesh = rectangle(n=500).geometry
    exact = geodesic_distance(mesh, [0, 7])
    assert exact.distance == pytest.approx(by_libigl(mesh, 0, 7), rel=1e-8)
    for options in ({"time_coefficient": 2.0}, {"solver": Direct()}, {"weights": [1, 2]}):
        assert geodesic_distance(mesh, [0, 7], **options).solver == Direct()
    point = FacePoint(3, (0.2, 0.3, 0.5))
    assert geodesic_distance(mesh, check_sources(point, mesh)).solver == Direct()
    assert geodesic_distance(mesh, point).solver == Exact()
    assert geodesic_distance(mesh.as_cloud(), 0).solver == Direct()
    assert geodesic_distance(creature(2200, seed=0), 0).solver == Direct()
