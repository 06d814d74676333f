"""The study of segmentation: networks that learn the parts of shapes, from many examples or few."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from spectra_kit import features as e
from spectra_kit import learn
from spectra_kit._core.files import atomic_path
from spectra_kit._core.fingerprint import arrays_digest
from spectra_kit._core.types import Floats, Ints
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.learn.examples import Example, prepared
from spectra_kit.learn.fitting import Model, fit, predicted, with_copies
from spectra_kit.learn.labellers import Segmenter, carried, labels_of
from studies.learning.classification import OF_POINTS, SOLVERS, SOURCES, View
from studies.learning.labelled import LabelledSet
from studies.store import Record
from studies.study import Study

POINTS = 2048  #: Of a cloud.
K = 96  #: Modes.
_LOOKS = 40  # at the test shapes, for the curve
COPIES = 15  #: Stretched ones of each, where there are few examples.

EMBEDDINGS: dict[str, e.Embedding] = {**OF_POINTS, "global": e.GlobalPointSignature(count=16)}
NETWORKS: dict[str, learn.Network] = {
    "diffusion": learn.DiffusionNet(dropout=0.2),
    "mlp": learn.PointMLP(),
    "pointnet": learn.PointNet(width=64),
    "pointnet++": learn.Hierarchical(backbone="pointnet++", width=53),
    "point-transformer": learn.Hierarchical(backbone="point-transformer", width=53),
}


class PartsRow(NamedTuple):
    """A row of the table: a set, what is seen of its shapes, and what learns from how many."""

    set: str
    view: View
    embedding: str
    method: str
    shots: int = 0  #: Labelled shapes, 0 for all of the training split.
    upright: bool = False  #: See `Recipe`.

    def __str__(self) -> str:
        of = f"{self.shots} shapes" if self.shots else "all"
        stand = "; upright" * self.upright
        return f"{self.set}: {self.embedding}, {self.method}; {self.view}; {of}{stand}"


# --- the rows of the table ---

_EXACT, _PREDICTED_MESH = View("mesh", "exact"), View("mesh", "predicted")
_PREDICTED = View("cloud", "predicted")
_SIGNATURES = "heat+waves+global"


def parts_rows(name: str) -> list[PartsRow]:
    """Return the rows of the table of segmenters for a set."""
    both = f"{_SIGNATURES}+coordinates"
    if name != "human":  # all others stand alike
        return [
            PartsRow(name, _EXACT, both, "diffusion", upright=True),
            PartsRow(name, _EXACT, _SIGNATURES, "diffusion"),
            PartsRow(name, _EXACT, "coordinates", "diffusion", upright=True),
            PartsRow(name, _PREDICTED_MESH, both, "diffusion", upright=True),
        ]
    return [
        PartsRow(name, _EXACT, _SIGNATURES, "diffusion"),
        PartsRow(name, _EXACT, both, "diffusion"),
        PartsRow(name, _EXACT, "coordinates", "diffusion"),
        PartsRow(name, _PREDICTED_MESH, _SIGNATURES, "diffusion"),
        PartsRow(name, _PREDICTED, _SIGNATURES, "diffusion"),
        PartsRow(name, _EXACT, both, "diffusion", 10),
        PartsRow(name, _EXACT, _SIGNATURES, "diffusion", 10),
        PartsRow(name, _EXACT, "coordinates", "diffusion", 10),
        PartsRow(name, _EXACT, _SIGNATURES, "mlp"),
        PartsRow(name, _EXACT, "neo", "mlp"),
        PartsRow(name, _EXACT, "encoding", "mlp"),
        PartsRow(name, _EXACT, "neo-mass-free", "pointnet++"),
        PartsRow(name, _EXACT, "neo-base-mass-free", "pointnet++"),
        PartsRow(name, _EXACT, "coordinates", "pointnet++"),
    ]


# --- what is measured ---


@dataclass(frozen=True, eq=False, kw_only=True)
class Parts(Study[PartsRow, int]):
    """How well the parts of test shapes are told; problems are seeds."""

    name: ClassVar[str] = "parts"
    version: ClassVar[int] = 2
    sources: ClassVar[tuple[str, ...]] = (*SOURCES, "learn/*.py")
    fresh: ClassVar[bool] = False

    sets: dict[str, LabelledSet]
    epochs: int = 40
    validated: bool = False  #: Tested on a part of the training split that is held out, instead.

    def training(self, row: PartsRow, seed: int) -> learn.Training:
        """Return how a network is trained: of a few shapes, with stretched copies of each."""
        return learn.Training(epochs=self.epochs, copies=COPIES * bool(row.shots), seed=seed)

    def facts(self, contender: PartsRow, problem: int) -> dict[str, object]:
        return {
            "set": self.sets[contender.set].digest,
            "recipe": repr(recipe_of(contender, problem)),
            "network": repr(NETWORKS[contender.method]),
            "split": arrays_digest(
                *self._split(self.sets[contender.set], contender.shots, problem)
            ),
            "training": repr(self.training(contender, problem)),
            "validated": self.validated,
        }

    def measure(self, contender: PartsRow, problem: int) -> Record:
        """Train, test after each epoch and at the end, also turned; keep labels and the network."""
        shapes, recipe = self.sets[contender.set], recipe_of(contender, problem)
        known, tested = self._split(shapes, contender.shots, problem)
        network = NETWORKS[contender.method]
        training = self.training(contender, problem)
        own = with_copies([shapes.meshes[i] for i in known], training)
        seen = [_Seen(shapes, int(known[i]), mesh, recipe, network) for i, mesh in own]
        shown = [_Seen(shapes, i, shapes.meshes[i], recipe, network) for i in tested.tolist()]
        step = max(1, training.epochs // _LOOKS)

        def watch(model: Model, epoch: int) -> dict[str, float]:
            if epoch % step and epoch != training.epochs:
                return {}
            model.eval()
            return marks(shapes, [(one.number, one.scores(model, recipe)) for one in shown])

        folder = self.file(contender, problem, "")
        model, curve = fit(
            recipe,
            network,
            [one.example for one in seen],
            [one.labels for one in seen],
            classes=len(shapes.classes),
            training=training,
            corners=[one.corners for one in seen if one.corners is not None],
            folder=folder,
            watch=watch,
        )
        names = tuple(shapes.classes)
        segmenter = Segmenter(names, recipe, network, model)
        turned = []
        rng = np.random.default_rng([problem, 1])
        for i in tested.tolist():
            mesh = shapes.meshes[i]
            points = mesh.points @ Rotation.random(rng=rng).as_matrix().T
            turned.append((i, segmenter.segment(TriangleMesh(points, mesh.faces)).scores))
        scores = {one.number: one.scores(model, recipe) for one in shown}
        labels = {f"{number}": told.argmax(axis=1) for number, told in scores.items()}
        learned = {_content(shapes, i) for i in known}
        unseen = [(i, told) for i, told in scores.items() if _content(shapes, i) not in learned]
        arrays = self.file(contender, problem, ".npz")
        saved = self.file(contender, problem, ".safetensors")
        with atomic_path(arrays) as part:
            np.savez(part, **labels)
        learn.save_labeller(saved, segmenter)
        return {
            **{name: value for name, value in curve[-1].items() if name != "epoch"},
            "turned": marks(shapes, turned),
            "seen": len(scores) - len(unseen),  # in training, too: some sets hold shapes twice
            "unseen": marks(shapes, unseen) if unseen else None,
            "curve": [[one["epoch"], one["iou"]] for one in curve if "iou" in one],
            "weights": sum(p.numel() for p in model.parameters()),
            "examples": len(known),
            "files": [str(path.relative_to(self.folder)) for path in (arrays, saved)],
        }

    def _split(self, shapes: LabelledSet, shots: int, seed: int) -> tuple[Ints, Ints]:
        order = np.random.default_rng(seed).permutation(shapes.train)
        tested = shapes.test
        if self.validated:  # some sets hold shapes twice
            tested = shapes.held_out(seed)
            held = {_content(shapes, i) for i in tested}
            order = np.array([i for i in order if _content(shapes, i) not in held], dtype=np.int64)
        if not (len(tested) and len(order)):
            raise InvalidInputError(
                "set", "have shapes to learn from and others to test on", shapes.name
            )
        if shots > len(order):
            raise InvalidInputError("shots", f"be at most {len(order)}", shots)
        return order[:shots] if shots else order, tested


def _content(shapes: LabelledSet, i: int) -> str:
    mesh = shapes.meshes[i]
    return arrays_digest(mesh.points, mesh.faces)


def recipe_of(row: PartsRow, seed: int) -> learn.Recipe:
    """Return how a row's shapes become numbers."""
    return learn.Recipe(
        embeddings=tuple(EMBEDDINGS[name] for name in row.embedding.split("+")),
        k=K,
        solver=SOLVERS[row.view.solver],
        upright=row.upright,
        points=POINTS if row.view.kind == "cloud" else None,
        seed=seed if row.view.kind == "cloud" else 0,
    )


_prepared: dict[tuple[str, str, str, bool], tuple[Example, Geometry]] = {}


class _Seen:
    """A shape as a network sees it, with the labels of what it sees."""

    def __init__(
        self,
        shapes: LabelledSet,
        i: int,
        mesh: Geometry,
        recipe: learn.Recipe,
        network: learn.Network,
    ) -> None:
        assert isinstance(mesh, TriangleMesh)  # and so is a stretched one
        self.number, self.mesh = i, mesh
        content = arrays_digest(mesh.points, mesh.faces)
        key = (shapes.digest, content, repr(recipe), bool(network.sees))
        if _prepared and next(iter(_prepared))[::2] != key[::2]:
            _prepared.clear()  # one recipe at a time
        if key not in _prepared:
            _prepared[key] = prepared(recipe, self.mesh, network.sees)
        self.example, self.seen = _prepared[key]
        if recipe.points is None:
            self.seen = mesh  # what is kept may be of another shape of the same points
        truth = shapes.face_labels[i]
        self.labels, self.corners = labels_of(self.seen, mesh, truth, recipe, "faces")

    def scores(self, model: Model, recipe: learn.Recipe) -> Floats:
        """Return scores of the mesh's vertices."""
        return carried(self.seen, predicted(model, recipe, self.example), self.mesh)


def marks(shapes: LabelledSet, answers: Sequence[tuple[int, Floats]]) -> dict[str, float]:
    """Mark scores of the vertices of some shapes, of all together.

    ``iou``: mean over the classes of intersection over union, by area of faces, each shape of area
    one: sets mix units. ``area``, ``faces``
    and ``vertices``: shares of these that are told right. ``edges``: share by area of edges whose
    class is that of a face beside it, as MeshCNN counts.
    """
    classes = len(shapes.classes)
    confused = np.zeros((classes, classes))
    right: dict[str, list[Floats]] = {"faces": [], "vertices": [], "edges": [], "weights": []}
    for i, scores in answers:
        mesh, truth = shapes.meshes[i], shapes.face_labels[i]
        logarithms = np.log(np.maximum(scores, np.finfo(float).tiny))
        faces = logarithms[mesh.faces].sum(axis=1).argmax(axis=1)
        np.add.at(confused, (truth, faces), mesh.face_areas / mesh.area)  # each shape counts alike
        right["faces"].append(faces == truth)
        right["vertices"].append(scores.argmax(axis=1) == shapes.vertex_labels[i])
        edges, weights = _edges_right(mesh, truth, logarithms)
        right["edges"].append(edges)
        right["weights"].append(weights / weights.sum())
    hit = np.diag(confused)
    with np.errstate(invalid="ignore"):
        iou = hit / (confused.sum(axis=0) + confused.sum(axis=1) - hit)
    found = {name: np.concatenate(values) for name, values in right.items()}
    return {
        "iou": float(np.nanmean(iou)),
        "area": float(hit.sum() / confused.sum()),
        "faces": float(found["faces"].mean()),
        "vertices": float(found["vertices"].mean()),
        "edges": float(found["edges"] @ found["weights"] / found["weights"].sum()),
    }


def _edges_right(mesh: TriangleMesh, truth: Ints, logarithms: Floats) -> tuple[Floats, Floats]:
    """Return which edges are told right, by their ends, and a third of the area beside each."""
    ends = np.sort(np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=-1), axis=-1)
    edges, edge = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    said = logarithms[edges].sum(axis=1).argmax(axis=1)
    edge = edge.ravel()
    beside = said[edge] == np.repeat(truth, 3)
    right = np.bincount(edge, beside, minlength=len(edges)) > 0
    weights = np.bincount(edge, np.repeat(mesh.face_areas, 3), minlength=len(edges)) / 3
    return right.astype(np.float64), weights
