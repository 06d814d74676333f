"""Labellers as files: safetensors, with all else as JSON in the metadata. Nothing is unpickled."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from spectra_kit import eigen, features
from spectra_kit._core.checked import checked
from spectra_kit._core.files import atomic_path, parsing
from spectra_kit._core.fingerprint import BLANK, has_seal, sealed
from spectra_kit._core.validate import check_indices
from spectra_kit.eigen import subspaces
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.learn import heads, networks
from spectra_kit.learn.examples import Recipe
from spectra_kit.learn.fitting import Model
from spectra_kit.learn.heads import Head
from spectra_kit.learn.labellers import Classifier, Segmenter
from spectra_kit.learn.networks import Network
from spectra_kit.neo import NeoSubspace

Made = TypeVar("Made")

_KEY = "spectra_kit.learning"
_FORMAT = 2  # 2: with a checksum
_INPUTS = "network inputs"  # in the metadata
#: Classes that a file may name, by their names: of options alone.
_KNOWN = {
    name: kind
    for module in (features, eigen, subspaces, heads, networks)
    for name, kind in vars(module).items()
    if isinstance(kind, type) and is_dataclass(kind)
} | {"Recipe": Recipe, "NeoSubspace": NeoSubspace}


@checked
def save_labeller(path: str | os.PathLike[str], labeller: Classifier | Segmenter) -> None:
    """Write a classifier or a segmenter, whole or not at all.

    Parameters
    ----------
    path : path
        Where to; should end in ``.safetensors``.
    labeller : Classifier or Segmenter
        What to write. Of a head its examples are written, to which it is fitted again. A recipe
        that holds a network of one's own has no name for it: save its weights, and name their file.
    """
    content: dict[str, Any] = {
        "kind": type(labeller).__name__,
        "names": list(labeller.names),
        "recipe": as_json(labeller.recipe),
        "method": as_json(labeller.method),
    }
    if isinstance(labeller.learned, Model):
        content[_INPUTS] = len(labeller.learned.mean)
        write(path, content, labeller.learned.state_dict())
        return
    assert isinstance(labeller, Classifier)
    assert labeller.examples is not None
    vectors, labels = labeller.examples
    write(path, content, {"vectors": torch.tensor(vectors), "labels": torch.tensor(labels)})


@checked
def load_labeller(path: str | os.PathLike[str]) -> Classifier | Segmenter:
    """Read what `save_labeller` wrote.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    Classifier or Segmenter
        That labels as the one that was written.

    Raises
    ------
    InvalidFileError
        If the file is damaged, or was not written by `save_labeller`. Those of release 0.2.0 have
        no checksum, and are refused where they name a class that was renamed since.
    MissingDependencyError
        Without the packages that its method needs.

    Examples
    --------
    >>> import tempfile
    >>> import spectra_kit as sk
    >>> from spectra_kit import learn
    >>> ball, ring = sk.geometry.sphere().geometry, sk.geometry.torus(n=400).geometry
    >>> known = learn.train_classifier(
    ...     [ball, ring], [0, 1], method=learn.NearestNeighbour(),
    ...     recipe=learn.Recipe(embeddings=(sk.features.ShapeDNA(count=8),), k=16),
    ... )
    >>> path = tempfile.mkdtemp() + "/known.safetensors"
    >>> learn.save_labeller(path, known)
    >>> learn.load_labeller(path).classify(ring).label
    1
    """
    return read(path, "labeller", _made)


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
    """Return what `make` makes of the content and the tensors of a file, or refuse it as damaged.

    Files of release 0.2.0 have no checksum.
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


def _made(content: dict[str, Any], tensors: dict[str, Tensor]) -> Classifier | Segmenter:
    names = from_json(content["names"])
    recipe, method = from_json(content["recipe"]), from_json(content["method"])
    whole = {"Classifier": True, "Segmenter": False}[content["kind"]]
    if whole and isinstance(method, Head):
        examples = tensors["vectors"].numpy(), tensors["labels"].numpy()
        check_indices("labels", examples[1], len(names))
        return Classifier(names, recipe, method, method.fit(*examples), examples)
    sizes = method, content[_INPUTS], len(names)
    _check_sizes(*sizes, tensors)
    model = Model(*sizes, whole=whole)
    model.load_state_dict(tensors)
    model.eval()
    if whole:
        return Classifier(names, recipe, method, model)
    return Segmenter(names, recipe, method, model)


def _check_sizes(method: Network, inputs: int, classes: int, tensors: dict[str, Tensor]) -> None:
    """Refuse sizes that are not those of the tensors, before anything as large is built.

    Each layer has a tensor, or more. On the device ``meta`` tensors are sizes alone.
    """
    if (depth := getattr(method, "depth", 1)) > len(tensors):
        raise InvalidInputError("depth", f"be at most {len(tensors)}, the tensors there are", depth)
    with torch.device("meta"):
        announced = Model(method, inputs, classes, whole=False).state_dict()
    ours, theirs = ({(n, *t.shape) for n, t in all_.items()} for all_ in (announced, tensors))
    if odd := ours ^ theirs:
        raise InvalidInputError("tensors", "be those of the method", f"others, as {min(odd)}")
