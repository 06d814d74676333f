"""PointNet++ and Point Transformer: neighbours against brute force, and what any network obeys."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from spectra_kit import MissingDependencyError, Neo, eigensolve
from spectra_kit.neo import NeoConfig, NeoNetwork, NeoSubspace, load_pretrained, save_weights
from spectra_kit.neo import backbones as b
from spectra_kit.neo.backbones import build_network
from spectra_kit.neo.loss import span_loss

OTHERS = ["point-transformer", "pointnet++"]
SIZES = NeoConfig(width=40, depth=2, heads=2, head_width=20, latents=8, m=30, k=8, waves=6)


@pytest.fixture(scope="module")
def clouds():
    """Two clouds on different ellipsoids: more points than the finest of the coarse levels."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((2, 500, 3))
    x /= np.linalg.norm(x, axis=2, keepdims=True)
    x *= np.array([[[1, 0.7, 0.5]], [[1, 0.5, 0.4]]])
    mass = rng.uniform(0.2, 2, (2, 500))
    return torch.from_numpy(x).float(), torch.from_numpy(mass).float()


@pytest.fixture(scope="module", params=OTHERS)
def network(request):
    pytest.importorskip("torch_geometric", reason="the optional PyTorch Geometric is missing")
    torch.manual_seed(0)
    return build_network(replace(SIZES, backbone=request.param)).eval()


def distances(x, y):
    return (x.unsqueeze(2) - y.unsqueeze(1)).norm(dim=3)


def test_farthest_points_are_far_apart_and_cover_the_cloud(clouds):
    points, _ = clouds
    centres = b.farthest_points(points, 50)
    apart = distances(centres, centres) + 9 * torch.eye(50)
    reach = distances(points, centres).amin(2)
    assert centres.shape == (2, 50, 3)
    # Each was the farthest when it was chosen: no point is farther from all than two are apart.
    assert (reach.amax(1) <= apart.amin((1, 2)) + 1e-6).all()
    assert (reach == 0).sum(1).tolist() == [50, 50]  # they are points of the cloud


def test_fewer_points_than_centres_are_all_of_them(clouds):
    points = clouds[0][:, :7]
    centres = b.farthest_points(points, 50)
    assert distances(points, centres).amin(2).amax() < 1e-6
    assert centres.shape == (2, 7, 3)


def test_farthest_points_do_not_depend_on_the_order(clouds):
    points, _ = clouds
    order = torch.randperm(500, generator=torch.Generator().manual_seed(1))
    assert torch.equal(b.farthest_points(points[:, order], 60), b.farthest_points(points, 60))


@pytest.mark.parametrize("k", [1, 5, 600])
def test_nearest_agrees_with_all_distances(clouds, k):
    points, _ = clouds
    centres = points[:, :40] + 0.01
    found = b.nearest(points, centres, k)
    k = min(k, 500)
    expected = distances(centres, points).topk(k, largest=False).values
    gaps = points.flatten(0, 1)[found] - centres.flatten(0, 1).unsqueeze(1)
    assert found.shape == (80, k)
    torch.testing.assert_close(gaps.norm(dim=2), expected.flatten(0, 1), atol=1e-5, rtol=1e-4)


def test_balls_agree_with_all_distances(clouds):
    points, _ = clouds
    edges = b.balls(points, points[:, :40], 0.3)
    inside = distances(points[:, :40], points) < 0.3
    found = torch.zeros(80, 1000, dtype=torch.bool)
    found[edges[1], edges[0]] = True
    assert torch.equal(found, torch.block_diag(*inside).bool())


def test_interpolation_is_exact_at_the_centres_and_a_mean_elsewhere(clouds):
    points, _ = clouds
    centres = points[:, :40].contiguous()
    x = torch.randn(80, 5, generator=torch.Generator().manual_seed(2))
    there = b.interpolate(x, centres, centres)
    torch.testing.assert_close(there, x, atol=1e-5, rtol=1e-5)
    spread = b.interpolate(x, centres, points).unflatten(0, (2, 500))
    values = x.unflatten(0, (2, 40))
    assert (spread <= values.amax(1, keepdim=True) + 1e-5).all()
    assert (spread >= values.amin(1, keepdim=True) - 1e-5).all()
    constant = b.interpolate(torch.full((80, 1), 3.0), centres, points)
    torch.testing.assert_close(constant, torch.full((1000, 1), 3.0))


@pytest.mark.parametrize("name", ["small", "paper-base", "paper-deep"])
@pytest.mark.parametrize("backbone", OTHERS)
def test_as_many_parameters_as_the_paper_s_network(name, backbone):
    pytest.importorskip("torch_geometric", reason="the optional PyTorch Geometric is missing")
    config = NeoConfig.named(name)
    with torch.device("meta"):
        ours, theirs = build_network(replace(config, backbone=backbone)), NeoNetwork(config)
    count, expected = (sum(p.numel() for p in n.parameters()) for n in (ours, theirs))
    assert abs(count / expected - 1) < 0.05


@pytest.mark.parametrize(
    ("backbone", "count"), [("pointnet++", 5_193_146), ("point-transformer", 5_244_864)]
)
def test_parameter_counts_of_base(backbone, count):
    pytest.importorskip("torch_geometric", reason="the optional PyTorch Geometric is missing")
    network = build_network(replace(NeoConfig.named("paper-base"), backbone=backbone))
    assert sum(p.numel() for p in network.parameters()) == count


@pytest.mark.parametrize("n", [10, 120, 500])
def test_features_and_outputs_have_their_sizes(network, clouds, n):
    points, mass = (part[:, :n] for part in clouds)
    assert network.features(points, mass).shape == (2, n, 40)
    F = network(points, mass)
    assert F.shape == (2, n, 30)
    assert F.isfinite().all()


@pytest.mark.parametrize(("m", "waves"), [(24, 0), (40, 0), (60, 0), (60, 12)])
def test_every_head_has_full_rank(network, clouds, m, waves):
    torch.manual_seed(0)
    other = build_network(replace(network.config, m=m, waves=waves))
    with torch.no_grad():
        F = other(*clouds)[0].double()
    assert torch.linalg.matrix_rank(F, rtol=1e-6) == m


def test_permuting_points_permutes_outputs(network, clouds):
    points, mass = clouds
    order = torch.randperm(500, generator=torch.Generator().manual_seed(2))
    permuted = network(points[:, order], mass[:, order])
    torch.testing.assert_close(permuted, network(points, mass)[:, order], atol=1e-4, rtol=1e-3)


def test_clouds_of_a_batch_do_not_see_each_other(network, clouds):
    points, mass = clouds
    batch = network(points, mass)
    for i in range(2):
        alone = network(points[i : i + 1], mass[i : i + 1])
        torch.testing.assert_close(batch[i : i + 1], alone, atol=1e-5, rtol=1e-4)


def test_masses_matter_up_to_their_scale(network, clouds):
    points, mass = clouds
    expected = network(points, mass)
    torch.testing.assert_close(network(points, 1e-6 * mass), expected, atol=1e-4, rtol=1e-3)
    assert (network(points, mass.square()) - expected).abs().max() > 1e-3
    blind = build_network(replace(network.config, mass_aware=False))
    assert torch.equal(blind(points, mass), blind(points, torch.ones_like(mass)))


@pytest.mark.parametrize("chunk", [64, 1000])
def test_chunked_evaluation_equals_forward(network, clouds, chunk):
    points, mass = (part[0] for part in clouds)
    expected = network(points[None], mass[None])[0].detach()
    chunked = network.evaluate_chunked(points, mass, chunk=chunk)
    torch.testing.assert_close(chunked, expected, atol=1e-5, rtol=1e-4)
    out = torch.empty(500, 30, dtype=torch.float64)
    assert network.evaluate_chunked(points, mass, chunk=chunk, out=out) is out
    torch.testing.assert_close(out, expected.double(), atol=1e-5, rtol=1e-4)


def test_every_parameter_learns(network, clouds):
    points, mass = clouds
    torch.manual_seed(0)
    fresh = build_network(network.config)
    modes = torch.randn(2, 500, 8, generator=torch.Generator().manual_seed(3))
    span_loss(fresh(points, mass), mass, modes).backward()
    still = [n for n, p in fresh.named_parameters() if p.grad is None or not p.grad.any()]
    assert still == []


def test_weights_come_back_from_a_file(network, clouds, tmp_path):
    path = tmp_path / "weights.safetensors"
    save_weights(path, network, {"steps": 0})
    loaded = load_pretrained(path)
    assert loaded.config == network.config
    assert type(loaded.network) is type(network)
    assert torch.equal(loaded.network(*clouds), network(*clouds))


def test_half_precision_stays_near_float32(network, clouds):
    points, mass = clouds[0][0].double().numpy(), clouds[1][0].double().numpy()
    full, half = (NeoSubspace(network, dtype=d)(points, mass) for d in ("float32", "bfloat16"))
    assert np.abs(half - full).max() < 0.2 * np.abs(full).max()


def test_learns_under_autocast(network, clouds):
    expected = network(*clouds)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        F = network(*clouds)
    assert (F.float() - expected).abs().max() < 0.2 * expected.abs().max()
    gradients = torch.autograd.grad(F.float().square().sum(), list(network.parameters()))
    assert all(gradient.isfinite().all() for gradient in gradients)


# Not trained: what they predict is bad, and said to be.
@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_drops_in_where_a_network_is_asked_for(network, tmp_path, bumpy_laplacian):
    subspace = NeoSubspace(network, poses=2)
    basis = subspace(bumpy_laplacian.points, bumpy_laplacian.mass)
    assert basis.shape == (bumpy_laplacian.n, 61)
    path = tmp_path / "weights.safetensors"
    save_weights(path, network, {})
    exact = eigensolve(bumpy_laplacian, 8)
    spectrum = eigensolve(bumpy_laplacian, 8, Neo(weights=path))
    assert spectrum.certificate.n_zero_modes == 1
    # Ritz values never fall below the exact ones, however untrained the network.
    assert (spectrum.eigenvalues >= exact.eigenvalues - 1e-9 * exact.eigenvalues[-1]).all()
    gaps = np.abs(spectrum.eigenvalues[:, None] - exact.eigenvalues[None]).min(axis=1)
    known = spectrum.eigenvalues < exact.eigenvalues[-1]
    assert (gaps[known] <= spectrum.certificate.residuals[known] + 1e-9).all()


@pytest.mark.parametrize("backbone", OTHERS)
def test_a_missing_package_says_how_to_get_it(backbone, monkeypatch):
    for module in ("torch_geometric", "torch_geometric.nn"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependencyError, match=r"torch_geometric; pip install"):
        build_network(replace(SIZES, backbone=backbone))
