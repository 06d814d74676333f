"""Pairs with a known correspondence: the same surface bent, remeshed, renumbered or mirrored."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._core.checked import checked
from spectra_kit._core.records import frozen
from spectra_kit._core.types import Ints
from spectra_kit._core.validate import check_count
from spectra_kit.geometry.creature import creature
from spectra_kit.geometry.shapes import PointCloud, TriangleMesh

Kind = TypeVar("Kind", TriangleMesh, PointCloud)


@checked
def creature_pair(
    n_source: int = 2000,
    n_target: int | None = None,
    *,
    seed: int = 0,
    poses: tuple[int, int] = (1, 2),
) -> tuple[TriangleMesh, TriangleMesh, Ints]:
    """Make one animal in two poses, with the point of the source that each target point is.

    Parameters
    ----------
    n_source : int, default 2000
        Vertices of the source, at least 500; met within 1 per cent.
    n_target : int, optional
        Vertices of the target; another number gives it other triangles. As many as the source by
        default, and then the very same triangles.
    seed : int, default 0
        Which animal.
    poses : tuple of int, default (1, 2)
        Of source and target, as in `creature`.

    Returns
    -------
    source, target : TriangleMesh
        Nearly isometric. Left and right differ little, so that they are easily confused.
    point_map : ndarray of shape (n2,)
        The source vertex of each target vertex: exact for equal triangles, else the nearest on the
        animal at rest.

    Examples
    --------
    >>> from spectra_kit.geometry import creature_pair
    >>> source, target, point_map = creature_pair(800, 600)
    >>> source.n, target.n, point_map.shape
    (800, 600, (600,))
    """
    sizes = n_source, n_target or n_source
    for name, n, pose in zip(("n_source", "n_target"), sizes, poses, strict=True):
        check_count(name, n, low=500, high=5_000_000)
        check_count("poses", pose, low=0)
    source, target = (
        creature(n, seed=seed, pose=pose) for n, pose in zip(sizes, poses, strict=True)
    )
    if sizes[0] == sizes[1]:
        return source, target, frozen(np.arange(source.n))
    rest = [creature(n, seed=seed) for n in sizes]
    _, nearest = cKDTree(rest[0].points).query(rest[1].points)
    return source, target, frozen(np.asarray(nearest, dtype=np.int64))


@checked
def permuted(geometry: Kind, *, seed: int = 0) -> tuple[Kind, Ints]:
    """Renumber the points at random.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        The source.
    seed : int, default 0
        Of the order.

    Returns
    -------
    copy : TriangleMesh or PointCloud
        The target: the same points, and faces, in another order.
    point_map : ndarray of shape (n,)
        The source point that each point of the copy is: ``copy.points`` equals
        ``geometry.points[point_map]``.

    Examples
    --------
    >>> from spectra_kit.geometry import creature, permuted
    >>> mesh = creature(600)
    >>> copy, point_map = permuted(mesh, seed=1)
    >>> bool((copy.points == mesh.points[point_map]).all())
    True
    """
    rng = np.random.default_rng(check_count("seed", seed, low=0))
    order = rng.permutation(geometry.n)
    if isinstance(geometry, PointCloud):
        return PointCloud(geometry.points[order]), frozen(order)
    faces = rng.permutation(np.argsort(order)[geometry.faces])
    return TriangleMesh(geometry.points[order], faces), frozen(order)


@checked
def mirrored(geometry: Kind, *, axis: int = 0) -> Kind:
    """Reflect a geometry; point i of the copy is the image of point i.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        What to reflect.
    axis : int, default 0
        The coordinate that changes its sign.

    Returns
    -------
    TriangleMesh or PointCloud
        Isometric to `geometry`, of the opposite orientation. Faces are turned over, so that those
        which looked outwards still do.

    Examples
    --------
    >>> from spectra_kit.geometry import creature, mirrored
    >>> mesh = creature(600)
    >>> bool(mirrored(mesh).area == mesh.area)
    True
    """
    signs = np.ones(3)
    signs[check_count("axis", axis, low=0, high=2)] = -1.0
    if isinstance(geometry, PointCloud):
        return PointCloud(geometry.points * signs)
    return TriangleMesh(geometry.points * signs, geometry.faces[:, ::-1])
