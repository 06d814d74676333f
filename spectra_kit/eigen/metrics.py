"""How far one spectrum is from another on the same points, whoever computed either.

Eigenvectors carry an arbitrary sign, and near-equal eigenvalues an arbitrary basis of their space.
So `compare_spectra` first pairs the modes one to one, then compares single vectors (the paper's
metrics) and, beside them, whole clusters of near-equal eigenvalues as subspaces.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_indices, check_mass, quantity
from spectra_kit._core.warn import warn
from spectra_kit._sparse.host import Weights
from spectra_kit._sparse.orthonormal import orthonormalize
from spectra_kit._sparse.products import weighed
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.eigen.subspaces.base import Subspace, restricted
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.operators.laplacian import Laplacian, split_mass

# Moving one place in the order must win this much squared cosine: modes that nothing
# resembles stay where they are.
_MOVE_COST = 0.01
_UNLIKE = 0.3  # cosine below which a mode says nothing of the template's; of a random map, 0.05
_ORTHONORMAL = 1e-5  # modes further from it have errors that mean nothing; single precision fits


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison(Rebuilt):
    """The errors of a predicted spectrum, mode by mode.

    Attributes
    ----------
    eigenvalues : ndarray of shape (k,)
        The exact ones, in 1/length^2.
    predicted_eigenvalues : ndarray of shape (k,)
        The predicted ones, paired with them.
    match : ndarray of int of shape (k,)
        Which predicted mode was paired with each exact one; no mode is used twice.
    span_error : ndarray of shape (k,)
        Energy of each exact mode outside the predicted span, ``1 - |Y^T M u_i|^2``, in [0, 1].
    span_dimension : int
        Number of orthonormal columns of Y.
    vector_error : ndarray of shape (k,)
        ``|u_i - v_i|_M^2`` for the paired vector, sign aligned, in [0, 2].
    eigenvalue_error : ndarray of shape (k,)
        ``|lambda_i - lambda'_i| / lambda_i``; NaN for zero modes, which have no relative error.
    cluster_error : ndarray of shape (k,)
        Like `vector_error`, after the best rotation inside each cluster and averaged over it:
        the mean of ``2 - 2 cos`` of the principal angles. Equal to it for a lone mode.
    clusters : tuple of (int, int)
        First mode and one past the last of each cluster of near-equal eigenvalues, in order.
    open_from : int
        The modes from here to k belong to a cluster that reaches past k, or may do so because the
        next exact eigenvalue is not known. Then the k-th space itself is arbitrary, and its
        error is no fault of the predictor: `mean_cluster_error` leaves these modes out.
        Equal to k where the last cluster is known to be complete.
    n_zero_modes : int
        Modes of the exact kernel.
    """

    eigenvalues: Floats
    predicted_eigenvalues: Floats
    match: Ints
    span_error: Floats
    span_dimension: int
    vector_error: Floats
    eigenvalue_error: Floats
    cluster_error: Floats
    clusters: tuple[tuple[int, int], ...]
    open_from: int
    n_zero_modes: int

    @property
    def k(self) -> int:
        """Number of modes compared."""
        return len(self.eigenvalues)

    @property
    def mean_span_error(self) -> float:
        """Mean over all k modes."""
        return float(self.span_error.mean())

    @property
    def mean_vector_error(self) -> float:
        """Mean over all k modes, near-equal eigenvalues included."""
        return float(self.vector_error.mean())

    @property
    def mean_eigenvalue_error(self) -> float:
        """Mean over the modes outside the kernel; NaN if there are none."""
        relative = self.eigenvalue_error[self.n_zero_modes :]
        return float(relative.mean()) if len(relative) else float("nan")

    @property
    def mean_cluster_error(self) -> float:
        """Mean over the modes before `open_from`; NaN if there are none."""
        closed = self.cluster_error[: self.open_from]
        return float(closed.mean()) if len(closed) else float("nan")


@checked
def span_error(
    basis: NDArray[np.floating], mass: Annotated[Floats, sparse.sparray], eigenvectors: Floats
) -> Floats:
    """Energy of each eigenvector outside the span of a basis.

    Parameters
    ----------
    basis : ndarray of shape (n, m)
        Any columns; they are M-orthonormalised first.
    mass : ndarray of shape (n,), or sparse array of shape (n, n)
        M, in length^2: lumped, or a matrix.
    eigenvectors : ndarray of shape (n, k)
        M-orthonormal columns.

    Returns
    -------
    ndarray of shape (k,)
        ``1 - |Y^T M u_i|^2``, between 0 (inside the span) and 1 (orthogonal to it).

    Notes
    -----
    The span loss of the NEO paper (metric (i) of its section 5). It depends on the space alone,
    so signs, order and degenerate eigenvalues do not touch it.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> sk.eigen.metrics.span_error(np.eye(4)[:, :2], np.ones(4), np.eye(4)[:, 1:3])
    array([0., 1.])
    """
    basis, eigenvectors = np.asarray(basis), np.asarray(eigenvectors)
    n = np.shape(mass)[0]
    lumped, consistent = split_mass("mass", mass, n)
    weights: Weights = check_mass("mass", lumped, n) if consistent is None else consistent
    for name, array in (("basis", basis), ("eigenvectors", eigenvectors)):
        if array.ndim != 2 or len(array) != n:
            raise InvalidInputError(
                name, f"have shape ({n}, columns) like the {n} masses", array.shape
            )
    _check_orthonormal("eigenvectors", eigenvectors, weights)
    return _outside(orthonormalize(basis, weights), weights, eigenvectors)


@checked
def subspace_span_error(
    subspace: Subspace, laplacian: Laplacian, exact: Spectrum, predicted: Spectrum
) -> tuple[Floats, int]:
    """Energy of the exact modes outside everything a subspace spans, component by component.

    Parameters
    ----------
    subspace : Subspace
        Called once for each connected component, as `eigensolve` does.
    laplacian : Laplacian
        Of both spectra.
    exact, predicted : Spectrum
        The predicted modes count as part of the span (constants were added to it, and tiny
        components are solved exactly).

    Returns
    -------
    span_error : ndarray of shape (k,)
        ``1 - |Y^T M u_i|^2`` for the exact modes; see `span_error`.
    dimension : int
        Number of orthonormal columns of Y, all components together.

    Examples
    --------
    >>> from spectra_kit import RayleighRitz, eigensolve, robust_laplacian
    >>> from spectra_kit.eigen.subspaces import AmbientFourier
    >>> from spectra_kit.geometry import creature
    >>> from spectra_kit.eigen.metrics import subspace_span_error
    >>> laplacian, subspace = robust_laplacian(creature(1000)), AmbientFourier(m=200, bandwidth=5.0)
    >>> exact = eigensolve(laplacian, 10)
    >>> predicted = eigensolve(laplacian, 10, RayleighRitz(subspace=subspace))
    >>> error, dimension = subspace_span_error(subspace, laplacian, exact, predicted)
    >>> bool(error.max() < 0.01)
    True
    """
    _check_orthonormal("exact", exact.eigenvectors, exact._weights)
    inside, dimension = np.zeros(exact.k), 0
    for label in range(laplacian.n_components):
        part = np.flatnonzero(laplacian.component_labels == label)
        mass, found = exact.mass[part], predicted.eigenvectors[part]
        M = exact.consistent_mass
        weights = mass if M is None else sparse.csr_array(M[part][:, part])
        # Three points have no frame to predict in.
        own = restricted(subspace, part)
        basis = [np.asarray(own(laplacian.points[part], mass))] if len(part) > 3 else []
        if any(columns.ndim != 2 or len(columns) != len(part) for columns in basis):
            raise InvalidInputError("subspace", f"return shape ({len(part)}, m)", basis[0].shape)
        columns = np.hstack([*basis, found])
        columns = columns[:, columns.any(axis=0)]  # what lives on other components
        if columns.shape[1]:
            Y = orthonormalize(columns, weights)
            inside += np.sum((Y.T @ weighed(weights, exact.eigenvectors[part])) ** 2, axis=0)
            dimension += Y.shape[1]
    return np.clip(1.0 - inside, 0.0, 1.0), dimension


@checked
def compare_spectra(
    exact: Spectrum,
    predicted: Spectrum,
    *,
    k: int | None = None,
    basis: NDArray[np.floating] | None = None,
    cluster_gap: float = 1e-2,
) -> Comparison:
    """Measure a predicted spectrum against an exact one on the same points.

    Parameters
    ----------
    exact : Spectrum
        The truth, k M-orthonormal modes or more. One more than k tells whether the last cluster is
        complete.
    predicted : Spectrum
        Of the same operator, k such modes or more; all may be paired with the first k exact ones.
    k : int, optional
        Modes to compare; by default as many as both have.
    basis : ndarray of shape (n, m), optional
        The whole basis that the prediction was drawn from; the span error is measured against
        it. Without it the predicted eigenvectors alone count, which is never smaller.
    cluster_gap : float, default 1e-2
        Neighbours with ``lambda_(i+1) - lambda_i <= cluster_gap * lambda_(i+1)`` share a cluster.
        The zero modes always do.

    Returns
    -------
    Comparison
        The errors per mode; their means are properties.

    Notes
    -----
    `span_error`, `vector_error` and `eigenvalue_error` are the three metrics of the NEO paper
    (section 5) as its text defines them, except that the mean eigenvalue error leaves out the
    whole kernel where the paper leaves out "the trivial mode": the same on a connected
    surface. Pairs maximise the total squared M-cosine less 0.01 for each place moved.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> s = sk.Spectrum(np.array([0.0, 1.0, 2.0]), np.eye(3), np.ones(3))
    >>> turned = sk.Spectrum(s.eigenvalues, -s.eigenvectors, s.mass)
    >>> sk.eigen.metrics.compare_spectra(s, turned).mean_vector_error
    0.0
    """
    k, match, clusters, open_from = _pair(exact, predicted, k, cluster_gap)
    M, U, V = exact._weights, exact.eigenvectors[:, :k], predicted.eigenvectors[:, match]
    values, other = exact.eigenvalues[:k], predicted.eigenvalues[match]

    cosines = np.einsum("nk,nk->k", weighed(M, U), V)
    vector_error = _squared_norm(U - V * np.copysign(1.0, cosines), M)
    aligned = _rotate_within(clusters, M, U, V)
    difference = _squared_norm(U - aligned, M)
    cluster_error = np.concatenate([np.full(b - a, difference[a:b].mean()) for a, b in clusters])
    zero = min(exact.n_zero_modes, k)
    relative = np.full(k, np.nan)
    relative[zero:] = np.abs(other - values)[zero:] / values[zero:]

    Y = predicted.eigenvectors
    if basis is not None:
        if np.ndim(basis) != 2 or len(basis) != exact.n:
            raise InvalidInputError(
                "basis", f"have shape ({exact.n}, m) like the spectra", np.shape(basis)
            )
        Y = orthonormalize(basis, M)
    return Comparison(
        eigenvalues=values,
        predicted_eigenvalues=other,
        match=match,
        span_error=_outside(Y, M, U),
        span_dimension=Y.shape[1],
        vector_error=vector_error,
        eigenvalue_error=relative,
        cluster_error=cluster_error,
        clusters=clusters,
        open_from=open_from,
        n_zero_modes=zero,
    )


@checked
def align_modes(
    exact: Spectrum, predicted: Spectrum, comparison: Comparison | None = None
) -> Floats:
    """Predicted eigenvectors, paired, signed and rotated to look like the exact ones.

    For display only: inside a cluster of near-equal eigenvalues the returned columns are mixtures,
    no longer eigenvectors of their own.

    Parameters
    ----------
    exact, predicted : Spectrum
        On the same points.
    comparison : Comparison, optional
        Of these two; by default ``compare_spectra(exact, predicted)``.

    Returns
    -------
    ndarray of shape (n, k)
        M-orthonormal inside each cluster; column i belongs beside exact mode i.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> s = sk.Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
    >>> sk.eigen.metrics.align_modes(s, sk.Spectrum(s.eigenvalues, -s.eigenvectors, s.mass))
    array([[1., 0.],
           [0., 1.]])
    """
    if comparison is None:
        comparison = compare_spectra(exact, predicted)
    return _rotate_within(
        comparison.clusters,
        exact._weights,
        exact.eigenvectors[:, : comparison.k],
        predicted.eigenvectors[:, comparison.match],
    )


@checked
@dataclass(frozen=True, eq=False)
class Aligned(Rebuilt):
    """Modes of a surface in the order, signs and rotations of a template's.

    Parameters
    ----------
    eigenvectors : ndarray of shape (n, k)
        M-orthonormal inside each cluster; in 1/length of the surface.
    likeness : ndarray of shape (k,)
        M-cosine of each with the template's mode carried over: 1 where both are one, 0 where they
        have nothing to do with each other.
    """

    eigenvectors: Floats
    likeness: Floats


@checked
def align_to_template(
    template: Spectrum, spectrum: Spectrum, point_map: ArrayLike, *, cluster_gap: float = 1e-2
) -> Aligned:
    """Modes of one surface of a cohort, paired, signed and rotated to look like a template's.

    What stands in column i of all surfaces then means the same: the modes of two subjects differ in
    sign, and near-equal ones in their order and by any rotation.

    Parameters
    ----------
    template : Spectrum
        On n1 points, k modes.
    spectrum : Spectrum
        Of the surface, on n2 points, k modes or more.
    point_map : array_like of int of shape (n2,)
        The template's point of each point: ``maps.nearest_rows(sphere, template_sphere)`` where
        both have a registered sphere, `Match.point_map` with the template for its source, or
        ``range(n2)`` of surfaces that share their vertices, as those resampled to fsaverage do.
    cluster_gap : float, default 1e-2
        Modes of the template are turned together where each is nearer to the next than that,
        relative to their eigenvalues: what comes back is then a mixture, and no eigenvector.

    Returns
    -------
    Aligned
        The modes, and how like the template's each is.

    Raises
    ------
    InvalidInputError
        If the map is ``range(n2)``, n1 is another number, and most modes have no likeness: the
        surfaces do not share their vertices then.

    Warns
    -----
    DoubtfulMatchWarning
        If modes have a likeness below 0.3: the map is wrong, or they differ between the surfaces.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> s = sk.Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
    >>> turned = sk.Spectrum(s.eigenvalues, -s.eigenvectors, s.mass)
    >>> aligned = sk.eigen.metrics.align_to_template(s, turned, [0, 1])
    >>> aligned.eigenvectors, aligned.likeness
    (array([[1., 0.],
           [0., 1.]]), array([1., 1.]))
    """
    from scipy.optimize import linear_sum_assignment  # slow to import

    places = check_indices("point_map", point_map, template.n)
    if places.shape != (spectrum.n,):
        raise InvalidInputError("point_map", f"have shape ({spectrum.n},)", places.shape)
    if (k := template.k) > spectrum.k:
        expected = f"have no more modes than the {spectrum.k} of `spectrum`"
        raise InvalidInputError("template", expected, k, advice="truncate it first")
    pulled = template.eigenvectors[places] * np.sqrt(template.area / spectrum.area)
    cosines = pulled.T @ spectrum._weighed(spectrum.eigenvectors)
    moved = np.abs(np.arange(k)[:, None] - np.arange(spectrum.k)[None, :])
    _, match = linear_sum_assignment(_MOVE_COST * moved - cosines**2)
    starts = _cluster_starts(template, cluster_gap)
    clusters = tuple(zip(starts.tolist(), [*starts[1:].tolist(), k], strict=True))
    M = spectrum._weights
    aligned = _rotate_within(clusters, M, pulled, spectrum.eigenvectors[:, match])
    inner = np.einsum("nk,nk->k", weighed(M, pulled), aligned)
    likeness = inner / np.sqrt(np.maximum(_squared_norm(pulled, M), np.finfo(float).tiny))
    if len(unlike := np.flatnonzero(likeness < _UNLIKE)):
        # Meshes that others are cut from, as fsaverage from fsaverage5, do share the first numbers.
        is_range = template.n != spectrum.n and (places == np.arange(spectrum.n)).all()
        if is_range and 2 * len(unlike) > k:
            raise InvalidInputError(
                "point_map",
                "be the template's point of each point",
                f"range({spectrum.n}), though the template has {template.n} and is not alike there",
                advice="of registered spheres, maps.nearest_rows(sphere, template_sphere) makes it",
            )
        told = f"{quantity(len(unlike), 'mode')} of {k}, the first being mode {unlike[0]}"
        warn(
            f"{told}, have a likeness below {_UNLIKE:g} to the template's",
            DoubtfulMatchWarning,
            advice="if low modes are among them, the map is wrong; else take those before alone",
        )
    return Aligned(aligned, likeness)


def _pair(
    exact: Spectrum, predicted: Spectrum, k: int | None, cluster_gap: float
) -> tuple[int, Ints, tuple[tuple[int, int], ...], int]:
    """Check the input; return k, the pairing, the clusters, and where an open cluster starts."""
    from scipy.optimize import linear_sum_assignment  # slow to import

    if exact.n != predicted.n:
        raise InvalidInputError(
            "predicted", f"live on the {exact.n} points of `exact`", f"{predicted.n} points"
        )
    if not np.allclose(exact.mass, predicted.mass, rtol=1e-9, atol=0.0):
        worst = float(np.abs(predicted.mass / exact.mass - 1).max())
        raise InvalidInputError(
            "predicted",
            "have the mass of `exact`",
            f"masses that differ by up to {worst:.2g} of their value",
            advice="solve both with the same Laplacian",
        )
    hashes = exact.provenance.input_hash, predicted.provenance.input_hash
    if all(hashes) and hashes[0] != hashes[1]:
        raise InvalidInputError(
            "predicted",
            "come from the operator of `exact`",
            f"other matrices or points: {exact.provenance.operator} (hash {hashes[0][:8]})"
            f" against {predicted.provenance.operator} (hash {hashes[1][:8]})",
        )
    if not cluster_gap >= 0:
        raise InvalidInputError("cluster_gap", "be at least 0", f"{cluster_gap!r}")
    for name, spectrum in (("exact", exact), ("predicted", predicted)):
        _check_orthonormal(name, spectrum.eigenvectors, spectrum._weights)
    most = min(exact.k, predicted.k)
    k = most if k is None else check_count("k", k, low=1, high=most)

    U = exact.eigenvectors[:, :k]
    cosines = exact._weighed(U).T @ predicted.eigenvectors
    moved = np.abs(np.arange(k)[:, None] - np.arange(predicted.k)[None, :])
    _, match = linear_sum_assignment(_MOVE_COST * moved - cosines**2)

    starts = _cluster_starts(exact, cluster_gap)
    complete = k in starts
    starts = starts[starts < k]
    clusters = tuple((int(a), int(b)) for a, b in zip(starts, [*starts[1:], k], strict=True))
    return k, np.asarray(match, dtype=np.int64), clusters, k if complete else clusters[-1][0]


def _check_orthonormal(name: str, modes: Floats, mass: Weights) -> None:
    """Refuse modes whose cosines and energies would not be those of M-orthonormal ones."""
    inside = modes.T @ weighed(mass, modes)
    error = float(np.abs(inside - np.eye(len(inside))).max(initial=0.0))
    if not error <= _ORTHONORMAL:
        raise InvalidInputError(
            name,
            "hold M-orthonormal modes",
            f"|U^T M U - I| of up to {error:.2g}",
            advice="of any columns,"
            " eigensolve(laplacian, k, RayleighRitz(subspace=GivenBasis(columns))) makes modes",
        )


def _cluster_starts(exact: Spectrum, gap: float) -> Ints:
    """First mode of each cluster among all exact modes."""
    values = exact.eigenvalues
    apart = np.diff(values) > gap * values[1:]
    zero = exact.n_zero_modes
    apart[: max(zero - 1, 0)] = False
    if 0 < zero < len(values):
        apart[zero - 1] = True
    return np.concatenate([[0], np.flatnonzero(apart) + 1])


def _rotate_within(
    clusters: tuple[tuple[int, int], ...], mass: Weights, U: Floats, V: Floats
) -> Floats:
    """Rotate the columns of V inside each cluster as close to U as they get (Procrustes)."""
    aligned = np.empty_like(U)
    for start, stop in clusters:
        cluster = slice(start, stop)
        left, _, right = np.linalg.svd(V[:, cluster].T @ weighed(mass, U[:, cluster]))
        aligned[:, cluster] = V[:, cluster] @ (left @ right)
    return aligned


def _outside(Y: Floats, mass: Weights, U: Floats) -> Floats:
    """``1 - |Y^T M u_i|^2`` for M-orthonormal Y, clipped to [0, 1] against rounding."""
    inside = np.sum((Y.T @ weighed(mass, U)) ** 2, axis=0)
    return np.asarray(np.clip(1.0 - inside, 0.0, 1.0))


def _squared_norm(columns: Floats, mass: Weights) -> Floats:
    """M-norm of each column, squared."""
    return np.asarray(np.einsum("nk,nk->k", weighed(mass, columns), columns))
