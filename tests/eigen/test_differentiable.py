"""Gradients of eigenvalues: laws, analytic answers, finite differences, and torch's own."""

from functools import cache

import numpy as np
import pytest
import torch
from conftest import bumpy, joined, moved, refused, two_parts
from scipy import sparse
from torch import Tensor

import spectra_kit as sk
from spectra_kit import InvalidInputError, TriangleMesh
from spectra_kit.eigen.differentiable import eigenvalues, mesh_eigenvalues
from spectra_kit.geometry import rectangle, sphere, torus
from spectra_kit.operators._cover import cover_of_faces, make_delaunay
from spectra_kit.operators.differentiable import (
    _check_same,
    lengthened_by_component,
    lengthened_by_corner,
    sides_in_space,
)

OPERATORS = ["cotan", "robust", "delaunay"]
RNG = np.random.default_rng
pytestmark = pytest.mark.filterwarnings("ignore:Sparse CSR tensor support is in beta")


@cache
def uneven() -> TriangleMesh:
    """A long closed surface of slivers, on which Delaunay flips a quarter of the edges."""
    mesh = bumpy()
    noise = 0.05 * RNG(0).standard_normal((mesh.n, 3))
    return mesh.with_points(mesh.points * [1, 1, 4] + noise)


@cache
def plate() -> TriangleMesh:
    """A wavy plate of slivers, with a boundary."""
    mesh = rectangle(n=150).geometry
    noise = 0.02 * RNG(1).standard_normal((mesh.n, 3))
    return mesh.with_points(mesh.points * [3, 1, 1] + noise)


def leaf(mesh: TriangleMesh, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.tensor(np.array(mesh.points), dtype=dtype, requires_grad=True)


def gradient(mesh: TriangleMesh, weights: np.ndarray, **options: object) -> np.ndarray:
    """The derivative of weighted eigenvalues by the points."""
    points = leaf(mesh)
    (
        mesh_eigenvalues(points, mesh.faces, len(weights), **options) @ torch.tensor(weights)
    ).backward()
    assert points.grad is not None
    return points.grad.numpy()


def change(mesh: TriangleMesh, direction: np.ndarray, weights: np.ndarray, step: float, **options):
    """The same along a direction, by central differences of what `eigensolve` returns."""

    def value(t: float) -> float:
        there = sk.laplacian(mesh.with_points(mesh.points + t * direction), **options)
        return float(weights @ sk.eigensolve(there, len(weights)).eigenvalues)

    return (value(step) - value(-step)) / (2 * step)


@cache
def two_bodies() -> TriangleMesh:
    """Two components without symmetries."""
    return joined(bumpy(), moved(uneven(), 9.0, scale=0.4))


CASES = [
    *((uneven, operator, "neumann") for operator in OPERATORS),
    *((plate, operator, b) for operator in OPERATORS for b in ("neumann", "dirichlet")),
    *((two_bodies, operator, "neumann") for operator in OPERATORS),
]
CASE = pytest.mark.parametrize(
    ("made", "operator", "boundary"), CASES, ids=lambda value: getattr(value, "__name__", value)
)


# ----------------------------------------------------------------------------- meshes


@CASE
def test_values_are_those_of_eigensolve(made, operator: str, boundary: str) -> None:
    mesh, options = made(), {"operator": operator, "boundary": boundary}
    expected = sk.eigensolve(sk.laplacian(mesh, **options), 6).eigenvalues
    for points in (leaf(mesh), leaf(mesh).detach()):
        values = mesh_eigenvalues(points, torch.tensor(np.array(mesh.faces)), 6, **options)
        assert values.dtype == torch.float64
        assert values.requires_grad == points.requires_grad
        np.testing.assert_array_equal(values.detach().numpy(), expected)


@CASE
def test_gradients_are_those_of_finite_differences(made, operator, boundary) -> None:
    mesh, options = made(), {"operator": operator, "boundary": boundary}
    rng = RNG(2)
    weights = rng.standard_normal(8)
    found = gradient(mesh, weights, **options)
    for _ in range(2):
        direction = rng.standard_normal((mesh.n, 3)) * np.sqrt(mesh.area / mesh.n)
        expected = change(mesh, direction, weights, 1e-6, **options)
        assert (found * direction).sum() == pytest.approx(expected, rel=2e-6, abs=1e-7)


@CASE
def test_gradients_obey_scaling_and_rigid_motions(made, operator, boundary) -> None:
    mesh, options = made(), {"operator": operator, "boundary": boundary}
    weights = RNG(3).standard_normal(8)
    values = sk.eigensolve(sk.laplacian(mesh, **options), 8).eigenvalues
    found = gradient(mesh, weights, **options)
    assert (found * mesh.points).sum() == pytest.approx(-2 * weights @ values, rel=1e-10)
    size = np.abs(found).sum()
    assert np.abs(found.sum(axis=0)).max() < 1e-12 * size
    assert np.abs(np.cross(mesh.points, found).sum(axis=0)).max() < 1e-12 * size * 10
    large = gradient(moved(mesh, 0.0, scale=2.0**20), weights, **options)
    np.testing.assert_allclose(large * 2.0**60, found, rtol=1e-9, atol=1e-9 * np.abs(found).max())


def test_the_triangulations_tested_above_are_flipped() -> None:
    for mesh in (uneven(), plate()):
        flipped, as_given = (
            sk.laplacian(mesh, operator=operator).stiffness for operator in ("robust", "cotan")
        )
        assert ((flipped != 0) != (as_given != 0)).sum() > 0.2 * as_given.nnz


def test_zero_modes_have_no_gradient_at_all() -> None:
    mesh = two_parts()
    for operator in OPERATORS:
        assert not gradient(mesh, np.array([1.0, -2.0]), operator=operator).any()
        weights = np.array([0.0, 0.0, 1.0])
        with_zeros = gradient(mesh, weights + [3, 4, 0], operator=operator)
        np.testing.assert_array_equal(with_zeros, gradient(mesh, weights, operator=operator))


@pytest.mark.parametrize("operator", OPERATORS)
def test_a_rectangle_changes_with_its_sides(operator: str) -> None:
    mesh = rectangle(n=1500).geometry
    a, b = np.ptp(mesh.points, axis=0)[:2]
    stretch = torch.ones(3, dtype=torch.float64, requires_grad=True)
    points = torch.tensor(np.array(mesh.points)) * stretch
    options = {"faces": mesh.faces, "operator": operator}
    side = mesh_eigenvalues(points, k=2, **options)[1]  # (pi / long side)^2
    (found,) = torch.autograd.grad(side, stretch)
    slope = -2 * np.pi**2 / max(a, b) ** 2
    expected = np.array([slope * (a > b), slope * (b > a), 0.0])
    assert found.numpy() == pytest.approx(expected, rel=5e-3, abs=5e-3 * abs(slope))
    drum = mesh_eigenvalues(
        torch.tensor(np.array(mesh.points)) * stretch, k=1, boundary="dirichlet", **options
    )
    (found,) = torch.autograd.grad(drum[0], stretch)
    expected = np.array([-2 * np.pi**2 / a**2, -2 * np.pi**2 / b**2, 0.0])
    assert found.numpy() == pytest.approx(expected, rel=1e-2, abs=1e-9)


def test_the_three_equal_eigenvalues_of_a_ball_change_as_one() -> None:
    ball = sphere(subdivisions=3).geometry
    each = [gradient(ball, np.eye(4)[j]) for j in (1, 2, 3)]
    for one in each[1:]:
        np.testing.assert_allclose(one, each[0], atol=1e-12)
    # The mean of the three feels the volume of a bump, and no other part of its shape.
    x, y, z = ball.points.T
    bumps = {"even": np.ones(ball.n), "quadrupole": 3 * z**2 - 1, "skew": x * y, "shift": x}
    moves = {name: (each[0] * ball.points * f[:, None]).sum() for name, f in bumps.items()}
    assert moves.pop("even") == pytest.approx(-4, rel=1e-2)
    assert list(moves.values()) == pytest.approx([0, 0, 0], abs=1e-3)


@pytest.mark.parametrize("k", [2, 3, 6, 11])
def test_the_cluster_that_k_cuts_is_completed(k: int) -> None:
    ball = sphere(subdivisions=3).geometry
    whole = gradient(ball, np.eye(16)[k - 1])
    np.testing.assert_allclose(gradient(ball, np.eye(k)[k - 1]), whole, atol=1e-10)


def test_the_pairs_of_a_torus_are_told_from_its_single_modes() -> None:
    # Turned about its axis it is the same; the gradient of a cluster must be, too.
    n = 24
    ring = torus(n=n * n // 2).geometry
    values = sk.spectrum(ring, 12).eigenvalues
    pairs = np.flatnonzero(np.diff(values) < 1e-9 * values[-1])
    assert len(pairs) >= 3
    for i in pairs:
        np.testing.assert_array_equal(
            gradient(ring, np.eye(12)[i]), gradient(ring, np.eye(12)[i + 1])
        )
    singles = np.setdiff1d(np.arange(1, 11), [*pairs, *(pairs + 1)])
    assert len(singles)
    for i in singles:
        assert (
            np.abs(gradient(ring, np.eye(12)[i]) - gradient(ring, np.eye(12)[i + 1])).max() > 1e-4
        )


def cotangents_in_torch(points: Tensor, faces: np.ndarray) -> tuple[Tensor, Tensor]:
    """Dense L and mixed Voronoi masses by dot and cross products: another way to the same."""
    n = len(points)
    L, mass = torch.zeros(n, n, dtype=torch.float64), torch.zeros(n, dtype=torch.float64)
    corners = points[torch.tensor(np.array(faces))]
    index = [torch.tensor(np.array(column)) for column in faces.T]
    area = (
        torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1)
        / 2
    )
    dots = [
        ((corners[:, c - 2] - corners[:, c]) * (corners[:, c - 1] - corners[:, c])).sum(dim=1)
        for c in range(3)
    ]
    obtuse = torch.stack(dots).min(dim=0).values < 0
    for c in range(3):
        i, j, o = index[c - 2], index[c - 1], index[c]
        weight = dots[c] / (2 * area) / 2
        squared = (corners[:, c - 2] - corners[:, c - 1]).square().sum(dim=1)
        for rows, columns, sign in ((i, j, -1), (j, i, -1), (i, i, 1), (j, j, 1)):
            L = L.index_put((rows, columns), sign * weight, accumulate=True)
        for end in (i, j):
            nearer = torch.where(obtuse, 0.0, squared * weight / 4)
            mass = mass.index_put((end,), nearer, accumulate=True)
        share = torch.where(dots[c] < 0, area / 2, area / 4)
        mass = mass.index_put((o,), torch.where(obtuse, share, 0.0), accumulate=True)
    return L, mass


def test_cotangents_agree_with_the_dense_derivatives_of_torch() -> None:
    mesh = uneven()
    weights = torch.tensor(RNG(4).standard_normal(10))
    points = leaf(mesh)
    L, mass = cotangents_in_torch(points, mesh.faces)
    root = mass.rsqrt()
    dense = torch.linalg.eigvalsh(root[:, None] * L * root)[:10]
    (expected,) = torch.autograd.grad((dense * weights)[1:].sum(), points)
    weights[0] = 0
    found = gradient(mesh, weights.numpy(), operator="cotan")
    np.testing.assert_allclose(found, expected.numpy(), atol=1e-9 * np.abs(found).max())


def test_gradients_have_the_type_of_the_points_and_refuse_second_derivatives() -> None:
    mesh = bumpy()
    points = leaf(mesh, torch.float32)
    values = mesh_eigenvalues(points, mesh.faces, 4)
    assert values.dtype == torch.float64
    (found,) = torch.autograd.grad(values.sum(), points, retain_graph=True)
    assert found.dtype == torch.float32
    exact = gradient(mesh, np.ones(4))
    np.testing.assert_allclose(found.numpy(), exact, atol=1e-4 * np.abs(exact).max())
    for loss in (values.sum(), values.square().sum()):
        (found,) = torch.autograd.grad(loss, points, create_graph=True)
        with pytest.raises(InvalidInputError, match="eigenvalues have first derivatives alone"):
            found.square().sum().backward()


def test_an_approximate_solver_has_nearly_the_gradient() -> None:
    mesh, weights = bumpy(2562), np.eye(6)[4]
    exact = gradient(mesh, weights)
    quick = gradient(mesh, weights, solver=sk.Cascade(coarsest=200))
    assert np.linalg.norm(quick - exact) < 0.1 * np.linalg.norm(exact)


@pytest.mark.parametrize("operator", OPERATORS)
def test_an_ellipsoid_learns_to_sound_like_another(operator: str) -> None:
    mesh = sphere(subdivisions=2).geometry
    goal = sk.laplacian(mesh.with_points(mesh.points * [1, 1.2, 1.5]), operator=operator)
    target = torch.tensor(np.array(sk.eigensolve(goal, 8).eigenvalues))[1:]
    axes = torch.tensor([1.3, 0.9, 1.1], dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([axes], max_iter=12, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        points = torch.tensor(np.array(mesh.points)) * axes
        values = mesh_eigenvalues(points, mesh.faces, 8, operator=operator)[1:]
        apart = (values / target - 1).square().sum()
        apart.backward()
        return apart.detach()

    start = float(optimiser.step(loss))
    assert float(loss()) < 1e-3 * start
    assert np.sort(axes.detach().numpy()) == pytest.approx([1, 1.2, 1.5], rel=0.03)


@pytest.mark.parametrize("factor", [0.05, 0.4])
@pytest.mark.parametrize("lengthened", [lengthened_by_component, lengthened_by_corner])
def test_what_mollification_adds_is_differentiated(lengthened, factor: float) -> None:
    mesh = joined(uneven(), moved(plate(), 9.0))
    rng = RNG(6)
    weights = rng.standard_normal((len(mesh.faces), 3))
    sides, back = lengthened(mesh, factor)
    assert (sides > sides_in_space(mesh) * (1 + 1e-9)).any()
    slopes, step = back(weights), 1e-7
    for _ in range(3):
        direction = rng.standard_normal((mesh.n, 3))
        ahead, behind = (mesh.with_points(mesh.points + t * direction) for t in (step, -step))
        expected = ((lengthened(ahead, factor)[0] - lengthened(behind, factor)[0]) * weights).sum()
        found = (slopes * (sides_in_space(ahead) - sides_in_space(behind))).sum()
        assert found == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.data
@pytest.mark.parametrize("operator", OPERATORS)
def test_gradients_of_a_real_shape(real_shapes, operator: str) -> None:
    arrays = np.load(real_shapes / "spot.npz")
    mesh = TriangleMesh(arrays["V"].astype(float), arrays["F"]).without_unreferenced()
    weights = RNG(7).standard_normal(12)
    found = gradient(mesh, weights, operator=operator)
    for height in (mesh.points[:, :1] ** 2, np.sin(mesh.points[:, 1:2])):
        direction = height * [0.3, -0.2, 1.0]
        expected = change(mesh, direction, weights, 1e-7, operator=operator)
        assert (found * direction).sum() == pytest.approx(expected, rel=1e-5, abs=1e-7)


def box(n: int, noise: float = 0.0) -> TriangleMesh:
    """A box with n points on each edge of its base and top, which are fans from one point."""
    t = np.arange(n)[:, None] / n
    corners = np.array([[0, 0], [2, 0], [2, 1], [0, 1]])
    rim = np.vstack(
        [a + t * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    )
    rim = rim + noise * RNG(0).standard_normal(rim.shape)
    rim, here = np.vstack([rim, [0.5, 0.25]]), np.arange(4 * n)
    there, centre, up = np.roll(here, -1), np.full(4 * n, 4 * n), 4 * n + 1
    faces = [
        *([there, here, centre], [here + up, there + up, centre + up]),
        *([here, there, there + up], [here, there + up, here + up]),
    ]
    points = np.vstack([np.c_[rim, np.full(up, height)] for height in (0, 0.7)])
    return TriangleMesh(points, np.hstack(faces).T)


@pytest.mark.parametrize("operator", ["robust", "delaunay"])
@pytest.mark.parametrize(("n", "noise", "rtol"), [(12, 0.0, 1e-10), (150, 1e-4, 1e-8)])
def test_many_points_on_a_circle_and_more_flips_than_half_edges(operator, n, noise, rtol) -> None:
    mesh, weights = box(n, noise), RNG(13).standard_normal(5)
    if noise and operator == "delaunay":
        corners, lengths, twins, _ = cover_of_faces(
            mesh.points, mesh.faces.astype(np.int32), sides_in_space(mesh)
        )
        assert len(make_delaunay(corners, lengths, twins, recorded=True)[0]) > len(twins)
    values = sk.eigensolve(sk.laplacian(mesh, operator=operator), 5).eigenvalues
    found = gradient(mesh, weights, operator=operator)
    assert (found * mesh.points).sum() == pytest.approx(-2 * weights @ values, rel=rtol)


# ----------------------------------------------------------------------------- matrices


def tensors(mesh: TriangleMesh) -> tuple[sparse.coo_array, Tensor, Tensor, Tensor]:
    """The stiffness, where its entries are and what they are, and the mass."""
    laplacian = sk.robust_laplacian(mesh)
    matrix = sparse.coo_array(laplacian.stiffness)
    index = torch.tensor(np.array([matrix.row, matrix.col]), dtype=torch.int64)
    return (
        matrix,
        index,
        torch.tensor(np.array(matrix.data)),
        torch.tensor(np.array(laplacian.mass)),
    )


def dense_of(L: Tensor, mass: Tensor) -> Tensor:
    root = mass.rsqrt()
    return torch.linalg.eigvalsh(root[:, None] * L * root)


@pytest.mark.parametrize("layout", ["coo", "csr", "twice"])
def test_matrices_agree_with_the_dense_derivatives_of_torch(layout: str) -> None:
    matrix, index, entries, mass = tensors(bumpy())
    weights = torch.tensor(RNG(8).standard_normal(10))
    entries.requires_grad_()
    mass.requires_grad_()
    dense = torch.tensor(matrix.toarray(), requires_grad=True)
    values = dense_of(dense, mass)[:10]
    by_entry, by_mass = torch.autograd.grad((values * weights).sum(), (dense, mass))
    if layout == "twice":  # each entry as the sum of two halves
        halves = torch.cat([entries / 2, entries / 2])
        L = torch.sparse_coo_tensor(torch.cat([index, index], 1), halves, check_invariants=True)
    else:
        L = torch.sparse_coo_tensor(index, entries, check_invariants=True).coalesce()
        L = L.to_sparse_csr() if layout == "csr" else L
    found = eigenvalues(L, mass, 10)
    np.testing.assert_allclose(found.detach().numpy(), values.detach().numpy(), atol=1e-10)
    ours, ours_by_mass = torch.autograd.grad((found * weights).sum(), (entries, mass))
    expected = by_entry[index[0], index[1]].numpy()
    np.testing.assert_allclose(ours.numpy(), expected, atol=1e-9 * np.abs(expected).max())
    scale = by_mass.abs().max().item()
    np.testing.assert_allclose(ours_by_mass.numpy(), by_mass.numpy(), atol=1e-8 * scale)


@pytest.mark.parametrize("layout", ["coo", "csr"])
def test_the_gradient_of_a_sparse_leaf_has_its_layout_and_pattern(layout: str) -> None:
    _, index, entries, mass = tensors(bumpy())
    L = torch.sparse_coo_tensor(index, entries.float(), check_invariants=True).coalesce()
    L = (L.to_sparse_csr() if layout == "csr" else L).requires_grad_()
    eigenvalues(L, mass.float(), 3)[2].backward()
    assert L.grad is not None
    assert (L.grad.layout, L.grad.dtype, L.grad.shape) == (L.layout, torch.float32, L.shape)
    assert L.grad._nnz() == len(entries)


def spring_laplacian(springs: Tensor, ends: Tensor, n: int) -> Tensor:
    i, j = ends
    index = torch.stack([torch.cat([i, j, i, j]), torch.cat([i, j, j, i])])
    entries = torch.cat([springs, springs, -springs, -springs])
    return torch.sparse_coo_tensor(index, entries, (n, n), check_invariants=True)


@pytest.mark.parametrize("fixed", [(), (0, 3)])
def test_gradcheck_of_springs_and_masses(fixed: tuple[int, ...]) -> None:
    n, rng = 6, RNG(9)
    ends = torch.tensor([(i, j) for i in range(n) for j in range(i) if (i * j) % 3 != 1]).T
    springs = torch.tensor(rng.uniform(0.5, 2, ends.shape[1]), requires_grad=True)
    mass = torch.tensor(rng.uniform(0.5, 2, n), requires_grad=True)

    def function(springs: Tensor, mass: Tensor) -> Tensor:
        return eigenvalues(spring_laplacian(springs, ends, n), mass, 3, fixed=fixed)

    assert torch.autograd.gradcheck(function, (springs, mass))


def test_the_pairs_of_a_ring_of_springs_change_as_one() -> None:
    n = 12
    ends = torch.tensor([(i, (i + 1) % n) for i in range(n)]).T
    springs = torch.ones(n, dtype=torch.float64, requires_grad=True)
    for k in (2, 3):  # the first cuts the pair
        values = eigenvalues(spring_laplacian(springs, ends, n), torch.ones(n), k)
        assert values[1].item() == pytest.approx(2 - 2 * np.cos(2 * np.pi / n))
        (found,) = torch.autograd.grad(values[1], springs)
        # All springs are alike to the mean of a pair; lambda is linear in them all.
        np.testing.assert_allclose(found.numpy(), values[1].item() / n, atol=1e-12)


def test_a_potential_lifts_the_lowest_eigenvalue_by_its_mean() -> None:
    _, index, entries, mass = tensors(bumpy())
    shape = torch.tensor(RNG(10).uniform(0, 1, len(mass)))
    strength = torch.tensor(0.0, dtype=torch.float64, requires_grad=True)
    L = torch.sparse_coo_tensor(index, entries, check_invariants=True)
    around = torch.arange(len(mass)).expand(2, -1)
    V = torch.sparse_coo_tensor(around, strength * mass * shape, L.shape, check_invariants=True)
    eigenvalues(L + V, mass, 1)[0].backward()
    assert strength.grad is not None
    mean = (mass * shape).sum() / mass.sum()
    assert strength.grad.item() == pytest.approx(mean.item(), rel=1e-10)


def test_solvers_that_look_at_points_get_them() -> None:
    mesh = bumpy()
    laplacian = sk.robust_laplacian(mesh)
    _, index, entries, mass = tensors(mesh)
    L = torch.sparse_coo_tensor(index, entries, check_invariants=True)
    solver = sk.Refined(start=sk.eigen.subspaces.AmbientFourier(m=30))
    for points in (mesh.points, leaf(mesh)):
        values = eigenvalues(L, mass, 5, points=points, solver=solver)
        expected = sk.eigensolve(laplacian, 5, solver).eigenvalues
        np.testing.assert_allclose(values.numpy(), expected, atol=1e-12)
    refused("points", "not share one", eigenvalues, L, mass, 5, solver=solver)


# ----------------------------------------------------------------------------- refusals


def test_what_cannot_be_differentiated_is_refused() -> None:
    mesh = bumpy()
    points, faces = leaf(mesh), mesh.faces
    refused("points", "be a dense tensor of real", mesh_eigenvalues, points.long(), faces, 3)
    sparse_points = points.detach().to_sparse()
    refused("points", "be a dense tensor of real", mesh_eigenvalues, sparse_points, faces, 3)
    refused("points", "have shape (n, 3)", mesh_eigenvalues, points.T[:2], faces, 3)
    dense, mass = torch.eye(4), torch.ones(4)
    refused("stiffness", "be a real sparse tensor", eigenvalues, dense, mass, 2)
    refused("stiffness", "be a real sparse tensor", eigenvalues, dense.to_sparse().long(), mass, 2)
    for wrong in (mass[:3], mass.long(), mass.to_sparse()):
        refused("mass", "be a real tensor of shape (4,)", eigenvalues, dense.to_sparse(), wrong, 2)


def test_an_edge_of_no_length_has_no_derivative() -> None:
    mesh = bumpy()
    points = np.array(mesh.points)
    points[mesh.faces[0, 0]] = points[mesh.faces[0, 1]]
    flat = mesh.with_points(points)
    assert torch.isfinite(mesh_eigenvalues(leaf(flat).detach(), flat.faces, 3)).all()
    refused(
        "points", "differ at the two ends of an edge", mesh_eigenvalues, leaf(flat), flat.faces, 3
    )


@pytest.mark.parametrize("operator", ["robust", "delaunay"])
def test_three_sheets_that_share_an_edge_are_differentiated(operator: str) -> None:
    sheet = rectangle(n=150).geometry
    x, y, _ = sheet.points.T
    x, y = 3 * x + 0.1 * np.sin(30 * y + 9 * x), y * (1 + 0.3 * np.sin(40 * x))
    sizes = ((0, 1.0), (2, 0.8), (4, 1.3))  # by three alike, eigenvalues come in pairs
    fins = [np.c_[x, size * y * np.cos(angle), size * y * np.sin(angle)] for angle, size in sizes]
    mesh = joined(*(sheet.with_points(fin) for fin in fins)).with_merged_vertices()
    assert (mesh.unique_edges[1] == 3).any()
    weights = RNG(11).standard_normal(6)
    direction = RNG(12).standard_normal((mesh.n, 3)) * np.sqrt(mesh.area / mesh.n)
    expected = change(mesh, direction, weights, 1e-6, operator=operator)
    found = gradient(mesh, weights, operator=operator)
    assert (found * direction).sum() == pytest.approx(expected, rel=1e-5, abs=1e-7)


def test_other_triangles_than_the_library_has_are_refused() -> None:
    mesh, unit = uneven(), 1.0
    built, other = sk.robust_laplacian(mesh), sk.cotan_laplacian(mesh)
    _check_same(built, built.stiffness, built.mass, unit)
    for stiffness, mass in ((other.stiffness, built.mass), (built.stiffness, other.mass)):
        expected = "be a sum over triangles that are known"
        refused("operator", expected, _check_same, built, stiffness, mass, unit)
