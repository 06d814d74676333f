"""Labellers as files."""

from __future__ import annotations

import os
from typing import Any

import torch
from torch import Tensor

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import check_indices
from spectra_kit.errors import InvalidInputError
from spectra_kit.learn._files import as_json, from_json, read, write
from spectra_kit.learn.fitting import Model
from spectra_kit.learn.heads import Head
from spectra_kit.learn.labellers import Classifier, Segmenter
from spectra_kit.learn.networks import Network

_INPUTS = "network inputs"  # in the metadata


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
        no checksum, and are read without one.
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
