"""Point maps, functional maps and precise maps turn into one another as the conventions say."""

import numpy as np
import pytest
from conftest import creature, refused
from scipy import sparse
from scipy.spatial import cKDTree

from spectra_kit import InvalidInputError, Spectrum, robust_laplacian
from spectra_kit.eigensolvers import eigensolve
from spectra_kit.functional_maps import (
    Correspondence,
    functional_map_from_point_map,
    functional_map_from_precise_map,
    nearest_rows,
    point_map_from_functional_map,
    precise_map,
)
from spectra_kit.geometry import TriangleMesh

PRECISE_CASES = {  # q against the triangle (0,0) (1,0) (0,1)
    "inside": ([0.25, 0.25], [0.5, 0.25, 0.25]),
    "beyond a side": ([0.5, -1.0], [0.5, 0.5, 0.0]),
    "beyond the long side": ([1.0, 1.0], [0.0, 0.5, 0.5]),
    "beyond a corner": ([-1.0, -2.0], [1.0, 0.0, 0.0]),
}


@pytest.fixture(scope="module")
def mesh() -> TriangleMesh:
    return creature(700)


@pytest.fixture(scope="module")
def spectrum(mesh) -> Spectrum:
    return eigensolve(robust_laplacian(mesh), 40)


@pytest.fixture(scope="module")
def shuffle(spectrum) -> np.ndarray:
    return np.random.default_rng(0).permutation(spectrum.n)


@pytest.fixture(scope="module")
def copy(spectrum, shuffle) -> Spectrum:
    """The same surface with its points in another order, in another unit."""
    return Spectrum(
        spectrum.eigenvalues, spectrum.eigenvectors[shuffle], spectrum.mass[shuffle]
    ).rescale(1000.0)


@pytest.mark.parametrize("width", [1, 3, 20, 150])
def test_nearest_rows_agree_with_a_tree(width: int) -> None:
    rng = np.random.default_rng(width)
    points, queries = rng.normal(size=(900, width)), rng.normal(size=(1100, width))
    found = nearest_rows(queries, points)
    assert (found == cKDTree(points).query(queries)[1]).all()
    assert (nearest_rows(queries, points, exact=False) != found).mean() < 0.01


def test_nearest_rows_are_exact_where_single_precision_is_not() -> None:
    rng = np.random.default_rng(0)
    points = 1000.0 + 1e-3 * rng.normal(size=(300, 4))  # differences beyond the digits of float32
    queries = points[rng.permutation(300)] + 1e-7
    assert (nearest_rows(queries, points) == cKDTree(points).query(queries)[1]).all()
    assert (nearest_rows(queries, points, exact=False) != nearest_rows(queries, points)).any()


def test_the_lowest_of_equal_rows_is_chosen() -> None:
    points = np.array([[5.0, 5.0], [1.0, 2.0], [1.0, 2.0], [3.0, 2.0]])
    assert nearest_rows([[1.1, 2.0], [2.0, 2.0]], points).tolist() == [1, 1]
    assert nearest_rows(np.zeros((3, 2)), np.zeros((4, 2))).tolist() == [0, 0, 0]
    assert nearest_rows(np.zeros((3, 2)), np.ones((1, 2))).tolist() == [0, 0, 0]


def test_blocks_and_threads_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    from spectra_kit.functional_maps import nearest

    rng = np.random.default_rng(1)
    points, queries = rng.normal(size=(50, 5)), rng.normal(size=(333, 5))
    whole = nearest_rows(queries, points)
    monkeypatch.setattr(nearest, "_BLOCK", 1)  # 16 rows at a time
    monkeypatch.setenv("NUMBA_NUM_THREADS", "3")
    assert (nearest_rows(queries, points) == whole).all()
    monkeypatch.setattr(nearest, "_DEVICE_BLOCK", 1)
    assert (nearest_rows(queries, points, device="cpu:0") == whole).all()


def test_torch_finds_the_same_rows() -> None:
    rng = np.random.default_rng(2)
    points, queries = rng.normal(size=(400, 30)), rng.normal(size=(500, 30))
    points[7] = points[3]
    queries[0] = points[3]
    found = nearest_rows(queries, points, device="cpu:0")  # any name but "cpu" goes to torch
    assert found[0] == 3
    assert (found == nearest_rows(queries, points)).all()
    close = 1000.0 + 1e-3 * points
    assert (nearest_rows(close, close, device="cpu:0") == nearest_rows(close, close)).all()
    assert nearest_rows(queries, points[:1], device="cpu:0").max() == 0
    points.flags.writeable = False  # as eigenvectors are
    assert (nearest_rows(points, points, device="cpu:0") == nearest_rows(points, points)).all()


def test_torch_decides_in_single_precision_where_that_is_enough() -> None:
    rows = 1000.0 + 1e-3 * np.random.default_rng(4).normal(size=(300, 4))
    rough, exact = (nearest_rows(rows, rows, exact=e, device="cpu:0") for e in (False, True))
    assert (exact == np.arange(300)).all()
    assert (rough != exact).any()


@pytest.mark.parametrize("device", ["quantum", "meta", "cuda:99", ""])
def test_a_device_that_is_not_there_is_refused(device: str) -> None:
    with pytest.raises(InvalidInputError, match=rf"`device` must .* '{device}' \(.*; try 'cpu'"):
        nearest_rows([[0.0]], [[0.0]], device=device)


def test_rows_must_fit() -> None:
    refused("queries", "be two-dimensional and", nearest_rows, np.zeros(3), np.zeros((2, 3)))
    refused("points", "be two-dimensional and", nearest_rows, np.zeros((1, 3)), np.zeros((0, 3)))
    with pytest.raises(InvalidInputError, match="rows of one length, got 3 and 2"):
        nearest_rows(np.zeros((1, 3)), np.zeros((1, 2)))
    refused("points", "be finite", nearest_rows, np.zeros((1, 2)), [[0.0, np.nan]])


def test_a_reordered_copy_in_another_unit_has_the_identity(spectrum, copy, shuffle) -> None:
    C = functional_map_from_point_map(spectrum, copy, shuffle)
    assert pytest.approx(np.eye(40), abs=1e-9) == C
    for adjoint in (False, True):
        found = point_map_from_functional_map(spectrum, copy, C, adjoint=adjoint)
        assert (found == shuffle).all()


def test_shapes_and_directions(spectrum) -> None:
    """C_12 is (k2, k1) and pulls functions on the source back along the point map."""
    other = eigensolve(robust_laplacian(creature(500)), 20)
    point_map = np.random.default_rng(3).integers(spectrum.n, size=other.n)
    C = functional_map_from_point_map(spectrum, other, point_map, k=(12, 7))
    assert C.shape == (7, 12)
    values = spectrum.eigenvectors[:, :12] @ np.arange(12.0)
    factor = np.sqrt(spectrum.area / other.area)  # both at unit area
    pulled = other.truncate(7).project(values[point_map]) * factor
    assert pulled == pytest.approx(C @ np.arange(12.0), abs=1e-9)
    assert functional_map_from_point_map(spectrum, other, point_map).shape == (20, 40)
    assert point_map_from_functional_map(spectrum, other, C).shape == (other.n,)


def test_constants_are_carried_to_constants(spectrum) -> None:
    other = eigensolve(robust_laplacian(creature(500)), 6)
    C = functional_map_from_point_map(spectrum, other, np.zeros(other.n, dtype=int), k=6)
    assert np.abs(C[:, 0]) == pytest.approx([1, 0, 0, 0, 0, 0], abs=1e-9)


def test_maps_must_fit(spectrum, copy) -> None:
    n = spectrum.n
    other = eigensolve(robust_laplacian(creature(500)), 6)
    with pytest.raises(InvalidInputError, match=rf"shape \({other.n},\).* \(it seems to run from"):
        functional_map_from_point_map(spectrum, other, np.zeros(n, dtype=int))
    with pytest.raises(InvalidInputError, match=rf"`point_map` must have shape \({n},\)"):
        functional_map_from_point_map(spectrum, copy, np.zeros((n, 1), dtype=int))
    with pytest.raises(InvalidInputError, match=rf"must be in \[0, {n}\), got {n}"):
        functional_map_from_point_map(spectrum, copy, np.full(n, n))
    with pytest.raises(InvalidInputError, match="`point_map` must hold integers"):
        functional_map_from_point_map(spectrum, copy, np.zeros(n))
    with pytest.raises(InvalidInputError, match=r"`k of the source` must be in \[1,"):
        functional_map_from_point_map(spectrum, copy, np.zeros(n, dtype=int), k=41)
    with pytest.raises(InvalidInputError, match=r"`k of the target` must be in \[1,"):
        functional_map_from_point_map(spectrum, other, np.zeros(other.n, dtype=int), k=(5, 7))
    with pytest.raises(InvalidInputError, match=r"must have shape \(k2, k1\).* got \(41, 3\)"):
        point_map_from_functional_map(spectrum, copy, np.zeros((41, 3)))
    with pytest.raises(InvalidInputError, match="`functional_map` must be finite"):
        point_map_from_functional_map(spectrum, copy, np.full((3, 3), np.nan))


def test_a_correspondence_is_read_only_and_says_its_size(spectrum) -> None:
    both = Correspondence(np.arange(4), np.eye(3))
    assert repr(both) == "Correspondence(4 points, functional map 3 x 3)"
    with pytest.raises(ValueError, match="read-only"):
        both.point_map[0] = 1


@pytest.mark.parametrize("name", PRECISE_CASES)
def test_the_nearest_point_of_a_triangle(name: str) -> None:
    from spectra_kit.functional_maps.precise import _project

    query, expected = PRECISE_CASES[name]
    corners = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    weights, squared = _project(np.array([query]), corners)
    assert weights[0] == pytest.approx(expected)
    assert squared[0] == pytest.approx(np.sum((weights[0] @ corners[0] - query) ** 2))
    # A flat triangle is its longest side.
    weights, _ = _project(np.array([[0.5, 1.0]]), np.array([[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]]))
    assert weights[0] @ [0.0, 1.0, 2.0] == pytest.approx(0.5)


def test_precise_maps_beat_vertices_between_two_resolutions(mesh, spectrum) -> None:
    """Other vertices on one surface: their places lie within triangles, not at vertices."""
    fine = creature(1400)
    target = eigensolve(robust_laplacian(fine), 40)
    by_space = cKDTree(mesh.points).query(fine.points)[1]
    C = functional_map_from_point_map(spectrum, target, by_space, k=30)
    precise = precise_map(spectrum, target, C, mesh.faces)
    assert precise.shape == (fine.n, mesh.n)
    assert precise.sum(axis=1) == pytest.approx(np.ones(fine.n))
    assert precise.data.min() > 0
    vertices = point_map_from_functional_map(spectrum, target, C)
    off = [
        np.linalg.norm(places - fine.points, axis=1).mean()
        for places in (precise @ mesh.points, mesh.points[vertices])
    ]
    assert off[0] < 0.8 * off[1]
    again = functional_map_from_precise_map(spectrum, target, precise, k=30)
    assert np.linalg.norm(again - C) < 0.2 * np.linalg.norm(C)


def test_a_point_map_is_a_precise_map_of_one_entry_each(spectrum, copy, shuffle) -> None:
    n = spectrum.n
    hard = sparse.csr_array((np.ones(n), (np.arange(n), shuffle)), shape=(n, n))
    expected = functional_map_from_point_map(spectrum, copy, shuffle, k=(9, 8))
    found = functional_map_from_precise_map(spectrum, copy, hard, k=(9, 8))
    assert found == pytest.approx(expected, abs=1e-12)


def test_a_vertex_without_triangles_stands_for_itself(mesh, spectrum) -> None:
    some = mesh.faces[~(mesh.faces == 0).any(axis=1)]
    precise = precise_map(spectrum, spectrum, np.eye(40), some)
    assert precise[0, 0] == 1
    assert (precise.sum(axis=1) > 0.999).all()


def test_precise_maps_must_fit(spectrum, copy) -> None:
    with pytest.raises(InvalidInputError, match=r"`faces of the source` must be in \[0,"):
        precise_map(spectrum, copy, np.eye(3), [[0, 1, 700]])
    refused("precise", "be a scipy", functional_map_from_precise_map, spectrum, copy, [0, 1, 2])
    with pytest.raises(InvalidInputError, match="`data of precise` must be finite"):
        functional_map_from_precise_map(spectrum, copy, np.nan * sparse.eye_array(700))
    with pytest.raises(InvalidInputError, match=r"`precise` must have shape \(700,"):
        functional_map_from_precise_map(spectrum, copy, sparse.csr_array((700, 3)))
