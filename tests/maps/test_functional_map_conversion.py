"""Point maps, functional maps and precise maps turn into one another as the conventions say."""

import numpy as np
import pytest
from conftest import creature, refused
from scipy import sparse
from scipy.spatial import cKDTree

from spectra_kit import InvalidInputError, Spectrum, robust_laplacian
from spectra_kit.eigen import eigensolve
from spectra_kit.maps import (
    functional_map_from_point_map,
    functional_map_from_precise_map,
    nearest,
    nearest_rows,
    point_map_from_functional_map,
    precise_map,
)

N = 500


@pytest.fixture(scope="module")
def spectrum() -> Spectrum:
    return eigensolve(robust_laplacian(creature(N)), 30)


@pytest.fixture(scope="module")
def shuffle() -> np.ndarray:
    return np.random.default_rng(0).permutation(N)


@pytest.fixture(scope="module")
def copy(spectrum, shuffle) -> Spectrum:
    """The same surface with its points in another order, in another unit."""
    return Spectrum(
        spectrum.eigenvalues, spectrum.eigenvectors[shuffle], spectrum.mass[shuffle]
    ).rescale(1000.0)


@pytest.fixture(scope="module")
def fine() -> Spectrum:
    return eigensolve(robust_laplacian(creature(900)), 20)


# --- nearest rows ---


@pytest.mark.parametrize("device", ["cpu", "cpu:0"])  # any name but "cpu" goes to torch
def test_nearest_rows_are_those_of_a_tree(device, monkeypatch) -> None:
    rng = np.random.default_rng(1)
    for width in (2, 150):
        points, queries = rng.normal(size=(400, width)), rng.normal(size=(321, width))
        points.flags.writeable = False  # as eigenvectors are
        whole = nearest_rows(queries, points, device=device)
        assert (whole == cKDTree(points).query(queries)[1]).all()
        assert (nearest_rows(queries, points, exact=False, device=device) != whole).mean() < 0.01
    assert not nearest_rows(queries, points[:1], device=device).any()
    equal = [[5.0, 5.0], [1.0, 2.0], [1.0, 2.0], [3.0, 2.0]]  # the lowest of equals
    assert nearest_rows([[1.1, 2.0], [2.0, 2.0]], equal, device=device).tolist() == [1, 1]
    # Differences beyond the digits of float32.
    close = 1000.0 + 1e-3 * rng.normal(size=(300, 4))
    rough, exact = (nearest_rows(close, close, exact=e, device=device) for e in (False, True))
    assert (exact == np.arange(300)).all()
    assert (rough != exact).any()
    # Blocks of 16 rows, shared by three threads, do not show: nor does the last, of one row.
    monkeypatch.setattr(nearest, "_BLOCK", 1)
    monkeypatch.setattr(nearest, "_DEVICE_BLOCK", 1)
    monkeypatch.setenv("NUMBA_NUM_THREADS", "3")
    assert (nearest_rows(queries, points, device=device) == whole).all()


# --- between kinds of maps ---


def test_a_reordered_copy_in_another_unit_has_the_identity(spectrum, copy, shuffle) -> None:
    C = functional_map_from_point_map(spectrum, copy, shuffle)
    assert pytest.approx(np.eye(30), abs=1e-9) == C
    for adjoint in (False, True):
        found = point_map_from_functional_map(spectrum, copy, C, adjoint=adjoint)
        assert (found == shuffle).all()
    hard = sparse.csr_array((np.ones(N), (np.arange(N), shuffle)), shape=(N, N))
    found = functional_map_from_precise_map(spectrum, copy, hard, k=(9, 8))
    assert found == pytest.approx(C[:8, :9], abs=1e-12)


def test_shapes_and_directions(spectrum, fine) -> None:
    """C_12 is (k2, k1) and pulls functions on the source back along the point map."""
    point_map = np.random.default_rng(3).integers(N, size=fine.n)
    C = functional_map_from_point_map(spectrum, fine, point_map, k=(12, 7))
    assert C.shape == (7, 12)
    values = spectrum.eigenvectors[:, :12] @ np.arange(12.0)
    factor = np.sqrt(spectrum.area / fine.area)  # both at unit area
    pulled = fine.truncate(7).project(values[point_map]) * factor
    assert pulled == pytest.approx(C @ np.arange(12.0), abs=1e-9)
    assert functional_map_from_point_map(spectrum, fine, point_map).shape == (20, 30)
    images = spectrum.rescale(spectrum.area**-0.5).eigenvectors[:, :12]
    rows = fine.rescale(fine.area**-0.5).eigenvectors[:, :7]
    for adjoint, tree, asked in ((False, images @ C.T, rows), (True, images, rows @ C)):
        found = point_map_from_functional_map(spectrum, fine, C, adjoint=adjoint)
        assert (found == cKDTree(tree).query(asked)[1]).all()


def test_a_precise_map_finds_the_nearest_point_of_a_triangle() -> None:
    """Rows of the second and third mode are the plane that triangle and points lie in."""
    corners = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0], [40.0, 40.0]])
    wanted = {  # by barycentric coordinates of the first three
        (1.0, 1.0): (1 / 3, 1 / 3, 1 / 3),
        (1.5, -1.0): (0.5, 0.5, 0.0),
        (3.0, 3.0): (0.0, 0.5, 0.5),
        (-1.0, -2.0): (1.0, 0.0, 0.0),
    }
    one, other = (
        Spectrum([0.0, 1.0], rows, np.full(len(rows), 1 / len(rows)))
        for rows in (corners, np.array(list(wanted)))
    )
    precise = precise_map(one, other, np.eye(2), [[0, 1, 2]]).toarray()
    assert precise[:, :3] == pytest.approx(np.array(list(wanted.values())))
    assert not precise[:, 3].any()
    # A flat triangle is its longest side; a vertex without triangles stands for itself.
    line = Spectrum([0.0, 1.0], [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 3.0]], np.full(4, 0.25))
    precise = precise_map(line, other, np.eye(2), [[0, 1, 2]]).toarray()
    assert precise @ [0.0, 1.0, 2.0, 9.0] == pytest.approx([1.0, 1.5, 9.0, 0.0])
    assert precise[2, 3] == 1


def test_precise_maps_beat_vertices_between_two_resolutions(spectrum, fine) -> None:
    """Other vertices on one surface: their places lie within triangles, not at vertices."""
    mesh, places = creature(N), creature(900).points
    by_space = cKDTree(mesh.points).query(places)[1]
    C = functional_map_from_point_map(spectrum, fine, by_space, k=20)
    precise = precise_map(spectrum, fine, C, mesh.faces)
    assert precise.shape == (fine.n, N)
    assert precise.sum(axis=1) == pytest.approx(np.ones(fine.n))
    assert precise.data.min() > 0
    vertices = point_map_from_functional_map(spectrum, fine, C)
    off = [
        np.linalg.norm(found - places, axis=1).mean()
        for found in (precise @ mesh.points, mesh.points[vertices])
    ]
    assert off[0] < 0.9 * off[1]
    again = functional_map_from_precise_map(spectrum, fine, precise, k=20)
    assert np.linalg.norm(again - C) < 0.2 * np.linalg.norm(C)


def test_maps_must_fit(spectrum, copy, fine) -> None:
    from_points, zeros = functional_map_from_point_map, np.zeros(N, dtype=int)
    to_points, from_precise = point_map_from_functional_map, functional_map_from_precise_map
    pair, narrow, hollow = (spectrum, copy), sparse.eye_array(N, 3), np.nan * sparse.eye_array(N)
    for argument, expected, call, *given in (
        ("queries", "be two-dimensional and", nearest_rows, np.zeros(3), np.eye(3)),
        ("points", "be two-dimensional and", nearest_rows, np.eye(3), np.zeros((0, 3))),
        ("points", "be finite", nearest_rows, np.eye(2), [[0.0, np.nan]]),
        ("queries` and `points", "have rows of", nearest_rows, np.eye(3), np.eye(2)),
        ("point_map", f"have shape ({N},)", from_points, *pair, zeros[:, None]),
        ("point_map", f"be in [0, {N})", from_points, *pair, zeros + N),
        ("point_map", "hold integers", from_points, *pair, np.zeros(N)),
        ("functional_map", "have shape (k2, k1)", to_points, *pair, np.eye(31)),
        ("functional_map", "be finite", to_points, *pair, np.full((3, 3), np.nan)),
        ("faces of the source", "be in [0,", precise_map, *pair, np.eye(3), [[0, 1, N]]),
        ("data of precise", "be finite", from_precise, *pair, hollow),
        ("precise", f"have shape ({N},", from_precise, *pair, narrow),
    ):
        refused(argument, expected, call, *given)
    refused("k of the source", "be in [1, 30]", from_points, *pair, zeros, k=31)
    few = np.zeros(fine.n, dtype=int)
    refused("k of the target", "be in [1, 20]", from_points, spectrum, fine, few, k=(5, 21))
    for device in ("quantum", "cuda:99", ""):
        refused("device", "be", nearest_rows, [[0.0]], [[0.0]], device=device)
    with pytest.raises(InvalidInputError, match=r"\(900,\).* \(it seems to run from"):
        from_points(spectrum, fine, zeros)
