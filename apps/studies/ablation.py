"""Train variants of a tiny network under one protocol, and measure them on the same clouds.

    python apps/studies/run.py ablation OUT CORPUS VALIDATION --data FOLDER_OF_MESHES

Every variant sees the same samples in the same order. They are measured on held-out samples and on
sampled real meshes, uniform and crowded around one spot: mean span error, standard deviation and
median over the clouds. What is trained or measured already is not done again: an interrupted run
goes on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import torch
from tqdm import tqdm

from spectra_kit import (
    InvalidInputError,
    Laplacian,
    Neo,
    SpectraKitError,
    Spectrum,
    delaunay_laplacian,
    eigensolve,
)
from spectra_kit.eigen.metrics import compare_spectra, span_error, subspace_span_error
from spectra_kit.errors import DoubtfulSpectrumWarning
from spectra_kit.geometry import GaussianDensity, sample
from spectra_kit.geometry.io import is_readable
from spectra_kit.neo import NeoConfig, NeoSubspace, load_pretrained, save_weights
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.corpus import Corpus, open_shards
from spectra_kit.neo.train.train import train
from studies.machine import describe_machine
from studies.report import Table, write_report
from studies.shapes import data_folder, shape_at
from studies.store import Record, Store
from studies.study import Study, run

TINY = NeoConfig(width=64, depth=3, heads=4, head_width=16, latents=32, m=192, waves=32)
# Name -> what it changes; trained in this order.
VARIANTS: dict[str, dict[str, Any]] = {
    "reference": {},
    "mass-agnostic": {"mass_aware": False},
    "plain": {"waves": 0},
    "pointnet++": {"backbone": "pointnet++"},
    "m-96": {"m": 96},
    "m-256": {"m": 256},
    "point-transformer": {"backbone": "point-transformer"},
    "m-128": {"m": 128},
    "m-160": {"m": 160},
    "waves-64": {"waves": 64},
    "latents-64": {"latents": 64},
    "latents-128": {"latents": 128},
    "plain-m-96": {"m": 96, "waves": 0},
    "plain-m-256": {"m": 256, "waves": 0},
    "plain-m-128": {"m": 128, "waves": 0},
    "plain-m-160": {"m": 160, "waves": 0},
}
CLOUDS = {"held-out": "held-out samples", "real": "real meshes", "crowded": "real, crowded"}
Errors = dict[str, dict[str, float]]  # by cloud and kind


def file_digest(path: Path) -> str:
    """Return a hash of a file."""
    return hashlib.blake2b(path.read_bytes(), digest_size=12).hexdigest()


def corpus_digest(corpus: Corpus) -> str:
    """Return a hash of the masses: no two samples have the same."""
    digest = hashlib.blake2b(digest_size=12)
    for shard in corpus.shards:
        digest.update(np.ascontiguousarray(shard.mass).data)
    return digest.hexdigest()


class Trial(NamedTuple):
    """One variant: its network, its folder, and what both are trained with."""

    name: str
    folder: Path
    config: TrainConfig

    @property
    def weights(self) -> Path:
        """Where the trained network lies."""
        return self.folder / "weights.safetensors"

    def train(self, corpus: Corpus, validation: Corpus) -> bool:
        """Train and save, unless that is done; return False if Ctrl-C came in between."""
        samples = [corpus_digest(corpus), corpus_digest(validation)]
        if self.weights.is_file():
            record = load_pretrained(self.weights).record
            wanted = [json.loads(json.dumps(asdict(self.config))), samples]
            if [record["config"], record.get("digests")] != wanted:
                raise InvalidInputError(
                    f"{self.weights} was trained under another protocol, or on other samples; give"
                    " those again, or another --out"
                )
            return True
        began, resume = time.process_time(), (self.folder / "checkpoint.pt").is_file()
        with tqdm(total=self.config.steps, desc=self.name, unit="step", disable=None) as bar:
            result = train(
                corpus,
                validation,
                self.config,
                out=self.folder,
                resume=resume,
                report=lambda row: bar.update(int(row["step"]) - bar.n),
            )
        if result.finished:
            spent = None if resume else round(time.process_time() - began, 1)
            record = {**result.record, "cpu_seconds": spent, "digests": samples}
            save_weights(self.weights, result.network, record)
        return result.finished


@dataclass(frozen=True, eq=False, kw_only=True)
class Clouds(Study[Path, str]):
    """Networks, by their weights, on sets of clouds: errors of each cloud, means over the modes."""

    name: ClassVar[str] = "clouds"
    fresh: ClassVar[bool] = False

    validation: Corpus
    held_out: int  #: So many samples of the validation.
    meshes: Sequence[Path]  #: Sampled in two ways.
    points: int  #: Of each sample.
    k: int  #: Exact modes, made when the first network needs them.

    @cached_property
    def inputs(self) -> dict[str, object]:
        """All that is measured on; files may change under their names."""
        return {
            "held-out": self.held_out,
            "meshes": [path.name for path in self.meshes],
            "points": self.points,
            "operator": "delaunay",
            "k": self.k,
            "digests": [*map(file_digest, self.meshes), corpus_digest(self.validation)],
        }

    def facts(self, contender: Path, problem: str) -> dict[str, object]:
        weights = load_pretrained(contender).sha256
        return {"weights": weights, "set": problem, **self.inputs}

    def measure(self, contender: Path, problem: str) -> dict[str, Errors]:
        """Return the errors by cloud; where there are no exact eigenvalues, those of the span."""
        if problem == "held-out":
            return {"errors": self._held_out_errors(NeoSubspace(contender))}
        solver = Neo(weights=contender, max_steps=0)
        return {"errors": {path.stem: self._error(path, problem, solver) for path in self.meshes}}

    def _held_out_errors(self, subspace: NeoSubspace) -> Errors:
        batch = self.validation.batch(range(self.held_out))
        errors: Errors = {}
        for points, mass, modes in zip(batch.points, batch.mass, batch.eigenvectors, strict=True):
            root = np.sqrt(mass.astype(np.float64))[:, None]
            U = np.linalg.qr(root * modes)[0] / root  # float16 has 3 digits
            span = span_error(subspace(points, mass), mass.astype(np.float64), U)
            errors[str(len(errors))] = {"span": float(span.mean())}
        return errors

    def _error(self, path: Path, sampling: str, solver: Neo) -> dict[str, float]:
        laplacian, exact = solved(path, file_digest(path), sampling, self.points, self.k)
        with warnings.catch_warnings():  # how wrong it is, is what is measured here
            warnings.simplefilter("ignore", DoubtfulSpectrumWarning)
            predicted = eigensolve(laplacian, self.k, solver)
        span, _ = subspace_span_error(solver.subspace, laplacian, exact, predicted)
        comparison = compare_spectra(exact, predicted)
        return {
            "span": float(span.mean()),
            "value": comparison.mean_eigenvalue_error,
            "vector": comparison.mean_vector_error,
        }


@cache
def solved(
    path: Path, digest: str, sampling: str, points: int, k: int
) -> tuple[Laplacian, Spectrum]:
    """Return operator and exact modes of a sampled mesh, whose file has this hash."""
    density: Literal["uniform"] | GaussianDensity = "uniform"
    if sampling == "crowded":
        density = GaussianDensity()
    laplacian = delaunay_laplacian(sample(shape_at(path).mesh, points, seed=0, density=density))
    return laplacian, eigensolve(laplacian, k)


def errors_of(trial: Trial, clouds: Clouds) -> dict[str, Errors]:
    """Measure a trained variant on every set of clouds, unless that is done."""
    study = replace(clouds, contenders=[trial.weights])
    results = run(study, Store(clouds.folder), jobs=0, retry=True)
    for result in results:
        if not result.ok:
            raise SpectraKitError(result.reason)
    return {result.problem: result.record["errors"] for result in results}


def summary(trial: Trial, clouds: Clouds) -> Record:
    """Everything that the report says about a variant."""
    network, _, _, digest, record = load_pretrained(trial.weights)
    spans = {
        cloud: np.array([error["span"] for error in errors.values()])
        for cloud, errors in errors_of(trial, clouds).items()
    }
    return {
        "changes": VARIANTS[trial.name],
        "parameters": sum(p.numel() for p in network.parameters()),
        "samples": record["samples"],
        "cpu_seconds": record["cpu_seconds"],
        "minutes": record["minutes"],
        "curve": [
            [row["samples"], row["validation"]] for row in record["history"] if "validation" in row
        ],
        "span": {
            cloud: {
                "mean": float(x.mean()),
                "std": float(x.std()),
                "median": float(np.median(x)),
                "clouds": len(x),
            }
            for cloud, x in spans.items()
        },
        "weights": digest,
    }


def write(done: dict[str, Record], protocol: dict[str, Record], out: Path) -> None:
    """Write a table of what is done."""
    shown = {"variant": "", "parameters": ",d", "CPU minutes": ".1f"}
    shown |= {
        f"{of}: {what}": ".4f" for of in CLOUDS.values() for what in ("mean", "std", "median")
    }
    table = Table("Variants", [_line(name, row) for name, row in done.items()], shown)
    machine = describe_machine(threads=1)
    write_report(out, "ablation", [], [table], machine, protocol=protocol, variants=done)


def _line(name: str, row: Record) -> Record:
    spent = row["cpu_seconds"]
    line = {"variant": name, "parameters": row["parameters"]}
    line["CPU minutes"] = None if spent is None else spent / 60
    for cloud, span in row["span"].items():
        line |= {f"{CLOUDS[cloud]}: {what}": value for what, value in span.items()}
    return line


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("corpus", type=Path, help="folder of shards")
    add("validation", type=Path, help="folder of shards, other samples")
    add("--data", type=Path, default=data_folder("ood_public"), help="folder of meshes")
    add("--only", nargs="+", choices=VARIANTS, metavar="VARIANT", help=", ".join(VARIANTS))
    add("--samples", type=int, default=3000, help="to train on, in all (%(default)s)")
    add("--batch", type=int, default=8, help="clouds per step (%(default)s)")
    add("--lr", type=float, default=5e-3)
    add("--seed", type=int, default=0)
    add("--held-out", type=int, default=128, help="samples to measure on (%(default)s)")
    add("--sampled", type=int, default=2048, help="points on each real mesh (%(default)s)")
    add("--limit", type=int, help="use the first meshes alone")


def measure(args: argparse.Namespace) -> None:
    """Train, measure and report."""
    torch.set_num_threads(1)
    base = TINY
    corpus, validation = open_shards(args.corpus), open_shards(args.validation)
    files = sorted(args.data.iterdir()) if args.data else []
    meshes = [file for file in files if is_readable(file)][: args.limit]
    clouds = Clouds(
        folder=args.out,
        contenders=[],
        problems=[name for name in CLOUDS if meshes or name == "held-out"],
        validation=validation,
        held_out=min(args.held_out, len(validation)),
        meshes=meshes,
        points=args.sampled,
        k=base.k,
    )
    steps = args.samples // args.batch
    same = {"steps": steps, "batch": args.batch, "lr": args.lr}
    same |= {"seed": args.seed, "ema": 0.0, "every": max(1, steps // 5), "validation": 32}

    def trial(name: str) -> Trial:
        network = replace(base, **VARIANTS[name])
        return Trial(name, args.out / name, TrainConfig(network=network, **same))

    args.out.mkdir(parents=True, exist_ok=True)
    for name in args.only or VARIANTS:
        if not trial(name).train(corpus, validation):
            print("interrupted: the same command goes on")
            return
        done = {
            other: summary(trial(other), clouds)
            for other in VARIANTS
            if (args.out / other / "weights.safetensors").is_file()
        }
        spans = {cloud: round(span["mean"], 4) for cloud, span in done[name]["span"].items()}
        print(f"{name}: span error {spans}", flush=True)
        protocol = {"network": asdict(base), "training": same, "clouds": clouds.inputs}
        write(done, protocol, args.out)
