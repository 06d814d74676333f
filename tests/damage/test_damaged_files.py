"""Damaged files that the library wrote itself: spectra, weights, checkpoints."""

from __future__ import annotations

import io
import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from frame import Case, damaged, part, pytest_generate_tests  # noqa: F401

from spectra_kit import Spectrum, eigensolve, robust_laplacian
from spectra_kit.geometry import sphere
from spectra_kit.neo import NeoConfig, build_network
from spectra_kit.neo.pretrained import load_pretrained, save_weights
from spectra_kit.training import checkpoint


@cache
def _spectrum() -> tuple[Spectrum, bytes]:
    spectrum = eigensolve(robust_laplacian(sphere(subdivisions=1).geometry), 5)
    with TemporaryDirectory() as folder:
        path = Path(folder, "modes.npz")
        spectrum.save(path)
        return spectrum, path.read_bytes()


@part()
def test_saved_spectrum(case: Case) -> None:
    """What can still be read is what was written."""
    spectrum, content = _spectrum()
    path = case.folder / "modes.npz"
    path.write_bytes(damaged(case.rng, content))
    _compare(Spectrum.load(path), spectrum)


@part()
def test_mapped_spectrum(case: Case) -> None:
    """Mapped values are not checked, as its documentation says; they can be looked at."""
    path = case.folder / "modes.npz"
    path.write_bytes(damaged(case.rng, _spectrum()[1]))
    repr(Spectrum.load(path, mmap=True).eigenvectors.sum())


@part()
def test_edited_spectrum(case: Case) -> None:
    """Fields that somebody changed, checksums and all, are refused or can be worked with."""
    with np.load(io.BytesIO(_spectrum()[1])) as old:
        members = dict(old)
    header = json.loads(str(members["header"]))
    _edit(case.rng, header)
    members["header"] = np.array(json.dumps(header))
    for name in case.rng.choice(list(members), case.rng.integers(3), replace=False):
        array = members[name]
        if name != "header":
            changes = [array[..., :-1], array[None], array.astype(str), array * np.nan, -array]
            members[name] = changes[case.rng.integers(len(changes))]
        elif case.rng.random() < 0.5:
            del members[name]
    np.savez(case.folder / "modes.npz", **members)
    spectrum = Spectrum.load(case.folder / "modes.npz")
    repr(spectrum)
    spectrum.save(case.folder / "again.npz")
    _compare(Spectrum.load(case.folder / "again.npz"), spectrum)


def _compare(back: Spectrum, spectrum: Spectrum) -> None:
    for name in ("eigenvalues", "eigenvectors", "mass"):
        np.testing.assert_array_equal(getattr(back, name), getattr(spectrum, name))
    assert repr(back.certificate) == repr(spectrum.certificate)
    assert repr(back.provenance) == repr(spectrum.provenance)


def _edit(rng: np.random.Generator, tree: dict[str, Any]) -> None:
    """Change one field of nested ones to something else."""
    key = list(tree)[rng.integers(len(tree))]
    if isinstance(tree[key], dict) and tree[key] and rng.random() < 0.7:
        _edit(rng, tree[key])
        return
    deep: list[Any] = []
    for _ in range(500):
        deep = [deep]
    values = [None, -1, 1.5, 10**30, "text", [], {}, True, float("nan"), deep, {"a": None}]
    choice = rng.integers(len(values) + 1)
    if choice == len(values):
        del tree[key]
    else:
        tree[key] = values[choice]


@cache
def _weights() -> tuple[dict[str, torch.Tensor], dict[str, Any], bytes]:
    torch.manual_seed(0)
    config = NeoConfig(width=8, depth=1, heads=2, head_width=4, latents=4, m=8, k=4)
    network, record = build_network(config), {"steps": 3, "history": [0.5, 0.25]}
    with TemporaryDirectory() as folder:
        path = Path(folder, "w.safetensors")
        save_weights(path, network, record)
        return network.state_dict(), record, path.read_bytes()


@part()
def test_saved_weights(case: Case) -> None:
    state, record, content = _weights()
    path = case.folder / "w.safetensors"
    path.write_bytes(damaged(case.rng, content))
    back = load_pretrained(path)
    assert back.record == record
    for name, tensor in back.network.state_dict().items():
        assert torch.equal(tensor, state[name])


@part()
def test_edited_weights(case: Case) -> None:
    """Headers that somebody changed, without the digest, fit the network or are refused."""
    content = _weights()[2]
    start = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:start])
    told = json.loads(header["__metadata__"]["spectra_kit.neo"])
    header["__metadata__"]["spectra_kit.neo"] = json.dumps({**told, "sha256": None})
    for _ in range(case.rng.integers(1, 4)):
        _edit(case.rng, header)
    text = json.dumps(header).encode()
    path = case.folder / "w.safetensors"
    path.write_bytes(len(text).to_bytes(8, "little") + text + content[start:])
    load_pretrained(path)


@cache
def _checkpoint() -> tuple[dict[str, Any], bytes]:
    content = {
        "state": {"step": 3, "losses": [0.1, 0.2]},
        "network": {"a": torch.rand(20, 30, generator=torch.Generator().manual_seed(0))},
    }
    with TemporaryDirectory() as folder:
        checkpoint.write(Path(folder), content)
        return content, Path(folder, checkpoint.NAME).read_bytes()


@part()
def test_training_checkpoint(case: Case) -> None:
    content, data = _checkpoint()
    (case.folder / checkpoint.NAME).write_bytes(damaged(case.rng, data))
    back = checkpoint.read(case.folder)
    assert back["state"] == content["state"]
    assert torch.equal(back["network"]["a"], content["network"]["a"])
