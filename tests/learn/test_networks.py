"""Networks: padding, order, turned tangents and signs of modes change nothing."""

import numpy as np
import pytest
import torch
from conftest import creature
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import spectra_kit as sk
from spectra_kit.errors import InvalidInputError
from spectra_kit.features import Coordinates, HeatKernelSignature
from spectra_kit.geometry import TriangleMesh, torus
from spectra_kit.learn import DiffusionNet, Hierarchical, PointMLP, PointNet, Recipe
from spectra_kit.learn.examples import batched, prepared, stretched
from spectra_kit.learn.networks import _DiffusionBlock

NETWORKS = [
    PointMLP(width=16),
    PointNet(width=8),
    DiffusionNet(width=12, depth=2, dropout=0.0),
    Hierarchical(backbone="pointnet++", width=16),
    Hierarchical(backbone="point-transformer", width=16, features=False),
]
RECIPE = Recipe(embeddings=(HeatKernelSignature(count=5), Coordinates()), k=24)
SEES = frozenset({"spectrum", "slopes"})


@pytest.fixture(scope="module")
def examples():
    return [prepared(RECIPE, mesh, SEES)[0] for mesh in (creature(520), torus(n=400).geometry)]


def module_of(network, inputs=8, outputs=3):
    torch.manual_seed(0)
    return network.build(inputs, outputs).eval()


@pytest.mark.parametrize("network", NETWORKS, ids=str)
@torch.no_grad()
def test_a_shape_in_a_batch_is_answered_as_alone(network, examples):
    module = module_of(network)
    together = module(batched(RECIPE, examples))
    assert together.shape == (2, max(e.n for e in examples), 3)
    for answer, example in zip(together, examples, strict=True):
        alone = module(batched(RECIPE, [example]))[0]
        torch.testing.assert_close(answer[: example.n], alone, atol=2e-5, rtol=1e-4)


@pytest.mark.parametrize("network", NETWORKS, ids=str)
@torch.no_grad()
def test_the_order_of_points_does_not_matter(network):
    mesh, module = creature(520), module_of(network)
    order = np.random.default_rng(0).permutation(mesh.n)
    back = np.argsort(order)
    other = TriangleMesh(mesh.points[order], back[mesh.faces])
    one, two = (module(batched(RECIPE, [prepared(RECIPE, m, SEES)[0]]))[0] for m in (mesh, other))
    torch.testing.assert_close(two, one[torch.from_numpy(order)], atol=2e-3, rtol=2e-3)


@torch.no_grad()
def test_diffusion_net_sees_neither_signs_nor_tangent_frames_nor_mirrors(examples):
    module = module_of(DiffusionNet(width=12, depth=2, dropout=0.0))
    batch = batched(RECIPE, examples[:1])
    answer = module(batch)
    signs = torch.from_numpy(np.random.default_rng(0).choice([-1.0, 1.0], 24)).float()
    flipped = batch._replace(eigenvectors=batch.eigenvectors * signs)
    torch.testing.assert_close(module(flipped), answer, atol=1e-5, rtol=1e-4)
    x, y = (slope.to_dense() for slope in batch.slopes)
    angle = torch.linspace(0, 6, len(x))[:, None]
    turned = (angle.cos() * x + angle.sin() * y, -angle.sin() * x + angle.cos() * y)
    for slopes in (turned, (x, -y)):
        torch.testing.assert_close(
            module(batch._replace(slopes=slopes)), answer, atol=1e-5, rtol=1e-4
        )


@torch.no_grad()
def test_features_spread_as_heat_does():
    mesh = torus(n=300).geometry
    laplacian = sk.delaunay_laplacian(mesh)
    area = laplacian.mass.sum()
    recipe = Recipe(embeddings=(HeatKernelSignature(count=4),), k=mesh.n - 1)
    batch = batched(recipe, [prepared(recipe, mesh, SEES)[0]])
    block = _DiffusionBlock(3, 0.0)
    root = torch.tensor([0.05, 0.1, 0.2])
    block.root_time.copy_(root)
    seen = []
    block.layers.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    x = torch.randn(1, mesh.n, 3, generator=torch.Generator().manual_seed(0))
    block(x, batch)
    matrix = laplacian.stiffness.toarray() / laplacian.mass[:, None] * area
    for i, time in enumerate(root.double() ** 2):
        heat = expm(-float(time) * matrix) @ x[0, :, i].double().numpy()
        # All modes but one; that one has died down.
        np.testing.assert_allclose(seen[0][0, :, 3 + i].numpy(), heat, atol=2e-3)


@torch.no_grad()
def test_diffusion_net_does_not_see_the_unit():
    mesh, module = creature(520), module_of(DiffusionNet(width=12, depth=2, dropout=0.0))
    one, other = (
        module(batched(RECIPE, [prepared(RECIPE, mesh.with_points(s * mesh.points), SEES)[0]]))
        for s in (1.0, 1e3)
    )
    torch.testing.assert_close(other, one, atol=1e-4, rtol=1e-3)


def test_shares_that_are_none():
    for dropout in (-3.0, 1.0, 1.5):
        with pytest.raises(InvalidInputError, match=r"`dropout` must be in \[0, 1\)"):
            DiffusionNet(dropout=dropout)


def test_gradients_reach_all_weights(examples):
    for network in NETWORKS:
        module = module_of(network).train()
        torch.autograd.backward(module(batched(RECIPE, examples)).square().sum())
        assert all(p.grad is not None and p.grad.isfinite().all() for p in module.parameters())


def test_turned_shapes_turn_only_what_is_not_invariant(examples):
    turn = torch.tensor(Rotation.from_euler("x", 1.0).as_matrix(), dtype=torch.float32)
    still, turned = (
        batched(RECIPE, examples[:1], rotations=r).features[0] for r in (None, turn[None])
    )
    torch.testing.assert_close(turned[:, :5], still[:, :5])
    torch.testing.assert_close(
        turned[:, 5:] / turned[:, 5:].norm(), still[:, 5:] @ turn.T / still[:, 5:].norm()
    )


def test_a_stretched_copy_keeps_its_faces_and_is_stretched_by_a_third_at_most():
    mesh = creature(600)
    other = stretched(mesh, np.random.default_rng(0))
    assert np.array_equal(other.faces, mesh.faces)
    matrix = np.linalg.lstsq(mesh.points, other.points, rcond=None)[0]
    singular = np.linalg.svd(matrix, compute_uv=False)
    assert 0.74 < singular.min() < singular.max() < 1.34
