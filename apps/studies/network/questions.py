"""The questions: which methods on which cases."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError
from studies.network import findings as found
from studies.network.accuracy import Accuracy
from studies.network.cases import Case
from studies.network.findings import Labels, Row
from studies.network.methods import (
    Method,
    Poses,
    Precision,
    check_labels,
    functions_of,
    joined,
    label,
    network,
    waves,
)
from studies.shapes import Shape
from studies.store import Store
from studies.study import Result, run

_LARGE = 16_384  # points: an exact solve takes seconds beyond
_PRECISIONS: tuple[Precision, ...] = ("float32", "bfloat16", "float16")
Places = Iterable[tuple[Labels, tuple[Case, ...]]]
Methods = Iterable[tuple[Labels, Method]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Settings:
    """What all questions are asked about."""

    sets: Mapping[str, tuple[Shape, ...]]  #: statistics are taken over each
    weights: Sequence[str]  #: questions about one network take the first
    agnostic: Sequence[str] = ()  #: networks that were trained without masses
    k: int = 96  #: modes
    points: Sequence[int] = (512, 2048, 8192, 65536)  #: sampled on every shape
    focus: int = 8192  #: points where a question looks at one number of them
    poses: Sequence[Poses] = (1, 2, 4)
    fourier: Sequence[int] = (640,)  #: plane waves, beside as many as a network has functions
    few: int | None = None  #: shapes of each set on clouds of more than 16,384 points
    bandwidths: Sequence[float] = (7.0, 10.0)  #: comparisons are made with the best
    sigma: float = 0.25  #: of non-uniform samples
    rotations: int = 10  #: of each cloud
    device: str = "cpu"

    def __post_init__(self) -> None:
        if not any(self.sets.values()) or not self.weights:
            raise InvalidInputError(
                "`sets` and `weights` must hold at least one shape and one network, got"
                f" {sum(map(len, self.sets.values()))} and {len(self.weights)}"
            )
        check_count("k", self.k, low=1)
        check_labels([*self.weights, *self.agnostic])

    def network(self, weights: str | None = None, **options: Any) -> Method:
        """Return a network on the device of the settings, by default the first."""
        return network(weights or self.weights[0], device=self.device, **options)

    def waves(self, m: int, **options: Any) -> list[Method]:
        """Return m plane waves at every bandwidth."""
        return [waves(m, bandwidth, device=self.device, **options) for bandwidth in self.bandwidths]


@dataclass(frozen=True, eq=False)
class Question:
    """Each of some methods in each of some places is a row of a table."""

    title: str
    places: Callable[[Settings], Places]  #: cases that are summarised together, with labels
    methods: Callable[[Settings], Methods]  #: with labels that tell them apart
    #: Labels of the rows that others are compared with, each in a column of its own.
    against: tuple[Labels, ...] = ()


@dataclass(frozen=True, eq=False)
class Answer:
    """What was found: rows of the table."""

    name: str  #: of the question
    study: Accuracy  #: that measured it
    rows: tuple[Row, ...]
    results: tuple[Result[Method, Case], ...]

    @property
    def question(self) -> Question:
        """What was asked."""
        return QUESTIONS[self.name]


def ask(name: str, settings: Settings, store: Store, *, progress: bool = False) -> Answer:
    """Measure what a question needs and the store does not hold."""
    question = QUESTIONS[name]
    places, methods = list(question.places(settings)), list(question.methods(settings))
    study = Accuracy(
        folder=store.folder,
        contenders=[method for _, method in methods],
        problems=[case for _, cases in places for case in cases],
        k=settings.k,
    )
    results = run(study, store, jobs=0, retry=True, progress=progress)
    by_pair = {(result.contender, result.problem): result for result in results}
    rows = []
    for (place, cases), (which, method) in itertools.product(places, methods):
        these = [by_pair[method, case] for case in cases if (method, case) in by_pair]
        if these:
            rows.append(_row({**place, **which}, method, these))
    return Answer(name, study, tuple(rows), tuple(results))


def _row(labels: Labels, method: Method, results: Sequence[Result[Method, Case]]) -> Row:
    good = [result for result in results if result.ok]
    return Row(
        labels,
        method,
        cases=tuple(result.problem for result in good),
        records=tuple(result.record for result in good),
    )


def _sampled(settings: Settings, points: Sequence[int]) -> Places:
    for models, shapes in settings.sets.items():
        for n in points:
            few = shapes[: settings.few] if n > _LARGE else shapes
            cases = tuple(Case(shape=shape, points=n) for shape in few)
            yield {"models": models, "points": n}, cases


def _everywhere(settings: Settings) -> Places:
    return _sampled(settings, settings.points)


def _where_m_matters(settings: Settings) -> Places:
    sizes = sorted({2048, settings.focus} & set(settings.points)) or [settings.focus]
    return _sampled(settings, sizes)


def _densities(settings: Settings) -> Places:
    for models, shapes in settings.sets.items():
        for density, sigma in (("uniform", None), ("non-uniform", settings.sigma)):
            yield (
                {"models": models, "sampling": density},
                tuple(Case(shape=shape, points=settings.focus, sigma=sigma) for shape in shapes),
            )


def _operators(settings: Settings) -> Places:
    recipes: dict[str, dict[str, Any]] = {
        found.CLOUD: {"points": settings.focus},
        "cloud, k-NN graph": {"points": settings.focus, "operator": "knn"},
        "mesh, robust": {"points": None},
        "mesh, cotangent": {"points": None, "operator": "cotan"},
    }
    for models, shapes in settings.sets.items():
        for operator, recipe in recipes.items():
            cases = tuple(Case(shape=shape, **recipe) for shape in shapes)
            yield {"models": models, "operator": operator}, cases


def _rotations(settings: Settings) -> Places:
    for models, shapes in settings.sets.items():
        for shape in shapes:
            yield (
                {"models": models, "model": shape.name},
                tuple(
                    Case(shape=shape, points=settings.focus, rotation=seed)
                    for seed in range(settings.rotations)
                ),
            )


def _clouds_and_meshes(settings: Settings) -> Places:
    yield from _sampled(settings, [settings.focus])
    for models, shapes in settings.sets.items():
        cases = tuple(Case(shape=shape, points=None) for shape in shapes)
        yield {"models": f"{models}, own meshes"}, cases


def _one(settings: Settings) -> Methods:
    return [({}, settings.network())]


def _all(settings: Settings) -> Methods:
    methods: list[Method] = []
    for weights in settings.weights:
        one = settings.network(weights)
        methods += [settings.network(weights, poses=poses) for poses in settings.poses]
        rivals = settings.waves(1 + functions_of(weights))
        methods += [*rivals, *(joined([one, rival]) for rival in rivals)]
    for m in settings.fourier:
        methods += settings.waves(m)
    # Each once: networks of one size have the same rivals.
    return [({"solver": name}, one) for name, one in {one.name: one for one in methods}.items()]


def _smoothed(settings: Settings) -> Methods:
    """Each as it predicts, after one step, and as `Neo` goes on by default."""
    m = 1 + functions_of(settings.weights[0])
    for steps in found.STEPS:
        yield {"steps": steps}, settings.network(steps=steps)
        yield from (({"steps": steps}, rival) for rival in settings.waves(m, steps=steps))


def _precisions(settings: Settings) -> Methods:
    return [({"precision": dtype}, settings.network(dtype=dtype)) for dtype in _PRECISIONS]


def _attentions(settings: Settings) -> Methods:
    yield {"attention": found.AWARE}, settings.network()
    yield {"attention": "masses of one"}, settings.network(weighted=False)
    for weights in settings.agnostic:
        name = f"trained without ({label(weights)})"
        yield {"attention": name}, settings.network(weights)


def _sizes(settings: Settings) -> Methods:
    for weights in sorted(settings.weights, key=functions_of):
        yield {"m": functions_of(weights), "weights": label(weights)}, settings.network(weights)


QUESTIONS: dict[str, Question] = {
    "accuracy": Question("Accuracy and time", _everywhere, _all, ({"points": 8192},)),
    "precision": Question(
        "Precision of the network", _everywhere, _precisions, ({"precision": "float32"},)
    ),
    "sampling": Question(
        "Sampling density and masses",
        _densities,
        _attentions,
        ({"sampling": "uniform"}, {"attention": found.AWARE}),
    ),
    "operators": Question(
        "Transfer to other Laplacians", _operators, _one, ({"operator": found.CLOUD},)
    ),
    "redundancy": Question("Redundancy", _where_m_matters, _sizes),
    "rotation": Question("Rotations", _rotations, _one),
    "models": Question("Model by model", _clouds_and_meshes, _smoothed),
}
