"""Operators of meshes and of user-made matrices: definitions, laws, units, and what is refused."""

import igl
import numpy as np
import pytest
from conftest import bumpy, joined, moved, refused, two_parts
from scipy import sparse

from spectra_kit import (
    Laplacian,
    PointCloud,
    TriangleMesh,
    cotan_laplacian,
    delaunay_laplacian,
    knn_laplacian,
    robust_laplacian,
)
from spectra_kit.catalogue import OPERATORS as NAMED
from spectra_kit.geometry import rectangle, sphere

OPERATORS = [entry.made_by for entry in NAMED.values()]  # a new one is among them by its line
MESH_OPERATORS = [robust_laplacian, cotan_laplacian, delaunay_laplacian]


def test_symmetric_semi_definite_with_constant_kernel() -> None:
    mesh = bumpy()
    for build in OPERATORS:
        L = build(mesh)
        dense = L.stiffness.toarray()
        assert np.abs(dense - dense.T).max() < 1e-12
        assert np.linalg.eigvalsh(dense)[0] > -1e-12
        assert np.abs(dense.sum(axis=1)).max() < 1e-12
        assert (L.mass > 0).all()
        assert (L.n_components, L.kernel_dimension) == (1, 1)
        if build is not knn_laplacian:
            assert L.area == pytest.approx(mesh.area, rel=1e-12)


def test_cotan_is_libigl_with_the_sign_turned_and_robust_where_it_is_delaunay() -> None:
    mesh, ball = bumpy(), sphere(subdivisions=3).geometry
    expected = -igl.cotmatrix(np.array(mesh.points), np.array(mesh.faces))
    assert abs(cotan_laplacian(mesh).stiffness - expected).max() == 0
    difference = robust_laplacian(ball).stiffness - cotan_laplacian(ball).stiffness
    assert abs(difference).max() < 1e-4  # the mollification, 1e-5 of an edge


def test_knn_follows_its_definition_entry_by_entry() -> None:
    points = np.random.default_rng(0).standard_normal((40, 3))
    k = 5
    d = np.linalg.norm(points[:, None] - points[None], axis=2)
    nearest = np.argsort(d, axis=1)[:, 1 : k + 1]
    eps = np.median(np.take_along_axis(d, nearest, axis=1).mean(axis=1)) ** 2
    W = np.zeros((40, 40))
    for i in range(40):
        for j in nearest[i]:
            W[i, j] += np.exp(-(d[i, j] ** 2) / eps) / 2
            W[j, i] += np.exp(-(d[i, j] ** 2) / eps) / 2
    q = W.sum(axis=1)
    K = W / np.outer(q, q)
    L = knn_laplacian(PointCloud(points), n_neighbors=k)
    assert L.stiffness.toarray() == pytest.approx(np.diag(K.sum(axis=1)) - K, abs=1e-14)
    assert L.mass == pytest.approx(K.sum(axis=1))


def test_spacing_is_near_weyls_and_that_of_each_component_its_own() -> None:
    ball = sphere(subdivisions=3).geometry
    for mesh in (ball, rectangle(n=600).geometry):
        L = robust_laplacian(mesh)
        assert L.eigenvalue_spacing == pytest.approx(4 * np.pi / L.area, rel=0.3)
    L = robust_laplacian(joined(ball, moved(ball, 5, scale=1e-4)))
    alone = robust_laplacian(ball).eigenvalue_spacing
    assert L.component_spacings == pytest.approx([alone, 1e8 * alone], rel=1e-6)
    assert L.kernel_dimension == 2


def test_kernels_of_components_potentials_and_fixed_points() -> None:
    L = robust_laplacian(two_parts())
    assert (L.n_components, L.kernel_dimension) == (2, 2)
    first = np.flatnonzero(L.component_labels == 0)[:3]
    held = L.dirichlet(first)
    assert (held.n_components, held.kernel_dimension) == (2, 1)
    assert (held.component_labels[first] == -1).all()
    mask = np.isin(np.arange(L.n), first)
    assert L.dirichlet(mask).fixed.tolist() == held.fixed.tolist() == first.tolist()
    assert L.dirichlet([]).fixed.tolist() == []
    well = Laplacian(L.stiffness + sparse.diags_array(L.mass), L.mass, L.points)
    assert well.kernel_dimension == 0


def test_dirty_meshes_that_the_robust_operator_takes() -> None:
    ball = sphere(subdivisions=2).geometry
    # A fin on an edge makes it non-manifold; a face twice; a needle of zero area.
    fin = np.vstack([ball.points, [[0, 0, 2.0]]])
    edge = ball.faces[0, :2]
    needle = [ball.faces[0, 0], ball.faces[0, 1], ball.n + 1]
    points = np.vstack([fin, fin[edge].mean(axis=0)])
    faces = np.vstack([ball.faces, [*edge, ball.n], ball.faces[5], needle])
    L = robust_laplacian(TriangleMesh(points, faces))
    assert L.n_components == 1
    assert np.isfinite(L.stiffness.data).all()


def test_mass_may_be_a_diagonal_matrix() -> None:
    for matrix in (sparse.diags([1.0, 2, 3, 4]), np.diag([1.0, 2, 3, 4])):
        assert Laplacian(path(), matrix, POINTS).mass.tolist() == [1, 2, 3, 4]


def parts_of(size: float, place: float) -> tuple[TriangleMesh, TriangleMesh]:
    """A body, and it together with a copy of another size at another place."""
    return bumpy(), joined(bumpy(), moved(bumpy(), place, scale=size))


@pytest.mark.parametrize(("size", "place"), [(1e-6, 3), (1e-12, 0), (1e6, 3e6)])
@pytest.mark.parametrize("build", MESH_OPERATORS)
def test_parts_of_any_size_have_the_operator_that_they_have_alone(build, size, place) -> None:
    body, both = parts_of(size, place)
    alone, L = build(body), build(both)
    areas = np.bincount(np.repeat([0, 1], len(body.faces)), both.face_areas)
    masses = np.bincount(np.repeat([0, 1], body.n), L.mass)
    assert masses == pytest.approx(areas, rel=1e-7)  # of the coordinates far from the origin
    for part, unit in ((slice(None, body.n), 1.0), (slice(body.n, None), size)):
        assert abs(L.stiffness[part, part] - alone.stiffness).max() < 1e-7
        assert L.mass[part] / unit**2 == pytest.approx(alone.mass, rel=1e-7)


@pytest.mark.parametrize("exponent", [-420, 420])
@pytest.mark.parametrize("build", [*OPERATORS, "cloud"])
def test_powers_of_two_change_no_bit(build, exponent: int) -> None:
    body = bumpy()
    scaled = body.with_points(np.ldexp(body.points, exponent))
    if build == "cloud":
        build, body, scaled = delaunay_laplacian, body.as_cloud(), scaled.as_cloud()
    L, other = build(body), build(scaled)
    np.testing.assert_array_equal(other.stiffness.toarray(), L.stiffness.toarray())
    unit = 0 if build is knn_laplacian else 2 * exponent
    np.testing.assert_array_equal(other.mass, np.ldexp(L.mass, unit))


@pytest.mark.parametrize("scale", [1e-320, 1e-160, 1e160, 1e308])
def test_units_in_which_areas_are_no_numbers_are_refused(scale: float) -> None:
    body = bumpy()
    body = body.with_points(scale * (body.points / np.abs(body.points).max()))
    for build in OPERATORS:
        refused("geometry", "have an extent", build, body)
    refused("geometry", "have an extent", delaunay_laplacian, body.as_cloud())


def path(n: int = 4) -> sparse.csr_array:
    L = np.diag([1.0] + [2.0] * (n - 2) + [1.0])
    return sparse.csr_array(L - np.eye(n, k=1) - np.eye(n, k=-1))


POINTS = np.arange(12.0).reshape(4, 3)
TRIANGLES = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]
LINE = TriangleMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
COPY = TriangleMesh(TRIANGLES, [[0, 1, 2], [1, 3, 2], [2, 1, 0]])
FAR = PointCloud([*bumpy().points, [1e4, 0, 0]])
DENSE = PointCloud([*(1e-170 * bumpy().points), [1, 0, 0]])
UPPER = sparse.csr_array(np.triu(np.ones((4, 4))))


def user_made(stiffness=None, mass=(1, 1, 1, 1)) -> Laplacian:
    return Laplacian(path() if stiffness is None else stiffness, mass, POINTS)


@pytest.mark.parametrize(
    ("make", "argument", "expected"),
    [
        (lambda: user_made(path(5)), "stiffness", "be a scipy sparse array of shape (4, 4)"),
        (lambda: user_made(np.eye(4)), "stiffness", "be a scipy sparse array"),
        (lambda: user_made(-path()), "stiffness", "be positive semi-definite"),
        (lambda: user_made(UPPER), "stiffness", "be symmetric"),
        (lambda: user_made(path() * np.nan), "stiffness", "be finite"),
        (lambda: user_made(path() * 1j), "stiffness", "hold real numbers"),
        (lambda: user_made(mass=[1, 1, 0, 1]), "mass", "be positive"),
        (lambda: user_made(mass=np.ones(3)), "mass", "have shape (4,)"),
        (lambda: user_made(mass=UPPER), "mass", "be symmetric"),
        (lambda: user_made().dirichlet(range(4)), "fixed", "leave at least one point free"),
        (lambda: user_made().dirichlet([4]), "vertices", "be in [0, 4)"),
        (lambda: user_made().dirichlet([0.7, 3.0]), "vertices", "hold integers"),
        (
            lambda: user_made().restricted(np.array([], int)),
            "indices",
            "be a vector of at least one point",
        ),
        (lambda: robust_laplacian(COPY, mollify_factor=-1), "mollify_factor", "be positive"),
        (lambda: robust_laplacian(TriangleMesh(POINTS, [[0, 1, 2]])), "mesh", "have a face at"),
        (
            lambda: robust_laplacian(TriangleMesh(TRIANGLES, [[0, 1, 2], [1, 3, 1]])),
            "mesh",
            "have three corners to a face, got 1 face with a vertex twice",
        ),
        (lambda: robust_laplacian(parts_of(1e-160, 0)[1]), "geometry", "have components of an"),
        (lambda: cotan_laplacian(LINE), "mesh", "have faces on which cotangents exist, got 1 face"),
        (lambda: cotan_laplacian(COPY), "mesh", "have each face once, got 1 duplicate face"),
        (lambda: cotan_laplacian(FAR), "mesh", "be a TriangleMesh"),
        (lambda: knn_laplacian(FAR), "geometry", "have neighbours of all points"),
        (lambda: knn_laplacian(DENSE, n_neighbors=5), "geometry", "have neighbours at distances"),
        (lambda: knn_laplacian(COPY, n_neighbors=4), "n_neighbors", "be in [1, 3]"),
    ],
)
def test_bad_input(make, argument, expected) -> None:
    refused(argument, expected, make)
