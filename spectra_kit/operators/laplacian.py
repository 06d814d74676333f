"""`Laplacian`: a weak Laplace-Beltrami operator and the mass that goes with it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, cached, frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import (
    as_indices,
    check_count,
    check_indices,
    check_mass,
    check_points,
)
from spectra_kit._sparse._checks import asymmetry
from spectra_kit._sparse.products import weighed
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from spectra_kit._sparse.elimination import Elimination

_EPS = float(np.finfo(np.float64).eps)
_ROUNDING = 32 * _EPS  # of the sums of rows, relative to magnitudes
_VANISHES = 1e-2  # of its diagonal entry: the sum of a row of a mass; of linear elements it is 2
# By dimension: what makes medians of L spacings, and Weyl's first eigenvalue where the mass is one.
_WEYL = {2: (4.0, 4 * np.pi), 3: (2.5, (6 * np.pi**2) ** (2 / 3))}


@checked
@dataclass(frozen=True, eq=False)
class Laplacian(Rebuilt):
    """A symmetric positive semi-definite stiffness matrix L and a mass M on n points.

    Its eigenproblem is ``L u = lambda M u``, lambda >= 0. Build one with `robust_laplacian`,
    `cotan_laplacian`, `delaunay_laplacian` or `knn_laplacian`, or bring your own matrices:
    nothing is clamped or rescaled.

    Parameters
    ----------
    stiffness : sparse array of shape (n, n)
        L, symmetric, positive semi-definite (libigl's cotangent matrix has the other sign).
    mass : array_like of shape (n,), or sparse array of shape (n, n)
        M, in length^2, of a volume in length^3: its diagonal, positive, or a positive definite
        matrix. What is kept here of the latter is lumped: the sums of its rows, which are exact for
        linear elements, or, where one vanishes, its diagonal scaled to the same total.
    points : array_like of shape (n, 3)
        Where the unknowns live; learned and Fourier subspaces are functions of it.
    operator : str, default "user"
        How L was made, for the record.
    seconds : float, default 0.0
        Time spent on assembly.
    fixed : array_like of int, default ()
        Points held at zero (homogeneous Dirichlet). None of them means Neumann.
    consistent_mass : sparse array of shape (n, n), optional
        M where it is not diagonal: the eigenproblem is of it, and `mass`, lumped, weighs points.
    dimension : int, default 2
        3 in a volume, as of `tetrahedral_laplacian`: for Weyl's law, and changes of unit.

    Examples
    --------
    >>> from scipy import sparse
    >>> from spectra_kit import Laplacian
    >>> path = sparse.csr_array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    >>> laplacian = Laplacian(path, [1, 1, 1], [[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    >>> laplacian.n, laplacian.n_components
    (3, 1)
    """

    stiffness: sparse.csr_array
    mass: Annotated[Floats, sparse.sparray]
    points: Floats
    operator: str = "user"
    seconds: float = 0.0
    fixed: Annotated[Ints, NDArray[np.bool_]] = field(
        default_factory=lambda: np.empty(0, dtype=np.int64)
    )
    consistent_mass: sparse.csr_array | None = None
    dimension: int = 2

    def __post_init__(self) -> None:
        check_dimension(self.dimension)
        points = check_points("points", self.points)
        n = len(points)
        stiffness = _check_stiffness(self.stiffness, n)
        given, consistent = split_mass("mass", self.mass, n)
        if self.consistent_mass is not None:
            consistent = split_mass("consistent_mass", self.consistent_mass, n)[1]
            if consistent is None:
                expected = "be a matrix with entries beside its diagonal"
                advice = "pass a diagonal as `mass`"
                raise InvalidInputError("consistent_mass", expected, advice=advice)
        mass = check_mass("mass", given, n)
        fixed = np.unique(as_indices("fixed", self.fixed, len(points)))
        if len(fixed) == len(points):
            raise InvalidInputError(
                "fixed", "leave at least one point free", f"all {len(points)} of them"
            )
        for name, value in (("points", points), ("mass", mass), ("fixed", fixed)):
            object.__setattr__(self, name, frozen(np.array(value)))
        for name, matrix in (("stiffness", stiffness), ("consistent_mass", consistent)):
            for buffer in () if matrix is None else (matrix.data, matrix.indices, matrix.indptr):
                buffer.flags.writeable = False
            object.__setattr__(self, name, matrix)

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def area(self) -> float:
        """Total mass, in length^2; of a volume that volume, in length^3."""
        return float(self.mass.sum())

    @cached_property
    def free(self) -> Ints:
        """Points that are not `fixed`, ascending."""
        return frozen(np.setdiff1d(np.arange(self.n), self.fixed, assume_unique=True))

    @cached_property
    def eigenvalue_spacing(self) -> float:
        """Typical gap between neighbouring eigenvalues, in 1/length^2.

        ``4 median(diag L) / tr M``: on a surface mesh of equilateral triangles within a tenth of
        Weyl's ``4 pi / area``, and of the right unit for any other pair. A potential lifts
        eigenvalues and parts none from the next: where it is most of the diagonal, the sums of
        what is beside it stand in. Shifts and the test for zero modes are relative to it. Where L
        is mostly zero, Weyl's own value stands in.

        In a volume, where an entry of L grows with the distance h of points and one of M with its
        cube, ``5/2 median(L_ii / M_ii^(1/3)) / (tr M)^(2/3)``: free of h too, and in a grid of
        cubes near Weyl's ``(6 pi^2 / volume)^(2/3)``.
        """
        return float(self._typical_of_all / self.area ** (2 / self.dimension))

    @cached_property
    def component_spacings(self) -> Floats:
        """`eigenvalue_spacing` of each connected component alone, shape (n_components,)."""
        labels, mass = self.component_labels[self.free], self.mass[self.free]
        if self._in_one_piece:
            typical: Any = self._typical_of_all
        else:
            diagonal, beside = self._held
            typical = self._typical(diagonal[self.free], beside[self.free], labels)
        return frozen(typical / np.bincount(labels, mass) ** (2 / self.dimension))

    @cached
    def _elimination(self) -> Elimination:
        """What all factors of ``L - sigma M`` share; `_forget` it, as it is as large as L."""
        from spectra_kit._sparse.pencil import Pencil

        return Pencil(self.stiffness, self._weights).elimination

    def _forget(self) -> None:
        vars(self).pop("_elimination", None)

    @property
    def _weights(self) -> Floats | sparse.csr_array:
        """M as solvers take it: its diagonal, or all of it."""
        return self.mass if self.consistent_mass is None else self.consistent_mass

    @property
    def _diagonal(self) -> Floats:
        """The diagonal of M."""
        M = self.consistent_mass
        return self.mass if M is None else np.asarray(M.diagonal())

    def _weighed(self, f: Floats) -> Floats:
        """``M f`` of one function, (n,), or several, (n, c)."""
        columns = f if f.ndim == 2 else f[:, None]
        return np.asarray(weighed(self._weights, columns)).reshape(f.shape)

    @cached
    def _row_sums(self) -> Floats:
        """``M 1``: what integrates functions that are one of M's."""
        M = self.consistent_mass
        return self.mass if M is None else np.asarray(M.sum(axis=1))

    @cached
    def _least_weight(self) -> float:
        """Below the least eigenvalue of M relative to its diagonal: 1 where that is all of it."""
        if self.consistent_mass is None:
            return 1.0
        from spectra_kit._sparse.inverse_norms import least_eigenvalue

        M = self.consistent_mass
        least = least_eigenvalue(_block(M, self.free) if len(self.fixed) else M)
        if least <= 0:
            raise InvalidInputError(
                "mass",
                "be positive definite",
                f"a matrix whose least eigenvalue, relative to its diagonal, is {least:.2g}",
                advice="pass its row sums, if these are positive: a lumped mass",
            )
        return least / 2  # it is found to a few digits

    @cached
    def _rounding(self) -> float:
        """Bound on rounding in ``M^-1/2 L M^-1/2 u``, and what one triangle hides of asymmetry."""
        L, scale = self.stiffness, 1 / np.sqrt(self._diagonal * self._least_weight)
        sizes = sparse.csr_array((np.abs(L.data), L.indices, L.indptr), shape=L.shape)
        magnitude = scale * (sizes @ scale)
        turned, asymmetry = L.tocsc(), 0.0  # whose arrays are those of the transpose's rows
        parts = (L.data, turned.data), (L.indices, turned.indices), (L.indptr, turned.indptr)
        if not all(np.array_equal(*both) for both in parts):
            asymmetry = float((scale * (abs(L - turned.T) @ scale)).max())
        longest = int(np.diff(L.indptr).max())
        return float((longest + 4) * _EPS * magnitude.max()) + asymmetry

    @cached
    def _typical_of_all(self) -> float:
        """`_typical` of all points together."""
        return float(self._typical(*self._held, np.zeros(self.n, dtype=np.int64))[0])

    def _typical(self, diagonal: Floats, beside: Floats, labels: Ints) -> Floats:
        """Return the spacing of each component, by label, if its mass were one.

        From what holds its points, without the potential where that is most of it; beside fixed
        points it is not.
        """
        factor, instead = _WEYL[self.dimension]
        all_of_it, rest = (_medians(values, labels) for values in (diagonal, beside))
        held = np.where((rest > 0) & (rest < all_of_it / 2), rest, all_of_it)
        return np.where(held > 0, factor * held, instead)

    @cached
    def _held(self) -> tuple[Floats, Floats]:
        """What holds each point: all, and what does beside a potential; (n,) each.

        In a volume over the distance of points, the cube root of M, with which it grows.
        """
        diagonal = self.stiffness.diagonal()
        sums, rounding = self._sums
        others = rounding / _ROUNDING - diagonal
        beside = np.where(np.abs(sums) > rounding, np.minimum(diagonal, others), diagonal)
        if self.dimension == 2:  # free of it
            return diagonal, beside
        grown = self.mass ** (1 - 2 / self.dimension)
        return diagonal / grown, beside / grown

    @cached
    def _sums(self) -> tuple[Floats, Floats]:
        """The sum of each row of L, and what rounding can make of one that is zero."""
        return _row_sums(self.stiffness)

    @cached_property
    def component_labels(self) -> Ints:
        """Connected component of each point, shape (n,), from 0; -1 for fixed points."""
        labels = np.full(self.n, -1, dtype=np.int64)
        graph = self.stiffness
        if self.consistent_mass is not None:  # which may join what no edge of weight does
            graph = abs(graph) + abs(self.consistent_mass)
        graph = graph[self.free][:, self.free] if len(self.fixed) else graph
        labels[self.free] = connected_components(graph, directed=False)[1]
        return frozen(labels)

    @cached_property
    def n_components(self) -> int:
        """Number of connected components of the free points."""
        return int(self.component_labels.max()) + 1

    @property
    def _in_one_piece(self) -> bool:
        """Whether all points are free, and one component."""
        return self.n_components == 1 and not len(self.fixed)

    @cached_property
    def constant_components(self) -> NDArray[np.bool_]:
        """Components on which constants have no energy, shape (n_components,).

        Neumann: all. One that touches a fixed point, or whose user-made L has a potential beyond
        the rounding of its entries, has none. (In float32 the rounding of L looks like one.)
        """
        free, labels = self.free, self.component_labels[self.free]
        sums, rounding = self._sums
        found = np.bincount(labels, np.abs(sums)[free]) <= np.bincount(labels, rounding[free])
        if len(self.fixed):
            beside = np.diff(self.stiffness[free][:, self.fixed].indptr) > 0
            found[labels[beside]] = False
        if self.consistent_mass is not None and found.any():
            _check_joined(self.stiffness[free][:, free], np.where(found[labels], labels, -1))
        return frozen(found)

    @property
    def kernel_dimension(self) -> int:
        """Number of zero modes: of the `constant_components`, each has one."""
        return int(self.constant_components.sum())

    def dirichlet(self, vertices: Annotated[ArrayLike, NDArray[np.bool_]]) -> Laplacian:
        """Return the same operator with u = 0 at some vertices, and where it was already.

        On all n points; `vertices` are indices, or a mask of shape (n,).
        """
        indices = as_indices("vertices", vertices, self.n)
        return replace(self, fixed=np.union1d(self.fixed, indices))

    def solve(
        self,
        rhs: ArrayLike | None = None,
        *,
        fixed: Annotated[ArrayLike | None, NDArray[np.bool_]] = None,
        values: ArrayLike | None = None,
    ) -> Floats:
        """Return the function u with ``L u = rhs``, and with given values at some points.

        Parameters
        ----------
        rhs : array_like of shape (n,) or (n, c), optional
            Integrated: of a density f, ``mass * f``, as `poisson` has it. Without one u is
            harmonic: what is known at a few points spreads over all, between the least and the
            greatest of it where no weight is negative, as of `robust_laplacian`.
        fixed : array_like of int of shape (m,), or mask of shape (n,), optional
            Points at which u is given. At the operator's own, if they are none of these, u is zero.
        values : float, or array_like of shape (m,) or (m, c), optional
            What u is there, in the order of `fixed`, of a mask ascending; zero by default.

        Returns
        -------
        ndarray of shape (n,) or (n, c)
            On components without a fixed point or potential u has mean zero by mass, and `rhs` must
            sum to zero; without one, a point must be fixed. Each column is what it would be alone.
            The factor is kept for as long as fixed points are the same.

        Examples
        --------
        >>> import spectra_kit as sk
        >>> sheet = sk.geometry.rectangle(n=100, height=1.0).geometry
        >>> x, rim = sheet.points[:, 0], sheet.boundary_vertices
        >>> u = sk.delaunay_laplacian(sheet).solve(fixed=rim, values=x[rim])
        >>> bool(abs(u - x).max() < 1e-12)  # linear functions are harmonic
        True
        """
        from spectra_kit.operators._held import solution

        return solution(self, "rhs", rhs, fixed, values)

    def restricted(self, indices: Ints) -> Laplacian:
        """Return the operator on some points alone, the others held at zero.

        Their order becomes that of the new operator, of which none is fixed.
        """
        indices = check_indices("indices", indices, self.n)
        if indices.ndim != 1 or not len(indices):
            raise InvalidInputError(
                "indices", "be a vector of at least one point", f"shape {indices.shape}"
            )
        M = self.consistent_mass
        if M is None and (np.diff(indices) > 0).all():  # what was checked of all holds of some
            part = object.__new__(Laplacian)
            vars(part).update(
                {one.name: getattr(self, one.name) for one in fields(self)},
                stiffness=_block(self.stiffness, indices),
                mass=frozen(self.mass[indices]),
                points=frozen(self.points[indices]),
                fixed=frozen(np.empty(0, dtype=np.int64)),
            )
            for buffer in (part.stiffness.data, part.stiffness.indices, part.stiffness.indptr):
                buffer.flags.writeable = False
            return part
        block = None if M is None else _block(M, indices)
        lumped = block is None or block.nnz == len(indices)  # of points that M joins to none
        return Laplacian(
            _block(self.stiffness, indices),
            self.mass[indices] if block is None or not lumped else block.diagonal(),
            self.points[indices],
            operator=self.operator,
            seconds=self.seconds,
            consistent_mass=None if lumped else block,
            dimension=self.dimension,
        )

    def _component(self, i: int, points: Ints) -> Laplacian:
        """Return the operator on its i-th component, of these points; what is known stays."""
        part = self.restricted(points)
        if part.consistent_mass is None:
            known = np.zeros(part.n, dtype=np.int64), self.constant_components[i : i + 1]
            vars(part).update(zip(("component_labels", "constant_components"), known, strict=True))
            known[0].flags.writeable = False
        return part


def check_dimension(value: int) -> int:
    """Return 2 or 3; refuse what is neither a surface nor a volume."""
    return check_count("dimension", value, low=2, high=3)


def _check_joined(stiffness: sparse.csr_array, labels: Ints) -> None:
    """Refuse a mass that joins parts on each of which constants have no energy."""
    parts = connected_components(stiffness, directed=False)[1][labels >= 0]
    if len(np.unique(parts)) > len(np.unique(labels[labels >= 0])):
        raise InvalidInputError(
            "mass",
            "join no points of parts that the stiffness leaves apart",
            "one that does, so that their zero modes are not counted",
            advice="are both matrices of the same mesh, in the same order?",
        )


def _block(matrix: sparse.csr_array, indices: Ints) -> sparse.csr_array:
    """Return the rows and columns of some points."""
    rows = matrix[indices]
    if not (np.diff(indices) > 0).all():
        return sparse.csr_array(rows[:, indices])
    # At a cost that knows nothing of the other points.
    place = np.searchsorted(indices, rows.indices)
    inside = indices[np.minimum(place, len(indices) - 1)] == rows.indices
    starts = np.concatenate([[0], np.cumsum(inside)])[rows.indptr]
    shape = (len(indices), len(indices))
    kind = matrix.indices.dtype
    columns, starts = place[inside].astype(kind), starts.astype(kind)
    return sparse.csr_array((rows.data[inside], columns, starts), shape=shape)


def split_mass(name: str, mass: Any, n: int) -> tuple[ArrayLike, sparse.csr_array | None]:
    """Return the lumped part of a mass, and all of it where it is a matrix beyond its diagonal.

    Vectors, and columns, are returned as they are, to be checked as what they are.
    """
    if not sparse.issparse(mass):
        mass = np.asarray(mass)
        if mass.ndim != 2:
            return mass, None
        if mass.shape[1] == 1:  # the row sums of a scipy.sparse matrix
            return mass[:, 0], None
    if mass.shape != (n, n):
        raise InvalidInputError(name, f"have shape ({n},) or ({n}, {n})", mass.shape)
    matrix = _symmetric(name, mass, n)
    diagonal: Floats = matrix.diagonal()
    if matrix.count_nonzero() == np.count_nonzero(diagonal):
        return diagonal, None
    if not (diagonal > 0).all():
        raise InvalidInputError(
            name, "be positive definite", f"a diagonal entry of {diagonal.min():.3g}"
        )
    sums: Floats = matrix.sum(axis=1)
    if not sums.sum() > 0:
        raise InvalidInputError(name, "be positive definite", f"entries of sum {sums.sum():.3g}")
    if not (sums > _VANISHES * diagonal).all():  # those of quadratic elements do, at corners
        sums = diagonal * (sums.sum() / diagonal.sum())
    return sums, matrix


def _check_stiffness(matrix: Any, n: int) -> sparse.csr_array:
    """Return `matrix` as a canonical csr_array that may be a (semi-)definite L."""
    if not sparse.issparse(matrix) or matrix.shape != (n, n):
        raise InvalidInputError(
            "stiffness",
            f"be a scipy sparse array of shape ({n}, {n})",
            f"{type(matrix).__name__} of shape {np.shape(matrix)}",
        )
    stiffness = _symmetric("stiffness", matrix, n)
    largest = np.abs(stiffness.data).max(initial=0.0)
    if stiffness.diagonal().min() < -1e-12 * largest:
        raise InvalidInputError(
            "stiffness",
            "be positive semi-definite",
            f"a negative diagonal entry ({stiffness.diagonal().min():.3g})",
            advice="libigl's cotmatrix has the opposite sign: pass -L",
        )
    return stiffness


def _symmetric(name: str, given: Any, n: int) -> sparse.csr_array:
    """Return a copy of a matrix of shape (n, n) as a canonical csr_array, finite and symmetric."""
    if given.dtype.kind not in "fiu":
        raise InvalidInputError(name, "hold real numbers", f"dtype {given.dtype}")
    matrix = sparse.csr_array(given, dtype=np.float64, copy=True)
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    if matrix.nnz <= np.iinfo(np.int32).max:  # half the memory, and the loops of all others
        for part in ("indices", "indptr"):
            setattr(matrix, part, getattr(matrix, part).astype(np.int32, copy=False))
    if not np.isfinite(matrix.data).all():
        raise InvalidInputError(
            name,
            "be finite",
            f"{int((~np.isfinite(matrix.data)).sum())} NaN or infinite entries",
            advice="degenerate faces cause them: see {}",
            remedies=("mesh.without_degenerate_faces()",),
        )
    if (found := asymmetry(matrix)) > 0:
        letter = "L" if name == "stiffness" else "M"
        raise InvalidInputError(
            name,
            "be symmetric",
            f"|{letter} - {letter}.T| up to {found:.2e}",
            advice=f"pass ({letter} + {letter}.T) / 2 if that is meant",
        )
    return matrix


def with_zero_sums(stiffness: sparse.sparray) -> sparse.csr_array:
    """Return L with the rows that sum to more than rounding corrected on the diagonal.

    Beside needles, those of the library robust_laplacian sum to thousands of times their rounding.
    """
    matrix = sparse.csr_array(stiffness)
    sums, rounding = _row_sums(matrix)
    off = np.abs(sums) > rounding
    if not off.any():
        return matrix
    return sparse.csr_array(matrix - sparse.diags_array(np.where(off, sums, 0)))


def _medians(values: Floats, labels: Ints) -> Floats:
    """Return the median of the values of each label."""
    sizes = np.bincount(labels)
    ascending = np.sort(values) if len(sizes) == 1 else values[np.lexsort((values, labels))]
    first = np.cumsum(sizes) - sizes
    return np.asarray((ascending[first + (sizes - 1) // 2] + ascending[first + sizes // 2]) / 2)


def _row_sums(stiffness: sparse.csr_array) -> tuple[Floats, Floats]:
    """Return the sum of each row, and what rounding can make of one that is zero."""
    some = np.flatnonzero(np.diff(stiffness.indptr))  # `reduceat` knows no empty row
    starts, sums = stiffness.indptr[some], np.zeros((2, stiffness.shape[0]))
    for found, data in zip(sums, (stiffness.data, np.abs(stiffness.data)), strict=True):
        found[some] = np.add.reduceat(data, starts)
    return sums[0], _ROUNDING * sums[1]
