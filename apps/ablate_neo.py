"""Train variants of a tiny network under one protocol, and measure them on the same clouds.

    python apps/ablate_neo.py CORPUS VALIDATION --out OUT --data FOLDER_OF_MESHES

Every variant sees the same samples in the same order. They are measured on held-out samples and on
sampled real meshes, uniform and crowded around one spot; the answers are OUT/ablation.json, .md
and .png. What is trained or measured already is not done again: an interrupted run goes on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from matplotlib.figure import Figure
from tqdm import tqdm

from spectra_kit import (
    InvalidInputError,
    Laplacian,
    Neo,
    SpectraKitError,
    Spectrum,
    TriangleMesh,
    delaunay_laplacian,
    eigensolve,
    read,
)
from spectra_kit._files import atomic_path, parsing
from spectra_kit.errors import DoubtfulSpectrumWarning
from spectra_kit.geometry import GaussianDensity, repair, sample
from spectra_kit.geometry.io import READERS
from spectra_kit.metrics import compare_spectra, span_error, subspace_span_error
from spectra_kit.neo import NeoConfig, NeoSubspace, load_pretrained, save_weights
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.shards import Corpus, open_shards
from spectra_kit.training.train import train

TINY = NeoConfig(width=64, depth=3, heads=4, head_width=16, latents=32, m=192, waves=32)
# Name -> what it changes; trained in this order.
VARIANTS: dict[str, dict[str, object]] = {
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
STUDIES: dict[str, tuple[str, ...]] = {
    "Masses in the attention": ("reference", "mass-agnostic"),
    "Plane waves": ("plain", "reference", "waves-64"),
    "Backbone": ("reference", "pointnet++", "point-transformer"),
    "Functions, with waves": ("m-96", "m-128", "m-160", "reference", "m-256"),
    "Functions, without waves": (
        "plain-m-96",
        "plain-m-128",
        "plain-m-160",
        "plain",
        "plain-m-256",
    ),
    "Latents": ("reference", "latents-64", "latents-128"),
}
CLOUDS = {"held-out": "held-out samples", "real": "real meshes", "crowded": "real, crowded"}
Errors = dict[str, dict[str, float]]  # cloud -> span, and where there are exact eigenvalues more


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

    def errors(self, bench: Bench) -> dict[str, Errors]:
        """Measure on every set of clouds, unless that is done."""
        path, digest = self.folder / "errors.json", load_pretrained(self.weights).sha256
        with parsing(path, "measurement", remedy="delete it"):
            known = dict(json.loads(path.read_text())) if path.is_file() else {}
        if known.get("weights") != digest or known.get("clouds") != bench.key:
            known = {"weights": digest, "clouds": bench.key, "errors": bench.measure(self.weights)}
            with atomic_path(path) as part:
                part.write_text(json.dumps(known, indent=1))
        errors: dict[str, Errors] = known["errors"]
        return errors


class Bench:
    """The clouds that every variant is measured on, made when the first one needs them."""

    def __init__(
        self, validation: Corpus, held_out: int, meshes: Sequence[Path], points: int, k: int
    ) -> None:
        self.validation, self.meshes, self.points, self.k = validation, meshes, points, k
        self.held_out = range(min(held_out, len(validation)))
        self.key = {
            "held-out": len(self.held_out),
            "meshes": [path.name for path in meshes],
            "points": points,
            "operator": "delaunay",
            "k": k,
            # Files may change under their names.
            "digests": [*map(file_digest, meshes), corpus_digest(validation)],
        }

    @cached_property
    def real(self) -> dict[str, dict[str, tuple[Laplacian, Spectrum]]]:
        """Operator and exact spectrum of every mesh, sampled in both ways."""
        solved: dict[str, dict[str, tuple[Laplacian, Spectrum]]] = {}
        for path in tqdm(self.meshes, desc="exact", disable=None):
            mesh = repair(read(path, kind="mesh")).geometry
            assert isinstance(mesh, TriangleMesh)
            for name, density in (("real", "uniform"), ("crowded", GaussianDensity())):
                laplacian = delaunay_laplacian(sample(mesh, self.points, seed=0, density=density))
                exact = eigensolve(laplacian, self.k)
                solved.setdefault(name, {})[path.stem] = laplacian, exact
        return solved

    def measure(self, weights: Path) -> dict[str, Errors]:
        """Return {set of clouds: {cloud: {error: mean over the modes}}}."""
        subspace, solver = NeoSubspace(weights), Neo(weights=weights)
        batch = self.validation.batch(self.held_out)
        clouds = zip(batch.points, batch.mass, batch.eigenvectors, strict=True)
        errors: dict[str, Errors] = {"held-out": {}}
        for i, (points, mass, modes) in enumerate(clouds):
            root = np.sqrt(mass.astype(np.float64))[:, None]
            U = np.linalg.qr(root * modes)[0] / root  # float16 has 3 digits
            span = span_error(subspace(points, mass), mass.astype(np.float64), U)
            errors["held-out"][str(i)] = {"span": float(span.mean())}
        for name, solved in self.real.items():
            errors[name] = {}
            for mesh, (laplacian, exact) in solved.items():
                with warnings.catch_warnings():  # how wrong it is, is what is measured here
                    warnings.simplefilter("ignore", DoubtfulSpectrumWarning)
                    predicted = eigensolve(laplacian, self.k, solver)
                span, _ = subspace_span_error(solver.subspace, laplacian, exact, predicted)
                comparison = compare_spectra(exact, predicted)
                errors[name][mesh] = {
                    "span": float(span.mean()),
                    "value": comparison.mean_eigenvalue_error,
                    "vector": comparison.mean_vector_error,
                }
        return errors


def summary(trial: Trial, bench: Bench) -> dict[str, object]:
    """Everything that the report says about a variant."""
    network, _, _, digest, record = load_pretrained(trial.weights)
    spans = {
        cloud: np.array([error["span"] for error in errors.values()])
        for cloud, errors in trial.errors(bench).items()
        if errors
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


def table(done: dict[str, dict], protocol: dict[str, dict]) -> str:
    """Every study as a Markdown table."""
    lines = ["# Ablation", "", "Mean span error ± standard deviation (median). Protocol:", ""]
    for part, values in protocol.items():
        values = {k: len(v) if isinstance(v, list) else v for k, v in values.items()}
        lines.append(f"- {part}: {', '.join(f'{k} {v}' for k, v in values.items())}")
    for title, names in STUDIES.items():
        rows = {name: done[name] for name in names if name in done}
        if len(rows) < 2:
            continue
        clouds = [c for c in CLOUDS if all(c in row["span"] for row in rows.values())]
        head = ["variant", "parameters", "CPU minutes", *(CLOUDS[cloud] for cloud in clouds)]
        lines += ["", f"## {title}", "", f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
        for name, row in rows.items():
            spent = row["cpu_seconds"]
            cells = [name, f"{row['parameters']:,}", "?" if spent is None else f"{spent / 60:.1f}"]
            for cloud in clouds:
                span = row["span"][cloud]
                cells.append(f"{span['mean']:.4f} ± {span['std']:.4f} ({span['median']:.4f})")
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw(done: dict[str, dict], path: Path) -> None:
    """Draw a panel for each study, and validation against the time that training took."""
    studies = {
        title: [name for name in names if name in done]
        for title, names in STUDIES.items()
        if sum(name in done for name in names) > 1
    }
    figure = Figure(figsize=(11, 3.3 * (len(studies) // 3 + 1)), layout="constrained", dpi=130)
    axes = list(figure.subplots(len(studies) // 3 + 1, 3, squeeze=False).flat)
    for axis, (title, names) in zip(axes, studies.items(), strict=False):
        for marker, (cloud, label) in zip("osD", CLOUDS.items(), strict=True):
            shown = [(n, done[n]["span"][cloud]["mean"]) for n in names if cloud in done[n]["span"]]
            if shown:
                axis.plot(*zip(*shown, strict=True), marker, label=label)
        axis.set(title=title, ylabel="mean span error", ylim=(0, None))
        axis.tick_params(axis="x", rotation=15)
        axis.margins(x=0.2)
        axis.grid(axis="y", alpha=0.3)
    axes[0].legend(fontsize="small")
    for name, row in done.items():
        if row["cpu_seconds"] and name in {*STUDIES["Backbone"], *STUDIES["Plane waves"]}:
            samples, errors = np.array(row["curve"]).T
            minutes = samples * row["cpu_seconds"] / row["samples"] / 60
            axes[len(studies)].semilogy(minutes, errors, ".-", label=name)
    axes[len(studies)].set(title="Equal time", xlabel="CPU minutes", ylabel="validation")
    axes[len(studies)].legend(fontsize="small")
    for axis in axes[len(studies) + 1 :]:
        axis.set_axis_off()
    with atomic_path(path) as part:
        figure.savefig(part, format="png")


def write(done: dict[str, dict], protocol: dict[str, dict], out: Path) -> None:
    """Write the report of what is done."""
    with atomic_path(out / "ablation.json") as part:
        part.write_text(json.dumps({"protocol": protocol, "variants": done}, indent=1))
    with atomic_path(out / "ablation.md") as part:
        part.write_text(table(done, protocol))
    if any(sum(name in done for name in names) > 1 for names in STUDIES.values()):
        draw(done, out / "ablation.png")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    data = os.environ.get("SPECTRA_KIT_DATA")
    add("corpus", type=Path, help="folder of shards")
    add("validation", type=Path, help="folder of shards, other samples")
    add("--out", type=Path, required=True)
    add("--data", type=Path, default=data and Path(data, "ood_public"), help="folder of meshes")
    add("--only", nargs="+", choices=VARIANTS, metavar="VARIANT", help=", ".join(VARIANTS))
    add("--samples", type=int, default=3000, help="to train on, in all (%(default)s)")
    add("--batch", type=int, default=8, help="clouds per step (%(default)s)")
    add("--points", type=int, default=640, help="drawn from each (%(default)s)")
    add("--lr", type=float, default=5e-3)
    add("--seed", type=int, default=0)
    add("--held-out", type=int, default=128, help="samples to measure on (%(default)s)")
    add("--sampled", type=int, default=2048, help="points on each real mesh (%(default)s)")
    add("--limit", type=int, help="use the first meshes alone")
    return parser


def main(argv: Sequence[str] | None = None, base: NeoConfig = TINY) -> int:
    """Train, measure and report; return 0, or 1 where arguments or files do not fit."""
    args = _parser().parse_args(argv)
    torch.set_num_threads(1)
    try:
        _run(args, base)
    except SpectraKitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _run(args: argparse.Namespace, base: NeoConfig) -> None:
    corpus, validation = open_shards(args.corpus), open_shards(args.validation)
    files = sorted(args.data.iterdir()) if args.data else []
    meshes = [file for file in files if file.suffix.lower() in READERS][: args.limit]
    bench = Bench(validation, args.held_out, meshes, args.sampled, base.k)
    steps = args.samples // args.batch
    same = {"steps": steps, "batch": args.batch, "points": args.points, "lr": args.lr}
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
            other: summary(trial(other), bench)
            for other in VARIANTS
            if (args.out / other / "weights.safetensors").is_file()
        }
        spans = {cloud: round(span["mean"], 4) for cloud, span in done[name]["span"].items()}
        print(f"{name}: span error {spans}", flush=True)
        protocol = {"network": asdict(base), "training": same, "clouds": bench.key}
        write(done, protocol, args.out)


if __name__ == "__main__":
    raise SystemExit(main())
