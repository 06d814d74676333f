"""Heat and distances in the modes: closed forms, linear algebra, and exact distances."""

import numpy as np
import pytest
from conftest import creature, joined, moved, refused, two_parts
from geodesic_truths import angles, by_libigl, relative_error
from scipy.linalg import expm

from spectra_kit import (
    Dense,
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


def with_modes(mesh, k):
    triangulation = intrinsic_delaunay(mesh)
    return mesh, triangulation, eigensolve(triangulation.laplacian, k)


@pytest.fixture(scope="module")
def ball():
    """Mesh, triangulation and modes of the unit sphere; 100 modes are ten full shells."""
    return with_modes(sphere(subdivisions=4).geometry, 196)


@pytest.fixture(scope="module")
def animal():
    return with_modes(creature(1500, seed=0), 100)


@pytest.fixture(scope="module")
def pair():
    return with_modes(two_parts(), 60)


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
    mesh, _, spectrum = ball
    for k in (36, 100, 196):
        modes = spectrum.truncate(k)
        balance = np.pi / (2 * modes.eigenvalues[-1] ** 0.5)
        assert 0.6 < smallest_spectral_time(modes, 17) / balance < 1.1
    one = smallest_spectral_time(spectrum, 0)
    assert smallest_spectral_time(spectrum, range(0, mesh.n, 40)) < 0.3 * one
    weighted = check_sources(0, mesh, weights=[1e6])
    assert smallest_spectral_time(spectrum, weighted) == pytest.approx(one)
    assert smallest_spectral_time(spectrum.rescale(1000.0), 0) == pytest.approx(1e6 * one)


# Distances


def test_distance_on_the_sphere(ball):
    """Off by the blunt tip at the source, 1 / sqrt(lambda_k), and the smooth ridge opposite."""
    mesh, triangulation, spectrum = ball
    for k, bound in ((36, 0.065), (100, 0.045), (196, 0.035)):
        modes = spectrum.truncate(k)
        errors = []
        for vertex in (0, 2561):
            truth = angles(mesh.points, vertex)
            found = spectral_distance(modes, triangulation, vertex)
            errors.append(relative_error(found, truth))
            near = truth < 2.5
            assert np.abs(found - truth)[near].max() < 1.2 / modes.eigenvalues[-1] ** 0.5
        assert np.mean(errors) < bound
    point = FacePoint(99, [0.2, 0.2, 0.6])
    found = spectral_distance(spectrum, triangulation, check_sources(point, mesh))
    place = point.position(mesh) / np.linalg.norm(point.position(mesh))
    assert relative_error(found, np.arccos(np.clip(mesh.points @ place, -1, 1))) < 0.035


def test_default_time_is_about_the_best(animal):
    mesh, triangulation, spectrum = animal
    vertices = (0, 1000, 1499)
    truths = {v: by_libigl(mesh, v) for v in vertices}
    times = {v: smallest_spectral_time(spectrum, v) for v in vertices}

    def error(factor):
        fields = {
            v: spectral_distance(spectrum, triangulation, v, time=factor * times[v])
            for v in vertices
        }
        return np.mean([relative_error(fields[v], truths[v]) for v in vertices])

    default = error(1.0)
    assert default < 0.07
    assert default < 1.05 * min(error(1.3), error(1.7), error(2.5))
    with pytest.warns(
        DoubtfulDistanceWarning, match="too short for 100 modes.*negative on [0-9]+ %"
    ):
        assert default < 0.9 * error(0.5)
    alone = spectral_distance(spectrum, triangulation, 0)
    assert np.array_equal(alone, spectral_distance(spectrum, triangulation, 0, time=times[0]))
    assert alone[0] == 0


def test_distance_is_never_shorter_than_the_straight_line(animal):
    mesh, triangulation, spectrum = animal
    few = spectrum.truncate(10)
    point = FacePoint(30, [0.2, 0.3, 0.5])
    found = spectral_distance(few, triangulation, check_sources(point, mesh))
    straight = np.linalg.norm(mesh.points - point.position(mesh), axis=1)
    assert (found >= straight - 1e-12).all()


def test_unit_and_order_of_the_points_do_not_matter(animal):
    mesh, triangulation, spectrum = animal
    order = np.random.default_rng(0).permutation(mesh.n)
    place = np.argsort(order)
    other = intrinsic_delaunay(TriangleMesh(1000 * mesh.points[order], place[mesh.faces]))
    modes = Spectrum(spectrum.eigenvalues, spectrum.eigenvectors[order], spectrum.mass[order])
    found = spectral_distance(modes.rescale(1000.0), other, place[7]) / 1000
    expected = spectral_distance(spectrum, triangulation, 7)[order]
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_the_nearest_source_counts_and_none_reaches_another_component(pair):
    mesh, triangulation, spectrum = pair
    label, sources = triangulation.laplacian.component_labels, [0, 100, mesh.n - 1]
    assert label[0] == label[100] != label[-1]
    alone = {v: spectral_distance(spectrum, triangulation, v) for v in sources}
    for vertex, found in alone.items():
        assert np.array_equal(np.isfinite(found), label == label[vertex])
    nearest = np.minimum.reduce(list(alone.values()))
    assert np.array_equal(spectral_distance(spectrum, triangulation, sources), nearest)
    weighted = check_sources(sources, mesh, weights=[1.0, 100.0, 1.0])
    assert spectral_distance(spectrum, triangulation, weighted) == pytest.approx(nearest, rel=1e-12)


def test_a_second_component_changes_nothing(animal):
    """Modes, mixed or not, of another surface do not reach across."""
    mesh, triangulation, spectrum = animal
    n = mesh.n
    double = intrinsic_delaunay(joined(mesh, moved(mesh, 50, 0, 0)))
    modes = eigensolve(double.laplacian, 200)
    found = spectral_distance(modes, double, 7)
    assert found[:n] == pytest.approx(spectral_distance(spectrum, triangulation, 7), rel=1e-4)
    assert np.isinf(found[n:]).all()


def test_clouds_and_spectra_of_other_operators_serve(ball, animal):
    points = ball[0].points
    _, triangulation, spectrum = with_modes(PointCloud(points), 100)
    found = spectral_distance(spectrum, triangulation, 5)
    assert relative_error(found, angles(points, 5)) < 0.05
    mesh, triangulation, spectrum = animal
    found = spectral_distance(eigensolve(robust_laplacian(mesh), 100), triangulation, 7)
    assert found == pytest.approx(spectral_distance(spectrum, triangulation, 7), abs=0.01)


# What is refused


def test_what_is_refused(animal, pair):
    _, triangulation, spectrum = animal
    few, held, other = spectrum.truncate(1), spectrum.nonzero(), pair[1]
    joined = Spectrum(pair[2].eigenvalues[2:], pair[2].eigenvectors[:, 2:], pair[2].mass)
    constant = np.full((other.n, 1), pair[2].area ** -0.5)
    one = Spectrum(
        np.append(0.0, joined.eigenvalues), np.hstack([constant, joined.eigenvectors]), joined.mass
    )
    corner = FacePoint(0, [1, 0, 0])
    for call, given, argument, expected in (
        (smallest_spectral_time, (few, 0), "spectrum", "have modes outside its kernel"),
        (smallest_spectral_time, (held, 3), "sources", "be on components with a zero mode, got 3"),
        (spectral_distance, (spectrum, other, 0), "triangulation", "have the 1500 points of"),
        (spectral_distance, (joined, other, 0), "sources", "be on components with a zero mode"),
        (spectral_distance, (one, other, 0), "spectrum", "have a zero mode for each of the 2"),
        (spectral_distance, (spectrum, triangulation, []), "sources", "name at least one source"),
        (spectral_distance, (spectrum, triangulation, corner), "sources", "be vertices where"),
    ):
        refused(argument, expected, call, *given)
