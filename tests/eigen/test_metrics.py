import warnings

import numpy as np
import pytest
from conftest import joined, refused, two_parts
from scipy.linalg import block_diag, expm

import spectra_kit as sk
from spectra_kit import RayleighRitz, eigensolve, robust_laplacian
from spectra_kit.eigen import Provenance, Spectrum
from spectra_kit.eigen.metrics import (
    align_modes,
    align_to_template,
    compare_spectra,
    span_error,
    subspace_span_error,
)
from spectra_kit.eigen.subspaces import AmbientFourier, GivenBasis
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.geometry import TriangleMesh, sphere

N, K = 60, 12


def random_rotation(size, seed):
    skew = np.random.default_rng(seed).standard_normal((size, size))
    return expm(skew - skew.T)


@pytest.fixture(scope="module")
def exact():
    """Twelve of sixty modes for a random mass; modes 3, 4, 5 share an eigenvalue."""
    rng = np.random.default_rng(0)
    mass = rng.uniform(0.5, 2.0, N)
    q, _ = np.linalg.qr(rng.standard_normal((N, N)))
    values = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0])
    return Spectrum(values, q[:, :K] / np.sqrt(mass)[:, None], mass)


@pytest.fixture(scope="module")
def outside(exact):
    """M-orthonormal functions orthogonal to the exact modes."""
    root = np.sqrt(exact.mass)[:, None]
    rest = np.random.default_rng(1).standard_normal((N, K))
    q, _ = np.linalg.qr(np.hstack([root * exact.eigenvectors, rest]))
    return q[:, K:] / root


def with_vectors(exact, vectors, values=None):
    return Spectrum(exact.eigenvalues if values is None else values, vectors, exact.mass)


def test_a_spectrum_is_at_distance_zero_from_itself_signs_aside(exact):
    signs = np.random.default_rng(2).choice([-1.0, 1.0], K)
    result = compare_spectra(exact, with_vectors(exact, exact.eigenvectors * signs))
    assert result.match.tolist() == list(range(K))
    for errors in (result.vector_error, result.cluster_error, result.span_error):
        np.testing.assert_allclose(errors, 0, atol=1e-14)
    assert np.isnan(result.eigenvalue_error[0])
    assert result.mean_eigenvalue_error == 0
    assert (result.k, result.span_dimension, result.n_zero_modes) == (K, K, 1)
    with pytest.raises(ValueError, match="read-only"):
        result.span_error[0] = 1.0


def test_modes_that_are_not_orthonormal_are_refused(exact):
    """Their length would pass for nearness: noise times 100 had no error at all."""
    for wrong in (np.random.default_rng(8).standard_normal((N, K)), np.full((N, K), np.nan)):
        with pytest.raises(InvalidInputError, match="`eigenvectors` must hold M-orthonormal modes"):
            span_error(exact.eigenvectors, exact.mass, 100 * wrong)
    spectrum = with_vectors(exact, 0.1 * exact.eigenvectors)
    for pair, name in (((exact, spectrum), "predicted"), ((spectrum, exact), "exact")):
        for measure in (compare_spectra, align_modes):
            with pytest.raises(InvalidInputError, match=rf"`{name}` must hold M-orthonormal modes"):
                measure(*pair)
    single = with_vectors(exact, exact.eigenvectors.astype(np.float32))  # is near enough
    assert compare_spectra(exact, single).mean_span_error < 1e-6


def test_a_basis_inside_an_eigenspace_is_arbitrary(exact):
    turn = block_diag(np.eye(3), random_rotation(3, 3), np.eye(K - 6))
    turned = with_vectors(exact, exact.eigenvectors @ turn)
    result = compare_spectra(exact, turned)
    assert (3, 6) in result.clusters
    assert result.vector_error[3:6].mean() > 0.01  # single vectors see it,
    np.testing.assert_allclose(result.cluster_error, 0, atol=1e-14)  # spaces do not
    np.testing.assert_allclose(result.span_error, 0, atol=1e-14)
    np.testing.assert_allclose(align_modes(exact, turned), exact.eigenvectors, atol=1e-13)


@pytest.mark.parametrize("angle", [1e-4, 1.0])
def test_a_known_angle_gives_the_known_errors(exact, outside, angle):
    tilted = np.array(exact.eigenvectors)
    tilted[:, 8] = np.cos(angle) * tilted[:, 8] + np.sin(angle) * outside[:, 0]
    result = compare_spectra(exact, with_vectors(exact, tilted))
    vector, span = 2 - 2 * np.cos(angle), np.sin(angle) ** 2
    found = [result.vector_error[8], result.cluster_error[8], result.span_error[8]]
    assert found == pytest.approx([vector, vector, span], rel=1e-6)
    np.testing.assert_allclose(np.delete(result.vector_error, 8), 0, atol=1e-14)
    assert result.mean_span_error == pytest.approx(span / K, rel=1e-6)
    assert result.mean_vector_error == pytest.approx(vector / K, rel=1e-6)


def test_a_tilted_cluster_has_the_mean_of_its_principal_angles(exact, outside):
    angles = np.array([0.1, 0.2, 0.3])
    cluster = np.cos(angles) * exact.eigenvectors[:, 3:6] + np.sin(angles) * outside[:, :3]
    vectors = np.array(exact.eigenvectors)
    vectors[:, 3:6] = cluster @ random_rotation(3, 4)
    result = compare_spectra(exact, with_vectors(exact, vectors))
    np.testing.assert_allclose(result.cluster_error[3:6], (2 - 2 * np.cos(angles)).mean())


def test_swapped_modes_find_their_partners(exact):
    order = np.array([0, 2, 1, 3, 4, 5, 7, 8, 6, 9, 10, 11])
    result = compare_spectra(exact, with_vectors(exact, exact.eigenvectors[:, order]))
    assert order[result.match].tolist() == list(range(K))
    np.testing.assert_allclose(result.vector_error, 0, atol=1e-14)
    # The eigenvalue goes with its vector.
    assert result.predicted_eigenvalues[1] == exact.eigenvalues[2]
    assert result.eigenvalue_error[1] == pytest.approx(1.0)


def test_spurious_modes(exact, outside):
    """Modes that nothing resembles stay in place; one pushed past k by another is found again."""
    result = compare_spectra(exact, with_vectors(exact, outside))
    assert result.match.tolist() == list(range(K))
    np.testing.assert_allclose(result.vector_error, 2, rtol=1e-12)
    np.testing.assert_allclose(result.span_error, 1, rtol=1e-12)
    vectors = np.insert(exact.eigenvectors, 6, outside[:, 0], axis=1)
    values = np.insert(exact.eigenvalues, 6, 3.5)
    result = compare_spectra(exact, with_vectors(exact, vectors, values))
    assert 6 not in result.match
    np.testing.assert_allclose(result.vector_error, 0, atol=1e-14)
    assert result.span_dimension == K + 1


def test_eigenvalue_error_leaves_out_the_whole_kernel(exact):
    two_pieces = Spectrum(np.array([0.0, 0.0, 1.0, 2.0]), np.eye(4), np.ones(4))
    off = Spectrum(np.array([0.0, 0.0, 1.1, 2.4]), np.eye(4), np.ones(4))
    result = compare_spectra(two_pieces, off)
    assert result.n_zero_modes == 2
    assert result.clusters[0] == (0, 2)
    assert result.mean_eigenvalue_error == pytest.approx((0.1 + 0.2) / 2)
    result = compare_spectra(exact, exact, k=1)  # zero modes only
    assert np.isnan(result.mean_eigenvalue_error)
    assert result.mean_cluster_error == pytest.approx(0, abs=1e-14)  # mode 2 is known to be apart


def test_a_cluster_cut_by_k_is_flagged_and_not_counted(exact):
    """With k = 5 the prediction may return any two of the three equal modes."""
    turn = block_diag(np.eye(3), random_rotation(3, 5), np.eye(K - 6))
    predicted = with_vectors(exact, exact.eigenvectors @ turn).truncate(5)
    result = compare_spectra(exact, predicted)
    assert (result.k, result.open_from) == (5, 3)
    assert result.cluster_error[3:].max() > 1e-3
    assert result.mean_cluster_error == pytest.approx(0, abs=1e-14)
    assert compare_spectra(exact, exact, k=6).open_from == 6
    # Nobody knows what follows the last mode.
    assert compare_spectra(exact, exact).open_from == K - 1
    flat = Spectrum(np.array([1.0, 1.0]), np.eye(2), np.ones(2))
    assert np.isnan(compare_spectra(flat, flat).mean_cluster_error)


def test_cluster_gap_is_a_relative_gap_of_one_per_cent():
    close = Spectrum(np.array([0.0, 1.0, 1.02, 2.0]), np.eye(4), np.ones(4))
    assert (1, 3) in compare_spectra(close, close, cluster_gap=0.03).clusters
    assert (1, 2) in compare_spectra(close, close).clusters
    closer = Spectrum(np.array([0.0, 1.0, 1.009, 2.0]), np.eye(4), np.ones(4))
    assert (1, 3) in compare_spectra(closer, closer).clusters


def test_span_error_takes_any_basis(exact, outside):
    mixed = np.hstack([exact.eigenvectors, outside[:, :3]]) @ random_rotation(K + 3, 6)
    skewed = mixed * np.geomspace(1e-3, 1e3, K + 3)
    np.testing.assert_allclose(span_error(skewed, exact.mass, exact.eigenvectors), 0, atol=1e-12)
    half = span_error(exact.eigenvectors[:, :6], exact.mass, exact.eigenvectors)
    np.testing.assert_allclose(half, np.repeat([0.0, 1.0], 6), atol=1e-14)
    predicted, whole = with_vectors(exact, outside), np.hstack([outside, exact.eigenvectors])
    result = compare_spectra(exact, predicted, basis=whole)
    np.testing.assert_allclose(result.span_error, 0, atol=1e-14)
    assert result.span_dimension == 2 * K


def test_subspace_span_error_adds_up_components():
    laplacian = robust_laplacian(two_parts())
    subspace = AmbientFourier(m=30, bandwidth=3.0)
    exact = eigensolve(laplacian, 12)
    predicted = eigensolve(laplacian, 12, RayleighRitz(subspace=subspace))
    errors, dimension = subspace_span_error(subspace, laplacian, exact, predicted)
    assert dimension <= 2 * 31
    assert errors[:2].max() < 1e-12  # constants on each part
    # By hand, on all points at once: the block-diagonal basis.
    blocks = []
    for label in (0, 1):
        part = laplacian.component_labels == label
        block = np.zeros((laplacian.n, 31))
        block[part, :30] = subspace(laplacian.points[part], laplacian.mass[part])
        block[part, 30] = 1.0
        blocks.append(block)
    expected = span_error(np.hstack(blocks), laplacian.mass, exact.eigenvectors)
    np.testing.assert_allclose(errors, expected, atol=1e-9)
    assert expected.max() > 1e-6


def test_a_component_too_small_to_predict_is_spanned_by_what_was_found():
    lone = TriangleMesh([[5, 0, 0], [6, 0, 0], [5, 1, 0]], [[0, 1, 2]])
    laplacian = robust_laplacian(joined(sphere(subdivisions=3).geometry, lone))
    subspace = AmbientFourier(m=60, bandwidth=3.0)
    predicted = eigensolve(laplacian, 6, RayleighRitz(subspace=subspace))
    errors, _ = subspace_span_error(subspace, laplacian, eigensolve(laplacian, 6), predicted)
    assert errors.max() < 1e-2


def test_columns_of_the_whole_are_compared_part_by_part():
    """Given columns belong to the points: of several components, or beside fixed ones."""
    parts = robust_laplacian(two_parts())
    for laplacian in (parts, parts.dirichlet([3])):
        exact = eigensolve(laplacian, 12)
        columns = exact.eigenvectors[:, :8]
        found = eigensolve(laplacian, 8, RayleighRitz(subspace=GivenBasis(columns)))
        error, dimension = subspace_span_error(GivenBasis(columns), laplacian, exact, found)
        np.testing.assert_allclose(error, np.repeat([0, 1], [8, 4]), atol=1e-9)
        assert dimension == 8


def test_what_is_refused(exact):
    def hashed(text):
        provenance = Provenance(operator=text, input_hash=text)
        return Spectrum(exact.eigenvalues, exact.eigenvectors, exact.mass, None, provenance)

    small = Spectrum(np.zeros(1), np.ones((3, 1)), np.ones(3))
    for call, message in (
        (lambda: compare_spectra(exact, small), "live on the 60 points of `exact`, got 3 points"),
        (lambda: compare_spectra(exact, exact.rescale(2)), "must have the mass of `exact`, got"),
        (lambda: compare_spectra(hashed("a"), hashed("b")), "come from the operator of `exact`"),
        (lambda: compare_spectra(exact, exact, k=13), r"`k` must be in \[1, 12\], got 13"),
        (lambda: compare_spectra(exact, exact, cluster_gap=-1), "`cluster_gap` must be at least 0"),
        (lambda: compare_spectra(exact, exact, basis=np.ones((3, 2))), r"have shape \(60, m\)"),
        (lambda: span_error(np.ones((3, 2)), exact.mass, exact.eigenvectors), "`basis` must have"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            call()


def test_modes_of_a_cohort_are_those_of_the_template():
    ball = sk.geometry.sphere(subdivisions=3).geometry
    template = sk.eigensolve(sk.robust_laplacian(ball), 16)  # whole clusters
    rng = np.random.default_rng(0)
    q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    order = rng.permutation(ball.n)
    place = np.argsort(order)
    subject = sk.TriangleMesh(7 * (ball.points @ q)[order], place[ball.faces])
    for solver in (sk.Lanczos(seed=5), sk.Arpack(seed=2)):
        spectrum = sk.eigensolve(sk.robust_laplacian(subject), 20, solver)
        found = align_to_template(template, spectrum, order)
        assert found.eigenvectors == pytest.approx(template.eigenvectors[order] / 7, abs=1e-6)
        assert found.likeness == pytest.approx(np.ones(16))
    refused("template", "have no more modes", align_to_template, spectrum, template, place)
    refused("point_map", "have shape", align_to_template, template, spectrum, order[:5])


def test_likeness_tells_a_right_map_from_a_wrong_one():
    """Two samplings of one ellipsoid: nearest on the spheres is right, chance and one point not."""
    spheres = [sk.geometry.sphere(subdivisions=k).geometry for k in (3, 4)]
    template, subject = (
        sk.spectrum(sk.TriangleMesh(ball.points * [1.0, 1.3, 1.7], ball.faces), 20)
        for ball in spheres
    )
    template = template.truncate(12)
    right = sk.maps.nearest_rows(spheres[1].points, spheres[0].points)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        aligned = align_to_template(template, subject, right)
    assert aligned.likeness.min() > 0.97
    carried = template.eigenvectors[right]
    correlation = [np.corrcoef(carried[:, i], aligned.eigenvectors[:, i])[0, 1] for i in (1, 5, 9)]
    assert aligned.likeness[[1, 5, 9]] == pytest.approx(correlation, abs=0.01)
    for wrong in (np.random.default_rng(0).integers(0, template.n, subject.n), 0 * right):
        with pytest.warns(DoubtfulMatchWarning, match="11 modes of 12, the first being mode [01],"):
            likeness = align_to_template(template, subject, wrong).likeness
        assert np.sort(likeness)[-2] < 0.1


def test_numbers_of_vertices_are_a_map_where_they_are_shared_alone():
    """The first 642 vertices of a ball are those that it was cut from; shuffled, they are any."""
    coarse, fine = (sk.geometry.sphere(subdivisions=k).geometry for k in (3, 4))
    axes, order = np.array([1.0, 1.3, 1.7]), np.random.default_rng(0).permutation(fine.n)
    subject = sk.spectrum(sk.TriangleMesh(axes * coarse.points, coarse.faces), 12)
    template = sk.spectrum(sk.TriangleMesh(axes * fine.points, fine.faces), 9)
    assert align_to_template(template, subject, range(642)).likeness.min() > 0.97
    shuffled = sk.TriangleMesh(axes * fine.points[order], np.argsort(order)[fine.faces])
    expected = "be the template's point of each point, got range(642), though the template has 2562"
    template = sk.spectrum(shuffled, 9)
    refused("point_map", expected, align_to_template, template, subject, range(642))
