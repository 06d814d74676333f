"""`measure_mesh`: everything that is measured on one mesh."""

from __future__ import annotations

import json
import platform
import statistics
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit._files import atomic_path, parsing
from spectra_kit._validate import check_count
from spectra_kit.benchmarks.code import code_digest
from spectra_kit.benchmarks.geodesics.contenders import (
    CONTENDERS,
    DIRECT,
    LIBIGL,
    PLAIN,
    ROBUST,
    UNAIDED,
)
from spectra_kit.benchmarks.geodesics.problems import (
    EIGENSOLVERS,
    NamedMesh,
    choose_sources,
    spectrum_path,
    spectrum_seconds,
)
from spectra_kit.benchmarks.geodesics.process import measured
from spectra_kit.benchmarks.geodesics.truth import ExactCache, relative_errors
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import write
from spectra_kit.operators import intrinsic_delaunay

Record = dict[str, Any]
Say = Callable[[str], None]

_OTHERS = (ROBUST, PLAIN, LIBIGL)
#: Contenders for many sources: none is given modes, so that none has time on the house.
MANY = (UNAIDED, DIRECT, *_OTHERS)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How it is measured.

    Parameters
    ----------
    sources : int, default 20
        How many for the time of many.
    repeats : int, default 3
        Of every clocked run, each time in a fresh process, all contenders by turns.
    threads : int, default 2
        For all alike.
    exact_sources : int, default 4
        Sources at which errors are measured.
    large : int, default 60000
        Above so many vertices, errors are measured at two sources at most.
    warm : int, default 5
        Subdivisions of the sphere to warm up on.
    seed : int, default 0
        Of the sources.
    quick : bool, default False
        Everything in this process, for a look: seconds are then not comparable.

    Raises
    ------
    InvalidInputError
        If a count is not positive.
    """

    sources: int = 20
    repeats: int = 3
    threads: int = 2
    exact_sources: int = 4
    large: int = 60_000
    warm: int = 5
    seed: int = 0
    quick: bool = False

    def __post_init__(self) -> None:
        for name in ("sources", "repeats", "threads", "exact_sources"):
            check_count(name, getattr(self, name), low=1)

    def on(self, n: int) -> Settings:
        """Return those for n vertices."""
        few = min(self.exact_sources, 2 if n > self.large else n)
        return replace(self, sources=min(self.sources, n), exact_sources=few)


def measure_mesh(model: NamedMesh, settings: Settings, folder: Path, *, say: Say) -> Record:
    """Measure one mesh, or read what the same code measured here with the same settings.

    Parameters
    ----------
    model : NamedMesh
        The mesh.
    settings : Settings
        How.
    folder : Path
        Gets NAME.json, and in folders of their own the exact distances, spectra and fields.
    say : callable
        Is told what goes on.

    Returns
    -------
    dict
        As in the file.

    Raises
    ------
    InvalidInputError
        If the direct solver, with which the others are compared, fails.
    """
    settings = settings.on(model.mesh.n)
    record: Record = {
        "name": model.name,
        "digest": model.digest,
        "code": code_digest(),
        "solvers": {kind: repr(make()) for kind, make in EIGENSOLVERS.items()},
        "machine": platform.node(),
        "settings": asdict(settings),
    }
    path = folder / f"{model.name}.json"
    if path.exists():
        with parsing(path, "measurement", remedy="delete it"):
            known: Record = dict(json.loads(path.read_text()))
        if all(known.get(key) == value for key, value in record.items()):
            say(f"{model.name}: measured before")
            return known
    work = folder / "work"
    work.mkdir(exist_ok=True)
    mesh_path = work / f"{model.name}.npz"
    write(model.mesh, mesh_path)
    spectra = {}
    for kind in EIGENSOLVERS:
        say(f"{model.name}: {kind} modes")
        spectra[kind] = spectrum_path(model, kind, work)
    record |= {
        "n": model.mesh.n,
        "faces": len(model.mesh.faces),
        "spectra": {kind: spectrum_seconds(file) for kind, file in spectra.items()},
    }

    def run(name: str, sources: list[int], **options: Any) -> Record:
        say(f"{model.name}: {name}")
        kind = CONTENDERS[name].spectrum
        return measured(
            name,
            mesh_path,
            sources,
            threads=settings.threads,
            spectrum=spectra[kind] if kind else None,
            subdivisions=settings.warm,
            fresh=not settings.quick,
            **options,
        )

    truth = ExactCache(folder / "exact")
    say(f"{model.name}: exact distances")
    sources = choose_sources(model, settings.exact_sources, truth, seed=settings.seed)
    record |= compare_with_exact(model, sources, truth, run, work / "fields.npy")
    record["exact_seconds"] = truth.seconds

    record["first"] = _clocked(
        list(CONTENDERS), settings.repeats, lambda name: run(name, sources[:1])
    )
    rng = np.random.default_rng(settings.seed)
    many = rng.choice(model.mesh.n, settings.sources, replace=False).tolist()
    record["many"] = _clocked(list(MANY), settings.repeats, lambda name: run(name, many, many=True))
    with atomic_path(path) as part:
        part.write_text(json.dumps(record, indent=1))
    return record


def compare_with_exact(
    model: NamedMesh,
    sources: list[int],
    truth: ExactCache,
    run: Callable[..., Record],
    fields: Path,
) -> Record:
    """Return iterations, errors against exact distances, and differences from the direct solver.

    Parameters
    ----------
    model : NamedMesh
        The mesh.
    sources : list of int
        Vertices.
    truth : ExactCache
        Of the distances to them.
    run : callable
        Measures a contender at the sources, and leaves its distances in `fields`.
    fields : Path
        An npy file.

    Returns
    -------
    dict
        By contenders.

    Raises
    ------
    InvalidInputError
        If the direct solver fails.
    """
    mass = intrinsic_delaunay(model.mesh).laplacian.mass
    exact = [truth.distances(model.mesh, source) for source in sources]
    iterations: Record = {}
    errors: Record = {}
    differences: Record = {}
    # The direct solver comes first: the others are compared with it.
    reference = None
    for name in sorted(CONTENDERS, key=lambda name: name != DIRECT):
        answer = run(name, sources, fields=fields)
        if "failure" in answer:
            if name == DIRECT:
                raise InvalidInputError(
                    f"`model` {model.name} must be one that the direct solver can do:"
                    f" {answer['failure']}"
                )
            errors[name] = answer
            continue
        iterations[name] = answer["iterations"]
        found = np.load(fields)
        if reference is None:
            reference = found
        errors[name] = [
            asdict(relative_errors(d, e, mass)) for d, e in zip(found, exact, strict=True)
        ]
        if name not in _OTHERS:
            known = np.isfinite(reference)
            span = np.max(reference, where=known, initial=0.0, axis=1)
            difference = np.max(np.abs(found - reference), where=known, initial=0.0, axis=1)
            differences[name] = (difference / span).tolist()
    return {
        "exact_sources": sources,
        "iterations": iterations,
        "errors": errors,
        "differences": differences,
    }


def _clocked(names: list[str], repeats: int, run: Callable[[str], Record]) -> Record:
    """Run all by turns, and return the median run of each with the seconds of all."""
    runs: dict[str, list[Record]] = {name: [] for name in names}
    for _ in range(repeats):
        for name in names:
            runs[name].append(run(name))
    record: Record = {}
    for name, answers in runs.items():
        failed = [answer for answer in answers if "failure" in answer]
        if failed:
            record[name] = failed[0]
            continue
        seconds = [answer["seconds"] for answer in answers]
        middle = statistics.median_low(seconds)
        record[name] = {
            **answers[seconds.index(middle)],
            "seconds": statistics.median(seconds),
            "all_seconds": seconds,
        }
    return record
