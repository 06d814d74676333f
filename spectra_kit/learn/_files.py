"""Files of safetensors with all else as JSON in the metadata. Nothing is unpickled."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from spectra_kit import eigen, features
from spectra_kit._core.files import atomic_path, parsing
from spectra_kit._core.fingerprint import BLANK, has_seal, sealed
from spectra_kit.eigen import subspaces
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.learn import heads, networks
from spectra_kit.learn.examples import Recipe
from spectra_kit.neo import NeoSubspace

Made = TypeVar("Made")

_KEY = "spectra_kit.learning"
_FORMAT = 2  # 2: with a checksum
#: Classes that a file may name, by their names: of options alone.
_KNOWN = {
    name: kind
    for module in (features, eigen, subspaces, heads, networks)
    for name, kind in vars(module).items()
    if isinstance(kind, type) and is_dataclass(kind)
} | {"Recipe": Recipe, "NeoSubspace": NeoSubspace}


def write(
    path: str | os.PathLike[str], content: Mapping[str, Any], tensors: Mapping[str, Tensor]
) -> None:
    """Write tensors and what JSON or `as_json` can say, whole or not at all."""
    text = json.dumps({"sha256": BLANK, "format": _FORMAT, **content})
    data = sealed(
        save({name: tensor.contiguous() for name, tensor in tensors.items()}, {_KEY: text})
    )
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def read(
    path: str | os.PathLike[str],
    what: str,
    make: Callable[[dict[str, Any], dict[str, Tensor]], Made],
) -> Made:
    """Return what `make` makes of the content and the tensors of a file.

    Raises
    ------
    InvalidFileError
        If the file is damaged, or `make` cannot take it apart. Those of release 0.2.0 have no
        checksum.
    """
    path = Path(path)
    with parsing(path, what, remedy="make it again"):
        try:
            with safe_open(path, "pt") as file:
                content = json.loads((file.metadata() or {})[_KEY])
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except SafetensorError as error:
            problem = f"not a whole {what}, which is a safetensors file ({error})"
            raise InvalidFileError(path, problem) from error
        if content["format"] not in range(1, _FORMAT + 1):
            raise InvalidInputError("format", f"be at most {_FORMAT}", content["format"])
        seal = content.pop("sha256", None)
        if (seal is not None or content["format"] > 1) and not has_seal(path.read_bytes(), seal):
            raise InvalidInputError("its content has another checksum than it says")
        if not all(tensor.isfinite().all() for tensor in tensors.values()):
            raise InvalidInputError("tensors", "be finite", "some that are not")
        return make(content, tensors)


def as_json(value: Any) -> Any:
    """Return options as JSON has them: classes by their names."""
    if is_dataclass(value) and _KNOWN.get(type(value).__name__) is type(value):
        options = {f.name: as_json(getattr(value, f.name)) for f in fields(value) if f.init}
        return {"type": type(value).__name__, **options}
    if isinstance(value, tuple):
        return [as_json(item) for item in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise InvalidInputError(
        "recipe",
        "be made of options that a file can name",
        type(value).__name__,
        advice="save the network's weights, and name their file instead",
    )


def from_json(value: Any) -> Any:
    """Return what `as_json` was given."""
    if isinstance(value, dict):
        options = {name: from_json(item) for name, item in value.items() if name != "type"}
        return _KNOWN[value["type"]](**options)
    return tuple(map(from_json, value)) if isinstance(value, list) else value
