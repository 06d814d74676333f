"""Weights files: safetensors with the configuration and the training record in their metadata."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from spectra_kit._core.checked import checked
from spectra_kit._core.files import atomic_path
from spectra_kit._core.fingerprint import BLANK, has_seal, sealed
from spectra_kit._sparse.torch_device import check_device, check_float_dtype
from spectra_kit.errors import InvalidInputError, WeightsError
from spectra_kit.neo.backbones import build_network
from spectra_kit.neo.model import NeoConfig, NeoNetwork

_KEY = "spectra_kit.neo"  # the only one of the metadata: a file with two would differ every time

INDEX = "index.json"  # in neo/weights, which apps/ship_weights.py writes


class Shipped(NamedTuple):
    """Weights in the package, as ``neo/weights/index.json`` tells of them.

    Attributes
    ----------
    file : str
        In ``neo/weights``.
    sha256 : str
        Of the file.
    record : dict
        How they were trained, in short; `load_pretrained` returns all of it.
    """

    file: str
    sha256: str
    record: dict[str, Any]


def read_index(folder: Path) -> dict[str, Shipped]:
    """Return the weights that a folder holds, by name."""
    return {
        name: Shipped(**entry) for name, entry in json.loads((folder / INDEX).read_text()).items()
    }


_FOLDER = Path(str(resources.files("spectra_kit.neo") / "weights"))
#: Shipped weights by name.
WEIGHTS: dict[str, Shipped] = read_index(_FOLDER)


class Pretrained(NamedTuple):
    """A network from a file, its configuration, and where it comes from.

    Attributes
    ----------
    network : NeoNetwork
        In evaluation mode, float32.
    config : NeoConfig
        Sizes and frame.
    name : str
        What was asked for.
    sha256 : str
        Of the file.
    record : dict
        How it was trained: steps, samples, minutes, validation curve.
    """

    network: NeoNetwork
    config: NeoConfig
    name: str
    sha256: str
    record: dict[str, Any]


@checked
def load_pretrained(name_or_path: str | os.PathLike[str], device: str = "cpu") -> Pretrained:
    """Load a shipped network by its name, or any weights file by its path.

    Parameters
    ----------
    name_or_path : str or path
        A key of `WEIGHTS`, or a file that `save_weights` wrote (recognised by its suffix
        ``.safetensors``).
    device : str, default "cpu"
        Where to put the network.

    Returns
    -------
    Pretrained
        ``network, config, name, sha256, record``.

    Raises
    ------
    WeightsError
        If the name is unknown, the file is missing, damaged, or not the one that was shipped, or
        its tensors do not fit the network that its metadata describes.

    Examples
    --------
    >>> import tempfile
    >>> from spectra_kit.neo import NeoConfig, NeoNetwork, load_pretrained, save_weights
    >>> network = NeoNetwork(NeoConfig.named("small"))
    >>> path = tempfile.mkdtemp() + "/mine.safetensors"
    >>> digest = save_weights(path, network, {"steps": 0})
    >>> load_pretrained(path).config.m
    256
    """
    place = check_device(device)
    path, digest = find_weights(name_or_path)
    data = path.read_bytes()
    arrived = hashlib.sha256(data).hexdigest()
    if arrived != digest:
        raise WeightsError(
            f"{path} must have sha256 {digest}, got {arrived}; the file was changed or damaged",
            advice="reinstall spectra_kit",
        )
    config, record, tensors = _unpacked(path, data)
    _check_tensors(path, config, tensors)
    network = build_network(config)
    network.load_state_dict(tensors)  # into float32, whatever the precision on disk
    network.requires_grad_(False).eval().to(place)
    return Pretrained(network, config, os.fspath(name_or_path), digest, record)


def _unpacked(path: Path, data: bytes) -> tuple[NeoConfig, dict[str, Any], dict[str, torch.Tensor]]:
    """Return the configuration, the record and the tensors of a file of this content."""
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path} is no complete safetensors file ({error})") from error
    if _KEY not in metadata:
        raise WeightsError(
            f"{path} must have the metadata {_KEY!r}, got {sorted(metadata)}",
            advice="was it written by `save_weights`?",
        )
    try:
        content = json.loads(metadata[_KEY])
        seal = content.pop("sha256", None)
        config, record = NeoConfig(**content.pop("config")), content.pop("record")
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise WeightsError(f"{path} has unreadable metadata ({error!r})") from error
    if content or (seal is not None and not has_seal(data, seal)):
        raise WeightsError(f"{path} is not what `save_weights` wrote; it was changed or damaged")
    return config, record, tensors


@checked
def save_weights(
    path: str | os.PathLike[str],
    network: NeoNetwork,
    record: dict[str, Any],
    *,
    dtype: torch.dtype = torch.float32,
) -> str:
    """Write a network with its configuration and training record, atomically.

    Parameters
    ----------
    path : path
        Where to; should end in ``.safetensors``.
    network : NeoNetwork
        The weights.
    record : dict
        JSON values about the training.
    dtype : torch.dtype, default float32
        Precision on disk. Loading always gives float32.

    Returns
    -------
    str
        The sha256 of the file.
    """
    check_float_dtype(dtype)
    try:
        content = json.dumps({"sha256": BLANK, "config": asdict(network.config), "record": record})
    except TypeError as error:
        raise InvalidInputError("record", "hold JSON values only", error) from error
    tensors = {
        name: tensor.detach().to("cpu", dtype).contiguous()
        for name, tensor in network.state_dict().items()
    }
    data = sealed(save(tensors, {_KEY: content}))
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return hashlib.sha256(data).hexdigest()


def find_weights(name_or_path: str | os.PathLike[str]) -> tuple[Path, str]:
    """Return where weights lie, without reading them, and their sha256.

    That is the one they must have, of a shipped name, or do have, of a path.
    """
    if isinstance(name_or_path, str) and name_or_path in WEIGHTS:
        shipped = WEIGHTS[name_or_path]
        path = _FOLDER / shipped.file
        if not path.is_file():
            raise WeightsError(
                f"the shipped file {path} is missing", advice="reinstall spectra_kit"
            )
        return path, shipped.sha256
    path = Path(name_or_path)
    if path.suffix != ".safetensors":
        raise WeightsError(
            f"`name_or_path` must be one of {sorted(WEIGHTS)} or the path of a .safetensors file,"
            f" got {os.fspath(name_or_path)!r}"
        )
    if not path.is_file():
        raise WeightsError(f"the weights file {path} does not exist", advice="check the path")
    state = path.stat()
    return path, _sha256_of(path.absolute(), state.st_mtime_ns, state.st_size)


def weights_digest(network: str | os.PathLike[str] | NeoNetwork) -> str:
    """Return a hash of the weights, by which results of different ones can be told apart."""
    if not isinstance(network, NeoNetwork):
        return find_weights(network)[1][:12]
    content = hashlib.sha256()
    for name, tensor in network.state_dict().items():
        content.update(f"{name} {tuple(tensor.shape)}".encode())
        content.update(tensor.detach().double().cpu().numpy().tobytes())
    return content.hexdigest()[:12]


@lru_cache(maxsize=16)
def _sha256_of(path: Path, _changed: int, _size: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_tensors(path: Path, config: NeoConfig, tensors: dict[str, torch.Tensor]) -> None:
    """Refuse tensors that are not those of a configuration, before anything as large is built.

    Each block has a tensor, or more, and each wave a row of one. On the device ``meta`` tensors are
    sizes alone.
    """
    longest = max((size for tensor in tensors.values() for size in tensor.shape), default=0)
    try:
        if config.depth > len(tensors) or config.waves > longest:
            raise RuntimeError("more blocks or waves than there are tensors, or rows of them")  # noqa: TRY301
        with torch.device("meta"):
            announced = build_network(config).state_dict()
    except RuntimeError as error:
        raise WeightsError(
            f"{path} must hold the tensors of its configuration {config} ({error})"
        ) from error
    ours = {name: tuple(tensor.shape) for name, tensor in announced.items()}
    theirs = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if wrong := sorted(
        name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name)
    ):
        raise WeightsError(
            f"{path} must hold the tensors of its configuration, {len(wrong)} do not fit, the"
            f" first is {wrong[0]!r}: expected shape {ours.get(wrong[0])}, got"
            f" {theirs.get(wrong[0])}"
        )
    for name, tensor in tensors.items():
        if not (tensor.is_floating_point() and tensor.isfinite().all()):
            raise WeightsError(f"{path} must hold finite floats, its tensor {name!r} does not")
