"""Chebyshev filters: the pairs of LAPACK from any start, honest about what was reached."""

import numpy as np
import pytest
import torch
from scipy import linalg, sparse

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere
from spectra_kit.linalg import chebyshev
from spectra_kit.linalg.chebyshev import chebyshev_eigenpairs
from spectra_kit.linalg.filters import shifted, spectral_bound, standard_form
from spectra_kit.linalg.torch_device import sparse_tensor
from spectra_kit.operators import cotan_laplacian, robust_laplacian

DEVICES = ["cpu"] + ["cuda"] * torch.cuda.is_available()


def noise(n, b):
    return torch.randn(n, b, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


@pytest.fixture(scope="module", params=["sphere", "irregular"])
def laplacian(request):
    """Clusters of equal eigenvalues; triangles and masses of very different size."""
    ball = sphere(subdivisions=3).geometry
    if request.param == "sphere":
        return cotan_laplacian(ball)
    return robust_laplacian(
        ball.with_points(ball.points * np.exp(1.5 * ball.points[:, [0]]) * [1, 1, 2])
    )


@pytest.fixture(scope="module")
def exact(laplacian):
    return linalg.eigh(laplacian.stiffness.toarray(), np.diag(laplacian.mass))


def refine(laplacian, start, k, device="cpu", area=1.0, **options):
    """Refine, of the operator in another unit of area."""
    return chebyshev_eigenpairs(
        sparse_tensor(laplacian.stiffness, device),
        torch.tensor(area * laplacian.mass, device=device),
        start.to(device),
        k,
        spacing=laplacian.eigenvalue_spacing / area,
        **{"block": k + max(8, k // 2), "rtol": 1e-8, **options},
    )


def true_residuals(laplacian, values, vectors):
    """In the M^-1 norm, in NumPy."""
    R = laplacian.stiffness @ vectors - laplacian.mass[:, None] * vectors * values
    return np.sqrt((R**2 / laplacian.mass[:, None]).sum(0))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("rtol", [1e-4, 1e-10])
def test_a_random_start_is_driven_to_the_tolerance(laplacian, exact, rtol, device):
    k = 23  # on the sphere this cuts the cluster of l = 4
    pairs = refine(laplacian, noise(laplacian.n, 32), k, rtol=rtol, device=device)
    assert pairs.converged
    assert 0 < pairs.sweeps <= pairs.products
    values, vectors = pairs.eigenvalues.cpu().numpy(), pairs.eigenvectors.cpu().numpy()
    residuals = true_residuals(laplacian, values, vectors)
    spacing = laplacian.eigenvalue_spacing
    assert (residuals <= 1.01 * rtol * np.maximum(values, spacing)).all()
    np.testing.assert_allclose(pairs.residuals.cpu(), residuals, rtol=1e-2, atol=1e-12 * values[-1])
    np.testing.assert_allclose(values, exact[0][:k], rtol=1e-2 * rtol, atol=1e-10 * values[-1])
    gram = vectors.T @ (laplacian.mass[:, None] * vectors)
    np.testing.assert_allclose(gram, np.eye(k), atol=1e-12)


def test_a_better_start_takes_less_work(laplacian, exact, monkeypatch):
    """Random, near, exact but for two of the lowest modes, of low rank, and exact: left as it is.

    And where mass added nearly everywhere makes another operator, whose sweeps gain little.
    """
    modes, random = torch.from_numpy(exact[1]), noise(laplacian.n, 32)
    lacking = modes[:, [j for j in range(34) if j not in (1, 5)]] + 1e-6 * random
    few = modes[:, [0, 1, 2, 2]]
    starts = (random, modes[:, :32] + 1e-3 * random, lacking, few, few, modes[:, :32])
    runs = [refine(laplacian, start, 20) for start in starts]
    runs.append(refine(laplacian, few, 20, seed=1))
    monkeypatch.setattr(chebyshev, "_STIFF", 0.2)
    monkeypatch.setattr(chebyshev, "_FAR", 1.0)
    runs.append(refine(laplacian, random, 20))
    for pairs in runs:
        assert pairs.converged
        np.testing.assert_allclose(pairs.eigenvalues, exact[0][:20], atol=1e-10 * exact[0][20])
    assert runs[1].products < 0.9 * runs[0].products
    assert torch.equal(runs[3].eigenvectors, runs[4].eigenvectors)
    assert runs[5].sweeps == 0
    assert not torch.equal(runs[3].eigenvectors, runs[6].eigenvectors)  # of another seed
    assert runs[7].products > runs[0].products


def test_units_do_not_matter(laplacian):
    start, area = noise(laplacian.n, 24), 1e-12
    here, there = (refine(laplacian, start, 16, rtol=1e-6, area=a) for a in (1.0, area))
    assert there.converged
    assert there.products == pytest.approx(here.products, rel=0.02)
    difference = area * there.eigenvalues - here.eigenvalues
    assert difference.abs().max() < 1e-10 * here.eigenvalues[-1]


def test_what_was_not_reached_is_told(laplacian, exact):
    """Too few sweeps; and a tolerance below rounding, which is given up soon."""
    start = noise(laplacian.n, 32)
    pairs = refine(laplacian, start, 20, max_sweeps=1)
    assert (pairs.converged, pairs.sweeps) == (False, 1)
    residuals = true_residuals(laplacian, pairs.eigenvalues.numpy(), pairs.eigenvectors.numpy())
    np.testing.assert_allclose(pairs.residuals, residuals, rtol=1e-6)
    pairs = refine(laplacian, start, 20, rtol=1e-18, max_sweeps=99)
    assert not pairs.converged
    assert pairs.sweeps < 30
    np.testing.assert_allclose(pairs.eigenvalues, exact[0][:20], atol=1e-10 * exact[0][20])


def test_bad_starts_and_operators_are_refused(laplacian):
    start = noise(laplacian.n, 12)
    start[3, 4] = torch.nan
    with pytest.raises(InvalidInputError, match="1 column with NaN or infinite values of 12"):
        refine(laplacian, start, 8)
    hollow = sparse_tensor(sparse.csr_array([[0.0, 1.0], [1.0, 2.0]]))
    with pytest.raises(InvalidInputError, match="must store all 2 entries of its diagonal, got 1"):
        shifted(hollow, (0.0, 1.0))


def test_the_bound_is_never_below_the_spectrum_and_sharp_on_laplacians(laplacian):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 60))
        A = sparse.random_array((n, n), density=0.2, rng=rng, data_sampler=rng.standard_normal)
        A = sparse.csr_array((A + A.T) * 10.0 ** rng.integers(-8, 8))
        assert np.linalg.eigvalsh(A.toarray())[-1] <= spectral_bound(sparse_tensor(A))
    root = torch.tensor(laplacian.mass).sqrt()
    operator = standard_form(sparse_tensor(laplacian.stiffness), root)
    top = np.linalg.eigvalsh(operator.to_dense().numpy())[-1]
    assert top <= spectral_bound(operator) < 1.5 * top
