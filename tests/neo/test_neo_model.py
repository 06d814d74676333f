"""The networks: their sizes, and the laws that their architecture promises."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from conftest import refused

from spectra_kit.errors import InvalidInputError
from spectra_kit.neo import NeoConfig, NeoNetwork, NeoSubspace, build_network
from spectra_kit.neo.backbones import BACKBONES
from spectra_kit.neo.loss import mode_residuals

TINY = NeoConfig(width=48, depth=2, heads=2, head_width=16, latents=10, m=24, k=8)
NAMES = ["small", "base", "paper-base", "paper-deep", "paper-large"]


def random_network(config, seed=0):
    if config.backbone != "neo":
        pytest.importorskip("torch_geometric", reason="the optional PyTorch Geometric is missing")
    torch.manual_seed(seed)
    return build_network(config).eval().requires_grad_(False)


@pytest.fixture(scope="module")
def network():
    network = random_network(TINY)
    for block in network.blocks:  # sharper attention than at the start of a training
        block.down.norm_q.weight.fill_(4.0)
    return network


@pytest.fixture(scope="module")
def cloud():
    generator = torch.Generator().manual_seed(1)
    points = 2 * torch.rand(1, 200, 3, generator=generator) - 1
    return points, 0.01 + torch.rand(1, 200, generator=generator)


@pytest.fixture(scope="module")
def clouds():
    """Two clouds on different ellipsoids: more points than the finest of any coarse levels."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((2, 450, 3))
    x /= np.linalg.norm(x, axis=2, keepdims=True)
    x *= np.array([[[1, 0.7, 0.5]], [[1, 0.5, 0.4]]])
    mass = rng.uniform(0.2, 2, (2, 450))
    return torch.from_numpy(x).float(), torch.from_numpy(mass).float()


def size(network):
    return sum(parameter.numel() for parameter in network.parameters())


def test_parameter_counts():
    counts = [2_552_512, 5_378_176, 5_365_632, 10_702_848, 16_929_376]
    with torch.device("meta"):
        assert [size(NeoNetwork(NeoConfig.named(name))) for name in NAMES] == counts


# What holds of every backbone


@pytest.fixture(scope="module", params=sorted(BACKBONES))
def any_network(request):
    return random_network(replace(TINY, width=40, m=30, waves=6, backbone=request.param))


def assert_near(one, other, **tolerance):
    torch.testing.assert_close(one, other, **{"atol": 1e-5, "rtol": 1e-4} | tolerance)


@pytest.fixture(scope="module")
def expected(any_network, clouds):
    return any_network(*clouds)


def test_permuting_points_permutes_outputs_however_few(any_network, clouds, expected):
    points, mass = clouds
    assert any_network(points[:, :10], mass[:, :10]).isfinite().all()
    assert expected.shape == (2, 450, 30)
    order = torch.randperm(450, generator=torch.Generator().manual_seed(2))
    permuted = any_network(points[:, order], mass[:, order])
    assert_near(permuted, expected[:, order], atol=1e-4, rtol=1e-3)


def test_clouds_of_a_batch_do_not_see_each_other_nor_the_scale_of_masses(
    any_network, clouds, expected
):
    points, mass = clouds
    scales = torch.tensor([[1e-12], [1e9]])
    assert_near(any_network(points, scales * mass), expected, atol=1e-4, rtol=1e-3)
    assert_near(any_network(points[1:], mass[1:]), expected[1:])
    assert (any_network(points, mass.square()) - expected).abs().max() > 1e-3
    blind = random_network(replace(any_network.config, mass_aware=False))
    assert torch.equal(blind(points, mass), blind(points, torch.ones_like(mass)))


def test_chunked_evaluation_equals_forward(any_network, clouds, expected):
    points, mass = (part[0] for part in clouds)
    assert_near(any_network.evaluate_chunked(points, mass, chunk=64), expected[0])
    out = torch.empty(450, 30, dtype=torch.float64)
    assert any_network.evaluate_chunked(points, mass, chunk=1000, out=out) is out
    assert_near(out, expected[0].double())


def test_every_parameter_learns_under_autocast_too(any_network, clouds, expected):
    points, mass = clouds
    fresh = random_network(any_network.config).train().requires_grad_(True)
    modes = torch.randn(2, 450, 8, generator=torch.Generator().manual_seed(3))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        out = fresh(points, mass)
    assert (out.float() - expected).abs().max() < 0.2 * expected.abs().max()
    mode_residuals(out, mass, modes).mean().backward()
    assert [n for n, p in fresh.named_parameters() if p.grad is None or not p.grad.any()] == []
    assert all(p.grad.isfinite().all() for p in fresh.parameters())
    points, mass = points[0].double().numpy(), mass[0].double().numpy()
    full, half = (NeoSubspace(any_network, dtype=d)(points, mass) for d in ("float32", "bfloat16"))
    assert np.abs(half - full).max() < 0.2 * np.abs(full).max()


@pytest.mark.parametrize(("m", "waves"), [(24, 0), (40, 0), (60, 0), (60, 12)])
def test_every_head_has_full_rank(clouds, m, waves):
    out = random_network(replace(TINY, width=40, m=m, waves=waves))(*clouds)[0].double()
    assert torch.linalg.matrix_rank(out, rtol=1e-6) == m


# What holds of the paper's


def test_splitting_points_with_their_mass_is_a_true_quadrature(network, cloud):
    points, mass = cloud
    share = torch.tensor([0.3])
    split = torch.cat([mass[:, :60] * share, mass[:, 60:], mass[:, :60] * (1 - share)], dim=1)
    doubled = network(torch.cat([points, points[:, :60]], dim=1), split)
    expected = network(points, mass)
    assert_near(doubled[:, :200], expected)
    assert_near(doubled[:, 200:], expected[:, :60])


@pytest.mark.parametrize(("dtype", "error"), [(torch.float16, 0.02), (torch.bfloat16, 0.15)])
def test_sharp_attention_in_half_precision_and_chunks_stays_near_float32(
    network, cloud, dtype, error
):
    points, mass = cloud
    half, expected = copy.deepcopy(network).to(dtype), network(points, mass)[0]
    assert_near(network.evaluate_chunked(points[0], mass[0], chunk=7), expected)
    for out in (half(points, mass)[0], half.evaluate_chunked(points[0], mass[0], chunk=64)):
        assert out.dtype == dtype
        assert (out.float() - expected).abs().max() < error * expected.abs().max()
    tiny = torch.where(torch.arange(200) < 5, 1e-30, mass)
    assert half(points, tiny).isfinite().all()


# Plane waves


@pytest.fixture(scope="module")
def waves():
    return random_network(replace(TINY, waves=8))


def test_a_gate_turns_and_scales_its_wave(waves, cloud):
    points, mass = cloud
    out = waves(points, mass)
    gates = waves.head.gates(waves.head.norm(waves.features(points, mass)))
    gain, turn = 1 + gates[..., :8], gates[..., 8:]
    # As complex numbers, cos + i sin = exp(i angle): the output is that times (gain + i turn).
    expected = torch.complex(gain, turn) * torch.exp(1j * (points @ waves.head.frequencies.T))
    assert torch.allclose(out[..., 8:16], expected.real, atol=1e-5)
    assert torch.allclose(out[..., 16:], expected.imag, atol=1e-5)
    flat = copy.deepcopy(waves)
    for parameter in flat.head.gates.parameters():
        torch.nn.init.zeros_(parameter)
    with torch.autocast("cpu", dtype=torch.bfloat16):  # which does not round the phases
        rounded = flat(points, mass)[..., 8:16].float()
    # Half a unit in the last place of bfloat16, of values up to one.
    assert (rounded - (points @ waves.head.frequencies.T).cos()).abs().max() < 0.004


def test_frequencies_are_exact_in_half_precision_and_the_same_for_all_seeds(waves):
    frequencies = waves.head.frequencies
    assert torch.equal(random_network(waves.config, seed=1).head.frequencies, frequencies)
    assert torch.equal(frequencies.half().float(), frequencies)
    assert torch.equal(frequencies.bfloat16().float(), frequencies)


# Configurations


def test_sizes_and_options_are_checked():
    for argument, expected, changes in (
        ("frame", "be 'principal' or 'none'", {"frame": "up"}),
        ("waves", "be in [0, m / 2), got 12", {"waves": 12}),
        ("waves", "be in", {"waves": -1}),
        ("bandwidth", "be positive", {"bandwidth": 0.0}),
        ("backbone", "be 'neo', 'pointnet++' or 'point-transformer'", {"backbone": "mlp"}),
    ):
        refused(argument, expected, replace, TINY, **changes)
    refused("name", "be one of", NeoConfig.named, "huge")
    for changes in ({"depth": 0}, {"m": 8, "k": 9}):
        with pytest.raises(InvalidInputError, match="must be positive with m >= k"):
            replace(TINY, **changes)
