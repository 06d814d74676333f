"""`fit_functional_map`: the minimum it finds, what the terms ask for, and what it refuses."""

import numpy as np
import pytest
from conftest import creature, refused

from spectra_kit import TriangleMesh, eigensolve, robust_laplacian
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import ConvergenceError
from spectra_kit.features import normalize_descriptors, wave_kernel_signature
from spectra_kit.geometry import sphere
from spectra_kit.maps import (
    FitWeights,
    fit,
    fit_functional_map,
    functional_map_from_point_map,
    point_map_from_functional_map,
)
from spectra_kit.maps.fit import (
    Commuting,
    Preserved,
    commuting,
    laplacian_mask,
    minimise,
    preserved,
)
from spectra_kit.operators.oriented import oriented_triangles

K = 12


def wks(spectrum: Spectrum, count: int = 20) -> np.ndarray:
    return normalize_descriptors(spectrum, wave_kernel_signature(spectrum, count=count))


@pytest.fixture(scope="module")
def animal() -> tuple[TriangleMesh, Spectrum]:
    mesh = creature(500)
    return mesh, eigensolve(robust_laplacian(mesh), 40)


@pytest.fixture(scope="module")
def bent() -> tuple[TriangleMesh, Spectrum]:
    """The same animal in another pose, its points in the same order."""
    mesh = creature(500, pose=1)
    return mesh, eigensolve(robust_laplacian(mesh), 40)


@pytest.fixture(scope="module")
def symmetric() -> tuple[TriangleMesh, Spectrum, np.ndarray]:
    """A body that is its own mirror image in y but has no other symmetry, and the mirror map."""
    ball = sphere(subdivisions=3).geometry
    x, y, z = ball.points.T
    wave = 0.2 * np.sin(2 * x + 1) + 0.15 * np.cos(3 * y * y - z) + 0.1 * z**3
    mesh = TriangleMesh(ball.points * (1 + wave[:, None]) * [1.0, 1.3, 1.7], ball.faces)
    image = {tuple(p): i for i, p in enumerate(np.round(mesh.points, 9) + 0.0)}
    mirror = [image[tuple(p)] for p in np.round(mesh.points * [1, -1, 1], 9) + 0.0]
    return mesh, eigensolve(robust_laplacian(mesh), 40), np.array(mirror)


# --- the minimum ------------------------------------------------------------------------------


def random_energy(rng, k1, k2):
    mask = rng.random((k2, k1))
    data = [Preserved(rng.standard_normal((k1, 4)), rng.standard_normal((k2, 4)), 0.7)]
    operators = [
        Commuting(rng.standard_normal((3, k1, k1)), rng.standard_normal((3, k2, k2)), w)
        for w in (0.5, 1.3)
    ]
    return mask, data, operators, (rng.standard_normal(k1), rng.standard_normal(k2))


def by_lagrange_multipliers(mask, data, operators, constants):
    k2, k1 = mask.shape
    m = min(k1, k2)

    def residual(C):
        parts = [np.sqrt(mask) * C]
        parts += [np.sqrt(t.weight) * (C @ t.a - t.b) for t in data]
        parts += [np.sqrt(t.weight) * (C @ t.source - t.target @ C)[:, :m, :m] for t in operators]
        return np.concatenate([part.ravel() for part in parts])

    offset = residual(np.zeros((k2, k1)))
    D = np.stack([residual(e.reshape(k2, k1)) - offset for e in np.eye(k1 * k2)], axis=1)
    A = np.kron(np.eye(k2), constants[0])
    system = np.block([[D.T @ D, A.T], [A, np.zeros((k2, k2))]])
    solution = np.linalg.solve(system, np.r_[-D.T @ offset, constants[1]])
    return solution[: k1 * k2].reshape(k2, k1)


@pytest.mark.parametrize(("k1", "k2"), [(1, 3), (5, 5), (4, 7), (7, 4)])
@pytest.mark.parametrize(("dense", "with_operators"), [(2500, True), (0, True), (0, False)])
def test_the_minimum_is_that_of_the_quadratic_program(k1, k2, dense, with_operators) -> None:
    mask, data, operators, constants = random_energy(np.random.default_rng(k1), k1, k2)
    operators = operators if with_operators else []
    expected = by_lagrange_multipliers(mask, data, operators, constants)
    got = minimise(mask, data, operators, constants, dense=dense)
    assert np.allclose(got, expected, atol=1e-9)
    assert np.allclose(got @ constants[0], constants[1], atol=1e-13)


def test_conjugate_gradients_that_do_not_converge_say_so(monkeypatch) -> None:
    monkeypatch.setattr(fit, "_MAX_STEPS", 1)
    with pytest.raises(ConvergenceError, match=r"after 1 steps; raise `commutativity`"):
        minimise(*random_energy(np.random.default_rng(0), 5, 6), dense=0)


def test_each_term_counts_one_for_a_random_map() -> None:
    rng = np.random.default_rng(0)
    k1, k2 = 4, 6
    maps = rng.standard_normal((20_000, k2, k1)) * np.sqrt(4 / (k1 * k2))
    constants = np.eye(k1)[0], np.eye(k2)[0]
    f, g = rng.standard_normal((k1, 3)), rng.standard_normal((k2, 3))
    f[0], g[0] = 0, 0  # no constant part, which is left out of the mean
    term = preserved("f", f, g, constants, 1.0)
    energy = term.weight * np.sum((maps @ term.a - term.b) ** 2, axis=(1, 2))
    assert energy.mean() == pytest.approx(1, rel=0.03)
    pair = commuting("f", rng.random((2, k1, k1)), rng.random((2, k2, k2)), 1.0)
    gaps = [
        (maps @ a - b @ maps)[:, :k1, :k1] for a, b in zip(pair.source, pair.target, strict=True)
    ]
    energy = pair.weight * np.sum(np.square(gaps), axis=(0, 2, 3))
    assert energy.mean() == pytest.approx(1, rel=0.03)
    for kind in ("resolvent", "standard"):
        mask = laplacian_mask(kind, np.arange(4.0), np.arange(6.0))
        assert np.mean(np.sum(mask * maps**2, axis=(1, 2))) == pytest.approx(1, rel=0.03)


# --- what the terms ask for -------------------------------------------------------------------


def test_a_permuted_copy_in_other_units_returns_the_permutation(animal) -> None:
    _, spectrum = animal
    order = np.random.default_rng(0).permutation(spectrum.n)
    signs = np.random.default_rng(1).choice([-1.0, 1.0], spectrum.k)
    copy = Spectrum(
        spectrum.eigenvalues, spectrum.eigenvectors[order] * signs, spectrum.mass[order]
    ).rescale(1000)
    f = wks(spectrum, 60)
    C = fit_functional_map(spectrum, copy, f, f[order], k=30)
    assert np.allclose(C, np.diag(signs[:30]), atol=1e-6)
    assert (point_map_from_functional_map(spectrum, copy, C) == order).all()


@pytest.mark.parametrize("k", [(20, 14), (14, 20)])
def test_rectangular_maps_between_poses_are_near_the_true_one(animal, bent, k) -> None:
    (_, one), (_, other) = animal, bent
    true = functional_map_from_point_map(one, other, np.arange(one.n), k=k)
    for mask in ("resolvent", "standard"):
        C = fit_functional_map(one, other, wks(one), wks(other), k=k, mask=mask)
        assert C.shape == true.shape
        assert np.linalg.norm(C - true) < 0.4 * np.linalg.norm(true)
        assert np.allclose(np.abs(C[:, 0]), np.eye(len(C))[0], atol=1e-6)


@pytest.mark.parametrize("mirrored", [False, True])
def test_orientation_decides_between_left_and_right(symmetric, mirrored) -> None:
    mesh, spectrum, mirror = symmetric
    f = wks(spectrum)
    oriented = oriented_triangles(mesh)
    C = fit_functional_map(
        spectrum,
        spectrum,
        f,
        f,
        k=20,
        weights=FitWeights(orientation=1.0),
        mirrored=mirrored,
        oriented=(oriented, oriented),
    )
    true = mirror if mirrored else np.arange(spectrum.n)
    expected = functional_map_from_point_map(spectrum, spectrum, true, k=20)
    assert np.linalg.norm(C - expected) < 1e-3
    # Without it, odd functions go nowhere: nothing tells the map from its mirror image.
    C = fit_functional_map(spectrum, spectrum, f, f, k=20)
    odd = np.diag(functional_map_from_point_map(spectrum, spectrum, mirror, k=20)) < 0
    assert odd.sum() > 5
    assert np.abs(C[odd]).max() < 1e-3


def test_landmarks_break_a_symmetry(symmetric) -> None:
    _, spectrum, mirror = symmetric
    f = wks(spectrum)
    side = np.array([5, 77, 300])
    for there, true in ((side, np.arange(spectrum.n)), (mirror[side], mirror)):
        C = fit_functional_map(spectrum, spectrum, f, f, k=20, landmarks=(side, there))
        expected = functional_map_from_point_map(spectrum, spectrum, true, k=20)
        assert np.linalg.norm(C - expected) < 0.1


def test_two_components_keep_their_areas_apart(animal) -> None:
    mesh, _ = animal
    ball = sphere(subdivisions=2).geometry
    both = TriangleMesh(
        np.vstack([mesh.points, ball.points + [9, 0, 0]]),
        np.vstack([mesh.faces, ball.faces + mesh.n]),
    )
    spectrum = eigensolve(robust_laplacian(both), 20)
    f = np.sin(both.points)
    C = fit_functional_map(spectrum, spectrum, f, f, k=20, weights=FitWeights(commutativity=1e-4))
    ones = spectrum.rescale(spectrum.area**-0.5).project(np.ones(both.n))
    assert np.allclose(C @ ones, ones, atol=1e-12)
    assert np.linalg.norm(C - np.eye(20)) < 0.05


# --- what is refused --------------------------------------------------------------------------


def test_what_cannot_be_fitted_is_refused(animal, bent, symmetric) -> None:
    (mesh, one), (_, other) = animal, bent
    f, g = wks(one), wks(other)
    oriented, two = oriented_triangles(mesh), Spectrum(np.zeros(2), np.eye(2), np.ones(2))
    turned = FitWeights(orientation=1.0)
    pair = (oriented, oriented_triangles(symmetric[0]))
    given = {"source": one, "target": other, "source_descriptors": f, "target_descriptors": g}
    for argument, expected, changes in (
        ("source_descriptors", "have shape (500, p)", {"source_descriptors": f.T}),
        ("target_descriptors", "have shape (500, p)", {"target_descriptors": g[:, :0]}),
        ("source_descriptors` and `target_descriptors", "have the same number of columns",
         {"target_descriptors": g[:, 1:]}),
        ("k of the source", "be in [1, 40]", {"k": 41}),
        ("oriented", "be given where", {"weights": turned}),
        ("oriented", "be on the 500 and 500 points", {"weights": turned, "oriented": pair}),
        ("landmarks", "be two lists of one length, at least 1", {"landmarks": ([], [])}),
        ("landmarks", "be two lists of one length", {"landmarks": ([1], [1, 2])}),
        ("landmarks", "be a pair", {"landmarks": [1, 2]}),
        ("landmarks of the target", "be in [0, 500)", {"landmarks": ([1], [500])}),
        ("descriptors", "not all be constant",
         {"source_descriptors": 0 * f + 0.1, "target_descriptors": 0 * g + 0.7}),
        ("source` and `target", "have the same number of components",
         {"target": two, "target_descriptors": np.ones((2, 20)), "k": 2}),
    ):  # fmt: skip
        refused(argument, expected, fit_functional_map, **{**given, "k": K, **changes})
    for name in FitWeights.__dataclass_fields__:
        for wrong in (-1.0, np.inf, "1"):
            refused(name, "be a", FitWeights, **{name: wrong})
    refused("multiplication", "be 0 where", commuting, "multiplication", np.eye(3)[None],
            np.eye(4)[None], 1.0)  # fmt: skip
    mask, [data], _, constants = random_energy(np.random.default_rng(0), 5, 6)
    alone = Preserved(data.a[:, :1], data.b[:, :1], 1.0)
    refused("weights", "leave the fit well", minimise, 0 * mask, [alone], [], constants)
