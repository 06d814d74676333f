"""Volumes: spectra of ball and box, agreement with others, laws, the surface, what is refused."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from conftest import refused
from scipy import sparse
from scipy.sparse.linalg import eigsh
from volumes import ball, ball_eigenvalues, box, box_eigenvalues

import spectra_kit as sk
from spectra_kit.eigen.run import Units
from spectra_kit.errors import IgnoredContentWarning, InvalidFileError, InvalidInputError
from spectra_kit.geometry import TetrahedralMesh
from spectra_kit.operators import tetrahedral_laplacian
from spectra_kit.operators.tetrahedra import matrices

SIDES = (1.0, 1.3, 1.7)
SIZES = (8, 12, 18)
MODES = 9


def boxes(n: int) -> TetrahedralMesh:
    return box(n, round(1.3 * n), round(1.7 * n))


def random_mesh() -> TetrahedralMesh:
    """A block without symmetry, of cells of many forms and both orientations."""
    mesh, rng = boxes(4), np.random.default_rng(0)
    cells = mesh.cells.copy()
    flipped = rng.random(len(cells)) < 0.5
    cells[flipped] = cells[flipped][:, [1, 0, 2, 3]]
    return TetrahedralMesh(mesh.points + 0.02 * rng.standard_normal(mesh.points.shape), cells)


@pytest.mark.parametrize("zero", [False, True], ids=["natural", "zero"])
@pytest.mark.parametrize("shape", ["ball", "box"])
def test_eigenvalues_converge_with_the_square_of_the_edges(shape: str, zero: bool) -> None:
    if shape == "ball":
        make, exact = ball, ball_eigenvalues(MODES, zero=zero)
    else:
        make, exact = boxes, box_eigenvalues(MODES, SIDES, zero=zero)
    errors = []
    for n in SIZES:
        mesh = make(n)
        laplacian = tetrahedral_laplacian(mesh)
        if zero:
            laplacian = laplacian.dirichlet(mesh.boundary_vertices)
        found = sk.eigensolve(laplacian, MODES)
        assert found.certificate.level == "verified"
        assert found.n_zero_modes == (not zero)
        errors.append(np.abs(found.eigenvalues - exact)[exact > 0] / exact[exact > 0])
    means = np.mean(errors, axis=1)
    slope = np.polyfit(np.log(1 / np.array(SIZES)), np.log(means), 1)[0]
    # In the ball, masses make eigenvalues too low and what the surface cuts off makes them too
    # high: less of the first is left.
    assert 1.9 < slope < (2.4 if shape == "ball" else 2.15)
    assert means[-1] < 0.015


def test_consistent_masses_bound_from_above_and_lumped_ones_lie_below() -> None:
    exact, errors, sizes = box_eigenvalues(MODES, SIDES, zero=False)[1:], [], (5, 7, 10)
    for n in sizes:
        stiffness, full = matrices(boxes(n), "consistent")
        found = eigsh(stiffness, MODES, full.tocsc(), sigma=-1.0, return_eigenvectors=False)
        above = np.sort(found)[1:]
        below = sk.eigensolve(tetrahedral_laplacian(boxes(n)), MODES).eigenvalues[1:]
        assert (below < exact).all()
        assert (exact < above).all()
        errors.append((above / exact - 1).mean())
    slope = np.polyfit(np.log(1 / np.array(sizes)), np.log(errors), 1)[0]
    assert 1.9 < slope < 2.15


def test_consistent_masses_are_solved_for() -> None:
    mesh = boxes(6)
    stiffness, full = matrices(mesh, "consistent")
    reference = eigsh(stiffness, MODES, full.tocsc(), sigma=-1.0, return_eigenvectors=False)
    found = sk.eigensolve(tetrahedral_laplacian(mesh, mass="consistent"), MODES)
    assert found.eigenvalues[1:] == pytest.approx(np.sort(reference)[1:], rel=1e-10)
    brought = sk.interop.from_arrays(found.eigenvalues, found.eigenvectors, full, dimension=3)
    assert brought.rescale(7.0).orthonormality_error() < 1e-12


def test_matrices_are_those_of_lapy_and_scikit_fem() -> None:
    skfem, lapy = pytest.importorskip("skfem"), pytest.importorskip("lapy")
    from skfem.models.poisson import laplace, mass

    for mesh in (random_mesh(), boxes(4)):
        stiffness, full = matrices(mesh, "consistent")
        lumped = tetrahedral_laplacian(mesh).mass
        basis = skfem.Basis(skfem.MeshTet(mesh.points.T, mesh.cells.T), skfem.ElementTetP1())
        pairs = [(stiffness, laplace.assemble(basis)), (full, mass.assemble(basis))]
        tets = lapy.TetMesh(mesh.points, mesh.cells)
        tets.orient_()  # which LaPy asks for
        for lump, own in ((False, full), (True, sparse.diags_array(lumped))):
            solver = lapy.Solver(tets, lump=lump)
            pairs += [(stiffness, solver.stiffness), (own, solver.mass)]
        for ours, theirs in pairs:
            assert abs(ours - theirs).max() <= 1e-10 * abs(theirs).max()


def test_what_changes_no_shape_changes_no_operator() -> None:
    mesh, rng = random_mesh(), np.random.default_rng(1)
    plain = tetrahedral_laplacian(mesh)
    turned, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    moved = tetrahedral_laplacian((mesh.points @ turned + [3.0, -1.0, 2.0], mesh.cells))
    corners = np.array([rng.permutation(4) for _ in mesh.cells])
    wound = tetrahedral_laplacian((mesh.points, np.take_along_axis(mesh.cells, corners, axis=1)))
    order = rng.permutation(mesh.n)
    place = np.argsort(order)
    renumbered = tetrahedral_laplacian((mesh.points[order], place[mesh.cells]))
    for other, rows in ((moved, slice(None)), (wound, slice(None)), (renumbered, place)):
        stiffness = other.stiffness[rows][:, rows]
        assert abs(stiffness - plain.stiffness).max() < 1e-11 * plain.stiffness.max()
        assert other.mass[rows] == pytest.approx(plain.mass, rel=1e-11)
    assert plain.area == pytest.approx(mesh.volume, rel=1e-12)
    sums = np.abs(plain.stiffness.sum(axis=1))
    assert sums.max() < 1e-13 * plain.stiffness.max()
    assert plain.kernel_dimension == 1


@pytest.mark.parametrize("scale", [2.0**-270, 1e-12, 1e12, 2.0**270])
def test_units_of_any_size(scale: float) -> None:
    mesh = random_mesh()
    plain, other = (tetrahedral_laplacian((s * mesh.points, mesh.cells)) for s in (1.0, scale))
    largest = scale * plain.stiffness.max()
    assert abs(other.stiffness - scale * plain.stiffness).max() < 1e-12 * largest
    assert other.mass == pytest.approx(scale**3 * plain.mass, rel=1e-12)
    spacing = plain.eigenvalue_spacing / scale**2
    assert other.eigenvalue_spacing == pytest.approx(spacing, rel=1e-12)
    first, second = sk.eigensolve(plain, 6), sk.eigensolve(other, 6)
    assert second.n_zero_modes == 1
    assert second.certificate.level == "verified"
    scaled = first.rescale(scale)
    assert second.eigenvalues[1:] == pytest.approx(scaled.eigenvalues[1:], rel=1e-9)
    assert second.mass == pytest.approx(scaled.mass, rel=1e-12)
    assert max(s.orthonormality_error() for s in (scaled, second)) < 1e-12
    assert not any(Units.of(Units.of(other).taken_from(other)))


def test_spacing_is_near_weyls_law_at_any_resolution() -> None:
    bar = box(30, 3, 3, sides=(10.0, 1.0, 1.0))
    for mesh in (ball(5), ball(10), boxes(4), boxes(8), bar, random_mesh()):
        laplacian = tetrahedral_laplacian(mesh)
        weyl = (6 * np.pi**2 / mesh.volume) ** (2 / 3)
        assert 0.5 < laplacian.eigenvalue_spacing / weyl < 2
    # Where no more than half of the points are on the boundary.
    coarse, fine = (tetrahedral_laplacian(boxes(n)).eigenvalue_spacing for n in (10, 15))
    assert fine == pytest.approx(coarse, rel=0.15)
    scaled = sk.Laplacian(3 * laplacian.stiffness, 5 * laplacian.mass, mesh.points, dimension=3)
    spacing = 3 / 5 * laplacian.eigenvalue_spacing
    assert scaled.eigenvalue_spacing == pytest.approx(spacing, rel=1e-12)


def test_a_bar_has_the_modes_of_its_length() -> None:
    bar = box(40, 4, 4, sides=(10.0, 1.0, 1.0))
    found = sk.eigensolve(tetrahedral_laplacian(bar), 6).eigenvalues
    assert found[1:] == pytest.approx((np.pi * np.arange(1, 6) / 10) ** 2, rel=0.02)


def test_two_balls_have_two_zero_modes_and_spacings_of_their_own() -> None:
    one = ball(4)
    points = np.concatenate([one.points, 0.25 * one.points + [4.0, 0.0, 0.0]])
    laplacian = tetrahedral_laplacian((points, np.concatenate([one.cells, one.cells + one.n])))
    assert laplacian.n_components == laplacian.kernel_dimension == 2
    assert laplacian.component_spacings[1] == pytest.approx(16 * laplacian.component_spacings[0])
    alone = tetrahedral_laplacian(one)
    assert laplacian.component_spacings[0] == pytest.approx(alone.eigenvalue_spacing, rel=1e-12)
    found = sk.eigensolve(laplacian, 6)
    assert found.n_zero_modes == 2
    assert found.certificate.level == "verified"
    assert found.eigenvalues[2:] == pytest.approx(sk.eigensolve(alone, 5).eigenvalues[1:])


def enclosed(mesh: sk.TriangleMesh) -> float:
    a, b, c = mesh.points[mesh.faces.T]
    return float((a * np.cross(b, c)).sum() / 6)


def test_the_surface_is_closed_wound_outwards_and_leads_back() -> None:
    for mesh in (boxes(3), random_mesh(), ball(4)):
        surface = mesh.surface
        assert enclosed(surface.mesh) == pytest.approx(mesh.volume, rel=1e-12)
        half = surface.mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        assert len(np.unique(half, axis=0)) == len(half)  # each edge once in each direction
        assert {*map(tuple, half)} == {*map(tuple, half[:, ::-1])}
        assert (mesh.points[surface.vertex_index] == surface.mesh.points).all()
    inside = np.setdiff1d(np.arange(mesh.n), mesh.boundary_vertices)
    assert np.linalg.norm(mesh.points[inside], axis=1).max() < 1 - 1e-9
    assert np.linalg.norm(surface.mesh.points, axis=1) == pytest.approx(1.0)


def test_the_meshes_of_others_are_taken() -> None:
    lapy, meshio = pytest.importorskip("lapy"), pytest.importorskip("meshio")
    pyvista, skfem = pytest.importorskip("pyvista"), pytest.importorskip("skfem")
    mesh = boxes(2)
    plain = tetrahedral_laplacian(mesh)
    given = (
        (mesh.points.tolist(), mesh.cells.tolist()),
        lapy.TetMesh(mesh.points, mesh.cells),
        meshio.Mesh(mesh.points, [("tetra", mesh.cells)]),
        pyvista.UnstructuredGrid({pyvista.CellType.TETRA: mesh.cells}, mesh.points),
        skfem.MeshTet(np.array(mesh.points.T), np.array(mesh.cells.T)),
    )
    for thing in given:
        laplacian = tetrahedral_laplacian(thing)
        assert abs(laplacian.stiffness - plain.stiffness).max() < 1e-13
    beside = meshio.Mesh(mesh.points, [("tetra", mesh.cells), ("triangle", mesh.cells[:2, :3])])
    with pytest.warns(IgnoredContentWarning, match="passed over 2 cells beside the tetrahedra"):
        tetrahedral_laplacian(beside)


CORNERS = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [2, 2, 2]]
TAKEN = "(points, cells), files and meshes of linear tetrahedra make one"


@pytest.mark.parametrize(
    ("points", "cells", "expected", "got", "remedy"),
    [
        (CORNERS, [[0, 1, 2, 3]], "have a cell at every vertex", "2 unused", "unreferenced"),
        (
            CORNERS[:4],
            [[0, 1, 2, 2], [0, 1, 2, 3]],
            "have cells that enclose",
            "1 flat",
            "degenerate_cells",
        ),
        (
            CORNERS,
            [[0, 4, 5, 1], [0, 1, 2, 3]],
            "have cells that enclose",
            "1 flat",
            "degenerate_cells",
        ),
        (
            CORNERS[:4],
            [[0, 1, 2, 3], [3, 2, 1, 0]],
            "have cells that enclose",
            "1 flat",
            "degenerate_cells",
        ),
        (
            [*CORNERS[:5], [0, 0, -1]],
            [[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5]],
            "have faces of one cell or two",
            "1 face of more",
            "",
        ),
        (1e-90 * np.array(CORNERS[:4]), [[0, 1, 2, 3]], "have an extent", "4 vertices", ""),
    ],
)
def test_what_has_no_operator_is_refused(
    points: list, cells: list, expected: str, got: str, remedy: str
) -> None:
    mesh = TetrahedralMesh(points, cells)
    with pytest.raises(InvalidInputError) as caught:
        tetrahedral_laplacian(mesh)
    assert caught.value.argument == "mesh"
    assert caught.value.expected.startswith(expected)
    assert str(caught.value.got).startswith(got)
    if remedy:  # which does mend it
        assert f"drop them with TetrahedralMesh.of(mesh).without_{remedy}()" in str(caught.value)
        mended = getattr(TetrahedralMesh.of(mesh), f"without_{remedy}")()
        tetrahedral_laplacian(mended.without_unreferenced())
    else:
        assert caught.value.advice


@pytest.mark.parametrize("name", ["a.msh", "old.msh", "a.mesh", "a.vtk", "a.vtu", "a.mesh.gz"])
def test_a_file_is_the_volume_that_it_holds(tmp_path: Path, name: str) -> None:
    """As meshio writes it, with a point that no cell uses, as Gmsh leaves those of its drawings."""
    meshio = pytest.importorskip("meshio")
    volume = boxes(2)
    points = np.vstack([volume.points, [9.0, 9, 9]])
    path = tmp_path / name.removesuffix(".gz")
    form = {"a.msh": "gmsh", "old.msh": "gmsh22", "a.mesh": "medit"}.get(path.name)
    meshio.Mesh(points, [("tetra", volume.cells)]).write(path, file_format=form)
    if name.endswith(".gz"):
        path = tmp_path / name
        path.write_bytes(gzip.compress(path.with_suffix("").read_bytes()))
    found = TetrahedralMesh.of(path)
    np.testing.assert_allclose(found.points, points)
    np.testing.assert_array_equal(found.cells, volume.cells)
    with pytest.raises(InvalidInputError, match=r"TetrahedralMesh\.of\(mesh\)\.without_unref"):
        tetrahedral_laplacian(path)
    meshio.Mesh(volume.points, [("tetra", volume.cells)]).write(path.with_name("b.vtu"))
    laplacian = tetrahedral_laplacian(path.with_name("b.vtu"))
    assert laplacian.area == pytest.approx(volume.volume)


def test_files_without_tetrahedra_are_refused(tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    ball = sk.geometry.sphere(subdivisions=1).geometry
    triangles, mixed = ("triangle", ball.faces), ("tetra", [[0, 1, 2, 3]])
    meshio.Mesh(ball.points, [triangles]).write(tmp_path / "a.vtu")
    sk.write(ball, tmp_path / "a.off")
    for name, told in (
        ("a.vtu", "holds no linear tetrahedra"),
        ("a.off", r"of '\.off' no tetrahedra are read"),
        ("b.msh", "there is no such file"),
    ):
        with pytest.raises(InvalidFileError, match=rf"{name}.*{told}"):
            TetrahedralMesh.of(tmp_path / name)
    meshio.Mesh(ball.points, [triangles, mixed]).write(tmp_path / "c.vtu")
    with pytest.warns(IgnoredContentWarning, match=r"c\.vtu: passed over 80 cells beside"):
        assert len(TetrahedralMesh.of(tmp_path / "c.vtu").cells) == 1


def test_arrays_that_are_no_volume_are_refused() -> None:
    shape = "have shape (m, 4)"
    refused("cells", shape, TetrahedralMesh, CORNERS, [[0, 1, 2]])
    refused("cells", shape, TetrahedralMesh, CORNERS, np.zeros((0, 4), dtype=int))
    refused("cells", "be in [0, 6)", TetrahedralMesh, CORNERS, [[0, 1, 2, 6]])
    refused("cells", "hold integers", TetrahedralMesh, CORNERS, [[0.0, 1.0, 2.0, 3.0]])
    nan = [[np.nan, 0, 0], *CORNERS[1:]]
    refused("points", "be finite", TetrahedralMesh, nan, [[0, 1, 2, 3]])
    surface = sk.geometry.sphere(subdivisions=1).geometry
    with pytest.raises(InvalidInputError, match="must be a TetrahedralMesh") as caught:
        tetrahedral_laplacian(surface)
    assert caught.value.advice == TAKEN
    with pytest.raises(InvalidInputError, match=r"mesh\.surface\.mesh its surface"):
        sk.robust_laplacian(ball(2))
    twice = TetrahedralMesh(CORNERS[:4], [[0, 1, 2, 3], [1, 0, 2, 3]])
    with pytest.raises(InvalidInputError, match="have faces of one cell alone, got none"):
        _ = twice.surface


def test_a_tensor_of_cells_is_a_stretched_volume() -> None:
    mesh = boxes(5)
    stretched = TetrahedralMesh(mesh.points / np.sqrt([4.0, 1.0, 1.0]), mesh.cells)
    plain = tetrahedral_laplacian(stretched, mass="consistent")
    D = np.tile(np.diag([4.0, 1.0, 1.0]), (len(mesh.cells), 1, 1))
    found = tetrahedral_laplacian(mesh, mass="consistent", tensors=D)
    assert abs(found.stiffness / 2 - plain.stiffness).max() < 1e-12 * plain.stiffness.max()
    assert abs(found.consistent_mass / 2 - plain.consistent_mass).max() < 1e-14
    alike = tetrahedral_laplacian(mesh, tensors=np.full(len(mesh.cells), 3.0))
    assert abs(alike.stiffness - 3 * tetrahedral_laplacian(mesh).stiffness).max() < 1e-12
    for wrong, told in ((-D, "be positive definite"), (D[1:], "have shape")):
        refused("tensors", told, tetrahedral_laplacian, mesh, tensors=wrong)
    D[3, 0, 1] = 1.0
    refused("tensors", "be symmetric, got 1 tensor", tetrahedral_laplacian, mesh, tensors=D)
