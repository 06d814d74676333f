"""Damaged files that the library wrote itself: spectra, stores, labellers, weights."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from frame import Case, damaged, part, pytest_generate_tests  # noqa: F401

from spectra_kit import Spectrum, eigensolve, learn, robust_laplacian
from spectra_kit._core.fingerprint import BLANK, sealed
from spectra_kit.datasets import Plan, ShapeRecord, SpectrumStore, complete
from spectra_kit.features import Coordinates, ShapeDNA
from spectra_kit.geometry import sphere, torus, write
from spectra_kit.neo import NeoConfig, build_network
from spectra_kit.neo.pretrained import load_pretrained, save_weights
from spectra_kit.neo.train import checkpoint

BALL = sphere(subdivisions=1).geometry


def _written(write: Callable[[Path], object]) -> dict[str, bytes]:
    """What the files of a folder hold, by their names, once something was written into it."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write(folder)
        files = [path for path in folder.rglob("*") if path.is_file()]
        return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@cache
def _spectrum() -> tuple[Spectrum, bytes]:
    spectrum = eigensolve(robust_laplacian(BALL), 5)
    return spectrum, _written(lambda folder: spectrum.save(folder / "modes.npz"))["modes.npz"]


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


def _edited(rng: np.random.Generator, tree: dict[str, Any]) -> dict[str, Any]:
    """Change one to three fields of what has a checksum; return it, to be sealed again."""
    for _ in range(rng.integers(1, 4)):
        _edit(rng, tree)
    return {"sha256": BLANK, **{key: value for key, value in tree.items() if key != "sha256"}}


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
    files = _written(lambda folder: save_weights(folder / "w.safetensors", network, record))
    return network.state_dict(), record, files["w.safetensors"]


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
    return content, _written(lambda folder: checkpoint.write(folder, content))[checkpoint.NAME]


@part()
def test_training_checkpoint(case: Case) -> None:
    content, data = _checkpoint()
    (case.folder / checkpoint.NAME).write_bytes(damaged(case.rng, data))
    back = checkpoint.read(case.folder)
    assert back["state"] == content["state"]
    assert torch.equal(back["network"]["a"], content["network"]["a"])


# --- stores ---------------------------------------------------------------------------------------

_PLAN = Plan(k=5, descriptors=("hks", "dna"), operators=("stiffness", "gradient"))


@cache
def _store() -> tuple[dict[str, bytes], ShapeRecord]:
    """The files of a store of two shapes and a map, and the record of the first."""
    with TemporaryDirectory() as folder:
        store = SpectrumStore(Path(folder, "store"))
        records = []
        for name in ("a", "b"):
            write(BALL, Path(folder, f"{name}.off"))
            records.append(complete(store, name, Path(folder, f"{name}.off"), _PLAN).record)
        store.keep_map(records[0].spectrum, "0" * 32, {"k": 5}, {"point_map": np.arange(42)})
        entries = {
            str(e.path.relative_to(store.path)): e.path.read_bytes() for e in store.entries()
        }
        return entries, records[0]


def _unpacked(folder: Path) -> SpectrumStore:
    store = SpectrumStore(folder / "store")
    for name, data in _store()[0].items():
        path = Path(store.path) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    for name in ("a", "b"):
        write(BALL, folder / f"{name}.off")
    return store


def _used(store: SpectrumStore, folder: Path, bad: Path) -> None:
    """A damaged entry is found, stops nothing, and is made good."""
    whole, record = _store()
    assert [one.path for one in store.verify()] == [bad]
    if bad.suffix == ".json":
        assert len([*store.records()]) == 1
    assert complete(store, "a", folder / "a.off", _PLAN).record == record
    assert [one.path for one in store.verify(remove=True)] in ([], [bad])
    assert complete(store, "a", folder / "a.off", _PLAN).record == record
    complete(store, "b", folder / "b.off", _PLAN)
    assert store.verify() == []
    for entry in store.entries():
        assert entry.path.read_bytes() == whole[str(entry.path.relative_to(store.path))]


@part()
def test_store_record(case: Case) -> None:
    store = _unpacked(case.folder)
    records = [entry.path for entry in store.entries("records")]
    path = records[case.rng.integers(len(records))]
    whole = path.read_bytes()
    path.write_bytes(damaged(case.rng, whole))
    if path.read_bytes() != whole:
        _used(store, case.folder, path)


@part()
def test_store_entry(case: Case) -> None:
    """All but what is behind the end of a zip, and between its members, is looked at."""
    store = _unpacked(case.folder)
    entries = [entry.path for entry in store.entries() if entry.kind != "records"]
    path = entries[case.rng.integers(len(entries))]
    path.write_bytes(damaged(case.rng, path.read_bytes()))
    if store.verify():
        found = store.verify(remove=True)
        assert [one.path for one in found] == [path]
        assert not path.exists()
    assert complete(store, "a", case.folder / "a.off", _PLAN).record == _store()[1]
    assert store.verify() == []


@part()
def test_edited_store_record(case: Case) -> None:
    """Fields that somebody changed, checksum and all, are refused or can be worked with."""
    store = _unpacked(case.folder)
    path = next(store.entries("records")).path
    content = _edited(case.rng, json.loads(path.read_text()))
    path.write_bytes(sealed(json.dumps(content).encode()))
    for record in store.records():
        repr(record)
        store.sizes(record)
    store.verify()
    for name in ("a", "b"):
        complete(store, name, case.folder / f"{name}.off", _PLAN)


# --- labellers and indexes ------------------------------------------------------------------------


@cache
def _learned() -> dict[str, tuple[bytes, Any]]:
    """Files of a segmenter, a classifier and an index, and what each tells of a ball."""
    ring = torus(n=200).geometry
    dna = learn.Recipe(embeddings=(ShapeDNA(count=8),), k=16)
    upright = learn.Recipe(embeddings=(Coordinates(),), upright=True)
    found = {
        "segmenter": learn.train_segmenter(
            [BALL],
            [(BALL.points[:, 2] > 0).astype(int)],
            recipe=upright,
            method=learn.PointMLP(width=8),
            training=learn.Training(epochs=2),
        ),
        "classifier": learn.train_classifier(
            [BALL, ring], [0, 1], recipe=dna, method=learn.NearestNeighbour()
        ),
    }
    with TemporaryDirectory() as folder:
        for name, labeller in found.items():
            learn.save_labeller(Path(folder, name), labeller)
        for name, shape in (("ball", BALL), ("ring", ring)):
            write(shape, Path(folder, f"{name}.off"))
        learn.index_folder(folder, dna).save(Path(folder, "index"))
        paths = [Path(folder, name) for name in ("segmenter", "classifier", "index")]
        return {path.name: (path.read_bytes(), _told(path)) for path in paths}


def _told(path: Path) -> Any:
    """What a file of learning says of a ball."""
    if path.name == "index":
        return learn.ShapeIndex.load(path).nearest(BALL)
    labeller = learn.load_labeller(path)
    if isinstance(labeller, learn.Segmenter):
        return labeller.segment(BALL).scores.tolist()
    return labeller.classify(BALL).scores.tolist()


def _learned_file(case: Case) -> tuple[Path, bytes, Any]:
    name = str(case.rng.choice([*_learned()]))
    return case.folder / name, *_learned()[name]


@part()
def test_saved_labeller_or_index(case: Case) -> None:
    path, data, told = _learned_file(case)
    path.write_bytes(damaged(case.rng, data))
    assert _told(path) == told


@part()
def test_edited_labeller_or_index(case: Case) -> None:
    """Fields that somebody changed, checksum and all, are refused or can be worked with."""
    path, data, _ = _learned_file(case)
    start = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:start])
    content = _edited(case.rng, json.loads(header["__metadata__"]["spectra_kit.learning"]))
    header["__metadata__"]["spectra_kit.learning"] = json.dumps(content)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(sealed(len(text).to_bytes(8, "little") + text + data[start:]))
    _told(path)
