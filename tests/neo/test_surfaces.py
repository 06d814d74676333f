"""Surfaces of the corpus: families that follow from seeds, and the clay that they are made of."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import implicit as clay
from spectra_kit.geometry import sphere
from spectra_kit.neo.train import bodies, surfaces
from spectra_kit.neo.train.families import FAMILIES, draw_family, make_mesh
from spectra_kit.neo.train.samples import CorpusConfig, draw_source, make_surface

OF_ONE_PIECE = {
    *("quadruped", "biped", "organism", "blob", "porous", "machined"),
    *("symmetric", "sculpture", "lattice"),
}


@pytest.mark.parametrize("family", FAMILIES)
def test_meshes_follow_from_the_seed_and_are_of_order_one(family):
    mesh = None
    for seed in (0, (7, 1)):
        first, mesh = mesh, make_mesh(family, seed)
        assert 0.3 < np.ptp(mesh.points, axis=0).max() < 20
        assert mesh.area > 0.01
        if family in OF_ONE_PIECE:
            assert not mesh.component_labels.any()
        elif family in ("assembly", "furniture", "vehicle"):  # before holes may take some
            assert FAMILIES[family][0](np.random.default_rng(seed)).component_labels.any()
        elif family == "sheet":
            assert len(mesh.with_merged_vertices().boundary_vertices)
    again = make_mesh(family, seed)
    np.testing.assert_array_equal(mesh.points, again.points)
    np.testing.assert_array_equal(mesh.faces, again.faces)
    assert not np.array_equal(mesh.points, first.points)


def test_closed_bodies_are_closed_and_symmetric_ones_have_a_mirror():
    blobs = (FAMILIES["blob"][0](np.random.default_rng(seed)) for seed in range(2))
    assert all(len(blob.boundary_vertices) == 0 for blob in blobs)
    for seed in range(2):
        points = FAMILIES["symmetric"][0](np.random.default_rng(seed)).points
        tree = cKDTree(points)
        cell = np.quantile(tree.query(points, 2)[0][:, 1], 0.99)
        mirrored = (points * mirror for mirror in ([-1, 1, 1], [1, -1, 1]))
        gaps = [np.quantile(tree.query(twin)[0], 0.95) for twin in mirrored]
        assert min(gaps) < 1.5 * cell  # grids have no mirrors, so points have none


@pytest.mark.parametrize("blend", [0.0, 0.3])
def test_a_body_is_the_smooth_union_of_its_parts_less_the_cuts(blend):
    rng = np.random.default_rng(0)
    joints, radii, points = (
        rng.normal(size=(6, 3)),
        rng.uniform(0.1, 0.5, 6),
        rng.normal(size=(900, 3)),
    )
    body = bodies.Body()
    body.chain(joints, radii)
    limbs = zip(joints[:-1], joints[1:], radii[:-1], radii[1:], strict=True)
    parts = [clay.limb(*limb) for limb in limbs]
    for turn in (None, surfaces.random_rotation(rng)):
        centre, half = rng.normal(size=3), rng.uniform(0.2, 0.7, 3)
        body.ball(centre, half, turn)
        parts.append(clay.ellipsoid(centre, half, turn))
    parts.append(clay.box(joints[0], [0.5, 0.6, 0.7]))
    body.add(parts[-1], joints[0], 0.7)
    whole = clay.smooth_union(parts, blend)(points)
    np.testing.assert_allclose(body.field(blend)(points), whole, atol=1e-12)
    body.cuts.append(hole := clay.ring(joints[1], 0.8, 0.3))
    cut = np.maximum(whole, -hole(points))
    np.testing.assert_allclose(body.field(blend)(points), cut, atol=1e-12)
    alone = bodies.Body()
    alone.add(parts[-1], joints[0], 0.7)
    np.testing.assert_array_equal(alone.field(blend)(points), parts[-1](points))


def test_families_are_drawn_by_their_weights():
    rng = np.random.default_rng(0)
    counts = np.bincount([draw_family(rng) for _ in range(20_000)], minlength=len(FAMILIES))
    weights = np.array([weight for _, weight in FAMILIES.values()], dtype=float)
    np.testing.assert_allclose(counts / 20_000, weights / weights.sum(), atol=0.012)


def test_surfaces_do_not_follow_from_the_draw_of_their_family(monkeypatch):
    first: dict[str, list[float]] = {name: [] for name in FAMILIES}
    for name, (_, weight) in FAMILIES.items():

        def ball(rng, draws=first[name]):
            draws.append(rng.random())
            return sphere(subdivisions=1).geometry

        monkeypatch.setitem(FAMILIES, name, (ball, weight))
    config = CorpusConfig(seed=3)
    for i in range(200):
        make_surface(config, draw_source(config, i, 0), i, 0)
    for draws in first.values():
        if len(draws) > 9:  # uniform numbers: a spread of 0.4 or less has a chance below 0.2 %
            assert np.ptp(draws) > 0.4


def test_deformations_and_rotations_keep_what_they_should():
    rng = np.random.default_rng(0)
    grid = np.meshgrid(np.linspace(0, 2, 90), np.linspace(0, 1, 40), [0.0], indexing="ij")
    sheet = surfaces.grid_mesh(np.stack(grid, axis=-1)[:, :, 0])
    bent = sheet.with_points(surfaces.bend(sheet.points, 2.5))
    assert bent.area == pytest.approx(sheet.area, rel=1e-3)  # bending a plate is an isometry
    turned = surfaces.twist(sheet.points, 1.0)
    radius = np.hypot(sheet.points[:, 1], sheet.points[:, 2])
    np.testing.assert_allclose(np.hypot(turned[:, 1], turned[:, 2]), radius, atol=1e-12)
    raised = surfaces.raised(sheet, np.full(sheet.n, 0.5)).points - sheet.points
    np.testing.assert_allclose(np.abs(raised), np.tile([0, 0, 0.5], (sheet.n, 1)), atol=1e-12)
    rotations = np.array([surfaces.random_rotation(rng) for _ in range(4000)])
    np.testing.assert_allclose(rotations[0] @ rotations[0].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    # Uniform on SO(3): the tilt of any axis is uniform in its cosine, mean |cos| = 1/2.
    assert np.abs(rotations[:, 2, 2]).mean() == pytest.approx(0.5, abs=0.02)
    line = np.zeros((5, 3))  # flat things do not turn into NaN
    for deform in (surfaces.bend, surfaces.twist, surfaces.taper):
        np.testing.assert_array_equal(deform(line, 0.3), line)


@pytest.mark.parametrize("turns", [0.0, 0.5])
def test_half_turned_tubes_close_without_a_pinch(turns):
    t = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    circle = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    tube = surfaces.sweep(circle, 0.2, closed=True, aspect=0.5, turns=turns)
    a, b = tube.points[tube.edges].transpose(1, 0, 2)
    assert np.linalg.norm(a - b, axis=1).max() < 0.13
    assert tube.n - len(tube.unique_edges[0]) + len(tube.faces) == 0  # a torus
    # A thin tube has the area of its centre line times its rim (here 1.4 % more).
    rim = 0.2 * np.pi * (3 * 1.5 - np.sqrt(3.5 * 2.5))
    assert tube.area == pytest.approx(2 * np.pi * rim, rel=0.03)


def test_bisection_cuts_edges_and_keeps_the_surface_whole():
    ball = sphere(subdivisions=1).geometry
    long = ball.with_points(ball.points * [1, 1, 4])
    fine = surfaces.bisected(long, 0.2)
    a, b = fine.points[fine.edges].transpose(1, 0, 2)
    assert np.linalg.norm(a - b, axis=1).max() <= 0.2
    assert fine.area == pytest.approx(long.area)
    assert (fine.with_merged_vertices().unique_edges[1] == 2).all()  # no crack opens
    assert surfaces.join([ball, fine]).area == pytest.approx(ball.area + fine.area)


def test_crumbs_and_unknown_families_are_refused():
    with pytest.raises(InvalidInputError, match="`field` must have a surface of 400 faces"):
        bodies.polygonized(lambda p: np.linalg.norm(p, axis=1) - 0.05, -np.ones(3), np.ones(3))
    with pytest.raises(InvalidInputError, match="`family` must be one of"):
        make_mesh("unicorn", 0)
