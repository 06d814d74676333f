"""The network: its size, and the laws that its architecture promises."""

import copy
import math
from dataclasses import replace

import pytest
import torch
from torch.nn import functional as F

from spectra_kit.errors import InvalidInputError
from spectra_kit.neo import NeoConfig, NeoNetwork, build_network
from spectra_kit.neo.model import encode

TINY = NeoConfig(width=48, depth=2, heads=2, head_width=16, latents=10, m=24, k=8)


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    network = NeoNetwork(TINY).eval().requires_grad_(False)
    for block in network.blocks:  # sharper attention than at the start of a training
        block.down.norm_q.weight.fill_(4.0)
    return network


@pytest.fixture(scope="module")
def cloud():
    generator = torch.Generator().manual_seed(1)
    points = 2 * torch.rand(1, 200, 3, generator=generator) - 1
    return points, 0.01 + torch.rand(1, 200, generator=generator)


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("small", 2_552_512),
        ("base", 5_378_176),
        ("paper-base", 5_365_632),
        ("paper-deep", 10_702_848),
        ("paper-large", 16_929_376),
    ],
)
def test_parameter_counts(name, count):
    with torch.device("meta"):
        network = NeoNetwork(NeoConfig.named(name))
    assert sum(parameter.numel() for parameter in network.parameters()) == count


def test_encoding_holds_coordinates_and_48_waves_each():
    points = torch.tensor([[0.5, -1.0, 0.25]])
    encoded = encode(points)[0]
    assert encoded.shape == (147,)
    torch.testing.assert_close(encoded[:3], points[0])
    lowest = math.pi * 2.0**-2 * points[0]
    torch.testing.assert_close(encoded[3:75:24], lowest.sin())
    torch.testing.assert_close(encoded[75::24], lowest.cos())
    highest = math.pi * 2.0**6 * points[0]
    torch.testing.assert_close(encoded[26:75:24], highest.sin(), atol=1e-4, rtol=0)


def test_encoding_is_float32_whatever_comes_in():
    assert encode(torch.zeros(2, 3, dtype=torch.float16)).dtype == torch.float32


def test_log_mass_channel_equals_an_additive_mask(network, cloud):
    points, mass = cloud
    down, x = network.blocks[0].down, network.lift(encode(points))
    log_mass = (mass / mass.mean()).log()
    k, v = down.norm_k(down.split(down.key(x))), down.split(down.value(x))
    q = down.norm_q(down.queries)[None]
    masked = F.scaled_dot_product_attention(q, k, v, attn_mask=log_mass[:, None, None, :])
    torch.testing.assert_close(down(x, log_mass), down.out(down.merge(masked)))


def test_scale_of_masses_does_not_matter(network, cloud):
    points, mass = cloud
    for size in (1e-12, 1e9):
        torch.testing.assert_close(network(points, size * mass), network(points, mass))


def test_mass_does_matter(network, cloud):
    points, mass = cloud
    difference = network(points, mass.square()) - network(points, mass)
    assert difference.abs().max() > 1e-3  # a hundred times what the laws below allow


def test_permuting_points_permutes_outputs(network, cloud):
    points, mass = cloud
    order = torch.randperm(200, generator=torch.Generator().manual_seed(2))
    torch.testing.assert_close(
        network(points[:, order], mass[:, order]),
        network(points, mass)[:, order],
        atol=1e-5,
        rtol=1e-4,
    )


def test_splitting_points_with_their_mass_is_a_true_quadrature(network, cloud):
    points, mass = cloud
    share = torch.tensor([0.3])
    split = torch.cat([mass[:, :60] * share, mass[:, 60:], mass[:, :60] * (1 - share)], dim=1)
    doubled = network(torch.cat([points, points[:, :60]], dim=1), split)
    expected = network(points, mass)
    torch.testing.assert_close(doubled[:, :200], expected, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(doubled[:, 200:], expected[:, :60], atol=1e-5, rtol=1e-4)


def test_clouds_of_a_batch_do_not_see_each_other(network, cloud):
    points, mass = cloud
    batch = network(torch.cat([points, -points]), torch.cat([mass, mass.flip(1)]))
    torch.testing.assert_close(batch[:1], network(points, mass), atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("m", [24, 32, 60])
def test_outputs_have_full_rank_for_any_m(cloud, m):
    torch.manual_seed(0)
    network = NeoNetwork(NeoConfig(width=32, depth=1, heads=2, head_width=16, latents=4, m=m, k=8))
    with torch.no_grad():
        F = network(*cloud)[0].double()
    assert F.shape == (200, m)
    assert torch.linalg.matrix_rank(F, rtol=1e-4) == m
    chunked = network.evaluate_chunked(cloud[0][0], cloud[1][0], chunk=90)
    torch.testing.assert_close(chunked.double(), F, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("chunk", [7, 64, 200, 1000])
def test_chunked_evaluation_equals_forward(network, cloud, chunk):
    points, mass = cloud
    chunked = network.evaluate_chunked(points[0], mass[0], chunk=chunk)
    torch.testing.assert_close(chunked, network(points, mass)[0], atol=1e-5, rtol=1e-4)


def test_chunked_evaluation_without_head_and_into_given_memory(cloud):
    torch.manual_seed(0)
    network = NeoNetwork(NeoConfig(width=32, depth=1, heads=1, head_width=16, latents=4, m=32, k=8))
    points, mass = cloud
    out = torch.empty(200, 32, dtype=torch.float64)
    assert network.evaluate_chunked(points[0], mass[0], chunk=90, out=out) is out
    expected = network(points, mass)[0].detach().double()
    torch.testing.assert_close(out, expected, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize(("dtype", "error"), [(torch.float16, 0.02), (torch.bfloat16, 0.15)])
def test_half_precision_stays_near_float32(network, cloud, dtype, error):
    points, mass = cloud
    half = copy.deepcopy(network).to(dtype)
    expected = network(points, mass)[0]
    for out in (half(points, mass)[0], half.evaluate_chunked(points[0], mass[0], chunk=64)):
        assert out.dtype == dtype
        assert (out.float() - expected).abs().max() < error * expected.abs().max()


def test_tiny_masses_survive_float16(network, cloud):
    points, mass = cloud
    mass = mass.clone()
    mass[0, :5] = 1e-30
    assert copy.deepcopy(network).half()(points, mass).isfinite().all()


def test_sizes_and_names_are_checked():
    with pytest.raises(InvalidInputError, match="must be positive with m >= k"):
        NeoConfig(width=8, depth=0, heads=1, head_width=8, latents=4, m=8, k=4)
    with pytest.raises(InvalidInputError, match="must be positive with m >= k"):
        NeoConfig(width=8, depth=1, heads=1, head_width=8, latents=4, m=8, k=9)
    with pytest.raises(InvalidInputError, match="`frame` must be 'principal' or 'none'"):
        NeoConfig(width=8, depth=1, heads=1, head_width=8, latents=4, m=8, k=4, frame="up")
    with pytest.raises(InvalidInputError, match="`name` must be one of"):
        NeoConfig.named("huge")


@pytest.fixture(scope="module")
def waves():
    torch.manual_seed(0)
    return NeoNetwork(replace(TINY, m=24, waves=8)).eval()


def test_waves_without_gates_are_the_plane_waves(waves, cloud):
    points, mass = cloud
    flat = NeoNetwork(waves.config)
    for parameter in [*flat.head.free.parameters(), *flat.head.gates.parameters()]:
        torch.nn.init.zeros_(parameter)
    frequencies = flat.head.frequencies
    assert abs(frequencies.std().item() / waves.config.bandwidth - 1) < 0.3
    angles = points @ frequencies.T
    F = flat(points, mass)
    assert torch.equal(F[..., :8], torch.zeros_like(F[..., :8]))
    assert torch.allclose(F[..., 8:16], angles.cos(), atol=1e-6)
    assert torch.allclose(F[..., 16:], angles.sin(), atol=1e-6)


def test_a_gate_turns_and_scales_its_wave(waves, cloud):
    points, mass = cloud
    F = waves(points, mass)
    gates = waves.head.gates(waves.head.norm(waves.features(points, mass)))
    gain, turn = 1 + gates[..., :8], gates[..., 8:]
    # As complex numbers, cos + i sin = exp(i angle): the output is that times (gain + i turn).
    expected = torch.complex(gain, turn) * torch.exp(1j * (points @ waves.head.frequencies.T))
    assert torch.allclose(F[..., 8:16], expected.real, atol=1e-5)
    assert torch.allclose(F[..., 16:], expected.imag, atol=1e-5)


def test_frequencies_are_exact_in_half_precision_and_the_same_for_all_seeds(waves):
    frequencies = waves.head.frequencies
    torch.manual_seed(1)
    assert torch.equal(NeoNetwork(waves.config).head.frequencies, frequencies)
    assert torch.equal(frequencies.half().float(), frequencies)
    assert torch.equal(frequencies.bfloat16().float(), frequencies)


def test_autocast_does_not_round_the_phases(waves, cloud):
    points, mass = cloud
    flat = copy.deepcopy(waves)
    for parameter in [*flat.head.free.parameters(), *flat.head.gates.parameters()]:
        torch.nn.init.zeros_(parameter)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        F = flat(points, mass)
    # Half a unit in the last place of bfloat16, of values up to one.
    assert (F[..., 8:16].float() - (points @ flat.head.frequencies.T).cos()).abs().max() < 0.004


def test_chunked_evaluation_of_waves_equals_forward(waves, cloud):
    points, mass = (part[0] for part in cloud)
    whole = waves(points[None], mass[None])[0]
    assert torch.allclose(waves.evaluate_chunked(points, mass, chunk=7), whole, atol=1e-5)


def test_a_network_without_masses_does_not_see_them(cloud):
    points, mass = cloud
    torch.manual_seed(0)
    blind = NeoNetwork(replace(TINY, mass_aware=False)).eval()
    assert torch.equal(blind(points, mass), blind(points, torch.ones_like(mass)))


def test_build_network_makes_what_the_configuration_says():
    assert type(build_network(TINY)) is NeoNetwork
    assert build_network(TINY).config == TINY


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"waves": 12}, r"`waves` must be in \[0, m / 2\), got 12"),
        ({"waves": -1}, "`waves` must be in"),
        ({"bandwidth": 0.0}, "`bandwidth` must be positive and finite, got 0.0"),
        ({"backbone": "mlp"}, "`backbone` must be 'neo', .* or 'point-transformer', got 'mlp'"),
    ],
)
def test_options_of_the_head_and_backbone_are_checked(changes, message):
    with pytest.raises(InvalidInputError, match=message):
        replace(TINY, **changes)
