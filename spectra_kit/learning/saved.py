"""Labellers as files: safetensors, with all else as JSON in the metadata. Nothing is unpickled."""

from __future__ import annotations

import json
import os
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from spectra_kit import eigensolvers, embeddings, subspaces
from spectra_kit._checked import checked
from spectra_kit._files import atomic_path, parsing
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.learning import heads, networks
from spectra_kit.learning.examples import Recipe
from spectra_kit.learning.fitting import Model
from spectra_kit.learning.heads import Head
from spectra_kit.learning.labellers import Classifier, Segmenter

_KEY = "spectra_kit.learning"
_FORMAT = 1
_INPUTS = "network inputs"  # in the metadata
#: Classes that a file may name, by their names: of options alone, and what they may hold.
_KNOWN = {
    name: kind
    for module in (embeddings, eigensolvers, subspaces, heads, networks)
    for name, kind in vars(module).items()
    if isinstance(kind, type) and is_dataclass(kind)
} | {"Recipe": Recipe}


@checked
def save_labeller(path: str | os.PathLike[str], labeller: Classifier | Segmenter) -> None:
    """Write a classifier or a segmenter, whole or not at all.

    Parameters
    ----------
    path : path
        Where to; should end in ``.safetensors``.
    labeller : Classifier or Segmenter
        What to write. Of a head its examples are written, to which it is fitted again.

    Raises
    ------
    InvalidInputError
        If its recipe holds what a file cannot name, such as a network of one's own; or the folder
        does not exist.
    """
    content: dict[str, Any] = {
        "format": _FORMAT,
        "kind": type(labeller).__name__,
        "names": list(labeller.names),
        "recipe": _as_json(labeller.recipe),
        "method": _as_json(labeller.method),
    }
    if isinstance(labeller.learned, Model):
        content[_INPUTS] = len(labeller.learned.mean)
        tensors = dict(labeller.learned.state_dict())
    else:
        assert isinstance(labeller, Classifier)
        assert labeller.examples is not None
        vectors, labels = labeller.examples
        tensors = {"vectors": torch.tensor(vectors), "labels": torch.tensor(labels)}
    data = save({k: v.contiguous() for k, v in tensors.items()}, {_KEY: json.dumps(content)})
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


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
        If the file is damaged, or was not written by `save_labeller`.
    MissingDependencyError
        Without the packages that its method needs.

    Examples
    --------
    >>> import tempfile
    >>> import spectra_kit as sk
    >>> from spectra_kit import learning
    >>> ball, ring = sk.geometry.sphere().geometry, sk.geometry.torus(n=400).geometry
    >>> known = learning.train_classifier(
    ...     [ball, ring], [0, 1], method=learning.NearestNeighbour(),
    ...     recipe=learning.Recipe(embeddings=(sk.embeddings.ShapeDNA(count=8),), k=16),
    ... )
    >>> path = tempfile.mkdtemp() + "/known.safetensors"
    >>> learning.save_labeller(path, known)
    >>> learning.load_labeller(path).classify(ring).label
    1
    """
    path = Path(path)
    with parsing(path, "labeller", remedy="train it again"):
        try:
            with safe_open(path, "pt") as file:
                content = json.loads((file.metadata() or {})[_KEY])
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except SafetensorError as error:
            raise InvalidFileError(path, f"no complete safetensors file ({error})") from error
        if content["format"] != _FORMAT:
            raise InvalidInputError("format", f"be {_FORMAT}", content["format"])
        if not all(tensor.isfinite().all() for tensor in tensors.values()):
            raise InvalidInputError("tensors", "be finite", "some that are not")
        names = tuple(content["names"])
        recipe, method = _from_json(content["recipe"]), _from_json(content["method"])
        whole = content["kind"] == "Classifier"
        if whole and isinstance(method, Head):
            examples = tensors["vectors"].numpy(), tensors["labels"].numpy()
            return Classifier(names, recipe, method, method.fit(*examples), examples)
        model = Model(method, content[_INPUTS], len(names), whole=whole)
        model.load_state_dict(tensors)
        model.eval()
        if whole:
            return Classifier(names, recipe, method, model)
        return Segmenter(names, recipe, method, model)


def _as_json(value: Any) -> Any:
    if is_dataclass(value) and type(value).__name__ in _KNOWN:
        options = {f.name: _as_json(getattr(value, f.name)) for f in fields(value) if f.init}
        return {"type": type(value).__name__, **options}
    if isinstance(value, tuple):
        return [_as_json(item) for item in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise InvalidInputError(
        "labeller",
        "be made of options that a file can name",
        type(value).__name__,
        advice="save the network's weights, and name their file instead",
    )


def _from_json(value: Any) -> Any:
    if isinstance(value, dict):
        options = {name: _from_json(item) for name, item in value.items() if name != "type"}
        return _KNOWN[value["type"]](**options)
    return tuple(map(_from_json, value)) if isinstance(value, list) else value
