"""`laplacian_many`: the operators of many geometries at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Literal

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.many import about, of_similar_size
from spectra_kit._core.threads import (
    ended_beside,
    in_threads,
    single_threaded,
    single_threaded_blas,
)
from spectra_kit._core.warn import hearing, tell
from spectra_kit.errors import SpectraKitWarning
from spectra_kit.geometry.shapes import GeometryLike, PointCloud
from spectra_kit.operators.assemble import laplacian
from spectra_kit.operators.checks import off_host
from spectra_kit.operators.intrinsic import cloud_triangulation
from spectra_kit.operators.laplacian import Laplacian

if TYPE_CHECKING:
    from spectra_kit.operators._cover import OrderedCloud
    from spectra_kit.operators.local_delaunay import FirstStars

    Begun = tuple[int, OrderedCloud, FirstStars, float]

Built = tuple[int, Laplacian, list[SpectraKitWarning]]
_TOGETHER = 65_536  # points of a group, padded: a device idles while it has few
_NEIGHBORS = 30  # as `laplacian` has it


@checked
def laplacian_many(
    geometries: Sequence[GeometryLike],
    *,
    operator: Literal["robust", "cotan", "knn", "delaunay"] | None = None,
    boundary: Literal["neumann", "dirichlet"] = "neumann",
    mass: Literal["lumped", "consistent"] = "lumped",
    device: str = "cpu",
) -> list[Laplacian]:
    """Build the Laplacian of each of many geometries, as `laplacian` does.

    They are built side by side, one thread each. On a device, clouds of similar size share what is
    done there: it is launched, and waited for, as often for thirty of them as for one. Threads go
    on from there while the device is at work on the next.

    Parameters
    ----------
    geometries : sequence of TriangleMesh and PointCloud
        Of any sizes.
    operator, boundary, mass
        As of `laplacian`, for all of them.
    device : str, default "cpu"
        As of `delaunay_laplacian`; all of meshes, and other operators, are the host's.

    Returns
    -------
    list of Laplacian
        In the order of the geometries. Those of a device are those of the host up to rounding.

    Raises
    ------
    InvalidInputError, ConvergenceError, OutOfMemoryError
        As of `laplacian`, for one that fails.

    Warns
    -----
    SplitSurfaceWarning
        As `laplacian` does, for each.

    Notes
    -----
    Messages begin with the place of the geometry that they are about: ``geometries[3]``, which is
    the attribute ``where`` of errors and warnings, too.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> clouds = [sk.geometry.creature(900, seed=seed).as_cloud() for seed in range(3)]
    >>> [laplacian.n for laplacian in sk.laplacian_many(clouds)]
    [900, 900, 900]
    """
    on_device = off_host(device) and operator not in ("cotan", "knn")
    on_device = on_device and (boundary, mass) == ("neumann", "lumped")
    clouds = {i: one for i, one in enumerate(geometries) if isinstance(one, PointCloud)}
    clouds = clouds if on_device else {}

    def one(i: int, *begun: Any) -> Built:
        with about(_name(i)), single_threaded(), hearing() as heard:
            if begun:
                return i, cloud_triangulation(*begun).laplacian, heard
            own = laplacian(geometries[i], operator=operator, boundary=boundary, mass=mass)
            return i, own, heard

    with single_threaded_blas():  # once: each of them would set it and restore it
        built = in_threads(one, [(i,) for i in range(len(geometries)) if i not in clouds])
        for some in _built(clouds, device, partial(in_threads, one)):
            built += some
    built.sort(key=itemgetter(0))
    for _, _, heard in built:
        for told in heard:
            tell(told)
    return [made for _, made, _ in built]


def _built(
    clouds: dict[int, PointCloud], device: str, end: Callable[[list[Begun]], list[Built]]
) -> Iterator[list[Built]]:
    """Yield what is made in the `end` of clouds that go together.

    Of their points, first stars, and the seconds that these took.
    """
    if not clouds:
        return
    from spectra_kit.operators._cover import ordered_cloud
    from spectra_kit.operators._device_stars import first_stars

    def ordered(i: int, cloud: PointCloud) -> tuple[int, OrderedCloud, float]:
        clock = Clock()
        with about(_name(i)), single_threaded():
            return i, ordered_cloud(cloud, _NEIGHBORS), clock.total

    there = in_threads(ordered, clouds.items())

    def together(group: tuple[int, ...]) -> list[Begun]:
        clock, members = Clock(), [there[j] for j in group]
        points = [own.points for _, own, _ in members]
        found = first_stars(points, members[0][1].n_neighbors, device)
        share = clock.total / len(group)
        both = zip(members, found, strict=True)
        return [(i, own, first, seconds + share) for (i, own, seconds), first in both]

    few = {j for j, (_, own, _) in enumerate(there) if own.n_neighbors < _NEIGHBORS}
    groups = of_similar_size([one.n for one in clouds.values()], _TOGETHER, few)
    yield from ended_beside(together, end, groups)


def _name(i: int) -> str:
    return f"geometries[{i}]"
