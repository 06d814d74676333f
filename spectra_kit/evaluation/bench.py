"""`Bench`: measures methods on cases, once each, and remembers the answers in a folder."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import platform
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from spectra_kit._files import atomic_path, parsing
from spectra_kit._types import Floats
from spectra_kit._validate import check_count, frozen
from spectra_kit._version import VERSION
from spectra_kit.eigensolvers import Dense, eigensolve
from spectra_kit.eigensolvers.base import Eigenpairs
from spectra_kit.errors import DoubtfulSpectrumWarning, SpectraKitError
from spectra_kit.evaluation.cases import Case
from spectra_kit.evaluation.methods import Method
from spectra_kit.linalg.torch_device import device_clock, sparse_tensor
from spectra_kit.linalg.torch_ritz import orthonormalize, rayleigh_ritz
from spectra_kit.metrics import Comparison, compare_spectra
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum

#: Functions for each point above which a subspace says nothing: it fills the space of the points.
ROOM = 0.6
_FORMAT = 2  # of the folder; raise it where the meaning of a number changes
_ERRORS = ("span", "vector", "value")


@dataclass(frozen=True, eq=False, kw_only=True)
class Measurement:
    """The errors of one method on one case, mode by mode; see `metrics.Comparison`.

    Attributes
    ----------
    n : int
        Points.
    dimension : int
        Of the subspace, all components together.
    span, vector, value : ndarray of shape (k,)
        The NEO paper's three errors; the last is NaN for zero modes.
    seconds, exact_seconds : float
        Of the solve and of ARPACK's; see `Provenance.solving_seconds`.
    """

    n: int
    dimension: int
    span: Floats
    vector: Floats
    value: Floats
    seconds: float
    exact_seconds: float

    def __post_init__(self) -> None:
        for name in _ERRORS:
            array = np.array(getattr(self, name), dtype=np.float64)  # None reads as NaN
            object.__setattr__(self, name, frozen(array))

    def mean(self, error: str) -> float:
        """Mean over the modes of "span", "vector" or "value" (there without the kernel)."""
        return float(np.nanmean(getattr(self, error)))

    @cached_property
    def worst_mode(self) -> int:
        """The mode with the largest span error."""
        return int(self.span.argmax())

    def to_json(self) -> dict[str, Any]:
        """Return a record that the constructor takes."""
        record = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        for name in _ERRORS:
            record[name] = [None if np.isnan(x) else float(x) for x in record[name]]
        return record


@dataclass(frozen=True)
class Failure:
    """Why there is no measurement.

    Attributes
    ----------
    reason : str
        The message of the error.
    """

    reason: str


Result = Measurement | Failure
Pair = tuple[Case, Method]


class Bench:
    """Measures and remembers: asked again, also by another process, it reads the answer.

    Parameters
    ----------
    folder : path
        Made if missing: ``exact`` holds spectra, ``measurements`` one small JSON for each case and
        method. Both are named by a hash of all that decides them: case, method and release; and,
        for the seconds, machine and threads.
    k : int
        Modes.

    Raises
    ------
    InvalidInputError
        If `k` is below 1, or a file in the folder was damaged.

    Examples
    --------
    >>> import tempfile
    >>> from spectra_kit.evaluation import Bench, Case, demo_models, fourier
    >>> bench = Bench(tempfile.mkdtemp(), k=8)
    >>> case, method = Case(model=demo_models()[0], points=400), fourier(100, 4.0)
    >>> [result] = bench.run([(case, method)])
    >>> bool(result.mean("span") < 0.01)
    True
    """

    def __init__(self, folder: str | os.PathLike[str], *, k: int) -> None:
        self.k = check_count("k", k, low=1)
        self.folder = Path(folder)
        for name in ("exact", "measurements"):
            (self.folder / name).mkdir(parents=True, exist_ok=True)

    def run(self, pairs: Iterable[Pair], *, progress: bool = False) -> list[Result]:
        """Measure every pair that has not been measured before.

        Parameters
        ----------
        pairs : iterable of (Case, Method)
            Any order; operators are assembled once for all methods and rotations.
        progress : bool, default False
            Show a bar on a terminal.

        Returns
        -------
        list of Measurement or Failure
            In the order of the pairs. Failures are not remembered.
        """
        wanted = list(pairs)
        results: list[Result | None] = [self._remembered(*pair) for pair in wanted]
        groups: dict[str, list[int]] = {}
        for i, (case, _) in enumerate(wanted):
            if results[i] is None:
                groups.setdefault(_digest(case.unrotated().key()), []).append(i)
        bar = tqdm(
            total=sum(map(len, groups.values())), unit="solve", disable=None if progress else True
        )
        with bar:
            for indices in groups.values():
                first = wanted[indices[0]][0].unrotated()
                bar.set_description(f"{first.model.name}, {first.n:,} points")
                try:
                    laplacian = first.assembled()
                    exact = self.exact(first, laplacian)
                except SpectraKitError as error:
                    for i in indices:
                        results[i] = Failure(str(error))
                    bar.update(len(indices))
                    continue
                for i in indices:
                    results[i] = self._measure(*wanted[i], laplacian, exact)
                    bar.update()
        return [result for result in results if result is not None]

    def exact(self, case: Case, laplacian: Laplacian) -> Spectrum:
        """Return ARPACK's modes of a case without rotation, from the folder where they lie."""
        path = self.folder / "exact" / f"{_digest(self._key(case))}.npz"
        if path.exists():
            return Spectrum.load(path)
        spectrum = eigensolve(laplacian, self.k)
        spectrum.save(path)
        return spectrum

    def compare(self, case: Case, method: Method) -> tuple[Spectrum, Spectrum, Comparison]:
        """Solve a pair afresh and return the exact modes, the predicted ones and their errors."""
        laplacian = case.unrotated().assembled()
        exact = self.exact(case.unrotated(), laplacian)
        return exact, *self._solve(case, method, laplacian, exact)

    def _measure(self, case: Case, method: Method, laplacian: Laplacian, exact: Spectrum) -> Result:
        try:
            predicted, comparison = self._solve(case, method, laplacian, exact)
        except SpectraKitError as error:
            return Failure(str(error))
        measurement = Measurement(
            n=exact.n,
            dimension=comparison.span_dimension,
            span=comparison.span_error,
            vector=comparison.vector_error,
            value=comparison.eigenvalue_error,
            seconds=predicted.provenance.solving_seconds,
            exact_seconds=exact.provenance.solving_seconds,
        )
        key = self._key(case, method)
        with atomic_path(self._path(case, method)) as part:
            part.write_text(json.dumps({"key": key, **measurement.to_json()}))
        return measurement

    def _solve(
        self, case: Case, method: Method, laplacian: Laplacian, exact: Spectrum
    ) -> tuple[Spectrum, Comparison]:
        method.warm_up()
        solver = _Recorder(method)
        turned = case.turned(laplacian)
        with warnings.catch_warnings():  # how wrong it is, is what is measured here
            warnings.simplefilter("ignore", DoubtfulSpectrumWarning)
            predicted = eigensolve(turned, self.k, solver)
        if case.rotation is not None:
            # A turned copy of the same matrices: the hash, which covers points, would refuse it.
            unsigned = dataclasses.replace(predicted.provenance, input_hash="")
            predicted = dataclasses.replace(predicted, provenance=unsigned)
        comparison = compare_spectra(exact, predicted)
        span, dimension = solver.span_error(turned, exact)
        return predicted, dataclasses.replace(comparison, span_error=span, span_dimension=dimension)

    def _key(self, case: Case, method: Method | None = None) -> dict[str, object]:
        key: dict[str, object] = {"format": _FORMAT, "version": VERSION}
        key |= {"k": self.k, "case": case.key()}
        key |= {"machine": platform.node(), "threads": torch.get_num_threads()}  # seconds are kept
        return key if method is None else key | {"method": method.key}

    def _path(self, case: Case, method: Method) -> Path:
        return self.folder / "measurements" / f"{_digest(self._key(case, method))}.json"

    def _remembered(self, case: Case, method: Method) -> Measurement | None:
        path = self._path(case, method)
        if not path.exists():
            return None
        with parsing(path, "measurement", remedy="delete it"):
            record = json.loads(path.read_text())
            del record["key"]
            return Measurement(**record)


class _Recorder:
    """Rayleigh-Ritz in the subspace of a method, step by step as `Neo` does it; keeps the bases.

    Small clouds are not handed to LAPACK as `Neo` and `RayleighRitz` do: at 512 points that would
    measure LAPACK.
    """

    def __init__(self, method: Method) -> None:
        self.method = method
        self.bases: dict[bytes, torch.Tensor] = {}

    def __repr__(self) -> str:
        return f"evaluation of {self.method.name}"

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver`."""
        if self.method.columns > ROOM * laplacian.n:
            return Dense().eigenpairs(laplacian, k)
        clock = device_clock(self.method.device)
        basis = self.method.basis(laplacian.points, laplacian.mass)
        clock.stage("subspace")
        mass = torch.from_numpy(np.array(laplacian.mass)).to(basis.device)
        stiffness = sparse_tensor(laplacian.stiffness, self.method.device)
        clock.stage("transfer")
        values, vectors, _ = rayleigh_ritz(stiffness, mass, basis, k, clock=clock)
        pairs = Eigenpairs(values.cpu().numpy(), vectors.cpu().numpy(), clock.seconds)
        clock.stage("transfer")
        self.bases[laplacian.points.tobytes()] = basis
        return pairs

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


def _digest(key: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:24]
