"""Errors of networks on held-out samples: of predictions, and of what users get of them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit._sparse import orthonormalize
from spectra_kit.eigen import Cascade, Neo, eigensolve
from spectra_kit.errors import DoubtfulSpectrumWarning, InvalidInputError
from spectra_kit.neo.loss import mode_residuals, smoothed_residuals
from spectra_kit.neo.model import NeoNetwork
from spectra_kit.neo.train.checkpoint import Row
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.corpus import Corpus
from spectra_kit.neo.train.families import FAMILIES
from spectra_kit.neo.train.loader import Batch, for_validation, posed
from spectra_kit.operators.laplacian import Laplacian

_DTYPES = {"float32": None, "bfloat16": torch.bfloat16, "float16": torch.float16}


@torch.no_grad()
def validate(
    network: NeoNetwork,
    corpus: Corpus,
    config: TrainConfig,
    *,
    threads: ThreadPoolExecutor | None = None,
) -> Row:
    """Return the span errors of a network on the first samples of a corpus.

    Parameters
    ----------
    network : NeoNetwork
        In evaluation mode.
    corpus : Corpus
        Of samples that it was not trained on.
    config : TrainConfig
        How many, in which pose, and how they are smoothed.
    threads : ThreadPoolExecutor, optional
        To work in.

    Returns
    -------
    dict of str to float
        ``validation``, of the prediction, and, of samples with operators, ``smoothed``: means over
        modes and samples, or if ``config.relative`` geometric means over the samples.
    """
    device = next(network.parameters()).device
    n = min(config.validation, len(corpus))

    @torch.no_grad()
    def errors(first: int) -> Tensor:
        indices = range(first, min(first + 8, n))
        whole = for_validation(posed(corpus.batch(indices), config), config, first)
        return predicted(network, whole.to(device), config)[1]

    apply = map if threads is None else threads.map
    found = torch.cat([*apply(errors, range(0, n, 8))], dim=1).double().cpu().numpy()
    mean = typical if config.relative else np.mean
    names = ("validation", "smoothed")
    return {name: float(mean(part)) for name, part in zip(names, found, strict=False)}


def predicted(
    network: Callable[[Tensor, Tensor], Tensor], batch: Batch, config: TrainConfig
) -> tuple[Tensor, Tensor]:
    """Return the functions that a network predicts, and the errors of the samples, (1 or 2, b).

    Means over the modes: span errors and, where there are operators, what smoothing leaves of them.
    """
    points, mass, U, smoothers = batch
    dtype = _DTYPES[config.precision]
    with torch.autocast(points.device.type, dtype=dtype, enabled=dtype is not None):
        F = network(points, mass)
    if smoothers:
        return F, torch.stack(smoothed_residuals(F, mass, U, *smoothers)).mean(-1)
    return F, mode_residuals(F, mass, U).mean(-1)[None]


def errors_of(
    solver: Neo | Cascade, corpus: Corpus, *, most: int | None = None
) -> dict[str, Floats]:
    """Return the errors of a solver on the samples of a corpus with operators.

    Parameters
    ----------
    solver : Neo or Cascade
        With its weights, or another subspace, and its smoothing.
    corpus : Corpus
        Of few samples of many points, as users bring them.
    most : int, optional
        Only so many samples, the first ones.

    Returns
    -------
    dict of str to ndarray of shape (s,)
        Means over the modes of each sample: ``predicted``, the span error of all predicted
        functions; ``span``, that of the k modes after smoothing; ``value``, the relative error of
        their eigenvalues, the constant's left out. And ``steps``, which the solver took: it goes on
        until it is as good as asked for, so these tell more of a network than the errors, or its
        errors after ``max_steps=1``.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from spectra_kit import Neo
    >>> from spectra_kit.neo.train.corpus import generate, open_shards
    >>> from spectra_kit.neo.train.evaluation import errors_of
    >>> from spectra_kit.neo.train.samples import CorpusConfig
    >>> with TemporaryDirectory() as folder:
    ...     made = generate(folder, 1, config=CorpusConfig(seed=0, n_points=600, k=8))
    ...     errors = errors_of(Neo(), open_shards(folder))
    >>> bool(errors["span"][0] < errors["predicted"][0] < 0.01)
    True
    """
    if not corpus.has_operators:
        raise InvalidInputError(
            "corpus",
            "have operators",
            "one without",
            advice="make it anew: those of before had none",
        )
    if solver.subspace is None:
        raise InvalidInputError("solver", "have a subspace", solver)
    count = len(corpus) if most is None else min(check_count("most", most, low=1), len(corpus))
    rows = [_errors(solver, corpus, i) for i in range(count)]
    return dict(zip(("predicted", "span", "value", "steps"), np.array(rows).T, strict=True))


def _errors(solver: Neo | Cascade, corpus: Corpus, i: int) -> tuple[float, float, float, float]:
    batch = corpus.batch([i])
    real = np.flatnonzero(batch.mass[0])  # the rest is padding
    mass, points = batch.mass[0, real].astype(np.float64), batch.points[0, real]
    exact, values = batch.eigenvectors[0, real].astype(np.float64), batch.arrays()["eigenvalues"][0]
    exact /= np.sqrt(mass @ exact**2)  # which float16 has rounded
    laplacian = Laplacian(batch.stiffness(0)[real][:, real], mass, points)
    with warnings.catch_warnings():  # how wrong it is, is what is measured here
        warnings.simplefilter("ignore", DoubtfulSpectrumWarning)
        found = eigensolve(laplacian, len(values), solver)
    apart = np.abs(found.eigenvalues[1:] / values[1:] - 1)
    assert solver.subspace is not None
    predicted = solver.subspace(laplacian.points, mass)
    # `eigen.metrics.span_error` wants orthonormal modes, which these are but for rounding.
    before, after = (
        1 - np.square(orthonormalize(basis, mass).T @ (mass[:, None] * exact)).sum(axis=0).mean()
        for basis in (predicted, found.eigenvectors)
    )
    steps = found.provenance.iterations or 0  # none on so few points that they are solved exactly
    return float(before), float(after), float(apart.mean()), float(steps)


def typical(errors: Floats) -> float:
    """Return the geometric mean: errors of samples differ a hundredfold, rounding is no error."""
    return float(np.exp(np.log(np.maximum(errors, np.finfo(float).eps)).mean()))


def kinds(labels: Mapping[str, NDArray[np.int64]]) -> NDArray[np.str_]:
    """Return what each sample is, by its labels: ``mesh of a tube``, ``cloud of a real shape``."""
    names = (*FAMILIES, "real shape")  # FROM_POOL = -1 counts from the end
    forms = np.array(["cloud", "mesh"])[labels["mesh"]]
    return np.array(
        [f"{form} of a {names[i]}" for form, i in zip(forms, labels["family"], strict=True)]
    )
