"""The heat method: analytic truths, invariances, an independent library, and bad input."""

import dataclasses
from contextlib import nullcontext

import numpy as np
import potpourri3d as pp3d
import pytest
from conftest import creature, joined, moved, refused
from geodesic_truths import (
    angles,
    by_libigl,
    flat_square,
    middle_of,
    relative_error,
    straight,
    too_large,
)
from scipy import sparse
from scipy.spatial import Delaunay

import spectra_kit as sk
from spectra_kit._sparse import LinearSolution
from spectra_kit._sparse.elimination import Elimination
from spectra_kit.errors import (
    ConvergenceError,
    DoubtfulDistanceWarning,
    OutOfMemoryError,
)
from spectra_kit.geodesics import (
    Direct,
    FacePoint,
    Heat,
    HeatGeodesics,
    Iterative,
    WithinMemory,
    check_sources,
    geodesic_distance,
)
from spectra_kit.geodesics.heat_step import HeatStep
from spectra_kit.geodesics.system import System
from spectra_kit.geometry import TriangleMesh, rectangle, sphere
from spectra_kit.operators.intrinsic import intrinsic_delaunay
from spectra_kit.operators.triangle_calculus import areas

BOTH = [Direct(), Iterative()]
PAPER = {"drop": None, "relaxation": 0.0, "modes": 59}
SOLVERS = [*BOTH, Iterative(coarse="projected"), Iterative(**PAPER), WithinMemory()]
each_solver = pytest.mark.parametrize("solver", BOTH, ids=["direct", "iterative"])


@pytest.fixture(scope="module")
def animal() -> TriangleMesh:
    return creature(2200, seed=0)


@pytest.fixture(scope="module")
def modes(animal) -> sk.Spectrum:
    return sk.eigensolve(intrinsic_delaunay(animal).laplacian, 60)


# --- truths -------------------------------------------------------------------------------------


@pytest.mark.parametrize("cloud", [False, True])
def test_distances_on_the_sphere_approach_the_angle(cloud) -> None:
    errors, edges = [], []
    for subdivisions in (2, 3, 4):
        mesh = sphere(subdivisions=subdivisions).geometry
        geodesics = HeatGeodesics(mesh.as_cloud() if cloud else mesh)
        errors.append(relative_error(geodesics.distance(0), angles(mesh.points, 0)))
        edges.append(geodesics.triangulation.spacings[0])
    rate = np.polyfit(np.log(edges), np.log(errors), 1)[0]
    assert errors[-1] < 0.02
    assert rate > 0.7  # sqrt(t) is the mean edge: first order, less the growth of 1 / d near 0


def test_errors_are_those_of_an_independent_library() -> None:
    animal = creature(3000, seed=0)
    theirs = pp3d.MeshHeatMethodDistanceSolver(np.array(animal.points), np.array(animal.faces))
    ours, both = HeatGeodesics(animal), [7, 900]
    errors = [
        [
            relative_error(d, by_libigl(animal, s))
            for d in (ours.distance(s), theirs.compute_distance(s))
        ]
        for s in (0, 1000)
    ]
    truth = by_libigl(animal, *both)
    pair = ours.distance(both), theirs.compute_distance_multisource(both)
    errors.append([relative_error(d, truth) for d in pair])
    errors = np.array(errors)
    assert errors[:, 0].mean() <= 1.05 * errors[:, 1].mean()
    assert errors[:, 0].max() < 0.03
    assert not pair[0].distance[both].any()


def test_heat_is_right_where_float64_cannot_hold_it() -> None:
    # On a path, (M + t L) u = delta at one end has the solution cosh((n - 1/2 - i) a), if the mass
    # at every point is 1 and no heat leaves: cosh a = 1 + 1 / (2 t).
    n, duration = 3000, 0.3
    off = -np.ones(n - 1)
    inner = np.full(n, 2.0)
    inner[[0, -1]] = 1.0
    path = sparse.csr_array(sparse.diags_array([off, inner, off], offsets=[-1, 0, 1]))
    points = np.column_stack([np.arange(n), np.zeros((n, 2))])
    heated = np.eye(1, n)[0]
    rate = np.arccosh(1 + 1 / (2 * duration))
    left = (n - 0.5 - np.arange(n)) * rate
    log = np.logaddexp(left, -left)
    for direct in (True, False):
        step = HeatStep(path, np.ones(n), points, duration=duration, direct=direct)
        (heat,) = step.solve([heated])
        assert heat.log[-1] < -4000  # exp of it underflows
        assert np.abs((heat.log - heat.log[0]) - (log - log[0])).max() < 1e-7
        assert heat.backward_error <= 1e-10


@each_solver
def test_a_long_strip_does_not_lose_the_heat(solver) -> None:
    mesh = rectangle(n=6000, width=1200.0, height=1.0).geometry
    distance = HeatGeodesics(mesh, solver=solver).distance(0).distance
    far = mesh.points[:, 0] > 1000
    assert relative_error(distance[far], mesh.points[far, 0]) < 1e-3


@pytest.mark.parametrize("source", [7, FacePoint(3, (0.2, 0.5, 0.3))], ids=["vertex", "face"])
def test_all_solvers_agree(animal, modes, source) -> None:
    fields = [HeatGeodesics(animal, modes, solver=s).distance(source).distance for s in SOLVERS]
    for field in fields[1:]:
        assert np.abs(field - fields[0]).max() < 1e-7 * fields[0].max()


def test_solvers_agree_where_heat_has_no_direction() -> None:
    mesh = sphere(subdivisions=4).geometry
    middle = FacePoint(0, (1 / 3, 1 / 3, 1 / 3))  # as warm at all three corners
    fields = [HeatGeodesics(mesh, solver=s).distance(middle) for s in BOTH]
    assert np.abs(fields[1].distance - fields[0].distance).max() < 1e-7 * np.pi


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_modes_save_iterations_and_wrong_ones_do_no_harm(animal, modes) -> None:
    wanted = HeatGeodesics(animal, solver=Direct()).distance(7).distance

    def iterations(spectrum=modes, **options) -> int:
        field = HeatGeodesics(animal, spectrum, solver=Iterative(**options)).distance(7)
        assert np.abs(field.distance - wanted).max() < 1e-7 * wanted.max()
        return field.poisson.iterations

    plain = iterations(coarse="none", **PAPER)
    assert iterations(coarse="additive", **PAPER) <= plain / 2
    assert iterations(coarse="projected", **PAPER) <= plain / 2
    predicted = sk.eigensolve(intrinsic_delaunay(animal).laplacian, 60, sk.Neo(poses=1))
    assert iterations(predicted, coarse="additive", **PAPER) <= plain / 2
    # The default is quicker than the paper's, and beside it modes save something still.
    assert iterations() < iterations(coarse="none") < plain / 2
    shuffled = np.random.default_rng(0).permutation(animal.n)
    iterations(sk.Spectrum(modes.eigenvalues, modes.eigenvectors[shuffled], modes.mass))
    iterations(sk.eigensolve(sk.knn_laplacian(animal), 30))
    # Energies that are not the modes' own are seen, and computed anew.
    wrong = sk.Spectrum(1000 * modes.eigenvalues, modes.eigenvectors, modes.mass)
    assert iterations(wrong, coarse="additive", **PAPER) <= plain / 2


def test_every_option_of_the_iteration_is_heeded(animal, modes) -> None:
    def norms(**options) -> list[float]:
        field = HeatGeodesics(animal, modes, solver=Iterative(**options)).distance(7)
        return field.poisson.residual_norms.tolist()

    default = norms()
    for name, value in {"coarse": "projected", "modes": 7, "drop": 0.05, "relaxation": 0.1}.items():
        assert norms(**{name: value}) != default, name
    assert norms(modes=24, drop=5e-3, relaxation=0.9, rtol=1e-8) == default
    loose = norms(rtol=1e-3)
    assert loose[:-1] == default[: len(loose) - 1]
    assert len(loose) < len(default)


# --- invariances --------------------------------------------------------------------------------


@each_solver
def test_unit_and_order_of_vertices_do_not_matter(animal, modes, solver) -> None:
    one = HeatGeodesics(animal, modes, solver=solver).distance(7)
    order = np.random.default_rng(1).permutation(animal.n)
    place = np.argsort(order)
    for factor in (1e-6, 1e6):
        other = TriangleMesh(factor * animal.points[order], place[animal.faces])
        spectrum = sk.Spectrum(modes.eigenvalues, modes.eigenvectors[order], modes.mass[order])
        field = HeatGeodesics(other, spectrum.rescale(factor), solver=solver).distance(place[7])
        expected = one.distance[order]
        assert np.abs(field.distance / factor - expected).max() < 1e-7 * expected.max()
        assert field.poisson.iterations <= 1.3 * one.poisson.iterations
        assert field.time_step == pytest.approx(factor**2 * one.time_step)


def test_same_input_same_bits(animal, modes) -> None:
    geodesics = HeatGeodesics(animal, modes, solver=Iterative())
    first = geodesics.distance(7).distance
    geodesics.distance(8)
    assert np.array_equal(geodesics.distance(7).distance, first)
    again = geodesic_distance(animal, 7, spectrum=modes, solver=Iterative())
    assert np.array_equal(again.distance, first)


# --- sources, boundaries, components --------------------------------------------------------------


@each_solver
def test_a_region_of_sources_is_at_zero_and_shines_outwards(solver) -> None:
    mesh = sphere(subdivisions=4).geometry
    height = mesh.points[:, 2]
    cap = height > 0.8
    geodesics = HeatGeodesics(mesh, solver=solver)
    distance = geodesics.distance(cap).distance
    assert not distance[cap].any()
    edge = np.arccos(height[cap].min())  # of the cap, up to one edge
    truth = np.arccos(np.clip(height[~cap], -1, 1)) - edge
    away = truth > 0.2
    assert relative_error(distance[~cap][away], truth[away]) < 0.05
    assert not geodesics.distance(np.ones(mesh.n, dtype=bool)).distance.any()


@pytest.mark.parametrize("boundary", ["neumann", "average"])
@each_solver
def test_the_smallest_geometries(solver, boundary) -> None:
    triangle = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    tetrahedron = TriangleMesh(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    for mesh in (triangle, tetrahedron):
        # Down the middle of each face: its height, as heat is the same at both ends of the side.
        heat = HeatGeodesics(mesh, solver=solver, boundary=boundary)
        with too_large if boundary == "neumann" else nullcontext():
            assert heat.distance(0).distance[1:] == pytest.approx(np.sqrt(0.5))


def test_a_source_inside_a_face_lies_between_its_corners() -> None:
    mesh = rectangle(n=1000).geometry
    centres = mesh.points[mesh.faces].mean(axis=1)
    face = int(np.argmin(np.linalg.norm(centres - [0.5, 0.8, 0], axis=1)))
    point = FacePoint(face, (0.2, 0.3, 0.5))
    truth = np.linalg.norm(mesh.points - point.position(mesh), axis=1)
    inside = HeatGeodesics(mesh).distance(point).distance
    corner = HeatGeodesics(mesh).distance(int(mesh.faces[face, 0])).distance
    assert np.abs(inside - truth).mean() < 0.5 * np.abs(corner - truth).mean()
    triangulated = HeatGeodesics(intrinsic_delaunay(mesh)).distance(check_sources(point, mesh))
    assert np.array_equal(triangulated.distance, inside)


def test_a_source_that_emits_more_runs_ahead_by_the_logarithm() -> None:
    mesh = rectangle(n=1000, width=100.0, height=1.0).geometry
    x = mesh.points[:, 0]
    left, right = int(x.argmin()), int(x.argmax())
    geodesics = HeatGeodesics(mesh)
    weight = 1e6
    even = geodesics.distance([left, right]).heat.log
    uneven = geodesics.distance([left, right], weights=[weight, 1.0]).heat.log
    at_even = x[(x < 60) & (x > 10)][even[(x < 60) & (x > 10)].argmin()]
    at_uneven = x[(x < 90) & (x > 10)][uneven[(x < 90) & (x > 10)].argmin()]
    root = np.sqrt(geodesics.time_steps[0])
    assert at_uneven - at_even == pytest.approx(root * np.log(weight) / 2, rel=0.25)


@each_solver
def test_the_average_is_that_of_both_heats(solver) -> None:
    triangulation = intrinsic_delaunay(rectangle(n=400).geometry)
    middle = np.linalg.norm(triangulation.points - triangulation.points.mean(axis=0), axis=1)
    sources = [int(triangulation.boundary[0]), int(middle.argmin())]  # one on the cold boundary
    geodesics = HeatGeodesics(triangulation, solver=solver, boundary="average")
    field = geodesics.distance(sources)
    L, mass = triangulation.laplacian.stiffness, triangulation.laplacian.mass
    A = (sparse.diags_array(mass) + field.time_step * L).toarray()
    free = np.setdiff1d(np.arange(triangulation.n), triangulation.boundary)
    rhs = np.zeros(triangulation.n)
    rhs[sources] = 1.0
    both = np.linalg.solve(A, rhs)
    both[free] += np.linalg.solve(A[np.ix_(free, free)], rhs[free])
    ratio = field.heat.log - np.log(both)
    assert np.ptp(ratio) < 1e-8


@each_solver
def test_a_cold_boundary_that_cuts_the_surface_apart_is_refused(solver) -> None:
    sheet = rectangle(n=100).geometry
    right = sheet.points[:, 0].max()
    a, b = np.flatnonzero(sheet.points[:, 0] == right)[4:6]  # the ends of one side
    other = sheet.points + [right, 0, 0]
    c, d = np.flatnonzero(other[:, 0] == right)[4:6] + sheet.n
    faces = [sheet.faces, sheet.faces + sheet.n, [[a, c, b], [b, c, d]]]
    strip = TriangleMesh(np.vstack([sheet.points, other + [0.1, 0, 0]]), np.vstack(faces))
    cold = HeatGeodesics(strip, solver=solver, boundary="dirichlet")
    refused("boundary", "be 'neumann' or 'average' here", cold.distance, middle_of(sheet))
    refused("sources", "not all lie on the boundary of their component", cold.distance, 0)
    field = HeatGeodesics(strip, solver=solver, boundary="average").distance(middle_of(sheet))
    assert field.distance.max() > 1.5 * right


# --- choice and record ----------------------------------------------------------------------------


def test_the_choice_is_explained(animal, modes) -> None:
    small = geodesic_distance(animal, 0)
    assert (small.solver, small.reason) == (
        Direct(),
        "factors of 2200 points fit into 4 GiB",
    )
    forced = HeatGeodesics(animal, modes, solver=Iterative()).distance(0)
    assert (forced.solver, forced.reason) == (Iterative(), "as asked")
    assert forced.choice == "two-level iterative (additive): as asked"
    for spectrum in (None, modes.truncate(1)):
        plain = HeatGeodesics(animal, spectrum, solver=Iterative()).distance(0)
        assert (plain.solver, plain.solver.name) == (Iterative(coarse="none"), "iterative")
    choose = WithinMemory(modes=7, rtol=1e-6).choose
    assert choose(400_000)[0] == Direct()
    assert choose(50_000_000)[0] == Iterative(modes=7, rtol=1e-6)
    assert "more than 4" in choose(50_000_000)[1]
    low = HeatGeodesics(animal, solver=WithinMemory(memory=1e-5)).distance(0)  # no room for factors
    assert low.solver == Iterative(coarse="none")
    assert np.abs(low.distance - small.distance).max() < 1e-6


def test_a_few_large_triangles_have_a_step_only_if_they_cover_something() -> None:
    ball = System.of(intrinsic_delaunay(sphere(subdivisions=5).geometry))  # 20,480 alike

    def sizes(*times: float) -> list[int]:
        lengths = ball.lengths.copy()
        lengths[: len(times)] *= np.array(times)[:, None]
        found = dataclasses.replace(ball, lengths=lengths).sizes
        assert not found[len(times) :].any()
        return found[: len(times)].tolist()

    assert sizes(10) == [0]  # half a per cent
    assert sizes(10, 10, 10, 10, 10) == [1] * 5
    assert sizes(10, 100) == [2, 2]
    assert sizes(10, 10, 10, 10, 10, 100) == [1] * 5 + [2]


def test_what_factors_take_is_counted_where_it_was_estimated_too_low(animal) -> None:
    taken = 2 * Elimination.of(intrinsic_delaunay(animal).laplacian.stiffness).gigabytes
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("spectra_kit.geodesics.solvers.factor_gigabytes", lambda n: 0.0)
        fields = [
            HeatGeodesics(animal, solver=WithinMemory(memory=times * taken)).distance(0)
            for times in (1.001, 0.999)
        ]
    assert [field.solver for field in fields] == [Direct(), Iterative(coarse="none")]
    assert "more than" in fields[1].reason
    np.testing.assert_allclose(*(field.distance for field in fields), atol=1e-6)


def apart(*meshes: TriangleMesh) -> tuple[TriangleMesh, list[int]]:
    """Return several meshes side by side, and the first point of each."""
    firsts = np.cumsum([0, *(mesh.n for mesh in meshes)])[:-1]
    return joined(*(moved(mesh, 9.0 * i, 0, 0) for i, mesh in enumerate(meshes))), firsts.tolist()


@pytest.mark.parametrize("boundary", ["dirichlet", "average"])
def test_what_suits_one_part_says_nothing_of_the_next(boundary) -> None:
    sheet = rectangle(n=1500).geometry
    mesh, (ball, other) = apart(sphere(subdivisions=4).geometry, sheet)
    other += middle_of(sheet)
    triangulation = intrinsic_delaunay(mesh)
    taken = 2 * System.of(triangulation, 0).elimination.gigabytes
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("spectra_kit.geodesics.solvers.factor_gigabytes", lambda n: 0.0)
        solver = WithinMemory(memory=0.99 * taken)  # the ball does not fit, the sheet does
        one, two = (HeatGeodesics(triangulation, solver=solver, boundary=boundary) for _ in "ab")
        first = one.distance(ball), one.distance(other)
        second = two.distance(other), two.distance(ball)
    assert [field.solver.name for field in first] == ["iterative", "direct"]
    for field, same in zip(first, reversed(second), strict=True):
        np.testing.assert_array_equal(field.distance, same.distance)
    alone = HeatGeodesics(triangulation, solver=Direct(), boundary=boundary).distance(other)
    np.testing.assert_array_equal(first[1].distance, alone.distance)


def test_factors_of_all_parts_together_stay_within_the_memory() -> None:
    mesh, firsts = apart(*(sphere(subdivisions=3).geometry for _ in range(4)))
    triangulation = intrinsic_delaunay(mesh)
    taken = 2 * System.of(triangulation, 0).elimination.gigabytes
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("spectra_kit.geodesics.solvers.factor_gigabytes", lambda n: 0.0)
        geodesics = HeatGeodesics(triangulation, solver=WithinMemory(memory=2.5 * taken))
        fields = [geodesics.distance(first) for first in (*firsts, firsts[0])]
    assert all(field.solver == Direct() for field in fields)
    assert sum(ready.gigabytes for ready in geodesics._prepared.values()) <= 2.5 * taken
    np.testing.assert_array_equal(fields[0].distance, fields[-1].distance)


def test_a_part_that_is_all_boundary_has_nothing_to_keep_warm() -> None:
    mesh, (ball, corner) = apart(sphere(subdivisions=3).geometry, flat_square())
    for geometry, source in ((flat_square(), 0), (mesh, corner)):
        cold = HeatGeodesics(geometry, boundary="dirichlet")
        refused("sources", "not all lie on the boundary", cold.distance, source)
    assert HeatGeodesics(mesh, boundary="dirichlet").distance(ball).reached.sum() == corner


def test_no_memory_for_the_order_of_elimination_is_told_with_a_way_out(animal) -> None:
    def none(matrix):
        raise MemoryError

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("spectra_kit._sparse.elimination.minimum_degree", none)
        with pytest.raises(OutOfMemoryError, match=r"geodesics.Iterative\(\)"):
            geodesic_distance(animal, 0, solver=Direct())


def test_triangles_of_very_different_size() -> None:
    rng = np.random.default_rng(0)
    coarse, fine = rng.random((1000, 2)), 0.5 + 0.001 * rng.random((3000, 2))
    flat = np.vstack([coarse, fine, [[0, 0], [1, 0], [0, 1], [1, 1]]])
    mesh = TriangleMesh(np.column_stack([flat, np.zeros(len(flat))]), Delaunay(flat).simplices)
    fields = [HeatGeodesics(mesh, solver=s).distance(0) for s in BOTH]
    assert np.abs(fields[1].distance - fields[0].distance).max() < 1e-7
    assert fields[1].heat.iterations < 60
    assert relative_error(fields[0], straight(mesh.points, 0)) < 0.1
    system = System.of(intrinsic_delaunay(mesh))
    own = np.log(system.lengths.max(axis=1)) / np.log(8) - 1
    asked = np.unique(system.sizes)
    assert 1 < len(asked) <= len(np.unique(np.ceil(own).clip(0)))
    assert ((system.sizes >= own) | (system.sizes == asked[-1])).all()
    covered = np.bincount(system.sizes, areas(system.lengths))
    assert (covered[asked[1:]] > 0.009 * covered.sum()).all()


def test_a_time_so_long_that_heat_is_level_is_warned_of(animal) -> None:
    with pytest.warns(DoubtfulDistanceWarning, match="lower `time_coefficient`"):
        geodesic_distance(animal, 7, time_coefficient=1e12)


def test_a_field_is_an_array_and_keeps_its_record(animal) -> None:
    field = geodesic_distance(animal, 7, solver=Iterative())
    assert np.array_equal(np.asarray(field), field.distance)
    assert np.asarray(field, dtype=np.float32).dtype == np.float32
    assert set(field.seconds) == {"triangulation", "setup", "heat", "directions", "poisson"}
    assert isinstance(field.poisson, LinearSolution)
    assert field.poisson.relative_residual <= 1e-8
    assert "iterations" in repr(field)
    with pytest.raises(ValueError, match="read-only"):
        field.distance[0] = 1.0


# --- bad input ------------------------------------------------------------------------------------


def test_heat_that_does_not_get_there_is_kept(animal, monkeypatch) -> None:
    monkeypatch.setattr("spectra_kit.geodesics.heat_step._ACCURACY", 1e-30)
    with pytest.raises(ConvergenceError, match="heat step must be right") as caught:
        geodesic_distance(animal, 7, solver=Iterative())
    assert isinstance(caught.value.partial, Heat)
    assert caught.value.partial.backward_error < 1e-10


@pytest.mark.parametrize(
    ("make", "options", "argument", "expected"),
    [
        (HeatGeodesics, {"time_coefficient": 1e200}, "time_coefficient", "be in [1e-30, 1e+30]"),
        (Iterative, {"relaxation": 1.5}, "relaxation", "be in [0, 1]"),
        (Iterative, {"rtol": 10.0}, "rtol", "be less than 1"),
        (WithinMemory, {"rtol": 1.0}, "rtol", "be less than 1"),
    ],
)
def test_wrong_options(animal, make, options, argument, expected) -> None:
    given = (animal,) if make is HeatGeodesics else ()
    refused(argument, expected, make, *given, **options)


def test_what_does_not_fit_together_is_refused(animal, modes) -> None:
    ball = sphere(subdivisions=2).geometry
    refused("spectrum", "have the 162 points of `geometry`", HeatGeodesics, ball, modes)
    refused("sources", "name at least one source", HeatGeodesics(animal).distance, [])
    indefinite = sparse.csr_array([[1.0, 2.0], [2.0, 1.0]])
    system = indefinite, np.ones(2) / 100, np.eye(2, 3)
    expected = "have a Laplacian without positive entries"
    refused("geometry", expected, HeatStep, *system, duration=1.0, direct=False)
    level = Heat(np.ones(2), np.zeros(2, np.int32), "", 0, 0.0, 0.0)
    refused("inside", "be a vector with 2 points in it", level.spread, [True])
