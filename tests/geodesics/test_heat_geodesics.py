"""The heat method: analytic truths, invariances, an independent library, and bad input."""

import igl
import numpy as np
import potpourri3d as pp3d
import pytest
from conftest import creature
from scipy import sparse
from scipy.spatial import Delaunay

import spectra_kit as sk
from spectra_kit.errors import ConvergenceError, DoubtfulDistanceWarning, InvalidInputError
from spectra_kit.geodesics import (
    Automatic,
    Direct,
    FacePoint,
    Heat,
    HeatGeodesics,
    Iterative,
    check_sources,
    geodesic_distance,
)
from spectra_kit.geodesics.heat_step import HeatStep
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere
from spectra_kit.linalg import LinearSolution
from spectra_kit.operators.intrinsic import intrinsic_delaunay

SOLVERS = [
    Direct(),
    Iterative(),
    Iterative(coarse="projected"),
    Iterative(coarse="none"),
    Iterative(drop=None, relaxation=0.0, modes=96),
    Automatic(),
]


@pytest.fixture(scope="module")
def animal() -> TriangleMesh:
    return creature(4000, seed=0)


@pytest.fixture(scope="module")
def modes(animal) -> sk.Spectrum:
    return sk.eigensolve(intrinsic_delaunay(animal).laplacian, 60)


def exact(mesh: TriangleMesh, source: int) -> np.ndarray:
    none = np.empty(0, dtype=np.int64)
    ends = np.arange(mesh.n)
    return igl.exact_geodesic(
        np.array(mesh.points), np.array(mesh.faces), np.array([source]), none, ends, none
    )


def relative_error(distance: np.ndarray, truth: np.ndarray) -> float:
    away = truth > 0
    return float((np.abs(distance - truth)[away] / truth[away]).mean())


def tube(length: float, rings: int, around: int = 8, radius: float = 0.5) -> TriangleMesh:
    """An open cylinder along x, whose geodesics are straight once it is unrolled."""
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    x = np.repeat(np.linspace(0, length, rings), around)
    y, z = (np.tile(radius * f(angle), rings) for f in (np.cos, np.sin))
    i, j = (a.ravel() for a in np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij"))
    a, b = around * i + j, around * i + (j + 1) % around
    faces = np.concatenate(
        [np.column_stack([a, a + around, b]), np.column_stack([b, a + around, b + around])]
    )
    return TriangleMesh(np.column_stack([x, y, z]), faces)


# --- truths -------------------------------------------------------------------------------------


@pytest.mark.parametrize("cloud", [False, True])
def test_distances_on_the_sphere_approach_the_angle(cloud) -> None:
    errors, edges = [], []
    for subdivisions in (3, 4, 5):
        mesh = sphere(subdivisions=subdivisions).geometry
        geodesics = HeatGeodesics(mesh.as_cloud() if cloud else mesh)
        angle = np.arccos(np.clip(mesh.points @ mesh.points[0], -1, 1))
        errors.append(relative_error(geodesics.distance(0).distance, angle))
        edges.append(geodesics.triangulation.spacings[0])
    rate = np.polyfit(np.log(edges), np.log(errors), 1)[0]
    assert errors[-1] < 0.01
    assert rate > 0.7  # sqrt(t) is the mean edge: first order, less the growth of 1 / d near 0


def test_errors_are_those_of_an_independent_library(animal) -> None:
    points, faces = np.array(animal.points), np.array(animal.faces)
    theirs = pp3d.MeshHeatMethodDistanceSolver(points, faces)
    ours = HeatGeodesics(animal)
    errors = np.array(
        [
            [
                relative_error(d, exact(animal, source))
                for d in (ours.distance(source).distance, theirs.compute_distance(source))
            ]
            for source in (0, 1000, 2500)
        ]
    )
    assert errors[:, 0].mean() <= 1.05 * errors[:, 1].mean()
    assert errors[:, 0].max() < 0.03


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
        heat = HeatStep(path, np.ones(n), points, duration=duration, direct=direct).solve(heated)
        assert heat.log[-1] < -4000  # exp of it underflows
        assert np.abs((heat.log - heat.log[0]) - (log - log[0])).max() < 1e-7
        assert heat.backward_error <= 1e-10


def test_a_long_tube_does_not_lose_the_heat() -> None:
    mesh = tube(1200.0, 3000)
    for solver in (Direct(), Iterative()):
        distance = HeatGeodesics(mesh, solver=solver).distance(0).distance
        far = distance[mesh.points[:, 0] > 1000]
        assert relative_error(far, np.hypot(mesh.points[:, 0], 0)[mesh.points[:, 0] > 1000]) < 1e-3


def test_heat_of_both_solvers_agrees_point_by_point(animal) -> None:
    triangulation = intrinsic_delaunay(animal)
    laplacian, unit = triangulation.laplacian, triangulation.spacings[0]
    system = laplacian.stiffness, laplacian.mass / unit**2, laplacian.points / unit
    heated = np.zeros(animal.n)
    heated[[5, 700]] = 1.0, 3.0
    both = [HeatStep(*system, duration=3.0, direct=d).solve(heated) for d in (True, False)]
    assert np.abs(both[0].log - both[1].log).max() < 1e-8
    assert both[0].method == "Cholesky"
    assert both[0].iterations == 0 < both[1].iterations


@pytest.mark.parametrize("source", [7, FacePoint(3, (0.2, 0.5, 0.3))], ids=["vertex", "face"])
def test_all_solvers_agree(animal, modes, source) -> None:
    fields = [HeatGeodesics(animal, modes, solver=s).distance(source).distance for s in SOLVERS]
    for field in fields[1:]:
        assert np.abs(field - fields[0]).max() < 1e-7 * fields[0].max()


def test_solvers_agree_where_heat_has_no_direction() -> None:
    mesh = sphere(subdivisions=4).geometry
    middle = FacePoint(0, (1 / 3, 1 / 3, 1 / 3))  # as warm at all three corners
    fields = [HeatGeodesics(mesh, solver=s).distance(middle) for s in (Direct(), Iterative())]
    assert np.abs(fields[1].distance - fields[0].distance).max() < 1e-7 * np.pi


def test_modes_save_iterations_and_projection_no_less(animal, modes) -> None:
    def iterations(**options) -> int:
        solver = Iterative(drop=None, relaxation=0.0, modes=59, **options)
        return HeatGeodesics(animal, modes, solver=solver).distance(7).poisson.iterations

    plain = iterations(coarse="none")
    assert iterations(coarse="additive") <= plain / 2.5
    assert iterations(coarse="projected") <= plain / 2.5


def test_modes_of_another_operator_and_shuffled_ones_do_no_harm(animal, modes) -> None:
    rng = np.random.default_rng(0)
    wrong = sk.Spectrum(
        modes.eigenvalues, modes.eigenvectors[rng.permutation(animal.n)], modes.mass
    )
    other = sk.eigensolve(sk.knn_laplacian(animal), 30)
    wanted = HeatGeodesics(animal, solver=Direct()).distance(7).distance
    for spectrum in (wrong, other):
        found = HeatGeodesics(animal, spectrum, solver=Iterative()).distance(7).distance
        assert np.abs(found - wanted).max() < 1e-7 * wanted.max()


# --- invariances --------------------------------------------------------------------------------


def test_distances_have_the_unit_of_the_input(animal, modes) -> None:
    for factor in (1e-6, 1e6):
        scaled = animal.with_points(factor * animal.points)
        for solver in (Direct(), Iterative()):
            one = HeatGeodesics(animal, modes, solver=solver).distance(7).distance
            other = HeatGeodesics(scaled, modes.rescale(factor), solver=solver).distance(7)
            assert np.abs(other.distance / factor - one).max() < 1e-7 * one.max()
            assert other.heat.iterations == 0 or not isinstance(solver, Direct)


def test_the_order_of_vertices_does_not_matter(animal, modes) -> None:
    order = np.random.default_rng(1).permutation(animal.n)
    place = np.argsort(order)
    shuffled = TriangleMesh(animal.points[order], place[animal.faces])
    spectrum = sk.Spectrum(modes.eigenvalues, modes.eigenvectors[order], modes.mass[order])
    for solver in (Direct(), Iterative()):
        one = HeatGeodesics(animal, modes, solver=solver).distance(7)
        other = HeatGeodesics(shuffled, spectrum, solver=solver).distance(int(place[7]))
        assert np.abs(other.distance - one.distance[order]).max() < 1e-7 * one.distance.max()
        assert other.poisson.iterations <= 1.3 * one.poisson.iterations


def test_same_input_same_bits(animal, modes) -> None:
    geodesics = HeatGeodesics(animal, modes, solver=Iterative())
    first = geodesics.distance(7).distance
    geodesics.distance(8)
    assert np.array_equal(geodesics.distance(7).distance, first)
    again = geodesic_distance(animal, 7, spectrum=modes, solver=Iterative())
    assert np.array_equal(again.distance, first)


# --- sources, boundaries, components --------------------------------------------------------------


def test_several_sources_give_the_distance_to_the_nearest(animal) -> None:
    geodesics = HeatGeodesics(animal)
    both = geodesics.distance([7, 2000]).distance
    nearest = np.minimum(exact(animal, 7), exact(animal, 2000))
    theirs = pp3d.MeshHeatMethodDistanceSolver(np.array(animal.points), np.array(animal.faces))
    peer = theirs.compute_distance_multisource([7, 2000])
    assert relative_error(both, nearest) <= 1.05 * relative_error(peer, nearest)
    assert not both[[7, 2000]].any()


@pytest.mark.parametrize("solver", [Direct(), Iterative()], ids=["direct", "iterative"])
def test_a_region_of_sources_is_at_zero_and_shines_outwards(solver) -> None:
    mesh = sphere(subdivisions=5).geometry
    height = mesh.points[:, 2]
    cap = height > 0.8
    distance = HeatGeodesics(mesh, solver=solver).distance(cap).distance
    assert not distance[cap].any()
    edge = np.arccos(height[cap].min())  # of the cap, up to one edge
    truth = np.arccos(np.clip(height[~cap], -1, 1)) - edge
    away = truth > 0.2
    assert relative_error(distance[~cap][away], truth[away]) < 0.05
    everywhere = HeatGeodesics(mesh, solver=solver).distance(np.ones(mesh.n, dtype=bool))
    assert not everywhere.distance.any()


@pytest.mark.parametrize("boundary", ["neumann", "average"])
@pytest.mark.parametrize("solver", [Direct(), Iterative()], ids=["direct", "iterative"])
def test_the_smallest_geometries(solver, boundary) -> None:
    triangle = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    tetrahedron = TriangleMesh(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    for mesh in (triangle, tetrahedron):
        # Down the middle of each face: its height, as heat is the same at both ends of the side.
        distance = HeatGeodesics(mesh, solver=solver, boundary=boundary).distance(0).distance
        assert distance[1:] == pytest.approx(np.sqrt(0.5))


def test_a_source_inside_a_face_lies_between_its_corners() -> None:
    mesh = rectangle(n=4000).geometry
    face = int(
        np.argmin(np.linalg.norm(mesh.points[mesh.faces].mean(axis=1) - [0.5, 0.8, 0], axis=1))
    )
    point = FacePoint(face, (0.2, 0.3, 0.5))
    truth = np.linalg.norm(mesh.points - point.position(mesh), axis=1)
    inside = HeatGeodesics(mesh).distance(point).distance
    corner = HeatGeodesics(mesh).distance(int(mesh.faces[face, 0])).distance
    assert np.abs(inside - truth).mean() < 0.5 * np.abs(corner - truth).mean()


def test_a_source_that_emits_more_runs_ahead_by_the_logarithm() -> None:
    mesh = tube(100.0, 400)
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


@pytest.mark.parametrize("solver", [Direct(), Iterative()], ids=["direct", "iterative"])
def test_what_no_source_reaches_is_infinite(solver) -> None:
    one = sphere(subdivisions=3).geometry
    two = TriangleMesh(
        np.concatenate([one.points, 3 * one.points + [9, 0, 0]]),
        np.concatenate([one.faces, one.faces + one.n]),
    )
    geodesics = HeatGeodesics(two, solver=solver)
    alone = HeatGeodesics(one, solver=solver).distance(0)
    field = geodesics.distance(0)
    assert np.isinf(field.distance[one.n :]).all()
    assert field.reached.sum() == one.n
    assert np.abs(field.distance[: one.n] - alone.distance).max() < 1e-7
    both = geodesics.distance([0, one.n + 5])
    assert both.reached.all()
    assert both.distance[0] == both.distance[one.n + 5] == 0
    assert np.abs(both.distance[: one.n] - alone.distance).max() < 1e-7


def test_the_average_of_boundary_conditions_lies_between_them() -> None:
    mesh = rectangle(n=4000).geometry
    source = int(np.argmin(np.linalg.norm(mesh.points - [0.5, 0.2, 0], axis=1)))
    away = np.linalg.norm(mesh.points - mesh.points[source], axis=1)
    errors = {
        boundary: relative_error(HeatGeodesics(mesh, boundary=boundary).distance(source), away)
        for boundary in ("neumann", "dirichlet", "average")
    }
    assert errors["neumann"] < errors["average"] < errors["dirichlet"] < 0.05
    with pytest.raises(InvalidInputError, match="must not all lie on the boundary"):
        HeatGeodesics(mesh, boundary="dirichlet").distance(0)
    on_edge = [HeatGeodesics(mesh, boundary=b).distance(0) for b in ("neumann", "average")]
    assert np.abs(on_edge[0].distance - on_edge[1].distance).max() < 1e-12


@pytest.mark.parametrize("solver", [Direct(), Iterative()], ids=["direct", "iterative"])
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


def test_a_cold_boundary_that_cuts_the_surface_apart_is_refused() -> None:
    sheet = rectangle(n=100).geometry
    right = sheet.points[:, 0].max()
    bridge = np.flatnonzero(sheet.points[:, 0] == right)[4:6]  # the ends of one side
    other = TriangleMesh(sheet.points + [right, 0, 0], sheet.faces)
    twin = np.flatnonzero(other.points[:, 0] == right)[4:6]
    moved = other.points + [0.1, 0, 0]
    a, b = bridge
    c, d = twin + sheet.n
    faces = [sheet.faces, sheet.faces + sheet.n, [[a, c, b], [b, c, d]]]
    strip = TriangleMesh(np.vstack([sheet.points, moved]), np.vstack(faces))
    middle = int(np.argmin(np.linalg.norm(sheet.points - sheet.points.mean(axis=0), axis=1)))
    for solver in (Direct(), Iterative()):
        with pytest.raises(InvalidInputError, match=r"cuts \d+ points off"):
            HeatGeodesics(strip, solver=solver, boundary="dirichlet").distance(middle)
        field = HeatGeodesics(strip, solver=solver, boundary="average").distance(middle)
        assert field.distance.max() > 1.5 * right
    triangle = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    with pytest.raises(InvalidInputError, match="must not all lie on the boundary"):
        HeatGeodesics(triangle, boundary="dirichlet").distance(0)


def test_a_closed_surface_has_no_boundary_condition(animal) -> None:
    one, other = (HeatGeodesics(animal, boundary=b).distance(7) for b in ("neumann", "dirichlet"))
    assert np.array_equal(one.distance, other.distance)


# --- choice and record ----------------------------------------------------------------------------


def test_the_choice_is_explained(animal, modes) -> None:
    small = geodesic_distance(animal, 0)
    assert (small.solver, small.reason) == (Direct(), "4000 points are few")
    forced = HeatGeodesics(animal, modes, solver=Iterative()).distance(0)
    assert (forced.solver, forced.reason) == (Iterative(), "as asked")
    assert forced.choice == "two-level iterative (additive): as asked"
    plain = HeatGeodesics(animal, solver=Iterative()).distance(0)
    assert (plain.solver, plain.solver.name) == (Iterative(coarse="none"), "iterative")
    choose = Automatic().choose
    assert isinstance(choose(100_000, 1)[0], Iterative)
    assert isinstance(choose(100_000, 20)[0], Direct)
    assert "more than" in choose(50_000_000, 20)[1]
    assert isinstance(Automatic(memory=0.001).choose(100_000, 20)[0], Iterative)


def test_triangles_of_very_different_size() -> None:
    rng = np.random.default_rng(0)
    coarse, fine = rng.random((3000, 2)), 0.5 + 0.001 * rng.random((9000, 2))
    flat = np.vstack([coarse, fine, [[0, 0], [1, 0], [0, 1], [1, 1]]])
    mesh = TriangleMesh(np.column_stack([flat, np.zeros(len(flat))]), Delaunay(flat).simplices)
    fields = [HeatGeodesics(mesh, solver=s).distance(0) for s in (Direct(), Iterative())]
    assert np.abs(fields[1].distance - fields[0].distance).max() < 1e-7
    assert fields[1].heat.iterations < 60
    assert relative_error(fields[0], np.linalg.norm(mesh.points - mesh.points[0], axis=1)) < 0.1


def test_a_spectrum_without_modes_is_none(animal, modes) -> None:
    field = HeatGeodesics(animal, modes.truncate(1), solver=Iterative()).distance(0)
    assert field.solver == Iterative(coarse="none")


def test_a_time_so_long_that_heat_is_level_is_warned_of(animal) -> None:
    with pytest.warns(DoubtfulDistanceWarning, match="lower `time_coefficient`"):
        geodesic_distance(animal, 7, time_coefficient=1e12)


def test_many_sources_or_the_promise_of_them_decide_alike() -> None:
    mesh = sphere(subdivisions=5).geometry  # 10,242 points
    geodesics = HeatGeodesics(mesh)
    fields = geodesics.distances([[i] for i in range(6)])
    promised = HeatGeodesics(mesh, solver=Automatic(n_sources=6)).distance(0)
    assert {f.solver for f in (*fields, promised)} == {Direct()}
    assert {f.reason for f in fields} == {promised.reason}
    alone = [geodesics.distance(0), HeatGeodesics(mesh).distance(0)]  # whatever was asked before
    assert {f.solver for f in alone} == {Iterative(coarse="none")}
    assert np.array_equal(alone[0], alone[1])


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


def test_an_iteration_limit_keeps_what_there_is(animal) -> None:
    with pytest.raises(ConvergenceError) as caught:
        geodesic_distance(animal, 7, solver=Iterative(coarse="none", max_iterations=5))
    partial = caught.value.partial
    assert partial.poisson.iterations == 5
    assert not partial.poisson.converged
    assert np.isfinite(partial.distance).all()


def test_heat_that_does_not_get_there_is_kept(animal, monkeypatch) -> None:
    monkeypatch.setattr("spectra_kit.geodesics.heat_step._ACCURACY", 1e-30)
    with pytest.raises(ConvergenceError, match="heat step must be right") as caught:
        geodesic_distance(animal, 7, solver=Iterative())
    assert isinstance(caught.value.partial, Heat)
    assert caught.value.partial.backward_error < 1e-10


def test_a_matrix_that_is_no_laplacian_has_no_heat_step() -> None:
    indefinite = sparse.csr_array([[1.0, 2.0], [2.0, 1.0]])
    with pytest.raises(InvalidInputError, match="has no incomplete factor"):
        HeatStep(indefinite, np.ones(2) / 100, np.eye(2, 3), duration=1.0, direct=False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"solver": "direct"}, "`solver` must be a Direct, Iterative or Automatic"),
        ({"boundary": "robin"}, "`boundary` must be"),
        ({"time_coefficient": 0.0}, "`time_coefficient` must be positive"),
        ({"time_coefficient": 1e200}, "`time_coefficient` must be in .1e-30, 1e.30., got 1e.200"),
        ({"spectrum": "modes"}, "`spectrum` must be a Spectrum"),
    ],
)
def test_wrong_options(animal, arguments, message) -> None:
    with pytest.raises(InvalidInputError, match=message):
        HeatGeodesics(animal, **arguments)


def test_a_spectrum_of_other_points(animal) -> None:
    spectrum = sk.eigensolve(sk.robust_laplacian(sphere(subdivisions=2).geometry), 5)
    with pytest.raises(InvalidInputError, match="must have the 4000 points"):
        HeatGeodesics(animal, spectrum)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Iterative(coarse="both"), "`coarse` must be"),
        (lambda: Iterative(modes=0), "`modes`"),
        (lambda: Iterative(drop=-1.0), "`drop`"),
        (lambda: Iterative(relaxation=1.5), "`relaxation`"),
        (lambda: Iterative(rtol=0.0), "`rtol`"),
        (lambda: Iterative(rtol=10.0), "`rtol` must be less than 1"),
        (lambda: Automatic(modes=0), "`modes`"),
        (lambda: Iterative(max_iterations=0), "`max_iterations`"),
        (lambda: Automatic(n_sources=0), "`n_sources`"),
        (lambda: Automatic(memory=0.0), "`memory`"),
    ],
)
def test_wrong_solvers(make, message) -> None:
    with pytest.raises(InvalidInputError, match=message):
        make()


def test_wrong_sources(animal) -> None:
    geodesics = HeatGeodesics(animal)
    with pytest.raises(InvalidInputError, match="at least one source"):
        geodesics.distance([])
    with pytest.raises(InvalidInputError, match="sources"):
        geodesics.distance(animal.n)
    lonely = TriangleMesh(np.vstack([animal.points, [[9.0, 9.0, 9.0]]]), animal.faces)
    with pytest.raises(InvalidInputError, match="without_unreferenced"):
        HeatGeodesics(lonely)
    cloud = PointCloud(animal.points)
    with pytest.raises(InvalidInputError, match="FacePoint"):
        HeatGeodesics(cloud).distance(FacePoint(0, (1.0, 0.0, 0.0)))
    checked = check_sources(FacePoint(0, (0.2, 0.3, 0.5)), animal)
    triangulated = HeatGeodesics(intrinsic_delaunay(animal)).distance(checked)
    assert np.array_equal(triangulated.distance, geodesics.distance(checked).distance)
