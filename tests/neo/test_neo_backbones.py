"""PointNet++ and Point Transformer: neighbours against brute force, sizes, and use."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from spectra_kit import Neo, eigensolve
from spectra_kit.errors import MissingDependencyError
from spectra_kit.neo import (
    NeoConfig,
    NeoNetwork,
    NeoSubspace,
    build_network,
    load_pretrained,
    save_weights,
)
from spectra_kit.neo import backbones as b

OTHERS = ["point-transformer", "pointnet++"]
SIZES = NeoConfig(width=40, depth=2, heads=2, head_width=20, latents=8, m=30, k=8, waves=6)


@pytest.fixture(scope="module")
def points():
    """Two clouds on different ellipsoids."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((2, 500, 3))
    x /= np.linalg.norm(x, axis=2, keepdims=True)
    return torch.from_numpy(x * np.array([[[1, 0.7, 0.5]], [[1, 0.5, 0.4]]])).float()


def distances(x, y):
    return (x.unsqueeze(2) - y.unsqueeze(1)).norm(dim=3)


def test_farthest_points_are_far_apart_and_cover_the_cloud(points):
    centres = b.farthest_points(points, 50)
    apart = distances(centres, centres) + 9 * torch.eye(50)
    reach = distances(points, centres).amin(2)
    assert centres.shape == (2, 50, 3)
    # Each was the farthest when it was chosen: no point is farther from all than two are apart.
    assert (reach.amax(1) <= apart.amin((1, 2)) + 1e-6).all()
    assert (reach == 0).sum(1).tolist() == [50, 50]  # they are points of the cloud
    order = torch.randperm(500, generator=torch.Generator().manual_seed(1))
    assert torch.equal(b.farthest_points(points[:, order], 50), centres)
    few = b.farthest_points(points[:, :7], 50)  # all there are
    assert few.shape == (2, 7, 3)
    assert distances(points[:, :7], few).amin(2).amax() < 1e-6


def test_neighbours_agree_with_all_distances(points):
    centres = points[:, :40] + 0.01
    expected = distances(centres, points)
    for k in (5, 600):
        found = b.nearest(points, centres, k)
        gaps = points.flatten(0, 1)[found] - centres.flatten(0, 1).unsqueeze(1)
        nearest = expected.topk(min(k, 500), largest=False).values.flatten(0, 1)
        torch.testing.assert_close(gaps.norm(dim=2), nearest, atol=1e-5, rtol=1e-4)
    edges = b.balls(points, centres, 0.3)
    inside = torch.zeros(80, 1000, dtype=torch.bool)
    inside[edges[1], edges[0]] = True
    assert torch.equal(inside, torch.block_diag(*(expected < 0.3)).bool())


def test_interpolation_is_exact_at_the_centres_and_a_mean_elsewhere(points):
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


@pytest.mark.parametrize(
    ("backbone", "count"), [("pointnet++", 5_193_146), ("point-transformer", 5_244_864)]
)
def test_as_many_parameters_as_the_paper_s_network(backbone, count):
    pytest.importorskip("torch_geometric", reason="the optional PyTorch Geometric is missing")

    def size(network):
        return sum(p.numel() for p in network.parameters())

    with torch.device("meta"):
        for name in ("small", "paper-base", "paper-deep"):
            config = NeoConfig.named(name)
            other = size(build_network(replace(config, backbone=backbone)))
            assert abs(other / size(NeoNetwork(config)) - 1) < 0.05
            assert name != "paper-base" or other == count


# Not trained: what they predict is bad, and said to be.
@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
@pytest.mark.parametrize("backbone", OTHERS)
def test_drops_in_where_a_network_is_asked_for(backbone, tmp_path, bumpy_laplacian):
    pytest.importorskip("torch_geometric", reason="the optional PyTorch Geometric is missing")
    torch.manual_seed(0)
    network, path = build_network(replace(SIZES, backbone=backbone)), tmp_path / "w.safetensors"
    save_weights(path, network, {"steps": 0})
    loaded = load_pretrained(path)
    assert (loaded.config, type(loaded.network)) == (network.config, type(network))
    ours, theirs = (
        NeoSubspace(one, poses=2)(bumpy_laplacian.points, bumpy_laplacian.mass)
        for one in (network, loaded.network)
    )
    assert ours.shape == (bumpy_laplacian.n, 61)
    np.testing.assert_array_equal(ours, theirs)
    exact = eigensolve(bumpy_laplacian, 8)
    spectrum = eigensolve(bumpy_laplacian, 8, Neo(weights=path))
    assert spectrum.certificate.n_zero_modes == 1
    # Ritz values never fall below the exact ones, however untrained the network.
    assert (spectrum.eigenvalues >= exact.eigenvalues - 1e-9 * exact.eigenvalues[-1]).all()
    gaps = np.abs(spectrum.eigenvalues[:, None] - exact.eigenvalues[None]).min(axis=1)
    known = spectrum.eigenvalues < exact.eigenvalues[-1]
    assert (gaps[known] <= spectrum.certificate.residuals[known] + 1e-9).all()


def test_a_missing_package_says_how_to_get_it(monkeypatch):
    for module in ("torch_geometric", "torch_geometric.nn"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependencyError, match=r"needs torch_geometric; pip install"):
        build_network(replace(SIZES, backbone="pointnet++"))
