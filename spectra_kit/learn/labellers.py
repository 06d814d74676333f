"""What has learned to label: a `Classifier` whole shapes, a `Segmenter` their points."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from torch import Tensor

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import as_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, GeometryLike, TriangleMesh, sample_with_origin
from spectra_kit.learn.examples import Example, Recipe, prepared
from spectra_kit.learn.fitting import Model, Training, fit, predicted, with_copies
from spectra_kit.learn.heads import Head
from spectra_kit.learn.networks import Network
from spectra_kit.learn.tensors import UNKNOWN

_CLASSES = 1 << 16
_CARRIED_BY = 3  # nearest sampled points tell a vertex its label


class Classification(NamedTuple):
    """What a `Classifier` takes a shape for.

    Attributes
    ----------
    label : int
        Number of the class.
    name : str
        Its name.
    scores : ndarray of shape (classes,)
        Of all: they sum to one.
    """

    label: int
    name: str
    scores: Floats


class Segmentation(NamedTuple):
    """What a `Segmenter` takes the points of a shape for.

    Attributes
    ----------
    labels : ndarray of shape (n,)
        Number of the class of each point.
    face_labels : ndarray of shape (f,) or None
        Of each face of a mesh: the class that its three corners together favour.
    scores : ndarray of shape (n, classes)
        Of each point: they sum to one.
    names : tuple of str
        Of the classes.
    """

    labels: Ints
    face_labels: Ints | None
    scores: Floats
    names: tuple[str, ...]


@checked
@dataclass(frozen=True, eq=False)
class Classifier:
    """Tells what a shape is; `train_classifier` makes one.

    Parameters
    ----------
    names : tuple of str
        Of the classes.
    recipe : Recipe
        How shapes become numbers.
    method : Head or Network
        What learned to tell them apart.
    learned : object
        A classifier of scikit-learn, or a `Model`.
    examples : tuple of ndarray, optional
        Of a head: the vectors (s, c) and classes (s,) that it is fitted to, again when it is read
        from a file.
    """

    names: tuple[str, ...]
    recipe: Recipe
    method: Head | Network
    learned: Any
    examples: tuple[Floats, Ints] | None = None

    def __post_init__(self) -> None:
        _check_names(self.names)
        if not isinstance(self.learned, Model) and not hasattr(self.learned, "predict"):
            raise InvalidInputError(
                "learned", "be what `train_classifier` has learned", type(self.learned).__name__
            )

    def __repr__(self) -> str:
        return f"Classifier({len(self.names)} classes, {self.recipe}, {self.method})"

    def classify(self, shape: GeometryLike) -> Classification:
        """Tell what a shape of one component is, in any unit."""
        if isinstance(self.learned, Model):
            example, _ = prepared(self.recipe, shape, self.learned.sees)
            scores = predicted(self.learned, self.recipe, example)
        else:
            scores = _scores(self.learned, self.recipe.vector(shape), len(self.names))
        label = int(scores.argmax())
        return Classification(label, self.names[label], scores)


@checked
@dataclass(frozen=True, eq=False)
class Segmenter:
    """Tells what part of a shape each point is; `train_segmenter` makes one.

    Parameters
    ----------
    names, recipe
        As of `Classifier`.
    method : Network
        The sizes of its model.
    learned : Model
        The network, trained.
    """

    names: tuple[str, ...]
    recipe: Recipe
    method: Network
    learned: Model

    def __post_init__(self) -> None:
        _check_names(self.names)

    def __repr__(self) -> str:
        return f"Segmenter({len(self.names)} classes, {self.recipe}, {self.method})"

    def segment(self, shape: GeometryLike) -> Segmentation:
        """Tell what part each point of a shape is, and each face of a mesh, in any unit."""
        example, seen = prepared(self.recipe, shape, self.learned.sees)
        scores, faces = carried(seen, predicted(self.learned, self.recipe, example), shape), None
        if isinstance(shape, TriangleMesh):
            logarithms = np.log(np.maximum(scores, np.finfo(float).tiny))
            faces = logarithms[shape.faces].sum(axis=1).argmax(axis=1)
        return Segmentation(scores.argmax(axis=1), faces, scores, self.names)


def carried(seen: Geometry, scores: Floats, shape: Geometry) -> Floats:
    """Return the scores of a shape's points from those of its samples: the nearest three's mean."""
    if seen is shape:
        return scores
    near = min(_CARRIED_BY, seen.n)
    gaps, rows = cKDTree(seen.points).query(shape.points, k=np.arange(1, near + 1))
    weights = 1 / np.maximum(gaps, 1e-9 * float(np.ptp(seen.points, axis=0).max()))
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("nj,njc->nc", weights, scores[rows]))


def _scores(learned: Any, vector: Floats, classes: int) -> Floats:
    """Return the scores of all classes; where a head has none, one for its choice."""
    if len(vector) != learned.n_features_in_:
        raise InvalidInputError(
            "recipe",
            f"give as many numbers as the head was fitted to, {learned.n_features_in_}",
            len(vector),
        )
    scores = np.zeros(classes)
    if hasattr(learned, "predict_proba"):
        scores[learned.classes_] = learned.predict_proba(vector[None])[0]
    else:
        scores[learned.predict(vector[None])[0]] = 1.0
    return scores


@checked
def train_classifier(
    shapes: Sequence[GeometryLike],
    labels: ArrayLike,
    *,
    recipe: Recipe,
    method: Head | Network,
    names: Sequence[str] | None = None,
    training: Training = Training(),  # noqa: B008
    folder: str | os.PathLike[str] | None = None,
    device: str = "cpu",
    progress: bool = False,
) -> Classifier:
    """Learn to tell what shapes are from labelled ones.

    Parameters
    ----------
    shapes : sequence of TriangleMesh or PointCloud
        Examples, s of them, each in its own unit.
    labels : array_like of shape (s,)
        Their classes, counted from 0.
    recipe : Recipe
        How shapes become numbers.
    method : Head or Network
        `NearestNeighbour`, `LinearDiscriminant` or `SupportVectors` of the embeddings of whole
        shapes; or a network of those of their points, whose answers are averaged.
    names : sequence of str, optional
        Of the classes; their numbers by default.
    training : Training
        Of a network; heads have nothing to be trained for.
    folder : path, optional
        Where a network's checkpoints go; the same call goes on from there.
    device : str, default "cpu"
        Where a network is trained: ``"cuda"``. It labels on the CPU. Modes are computed where the
        solver of the recipe does: ``Neo(device="cuda")``.
    progress : bool, default False
        Show it.

    Returns
    -------
    Classifier
        Ready, and to be saved by `save_labeller`.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> from spectra_kit import learn
    >>> meshes = [sk.geometry.sphere(subdivisions=3), sk.geometry.torus(n=600)]
    >>> clouds = [sk.geometry.sample(m.geometry, 400, seed=i) for m in meshes for i in range(3)]
    >>> recipe = learn.Recipe(embeddings=(sk.features.ShapeDNA(count=8),), k=16)
    >>> known = learn.train_classifier(
    ...     clouds, [0, 0, 0, 1, 1, 1], recipe=recipe, names=["ball", "ring"],
    ...     method=learn.LinearDiscriminant(),
    ... )
    >>> [known.classify(m.geometry).name for m in meshes]
    ['ball', 'ring']
    """
    truth = _classes("labels", labels, len(shapes), "shapes")
    called = _names(truth, names)
    if isinstance(method, Head):
        vectors = np.array([recipe.vector(shape) for shape in shapes])
        return Classifier(called, recipe, method, method.fit(vectors, truth), (vectors, truth))
    shown = with_copies(shapes, training)
    model, _ = fit(
        recipe,
        method,
        [prepared(recipe, shape, method.sees)[0] for _, shape in shown],
        [torch.tensor(int(truth[i])) for i, _ in shown],
        classes=len(called),
        training=training,
        folder=None if folder is None else Path(folder),
        device=device,
        progress=progress,
    )
    return Classifier(called, recipe, method, model)


@checked
def train_segmenter(
    shapes: Sequence[GeometryLike],
    labels: Sequence[Annotated[ArrayLike, object]],
    *,
    of: Literal["points", "faces"] = "points",
    recipe: Recipe,
    method: Network,
    names: Sequence[str] | None = None,
    training: Training = Training(),  # noqa: B008
    folder: str | os.PathLike[str] | None = None,
    device: str = "cpu",
    progress: bool = False,
) -> Segmenter:
    """Learn to tell what parts the points of shapes are from labelled ones.

    Parameters
    ----------
    shapes : sequence of TriangleMesh or PointCloud
        Examples, each in its own unit.
    labels : sequence of array_like of shape (n,) or (f,)
        Of the points of each, or of its faces: classes counted from 0, -1 where nothing is known.
    of : {"points", "faces"}, default "points"
        Whose labels these are. Where faces of meshes are labelled, learn from these: a point on the
        border of two parts belongs to both.
    recipe, method, names, training, folder, device, progress
        As of `train_classifier`; the method is a network.

    Returns
    -------
    Segmenter
        Ready, and to be saved by `save_labeller`.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> from spectra_kit import learn
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> high = (ball.points[:, 2] > 0).astype(int)
    >>> height = sk.features.Coordinates()
    >>> known = learn.train_segmenter(
    ...     [ball], [high], recipe=learn.Recipe(embeddings=(height,), upright=True),
    ...     method=learn.PointMLP(width=8), names=["low", "high"],
    ...     training=learn.Training(epochs=150),
    ... )
    >>> told = known.segment(ball)
    >>> bool((told.labels == high).mean() > 0.95), told.face_labels.shape
    (True, (1280,))
    """
    if len(labels) != len(shapes):
        raise InvalidInputError(
            "labels", f"hold an array for each of {len(shapes)} shapes", len(labels)
        )
    if of == "faces" and training.points is not None:
        raise InvalidInputError(
            "points",
            "be None, all points, where labels are of faces",
            training.points,
            advice="sample the meshes themselves, with `Recipe.points`",
        )
    truths = [
        _classes(f"labels[{i}]", some, _count(shape, of, i), of, unknown=True)
        for i, (some, shape) in enumerate(zip(labels, shapes, strict=True))
    ]
    called = _names(np.concatenate([np.empty(0, np.int64), *truths]), names)
    examples, truth, corners = list[Example](), list[Tensor](), list[Tensor]()
    for i, shape in with_copies(shapes, training):
        example, seen = prepared(recipe, shape, method.sees)
        examples.append(example)
        targets, faces = labels_of(seen, shape, truths[i], recipe, of)
        truth.append(targets)
        corners += [] if faces is None else [faces]
    if recipe.points is not None:
        _names(torch.cat(truth).numpy(), called)  # of each class some samples must be left
    model, _ = fit(
        recipe,
        method,
        examples,
        truth,
        classes=len(called),
        training=training,
        corners=corners,
        folder=None if folder is None else Path(folder),
        device=device,
        progress=progress,
    )
    return Segmenter(called, recipe, method, model)


def labels_of(
    seen: Geometry,
    shape: Geometry,
    labels: Ints,
    recipe: Recipe,
    of: Literal["points", "faces"],
) -> tuple[Tensor, Tensor | None]:
    """Return the labels of what is seen of a shape; if these are of faces, their corners, too."""
    if of == "faces" and isinstance(shape, TriangleMesh):
        if recipe.points is None:
            return torch.tensor(labels), torch.tensor(shape.faces, dtype=torch.int64)
        sampled = sample_with_origin(shape, recipe.points, seed=recipe.seed)
        return torch.tensor(labels[sampled.faces]), None
    nearest = slice(None) if seen is shape else cKDTree(shape.points).query(seen.points)[1]
    return torch.tensor(labels[nearest]), None


def _count(shape: Geometry, of: str, i: int) -> int:
    """Return how many labels a shape has."""
    if of == "points":
        return shape.n
    if not isinstance(shape, TriangleMesh):
        raise InvalidInputError(
            f"shapes[{i}]", "be a mesh, where labels are of faces", type(shape).__name__
        )
    return len(shape.faces)


def _classes(name: str, values: ArrayLike, n: int, of: str, *, unknown: bool = False) -> Ints:
    """Return n integers from 0 on, or from -1."""
    array = as_array(name, values)
    if array.shape != (n,):
        raise InvalidInputError(name, f"have shape ({n},), one for each of the {of}", array.shape)
    if array.dtype.kind not in "iu":
        raise InvalidInputError(
            name, "hold integers, the numbers of the classes", f"dtype {array.dtype}"
        )
    lowest = UNKNOWN if unknown else 0
    if array.size and array.min() < lowest:
        raise InvalidInputError(name, f"be {lowest} or more", int(array.min()))
    return array.astype(np.int64)


def _check_names(names: tuple[str, ...]) -> None:
    if len(names) < 2:
        raise InvalidInputError("names", "be of two classes or more", len(names))
    if not all(names) or len(set(names)) < len(names):
        raise InvalidInputError("names", "be words, each for one class", list(names))


def _names(labels: Ints, names: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of all classes, of each of which there is an example."""
    largest = int(labels.max(initial=-1))
    most = _CLASSES if names is None else len(names)
    if largest >= most:
        of = "" if names is None else ", the number of names"
        raise InvalidInputError(
            "labels", f"be less than {most}{of}", largest, advice="labels count from 0"
        )
    called = tuple(map(str, range(largest + 1))) if names is None else tuple(names)
    if names is not None:
        _check_names(called)
    if len(called) < 2:
        raise InvalidInputError("labels", "be of two classes or more", len(called))
    counts = np.bincount(labels[labels >= 0], minlength=len(called))
    if not counts.all():
        missing = int(np.argmin(counts > 0))
        raise InvalidInputError(
            "labels",
            "have an example of each class",
            f"none of class {missing} ({called[missing]!r})",
            advice="number the classes that there are from 0, without gaps",
        )
    return called
