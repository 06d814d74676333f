"""`Neo` on a device: many small clouds, one large, the network alone, and small eigenproblems.

    python apps/studies/run.py device OUT --device cuda

On made animals that no network was trained on, k = 96. Operators are made there as well; what that
takes stands beside. Everything is run once before it is timed, and each time is the least of two.
Eigenvalues are held against `Arpack` on the host. Nothing is begun later than `--minutes` after the
start; what was left out is told.
The sizes of the last table are those of the paper's runtimes, on an RTX 3090 in float32: 0.02,
0.23, 0.96 and 2.91 s.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import product
from typing import Any

import numpy as np
import torch

from spectra_kit import (
    Arpack,
    Cascade,
    Neo,
    Spectrum,
    eigensolve,
    eigensolve_many,
    laplacian,
    laplacian_many,
)
from spectra_kit._core.threads import in_threads, thread_count
from spectra_kit._sparse.batched_eigh import divide_and_conquer
from spectra_kit._sparse.blocks import device_memory
from spectra_kit._sparse.torch_device import check_device
from spectra_kit.geometry import PointCloud, TriangleMesh, creature, sample
from studies.machine import describe_machine
from studies.report import Table, write_report
from studies.store import Record

_K = 96
_ANIMALS = 8  # of which clouds are samples: making one takes a second
_COMPARED = 16  # clouds whose eigenvalues are held against those of the host
_NETWORKS = [("small", "float32"), ("base", "float32"), ("base", "bfloat16")]  # the last on CUDA
_FORMS = {
    **{"points": "d", "clouds": "d", "rows": "d", "matrices": "d", "solver": "", "network": ""},
    **{"precision": "", "seconds": ".4f", "clouds/s": ".1f", "from points": ".1f"},
    **{"assembly s": ".4f", "GB": ".2f"},
    **{"error, mean": ".1e", "worst": ".1e", "ms a matrix": ".4f", "torch, ms": ".4f"},
}


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--device", default="cuda", help="(%(default)s)")
    add("--minutes", type=float, default=4.5, help="after which nothing is begun (%(default)s)")
    add("--many", type=int, nargs=2, default=[2048, 256], help="points and number of small clouds")
    add("--one", type=int, nargs="+", default=[8192, 65_536], help="points of one cloud")
    add("--network", type=int, nargs="+", default=[8192, 65_536, 524_288, 1_500_000])
    add("--eigh", type=int, nargs="+", default=[115, 257], help="rows of small matrices")


def measure(args: argparse.Namespace) -> None:
    device = str(check_device(args.device))
    run = _Measurements(device, time.perf_counter() + 60 * args.minutes)
    tables = {
        "Small symmetric eigenproblems": partial(run.eigenproblems, args.eigh),
        "Many small clouds": partial(run.many, *args.many),
        "One cloud": partial(run.one, args.one),
        "The network alone, frames included": partial(run.network, args.network),
    }
    shown = []
    machine = describe_machine(threads=thread_count(), device=device)
    for title, rows in tables.items():
        found = [] if run.is_late(title) else list(rows())
        named = dict.fromkeys(name for row in found for name in row)
        shown.append(Table(title, found, {n: _FORMS.get(n, ".2f") for n in named}))
        # After each, so that it is there if the machine is taken away.
        write_report(args.out, "device", [], shown, machine, left_out=run.left_out)
    print("left out:", ", ".join(run.left_out) or "nothing")


class _Measurements:
    """What is measured on one device until an end, and what had to be left out."""

    def __init__(self, device: str, end: float) -> None:
        self.device, self.end, self.left_out = device, end, list[str]()
        self.cuda = device.startswith("cuda")
        self.networks: list[dict[str, Any]] = [
            {"weights": weights, "dtype": precision, "device": device}
            for weights, precision in (_NETWORKS if self.cuda else _NETWORKS[:2])
        ]

    def is_late(self, what: str) -> bool:
        """Whether no time is left for something, which is told."""
        late = time.perf_counter() > self.end
        self.left_out += [what] * late
        return late

    def timed(self, what: str, call: Callable[[], Any]) -> tuple[Any, Record] | None:
        """Run twice after a warm-up; return the result, seconds, and most memory of the device."""
        if self.is_late(what):
            return None
        times: list[float] = []
        for _ in range(3):
            if self.cuda:
                torch.cuda.reset_peak_memory_stats(self.device)
                torch.cuda.synchronize(self.device)
            start = time.perf_counter()
            print(f"{what}, run {len(times)}", flush=True)
            try:
                with device_memory():
                    found = call()
            except MemoryError as error:
                self.left_out.append(f"{what} ({error})")
                return None
            if self.cuda:
                torch.cuda.synchronize(self.device)
            times.append(time.perf_counter() - start)
        memory = {"GB": torch.cuda.max_memory_allocated(self.device) / 1e9} if self.cuda else {}
        return found, {"seconds": min(times[1:]), **memory}

    def eigenproblems(self, sizes: list[int]) -> Iterator[Record]:
        """Yield what a batch takes at once, and one after the other."""
        for n, b in product(sizes, (16, 64, 256)):
            A = torch.randn(b, n, n, dtype=torch.float64, device=self.device)
            A = A + A.mT
            ours = self.timed(f"eigh {n}", partial(divide_and_conquer, A, n))
            theirs = self.timed(f"torch {n}", partial(torch.linalg.eigh, A[:8]))
            if ours and theirs:
                off = (ours[0][0][:8] - theirs[0][0]).abs().max() / theirs[0][0].abs().max()
                yield {
                    **{"rows": n, "matrices": b, "ms a matrix": 1e3 * ours[1]["seconds"] / b},
                    **{"torch, ms": 1e3 * theirs[1]["seconds"] / 8, "worst": float(off)},
                }

    def many(self, points: int, count: int) -> Iterator[Record]:
        """Yield clouds a second, and where their time goes, in ms a cloud."""
        for seed in range(_ANIMALS):  # not in threads, which would only wait for each other
            _animal(seed)
        clouds = in_threads(_cloud, ((points, seed) for seed in range(count)))
        made = self.timed("operators", partial(laplacian_many, clouds, device=self.device))
        if made is None:
            return
        operators, assembly = made[0], made[1]["seconds"]
        some = operators[:_COMPARED]
        exact = in_threads(eigensolve, ((operator, _K, Arpack()) for operator in some))
        for network in self.networks:
            call = partial(eigensolve_many, operators, _K, Neo(**network))
            if timed := self.timed(f"many by {network}", call):
                found, took = timed
                yield {
                    **{"network": network["weights"], "precision": network["dtype"]},
                    **{"points": points},
                    **{"clouds": count, "clouds/s": count / took["seconds"]},
                    **{"from points": count / (took.pop("seconds") + assembly), **took},
                    **_errors(found[:_COMPARED], exact),
                    **{f"{stage}, ms": 1e3 * s for stage, s in _stages(found).items()},
                }

    def one(self, sizes: list[int]) -> Iterator[Record]:
        """Yield seconds of one cloud by each solver."""
        for points in sizes:
            cloud = _cloud(points, 1)
            made = self.timed("operator", partial(laplacian, cloud, device=self.device))
            if made is None:
                return
            if self.is_late(f"one cloud of {points}"):
                return
            operator, assembly = made[0], made[1]["seconds"]
            exact = eigensolve(operator, _K, Arpack())
            solvers: dict[str, Any] = {
                f"Neo, {network['weights']}, {network['dtype']}": Neo(**network)
                for network in self.networks
            }
            solvers |= {"Cascade": Cascade(device=self.device), "Cascade, host": Cascade()}
            for name, solver in solvers.items():
                timed = self.timed(f"{name} on {points}", partial(eigensolve, operator, _K, solver))
                if timed:
                    found, took = timed
                    yield {
                        **{"solver": name, "points": points, **took},
                        **{"assembly s": assembly, **_errors([found], [exact])},
                        **{f"{stage}, ms": 1e3 * s for stage, s in _stages([found]).items()},
                    }

    def network(self, sizes: list[int]) -> Iterator[Record]:
        """Yield seconds of a prediction."""
        mesh = creature(20_000, seed=0)
        for points, network in product(sizes, self.networks):
            cloud = sample(mesh, points, seed=0)
            call = partial(Neo(**network).subspace.tensor, cloud.points, np.ones(points))
            if timed := self.timed(f"network on {points}", call):
                names = {"network": network["weights"], "precision": network["dtype"]}
                yield {**names, "points": points, **timed[1]}


def _cloud(points: int, seed: int) -> PointCloud:
    return sample(_animal(seed % _ANIMALS), points, seed=seed)


@cache
def _animal(seed: int) -> TriangleMesh:
    return creature(4000, seed=seed)


def _errors(found: list[Spectrum], exact: list[Spectrum]) -> Record:
    """Return the mean relative error of eigenvalues but the zero, and that of the worst cloud."""
    off = [
        np.abs(one.eigenvalues[1:] / true.eigenvalues[1:] - 1).mean()
        for one, true in zip(found, exact, strict=True)
    ]
    return {"error, mean": float(np.mean(off)), "worst": float(np.max(off))}


def _stages(found: list[Spectrum]) -> dict[str, float]:
    names = [name for name in found[0].provenance.seconds if name != "assembly"]
    return {
        name: float(np.mean([one.provenance.seconds.get(name, 0.0) for one in found]))
        for name in names
    }
