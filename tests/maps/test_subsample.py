"""Dense surfaces: what they are matched on, the way back to all points, and maps into triangles."""

from __future__ import annotations

import pickle
from functools import cache

import igl
import numpy as np
import pytest
from conftest import creature, refused
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from test_match import QUICK, TURN

import spectra_kit as sk
from spectra_kit import TriangleMesh
from spectra_kit.geodesics import edge_graph
from spectra_kit.geodesics._kernels import farthest_along_edges
from spectra_kit.geometry import Geometry, creature_pair, permuted, sphere
from spectra_kit.maps import (
    Prepared,
    Truth,
    geodesic_errors,
    match,
    nearest_rows,
    prepare,
)
from spectra_kit.maps.convert import into_triangles
from spectra_kit.maps.nearest import nearest_within
from spectra_kit.maps.subsample import Subsample, image
from spectra_kit.maps.surface import outward_normals
from spectra_kit.operators import oriented_triangles

K = 60
FEW = 1000  # points that dense surfaces are matched on here


def refined(mesh: TriangleMesh) -> TriangleMesh:
    """Return the same surface with four triangles for each, its old vertices first."""
    return TriangleMesh(*igl.upsample(mesh.points, mesh.faces))


@cache
def thin(geometry: Geometry, k: int = K) -> Prepared:
    return prepare(sk.spectrum(geometry, k), geometry, n_points=FEW)


@pytest.fixture(scope="module")
def coarse() -> TriangleMesh:
    return creature(1000)


@pytest.fixture(scope="module")
def mesh(coarse) -> TriangleMesh:
    return refined(coarse)


@pytest.fixture(scope="module")
def source(mesh) -> Prepared:
    return thin(mesh)


@pytest.fixture(scope="module")
def dense(source) -> Subsample:
    return source.subsample


def spacing(mesh: TriangleMesh) -> float:
    """Return the mean length of an edge, in hundredths of the root of the area."""
    return 100 * float(edge_graph(mesh).data.mean()) / mesh.area**0.5


def errors(mesh: TriangleMesh, point_map: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return geodesic_errors(mesh, point_map, Truth.of_map(truth))


# --- the points that a dense surface is matched on ---------------------------------------------


def test_only_surfaces_of_more_than_twice_as_many_points_are_thinned(mesh, coarse, source) -> None:
    assert source.spectrum.n <= FEW
    assert source.whole.n == mesh.n
    assert repr(source).startswith(f"Prepared(n={source.spectrum.n} of {mesh.n}, k={K}")
    for n_points in (mesh.n // 2 + 1, 5000):
        full = prepare(sk.spectrum(mesh, K), mesh, n_points=n_points)
        assert full.subsample is None
        assert full.whole is full.spectrum
    assert thin(coarse).subsample is None
    assert prepare(sk.spectrum(mesh, K), n_points=FEW).subsample is None  # without a geometry


def test_farthest_points_along_edges_are_the_farthest(mesh) -> None:
    graph = edge_graph(mesh)
    arrays = graph.indptr, graph.indices, graph.data
    chosen, closest, apart = farthest_along_edges(*arrays, np.array([7, 5]), 60)
    distances = dijkstra(graph, indices=chosen)
    assert apart == pytest.approx(distances.min(axis=0))
    assert distances[closest, np.arange(mesh.n)] == pytest.approx(apart)
    assert chosen[:2].tolist() == [7, 5]
    for c in range(2, 60):
        before = distances[:c].min(axis=0)
        assert before[chosen[c]] == pytest.approx(before.max())


def test_the_numbering_and_the_place_of_a_mesh_do_not_matter(mesh, source) -> None:
    shuffled, truth = permuted(mesh, seed=1)
    same = thin(shuffled.with_points(25.4 * shuffled.points @ TURN))
    assert (truth[same.subsample.chosen] == source.subsample.chosen).all()
    assert (same.subsample.closest == source.subsample.closest[truth]).all()
    assert same.spectrum.mass == pytest.approx(source.spectrum.mass)


def test_the_modes_are_all_but_orthonormal_at_the_chosen_points(source, dense) -> None:
    modes = source.spectrum.truncate(30)
    gram = modes.eigenvectors.T @ (modes.mass[:, None] * modes.eigenvectors)
    assert gram == pytest.approx(np.eye(30), abs=0.02)
    assert modes.area == pytest.approx(1)
    assert (modes.eigenvectors == source.whole.eigenvectors[dense.chosen, :30]).all()


def test_more_points_are_chosen_where_the_modes_tell_more(source, dense) -> None:
    """A chosen point stands for the less area, the more the modes are worth there."""
    density = (source.spectrum.eigenvectors**2).mean(axis=1)
    mass, many = source.spectrum.mass, density > np.quantile(density, 0.9)
    assert mass[many].mean() < 0.7 * mass[~many].mean()
    assert np.log(mass * density).std() < np.log(mass).std()


def test_images_of_a_closed_surface_are_closed() -> None:
    """Whatever the map: here, points go anywhere."""
    ball = sphere(subdivisions=3).geometry
    oriented = oriented_triangles(ball)
    closest = np.random.default_rng(0).integers(40, size=ball.n)
    faces, weights = image(oriented, closest, 40)
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    along = sparse.coo_array((np.repeat(weights, 3), (tails, heads)), shape=(40, 40)).toarray()
    assert along.any()
    assert along == pytest.approx(along.T)
    same, ones = image(oriented, np.arange(ball.n), ball.n)
    assert (ones == 1).all()
    assert volume(ball.points, same) == pytest.approx(volume(ball.points, oriented.faces))


def volume(points: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = points[faces].transpose(1, 0, 2)
    return float(np.einsum("fr,fr->", a, np.cross(b, c))) / 6


def test_the_triangles_of_the_chosen_points_enclose_the_body(source, dense) -> None:
    faces, whole = source.surface.oriented.faces, dense.surface
    assert len(np.unique(faces)) == source.spectrum.n
    assert volume(source.surface.points, faces) == pytest.approx(
        volume(whole.points, whole.oriented.faces), rel=0.05
    )
    normals = outward_normals(whole.points, whole.oriented)[dense.chosen]
    here = outward_normals(source.surface.points, source.surface.oriented)
    assert np.median(np.einsum("nr,nr->n", normals, here)) > 0.98


def test_truncated_is_as_if_made_of_fewer_modes(mesh) -> None:
    spectrum = sk.spectrum(mesh, K)
    cut = prepare(spectrum, mesh, n_points=FEW).truncate(40)
    made = prepare(spectrum.truncate(40), mesh, n_points=FEW)
    assert (cut.subsample.chosen == made.subsample.chosen).all()
    assert (cut.samples == made.samples).all()
    assert cut.wave == pytest.approx(made.wave)
    again = pickle.loads(pickle.dumps(cut))
    assert (again.subsample.closest == cut.subsample.closest).all()
    assert again.whole.k == 40


# --- the way back ------------------------------------------------------------------------------


def test_a_rigid_motion_is_carried_to_all_points(dense) -> None:
    points = dense.surface.points
    moved = points @ TURN.T + [0.3, -0.1, 2.0]
    turns = np.broadcast_to(TURN, (len(dense.chosen), 3, 3))
    assert dense.carried(moved[dense.chosen], turns, points) == pytest.approx(moved)


def test_values_are_averaged_around_each_point(mesh, dense) -> None:
    """So they move points by less than the chosen ones are apart, and constants stay."""
    assert dense.lift.sum(axis=1) == pytest.approx(np.ones(mesh.n))
    assert dense.lift.data.min() > 0
    points = dense.surface.points
    apart = np.linalg.norm(points - points[dense.chosen[dense.closest]], axis=1)
    moved = np.linalg.norm(dense.lift @ points[dense.chosen] - points, axis=1)
    assert moved.max() < 2 * apart.max()
    assert moved.mean() < 0.5 * apart[apart > 0].mean()


def test_the_nearest_within_all_cells_is_the_nearest() -> None:
    rng = np.random.default_rng(0)
    rows1, rows2 = rng.normal(size=(300, 5)), rng.normal(size=(200, 5))
    cells1, cells2 = rng.integers(20, size=300), rng.integers(10, size=200)
    everywhere = sparse.csr_array(np.ones((10, 20)))
    found = nearest_within(everywhere, (rows1, cells1), (rows2, cells2))
    assert (found == nearest_rows(rows2, rows1)).all()
    some = sparse.csr_array(rng.random((10, 20)) < 0.3)
    found = nearest_within(some, (rows1, cells1), (rows2, cells2))
    for i in range(200):
        pool = np.flatnonzero(some.toarray()[cells2[i], cells1])
        assert found[i] == pool[((rows1[pool] - rows2[i]) ** 2).sum(axis=1).argmin()]


# --- matches -----------------------------------------------------------------------------------


def test_a_copy_of_a_dense_mesh_is_found(mesh, source) -> None:
    shuffled, truth = permuted(mesh, seed=1)
    found = match(source, thin(shuffled.with_points(25.4 * shuffled.points @ TURN)), options=QUICK)
    assert found.precise is None
    assert (found.point_map == truth).all()
    assert found.orientation == pytest.approx(1)
    assert found.coverage > 1.5
    C = found.functional_map
    gram = C.T @ C
    assert gram == pytest.approx(np.eye(K), abs=1e-6)
    assert not found.ambiguous


@pytest.mark.parametrize("elastic", [True, False])
def test_a_refined_body_matches_its_coarse_self(coarse, mesh, source, elastic) -> None:
    """Either way round: the first vertices of the refined one are those of the coarse one.

    Its new vertices are in the middle of edges of the coarse one, and a precise map knows it.
    """
    plain, old = thin(coarse), np.arange(coarse.n)
    onto_dense = match(plain, source, elastic=elastic, precise=True, options=QUICK)
    assert len(onto_dense.point_map) == mesh.n
    assert errors(coarse, onto_dense.point_map[old], old).mean() < 0.5 * spacing(coarse)
    precise = onto_dense.precise
    assert precise.shape == (mesh.n, coarse.n)
    assert precise.sum(axis=1) == pytest.approx(np.ones(mesh.n))
    assert precise.data.min() > 0
    apart = np.linalg.norm(precise @ coarse.points - mesh.points, axis=1).mean()
    nearest = np.linalg.norm(coarse.points[onto_dense.point_map] - mesh.points, axis=1).mean()
    assert apart < 0.7 * nearest
    onto_coarse = match(source, plain, elastic=elastic, precise=True, options=QUICK)
    assert errors(mesh, onto_coarse.point_map, old).mean() < spacing(mesh)
    assert onto_coarse.precise.shape == (coarse.n, mesh.n)


@pytest.mark.parametrize("elastic", [True, False])
def test_a_dense_pair_agrees_with_the_coarse_one(elastic) -> None:
    one, other, _ = creature_pair(600, 650, seed=1)
    fine = refined(one), refined(other)
    found = match(*(thin(side) for side in fine), elastic=elastic, options=QUICK)
    usual = match(*(thin(side) for side in (one, other)), elastic=elastic, options=QUICK)
    first = found.point_map[: other.n]
    assert errors(fine[0], first, usual.point_map).mean() < spacing(one)


def test_dense_clouds_and_mirror_images_are_matched(mesh, source) -> None:
    image_of = sk.geometry.mirrored(mesh)
    found = match(source, thin(image_of), options=QUICK)
    assert found.mirrored
    assert errors(mesh, found.point_map, np.arange(mesh.n)).mean() < 0.5 * spacing(mesh)
    cloud = match(source, thin(mesh.as_cloud()), options=QUICK)
    assert errors(mesh, cloud.point_map, np.arange(mesh.n)).mean() < spacing(mesh)


def test_landmarks_may_be_any_points_of_a_dense_mesh(mesh, source) -> None:
    points = np.array([0, mesh.n // 2, mesh.n - 1])
    found = match(source, source, landmarks=(points, points), mirrored=False, options=QUICK)
    assert found.candidates[0].mismatches["landmarks"] == pytest.approx(0, abs=1e-6)


# --- maps into triangles -----------------------------------------------------------------------


def test_points_inside_triangles_are_found_again() -> None:
    ball = sphere(subdivisions=3).geometry
    rng = np.random.default_rng(0)
    face, weights = rng.integers(len(ball.faces), size=500), rng.dirichlet(np.ones(3), size=500)
    inside = np.einsum("pc,pcr->pr", weights, ball.points[ball.faces[face]])
    corner = ball.faces[face, weights.argmax(axis=1)]
    found = into_triangles(inside, ball.points, ball.faces, corner)
    assert found @ ball.points == pytest.approx(inside, abs=1e-12)
    assert found.sum(axis=1) == pytest.approx(np.ones(500))


def test_bad_input_is_named(coarse) -> None:
    spectrum = sk.spectrum(coarse, 30)
    refused("n_points", "be at least 1000", prepare, spectrum, coarse, n_points=999)
    refused("precise", "be False without both", match, spectrum, spectrum, precise=True)


def test_a_piece_that_no_point_stands_for_is_named(mesh) -> None:
    """Four points beside the body, of which its spectrum knows nothing."""
    corners = 1e-3 * np.vstack([np.zeros(3), np.eye(3)]) + mesh.points.max(axis=0)
    sides = mesh.n + np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    both = TriangleMesh(np.vstack([mesh.points, corners]), np.vstack([mesh.faces, sides]))
    one = sk.spectrum(mesh, 30)
    vectors = np.vstack([one.eigenvectors, np.zeros((4, 30))])
    spectrum = sk.Spectrum(one.eigenvalues, vectors, np.append(one.mass, np.full(4, 1e-7)))
    refused("geometry", "be connected, as its spectrum is", prepare, spectrum, both, n_points=FEW)
