"""`Leg`: what its phases share, begun or found again."""

from __future__ import annotations

import json
import secrets
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from spectra_kit._core.files import atomic_path, parsing
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo import WEIGHTS, NeoConfig, load_pretrained
from spectra_kit.neo.train.config import TrainConfig

_SEED = 1_000_000


@dataclass(frozen=True)
class Leg:
    """What the phases of a leg share; ``leg.json`` holds it."""

    name: str  # tells this leg from others
    weights: str  # name or file that it starts from, empty for random ones
    config: TrainConfig  # of all its phases
    n_points: int  # of its samples
    #: Weights that the new ones must beat: those that it starts from, else the shipped ones of its
    #: configuration; empty where there are none.
    rival: str = ""
    #: What the first call asked for, which later ones may repeat but not change.
    asked: dict[str, Any] = field(default_factory=dict)
    before: float | None = None  # span error of the rival
    validation: str = ""  # tells the samples that it was measured on from others
    phase: int = 0  # phases that have made steps
    step: int = 0  # steps that they made
    finished: bool = False  # whether its schedule has ended

    def write(self, folder: Path) -> None:
        """Write ``leg.json``, into a folder that is made if missing."""
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_path(folder / "leg.json") as path:
            path.write_text(json.dumps(asdict(self), indent=1))

    @classmethod
    def read(cls, folder: Path) -> Leg | None:
        """Read ``leg.json``; None where there is none."""
        path = folder / "leg.json"
        if not path.is_file():
            return None
        with parsing(path, "record of a leg", remedy="copy it there again"):
            content = json.loads(path.read_text())
            config = content.pop("config")
            config["network"] = NeoConfig(**config["network"])
            return cls(**content, config=TrainConfig(**config))


def new_leg(
    *,
    name: str,
    weights: str | None,
    fresh: bool,
    fast: bool,
    n_points: int,
    batch: int | None,
    **options: Any,
) -> Leg:
    """Return a leg before its first phase.

    `name` is the configuration of the network, whose shipped weights are the default start, before
    other `weights` or, with `fresh`, random ones. `fast` tells whether an accelerator trains: large
    batches, bfloat16, compiled. The `options` are more of `TrainConfig`.
    """
    shipped = name if name in WEIGHTS else ""
    begin = "" if fresh else weights or shipped
    if not (fresh or begin):
        raise InvalidInputError(
            f"there are no shipped weights of {name!r}, only of {sorted(WEIGHTS)}",
            advice="give --weights FILE, or begin anew with --fresh",
        )
    start = load_pretrained(begin) if begin else None
    config = TrainConfig(
        network=NeoConfig.named(name) if start is None else start.config,
        steps=10**9,
        batch=batch or (400 if fast else 16),
        # As the shipped weights were trained: every kind of sample counts, and the rate falls
        # nearly throughout.
        relative=True,
        warmup=0.03,
        decay=0.9,
        precision="bfloat16" if fast else "float32",
        compile=fast,
        every=500,
        # Each leg sees samples of its own.
        seed=_SEED + (len(start.record.get("legs", [])) if start else 0),
        **options,
    )
    return Leg(secrets.token_hex(4), begin, config, n_points, begin or shipped)


def begun_leg(out: Path, source: Path | None, scratch: Path) -> tuple[Leg, Path] | None:
    """Find the leg to go on with, and the folder that it lies in: `source`, else `out`, `scratch`.

    None where there is none yet; a leg that has ended in `scratch` alone is none.
    """
    if source is not None and Leg.read(source) is None:
        raise InvalidInputError(
            "--from",
            "hold the leg.json of an earlier phase",
            f"none in {source}",
            advice="copy what that phase left there, or begin a leg without it",
        )
    for folder in (out, scratch) if source is None else (source,):
        leg = Leg.read(folder)
        if leg is not None and not leg.finished:
            return leg, folder
        if leg is not None and folder != scratch:
            raise InvalidInputError(
                f"the leg {leg.name} in {folder} has ended",
                advice="give another --out to begin the next",
            )
    return None
