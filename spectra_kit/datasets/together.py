"""`begin`: what `complete` does, for many files, of which several are solved for together."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from spectra_kit._core.threads import single_threaded_blas, thread_count
from spectra_kit._core.validate import hearing
from spectra_kit.datasets.completion import (
    Completed,
    FileRead,
    complete,
    finished,
    known,
    read_file,
)
from spectra_kit.datasets.plan import Plan
from spectra_kit.datasets.store import SpectrumStore
from spectra_kit.eigen import eigensolve_many
from spectra_kit.errors import SpectraKitError
from spectra_kit.geometry import Geometry
from spectra_kit.operators import Laplacian

#: Points that share a pass of a solver that takes several shapes at once.
_PASS, _PASS_OF_DEVICE = 4096, 65536


def begin(
    store: SpectrumStore, files: Iterable[tuple[str, Path]], plan: Plan
) -> Iterator[Callable[[], Completed]]:
    """Yield what is left to do for each of many named files, with the result of `complete`.

    Shapes are solved for together where that is sooner than one by one.
    """
    most = _points_together(plan.solver)
    rest, reads, points = list[Callable[[], Completed]](), dict[str, FileRead](), 0
    for name, path in files:
        one = _read(store, name, path, plan) if most else None
        if one is None:
            rest.append(partial(complete, store, name, path, plan))
        else:
            if one.key in reads:  # of two names of one shape, one is solved for
                one = replace(one, is_new=False)
            elif one.is_new:
                reads[one.key] = one
            points += one.shape.n
            rest.append(partial(finished, store, one, plan))
        if points >= most:
            _solve(store, reads.values(), plan)
            yield from rest
            rest, reads, points = [], {}, 0
    _solve(store, reads.values(), plan)
    yield from rest


def _read(store: SpectrumStore, name: str, path: Path, plan: Plan) -> FileRead | None:
    """Return a file that was read; None where nothing is left to do, or this fails.

    `complete` tells which, when it is its turn.
    """
    with suppress(SpectraKitError, OSError, MemoryError):
        if known(store, name, path, plan) is None:
            return read_file(store, name, path, plan)
    return None


def _points_together(solver: Any) -> int:
    """Return how many points are worth solving for together; 0 if none are.

    A pass of several shapes costs a processor what it costs one by one, but can be done beside
    other passes; an accelerator idles while it has one small shape.
    """
    if not hasattr(solver, "begin"):
        return 0
    if _on_device(solver):
        return 2 * _PASS_OF_DEVICE
    return 2 * _PASS * thread_count() if thread_count() > 1 else 0


def _on_device(solver: Any) -> bool:
    return getattr(solver, "device", "cpu") != "cpu"


def _solve(store: SpectrumStore, reads: Collection[FileRead], plan: Plan) -> None:
    """Keep the spectra of those that can be solved for together.

    Whoever asks for another solves for it alone, and is told why that fails.
    """
    if not reads:
        return
    shapes, laplacians = list[Geometry](), list[Laplacian]()
    with hearing(), single_threaded_blas(), suppress(SpectraKitError, MemoryError):
        for one in reads:
            with suppress(SpectraKitError):
                laplacian = plan.laplacian(one.shape)
                if plan.k <= len(laplacian.free):
                    shapes.append(one.shape)
                    laplacians.append(laplacian)
        batch = _PASS_OF_DEVICE if _on_device(plan.solver) else _PASS
        solved = eigensolve_many(laplacians, plan.k, plan.solver, batch=batch)
        for shape, spectrum in zip(shapes, solved, strict=True):
            store.keep_spectrum(shape, plan, spectrum)
