"""Shapes per second of `Neo`, by single calls and many at once.

    python apps/studies/run.py many OUT                          # a few minutes
    python apps/studies/run.py many OUT --sizes 2048 --count 240 --device cuda --weights base

Clouds of each size are sampled from meshes that no network was trained on (split `val` of the pool
in SPECTRA_KIT_DATA; made animals without it), one component each. Three ways take turns: single
calls with one thread, single calls with all threads, and `eigensolve_many`. Of each, the fastest
turn counts, by the clock and by processor time, which other work on the machine disturbs less. The
Laplacians are there beforehand; what their assembly takes stands beside, and by how much the
eigenvalues of a way differ from those of the first. A second table tells where the time of a shape
goes, as `provenance.seconds` has it, of the last turn.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np

from spectra_kit import Laplacian, Neo, Spectrum, eigensolve, eigensolve_many, laplacian_many
from spectra_kit._core.threads import single_threaded, thread_count
from spectra_kit._core.validate import check_count
from spectra_kit.geometry import TriangleMesh, creature, sample
from spectra_kit.neo.train.pool import open_pool
from studies.machine import describe_machine
from studies.report import Table, write_report
from studies.shapes import data_folder
from studies.store import Record

Way = Callable[[], list[Spectrum]]
_COLUMNS = {
    **{"way": "", "points": "d", "clouds": "d", "shapes/s": ".2f", "with assembly": ".2f"},
    **{"processor ms/shape": ".0f", "times one thread": ".2f", "times all threads": ".2f"},
    **{"assembly ms": ".0f", "apart": ".1e"},
}


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--sizes", type=int, nargs="+", default=[512, 2048, 8192], help="points of a cloud")
    add("--count", type=int, default=16, help="shapes of each size (%(default)s)")
    add("--repeats", type=int, default=4, help="turns of each way (%(default)s)")
    add("-k", type=int, default=96, help="modes (%(default)s)")
    add("--batch", type=int, help="points that share a pass (default: as eigensolve_many has it)")
    add("--weights", default="small", help="a name or a file (%(default)s)")
    add("--device", default="cpu", help="of the network and the smoothing (%(default)s)")


def measure(args: argparse.Namespace) -> None:
    for name in ("count", "repeats"):
        check_count(name, getattr(args, name), low=1)
    solver = Neo(device=args.device, weights=args.weights)
    rows: list[Record] = []
    stages: list[Record] = []
    for size in args.sizes:
        operators = _operators(size, args.count, args.device)
        assembly = sum(operator.seconds for operator in operators) / len(operators)

        def single(operators: list[Laplacian] = operators) -> list[Spectrum]:
            return [eigensolve(operator, args.k, solver) for operator in operators]

        def alone(single: Way = single) -> list[Spectrum]:
            with single_threaded():
                return single()

        def many(operators: list[Laplacian] = operators) -> list[Spectrum]:
            return eigensolve_many(operators, args.k, solver, batch=args.batch)

        ways: dict[str, Way] = {
            "single calls, one thread": alone,
            f"single calls, {thread_count()} threads": single,
            f"eigensolve_many, {thread_count()} threads": many,
        }
        compared, where = _compared(size, ways, args.repeats, assembly)
        rows, stages = rows + compared, stages + where
    device = "cuda" if args.device.startswith("cuda") else "cpu"
    machine = describe_machine(threads=thread_count(), device=device)
    named = dict.fromkeys(name for row in stages for name in row)
    forms = {name: ".2f" if name.endswith(" ms") else _COLUMNS[name] for name in named}
    tables = [Table("Shapes a second", rows, _COLUMNS), Table("Where time goes", stages, forms)]
    write_report(args.out, "many", [], tables, machine)


def _operators(size: int, count: int, device: str) -> list[Laplacian]:
    """Return operators of connected clouds."""
    clouds = (sample(mesh, size, seed=i) for i, mesh in enumerate(_meshes()))
    found = list[Laplacian]()
    while len(found) < count and (some := list(islice(clouds, count - len(found)))):
        made = laplacian_many(some, device=device)
        found += [operator for operator in made if operator.n_components == 1]
    return found


def _meshes() -> Iterator[TriangleMesh]:
    folder = data_folder("train_pool")
    if folder is None or not folder.exists():
        yield from (creature(4000, seed=seed) for seed in range(10_000))
        return
    pool = open_pool(folder, "val")
    yield from (pool.mesh(int(i)) for i in np.random.default_rng(0).permutation(len(pool)))


def _compared(
    size: int, ways: dict[str, Way], repeats: int, assembly: float
) -> tuple[list[Record], list[Record]]:
    """Let the ways take turns, and return what they took, and in which stages."""
    turns: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    spectra: dict[str, list[Spectrum]] = {}
    for turn in range(1 + repeats):
        for name, way in ways.items():
            begin = time.perf_counter(), time.process_time()
            spectra[name] = way()
            took = time.perf_counter() - begin[0], time.process_time() - begin[1]
            turns[name] += [took] if turn else []  # the first of all loads and compiles
    values = {name: np.array([s.eigenvalues[1:] for s in found]) for name, found in spectra.items()}
    first = next(iter(values.values()))
    best = {name: np.min(took, axis=0) / len(first) for name, took in turns.items()}
    one, several, *_ = (wall for wall, _ in best.values())
    stages = [
        {"way": name, "points": size}
        | {
            f"{stage} ms": 1e3 * float(np.mean([s.provenance.seconds.get(stage, 0) for s in found]))
            for stage in found[0].provenance.seconds
        }
        for name, found in spectra.items()
    ]
    rows = [
        {
            **{"way": name, "points": size, "clouds": len(first), "shapes/s": 1 / wall},
            **{"with assembly": 1 / (wall + assembly), "processor ms/shape": 1e3 * processor},
            **{"times one thread": one / wall, "times all threads": several / wall},
            **{"assembly ms": 1e3 * assembly, "apart": np.abs(values[name] / first - 1).max()},
        }
        for name, (wall, processor) in best.items()
    ]
    return rows, stages
