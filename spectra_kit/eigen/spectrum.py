"""`Spectrum`: the one object every eigensolver produces and every application consumes."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.files import parsing
from spectra_kit._core.records import Rebuilt, cached, frozen
from spectra_kit._core.shown import draw
from spectra_kit._core.threads import blas_threads_for
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive, quantity
from spectra_kit._sparse.host import dots, energies, gram, product
from spectra_kit._sparse.inverse_norms import inverse_squares
from spectra_kit._sparse.products import residual_norms, weighed
from spectra_kit.eigen.certificate import Certificate, ModeCount, Provenance
from spectra_kit.eigen.spectrum_file import REMEDY, read_spectrum_file, write_spectrum_file
from spectra_kit.errors import InvalidInputError, InvalidSpectrumError
from spectra_kit.operators.laplacian import Laplacian, check_dimension, split_mass

if TYPE_CHECKING:
    import torch


_FOREIGN_MASS = 1e-5  # relative; float32 copies of the same mass differ by less
_LARGEST_FACTOR = 1e150  # to change the unit of length by
_ZERO_MODE = 1e-7  # eigenvalues below this over the area count as zero where no operator can tell
_SHOWN = 12  # eigenvalues in a notebook
_BY_THE_USER = Provenance()


@checked
@dataclass(frozen=True, eq=False)
class Spectrum(Rebuilt):
    """The k lowest eigenpairs of ``L u = lambda M u`` on n points.

    Immutable. Signs, and bases inside an eigenspace, are unspecified and never "fixed". float64
    arrays are viewed, not copied (they can be gigabytes): do not write to them afterwards.

    Parameters
    ----------
    eigenvalues : array_like of shape (k,)
        Ascending, >= 0, in 1/length^2.
    eigenvectors : array_like of shape (n, k)
        Columns, M-orthonormal: ``U.T @ (mass[:, None] * U) == I``; in 1/length, of volumes in
        1/length^(3/2). `eigensolve` checks that; here it is taken for granted.
    mass : array_like of shape (n,), or sparse array of shape (n, n)
        M, positive, in length^2, of volumes in length^3: lumped, or a matrix, as of `Laplacian`.
    certificate : Certificate, optional
        Residuals and counts; `eigensolve` always fills it.
    provenance : Provenance, optional
        Solver, operator, seed, times, input hash.
    consistent_mass : sparse array of shape (n, n), optional
        M where it is not diagonal; `mass`, lumped, then weighs points.
    dimension : int, default 2
        3 in a volume, as `Laplacian.dimension` says.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit import Spectrum
    >>> s = Spectrum(np.array([0.0]), np.full((4, 1), 0.5), np.ones(4))
    >>> s.project(np.array([1.0, 2.0, 3.0, 4.0]))
    array([5.])
    """

    eigenvalues: Floats
    eigenvectors: Floats
    mass: Annotated[Floats, sparse.sparray]
    certificate: Certificate | None = None
    provenance: Provenance = _BY_THE_USER
    consistent_mass: sparse.csr_array | None = None
    dimension: int = 2

    def __post_init__(self) -> None:
        check_dimension(self.dimension)
        consistent, n = self.consistent_mass, np.shape(self.eigenvectors)[:1] or (0,)
        if sparse.issparse(self.mass):
            lumped, consistent = split_mass("mass", self.mass, *n)
            object.__setattr__(self, "mass", lumped)
        elif consistent is not None and not _is_ours(consistent, n):
            consistent = split_mass("consistent_mass", consistent, *n)[1]
        for array in () if consistent is None else _parts(consistent):
            array.flags.writeable = False
        object.__setattr__(self, "consistent_mass", consistent)
        values, vectors, mass = (
            _as_float64(name, getattr(self, name), ndim)
            for name, ndim in (("eigenvalues", 1), ("eigenvectors", 2), ("mass", 1))
        )
        if vectors.shape != (len(mass), len(values)):
            raise InvalidSpectrumError(
                "eigenvectors",
                f"have shape ({len(mass)}, {len(values)}) for {len(mass)} masses and"
                f" {quantity(len(values), 'eigenvalue')}",
                vectors.shape,
                advice="transposed?" if vectors.shape == (len(values), len(mass)) else "",
            )
        if (values[1:] < values[:-1]).any() or (len(values) and values[0] < 0):
            raise InvalidSpectrumError(
                "eigenvalues",
                "be non-negative and ascending",
                f"a smallest value of {values.min():.3g} and steps down to"
                f" {np.diff(values).min(initial=0):.3g}",
                advice="sort the pairs, and turn the sign of a negative Laplacian",
            )
        if not (mass > 0).all():
            raise InvalidSpectrumError(
                "mass", "be positive", f"{quantity((mass <= 0).sum(), 'entry')} <= 0"
            )
        _check_covers(self.certificate, len(values))
        for name, array in (("eigenvalues", values), ("eigenvectors", vectors), ("mass", mass)):
            object.__setattr__(self, name, frozen(array))

    @property
    def k(self) -> int:
        """Number of modes."""
        return len(self.eigenvalues)

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.mass)

    @property
    def area(self) -> float:
        """Total mass, in length^2; of a volume that volume, in length^3."""
        return float(self.mass.sum())

    @property
    def n_zero_modes(self) -> int:
        """Number of modes in the kernel: certified where possible, else lambda * area < 1e-7."""
        if self.certificate is not None:
            return self.certificate.n_zero_modes
        return int((self.eigenvalues * self.area ** (2 / self.dimension) <= _ZERO_MODE).sum())

    def truncate(self, k: int) -> Spectrum:
        """Return the first k modes, certificate included."""
        return self._modes(slice(0, check_count("k", k, low=1, high=self.k)))

    def nonzero(self) -> Spectrum:
        """Return the modes outside the kernel: what deflation, GPS and descriptors need."""
        return self._modes(slice(self.n_zero_modes, self.k))

    def rescale(self, factor: float) -> Spectrum:
        """Return the spectrum of the same surface with lengths multiplied by `factor`.

        A factor of 1000 leads from metres to millimetres: eigenvalues are divided by its square,
        masses multiplied by that, and eigenvectors divided by the factor; of a volume, masses
        multiplied by its cube, and eigenvectors divided by the root of that. The provenance has no
        input hash, for no solver has seen the scaled surface.
        """
        largest = _LARGEST_FACTOR ** (2 / self.dimension)
        powers = "squares" if self.dimension == 2 else "cubes"
        if not 1 / largest <= check_positive("factor", factor) <= largest:
            raise InvalidInputError(
                "factor",
                f"be in [{1 / largest:g}, {largest:g}], whose {powers} are numbers",
                f"{factor:g}",
            )
        return self._rescaled(factor)

    def _of_size_one(self) -> Spectrum:
        """Return it in the unit of length in which area, or volume, is one."""
        return self.rescale(self.area ** (-1 / self.dimension))

    def _rescaled(self, length: float, energy: float = 1.0) -> Spectrum:
        """Return it with lengths, and energies, multiplied by these."""
        square, old, M = length**2, self.certificate, self.consistent_mass
        certificate = old and replace(
            old,
            residuals=old.residuals / square * energy,
            count=old.count and old.count.rescaled(square).rescaled(1 / energy),
        )
        return replace(
            self,
            eigenvalues=self.eigenvalues / square * energy,
            eigenvectors=self.eigenvectors / length ** (self.dimension / 2),
            mass=self.mass * length**self.dimension,
            consistent_mass=None if M is None else M * length**self.dimension,
            certificate=certificate,
            provenance=replace(self.provenance, input_hash=""),
        )

    def project(self, values: Annotated[ArrayLike, NDArray[np.bool_]]) -> Floats:
        """Return the coefficients ``U^T M f`` of functions, in their unit times length.

        In a volume, times length^(3/2). `values` has shape (n,) or, of c functions, (n, c); the
        coefficients have (k,) or (k, c).
        """
        f = _as_columns("values", values, self.n)
        with blas_threads_for(self.eigenvectors.size):
            return np.asarray(self.eigenvectors.T @ self._weighed(f))

    def reconstruct(self, coefficients: ArrayLike) -> Floats:
        """Return the functions ``U c`` with these coefficients.

        The coefficients have shape (k,) or (k, c), as of `project`; the functions (n,) or (n, c).
        """
        c = _as_columns("coefficients", coefficients, self.k)
        with blas_threads_for(self.eigenvectors.size):
            return np.asarray(self.eigenvectors @ c)

    def filter(self, response: Callable[[Floats], Floats], values: ArrayLike) -> Floats:
        """Return ``U g(lambda) U^T M f``: functions with each mode multiplied by a number.

        `response` is g: it takes the eigenvalues, (k,), and returns as many numbers. `values` is f,
        one function (n,) or c of them (n, c); so is what comes back.
        """
        gain = np.asarray(response(self.eigenvalues), dtype=np.float64)
        if gain.shape != (self.k,):
            raise InvalidInputError(
                "response",
                f"return shape ({self.k},) for {quantity(self.k, 'eigenvalue')}",
                gain.shape,
            )
        return self.reconstruct((gain * self.project(values).T).T)

    def residuals(self, laplacian: Laplacian) -> Floats:
        """Return ``||L u - lambda M u|| / ||u||`` of each mode: (k,), in 1/length^2.

        In the M^-1 and M norms: within so much of each eigenvalue lies a true one of `laplacian`,
        which has the points and the mass of the spectrum. Rows of fixed (Dirichlet) points are left
        out: there u is prescribed, not solved for.
        """
        self._check_belongs_to(laplacian)
        M = laplacian.consistent_mass
        if M is None:
            norms, along = residual_norms(
                laplacian.stiffness,
                laplacian.mass,
                self.eigenvalues,
                self.eigenvectors,
                left_out=laplacian.fixed,
            )
        else:
            rest = product(laplacian.stiffness, self.eigenvectors)
            rest -= self._weighed(self.eigenvectors) * self.eigenvalues
            if len(laplacian.fixed):
                rest, M = rest[laplacian.free], laplacian.restricted(laplacian.free).consistent_mass
            norms = np.sqrt(inverse_squares(M, rest, laplacian._least_weight))
            along = dots(self.eigenvectors[laplacian.free], rest)
        vars(self)["_along"] = frozen(along)
        known = vars(self).get("_products")
        if known is None and M is None:
            squared = energies(self.mass, self.eigenvectors)
        else:
            squared = self._products.diagonal()
        if not squared.all():
            raise InvalidSpectrumError("eigenvectors", "not hold a column of zeros")
        return np.asarray(norms / np.sqrt(squared))

    def _rest_along(self, laplacian: Laplacian) -> Floats:
        """``u^T (L u - lambda M u)`` of each mode, which `residuals` meets on its way."""
        if "_along" not in vars(self):
            self.residuals(laplacian)
        return np.asarray(vars(self)["_along"])

    def _check_belongs_to(self, laplacian: Laplacian) -> None:
        """Refuse to compare this spectrum with an operator that it cannot be of."""
        if laplacian.n != self.n:
            raise InvalidInputError(
                "laplacian", f"live on the {self.n} points of this spectrum", laplacian.n
            )
        if laplacian.dimension != self.dimension:
            raise InvalidInputError(
                "laplacian",
                f"have the dimension {self.dimension} of this spectrum",
                laplacian.dimension,
            )
        if not (np.abs(laplacian.mass - self.mass) <= _FOREIGN_MASS * self.mass).all():
            times = laplacian.mass / self.mass
            raise InvalidInputError(
                "laplacian",
                "have the mass of this spectrum",
                f"entries between {times.min():.3g} and {times.max():.3g} times it",
                advice="is the unit the same?",
            )
        own, other = self.consistent_mass, laplacian.consistent_mass
        alike = own is other
        if own is not None and other is not None:
            alike = alike or bool(abs(own - other).max() <= _FOREIGN_MASS * abs(other).max())
        if not alike:
            raise InvalidInputError(
                "laplacian",
                "have the mass of this spectrum",
                "one that is lumped, and one that is not, or another",
            )
        if not len(laplacian.fixed):
            return
        held = np.abs(self.eigenvectors[laplacian.fixed]).max(initial=0.0)
        if held > 1e-8 * np.abs(self.eigenvectors).max(initial=0.0):
            raise InvalidInputError(
                "laplacian",
                f"hold points at zero where these modes are, unlike {held:.3g} at some of"
                f" {quantity(len(laplacian.fixed), 'point')}",
                advice="they belong to another boundary condition",
            )

    @cached
    def _products(self) -> Floats:
        """``U^T M U``."""
        return frozen(gram(self._weights, self.eigenvectors))

    @property
    def _weights(self) -> Floats | sparse.csr_array:
        """M: its diagonal, or all of it."""
        return self.mass if self.consistent_mass is None else self.consistent_mass

    def _weighed(self, f: Floats) -> Floats:
        """``M f`` of one function, (n,), or several, (n, c)."""
        columns = f if f.ndim == 2 else f[:, None]
        return np.asarray(weighed(self._weights, columns)).reshape(f.shape)

    def orthonormality_error(self) -> float:
        """Return the largest entry of ``|U^T M U - I|``; 0 without any modes."""
        return float(np.abs(self._products - np.eye(self.k)).max(initial=0.0))

    def certify(self, laplacian: Laplacian) -> Spectrum:
        """Return this spectrum with a `Certificate`, whoever computed it.

        It is held against `laplacian` as in `residuals`. Eigenvalues are not counted: see `verify`.
        """
        return self.described(certificate_of(self, laplacian), self.provenance)

    def described(self, certificate: Certificate | None, provenance: Provenance) -> Spectrum:
        """Return the same modes with these facts; the arrays, checked once, are not read again."""
        _check_covers(certificate, self.k)
        spectrum = object.__new__(type(self))
        vars(spectrum).update(vars(self), certificate=certificate, provenance=provenance)
        return spectrum

    def _spacings(self, laplacian: Laplacian) -> Floats:
        """Eigenvalue spacing of the component on which each mode lives (weighted, if several)."""
        if laplacian.n_components == 1:
            return np.full(self.k, laplacian.component_spacings[0])
        shares = self._by_component(laplacian) @ self._on_free(laplacian) ** 2
        return np.asarray(laplacian.component_spacings @ (shares / shares.sum(axis=0)))

    def _kernel_modes(self, laplacian: Laplacian) -> int:
        """How many modes lie in the kernel: the squared cosines between it and their span."""
        if not laplacian.kernel_dimension:
            return 0
        member = self._by_component(laplacian, laplacian._row_sums)[laplacian.constant_components]
        roots = np.sqrt(np.asarray(member.sum(axis=1)))
        cosines = member.dot(self._on_free(laplacian)) / roots[:, None]
        return min(round(float((cosines**2).sum())), laplacian.kernel_dimension)

    def _on_free(self, laplacian: Laplacian) -> Floats:
        """The eigenvectors at the free points, not copied where all are."""
        return self.eigenvectors[laplacian.free] if len(laplacian.fixed) else self.eigenvectors

    def _by_component(self, laplacian: Laplacian, mass: Floats | None = None) -> Any:
        """The mass of each free point in the row of its component, (n_components, n_free)."""
        free, weights = laplacian.free, self.mass if mass is None else mass
        weights = weights[free] if len(laplacian.fixed) else weights
        if laplacian.n_components == 1:
            return weights[None]  # a row without zeros
        labels = laplacian.component_labels[free]
        return sparse.csr_array((weights, (labels, np.arange(len(free)))))

    def save(self, path: str | Path) -> None:
        """Write everything to one versioned ``.npz`` file, whole or not at all.

        float64, uncompressed and aligned, so `load` can map it; plain ``numpy.load`` reads it too.
        What is there is replaced.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        known = self.certificate, self.provenance
        write_spectrum_file(Path(path), self._arrays, *known, dimension=self.dimension)

    @property
    def _arrays(self) -> dict[str, NDArray[Any]]:
        """What a file holds of it, by name."""
        arrays = {n: getattr(self, n) for n in ("eigenvalues", "eigenvectors", "mass")}
        if (M := self.consistent_mass) is not None:
            arrays |= {f"mass_{name}": getattr(M, name) for name in ("data", "indices", "indptr")}
        return arrays

    @classmethod
    def load(cls, path: str | Path, *, mmap: bool = False) -> Spectrum:
        """Read a spectrum written by `save`, with certificate and provenance.

        With `mmap` the arrays are mapped instead of read: instant, paged in as they are used, and
        without the checks (checksums, finite values) that reading makes.

        Raises
        ------
        InvalidFileError
            If the file is not there or no spectrum, is truncated, or has a newer format version.
        """
        path = Path(path)
        with parsing(path, "spectrum file", remedy=REMEDY):
            return cls(**read_spectrum_file(path, mmap=mmap))

    def to_torch(
        self, *, device: str | torch.device = "cpu", dtype: torch.dtype | None = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return eigenvalues (k,), eigenvectors (n, k) and mass (n,) as new tensors.

        They are float64, unless `dtype` is another real one.
        """
        import torch

        from spectra_kit._sparse.torch_device import check_device, check_float_dtype

        place = check_device(str(device))
        kind = torch.float64 if dtype is None else check_float_dtype(dtype)

        def tensor(a: Floats) -> Any:
            return torch.tensor(np.array(a), device=place, dtype=kind)

        return tensor(self.eigenvalues), tensor(self.eigenvectors), tensor(self.mass)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """Draw its eigenvalues, as `show.plot_spectrum` does.

        The picture is written to `path`: PNG, PDF or SVG by its suffix. Notebooks show it.
        """
        return draw("plot_spectrum", self, path=path)

    def __repr__(self) -> str:
        certified = "uncertified" if self.certificate is None else self.certificate.summary
        kind = "" if self.dimension == 2 else "of a volume, "
        return (
            f"Spectrum({kind}n={self.n}, k={self.k}, eigenvalues"
            f" {self.eigenvalues[:1].sum():.4g} to {self.eigenvalues[-1:].sum():.4g}, {certified},"
            f" solver={self.provenance.solver})"
        )

    def _facts(self) -> Mapping[str, object]:
        values = [f"{value:.6g}" for value in self.eigenvalues]
        shown = values if self.k <= _SHOWN else [*values[: _SHOWN - 2], "…", values[-1]]
        return {
            "points": f"{self.n:,}" + (" in a volume" if self.dimension == 3 else ""),
            "modes": f"{self.k:,}, {self.n_zero_modes} of them zero",
            "eigenvalues": ", ".join(shown),
            "certificate": self.certificate.summary if self.certificate else "none",
            "operator": self.provenance.operator,
            "solver": self.provenance.solver,
        }

    def _modes(self, columns: slice) -> Spectrum:
        """Return the modes in `columns`, certificate included."""
        old = self.certificate
        start, stop, _ = columns.indices(self.k)
        certificate = old and replace(
            old,
            residuals=old.residuals[columns],
            relative_residuals=old.relative_residuals[columns],
            n_zero_modes=max(min(old.n_zero_modes, stop) - start, 0),
            # Leading modes dropped on purpose are not missing from the kernel.
            kernel_dimension=max(old.kernel_dimension - start, 0),
            count=old.count and self._count_of(old.count, start, stop),
            excess=None if old.excess is None else old.excess[columns],
            errors=None if old.errors is None else old.errors[columns],
            bounded=old.bounded[columns],
        )
        return replace(
            self,
            eigenvalues=self.eigenvalues[columns],
            eigenvectors=self.eigenvectors[:, columns],
            certificate=certificate,
        )

    def _count_of(self, count: ModeCount, start: int, stop: int) -> ModeCount:
        """Return what `count` says of the modes from `start` to `stop`."""
        if stop < count.verified:  # the next mode is known to within the radius
            floor = float(self.eigenvalues[stop]) - count.radius
            count = replace(count, verified=stop, floor=floor)
        if count.verified == stop:
            count = replace(count, missing=0, reason="")
        return replace(count, verified=max(count.verified - start, 0))


def _parts(matrix: sparse.csr_array) -> tuple[NDArray[Any], ...]:
    return matrix.data, matrix.indices, matrix.indptr


def _is_ours(matrix: Any, n: tuple[int, ...]) -> bool:
    """Whether a mass was checked before: it can be gigabytes, too."""
    if not isinstance(matrix, sparse.csr_array) or matrix.shape != 2 * n:
        return False
    return matrix.dtype == np.float64 and not any(a.flags.writeable for a in _parts(matrix))


def certificate_of(
    spectrum: Spectrum, laplacian: Laplacian, errors: Floats | None = None
) -> Certificate:
    """Return what `Spectrum.certify` finds, with the `errors` that a solver told."""
    orthonormality_error = spectrum.orthonormality_error()  # with norms, for the residuals
    residuals = spectrum.residuals(laplacian)
    unit = np.maximum(spectrum.eigenvalues, spectrum._spacings(laplacian))
    if errors is not None:
        # None is below the rounding of u^T L u: so many terms in each row, |u|^T |L| |u| in size,
        # for which twice the diagonal of L stands.
        L, U = laplacian.stiffness, spectrum.eigenvectors
        terms = L.nnz / laplacian.n * 2 * np.einsum("i,ij,ij->j", L.diagonal(), U, U)
        least = np.finfo(np.float64).eps * terms / unit
        errors = np.where(errors > 0, np.maximum(errors, least), errors)  # 0 is said of exact ones
    return Certificate(
        residuals=residuals,
        relative_residuals=residuals / unit,
        orthonormality_error=orthonormality_error,
        n_zero_modes=spectrum._kernel_modes(laplacian),
        kernel_dimension=laplacian.kernel_dimension,
        n_components=laplacian.n_components,
        errors=errors,
    )


def _check_covers(certificate: Certificate | None, k: int) -> None:
    if certificate is not None and len(certificate.residuals) != k:
        raise InvalidSpectrumError(
            "certificate", f"cover {quantity(k, 'mode')}", len(certificate.residuals)
        )


def _as_columns(name: str, values: ArrayLike, rows: int) -> Floats:
    """Return `values` as float64 of shape (rows,) or (rows, c)."""
    array = np.asarray(values)
    if array.ndim not in (1, 2) or array.shape[0] != rows:
        raise InvalidInputError(name, f"be real, of shape ({rows},) or ({rows}, c)", array.shape)
    if not np.isfinite(array).all():
        raise InvalidInputError(
            name, "be finite", quantity((~np.isfinite(array)).sum(), "NaN or infinite value")
        )
    return array.astype(np.float64, copy=False)


def _as_float64(name: str, values: ArrayLike, ndim: int) -> Floats:
    """Return a finite float64 array of `ndim` dimensions, without a copy where possible."""
    array = np.asarray(values)
    if array.ndim != ndim or array.dtype.kind not in "fiu":
        raise InvalidSpectrumError(
            name,
            f"be a real array with {ndim} dimensions",
            f"shape {array.shape} of {array.dtype}",
        )
    array = np.asarray(array, dtype=np.float64)
    if not isinstance(values, np.memmap) and not np.isfinite(array).all():
        raise InvalidSpectrumError(
            name, "be finite", quantity((~np.isfinite(array)).sum(), "NaN or infinite value")
        )
    return array
