"""The two studies of classification: `Vectors` of shapes, and `Draws` of examples to learn from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from spectra_kit import features as e
from spectra_kit import learn
from spectra_kit._core.files import atomic_path
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count
from spectra_kit.eigen import Automatic, Eigensolver, Neo
from spectra_kit.eigen.subspaces import AmbientFourier
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, PointCloud, TriangleMesh, sample
from spectra_kit.learn.examples import Example, prepared
from spectra_kit.learn.fitting import fit, predicted, with_copies
from spectra_kit.neo import NeoSubspace
from studies.learning.labelled import LabelledSet
from studies.store import Record, Store
from studies.study import Result, Study, run

#: What embeddings depend on.
SOURCES = (
    *(f"{room}/**/*.py" for room in ("geometry", "_sparse", "operators", "eigen", "features")),
    "neo/*.py",
)
POINTS = 2048  #: Of a cloud.
K = 96  #: Modes.
_PART = 50  # shapes of one measurement of vectors
#: Shapes that a network is shown, whatever the number of examples: an hour of a core at most.
SHOWN = 30_000
COPIES = 7  #: Of each example, stretched.
_SEEN = 512  # points of each at a time; all of them in tests

SOLVERS: dict[str, Eigensolver] = {"exact": Automatic(), "predicted": Neo()}
#: Of whole shapes, for heads; side by side, as rows name them: ``waves+dna``.
WHOLE: dict[str, e.Embedding] = {
    "dna": e.ShapeDNA(count=45),
    "heat": e.HeatKernelSignature(),
    "waves": e.WaveKernelSignature(count=32, width=1.5, first=3),
    "all-waves": e.WaveKernelSignature(),
    "global": e.GlobalPointSignature(),
}
#: Of points, for networks.
OF_POINTS: dict[str, e.Embedding] = {
    "neo-mass-free": e.BasisFunctions(subspace=NeoSubspace(), masses=False),
    "neo-base-mass-free": e.BasisFunctions(subspace=NeoSubspace("base"), masses=False),
    "neo": e.BasisFunctions(subspace=NeoSubspace()),
    "plane-waves": e.BasisFunctions(subspace=AmbientFourier(m=132, bandwidth=7.0)),
    "encoding": e.PositionalEncoding(),
    "coordinates": e.Coordinates(),
    "heat": e.HeatKernelSignature(),
    "waves": e.WaveKernelSignature(),
    "global": e.GlobalPointSignature(),
}
HEADS: dict[str, learn.Head] = {
    "nearest": learn.NearestNeighbour(),
    "discriminant": learn.LinearDiscriminant(),
    "support": learn.SupportVectors(),
}
#: About 60,000 weights each, but for what the inputs take.
NETWORKS: dict[str, learn.Network] = {
    "pointnet": learn.PointNet(width=48),
    "pointnet++": learn.Hierarchical(backbone="pointnet++", width=40, features=False),
    "point-transformer": learn.Hierarchical(backbone="point-transformer", width=40, features=False),
}


class View(NamedTuple):
    """What is seen of shapes: ``mesh`` or ``cloud``, whose modes are exact or predicted."""

    kind: Literal["mesh", "cloud"]
    solver: str
    turned: bool = False

    def __str__(self) -> str:
        return f"{self.kind}, {self.solver}" + (", turned" if self.turned else "")


class Part(NamedTuple):
    """Some shapes, sampled with a seed."""

    seed: int
    start: int
    stop: int

    def __str__(self) -> str:
        return f"seed {self.seed}, {self.start} to {self.stop}"


class Row(NamedTuple):
    """A row of the table, at a number of examples a class."""

    view: View
    embedding: str
    method: str
    shots: int = 0  #: 0 for all of the row.

    def __str__(self) -> str:
        return f"{self.embedding}, {self.method}; {self.view}" + f"; {self.shots}" * (
            self.shots > 0
        )

    @property
    def trained(self) -> bool:
        """Whether its method is a network."""
        return self.method in NETWORKS


NamedRow = TypeVar("NamedRow")

# --- the rows of the table ---

_MESH, _CLOUD = View("mesh", "exact"), View("cloud", "exact")
_PREDICTED = View("cloud", "predicted")

#: Without any training, in minutes.
FREE = [
    Row(view, embedding, method)
    for view in (_MESH, _CLOUD, _PREDICTED)
    for embedding, method in (
        ("dna", "nearest"),
        ("heat", "nearest"),
        ("waves", "nearest"),
        ("waves+dna", "nearest"),
        ("waves+dna", "discriminant"),
        ("waves+dna", "support"),
        ("heat+waves+dna", "nearest"),
        ("heat+waves+dna", "discriminant"),
    )
]
#: Networks, on clouds: the paper's way, and its rivals.
TRAINED = [
    Row(_PREDICTED, embedding, method)
    for embedding, method in (
        ("neo-mass-free", "pointnet"),
        ("neo-base-mass-free", "pointnet"),
        ("neo", "pointnet"),
        ("global", "pointnet"),
        ("heat+waves", "pointnet"),
        ("plane-waves", "pointnet"),
        ("encoding", "pointnet"),
        ("coordinates", "pointnet"),
        ("coordinates", "pointnet++"),
        ("coordinates", "point-transformer"),
    )
]


def rows_named(names: Iterable[str], rows: Iterable[NamedRow]) -> list[NamedRow]:
    """Return rows by their names in the table."""
    known = {str(row): row for row in rows}
    for name in names:
        if name not in known:
            raise InvalidInputError("rows", f"be of these: {' | '.join(known)}", repr(name))
    return [known[name] for name in names]


# --- vectors ---


def shape_of(shapes: LabelledSet, i: int, kind: str, *, seed: int, turned: bool) -> Geometry:
    """Return a shape as a mesh, or as a cloud of random points; turned at random."""
    mesh = shapes.meshes[i]
    shape: Geometry = mesh if kind == "mesh" else sample(mesh, POINTS, seed=1000 * seed + i)
    if not turned:
        return shape
    rotation = Rotation.random(rng=np.random.default_rng([seed, i])).as_matrix()
    points = shape.points @ rotation.T
    return TriangleMesh(points, mesh.faces) if kind == "mesh" else PointCloud(points)


@dataclass(frozen=True, eq=False, kw_only=True)
class Vectors(Study[View, Part]):
    """The embeddings `WHOLE` of the shapes of a set, and of the test split also turned.

    Where they are validated no shape of the test split is embedded.
    """

    name: ClassVar[str] = "vectors"
    sources: ClassVar[tuple[str, ...]] = SOURCES
    fresh: ClassVar[bool] = False

    shapes: LabelledSet
    seeds: Sequence[int] = ()
    validated: bool = False  #: There is only something to choose, by the training split.

    def tasks(self) -> Iterable[tuple[View, Part, int]]:
        every = (
            (view, part, 0)
            for seed in self.seeds
            for view in self.contenders
            for part in self.parts(view, seed)
        )
        return list(dict.fromkeys(every))

    def parts(self, view: View, seed: int) -> list[Part]:
        """Cut all shapes into parts; meshes that are not turned are the same for all seeds."""
        own = seed if view.kind == "cloud" or view.turned else 0
        count = len(self.shapes.meshes)
        return [Part(own, start, min(start + _PART, count)) for start in range(0, count, _PART)]

    def _numbers(self, view: View, part: Part) -> list[int]:
        is_train = self.shapes.is_train
        left_out = ~is_train if self.validated else is_train & view.turned
        return [i for i in range(part.start, part.stop) if not left_out[i]]

    def facts(self, contender: View, problem: Part) -> dict[str, object]:
        solver = SOLVERS[contender.solver]
        return {
            "set": self.shapes.digest,
            "view": [contender.kind, repr(solver), contender.turned],
            "part": [problem.seed, self._numbers(contender, problem)],
            "embeddings": {name: repr(embedding) for name, embedding in WHOLE.items()},
            "size": [POINTS, K],
        }

    def measure(self, contender: View, problem: Part) -> Record:
        """Embed into the file."""
        numbers = self._numbers(contender, problem)
        vectors: dict[str, list[Floats]] = {name: [] for name in WHOLE}
        for i in numbers:
            shape = shape_of(
                self.shapes, i, contender.kind, seed=problem.seed, turned=contender.turned
            )
            surface = e.Surface(shape, min(K, shape.n // 2), SOLVERS[contender.solver])
            for name, embedding in WHOLE.items():
                vectors[name].append(embedding.of_all(surface))
        path = self.file(contender, problem, ".npz")
        with atomic_path(path) as part:
            np.savez(part, **{name: np.array(rows) for name, rows in vectors.items() if rows})  # type: ignore[arg-type]
        return {"files": [str(path.relative_to(self.folder))]}

    def of(self, numbers: Ints, view: View, seed: int, embedding: str) -> Floats:
        """Return the vectors (s, c) of some shapes."""
        known: dict[int, Floats] = {}
        for part in self.parts(view, seed):
            if there := self._numbers(view, part):
                file = _loaded(self.file(view, part, ".npz"))
                rows = np.column_stack([file[name] for name in embedding.split("+")])
                known |= zip(there, rows, strict=True)
        return np.array([known[i] for i in numbers.tolist()])


@lru_cache(maxsize=64)
def _loaded(path: Path) -> dict[str, Floats]:
    with np.load(path) as file:
        return dict(file)


@dataclass(frozen=True, eq=False, kw_only=True)
class Draws(Study[Row, int]):
    """Shares of test shapes that are told right, after learning from a few; problems are seeds.

    Where its vectors are validated, they are told of what the training split has left, and nothing
    is turned.
    """

    name: ClassVar[str] = "draws"
    version: ClassVar[int] = 2
    sources: ClassVar[tuple[str, ...]] = (*SOURCES, "learn/*.py")
    fresh: ClassVar[bool] = False

    shapes: LabelledSet
    vectors: Vectors  #: Of all views of all seeds.
    draws: int = 10  #: For each seed; of networks one.
    missing: Mapping[tuple[View, Part], str] = field(default_factory=dict)  #: Why no vectors.

    @property
    def validated(self) -> bool:
        """Whether they are told of what the training split has left, instead of test shapes."""
        return self.vectors.validated

    def views(self, view: View) -> list[View]:
        """Return how the tested shapes are seen: as in this view, and turned."""
        return [view] if self.validated else [view, view._replace(turned=True)]

    def facts(self, contender: Row, problem: int) -> dict[str, object]:
        network = NETWORKS.get(contender.method)
        embedding = [repr(x) for x in _embeddings(contender)]
        view = contender.view
        return {
            "vectors": self.vectors.key(view, self.vectors.parts(view, problem)[0]),
            "seed": problem,
            "embedding": embedding,
            "method": repr(network or HEADS[contender.method]),
            "training": repr(training_of(contender, 1, 0)) if network else None,
            "shots": contender.shots,
            "draws": 1 if network else self.draws,
            "validated": self.validated,
        }

    def excuse(self, contender: Row, problem: int, before: Sequence[Result[Row, int]]) -> str:
        """See `Study`; heads need vectors."""
        needed = [] if contender.trained else self.views(contender.view)
        parts = ((view, part) for view in needed for part in self.vectors.parts(view, problem))
        return next((self.missing[key] for key in parts if key in self.missing), "")

    def measure(self, contender: Row, problem: int) -> Record:
        """Draw, learn and test."""
        classes, right, turned = len(self.shapes.classes), [], []
        confused = np.zeros((classes, classes), dtype=np.int64)
        learn = _by_network if contender.trained else _by_head
        for draw in range(1 if contender.trained else self.draws):
            known, tested = drawn(
                self.shapes, contender.shots, [problem, draw], validated=self.validated
            )
            truth = _labels(self.shapes)[tested]
            there, *moved = learn(self, contender, problem, known, tested)
            right.append(float((there == truth).mean()))
            turned += [float((taken == truth).mean()) for taken in moved]
            np.add.at(confused, (truth, there), 1)
        return {"right": right, "turned": turned, "confused": confused.tolist()}


def drawn(
    shapes: LabelledSet, shots: int, seed: list[int], *, validated: bool
) -> tuple[Ints, Ints]:
    """Return shapes to learn from, so many of each class, and shapes to test on."""
    check_count("shots", shots, low=1)
    rng, labels = np.random.default_rng(seed), _labels(shapes)
    known, left = [], []
    for label in range(len(shapes.classes)):
        own = rng.permutation(np.flatnonzero(shapes.is_train & (labels == label)))
        if len(own) < shots + validated:
            raise InvalidInputError(
                "shots", f"be at most {len(own) - validated}, as class {label} has", shots
            )
        known.append(own[:shots])
        left.append(own[shots:])
    return np.concatenate(known), np.concatenate(left) if validated else shapes.test


def most_shots(shapes: LabelledSet) -> int:
    """Return how many examples there are of the smallest class."""
    return int(np.bincount(_labels(shapes)[shapes.train]).min())


def _labels(shapes: LabelledSet) -> Ints:
    assert shapes.labels is not None
    return shapes.labels


def _embeddings(row: Row) -> tuple[e.Embedding, ...]:
    table = OF_POINTS if row.trained else WHOLE
    return tuple(table[name] for name in row.embedding.split("+"))


def _by_head(
    study: Draws, row: Row, seed: int, known: Ints, tested: Ints
) -> list[NDArray[np.int64]]:
    """Return what the tested shapes are taken for in each view."""
    vectors = study.vectors
    examples = vectors.of(known, row.view, seed, row.embedding)
    head = HEADS[row.method].fit(examples, _labels(study.shapes)[known])
    return [
        head.predict(vectors.of(tested, view, seed, row.embedding))
        for view in study.views(row.view)
    ]


def _by_network(
    study: Draws, row: Row, seed: int, known: Ints, tested: Ints
) -> list[NDArray[np.int64]]:
    """Train a network, and return what it takes the tested shapes for in each view."""
    network, recipe = NETWORKS[row.method], _recipe(row)
    training = training_of(row, len(known), seed)
    clouds = [
        shape_of(study.shapes, i, row.view.kind, seed=seed, turned=False) for i in known.tolist()
    ]
    own = with_copies(clouds, training)
    model, _ = fit(
        recipe,
        network,
        [prepared(recipe, cloud)[0] for _, cloud in own],
        [torch.tensor(int(_labels(study.shapes)[known[i]])) for i, _ in own],
        classes=len(study.shapes.classes),
        training=training,
    )
    found = []
    for view in study.views(row.view):
        shown = (_example(study.shapes, row, i, seed, view.turned) for i in tested.tolist())
        found.append(np.array([predicted(model, recipe, one).argmax() for one in shown]))
    return found


def training_of(row: Row, examples: int, seed: int) -> learn.Training:
    """Return how a network is trained that learns from so many examples."""
    epochs = max(1, SHOWN // (examples * (1 + COPIES)))
    return learn.Training(
        epochs=epochs, batch=16, points=_SEEN, copies=COPIES, smoothing=0.0, seed=seed
    )


def _recipe(row: Row) -> learn.Recipe:
    """Return the recipe of a row: of what a network learns from, once it is prepared."""
    return learn.Recipe(embeddings=_embeddings(row), k=K, solver=SOLVERS[row.view.solver], seed=0)


_prepared: dict[tuple[object, ...], Example] = {}


def _example(shapes: LabelledSet, row: Row, i: int, seed: int, turned: bool) -> Example:
    """Return a shape as a network of a row sees it; those of one embedding and seed are kept."""
    held = (shapes.digest, row.embedding, row.view.kind, row.view.solver, seed)
    if _prepared and next(iter(_prepared))[:-2] != held:
        _prepared.clear()
    key = (*held, i, turned)
    if key not in _prepared:
        shape = shape_of(shapes, i, row.view.kind, seed=seed, turned=turned)
        _prepared[key] = prepared(_recipe(row), shape)[0]
    return _prepared[key]


def classify_all(draws: Draws, *, jobs: int = 1, progress: bool = False) -> list[Result[Row, int]]:
    """Measure what is not remembered, after the vectors for it."""
    store = Store(draws.folder)
    heads = [row for row in draws.contenders if not row.trained]
    views = {view: None for row in heads for view in draws.views(row.view)}
    vectors = replace(draws.vectors, contenders=list(views), seeds=list(draws.problems))
    made = run(vectors, store, jobs=jobs, retry=True, progress=progress)
    missing = {(r.contender, r.problem): f"{r.problem}: {r.reason}" for r in made if not r.ok}
    return run(
        replace(draws, vectors=vectors, missing=missing),
        store,
        jobs=jobs,
        retry=True,
        progress=progress,
    )
