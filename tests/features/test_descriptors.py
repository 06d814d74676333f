"""Descriptors of points and surfaces: closed forms, brute force, and what must not matter."""

import subprocess
import sys

import numpy as np
import pytest
from conftest import bumpy, refused, two_parts
from scipy.linalg import block_diag, expm
from scipy.special import gammaln, lpmv

from spectra_kit import (
    Dense,
    Spectrum,
    cotan_laplacian,
    eigensolve,
    features,
    robust_laplacian,
)
from spectra_kit.features import (
    global_point_signature,
    heat_kernel,
    heat_kernel_signature,
    heat_times,
    normalize_descriptors,
    shape_dna,
    shape_dna_distances,
    wave_energies,
    wave_kernel_signature,
)
from spectra_kit.geometry import sphere, write

LANDMARKS = [3, 17]
SIGNATURES = {
    "hks": heat_kernel_signature,
    "hks-scaled": lambda s: heat_kernel_signature(s, scaled=True),
    "wks": wave_kernel_signature,
    "landmark-hks": lambda s: heat_kernel_signature(s, landmarks=LANDMARKS),
    "landmark-wks": lambda s: wave_kernel_signature(s, landmarks=LANDMARKS),
}


def harmonics(n=60, degree=6, radius=1.0):
    """The exact spectrum of a sphere at random points: real spherical harmonics."""
    points = np.random.default_rng(0).standard_normal((n, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    z, angle = points[:, 2], np.arctan2(points[:, 1], points[:, 0])
    columns, values = [], []
    for l in range(degree + 1):
        for m in range(-l, l + 1):
            a = abs(m)
            norm = (2 * l + 1) / (4 * np.pi) * np.exp(gammaln(l - a + 1) - gammaln(l + a + 1))
            wave = np.sqrt(2 - (a == 0)) * (np.cos(a * angle) if m >= 0 else np.sin(a * angle))
            columns.append(np.sqrt(norm) * lpmv(a, l, z) * wave / radius)
            values.append(l * (l + 1) / radius**2)
    mass = np.full(n, 4 * np.pi * radius**2 / n)
    return Spectrum(np.array(values), np.stack(columns, axis=1), mass), points @ points.T


@pytest.fixture(scope="module")
def bumps():
    return eigensolve(robust_laplacian(bumpy()), 40)


@pytest.fixture(scope="module")
def complete():
    """All modes of a small mesh, with its matrices: sums over modes are then exact."""
    laplacian = cotan_laplacian(sphere(subdivisions=1).geometry)
    return eigensolve(laplacian, laplacian.n, Dense()), laplacian


def test_heat_kernel_is_the_exponential_of_the_operator(complete):
    spectrum, laplacian = complete
    generator = laplacian.stiffness.toarray() / laplacian.mass[:, None]
    times = [0.01, 1.0]
    expected = np.stack([expm(-t * generator) / laplacian.mass for t in times], axis=2)
    np.testing.assert_allclose(heat_kernel(spectrum, range(spectrum.n), times), expected, atol=1e-9)
    np.testing.assert_allclose(
        heat_kernel_signature(spectrum, times), np.einsum("iit->it", expected), atol=1e-9
    )
    columns = heat_kernel_signature(spectrum, times, landmarks=LANDMARKS)
    np.testing.assert_allclose(
        columns, np.hstack([expected[:, i] for i in LANDMARKS]), atol=1e-9
    )  # fmt: skip


def test_wks_is_a_loop_over_its_formula(bumps):
    energies, width = wave_energies(bumps, 9, width=0.2)
    assert width == 0.2
    expected = np.zeros((bumps.n, 9))
    for j, e in enumerate(energies):
        weights = np.exp(-((e - np.log(bumps.eigenvalues[1:])) ** 2) / (2 * width**2))
        for i, w in enumerate(weights):
            expected[:, j] += w / weights.sum() * bumps.eigenvectors[:, i + 1] ** 2
    for given in ({"count": 9}, {"energies": energies}):
        found = wave_kernel_signature(bumps, **given, width=width)
        np.testing.assert_allclose(found, expected, rtol=1e-10)
    energies, width = wave_energies(bumps)
    np.testing.assert_allclose(
        wave_kernel_signature(bumps, energies), wave_kernel_signature(bumps, energies, width=width)
    )


def test_the_diagonal_of_landmarks_is_the_signature(bumps):
    everyone = range(bumps.n)
    for signature in (heat_kernel_signature, wave_kernel_signature):
        columns = signature(bumps, landmarks=everyone, count=3).reshape(bumps.n, bumps.n, 3)
        np.testing.assert_allclose(np.einsum("iit->it", columns), signature(bumps, count=3))


def test_logarithms_are_of_units_of_the_mean(bumps):
    in_mm = bumps.rescale(1000.0)
    for signature, rest in ((heat_kernel_signature, 0.0), (wave_kernel_signature, 1e-3)):
        found = signature(bumps, logarithm=True)
        np.testing.assert_allclose(np.exp(found), signature(bumps) * bumps.area + rest)
        np.testing.assert_allclose(signature(in_mm, logarithm=True), found, atol=1e-9)
        refused("logarithm", "be False", signature, bumps, landmarks=[0], logarithm=True)


def test_what_has_no_spectrum_yet_gets_the_default_one(tmp_path):
    mesh = bumpy()
    spectrum = eigensolve(robust_laplacian(mesh), 96)
    write(mesh, tmp_path / "mesh.npz")
    for given in (mesh, robust_laplacian(mesh), tmp_path / "mesh.npz"):
        for name, descriptor in features.DESCRIPTORS.items():
            np.testing.assert_array_equal(descriptor(given), descriptor(spectrum), err_msg=name)
    few = sphere(subdivisions=1).geometry
    assert global_point_signature(few).shape == (few.n, few.n - 1)


def test_scaled_columns_have_integral_one(bumps):
    hks = heat_kernel_signature(bumps, scaled=True)
    np.testing.assert_allclose(bumps.mass @ hks, 1, rtol=1e-10)
    np.testing.assert_allclose(bumps.mass @ wave_kernel_signature(bumps), 1, rtol=1e-10)
    trace = np.exp(-np.outer(bumps.eigenvalues, heat_times(bumps))).sum(axis=0)
    np.testing.assert_allclose(hks * trace, heat_kernel_signature(bumps))


def test_nothing_underflows(bumps):
    # Without the constant all heat is gone long before; the shares of it that are left are not.
    hks = heat_kernel_signature(bumps.nonzero(), [1e6], scaled=True)
    np.testing.assert_allclose(hks[:, 0], bumps.eigenvectors[:, 1] ** 2)
    wks = wave_kernel_signature(bumps, [-1000.0])
    np.testing.assert_allclose(wks[:, 0], bumps.eigenvectors[:, 1] ** 2)


def test_scaling_is_a_power_of_the_scale(bumps):
    for signature in SIGNATURES.values():
        small, big = signature(bumps), signature(bumps.rescale(1000.0))
        np.testing.assert_allclose(1e6 * big, small, rtol=1e-10, atol=1e-12)


def test_grids_follow_the_definitions(bumps):
    first, last = bumps.eigenvalues[[1, -1]]
    times = heat_times(bumps, 5)
    np.testing.assert_allclose(np.exp(-first * times[-1]), 1e-4)
    np.testing.assert_allclose(np.exp(-last * times[0]), 1e-4)
    np.testing.assert_allclose(times[1:] / times[:-1], times[1] / times[0])
    energies, width = wave_energies(bumps)
    assert width == pytest.approx(7 * np.log(last / first) / 100)
    np.testing.assert_allclose(energies[[0, -1]], np.log([first, last]) + [2 * width, -2 * width])


def test_components_do_not_see_each_other():
    parts = eigensolve(robust_laplacian(two_parts()), 20)
    first = parts.eigenvalues[2]  # of the two kernels, grids know nothing
    assert heat_times(parts)[-1] == pytest.approx(4 * np.log(10) / first)
    assert wave_energies(parts)[0][0] > np.log(first)
    a, b = harmonics(n=40)[0], harmonics(n=30, radius=0.5)[0]
    values = np.concatenate([a.eigenvalues, b.eigenvalues])
    order = np.argsort(values, kind="stable")
    vectors = block_diag(a.eigenvectors, b.eigenvectors)[:, order]
    both = Spectrum(values[order], vectors, np.concatenate([a.mass, b.mass]))
    times = [0.1, 1.0, 100.0]
    together = heat_kernel_signature(both, times)
    np.testing.assert_allclose(together[:40], heat_kernel_signature(a, times))
    np.testing.assert_allclose(together[40:], heat_kernel_signature(b, times))
    assert not heat_kernel(both, [0], times)[0, 40:].any()


def test_gps_products_are_greens_function(complete):
    spectrum, laplacian = complete
    gps = global_point_signature(spectrum)
    assert gps.shape == (spectrum.n, spectrum.n - 1)
    # Green's function: L g = M (delta - 1/area), of zero mean.
    ones = np.ones((spectrum.n, spectrum.n))
    right = np.eye(spectrum.n) - ones * laplacian.mass[:, None] / spectrum.area
    np.testing.assert_allclose(laplacian.stiffness @ (gps @ gps.T), right, atol=1e-9)
    np.testing.assert_array_equal(global_point_signature(spectrum, 5), gps[:, :5])


def test_normalized_columns_have_one_size(bumps):
    hks = heat_kernel_signature(bumps)
    unit = normalize_descriptors(bumps, hks)
    np.testing.assert_allclose(bumps.mass @ unit**2, bumps.area)
    np.testing.assert_allclose(unit[:, 3] / unit[0, 3], hks[:, 3] / hks[0, 3])
    centred = normalize_descriptors(bumps, hks, center=True)
    np.testing.assert_allclose(bumps.mass @ centred, 0, atol=1e-9)
    np.testing.assert_allclose(bumps.mass @ centred**2, bumps.area)
    # Without a unit: in millimetres the columns, of which 1/length^2 is the unit, are the same.
    in_mm = bumps.rescale(1000.0)
    np.testing.assert_allclose(normalize_descriptors(in_mm, heat_kernel_signature(in_mm)), unit)


# --- ShapeDNA ---


def exact_sphere(k, radius=1.0):
    """A spectrum with the exact eigenvalues of a sphere and its area, on one point."""
    values = sphere(subdivisions=0, radius=radius, k=k).eigenvalues
    return Spectrum(values, np.ones((1, k)), [4 * np.pi * radius**2])


def test_dna_of_the_sphere():
    ball = exact_sphere(16, radius=3.0)
    degree = np.repeat([1, 2, 3], [3, 5, 7])
    np.testing.assert_allclose(shape_dna(ball), 4 * np.pi * degree * (degree + 1))
    np.testing.assert_allclose(shape_dna(ball, normalize="first"), degree * (degree + 1) / 2)
    np.testing.assert_allclose(shape_dna(ball, normalize=None), degree * (degree + 1) / 9)
    np.testing.assert_array_equal(shape_dna(ball, 4), shape_dna(ball)[:4])


def test_weyls_law_finds_the_area():
    ball = exact_sphere(2500)
    ratio = shape_dna(ball, normalize="weyl") / shape_dna(ball)
    np.testing.assert_allclose(ratio, ratio[0])
    assert ratio[0] == pytest.approx(1, rel=2e-3)


def test_distances_of_dna_by_their_formulas():
    rows = np.cumsum(np.random.default_rng(0).uniform(0.5, 2, (5, 12)), axis=1)
    gaps = rows[:, None] - rows
    for weight, scale in (
        ("index", np.arange(1, 13)),
        ("inverse", rows[:, None] * rows),
        (None, 1.0),
    ):
        expected = np.linalg.norm(gaps / scale, axis=2)
        np.testing.assert_allclose(shape_dna_distances(rows, weight=weight), expected)


# --- what is refused ---

TWO = Spectrum(np.zeros(2), np.eye(2), np.ones(2))
ONE_VALUE = Spectrum(np.array([0.0, 2.0, 2.0]), np.eye(3), np.ones(3))


def test_bad_input_is_refused(bumps):
    s, unlike = bumps, np.eye(bumps.n)[:, :2] * [1, 0]
    for argument, expected, call, *given in (
        *(
            ("surface", "have modes outside its kernel, got 2 zero modes alone", call, TWO, *more)
            for call, *more in (
                (heat_times,),
                (global_point_signature,),
                (shape_dna,),
                (features.biharmonic_distances, [0]),
                (features.commute_time_distances, [0]),
                (features.farthest_points, 1),
            )
        ),
        ("surface", "have two different eigenvalues outside its", wave_energies, ONE_VALUE),
        ("count", "be at least 2, got 1", heat_times, s, 1),
        ("count", "be at least 2, got 1", wave_energies, s, 1),
        ("count", "be in [1, 39], got 40", global_point_signature, s, s.k),
        ("count", "be in [1, 39], got 0", shape_dna, s, 0),
        ("count", "be in [1, 39], got 40", shape_dna, s, 40),
        ("count", "be in [1, 642], got 643", features.farthest_points, s, 643),
        ("energies", "be a vector of at least one number, got shape (); write [1.0]",
         wave_kernel_signature, s, 1.0),
        ("energies", "be a vector of at least one number, got shape (0,)",
         wave_kernel_signature, s, []),
        ("energies", "be a vector, got a tuple of two as `wave_energies` returns it; write",
         wave_kernel_signature, s, wave_energies(s)),
        ("energies", "be a vector, got a tuple of two as `wave_energies` returns it; write",
         wave_kernel_signature, s, ([[1.0, 2.0]], 0.5)),
        ("times", "be positive, got 1 entry", heat_kernel_signature, s, [0.0, 1.0]),
        ("times", "be finite", heat_kernel_signature, s, [np.nan]),
        ("sources", "name at least one point, got none", heat_kernel, s, [], [1.0]),
        ("sources", "be a vector, got shape (); write [3]", heat_kernel, s, 3, [1.0]),
        ("sources", "be in [0, 642), got 642", heat_kernel, s, [s.n], [1.0]),
        ("sources", "name at least one point", features.biharmonic_distances, s, []),
        ("sources", "be in [0, 642), got 642", features.commute_time_distances, s, [642]),
        ("descriptors", "have shape (642, d)", normalize_descriptors, s, np.ones(3)),
        ("descriptors", "have no zero column, got one in column 1", normalize_descriptors, s,
         unlike),
        ("dnas", "have shape (s, count), count >= 1, got (2,)", shape_dna_distances, [1.0, 2.0]),
        ("dnas", "have shape (s, count)", shape_dna_distances, np.ones((2, 0))),
        ("dnas", "have rows of one length", shape_dna_distances, [[1.0, 2.0], [1.0]]),
        ("dnas", "be positive, got 1 entry <= 0", shape_dna_distances, [[0.0, 2.0]]),
        ("dnas", "be finite", shape_dna_distances, [[np.nan, 2.0]]),
    ):  # fmt: skip
        refused(argument, expected, call, *given)
    for argument, expected, call, given, option in (
        ("landmarks", "name at least one point", heat_kernel_signature, (s,), []),
        ("landmarks", "be in [0, 642)", wave_kernel_signature, (s,), [-1]),
        ("width", "be below a quarter of the range", wave_energies, (s,), 9.0),
        ("width", "be positive and finite, got 0", wave_energies, (s,), 0.0),
        ("width", "be positive", wave_kernel_signature, (s, [1.0]), -1.0),
        ("sources", "hold integers", features.diffusion_distances, (s, [0.5]), 1.0),
        ("time", "be positive and finite", features.diffusion_distances, (s, [0]), 0.0),
        ("start", "be in [0, 641], got -1", features.farthest_points, (s, 3), -1),
        ("descriptors", "have no constant column, got one in column 0", normalize_descriptors,
         (s, np.full((s.n, 1), 0.1)), True),
    ):  # fmt: skip
        name = {"sources": "time", "descriptors": "center"}.get(argument, argument)
        refused(argument, expected, call, *given, **{name: option})


def test_torch_is_not_imported_for_them():
    code = (
        "import sys; from spectra_kit import features, geometry;"
        " ball = geometry.sphere(subdivisions=1).geometry;"
        " features.embed(ball, features.HeatKernelSignature(), k=20);"
        " [descriptor(ball) for descriptor in features.DESCRIPTORS.values()];"
        " sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
