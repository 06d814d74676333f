"""``L u = b`` with values held at points: closed forms, minimality, what is kept for the next."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from conftest import bumpy, creature, moebius, refused, two_parts, two_sheets
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay

from spectra_kit import (
    InvalidInputError,
    Laplacian,
    TriangleMesh,
    cotan_laplacian,
    delaunay_laplacian,
    robust_laplacian,
)
from spectra_kit.geometry import permuted, rectangle, sphere
from spectra_kit.operators import poisson, schroedinger


def disk(rings: int) -> TriangleMesh:
    """The unit disk, by rings of six more points each."""
    angles = [2 * np.pi * np.arange(6 * k) / (6 * k) for k in range(1, rings + 1)]
    radii = [np.full(6 * k, k / rings) for k in range(1, rings + 1)]
    r, a = np.append(0, np.concatenate(radii)), np.append(0, np.concatenate(angles))
    flat = np.stack([r * np.cos(a), r * np.sin(a)], axis=1)
    faces = Delaunay(flat).simplices
    return TriangleMesh(np.c_[flat, np.zeros(len(r))], faces)


def scattered() -> TriangleMesh:
    """An irregular triangulation of a sheet, with diagonals either way."""
    sheet = rectangle(n=500, height=1.0).geometry
    flat = np.array(sheet.points[:, :2])
    inside = np.setdiff1d(np.arange(sheet.n), sheet.boundary_vertices)
    flat[inside] += 0.015 * (np.random.default_rng(0).random((len(inside), 2)) - 0.5)
    return TriangleMesh(np.c_[flat, np.zeros(len(flat))], Delaunay(flat).simplices)


def error(laplacian: Laplacian, found: np.ndarray, true: np.ndarray) -> float:
    return float(np.sqrt(laplacian.mass @ (found - true) ** 2))


def on_rectangle(level: int, held: bool) -> tuple[Laplacian, np.ndarray, np.ndarray]:
    mesh = rectangle(n=300 * 4**level, height=1.0).geometry
    x, y = np.pi * mesh.points[:, :2].T
    laplacian = robust_laplacian(mesh)
    if held:
        return laplacian.dirichlet(mesh.boundary_vertices), np.sin(x) * np.sin(2 * y), 5 * np.pi**2
    return laplacian, np.cos(x) * np.cos(2 * y), 5 * np.pi**2


def on_sphere(level: int) -> tuple[Laplacian, np.ndarray, np.ndarray]:
    mesh = sphere(subdivisions=level + 2).geometry
    x, y, z = mesh.points.T
    return robust_laplacian(mesh), x * y + (x**2 - z**2), 6.0


def on_disk(level: int) -> tuple[Laplacian, np.ndarray, np.ndarray]:
    mesh = disk(8 * 2**level)
    x, y, _ = mesh.points.T
    rest = 1 - x**2 - y**2
    laplacian = delaunay_laplacian(mesh).dirichlet(mesh.boundary_vertices)
    return laplacian, rest * np.exp(x), np.exp(x) * (4 * x + 4 - rest)


@pytest.mark.parametrize(
    "case",
    [lambda level: on_rectangle(level, True), lambda level: on_rectangle(level, False)]
    + [on_sphere, on_disk],
    ids=["held rectangle", "free rectangle", "sphere", "held disk"],
)
def test_poisson_converges_to_known_solutions_of_second_order(case) -> None:
    errors, sizes = [], []
    for level in range(3):
        laplacian, true, factor = case(level)
        f = factor * true if np.isscalar(factor) else factor
        if not len(laplacian.fixed):
            f, true = (g - laplacian.mass @ g / laplacian.area for g in (f, true))
        errors.append(error(laplacian, poisson(laplacian, f), true))
        sizes.append(laplacian.n**-0.5)
    rate = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert rate == pytest.approx(2, abs=0.2), errors


def test_linear_functions_on_a_plane_are_harmonic() -> None:
    mesh = scattered()
    slopes = np.array([[1.0, -2.0, 0.0], [0.5, 3.0, 1.0]])
    values, rim = mesh.points @ slopes.T + [0.0, 7.0], mesh.boundary_vertices
    for build in (delaunay_laplacian, cotan_laplacian):
        found = build(mesh).solve(fixed=rim, values=values[rim])
        np.testing.assert_allclose(found, values, atol=1e-12)
    turned = robust_laplacian(mesh).solve(fixed=rim[::-1], values=values[rim[::-1]])
    np.testing.assert_allclose(turned, values, atol=1e-12)


@pytest.mark.parametrize(
    "shape",
    [creature(800), creature(500).as_cloud(), moebius(), two_sheets(), scattered()],
    ids=["mesh", "cloud", "one-sided", "non-manifold", "open"],
)
def test_interpolation_has_no_greater_values_and_the_least_energy(shape) -> None:
    laplacian, rng = delaunay_laplacian(shape), np.random.default_rng(0)
    fixed = rng.choice(laplacian.n, 12, replace=False)
    colours = rng.random((12, 3))
    u = laplacian.solve(fixed=fixed, values=colours)
    assert (u[fixed] == colours).all()
    assert (u >= colours.min(axis=0) - 1e-12).all()
    assert (u <= colours.max(axis=0) + 1e-12).all()
    free = np.setdiff1d(np.arange(laplacian.n), fixed)
    assert np.abs((laplacian.stiffness @ u)[free]).max() < 1e-11
    # What differs inside has the energy of the difference more.
    other = np.where(np.isin(np.arange(laplacian.n), fixed), 0, rng.standard_normal(laplacian.n))
    energy = [v @ laplacian.stiffness @ v for v in (u[:, 0], u[:, 0] + other, other)]
    assert energy[1] == pytest.approx(energy[0] + energy[2])


def test_it_is_what_scipy_finds_on_parts_that_are_held_and_on_others() -> None:
    laplacian, rng = robust_laplacian(two_parts()), np.random.default_rng(1)
    first = laplacian.component_labels == laplacian.component_labels[0]
    fixed, values = np.flatnonzero(first)[[3, 40, 7]], np.array([1.0, -2.0, 0.5])
    rhs = rng.standard_normal(laplacian.n)
    rhs[~first] -= laplacian.mass[~first] * rhs[~first].sum() / laplacian.mass[~first].sum()
    u = laplacian.solve(rhs, fixed=fixed, values=values)
    free = np.setdiff1d(np.flatnonzero(first), fixed)
    L = laplacian.stiffness.tocsc()
    expected = spsolve(L[free][:, free], rhs[free] - L[free][:, fixed] @ values)
    np.testing.assert_allclose(u[free], expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose((L @ u)[~first], rhs[~first], atol=1e-10)
    assert abs(laplacian.mass[~first] @ u[~first]) < 1e-12
    with pytest.raises(InvalidInputError, match="`fixed` must name a point of each component"):
        laplacian.solve(fixed=fixed, values=values)


def test_points_held_by_the_operator_potentials_and_brought_in_matrices() -> None:
    L = robust_laplacian(bumpy(162))
    rng = np.random.default_rng(2)
    rhs = rng.standard_normal(L.n)
    potential = rng.random(L.n)
    held = L.dirichlet([0, 5])
    for operator, fixed, values in [
        (held, None, None),
        (held, [5, 9], [2.0, 3.0]),  # 0 stays at zero, 5 does not
        (schroedinger(L, potential), None, None),
        (schroedinger(held, potential), [1], [1.0]),
    ]:
        u = operator.solve(rhs, fixed=fixed, values=values)
        at = np.union1d(operator.fixed, fixed or []).astype(int)
        expected = np.zeros(L.n)
        expected[fixed or []] = values or []
        free = np.setdiff1d(np.arange(L.n), at)
        A = operator.stiffness.toarray()
        inner = rhs[free] - A[np.ix_(free, at)] @ expected[at]
        expected[free] = np.linalg.solve(A[np.ix_(free, free)], inner)
        np.testing.assert_allclose(u, expected, atol=1e-11)
    loose = sparse.csr_array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    lone = Laplacian(loose, [1, 3, 1], np.eye(3))
    np.testing.assert_allclose(lone.solve([3.0, -3.0, 0.0]), [2.25, -0.75, 0.0], atol=1e-15)


def test_several_columns_are_bit_by_bit_those_alone() -> None:
    L, rng = robust_laplacian(creature(600)), np.random.default_rng(3)
    fixed = [5, 2, 99]
    rhs, values = rng.standard_normal((L.n, 11)), rng.standard_normal((3, 11))
    together = L.solve(rhs, fixed=fixed, values=values)
    for i in range(11):
        alone = L.solve(rhs[:, i], fixed=fixed, values=values[:, i])
        assert (alone == together[:, i]).all()
    same = L.solve(rhs, fixed=fixed, values=1.5)
    assert (same[fixed] == 1.5).all()
    free = rhs - L.mass[:, None] * rhs.sum(axis=0) / L.area
    assert (L.solve(free)[:, 4] == L.solve(free[:, 4])).all()


def test_a_factor_is_kept_for_the_same_points_and_no_other() -> None:
    L = robust_laplacian(creature(600))
    first = L.solve(fixed=[1, 30], values=[0.0, 1.0])
    (kept,) = (value for value in vars(L).values() if type(value) is tuple)
    mask = np.isin(np.arange(L.n), [1, 30])
    again = L.solve(fixed=mask, values=[0.0, 1.0])
    turned = L.solve(fixed=[30, 1], values=[1.0, 0.0])
    assert (first == again).all()
    assert (first == turned).all()
    assert kept in [value for value in vars(L).values() if value is kept]
    other = L.solve(fixed=[1, 31], values=[0.0, 1.0])
    now = [value for value in vars(L).values() if type(value) is tuple]
    assert len(now) == 1
    assert now[0] is not kept
    assert (other == robust_laplacian(creature(600)).solve(fixed=[1, 31], values=[0, 1])).all()
    assert (L.solve(fixed=[1, 30], values=[0.0, 1.0]) == first).all()


@pytest.mark.parametrize("scale", [1e-90, 1e90])
def test_any_unit_and_any_order_of_points(scale) -> None:
    mesh = creature(600)
    fixed, values = np.array([3, 77, 410]), np.array([1.0, 2.0, 4.0])
    L = robust_laplacian(mesh)
    u = L.solve(fixed=fixed, values=values)
    larger = robust_laplacian(mesh.with_points(scale * mesh.points))
    np.testing.assert_allclose(larger.solve(fixed=fixed, values=values), u, atol=1e-9)
    f = mesh.points[:, 0] - L.mass @ mesh.points[:, 0] / L.area
    g = f - larger.mass @ f / larger.area
    np.testing.assert_allclose(
        poisson(larger, g) / scale**2, poisson(L, f), atol=1e-8 * np.ptp(poisson(L, f))
    )
    copy, truth = permuted(mesh)
    back = np.argsort(truth)
    moved = robust_laplacian(copy).solve(fixed=back[fixed], values=values)
    np.testing.assert_allclose(moved, u[truth], atol=1e-10)


def test_one_triangle() -> None:
    L = robust_laplacian(TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    u = L.solve(fixed=[0, 1], values=[1.0, 3.0])
    assert u[2] == pytest.approx(1.0, abs=1e-4)  # the natural condition: level across the legs
    np.testing.assert_allclose(L.stiffness @ L.solve([1.0, 0.0, -1.0]), [1, 0, -1], atol=1e-12)


ONES = np.ones(162)


@pytest.mark.parametrize(
    ("argument", "expected", "given"),
    [
        ("rhs", "be given where no point is held", {}),
        ("rhs", "have shape (162,) or (162, c)", {"rhs": np.ones(5)}),
        ("rhs", "have shape (162,) or (162, c)", {"rhs": np.ones((162, 0))}),
        ("rhs", "sum to zero (a density: times mass)", {"rhs": np.ones(162)}),
        ("values", "come with the points that have them", {"rhs": np.ones(162), "values": 1.0}),
        ("values", "be a number or have shape (2,)", {"fixed": [1, 2], "values": np.ones(3)}),
        ("values", "be a number or have shape (1,)", {"rhs": ONES, "fixed": [1], "values": [[1]]}),
        ("fixed", "be a vector of points, each once", {"fixed": [1, 1], "values": 1.0}),
        ("fixed", "be a vector of points, each once", {"fixed": [], "values": 1.0}),
        ("fixed", "be a vector of points, each once", {"fixed": 3, "values": 1.0}),
        ("fixed", "leave at least one point free", {"fixed": np.arange(162), "values": 1.0}),
        ("fixed", "be in [0, 162)", {"fixed": [162], "values": 1.0}),
    ],
)  # fmt: skip
def test_refused(argument, expected, given) -> None:
    refused(argument, expected, robust_laplacian(bumpy(162)).solve, **given)


def test_a_density_is_refused_by_its_own_name() -> None:
    L = robust_laplacian(bumpy(162))
    refused("density", "sum to zero (a density: times mass)", poisson, L, np.ones(L.n))
    refused("density", "have shape", poisson, L, np.ones(3))
    with pytest.raises(InvalidInputError, match=r"that of point 0; subtract mass \* "):
        poisson(L, np.ones(L.n))


def test_what_is_not_definite_is_refused() -> None:
    indefinite = sparse.csr_array([[1.0, -2.0, 0.0], [-2.0, 1.0, -1.0], [0.0, -1.0, 1.0]])
    L = Laplacian(indefinite, np.ones(3), np.eye(3))
    refused("laplacian", "be positive definite off the points", L.solve, fixed=[2], values=1.0)


def test_lapy_finds_the_same() -> None:
    lapy = pytest.importorskip("lapy")
    mesh = bumpy()
    rim = np.arange(0, mesh.n, 50)
    values = np.sin(np.arange(len(rim)))
    theirs = lapy.Solver(lapy.TriaMesh(np.array(mesh.points), np.array(mesh.faces)), lump=True)
    ours = Laplacian(theirs.stiffness, theirs.mass, mesh.points)
    f = mesh.points[:, 1]
    expected = theirs.poisson(f, dtup=(rim, values))
    np.testing.assert_allclose(poisson(ours, f, fixed=rim, values=values), expected, atol=1e-6)
    harmonic = cotan_laplacian(mesh).solve(fixed=rim, values=values)
    np.testing.assert_allclose(harmonic, theirs.poisson(0.0, dtup=(rim, values)), atol=1e-6)
    from lapy.heat import diffusion  # one implicit step

    shape = lapy.TriaMesh(np.array(mesh.points), np.array(mesh.faces))
    t = shape.avg_edge_length() ** 2
    step = schroedinger(ours, 1 / t).solve((np.arange(mesh.n) == 17) / t)
    np.testing.assert_allclose(step, diffusion(shape, [17], m=1.0), rtol=1e-6)


STARVED = """
import resource
import numpy as np
from scipy import sparse
from spectra_kit import Laplacian
from spectra_kit.errors import OutOfMemoryError

side = 30  # of a cube of points, whose factor fills up
path = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(side, side))
one = sparse.eye_array(side)
square = sparse.kron(path, one) + sparse.kron(one, path)
cube = sparse.csr_array(sparse.kron(square, one) + sparse.kron(sparse.eye_array(side**2), path))
grid = np.stack(np.meshgrid(*[np.arange(side)] * 3), axis=-1).reshape(-1, 3)
Laplacian(path, np.ones(side), grid[:side]).solve(fixed=[0], values=1.0)  # imports, compiles
laplacian = Laplacian(cube, np.ones(side**3), grid)
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + 60 * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
try:
    laplacian.solve(fixed=[0], values=1.0)
except OutOfMemoryError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="counts memory as Linux does")
def test_want_of_memory_is_told() -> None:
    done = subprocess.run(
        [sys.executable, "-c", STARVED], capture_output=True, text=True, check=False
    )
    told = "the factor of 27000 unknowns does not fit into memory; take a coarser geometry\n"
    assert done.stdout == told, done.stderr


def test_threads_that_hold_other_points_get_their_own_answers():
    laplacian = delaunay_laplacian(rectangle(n=60).geometry)
    x = laplacian.points[:, 0]
    held = [np.arange(i, laplacian.n, 5) for i in range(5)]
    alone = [laplacian.solve(fixed=at, values=x[at]) for at in held]
    with ThreadPoolExecutor(8) as pool:
        asked = [
            pool.submit(laplacian.solve, fixed=held[i % 5], values=x[held[i % 5]])
            for i in range(400)
        ]
        for i, one in enumerate(asked):
            np.testing.assert_array_equal(one.result(), alone[i % 5])
