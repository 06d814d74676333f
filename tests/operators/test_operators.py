import igl
import numpy as np
import pytest
from conftest import bumpy, refused, two_parts
from scipy import sparse

from spectra_kit import (
    InvalidInputError,
    Laplacian,
    PointCloud,
    TriangleMesh,
    cotan_laplacian,
    delaunay_laplacian,
    eigensolve,
    knn_laplacian,
    robust_laplacian,
)
from spectra_kit.geometry import rectangle, sphere

OPERATORS = [robust_laplacian, cotan_laplacian, knn_laplacian]
MESH_OPERATORS = [robust_laplacian, cotan_laplacian, delaunay_laplacian]


@pytest.mark.parametrize("build", OPERATORS)
def test_symmetric_semi_definite_with_constant_kernel(build) -> None:
    L = build(bumpy())
    dense = L.stiffness.toarray()
    assert np.array_equal(dense, dense.T) or np.abs(dense - dense.T).max() < 1e-12
    assert np.linalg.eigvalsh(dense)[0] > -1e-12
    assert np.abs(dense.sum(axis=1)).max() < 1e-12
    assert (L.mass > 0).all()
    assert (L.n_components, L.kernel_dimension) == (1, 1)


@pytest.mark.parametrize("build", [robust_laplacian, cotan_laplacian])
def test_mass_is_the_area(build) -> None:
    mesh = bumpy()
    assert build(mesh).area == pytest.approx(mesh.area, rel=1e-12)


def test_cotan_is_libigl_with_the_sign_turned() -> None:
    mesh = bumpy()
    expected = -igl.cotmatrix(np.array(mesh.points), np.array(mesh.faces))
    assert abs(cotan_laplacian(mesh).stiffness - expected).max() == 0


def test_robust_equals_cotan_on_a_delaunay_mesh() -> None:
    # Every icosphere is Delaunay, so no edge is flipped.
    ball = sphere(subdivisions=3).geometry
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


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("build", [robust_laplacian, cotan_laplacian])
def test_scale_law(build, scale: float) -> None:
    mesh = bumpy()
    L, scaled = build(mesh), build(mesh.with_points(mesh.points * scale))
    assert abs(L.stiffness - scaled.stiffness).max() < 1e-9  # L is scale-free in two dimensions
    assert scaled.mass == pytest.approx(scale**2 * L.mass, rel=1e-9)
    assert scaled.eigenvalue_spacing == pytest.approx(L.eigenvalue_spacing / scale**2, rel=1e-9)


def test_spacing_is_near_weyls() -> None:
    for mesh in (sphere(subdivisions=3).geometry, rectangle(n=600).geometry):
        L = robust_laplacian(mesh)
        assert L.eigenvalue_spacing == pytest.approx(4 * np.pi / L.area, rel=0.3)


def test_components_and_kernel() -> None:
    L = robust_laplacian(two_parts())
    assert (L.n_components, L.kernel_dimension) == (2, 2)
    first = np.flatnonzero(L.component_labels == 0)[:3]
    held = L.dirichlet(first)
    assert (held.n_components, held.kernel_dimension) == (2, 1)
    assert (held.component_labels[first] == -1).all()


def test_potential_has_no_kernel() -> None:
    L = robust_laplacian(bumpy())
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
    L = robust_laplacian(bumpy())
    for matrix in (sparse.diags(L.mass), np.diag(L.mass)):
        assert np.array_equal(Laplacian(L.stiffness, matrix, L.points).mass, L.mass)


def test_fixed_points_as_a_mask() -> None:
    L = robust_laplacian(bumpy())
    mask = np.zeros(L.n, dtype=bool)
    mask[[3, 10]] = True
    assert L.dirichlet(mask).fixed.tolist() == [3, 10]
    assert L.dirichlet([]).fixed.tolist() == []


def test_each_component_has_its_own_spacing() -> None:
    ball = sphere(subdivisions=2).geometry
    points = np.vstack([ball.points, 1e-4 * ball.points + 5])
    L = robust_laplacian(TriangleMesh(points, np.vstack([ball.faces, ball.faces + ball.n])))
    alone = robust_laplacian(ball).eigenvalue_spacing
    assert L.component_spacings == pytest.approx([alone, 1e8 * alone], rel=1e-6)
    assert L.kernel_dimension == 2


def parts_of(size: float, place: float) -> tuple[TriangleMesh, TriangleMesh]:
    """A body, and it together with a copy of another size at another place."""
    body = bumpy()
    points = np.vstack([body.points, size * body.points + place])
    return body, TriangleMesh(points, np.vstack([body.faces, body.faces + body.n]))


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1e6])
@pytest.mark.parametrize("build", MESH_OPERATORS)
def test_parts_of_any_size_have_the_operator_that_they_have_alone(build, size: float) -> None:
    body, both = parts_of(size, 3 * max(1, size))
    alone, L = build(body), build(both)
    areas = np.bincount(np.repeat([0, 1], len(body.faces)), both.face_areas)
    masses = np.bincount(np.repeat([0, 1], body.n), L.mass)
    assert masses == pytest.approx(areas, rel=1e-7)  # of the coordinates far from the origin
    for part, unit in ((slice(None, body.n), 1.0), (slice(body.n, None), size)):
        assert abs(L.stiffness[part, part] - alone.stiffness).max() < 1e-7
        assert L.mass[part] / unit**2 == pytest.approx(alone.mass, rel=1e-7)


def test_spectra_of_parts_are_those_of_the_parts_alone() -> None:
    body, both = parts_of(1e-3, 5.0)
    alone = eigensolve(robust_laplacian(body), 6).eigenvalues
    L = robust_laplacian(both)
    small = L.restricted(np.arange(body.n, both.n))
    assert eigensolve(small, 6).eigenvalues == pytest.approx(1e6 * alone, rel=1e-6)
    assert eigensolve(L, 7).eigenvalues == pytest.approx([0, *alone], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("build", MESH_OPERATORS)
def test_a_tiny_part_at_the_origin_keeps_its_digits(build) -> None:
    body = bumpy()
    tiny = np.vstack([1e-12 * body.points, body.points + 5])
    L = build(TriangleMesh(tiny, np.vstack([body.faces, body.faces + body.n])))
    assert abs(L.stiffness[: body.n, : body.n] - build(body).stiffness).max() < 1e-7


@pytest.mark.parametrize("exponent", [-420, 7, 420])
@pytest.mark.parametrize("build", [*OPERATORS, delaunay_laplacian, "cloud"])
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
@pytest.mark.parametrize("cloud", [False, True])
@pytest.mark.parametrize("build", [*OPERATORS, delaunay_laplacian])
def test_units_in_which_areas_are_no_numbers_are_refused(build, cloud, scale: float) -> None:
    body = bumpy()
    geometry = body.with_points(scale * (body.points / np.abs(body.points).max()))
    if cloud and build is cotan_laplacian:
        return
    refused("geometry", "have an extent", build, geometry.as_cloud() if cloud else geometry)


def test_components_so_small_that_their_area_is_no_number_are_refused() -> None:
    body = bumpy()
    points = np.vstack([1e-160 * body.points, body.points + 5])
    both = TriangleMesh(points, np.vstack([body.faces, body.faces + body.n]))
    with pytest.raises(
        InvalidInputError, match=r"components of an extent above 1e-130, got one of about 3e-160"
    ):
        robust_laplacian(both)


def path(n: int = 4) -> sparse.csr_array:
    L = np.diag([1.0] + [2.0] * (n - 2) + [1.0])
    return sparse.csr_array(L - np.eye(n, k=1) - np.eye(n, k=-1))


POINTS = np.arange(12.0).reshape(4, 3)
LINE = [[i, 0, 0] for i in range(6)]
TWICE = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [1, 1, 0]]
TRIANGLES = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]

BAD = [
    (lambda: Laplacian(path(5), np.ones(4), POINTS), "`stiffness` must be a scipy sparse array"),
    (lambda: Laplacian(np.eye(4), np.ones(4), POINTS), "scipy sparse array"),
    (lambda: Laplacian(-path(), np.ones(4), POINTS), "opposite sign: pass -L"),
    (
        lambda: Laplacian(sparse.csr_array(np.triu(np.ones((4, 4)))), np.ones(4), POINTS),
        "`stiffness` must be",
    ),
    (lambda: Laplacian(path() * np.nan, np.ones(4), POINTS), "`stiffness` must be finite"),
    (lambda: Laplacian(path(), [1, 1, 0, 1], POINTS), "`mass` must be positive"),
    (lambda: Laplacian(path(), np.ones(3), POINTS), r"`mass` must have shape \(4,\)"),
    (lambda: Laplacian(path(), sparse.csr_array(np.ones((4, 4))), POINTS), "`mass` must be lumped"),
    (lambda: Laplacian(path(), np.ones(4), POINTS).dirichlet(range(4)), "leave at least one point"),
    (lambda: Laplacian(path(), np.ones(4), POINTS).dirichlet([4]), r"`vertices` must be in \[0"),
    (lambda: Laplacian(path() * 1j, np.ones(4), POINTS), "`stiffness` must hold real numbers, got"),
    (lambda: Laplacian(path(), np.ones(4), POINTS).dirichlet([0.7, 3.0]), "`vertices` must hold"),
    (lambda: robust_laplacian(PointCloud(POINTS), mollify_factor=-1), "`mollify_factor` must be"),
    (lambda: delaunay_laplacian(PointCloud([*TRIANGLES, [1e-310, 0, 0]])), "points further apart"),
    (lambda: knn_laplacian(PointCloud([*bumpy().points, [1e4, 0, 0]])), "points without"),
    (lambda: robust_laplacian(TriangleMesh(POINTS, [[0, 1, 2]])), "1 vertex that no face"),
    (
        lambda: robust_laplacian(TriangleMesh(TRIANGLES, [[0, 1, 2], [1, 3, 1]])),
        "1 face with a vertex",
    ),
    (lambda: cotan_laplacian(TriangleMesh(LINE[:3], [[0, 1, 2]])), "1 faces of zero area"),
    (
        lambda: cotan_laplacian(TriangleMesh(TRIANGLES, [[0, 1, 2], [1, 3, 2], [2, 1, 0]])),
        "1 duplicate faces",
    ),
    (lambda: cotan_laplacian(PointCloud(POINTS)), "must be a TriangleMesh"),
    (lambda: robust_laplacian(PointCloud(POINTS[:3])), "at least 4 points for a cloud Laplacian"),
    (lambda: robust_laplacian(PointCloud(LINE)), "points on one line"),
    (lambda: robust_laplacian(PointCloud(TWICE)), r"1 duplicate point \(such as 0 and"),
    (lambda: robust_laplacian(PointCloud(POINTS), n_neighbors=2), "`n_neighbors` must be at least"),
    (
        lambda: knn_laplacian(PointCloud([*(1e-170 * bumpy().points), [1, 0, 0]]), n_neighbors=5),
        "must have neighbours at",
    ),
    (lambda: knn_laplacian(PointCloud(POINTS), n_neighbors=4), r"`n_neighbors` must be in \[1"),
]


@pytest.mark.parametrize(("build", "message"), BAD)
def test_bad_input(build, message) -> None:
    with pytest.raises(InvalidInputError, match=message):
        build()
