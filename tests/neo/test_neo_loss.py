"""The losses: equal to their slow forms, before smoothing and after, blind to what they must be."""

from functools import cache

import numpy as np
import pytest
import torch
from conftest import bumpy
from scipy.linalg import eigh

from spectra_kit import delaunay_laplacian, eigensolve
from spectra_kit.eigen.multigrid import smoothed
from spectra_kit.neo import NeoConfig, NeoNetwork
from spectra_kit.neo import loss as losses
from spectra_kit.neo.loss import Smoother, mode_residuals, ortho_loss, smoothed_residuals


def span_loss(F, mass, U):
    return mode_residuals(F, mass, U).mean()


def span_loss_qr(F, mass, U):
    """The paper's route, a weighted QR."""
    root = mass.sqrt().unsqueeze(-1)
    Q, _ = torch.linalg.qr(root * F)
    V = torch.nn.functional.normalize(root * U, dim=-2)
    return 1 - (Q.mT @ V).square().sum(-2).mean()


@pytest.fixture
def case():
    """Functions F that cover modes U in part, of any size, on uneven masses, in float64."""
    generator = torch.Generator().manual_seed(0)
    mass = 100 * (0.1 + torch.rand(2, 90, generator=generator, dtype=torch.float64))
    F = torch.randn(2, 90, 12, generator=generator, dtype=torch.float64)
    U = F[..., :6] + 0.5 * torch.randn(2, 90, 6, generator=generator, dtype=torch.float64)
    return F * torch.logspace(-3, 3, 12).double(), mass, U * torch.logspace(1, -2, 6).double()


def test_value_and_gradient_equal_the_qr_form(case, monkeypatch):
    F, mass, U = case
    F = F.requires_grad_()
    with_ridge, truth = span_loss(F, mass, U), span_loss_qr(F, mass, U)
    assert with_ridge.item() == pytest.approx(truth.item(), abs=1e-5)
    monkeypatch.setattr(losses, "_RIDGE", 0.0)
    loss = span_loss(F, mass, U)
    torch.testing.assert_close(loss.double(), truth, rtol=1e-5, atol=0)
    one, other = (torch.autograd.grad(value, F)[0] for value in (loss, truth))
    torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-7)


def test_known_values():
    axes = torch.eye(4)[None]
    residuals = mode_residuals(axes[..., :2], torch.ones(1, 4), axes[..., 1:3])
    torch.testing.assert_close(residuals, torch.tensor([[0.0, 1.0]]), atol=1e-5, rtol=0)
    half = torch.tensor([[[1.0], [1.0], [0.0], [0.0]]])  # half the energy of the first axis
    assert span_loss(half, torch.ones(1, 4), axes[..., :1]).item() == pytest.approx(0.5, abs=1e-5)
    heavy = torch.tensor([[3.0, 1.0, 1.0, 1.0]])  # three quarters of its energy, by mass
    assert span_loss(half, heavy, axes[..., :1]).item() == pytest.approx(0.25, abs=1e-5)


def test_rank_deficient_functions_have_a_finite_loss_and_gradient(case):
    F, mass, U = case
    F = torch.cat([F[..., :6], F[..., :6]], dim=-1).requires_grad_()
    loss = span_loss(F, mass, U)
    loss.backward()
    assert loss.item() == pytest.approx(span_loss_qr(F[..., :6], mass, U).item(), abs=1e-4)
    assert F.grad.isfinite().all()


def test_functions_that_are_not_finite_spoil_their_own_cloud_alone(case):
    F, mass, U = case
    spoilt = torch.cat([F, F[:1]])
    spoilt[2, 5, 3] = torch.inf
    residuals = mode_residuals(spoilt, mass[[0, 1, 0]], U[[0, 1, 0]])
    assert torch.equal(residuals[:2], mode_residuals(F, mass, U))
    assert residuals[2].isnan().all()


def test_ortho_loss_vanishes_on_orthonormal_functions_alone(case):
    F, mass, _ = case
    weights = (mass / mass.sum(-1, keepdim=True)).unsqueeze(-1)
    Y = torch.linalg.qr(weights.sqrt() * F)[0] / weights.sqrt()
    assert ortho_loss(Y, 7 * mass).item() < 1e-12
    assert ortho_loss(2 * Y, mass).item() == pytest.approx(9 / 12, rel=1e-5)


# After smoothing

K = 12


@cache
def surface(n):
    """L and M of a surface of area one, with its lowest modes, padded with points to n."""
    laplacian = delaunay_laplacian(bumpy())
    L, mass = laplacian.stiffness, laplacian.mass / laplacian.area
    values, modes = eigh(L.toarray(), np.diag(mass), subset_by_index=(0, K - 1))
    L = L.copy()
    L.resize(n, n)
    rest = n - len(mass)
    return L, np.pad(mass, (0, rest)), values, np.pad(modes, ((0, rest), (0, 0)))


def smoother(n=642, *, degree=4, dtype=torch.float64, count=1):
    parts = zip(*count * [surface(n)], strict=True)
    L, mass, values, modes = map(list, parts)
    given = (np.stack(part) for part in (mass, values, modes))
    return Smoother.of(L, *given, degree=degree, dtype=dtype)


def errors(n=642, count=1):
    return torch.randn(count, n, K, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_it_is_a_polynomial_in_the_dense_operator_of_each_mode():
    L, mass, values, _ = surface(642)
    ours, e = smoother(), errors()
    D = ours.diagonal[0, :, 0].numpy()
    steps = [(float(keep), float(step)) for keep, step in ours.steps]
    for j in (0, 1, K // 2, K - 1):
        # D^-1 (L - lambda M) is similar to a symmetric matrix, whose polynomials are those of
        # its eigenvalues.
        w, V = np.linalg.eigh((L.toarray() - values[j] * np.diag(mass)) / np.sqrt(np.outer(D, D)))
        p = before = np.ones_like(w)
        for keep, step in steps:
            p, before = p + keep * (p - before) - step * w * p, p
        expected = V @ (p * (V.T @ (np.sqrt(D) * e[0, :, j].numpy()))) / np.sqrt(D)
        np.testing.assert_allclose(ours(e)[0, :, j], expected, atol=1e-10)
        assert p[np.abs(w).argmin()] == pytest.approx(1, abs=1e-6)  # of the mode itself
        assert np.abs(p[w > 0.5 * w.max()]).max() < 0.2


def test_gradients_are_right_also_beside_padding():
    e = errors(660, count=2)[:, :, :3].requires_grad_()
    L, mass, values, modes = surface(660)
    given = (np.stack([part, part]) for part in (mass, values[:3], modes[:, :3]))
    ours = Smoother.of([L, L], *given, degree=3, dtype=torch.float64)
    weights = errors(660, count=2)[:, :, 3:6]
    (gradient,) = torch.autograd.grad((weights * ours(e)).sum(), e)
    for direction in (errors(660, count=2)[:, :, 6:9], torch.ones_like(e)):
        change = (weights * (ours(e + direction) - ours(e))).sum()  # it is linear
        assert change.item() == pytest.approx((gradient * direction).sum().item(), rel=1e-9)


def test_gradients_of_the_loss_are_those_of_finite_differences():
    _, mass, _, modes = surface(642)
    ours = smoother()
    generator = torch.Generator().manual_seed(1)
    rest = torch.randn(1, 642, 8, generator=generator, dtype=torch.float64)
    F = torch.from_numpy(modes)[None] + 0.3 * torch.randn(
        1, 642, K, generator=generator, dtype=torch.float64
    )
    F = torch.cat([F, rest], -1).float().requires_grad_()
    w, U = torch.from_numpy(mass)[None], torch.from_numpy(modes)[None]

    def loss(functions):
        return smoothed_residuals(functions, w, U, ours)[1].double().sum()

    (gradient,) = torch.autograd.grad(loss(F), F)
    direction = torch.randn(F.shape, generator=generator)
    step = 3e-3
    change = (loss(F + step * direction) - loss(F - step * direction)) / (2 * step)
    assert change.item() == pytest.approx((gradient * direction).sum().item(), rel=2e-2)


def test_exact_modes_stay_and_rough_errors_go():
    _, mass, _, modes = surface(642)
    w, U = torch.from_numpy(mass)[None], torch.from_numpy(modes)[None]
    ours = smoother(dtype=torch.float32)
    before, after = smoothed_residuals(U, w, U, ours)
    assert max(before.max(), after.max()) < 1e-5
    noise = torch.randn(1, 642, K, generator=torch.Generator().manual_seed(2))
    before, after = smoothed_residuals(U + 0.3 * noise, w, U, ours)
    torch.testing.assert_close(before, mode_residuals(U + 0.3 * noise, w, U))
    assert after.mean() < 0.1 * before.mean()
    # What is missing altogether comes back by no smoothing.
    before, after = smoothed_residuals(U[..., 1:], w, U, ours)
    assert before[0, 0] > 0.99
    assert after[0, 0] > 0.9


def test_it_smooths_as_inference_does():
    laplacian = delaunay_laplacian(bumpy())
    exact = eigensolve(laplacian, K)
    rng = np.random.default_rng(3)
    noisy = exact.eigenvectors + 0.1 * rng.standard_normal((642, K)) * exact.eigenvectors.std()
    area = laplacian.area
    given = (laplacian.mass / area, exact.eigenvalues * area, exact.eigenvectors)
    ours = Smoother.of([laplacian.stiffness], *(a[None] for a in given), degree=6)
    e = torch.from_numpy(noisy - exact.eigenvectors).float()[None]
    theirs = smoothed(laplacian, exact.eigenvalues, noisy) - exact.eigenvectors
    # They take the values of the noisy columns for where to damp, and one more column.
    size = np.linalg.norm(e.numpy()[0])
    assert np.linalg.norm(ours(e)[0].numpy() - theirs) < 0.1 * size
    assert np.linalg.norm(theirs) < 0.5 * size


@pytest.mark.parametrize("waves", [0, 4])
def test_padding_changes_neither_prediction_nor_loss_nor_gradient(waves):
    torch.manual_seed(0)
    network = NeoNetwork(
        NeoConfig(width=36, depth=2, heads=2, head_width=18, latents=6, m=40, k=K, waves=waves)
    )
    points = delaunay_laplacian(bumpy()).points
    points = (points - points.mean(0)) / 3
    found = []
    for (L, mass, values, modes), n in ((surface(642), 642), (surface(700), 700)):
        x = torch.from_numpy(np.pad(points, ((0, n - 642), (0, 0)), mode="edge")).float()[None]
        w, U = torch.from_numpy(mass).float()[None], torch.from_numpy(modes).float()[None]
        ours = Smoother.of([L], mass[None], values[None], modes[None], degree=4)
        F = network(x, w)
        before, after = smoothed_residuals(F, w, U, ours)
        gradients = torch.autograd.grad(before.sum() + after.sum(), list(network.parameters()))
        found.append((F[:, :642], before, after, *gradients))
    for plain, beside in zip(*found, strict=True):
        assert beside.isfinite().all()
        torch.testing.assert_close(plain, beside, rtol=1e-3, atol=1e-4 * plain.abs().max().item())
