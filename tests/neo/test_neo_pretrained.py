"""Weights: files that hold what went in, shipped ones that are worth it, and how to ship."""

import json
import re
import shutil
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import ship_weights
import torch
from conftest import creature
from safetensors.torch import load_file, save_file

from spectra_kit import eigensolve, robust_laplacian
from spectra_kit._sparse import orthonormalize
from spectra_kit.eigen.neo import Neo
from spectra_kit.eigen.subspaces import AmbientFourier
from spectra_kit.errors import InvalidInputError, WeightsError
from spectra_kit.neo import WEIGHTS, NeoSubspace, pretrained
from spectra_kit.neo.model import NeoConfig, NeoNetwork
from spectra_kit.neo.pretrained import (
    Shipped,
    find_weights,
    load_pretrained,
    read_index,
    save_weights,
)

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "spectra_kit" / "neo" / "weights"
GOLDEN = Path(__file__).parent / "golden"
TINY = NeoConfig(width=16, depth=1, heads=2, head_width=8, latents=4, m=12, k=4, frame="none")


@pytest.fixture
def network():
    torch.manual_seed(0)
    return NeoNetwork(TINY)


@pytest.fixture
def path(tmp_path, network):
    path = tmp_path / "tiny.safetensors"
    save_weights(path, network, {"steps": 3})
    return path


def test_round_trip_is_exact(path, network, tmp_path):
    loaded = load_pretrained(path)
    assert (loaded.config, loaded.record, loaded.name) == (TINY, {"steps": 3}, str(path))
    assert not loaded.network.training
    half = tmp_path / "half.safetensors"
    save_weights(half, network, {}, dtype=torch.float16)
    rounded = load_pretrained(half).network.state_dict()
    for name, tensor in network.state_dict().items():
        assert torch.equal(loaded.network.state_dict()[name], tensor)
        assert rounded[name].dtype == torch.float32
        torch.testing.assert_close(rounded[name], tensor, atol=1e-3, rtol=1e-3)
    again = save_weights(tmp_path / "again.safetensors", network, {"steps": 3})
    assert loaded.sha256 == again == find_weights(path)[1]


def test_a_shipped_file_must_have_its_hash(path, monkeypatch, tmp_path):
    digest = find_weights(path)[1]
    monkeypatch.setattr(pretrained, "_FOLDER", tmp_path)
    monkeypatch.setitem(pretrained.WEIGHTS, "tiny", Shipped(path.name, digest, {}))
    assert load_pretrained("tiny").sha256 == digest
    with pytest.raises(WeightsError, match=r"one of \[.*'tiny'.*\] or the path .* got 'huge'"):
        load_pretrained("huge")
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(WeightsError, match=f"must have sha256 {digest}, got"):
        load_pretrained("tiny")
    path.unlink()
    with pytest.raises(WeightsError, match=r"shipped file .* is missing; reinstall"):
        load_pretrained("tiny")
    with pytest.raises(WeightsError, match=r"tiny\.safetensors does not exist; check the path"):
        load_pretrained(path)


def test_a_truncated_file_is_refused(path):
    content = path.read_bytes()
    for share in (0.0, 0.01, 0.5, 0.99):
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(WeightsError, match="is no complete safetensors file"):
            load_pretrained(path)


SOUND = json.dumps({"record": {}, "config": asdict(TINY)})


@pytest.mark.parametrize(
    ("change", "content", "told"),
    [
        (None, SOUND, "1 do not fit, the first is 'lift.bias': expected shape (16,), got None"),
        (torch.zeros(3), SOUND, "the first is 'lift.bias': expected shape (16,), got (3,)"),
        (torch.full((16,), torch.nan), SOUND, "must hold finite floats, its tensor 'lift.bias'"),
        (torch.ones(16).int(), SOUND, "must hold finite floats, its tensor 'lift.bias'"),
        ({"steps": torch.ones(2).int()}, SOUND, "is 'steps': expected shape None, got (2,)"),
        (torch.zeros(16), None, "'spectra_kit.neo', got []; was it written by"),
        (torch.zeros(16), '{"config": {"width": 16}, "record": {}}', "has unreadable metadata"),
        (torch.zeros(16), '{"record": {}}', "has unreadable metadata"),
        (torch.zeros(16), "no json", "has unreadable metadata"),
        (torch.zeros(16), "[]", "has unreadable metadata"),
    ],
)
def test_what_does_not_fit_together_is_refused(path, change, content, told):
    tensors = load_file(path) | (change if isinstance(change, dict) else {"lift.bias": change})
    tensors = {name: tensor for name, tensor in tensors.items() if tensor is not None}
    save_file(tensors, path, metadata=None if content is None else {"spectra_kit.neo": content})
    with pytest.raises(WeightsError, match=re.escape(told)):
        load_pretrained(path)


@pytest.mark.parametrize(
    "sizes",
    [
        {"depth": 10**9},
        {"width": 10**9},
        {"m": 10**12},
        {"m": 10**9, "waves": 10**8},
        {"latents": 10**15},
        {"heads": 10**9, "head_width": 10**10},
        {"head_width": 10**6},
    ],
    ids=str,
)
def test_sizes_that_no_tensor_has_are_refused_before_anything_is_built(path, sizes):
    content = json.dumps({"record": {}, "config": asdict(TINY) | sizes})
    save_file(load_file(path), path, metadata={"spectra_kit.neo": content})
    start = time.process_time()
    with pytest.raises(WeightsError, match="must hold the tensors of its configuration"):
        load_pretrained(path)
    assert time.process_time() - start < 1


def test_a_record_must_be_json_and_a_failed_write_leaves_the_old_file(path, network):
    before = path.read_bytes()
    with pytest.raises(InvalidInputError, match="`record` must hold JSON values only"):
        save_weights(path, network, {"when": object()})
    assert path.read_bytes() == before


def test_no_flipped_bit_changes_a_value_unseen(tmp_path):
    """Of a name, the metadata or a tensor: the format has no checksum, the content has one."""
    path = tmp_path / "least.safetensors"
    config = NeoConfig(width=1, depth=1, heads=1, head_width=1, latents=1, m=1, k=1)
    save_weights(path, NeoNetwork(config), {"steps": 3})
    content = path.read_bytes()
    for bit in np.random.default_rng(0).permutation(8 * len(content))[:150]:
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        with pytest.raises((WeightsError, InvalidInputError)):
            load_pretrained(path)


def test_a_file_without_a_digest_is_read_too(path, network):
    content = {"config": asdict(TINY), "record": {"steps": 3}}
    save_file(network.state_dict(), path, metadata={"spectra_kit.neo": json.dumps(content)})
    assert load_pretrained(path).record == {"steps": 3}


# Shipped weights


@pytest.mark.parametrize("name", sorted(WEIGHTS))
def test_the_file_is_the_one_that_was_trained(name):
    file, digest, told = WEIGHTS[name]
    golden = load_file(GOLDEN / file)
    loaded = load_pretrained(name)
    assert loaded.sha256 == digest
    assert told.items() <= loaded.record.items()
    with torch.no_grad():
        basis = loaded.network(golden["points"][None], golden["mass"][None])[0]
    torch.testing.assert_close(basis, golden["basis"], rtol=1e-3, atol=1e-4)
    assert loaded.record["samples"] > 10_000
    assert loaded.record["minutes"] > 1
    errors = [row["validation"] for row in loaded.record["history"]]
    # After a leg the last row is of the weights as shipped, the others of those in training.
    assert loaded.record["span_error"] == errors[-1] <= 1.05 * min(errors)
    assert (FOLDER / file).stat().st_size < 12e6


@pytest.fixture(scope="module")
def exact():
    """A creature that no training saw, with its exact spectrum."""
    laplacian = robust_laplacian(creature(2500, seed=123))
    return laplacian, eigensolve(laplacian, 96)


@pytest.fixture(scope="module")
def joined(exact):
    """The subspace that the network predicts for the creature in four poses."""
    laplacian, _ = exact
    return NeoSubspace("small", poses=4)(laplacian.points, laplacian.mass)


def span_error(basis, spectrum):
    Y = orthonormalize(basis, spectrum.mass)
    return 1 - np.square(Y.T @ (spectrum.mass[:, None] * spectrum.eigenvectors)).sum(0).mean()


def test_small_covers_the_low_modes_better_than_as_many_functions_without_training(exact, joined):
    laplacian, spectrum = exact
    one = span_error(joined[:, :257], spectrum)
    assert one < 0.004
    assert span_error(joined, spectrum) < 2e-4
    errors = [
        span_error(
            AmbientFourier(m=257, bandwidth=width)(laplacian.points, laplacian.mass), spectrum
        )
        for width in (5.0, 7.0)
    ]
    assert one < min(errors) / 3


def test_eigenvalues_of_the_solver(exact):
    laplacian, spectrum = exact
    predicted = eigensolve(laplacian, 48, Neo(weights="small", poses=4))
    relative = predicted.eigenvalues[1:] / spectrum.eigenvalues[1:48] - 1
    assert relative.min() > -1e-9
    assert relative.mean() < 0.0015  # two poses alone: 0.0021


def test_weights_are_shipped_under_their_name(path, tmp_path, capsys):
    folder = tmp_path / "spectra_kit" / "neo" / "weights"
    for made in (folder, tmp_path / "tests" / "neo" / "golden"):
        made.mkdir(parents=True)
    shutil.copy(FOLDER / "index.json", folder)
    told = dict(WEIGHTS)
    for name in ("small", "another"):
        digest, file = ship_weights.ship(name, path, tmp_path), f"neo-{name}.safetensors"
        told[name] = Shipped(file, digest, {"steps": 3})
        assert read_index(folder) == told
    loaded = load_pretrained(folder / file)
    assert (loaded.sha256, loaded.record) == (digest, {"steps": 3})
    golden = load_file(tmp_path / "tests" / "neo" / "golden" / file)
    with torch.no_grad():
        basis = loaded.network(golden["points"][None], golden["mass"][None])[0]
    torch.testing.assert_close(basis, golden["basis"])

    assert ship_weights.main(["small", str(tmp_path / "none.safetensors")]) == 2
    assert "does not exist" in capsys.readouterr().err
