"""Weights files: safetensors with the configuration and the training record in their metadata."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import torch

from spectra_kit._checked import checked
from spectra_kit._files import atomic_path
from spectra_kit.errors import InvalidInputError, WeightsError
from spectra_kit.linalg.torch_device import check_device, check_float_dtype
from spectra_kit.neo.model import NeoConfig, NeoNetwork, build_network
from spectra_kit.neo.safetensors_file import pack, unpack

_KEY = "spectra_kit.neo"

#: Shipped weights: name -> (file in neo/weights, sha256 of the file).
WEIGHTS: dict[str, tuple[str, str]] = {
    "small": (
        "neo-small.safetensors",
        "8ed4dab6ac44d7a9f926506d22a7c75f2e680d289c35240bcf39d0a09147de4f",
    ),
}


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
    arrived = _sha256(path)
    if arrived != digest:
        raise WeightsError(
            f"{path} must have sha256 {digest}, got {arrived}; the file was changed or damaged,"
            " reinstall spectra_kit"
        )
    try:
        halves, metadata = unpack(path.read_bytes())
    except WeightsError as error:
        raise WeightsError(f"{path} is no complete safetensors file ({error})") from error
    tensors = {key: tensor.float() for key, tensor in halves.items()}
    if metadata.keys() != {_KEY}:  # also where damage to its name hides the digest
        raise WeightsError(
            f"{path} must have the metadata {_KEY!r} alone, got {sorted(metadata)};"
            " was it written by `save_weights`?"
        )
    try:
        content = json.loads(metadata[_KEY])
        config, record = NeoConfig(**content["config"]), content["record"]
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise WeightsError(f"{path} has unreadable metadata ({error!r})") from error
    network = build_network(config)
    _check_tensors(path, network, tensors)
    network.load_state_dict(tensors, strict=True)
    network.requires_grad_(False).eval().to(place)
    return Pretrained(network, config, os.fspath(name_or_path), digest, record)


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

    Raises
    ------
    InvalidInputError
        If the record is no JSON, or the folder does not exist.
    """
    check_float_dtype(dtype)
    try:
        content = json.dumps({"config": asdict(network.config), "record": record})
    except TypeError as error:
        raise InvalidInputError(f"`record` must hold JSON values only: {error}") from error
    tensors = {
        name: tensor.detach().to("cpu", dtype).contiguous()
        for name, tensor in network.state_dict().items()
    }
    with atomic_path(path) as temporary:
        temporary.write_bytes(pack(tensors, {_KEY: content}))
    return _sha256(Path(path))


class WeightsFile(NamedTuple):
    """Where weights lie, and the sha256 they must have (for a shipped file) or do have."""

    path: Path
    sha256: str


def find_weights(name_or_path: str | os.PathLike[str]) -> WeightsFile:
    """Return the file of a shipped name or of a path, without reading the weights.

    Raises
    ------
    WeightsError
        If the name is unknown or the file is missing.
    """
    if isinstance(name_or_path, str) and name_or_path in WEIGHTS:
        file, digest = WEIGHTS[name_or_path]
        path = Path(str(resources.files("spectra_kit.neo") / "weights" / file))
        if not path.is_file():
            raise WeightsError(f"the shipped file {path} is missing; reinstall spectra_kit")
        return WeightsFile(path, digest)
    path = Path(name_or_path)
    if path.suffix != ".safetensors":
        raise WeightsError(
            f"`name_or_path` must be one of {sorted(WEIGHTS)} or the path of a .safetensors file,"
            f" got {os.fspath(name_or_path)!r}"
        )
    if not path.is_file():
        raise WeightsError(f"the weights file {path} does not exist; check the path")
    return WeightsFile(path, _sha256(path))


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_tensors(path: Path, network: NeoNetwork, tensors: dict[str, torch.Tensor]) -> None:
    ours = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    theirs = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    wrong = sorted(
        name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name)
    )
    if wrong:
        name = wrong[0]
        raise WeightsError(
            f"{path} must hold the tensors of its configuration, {len(wrong)} do not fit, the"
            f" first is {name!r}: expected shape {ours.get(name)}, got {theirs.get(name)}"
        )
