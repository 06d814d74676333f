"""`Accuracy`: the modes in a subspace beside the exact ones, mode by mode."""

from __future__ import annotations

import platform
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch

from spectra_kit._core.fingerprint import facts_digest
from spectra_kit._core.types import Floats
from spectra_kit._sparse.blocks import device_clock
from spectra_kit._sparse.orthonormal import orthonormalize
from spectra_kit._sparse.ritz import ritz_pairs
from spectra_kit.eigen import Dense, Spectrum, eigensolve
from spectra_kit.eigen.base import Eigenpairs
from spectra_kit.eigen.metrics import Comparison, compare_spectra
from spectra_kit.eigen.multigrid.smoothing import on_device
from spectra_kit.errors import DoubtfulSpectrumWarning
from spectra_kit.operators import Laplacian
from studies.network.cases import Case
from studies.network.methods import Method
from studies.store import Record, code_digest
from studies.study import Study

#: Functions for each point above which a subspace says nothing: it fills the space of the points.
ROOM = 0.6


@dataclass(frozen=True, eq=False, kw_only=True)
class Accuracy(Study[Method, Case]):
    """The NEO paper's three errors of subspaces, and what the solves take."""

    name: ClassVar[str] = "accuracy"
    fresh: ClassVar[bool] = False

    k: int  #: Modes.

    def tasks(self) -> Iterable[tuple[Method, Case, int]]:
        """See `Study`; where a subspace has no room, it is not measured."""
        return [task for task in super().tasks() if task[0].columns <= ROOM * task[1].n]

    def facts(self, contender: Method, problem: Case) -> dict[str, object]:
        return {**self._exact_facts(problem), **problem.facts(), "method": contender.facts}

    def measure(self, contender: Method, problem: Case) -> Record:
        """Return the errors of each mode, NaN where there is none, and what the solves took.

        The ``dimension`` is that of the subspace, all components together; after smoothing there
        are the modes alone.
        """
        exact, predicted, comparison = self.compare(contender, problem)
        return {
            "n": exact.n,
            "dimension": comparison.span_dimension,
            "span": comparison.span_error.tolist(),
            "vector": comparison.vector_error.tolist(),
            "value": comparison.eigenvalue_error.tolist(),
            "seconds": predicted.provenance.solving_seconds,
            "exact_seconds": exact.provenance.solving_seconds,
        }

    def compare(self, contender: Method, problem: Case) -> tuple[Spectrum, Spectrum, Comparison]:
        """Solve afresh and return the exact modes, those in the subspace and their errors."""
        laplacian, exact = _solved(problem.unrotated(), self.k, self._exact_path(problem))
        _warm_up(contender)
        ritz = Ritz(contender)
        turned = problem.turned(laplacian)
        with warnings.catch_warnings():  # how wrong it is, is what is measured here
            warnings.simplefilter("ignore", DoubtfulSpectrumWarning)
            predicted = eigensolve(turned, self.k, contender.solver or ritz)
        if problem.rotation is not None:
            # A turned copy of the same matrices: the hash, which covers points, would refuse it.
            unsigned = replace(predicted.provenance, input_hash="")
            predicted = replace(predicted, provenance=unsigned)
        comparison = compare_spectra(exact, predicted)
        if contender.solver is not None:
            return exact, predicted, comparison
        span, dimension = ritz.span_error(turned, exact)
        return exact, predicted, replace(comparison, span_error=span, span_dimension=dimension)

    def _exact_facts(self, problem: Case) -> dict[str, object]:
        machine = {"machine": platform.node(), "threads": torch.get_num_threads()}
        return {"k": self.k, **machine, **problem.unrotated().facts()}

    def _exact_path(self, problem: Case) -> Path:
        facts = {"code": code_digest(), **self._exact_facts(problem)}
        return self.folder / "files" / f"exact-{facts_digest(facts)}.npz"


@lru_cache(maxsize=1)  # problem by problem, as they are measured
def _solved(case: Case, k: int, path: Path) -> tuple[Laplacian, Spectrum]:
    """Operator and exact modes, these from the file where they lie."""
    laplacian = case.laplacian()
    if path.exists():
        return laplacian, Spectrum.load(path)
    exact = eigensolve(laplacian, k)
    exact.save(path)
    return laplacian, exact


@cache
def _warm_up(method: Method) -> None:
    """Load weights and launch the first kernels, which are no part of any solve."""
    method.basis(np.random.default_rng(0).standard_normal((64, 3)), np.ones(64))


class Ritz:
    """Rayleigh-Ritz in the subspace of a method, step by step as `Neo` does it; keeps the bases.

    Small clouds are not handed to LAPACK as `Neo` and `RayleighRitz` do: at 512 points that would
    measure LAPACK.
    """

    def __init__(self, method: Method) -> None:
        self.method = method
        self.bases: dict[bytes, torch.Tensor] = {}

    def __repr__(self) -> str:
        return f"Rayleigh-Ritz in {self.method}"

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        device = self.method.device
        if self.method.columns > ROOM * laplacian.n:
            return Dense().eigenpairs(laplacian, k)
        clock = device_clock(device)
        basis = self.method.basis(laplacian.points, laplacian.mass)
        clock.stage("subspace")
        self.bases[laplacian.points.tobytes()] = basis
        block = basis.numpy() if device == "cpu" else basis
        stiffness, mass = (on_device(a, device) for a in (laplacian.stiffness, laplacian.mass))
        clock.stage("transfer")
        values, vectors, _ = ritz_pairs(stiffness, mass, block, k, least=k)
        clock.stage("rayleigh_ritz")
        vectors = np.asarray(torch.as_tensor(vectors).cpu())
        clock.stage("transfer")
        return Eigenpairs(values, vectors, clock.seconds)

    def span_error(self, laplacian: Laplacian, exact: Spectrum) -> tuple[Floats, int]:
        """``1 - |Y^T M u|^2`` of each exact mode, and the columns of Y, over all components."""
        inside, dimension = np.zeros(exact.k), 0
        for label in range(laplacian.n_components):
            part = np.flatnonzero(laplacian.component_labels == label)
            weighted = laplacian.mass[part, None] * exact.eigenvectors[part]
            basis = self.bases.get(laplacian.points[part].tobytes())
            if basis is None:  # too small a component: solved exactly
                inside += np.sum(weighted * exact.eigenvectors[part], axis=0)
                dimension += len(part)
            else:
                mass = torch.from_numpy(laplacian.mass[part]).to(basis.device)
                Y = orthonormalize(basis, mass).cpu().numpy()
                inside += np.sum((Y.T @ weighted) ** 2, axis=0)
                dimension += Y.shape[1]
        return np.clip(1.0 - inside, 0.0, 1.0), dimension
