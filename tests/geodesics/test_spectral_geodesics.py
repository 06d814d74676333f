"""Heat and distances in the modes: closed forms, linear algebra, and exact distances."""

import igl
import numpy as np
import pytest
from conftest import creature, refused, two_parts
from scipy.linalg import expm

from spectra_kit import (
    Dense,
    InvalidInputError,
    PointCloud,
    Spectrum,
    TriangleMesh,
    eigensolve,
    robust_laplacian,
)
from spectra_kit.errors import DoubtfulDistanceWarning
from spectra_kit.geodesics.sources import FacePoint, check_sources
from spectra_kit.geodesics.spectral import (
    smallest_spectral_time,
    spectral_distance,
    spectral_heat,
)
from spectra_kit.geometry import sphere, torus
from spectra_kit.operators.intrinsic import intrinsic_delaunay


@pytest.fixture(scope="module")
def ball():
    """Mesh, triangulation and modes of the unit sphere; 100 modes are ten full shells."""
    mesh = sphere(subdivisions=4).geometry
    triangulation = intrinsic_delaunay(mesh)
    return mesh, triangulation, eigensolve(triangulation.laplacian, 196)


@pytest.fixture(scope="module")
def animal():
    mesh = creature(1500, seed=0)
    triangulation = intrinsic_delaunay(mesh)
    return mesh, triangulation, eigensolve(triangulation.laplacian, 100)


@pytest.fixture(scope="module")
def pair():
    mesh = two_parts()
    triangulation = intrinsic_delaunay(mesh)
    return mesh, triangulation, eigensolve(triangulation.laplacian, 60)


def around(mesh, point):
    """Exact distances on the unit sphere from a point of it."""
    return np.arccos(np.clip(mesh.points @ point / np.linalg.norm(point), -1, 1))


def exact(mesh, vertex):
    none = np.empty(0, dtype=np.int64)
    points, faces = np.array(mesh.points), np.array(mesh.faces)
    return igl.exact_geodesic(points, faces, np.array([vertex]), none, np.arange(mesh.n), none)


def mean_error(found, expected):
    """Mean over all vertices but the source, relative."""
    elsewhere = expected > 0
    return np.mean(np.abs(found - expected)[elsewhere] / expected[elsewhere])


# Heat


def test_heat_in_all_modes_solves_its_equations():
    laplacian = robust_laplacian(torus(n=60).geometry)
    spectrum = eigensolve(laplacian, laplacian.n, Dense())
    L, M = laplacian.stiffness.toarray(), np.diag(laplacian.mass)
    sources = check_sources([3, 40], laplacian, weights=[1.0, 2.0])
    heat = sources.right_hand_side()

    step = spectral_heat(spectrum, sources, 0.3, flow=False)
    assert (M + 0.3 * L) @ step == pytest.approx(heat, abs=1e-10)
    flown = spectral_heat(spectrum, sources, 0.3)
    assert flown == pytest.approx(expm(-0.3 * np.linalg.solve(M, L)) @ (heat / laplacian.mass))


@pytest.mark.parametrize("flow", [True, False])
def test_heat_is_neither_lost_nor_made(pair, flow):
    mesh, triangulation, spectrum = pair
    label = triangulation.laplacian.component_labels
    sources = check_sources([0, mesh.n - 1], mesh, weights=[1.0, 3.0])
    heat = spectral_heat(spectrum, sources, 0.05, flow=flow)
    assert np.bincount(label, spectrum.mass * heat) == pytest.approx([1.0, 3.0])


def test_smallest_time_is_when_the_heat_becomes_positive(animal):
    _, _, spectrum = animal
    for source in (0, 700, [3, 900]):
        time = smallest_spectral_time(spectrum, source)

        def cold(time, source=source):
            heat = spectral_heat(spectrum, source, time)
            return spectrum.mass[heat < 0].sum() / spectrum.area

        assert cold(time) <= 0.01 < cold(0.95 * time)


def test_smallest_time_needs_no_diameter(ball):
    """Yet finds the balance of heat at the antipodes and of the modes left out."""
    _, _, spectrum = ball
    for k in (36, 64, 100, 144, 196):
        modes = spectrum.truncate(k)
        balance = np.pi / (2 * modes.eigenvalues[-1] ** 0.5)
        assert 0.6 < smallest_spectral_time(modes, 17) / balance < 1.1


def test_smallest_time_falls_where_sources_are_dense(ball):
    mesh, _, spectrum = ball
    one, many = (
        smallest_spectral_time(spectrum, 0),
        smallest_spectral_time(spectrum, range(0, 2562, 40)),
    )
    assert many < 0.3 * one
    weighted = check_sources(0, mesh, weights=[1e6])
    assert smallest_spectral_time(spectrum, weighted) == pytest.approx(one)


def test_smallest_time_is_in_length_squared(animal):
    _, _, spectrum = animal
    scaled = smallest_spectral_time(spectrum.rescale(1000.0), 5)
    assert scaled == pytest.approx(1e6 * smallest_spectral_time(spectrum, 5))


# Distances


def test_distance_on_the_sphere(ball):
    """Off by the blunt tip at the source, 1 / sqrt(lambda_k), and the smooth ridge opposite."""
    mesh, triangulation, spectrum = ball
    for k, bound in ((36, 0.065), (100, 0.045), (196, 0.035)):
        modes = spectrum.truncate(k)
        errors = []
        for vertex in (0, 1000, 2561):
            truth = around(mesh, mesh.points[vertex])
            found = spectral_distance(modes, triangulation, vertex)
            errors.append(mean_error(found, truth))
            near = truth < 2.5
            assert np.abs(found - truth)[near].max() < 1.2 / modes.eigenvalues[-1] ** 0.5
        assert np.mean(errors) < bound


def test_distance_on_a_creature(animal):
    mesh, triangulation, spectrum = animal
    for vertex in (0, 500, 1499):
        truth = exact(mesh, vertex)
        found = spectral_distance(spectrum, triangulation, vertex)
        assert mean_error(found, truth) < 0.07
        assert found[vertex] == 0.0
        assert np.corrcoef(found, truth)[0, 1] > 0.99


def test_default_time_is_about_the_best(animal):
    mesh, triangulation, spectrum = animal
    vertices = (0, 500, 1000, 1499)
    truths = {v: exact(mesh, v) for v in vertices}
    times = {v: smallest_spectral_time(spectrum, v) for v in vertices}

    def error(factor):
        return np.mean(
            [
                mean_error(
                    spectral_distance(spectrum, triangulation, v, time=factor * times[v]), truths[v]
                )
                for v in vertices
            ]
        )

    default = error(1.0)
    assert default < 1.05 * min(error(1.3), error(1.7), error(2.5))
    with pytest.warns(DoubtfulDistanceWarning, match="too short for 100 modes"):
        assert default < 0.9 * error(0.5)


def test_distance_is_never_shorter_than_the_straight_line(animal):
    mesh, triangulation, spectrum = animal
    few = spectrum.truncate(10)
    point = FacePoint(30, [0.2, 0.3, 0.5])
    found = spectral_distance(few, triangulation, check_sources(point, mesh))
    straight = np.linalg.norm(mesh.points - point.position(mesh), axis=1)
    assert (found >= straight - 1e-12).all()


def test_nearest_of_several_sources_counts(animal):
    mesh, triangulation, spectrum = animal
    both = spectral_distance(spectrum, triangulation, [10, 1200])
    alone = [spectral_distance(spectrum, triangulation, v) for v in (10, 1200)]
    assert np.array_equal(both, np.minimum(*alone))
    weighted = check_sources([10, 1200], mesh, weights=[1.0, 100.0])
    assert spectral_distance(spectrum, triangulation, weighted) == pytest.approx(both, rel=1e-12)


def test_distance_from_a_point_of_a_face(ball):
    mesh, triangulation, spectrum = ball
    point = FacePoint(99, [0.2, 0.2, 0.6])
    found = spectral_distance(spectrum, triangulation, check_sources(point, mesh))
    assert mean_error(found, around(mesh, point.position(mesh))) < 0.035


def test_distance_has_the_unit_of_length(animal):
    mesh, triangulation, spectrum = animal
    large = intrinsic_delaunay(mesh.with_points(1000 * mesh.points))
    found = spectral_distance(spectrum.rescale(1000.0), large, 7)
    assert found == pytest.approx(1000 * spectral_distance(spectrum, triangulation, 7), rel=1e-6)


def test_distance_follows_the_order_of_the_points(animal):
    mesh, triangulation, spectrum = animal
    order = np.random.default_rng(0).permutation(mesh.n)
    place = np.argsort(order)
    shuffled = intrinsic_delaunay(TriangleMesh(mesh.points[order], place[mesh.faces]))
    modes = Spectrum(spectrum.eigenvalues, spectrum.eigenvectors[order], spectrum.mass[order])
    found = spectral_distance(modes, shuffled, place[7])
    expected = spectral_distance(spectrum, triangulation, 7)[order]
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_distance_between_components_is_infinite(pair):
    mesh, triangulation, spectrum = pair
    label = triangulation.laplacian.component_labels
    first, last = 0, mesh.n - 1
    assert label[first] != label[last]
    alone = {v: spectral_distance(spectrum, triangulation, v) for v in (first, last)}
    for vertex, found in alone.items():
        assert np.array_equal(np.isfinite(found), label == label[vertex])
    both = spectral_distance(spectrum, triangulation, [first, last])
    assert np.array_equal(both, np.minimum(alone[first], alone[last]))


def test_a_second_component_changes_nothing(animal):
    """Modes, mixed or not, of another surface do not reach across."""
    mesh, triangulation, spectrum = animal
    n = mesh.n
    points = np.vstack([mesh.points, mesh.points + [50.0, 0, 0]])
    twice = TriangleMesh(points, np.vstack([mesh.faces, mesh.faces + n]))
    double = intrinsic_delaunay(twice)
    modes = eigensolve(double.laplacian, 200)
    found = spectral_distance(modes, double, 7)
    assert found[:n] == pytest.approx(spectral_distance(spectrum, triangulation, 7), rel=1e-4)
    assert np.isinf(found[n:]).all()


def test_distance_on_a_cloud(ball):
    mesh, _, _ = ball
    triangulation = intrinsic_delaunay(PointCloud(mesh.points))
    spectrum = eigensolve(triangulation.laplacian, 100)
    assert (
        mean_error(spectral_distance(spectrum, triangulation, 5), around(mesh, mesh.points[5]))
        < 0.05
    )


def test_spectrum_of_another_operator_serves(animal):
    mesh, triangulation, spectrum = animal
    other = eigensolve(robust_laplacian(mesh), 100)
    found = spectral_distance(other, triangulation, 7)
    assert found == pytest.approx(spectral_distance(spectrum, triangulation, 7), abs=0.01)


# What is refused


def test_too_short_a_time_is_told(animal, recwarn):
    _, triangulation, spectrum = animal
    time = smallest_spectral_time(spectrum, 7)
    spectral_distance(spectrum, triangulation, 7)
    spectral_distance(spectrum, triangulation, 7, time=1.1 * time)
    assert not recwarn
    with pytest.warns(DoubtfulDistanceWarning, match="negative on [0-9]+ % of the surface"):
        spectral_distance(spectrum, triangulation, 7, time=0.5 * time)


def test_bad_spectra_and_triangulations_are_refused(animal, pair):
    mesh, _, spectrum = animal
    with pytest.raises(InvalidInputError, match="must be a Spectrum, got a TriangleMesh"):
        spectral_heat(mesh, 0, 1.0)
    with pytest.raises(InvalidInputError, match="must have modes outside its kernel"):
        smallest_spectral_time(spectrum.truncate(1), 0)
    with pytest.raises(InvalidInputError, match="on components with a zero mode, got 3"):
        smallest_spectral_time(spectrum.nonzero(), 3)
    with pytest.raises(InvalidInputError, match="an IntrinsicTriangulation, got a TriangleMesh"):
        spectral_distance(spectrum, mesh, 0)
    with pytest.raises(InvalidInputError, match="must have the 1500 points of `spectrum`, got"):
        spectral_distance(spectrum, pair[1], 0)


def test_components_must_agree(pair):
    _, triangulation, spectrum = pair
    joined = Spectrum(spectrum.eigenvalues[2:], spectrum.eigenvectors[:, 2:], spectrum.mass)
    with pytest.raises(InvalidInputError, match="on components with a zero mode"):
        spectral_distance(joined, triangulation, 0)
    constant = np.full((triangulation.n, 1), spectrum.area**-0.5)
    one = Spectrum(
        np.append(0.0, spectrum.eigenvalues[2:]),
        np.hstack([constant, spectrum.eigenvectors[:, 2:]]),
        spectrum.mass,
    )
    with pytest.raises(InvalidInputError, match=r"each of the 2 components .* got 1"):
        spectral_distance(one, triangulation, 0)


def test_bad_sources_and_times_are_refused(animal):
    _, triangulation, spectrum = animal
    with pytest.raises(InvalidInputError, match="at least one source"):
        spectral_distance(spectrum, triangulation, [])
    with pytest.raises(InvalidInputError, match=r"in \[0, 1500\), got 1500"):
        smallest_spectral_time(spectrum, 1500)
    with pytest.raises(InvalidInputError, match="needs the faces of a TriangleMesh"):
        spectral_distance(spectrum, triangulation, FacePoint(0, [1, 0, 0]))
    for time in (0.0, np.inf):
        refused("time", "be positive and", spectral_heat, spectrum, 0, time)
        refused("time", "be positive and", spectral_distance, spectrum, triangulation, 0, time=time)
