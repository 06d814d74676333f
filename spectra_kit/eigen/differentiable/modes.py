"""Modes to differentiate by: whole clusters of them, whose members change as one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen.accuracy import rounding
from spectra_kit.eigen.base import Eigensolver
from spectra_kit.eigen.solve import eigensolve
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.operators.laplacian import Laplacian

_MORE = 4  # modes to ask for at once, where those found cut a cluster


class Modes(NamedTuple):
    """The k modes that were asked for, and those that complete the last cluster.

    Of several equal eigenvalues, the eigenvectors are any basis, and the change of one of them is
    no derivative: a perturbation splits them, and which way depends on it. Their sum is
    differentiable, so each gets the gradient of their mean.
    """

    eigenvalues: Floats  #: (k',), k' >= k
    eigenvectors: Floats  #: (n, k')
    cluster: Ints  #: (k',), from 0
    n_zero: int  #: Leading modes without energy.

    def weights(self, given: Floats) -> Floats:
        """Share the weights (k,) of the eigenvalues among all members (k',) of their clusters."""
        total = np.bincount(self.cluster[: len(given)], given, minlength=self.cluster[-1] + 1)
        return np.asarray((total / np.bincount(self.cluster))[self.cluster])


def whole_clusters(spectrum: Spectrum, laplacian: Laplacian, solver: Eigensolver) -> Modes:
    """Find what belongs together, and the modes that the last cluster lacks.

    Of an approximate spectrum the last cluster is taken as it is: no count tells what is missing.
    """
    k, n_free = spectrum.k, len(laplacian.free)
    more, cluster = _MORE, _clusters(spectrum, laplacian)
    if _is_complete(spectrum, laplacian):
        n_whole = k
    else:
        while True:
            wide = min(k + more, n_free)
            spectrum = eigensolve(laplacian, wide, solver)
            cluster = _clusters(spectrum, laplacian)
            n_whole = int(np.searchsorted(cluster, cluster[k - 1], side="right"))
            if n_whole < wide or wide == n_free:
                break
            more *= 2
    assert spectrum.certificate is not None
    return Modes(
        spectrum.eigenvalues[:n_whole],
        spectrum.eigenvectors[:, :n_whole],
        cluster[:n_whole],
        min(spectrum.certificate.n_zero_modes, n_whole),
    )


def _is_complete(spectrum: Spectrum, laplacian: Laplacian) -> bool:
    """Whether no eigenvalue beyond the last one may belong to its cluster, as far as is known."""
    certificate = spectrum.certificate
    assert certificate is not None
    if spectrum.k == len(laplacian.free) or certificate.level != "verified":
        return True
    assert certificate.count is not None
    return bool(
        certificate.count.floor > spectrum.eigenvalues[-1] + _errors(spectrum, laplacian)[-1]
    )


def _clusters(spectrum: Spectrum, laplacian: Laplacian) -> Ints:
    """Number the clusters: neighbours that differ by no more than their errors are one.

    Zero modes, which are known exactly, are one of their own.
    """
    errors = _errors(spectrum, laplacian)
    apart = np.diff(spectrum.eigenvalues) > errors[1:] + errors[:-1]
    assert spectrum.certificate is not None
    n_zero = spectrum.certificate.n_zero_modes
    apart[: max(n_zero - 1, 0)] = False
    apart[n_zero - 1 : n_zero] = n_zero > 0
    return np.append(0, np.cumsum(apart))


def _errors(spectrum: Spectrum, laplacian: Laplacian) -> Floats:
    """Return how far each eigenvalue may be off, in 1/length^2: by rounding at least."""
    certificate = spectrum.certificate
    assert certificate is not None
    least = np.full(spectrum.k, rounding(laplacian))
    if certificate.errors is None:
        return least
    # Errors are relative to the same as residuals.
    relative, spacing = certificate.relative_residuals, laplacian.eigenvalue_spacing
    some = np.where(relative > 0, relative, 1.0)
    unit = np.where(
        relative > 0, certificate.residuals / some, np.maximum(spectrum.eigenvalues, spacing)
    )
    return np.asarray(np.maximum(certificate.errors * unit, least))
