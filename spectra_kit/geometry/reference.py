"""Surfaces whose Laplace-Beltrami spectrum is known exactly: the truth for tests and examples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import igl
import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import TriangleMesh


@checked
@dataclass(frozen=True, eq=False)
class Reference(Rebuilt):
    """A mesh and the exact spectrum of the smooth surface that it approximates.

    Parameters
    ----------
    geometry : TriangleMesh
        Vertices on the smooth surface; eigenvalues of its Laplacian differ from the exact ones by
        O(h^2) in the edge length h.
    eigenvalues : ndarray of shape (k,)
        The k smallest, ascending, repeated by multiplicity, in 1/length^2. With a boundary they
        are the Neumann ones. The first is 0.
    description : str
        The surface in words.
    dirichlet : ndarray of shape (k,) or None
        Likewise for functions that vanish on the boundary; None without a boundary.
    eigenfunctions : ndarray of shape (n, k) or None
        The modes of `eigenvalues` at the vertices, of unit L2 norm on the smooth surface; only
        where they are elementary (`rectangle`).
    """

    geometry: TriangleMesh
    eigenvalues: Floats
    description: str
    dirichlet: Floats | None = None
    eigenfunctions: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("eigenvalues", "dirichlet", "eigenfunctions"):
            if (values := getattr(self, name)) is not None:  # a tuple of numbers is welcome
                object.__setattr__(self, name, frozen(values))

    @property
    def multiplicities(self) -> Ints:
        """Size of each group of equal eigenvalues, ascending; k may cut the last one short."""
        gaps = np.diff(self.eigenvalues) > 1e-9 * self.eigenvalues[1:]
        starts = np.flatnonzero(np.concatenate([[True], gaps]))
        return np.diff(np.append(starts, len(self.eigenvalues)))


@checked
def sphere(*, subdivisions: int = 3, radius: float = 1.0, k: int = 100) -> Reference:
    """Sphere as a subdivided icosahedron, of 10 * 4^subdivisions + 2 vertices.

    Parameters
    ----------
    subdivisions : int, default 3
        Each splits every triangle in four.
    radius : float, default 1.0
        In the unit of length.
    k : int, default 100
        Number of exact eigenvalues.

    Returns
    -------
    Reference
        l (l + 1) / radius^2, each 2 l + 1 times.

    Examples
    --------
    >>> from spectra_kit.geometry import sphere
    >>> sphere(k=9).eigenvalues
    array([0., 2., 2., 2., 6., 6., 6., 6., 6.])
    """
    check_count("subdivisions", subdivisions, low=0, high=9)
    _check_numbers({"k": (k, 1)}, radius=radius)
    points, faces = _icosahedron()
    for _ in range(subdivisions):
        points, faces = igl.upsample(points, faces, 1)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    degree = np.repeat(np.arange(k), 2 * np.arange(k) + 1)[:k].astype(np.float64)
    return Reference(
        TriangleMesh(radius * points, faces),
        degree * (degree + 1) / radius**2,
        f"sphere of radius {radius:g}",
    )


@checked
def rectangle(
    *, n: int = 1000, width: float = 1.0, height: float = (1 + 5**0.5) / 2, k: int = 100
) -> Reference:
    """Flat rectangle in the plane z = 0; with the default golden ratio every eigenvalue is simple.

    Parameters
    ----------
    n : int, default 1000
        Number of vertices, met to about five per cent.
    width, height : float
        Sides along x and y, in the unit of length; one corner lies at the origin.
    k : int, default 100
        Number of exact modes.

    Returns
    -------
    Reference
        pi^2 (a^2 / width^2 + b^2 / height^2): a, b >= 0 (Neumann) or a, b >= 1 (`dirichlet`), and
        the products of cosines of the Neumann modes as `eigenfunctions`.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import rectangle
    >>> unit = rectangle(height=1.0, k=4)
    >>> unit.eigenvalues / np.pi**2
    array([0., 1., 1., 2.])
    >>> unit.dirichlet / np.pi**2
    array([2., 5., 5., 8.])
    """
    _check_numbers({"n": (n, 4), "k": (k, 1)}, width=width, height=height)
    if not 1 / n <= width / height <= n:
        raise InvalidInputError(
            "width", f"be within n = {n} times `height`", f"{width:g} beside {height:g}"
        )
    columns = max(2, round((n * width / height) ** 0.5))
    rows = max(2, round(n / columns))
    x, y = np.meshgrid(np.linspace(0, width, columns), np.linspace(0, height, rows), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    mesh = TriangleMesh(points, _grid_faces(columns, rows, wrap=False))

    # k modes never need an index above k: each of a = 0..k (b = 0) already lies below it.
    a, b = (index.ravel() for index in np.meshgrid(np.arange(k + 1), np.arange(k + 1)))
    values = np.pi**2 * ((a / width) ** 2 + (b / height) ** 2)
    order = np.argsort(values, kind="stable")
    neumann = order[:k]
    dirichlet = order[(a[order] > 0) & (b[order] > 0)][:k]
    modes = np.cos(np.pi * points[:, :1] * a[neumann] / width)
    modes *= np.cos(np.pi * points[:, 1:2] * b[neumann] / height)
    modes *= np.sqrt((1 + (a[neumann] > 0)) * (1 + (b[neumann] > 0)) / (width * height))
    return Reference(
        mesh,
        values[neumann],
        f"rectangle of {width:g} by {height:g}",
        values[dirichlet],
        modes,
    )


@checked
def disk(*, rings: int = 18, radius: float = 1.0, k: int = 100) -> Reference:
    """Flat disk in the plane z = 0, as rings of 6, 12, 18... vertices around the centre.

    Parameters
    ----------
    rings : int, default 18
        Gives 3 rings (rings + 1) + 1 vertices.
    radius : float, default 1.0
        Of the rim, in the unit of length.
    k : int, default 100
        Number of exact eigenvalues.

    Returns
    -------
    Reference
        (z / radius)^2 for the zeros z of J'_m (Neumann) or of J_m (`dirichlet`), twice each for
        m >= 1.

    Examples
    --------
    >>> from spectra_kit.geometry import disk
    >>> disk(k=3).eigenvalues
    array([0.  , 3.39, 3.39])
    >>> disk(k=1).dirichlet
    array([5.78])
    """
    from scipy.special import jn_zeros, jnp_zeros  # slow to import

    check_count("k", k, low=1, high=10_000)
    _check_numbers({"rings": (rings, 1)}, radius=radius)
    # Zeros of order m lie above m, and those of one order about pi apart; Weyl puts the k-th of
    # all near 2 sqrt(k). So this many orders and zeros hold the k smallest, with a margin.
    reach = int(2 * k**0.5) + 8
    neumann: list[float] = [0.0]
    dirichlet: list[float] = []
    for m in range(reach):
        count = (reach - m) // 3 + 3
        twice = 1 if m == 0 else 2
        neumann.extend(np.repeat(jnp_zeros(m, count), twice))
        dirichlet.extend(np.repeat(jn_zeros(m, count), twice))
    return Reference(
        _disk_mesh(rings, radius),
        (np.sort(neumann)[:k] / radius) ** 2,
        f"disk of radius {radius:g}",
        (np.sort(dirichlet)[:k] / radius) ** 2,
    )


@checked
def torus(*, n: int = 1800, major: float = 1.0, minor: float = 0.4, k: int = 100) -> Reference:
    """Torus of revolution around the z axis.

    Parameters
    ----------
    n : int, default 1800
        Number of vertices, met to about five per cent.
    major, minor : float
        Radius of the centre circle and of the tube, in the unit of length; minor < major.
    k : int, default 100
        Number of exact eigenvalues.

    Returns
    -------
    Reference
        Eigenvalues to a relative 1e-11 or so, from a Fourier collocation.

    Notes
    -----
    For functions exp(i m u) f(v), with v the angle around the tube and w = major + minor cos v,
    the eigenproblem is ``-(w f')' / (minor^2 w) + (m / w)^2 f = lambda f``, periodic in v: solved
    per m on equispaced nodes (Trefethen, *Spectral Methods in MATLAB*, 2000, chapter 3).

    Examples
    --------
    >>> from spectra_kit.geometry import torus
    >>> torus(k=5).multiplicities
    array([1, 2, 2])
    """
    _check_numbers({"n": (n, 9), "k": (k, 1)}, major=major, minor=minor)
    if minor >= major:
        raise InvalidInputError(
            "minor",
            f"be smaller than `major` = {major}",
            minor,
            advice="else the torus pierces itself",
        )
    around_tube = max(3, round((n * minor / major) ** 0.5))
    around_axis = max(3, round(n / around_tube))
    u, v = np.meshgrid(
        2 * np.pi * np.arange(around_axis) / around_axis,
        2 * np.pi * np.arange(around_tube) / around_tube,
        indexing="ij",
    )
    w = major + minor * np.cos(v)
    points = np.stack([w * np.cos(u), w * np.sin(u), minor * np.sin(v)], axis=-1)
    return Reference(
        TriangleMesh(points.reshape(-1, 3), _grid_faces(around_axis, around_tube, wrap=True)),
        _torus_eigenvalues(major, minor, k),
        f"torus of radii {major:g} and {minor:g}",
    )


def _torus_eigenvalues(major: float, minor: float, k: int, *, refine: int = 1) -> Floats:
    """Smallest k eigenvalues; `refine` multiplies the number of nodes."""
    # Enough nodes for the k-th wave around the tube, and for 1/w, whose Fourier coefficients decay
    # the slower the narrower the hole.
    narrow = major / np.sqrt(major**2 - minor**2)
    nodes = 2 * int(refine * (24 + 12 * narrow + 1.5 * k**0.5)) + 1
    v = 2 * np.pi * np.arange(nodes) / nodes
    w = major + minor * np.cos(v)
    i = np.arange(nodes)
    difference = i[:, None] - i
    D = np.zeros((nodes, nodes))  # spectral differentiation, odd number of nodes
    off = difference != 0
    D[off] = 0.5 * (-1.0) ** difference[off] / np.sin(np.pi * difference[off] / nodes)
    radial = D.T @ (w[:, None] * D) / minor**2 / np.sqrt(w[:, None] * w)
    values = np.empty(0)
    for m in range(k + 1):
        # (m / w)^2 >= (m / max w)^2 bounds all that this and higher m can still bring.
        if len(values) == k and (m / (major + minor)) ** 2 > values[-1]:
            break
        of_m = np.linalg.eigvalsh(radial + np.diag((m / w) ** 2))
        values = np.sort(np.concatenate([values, np.repeat(of_m, 1 if m == 0 else 2)]))[:k]
    values[0] = 0.0
    return values


def _check_numbers(counts: Mapping[str, tuple[int, int]], **lengths: float) -> None:
    """Refuse counts below the least that goes with them, and lengths that are not positive."""
    for name, (count, low) in counts.items():
        check_count(name, count, low=low)
    for name, length in lengths.items():
        check_positive(name, length)


def _grid_faces(rows: int, columns: int, *, wrap: bool) -> Ints:
    """Two triangles per cell of a grid of vertices, numbered row by row."""
    index = np.arange(rows * columns).reshape(rows, columns)
    if wrap:
        index = np.pad(index, ((0, 1), (0, 1)), mode="wrap")
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def _disk_mesh(rings: int, radius: float) -> TriangleMesh:
    points, faces = [np.zeros((1, 2))], []
    for ring in range(1, rings + 1):
        angle = 2 * np.pi * np.arange(6 * ring) / (6 * ring)
        points.append(ring / rings * np.stack([np.cos(angle), np.sin(angle)], axis=1))
        outer = 3 * ring * (ring - 1) + 1
        inner = 3 * (ring - 1) * (ring - 2) + 1 if ring > 1 else 0
        for sector in range(6):
            # A sector has `ring` cells outside and one less inside: a strip of triangles.
            out = outer + (sector * ring + np.arange(ring + 1)) % (6 * ring)
            inn = inner + (sector * (ring - 1) + np.arange(ring)) % max(6 * (ring - 1), 1)
            faces.append(np.stack([out[:-1], out[1:], inn], axis=1))
            faces.append(np.stack([inn[:-1], out[1:-1], inn[1:]], axis=1))
    flat = radius * np.concatenate(points)
    return TriangleMesh(np.column_stack([flat, np.zeros(len(flat))]), np.concatenate(faces))


def _icosahedron() -> tuple[Floats, Ints]:
    phi = (1 + 5**0.5) / 2
    # The cyclic permutations of (0, +-1, +-phi).
    corners = np.array([[0.0, a, b * phi] for a in (-1, 1) for b in (-1, 1)])
    points = np.concatenate([np.roll(corners, shift, axis=1) for shift in range(3)])
    near = np.linalg.norm(points[:, None] - points, axis=2) < 2.1  # edges have length 2
    faces = [
        (i, j, l) if np.linalg.det(points[[i, j, l]]) > 0 else (i, l, j)
        for i, j, l in combinations(range(12), 3)
        if near[i, j] and near[j, l] and near[i, l]
    ]
    return points / np.linalg.norm(points[0]), np.array(faces, dtype=np.int64)
