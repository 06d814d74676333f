"""The span loss: equal to its slow form, blind to what it must not see."""

import pytest
import torch

from spectra_kit.neo.loss import mode_residuals, ortho_loss, span_loss


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


def test_value_and_gradient_equal_the_qr_form(case):
    F, mass, U = case
    F = F.requires_grad_()
    losses = span_loss(F, mass, U, ridge=0.0), span_loss_qr(F, mass, U)
    torch.testing.assert_close(losses[0].double(), losses[1], rtol=1e-5, atol=0)
    one, other = (torch.autograd.grad(loss, F)[0] for loss in losses)
    torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-7)
    assert span_loss(F, mass, U).item() == pytest.approx(losses[1].item(), abs=1e-5)  # the ridge


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
