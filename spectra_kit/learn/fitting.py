"""The one loop that trains the networks here: `fit`, by a `Training`."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.utils.rnn import pad_sequence
from tqdm import trange

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit._sparse.torch_device import check_device
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry
from spectra_kit.learn.examples import Example, Recipe, batched, stretched
from spectra_kit.learn.networks import Batch, Network, pooled
from spectra_kit.learn.tensors import UNKNOWN
from spectra_kit.neo.train import checkpoint

_WARMUP = 0.1  # of all steps
_TURNED = [
    Tensor(rotation[None])
    for rotation in Rotation.random(4, rng=np.random.default_rng(0)).as_matrix()
]


@checked
@dataclass(frozen=True, kw_only=True)
class Training:
    """How a network is trained; its last state counts, none is picked by any score.

    Parameters
    ----------
    epochs : int, default 40
        Times that each example is shown, turned anew each time where turning it matters.
    batch : int, default 4
        Examples of a step; a quarter of them all where these are fewer than four batches.
    rate : float, default 2e-3
        Largest learning rate of AdamW: it rises over a tenth of the steps, and falls to nothing.
    decay : float, default 1e-2
        Of the weights.
    smoothing : float, default 0.1
        Share of each label that is spread over all classes.
    copies : int, default 0
        Of each example, stretched at random along random axes, shown beside it: where there are
        few examples, or shapes of one class differ in their proportions.
    points : int, optional
        Show so many points of each example, others each time; all by default. Networks that see
        operators need them all, and so do labels of faces.
    seed : int, default 0
        Of weights, order, rotations and points.
    """

    epochs: int = 40
    batch: int = 4
    rate: float = 2e-3
    decay: float = 1e-2
    smoothing: float = 0.1
    copies: int = 0
    points: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_count("epochs", self.epochs, low=1)
        check_count("batch", self.batch, low=1)
        check_count("copies", self.copies, low=0)
        check_positive("rate", self.rate)
        for name in ("decay", "smoothing"):
            if not 0 <= getattr(self, name) < 1:
                raise InvalidInputError(name, "be in [0, 1)", getattr(self, name))
        if self.points is not None:
            check_count("points", self.points, low=1)
        check_count("seed", self.seed, low=0)


def with_copies(shapes: Sequence[Geometry], training: Training) -> list[tuple[int, Geometry]]:
    """Return all shapes with their numbers, then the stretched copies that training asks for."""
    rng = np.random.default_rng([training.seed, len(shapes)])
    copies = [
        (i, stretched(shape, rng)) for _ in range(training.copies) for i, shape in enumerate(shapes)
    ]
    return [*enumerate(shapes), *copies]


class Model(nn.Module):
    """A network behind the scaling of its inputs; of whole shapes, the mean over all points."""

    def __init__(self, network: Network, inputs: int, classes: int, *, whole: bool) -> None:
        super().__init__()
        self.network, self.whole, self.sees = network.build(inputs, classes), whole, network.sees
        self.mean = nn.Buffer(torch.zeros(inputs))
        self.spread = nn.Buffer(torch.ones(inputs))

    def forward(self, batch: Batch) -> Tensor:
        """Return logits: (b, n, classes), or (b, classes) of whole shapes."""
        features = (batch.features - self.mean) / self.spread
        logits: Tensor = self.network(batch._replace(features=features))
        return pooled(logits, batch.mass) if self.whole else logits


def fit(
    recipe: Recipe,
    network: Network,
    examples: Sequence[Example],
    labels: Sequence[Tensor],
    *,
    classes: int,
    training: Training,
    corners: Sequence[Tensor] = (),
    folder: Path | None = None,
    device: str = "cpu",
    progress: bool = False,
    watch: Callable[[Model, int], dict[str, float]] | None = None,
) -> tuple[Model, list[dict[str, float]]]:
    """Train a network; return it, and what was seen after each epoch.

    Labels are () of whole shapes, (n,) of points, or with corners (f, 3) of their faces (f,);
    `UNKNOWN` where nothing is known. With a folder, its checkpoint is written after each epoch, and
    gone on from: the result is that of a run without an interruption. The model comes back on the
    CPU, wherever it was trained. `watch` may measure it after each epoch, whose number it is told.
    """
    whole, place = labels[0].ndim == 0, check_device(device)
    if training.points is not None and network.sees:
        raise InvalidInputError(
            "points",
            "be None, all points, for a network that sees operators",
            training.points,
            advice="sample the shapes themselves, with `Recipe.points`",
        )
    with torch.random.fork_rng(devices=[place] if place.type == "cuda" else []):
        torch.manual_seed(training.seed)
        first = batched(recipe, examples[:1])
        model = Model(network, first.features.shape[-1], classes, whole=whole)
        _scale(model, recipe, examples)
        model.to(place)
        run = _Run(model, training, -(-len(examples) // _size(training, len(examples))))
        facts = _facts(recipe, network, training, examples, [*labels, *corners], classes)
        begun = _resumed(run, folder, facts)
        shown = trange(
            begun, training.epochs, initial=begun, total=training.epochs, unit="epoch",
            disable=None if progress else True,
        )  # fmt: skip
        for epoch in shown:
            torch.manual_seed(hash_of(training.seed, epoch))  # of dropout
            loss = _epoch(run, recipe, examples, labels, corners, epoch)
            seen = {"epoch": epoch + 1, "loss": loss, **(watch(model, epoch + 1) if watch else {})}
            run.curve.append(seen)
            shown.set_postfix({name: f"{value:.3g}" for name, value in seen.items()})
            if folder is not None:
                checkpoint.write(folder, run.state(facts))
    return model.to("cpu").eval(), run.curve


def hash_of(*numbers: int) -> int:
    """Return a seed that follows from several."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0] >> 1)


class _Run:
    """What training changes."""

    def __init__(self, model: Model, training: Training, steps: int) -> None:
        self.model, self.training = model, training
        self.optimizer = torch.optim.AdamW(
            model.parameters(), lr=training.rate, weight_decay=training.decay
        )
        self.schedule = torch.optim.lr_scheduler.LambdaLR(
            self.optimizer, partial(_rate, steps * training.epochs)
        )
        self.curve: list[dict[str, float]] = []

    def state(self, facts: str) -> dict[str, Any]:
        return {
            "facts": facts,
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "schedule": self.schedule.state_dict(),
            "curve": self.curve,
        }


def _rate(steps: int, step: int) -> float:
    """Return the share of the largest rate: a line up, then half a wave down to nothing."""
    warm = _WARMUP * steps
    if step < warm:
        return (step + 1) / (warm + 1)
    return 0.5 + 0.5 * math.cos(math.pi * (step - warm) / (steps - warm))


def _resumed(run: _Run, folder: Path | None, facts: str) -> int:
    """Take up a run where it stopped; return the number of its epochs that are done."""
    if folder is None:
        return 0
    if folder.exists() and not folder.is_dir():
        raise InvalidInputError("folder", "be a folder", f"the file {str(folder)!r}")
    folder.mkdir(parents=True, exist_ok=True)
    state = checkpoint.read(folder)
    if state is None:
        return 0
    if state.get("facts") != facts:
        raise InvalidInputError(
            "folder",
            "hold a checkpoint of the same run",
            "one of another recipe, network, training, or of other examples",
            advice="name another folder, or delete the checkpoint",
        )
    run.model.load_state_dict(state["model"])
    run.optimizer.load_state_dict(state["optimizer"])
    run.schedule.load_state_dict(state["schedule"])
    run.curve.extend(state["curve"])
    return len(run.curve)


def _facts(
    recipe: Recipe,
    network: Network,
    training: Training,
    examples: Sequence[Example],
    labels: Sequence[Tensor],
    classes: int,
) -> str:
    """Return what tells a run from all others: its options, and a hash of what it learns from."""
    content = hashlib.sha256()
    seen = (part for e in examples for part in (e.points, e.mass, e.features))
    for part in (*seen, *labels):
        content.update(repr(tuple(part.shape)).encode() + part.numpy().tobytes())
    return repr((recipe, network, asdict(training), classes, content.hexdigest()))


def _size(training: Training, count: int) -> int:
    return max(1, min(training.batch, count // 4))


def _epoch(
    run: _Run,
    recipe: Recipe,
    examples: Sequence[Example],
    labels: Sequence[Tensor],
    corners: Sequence[Tensor],
    epoch: int,
) -> float:
    """Show all examples once; return the mean loss."""
    training, model = run.training, run.model.train()
    rng = np.random.default_rng([training.seed, epoch])
    order = rng.permutation(len(examples))
    size, total = _size(training, len(order)), 0.0
    for start in range(0, len(order), size):
        chosen = order[start : start + size]
        some, truth = _drawn([examples[i] for i in chosen], [labels[i] for i in chosen], run, rng)
        turned = Tensor(Rotation.random(len(chosen), rng=rng).as_matrix())
        shown = batched(recipe, some, rotations=turned if recipe.turns else None)
        logits = model(shown.to(model.mean.device))
        if corners:
            logits = _at_faces(logits, [corners[i] for i in chosen])
        loss = _loss(logits, truth.to(logits.device), training.smoothing)
        run.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        run.optimizer.step()
        run.schedule.step()
        total += loss.item() * len(chosen)
    return total / len(order)


def _at_faces(logits: Tensor, corners: Sequence[Tensor]) -> Tensor:
    """Return the means (b, f, classes) over the corners of all faces, padded."""
    means = [own[rows.to(own.device)].mean(1) for own, rows in zip(logits, corners, strict=True)]
    return pad_sequence(means, batch_first=True)


def _loss(logits: Tensor, truth: Tensor, smoothing: float) -> Tensor:
    """Return the mean over what is known, which padding is not; 0 where that is nothing."""
    total = F.cross_entropy(
        logits.flatten(0, -2),
        truth.flatten(),
        ignore_index=UNKNOWN,
        label_smoothing=smoothing,
        reduction="sum",
    )
    return total / (truth != UNKNOWN).sum().clamp(min=1)


def _drawn(
    examples: list[Example], labels: list[Tensor], run: _Run, rng: np.random.Generator
) -> tuple[list[Example], Tensor]:
    """Return examples of the points to be shown, and their labels, padded."""
    count, whole = run.training.points, run.model.whole
    if count is not None:
        rows = [torch.from_numpy(rng.permutation(e.n)[:count]) for e in examples]
        examples = [e.some(r) for e, r in zip(examples, rows, strict=True)]
        labels = labels if whole else [y[r] for y, r in zip(labels, rows, strict=True)]
    if whole:
        return examples, torch.stack(labels)
    return examples, pad_sequence(labels, batch_first=True, padding_value=UNKNOWN)


@torch.no_grad()
def _scale(model: Model, recipe: Recipe, examples: Sequence[Example]) -> None:
    """Let features have mean zero and spread one over all points of the examples."""
    total = square = torch.zeros(len(model.mean), dtype=torch.float64)
    for example in examples:
        batch = batched(recipe, [example])
        values = batch.features[0].double()
        total = total + example.mass.double() @ values
        square = square + example.mass.double() @ values.square()
    mean = total / len(examples)
    model.mean.copy_(mean)
    spread = (square / len(examples) - mean.square()).clamp(min=0).sqrt()
    model.spread.copy_(torch.where(spread > 1e-9, spread, 1.0))


def predicted(model: Model, recipe: Recipe, example: Example) -> Floats:
    """Return the probabilities of all classes: (n, classes), or (classes,) of a whole shape.

    Where rotations change what is seen, the mean over some, always the same: a turned shape is
    seen much as before.
    """
    rotations = _TURNED if recipe.turns else [None]
    with torch.no_grad():
        turned = [batched(recipe, [example], rotations=rotation) for rotation in rotations]
        logits = [
            model(batch.to(model.mean.device))[0].double().softmax(-1).cpu() for batch in turned
        ]
    return np.asarray(torch.stack(logits).mean(dim=0))
