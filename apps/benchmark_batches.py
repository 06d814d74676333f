"""Shapes per second of `Neo`, by single calls and many at once.

    python apps/benchmark_batches.py                          # a few minutes
    python apps/benchmark_batches.py --sizes 2048 --count 32 --device cuda --batch 65536

Clouds of each size are sampled from meshes that no network was trained on (split `val` of the pool
in SPECTRA_KIT_DATA; made animals without it), one component each. Three ways take turns: single
calls with one thread, single calls with all threads, and `eigensolve_many`. Of each, the fastest
turn counts, by the clock and by processor time, which other work on the machine disturbs less. The
Laplacians are there beforehand; what their assembly takes stands above each table, and by how much
the eigenvalues of the ways differ.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from measure.command import exit_code, parser_of
from measure.shapes import data_folder
from measure.tables import table

from spectra_kit import Laplacian, Neo, Spectrum, eigensolve, eigensolve_many, laplacian
from spectra_kit._core.threads import single_threaded, thread_count
from spectra_kit._core.validate import check_count
from spectra_kit.geometry import TriangleMesh, creature, sample
from spectra_kit.neo.train.pool import open_pool

Way = Callable[[], list[Spectrum]]


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print the tables, return the exit code."""
    parser = parser_of("benchmark_batches.py", __doc__)
    add = parser.add_argument
    add("--sizes", type=int, nargs="+", default=[512, 2048, 8192], help="points of a cloud")
    add("--count", type=int, default=16, help="shapes of each size (%(default)s)")
    add("--repeats", type=int, default=4, help="turns of each way (%(default)s)")
    add("-k", type=int, default=96, help="modes (%(default)s)")
    add("--batch", type=int, default=4096, help="points that share a pass (%(default)s)")
    add("--device", default="cpu", help="of the network and the smoothing (%(default)s)")
    args = parser.parse_args(argv)
    return exit_code(lambda: _measure(args))


def _measure(args: argparse.Namespace) -> None:
    for name in ("count", "repeats"):
        check_count(name, getattr(args, name), low=1)
    solver = Neo(device=args.device)
    for size in args.sizes:
        begin = time.perf_counter()
        operators = list(_operators(size, args.count))
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
        print(f"{size} points, {len(operators)} clouds made in {time.perf_counter() - begin:.0f} s")
        print(_compared(ways, args.repeats, assembly), end="\n\n", flush=True)


def _operators(size: int, count: int) -> Iterator[Laplacian]:
    """Yield operators of connected clouds."""
    found = 0
    for i, mesh in enumerate(_meshes()):
        operator = laplacian(sample(mesh, size, seed=i))
        if operator.n_components == 1:
            yield operator
            found += 1
        if found == count:
            return


def _meshes() -> Iterator[TriangleMesh]:
    folder = data_folder("train_pool")
    if folder is None or not folder.exists():
        yield from (creature(4000, seed=seed) for seed in range(10_000))
        return
    pool = open_pool(folder, "val")
    yield from (pool.mesh(int(i)) for i in np.random.default_rng(0).permutation(len(pool)))


def _compared(ways: dict[str, Way], repeats: int, assembly: float) -> str:
    """Let the ways take turns, and return a table of what they took."""
    turns: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    spectra: dict[str, list[Spectrum]] = {}
    for turn in range(1 + repeats):
        for name, way in ways.items():
            begin = time.perf_counter(), time.process_time()
            spectra[name] = way()
            took = time.perf_counter() - begin[0], time.process_time() - begin[1]
            turns[name] += [took] if turn else []  # the first of all loads and compiles
    first, *others = (np.array([s.eigenvalues[1:] for s in found]) for found in spectra.values())
    apart = max(float(np.abs(other / first - 1).max()) for other in others)
    best = {name: np.min(took, axis=0) / len(first) for name, took in turns.items()}
    rows = [
        (
            name,
            f"{1 / wall:.2f}",
            f"{1 / (wall + assembly):.2f}",
            f"{1e3 * processor:.0f}",
            *(f"{other / wall:.2f}" for other, _ in list(best.values())[:2]),
        )
        for name, (wall, processor) in best.items()
    ]
    header = (
        *("", "shapes/s", "with assembly", "processor ms/shape"),
        *("times one thread", "times all threads"),
    )
    return (
        f"assembly {1e3 * assembly:.0f} ms each; eigenvalues differ by {apart:.1e} at most\n\n"
        + table(header, rows)
    )


if __name__ == "__main__":
    sys.exit(main())
