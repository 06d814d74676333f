"""Volumes of tetrahedra whose spectra are known."""

from itertools import permutations, product

import numpy as np
from scipy.optimize import brentq
from scipy.special import spherical_jn

from spectra_kit.geometry import TetrahedralMesh


def box(*shape: int, sides: tuple[float, float, float] = (1.0, 1.3, 1.7)) -> TetrahedralMesh:
    """A box of so many cells along each side, six tetrahedra to each (Kuhn's)."""
    axes = [np.linspace(0, side, n + 1) for side, n in zip(sides, shape, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    strides = np.array([(shape[1] + 1) * (shape[2] + 1), shape[2] + 1, 1])
    low = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    first = low @ strides
    paths = [np.append(0, np.cumsum(strides[list(order)])) for order in permutations(range(3))]
    return TetrahedralMesh(points, np.concatenate([first[:, None] + path for path in paths]))


def ball(n: int) -> TetrahedralMesh:
    """The unit ball: a cube of n^3 cells, each ray from the middle stretched."""
    cube = box(n, n, n, sides=(2.0, 2.0, 2.0))
    points = cube.points - 1
    far, out = np.linalg.norm(points, axis=1), np.abs(points).max(axis=1)
    points = points * np.divide(out, far, out=np.zeros_like(far), where=far > 0)[:, None]
    return TetrahedralMesh(points, cube.cells)


def box_eigenvalues(count: int, sides: tuple[float, float, float], *, zero: bool) -> np.ndarray:
    """Those of products of cosines, or of sines where the boundary is held at zero."""
    numbers = product(range(int(zero), 12), repeat=3)
    return np.sort([((np.pi * np.array(n) / sides) ** 2).sum() for n in numbers])[:count]


def ball_eigenvalues(count: int, *, zero: bool) -> np.ndarray:
    """Squares of the zeros of spherical Bessel functions, or of their derivatives."""
    found = [] if zero else [0.0]
    grid = np.linspace(0.5, 12.0, 500)
    for order in range(8):
        values = spherical_jn(order, grid, derivative=not zero)
        for i in np.flatnonzero(values[:-1] * values[1:] < 0):
            root = brentq(
                lambda x, o=order: spherical_jn(o, x, derivative=not zero), grid[i], grid[i + 1]
            )
            found += [root**2] * (2 * order + 1)
    return np.sort(found)[:count]
