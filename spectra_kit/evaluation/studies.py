"""The questions: which methods on which cases, and what follows from the answers.

A study plans lines of a table (one method on many cases each); `run_study` has them measured and
draws the ratios and verdicts from them. `findings` holds the arithmetic.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from spectra_kit.errors import InvalidInputError
from spectra_kit.evaluation.bench import ROOM, Bench, Measurement
from spectra_kit.evaluation.cases import Case
from spectra_kit.evaluation.findings import (
    Finding,
    Row,
    accuracy_findings,
    operator_findings,
    precision_findings,
    redundancy_findings,
    rotation_findings,
    sampling_findings,
    worst_findings,
)
from spectra_kit.evaluation.methods import (
    Method,
    Precision,
    Weights,
    check_names,
    fourier,
    joined,
    neo,
)
from spectra_kit.evaluation.models import Model

Labels = Mapping[str, str | int]
_LARGE = 16_384  # points: an exact solve takes seconds beyond


@dataclass(frozen=True, eq=False, kw_only=True)
class Settings:
    """What all studies are run on and with.

    Attributes
    ----------
    sets : mapping of str to tuple of Model
        Models by the name of their set; statistics are taken over a set.
    weights : tuple of Weights
        Networks; studies of one network take the first.
    agnostic : tuple of Weights
        Networks that were trained without masses.
    points : tuple of int
        Points sampled on every model.
    focus : int
        Points where a study looks at one number of them.
    poses : tuple of {1, 2, 4}
        Of the networks.
    fourier : tuple of int
        Functions of `AmbientFourier`, beside as many as a network has in one pose.
    few : int, optional
        Models of each set on clouds of more than 16,384 points; by default all.
    bandwidths : tuple of float
        Of `AmbientFourier`; comparisons are made with the best.
    sigma : float
        Of non-uniform samples; see `Case`.
    rotations : int
        Of each cloud.
    worst : int
        Models to draw.
    device : str
        For networks and dense algebra.

    Raises
    ------
    InvalidInputError
        If there is no model or no network, or two networks of one name.
    """

    sets: Mapping[str, tuple[Model, ...]]
    weights: tuple[Weights, ...]
    agnostic: tuple[Weights, ...] = ()
    points: tuple[int, ...] = (512, 2048, 8192, 65536)
    focus: int = 8192
    poses: tuple[Literal[1, 2, 4], ...] = (1, 2, 4)
    fourier: tuple[int, ...] = (640,)
    few: int | None = None
    bandwidths: tuple[float, ...] = (7.0, 10.0)
    sigma: float = 0.25
    rotations: int = 10
    worst: int = 3
    device: str = "cpu"

    def __post_init__(self) -> None:
        if not any(self.sets.values()) or not self.weights:
            raise InvalidInputError(
                "`sets` and `weights` must hold at least one model and one network, got"
                f" {sum(map(len, self.sets.values()))} and {len(self.weights)}"
            )
        check_names([*self.weights, *self.agnostic])

    def neo(self, weights: Weights, **options: Any) -> Method:
        """Return a network as a method on the device of the settings."""
        return neo(weights, device=self.device, **options)

    def same_size(self, weights: Weights) -> list[Method]:
        """Return `AmbientFourier` with the functions of one pose, at every bandwidth."""
        return [fourier(1 + weights.m, b, device=self.device) for b in self.bandwidths]


@dataclass(frozen=True, eq=False)
class Line:
    """One planned row of a table: a method on cases."""

    labels: Labels
    method: Method
    cases: tuple[Case, ...]


@dataclass(frozen=True, eq=False)
class Study:
    """A question: its plan, and the arithmetic on the answers.

    Attributes
    ----------
    title, note : str
        For the report.
    plan : callable
        Settings to lines.
    findings : callable
        Rows to findings.
    """

    title: str
    note: str
    plan: Callable[[Settings], Iterator[Line]]
    findings: Callable[[Sequence[Row]], list[Finding]]


@dataclass(frozen=True, eq=False)
class Answer:
    """What a study found.

    Attributes
    ----------
    name : str
        Key of `STUDIES`.
    study : Study
        The question.
    rows : tuple of Row
        Measurements by line of the table.
    findings : tuple of Finding
        Ratios and verdicts.
    """

    name: str
    study: Study
    rows: tuple[Row, ...]
    findings: tuple[Finding, ...]


def run_study(name: str, settings: Settings, bench: Bench, *, progress: bool = False) -> Answer:
    """Measure what a study asks for.

    Parameters
    ----------
    name : str
        A key of `STUDIES`.
    settings : Settings
        Models, networks and sizes.
    bench : Bench
        Measures, or remembers.
    progress : bool, default False
        Show a bar on a terminal.

    Returns
    -------
    Answer
        Rows with no case that could be measured are left out of the findings.

    Raises
    ------
    InvalidInputError
        If there is no such study.
    """
    if name not in STUDIES:
        raise InvalidInputError(f"`name` must be one of {sorted(STUDIES)}, got {name!r}")
    study = STUDIES[name]
    lines = [line for line in map(_with_room, study.plan(settings)) if line.cases]
    pairs = [(case, line.method) for line in lines for case in line.cases]
    results = iter(bench.run(pairs, progress=progress))
    rows = []
    for line in lines:
        measured, failures = [], []
        for case in line.cases:
            result = next(results)
            if isinstance(result, Measurement):
                measured.append((case, result))
            else:
                failures.append(f"{case.model.name}: {result.reason}")
        rows.append(Row(line.labels, line.method, tuple(measured), tuple(failures)))
    found = study.findings([row for row in rows if row.measured])
    return Answer(name, study, tuple(rows), tuple(found))


def _with_room(line: Line) -> Line:
    cases = tuple(case for case in line.cases if line.method.columns <= ROOM * case.n)
    return replace(line, cases=cases)


def _places(
    settings: Settings, points: Sequence[int]
) -> Iterator[tuple[str, tuple[Model, ...], int]]:
    for kind, models in settings.sets.items():
        for n in points:
            yield kind, models[: settings.few] if n > _LARGE else models, n


def _clouds(models: Sequence[Model], points: int, **options: Any) -> tuple[Case, ...]:
    return tuple(Case(model=model, points=points, **options) for model in models)


def _accuracy(settings: Settings) -> Iterator[Line]:
    methods: list[Method] = []
    for weights in settings.weights:
        one = settings.neo(weights)
        methods += [settings.neo(weights, poses=poses) for poses in settings.poses]
        rivals = settings.same_size(weights)
        methods += [*rivals, *(joined([one, rival]) for rival in rivals)]
    for m, b in itertools.product(settings.fourier, settings.bandwidths):
        methods.append(fourier(m, b, device=settings.device))
    methods = list({method.name: method for method in methods}.values())  # each once
    for kind, models, n in _places(settings, settings.points):
        for method in methods:
            labels: Labels = {"models": kind, "points": n, "solver": method.name}
            yield Line(labels, method, _clouds(models, n))


def _precision(settings: Settings) -> Iterator[Line]:
    dtypes: tuple[Precision, ...] = ("float32", "bfloat16", "float16")
    for kind, models, n in _places(settings, settings.points):
        for dtype in dtypes:
            method = settings.neo(settings.weights[0], dtype=dtype)
            labels: Labels = {"models": kind, "points": n, "precision": dtype}
            yield Line(labels, method, _clouds(models, n))


def _sampling(settings: Settings) -> Iterator[Line]:
    variants = {
        "mass-aware": settings.neo(settings.weights[0]),
        "masses of one": settings.neo(settings.weights[0], weighted=False),
    }
    variants |= {f"trained without ({w.label})": settings.neo(w) for w in settings.agnostic}
    densities = {"uniform": None, "non-uniform": settings.sigma}
    for (kind, models), (density, sigma) in itertools.product(
        settings.sets.items(), densities.items()
    ):
        for variant, method in variants.items():
            labels = {"models": kind, "sampling": density, "attention": variant}
            yield Line(labels, method, _clouds(models, settings.focus, sigma=sigma))


def _operators(settings: Settings) -> Iterator[Line]:
    recipes: dict[str, dict[str, Any]] = {
        "cloud, Delaunay": {"points": settings.focus},
        "cloud, k-NN graph": {"points": settings.focus, "operator": "knn"},
        "mesh, robust": {"points": None},
        "mesh, cotangent": {"points": None, "operator": "cotan"},
    }
    method = settings.neo(settings.weights[0])
    for (kind, models), (operator, recipe) in itertools.product(
        settings.sets.items(), recipes.items()
    ):
        labels = {"models": kind, "operator": operator}
        yield Line(labels, method, tuple(Case(model=model, **recipe) for model in models))


def _redundancy(settings: Settings) -> Iterator[Line]:
    sizes = sorted({2048, settings.focus} & set(settings.points)) or [settings.focus]
    ordered = sorted(settings.weights, key=lambda weights: weights.m)
    for kind, models, n in _places(settings, sizes):
        for weights in ordered:
            labels: Labels = {
                "models": kind,
                "points": n,
                "m": weights.m,
                "weights": weights.label,
            }
            yield Line(labels, settings.neo(weights), _clouds(models, n))


def _rotation(settings: Settings) -> Iterator[Line]:
    method = settings.neo(settings.weights[0])
    for kind, models in settings.sets.items():
        for model in models:
            cases = [
                Case(model=model, points=settings.focus, rotation=seed)
                for seed in range(settings.rotations)
            ]
            labels = {"models": kind, "model": model.name}
            yield Line(labels, method, tuple(cases))


def _worst(settings: Settings) -> Iterator[Line]:
    method = settings.neo(settings.weights[0])
    for kind, models in settings.sets.items():
        yield Line({"models": kind}, method, _clouds(models, settings.focus))


STUDIES: dict[str, Study] = {
    "accuracy": Study(
        "Accuracy and time",
        "Statistics over models of each model's mean over modes. Times are medians of wall time"
        " and leave out assembly and certificates. `fast` marks a solver that no other one, ARPACK"
        " among them, beats in both span error and time.",
        _accuracy,
        accuracy_findings,
    ),
    "precision": Study(
        "Precision of the network",
        "The dense algebra is float64 throughout.",
        _precision,
        precision_findings,
    ),
    "sampling": Study(
        "Sampling density and masses",
        "Non-uniform: the density falls off like a Gaussian around a random point. `masses of one`"
        " gives the attention of the same network equal masses; frame and Rayleigh-Ritz keep the"
        " true ones.",
        _sampling,
        sampling_findings,
    ),
    "operators": Study(
        "Transfer to other Laplacians",
        "The network saw Laplacians of clouds in training. Meshes enter with their vertices"
        " as points. Each operator has its own exact modes.",
        _operators,
        operator_findings,
    ),
    "redundancy": Study(
        "Redundancy",
        "One network for each m.",
        _redundancy,
        redundancy_findings,
    ),
    "rotation": Study(
        "Rotations",
        "Each cloud in several random rotations, with the operator it had: the spread is the"
        " network's and the frame's alone.",
        _rotation,
        rotation_findings,
    ),
    "worst": Study(
        "The worst models",
        "By mean span error, with the mode that lies furthest outside the span.",
        _worst,
        worst_findings,
    ),
}
