"""Tell where a prediction is bad: prove by smoothing that its eigenvalues are too high."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import quantity, warn
from spectra_kit._sparse.ritz import ritz_pairs
from spectra_kit.eigen.base import Eigensolver
from spectra_kit.eigen.multigrid.smoothing import smoothed
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.errors import DoubtfulSpectrumWarning
from spectra_kit.operators.laplacian import Laplacian

#: Eigenvalues that are too high by more than this, relative to the true ones, are told.
DOUBTFUL = 0.1
_ESTIMATED = 0.03  # errors estimated to be below need no proof: estimates are better than this
_DEGREE = 12  # sparse products; twice as many prove hardly more
_COLUMNS = 32  # smoothed at a time, for the sake of memory


def with_excess(spectrum: Spectrum, laplacian: Laplacian) -> Spectrum:
    """Return a certified spectrum with `Certificate.excess`, where it leaves doubts without it."""
    certificate = spectrum.certificate
    assert certificate is not None
    if certificate.errors is not None and (certificate.errors <= _ESTIMATED).all():
        return spectrum  # these come from smoothing, too
    # Some true eigenvalue lies within the residual of each: smaller ones leave nothing to prove.
    if not (certificate.relative_residuals > DOUBTFUL).any():
        return spectrum
    excess = proved_excess(spectrum, laplacian)
    return spectrum.described(replace(certificate, excess=excess), spectrum.provenance)


def proved_excess(spectrum: Spectrum, laplacian: Laplacian) -> Floats:
    """Return by how much each eigenvalue is too high at least, relative to the true one; (k,).

    The j-th Ritz value of *any* functions is at least the j-th eigenvalue (Courant and Fischer).
    So where those of the smoothed modes are lower, the modes were too high by the difference, if
    not by more: what smoothing does not find, such as a mode that is missing altogether, is not
    proved.
    """
    values, vectors = spectrum.eigenvalues, spectrum.eigenvectors
    if len(laplacian.fixed):
        vectors = vectors[laplacian.free]
        laplacian = laplacian.restricted(laplacian.free)
    smooth = np.empty(vectors.shape)
    for start in range(0, spectrum.k, _COLUMNS):
        block = slice(start, start + _COLUMNS)
        smooth[:, block] = smoothed(laplacian, values[block], vectors[:, block], degree=_DEGREE)
    lower = ritz_pairs(laplacian.stiffness, laplacian.mass, smooth, spectrum.k).eigenvalues
    excess = np.zeros(spectrum.k)
    told = slice(laplacian.kernel_dimension, len(lower))
    excess[told] = np.maximum(values[told] / lower[told] - 1, 0.0)
    return excess


def verdict(spectrum: Spectrum) -> str:
    """Say in a line which eigenvalues are far too high, proved or estimated; nothing if none is."""
    certificate = spectrum.certificate
    if certificate is None:
        return ""
    for known, by in (("proved", certificate.excess), ("estimated", certificate.errors)):
        if by is not None and (high := by > DOUBTFUL).any():
            worst = int(by.argmax())
            return (
                f"{known} to be more than {DOUBTFUL:.0%} too high: {high.sum()} of"
                f" {quantity(spectrum.k, 'eigenvalue')}, that of mode {worst} by {by[worst]:.0%}"
                f" {'or more' if known == 'proved' else 'or so'}"
            )
    return ""


def warn_of_doubts(spectrum: Spectrum, solver: Eigensolver, *, where: str = "") -> None:
    """Warn of what is doubtful of a solver's spectrum, if it is approximate.

    That is what `verdict` says, and that the solver's target was missed. Of many spectra, `where`
    says which it is.
    """
    if spectrum.provenance.accuracy in ("exact", "to tolerance"):
        return
    if told := verdict(spectrum):
        warn(
            told,
            DoubtfulSpectrumWarning,
            advice="smooth it by {}, go on from it by {}, or take an exact solver such as {}",
            remedies=("Cascade", "Refined", "Arpack"),
            where=where,
        )
    certificate = spectrum.certificate
    errors = None if certificate is None else certificate.errors
    target, steps = getattr(solver, "target", None), spectrum.provenance.iterations
    if target is None or errors is None or not steps:  # without steps nothing was aimed at
        return
    if (left := float(errors.mean())) > target:
        warn(
            f"target = {target:g} was not reached: {quantity(steps, 'step')} of smoothing left"
            " errors that are"
            f" estimated at {left:.1e} in the mean",
            DoubtfulSpectrumWarning,
            advice=("raise {}", "use {}"),
            remedies=("max_steps", "Arpack"),
            where=where,
        )
