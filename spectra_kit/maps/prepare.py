"""What matching needs to know of one surface, computed once and used for all its pairs."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.threads import blas_threads_for, single_threaded_blas
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count
from spectra_kit.eigen import Spectrum
from spectra_kit.eigen import spectrum as solved
from spectra_kit.errors import InvalidInputError
from spectra_kit.features import farthest_points, wave_kernel_signature
from spectra_kit.geometry import Geometry, GeometryLike
from spectra_kit.maps.subsample import Subsample, thinned
from spectra_kit.maps.surface import Surface, lengths_of, smoothed_mean_curvature
from spectra_kit.operators.oriented import area_form, oriented_triangles

MODES = 150  # of a geometry that comes without its spectrum: these match best
LOWEST_K = 30  # modes without which there is no matching: to which candidates grow
REFINED_K = 60  # modes to which candidates are refined
CURVATURE_SCALE = 2.0  # of each curvature beside modes, in the last steps: it counts like four
FORM_K = 40  # modes of the area form
_EVEN = 1e-6  # at unit area, a curvature that varies less than that does not vary: a sphere
_ENDS = 60  # samples from which lengths are measured: the first are the tips of limbs
_ELSEWHERE = 0.4  # farther than that along a surface is another limb
_CURVATURES = (80, 40, 20, 10)  # modes whose heat times smooth the curvature, fine to coarse


def _nothing() -> Floats:
    return np.empty((0, 0))


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Prepared(Rebuilt):
    """A surface, ready to be matched; `prepare` makes it. All at unit area.

    Of a dense surface, n counts the well-spread points on which it is matched.

    Attributes
    ----------
    spectrum : Spectrum
        Scaled to area 1.
    samples : ndarray of shape (s,)
        Well-spread points, the first ones the farthest apart.
    wave : ndarray of shape (n, e)
        Wave kernel signature.
    geometry : Surface or None
        The mesh or cloud in the unit frame; None without one.
    curvature : ndarray of shape (n, 4)
        Smoothed mean curvature, fine to coarse: minus its mean, divided by its standard deviation
        (zero where it does not vary). Empty, as what follows, without a geometry.
    form : ndarray of shape (q, q, q)
        Area form of the lowest modes: the integrals of ``u_a du_b ^ du_c``.
    lengths : ndarray of shape (p, n)
        Of the ways from the first samples to all points.
    subsample : Subsample or None
        Of a dense surface: all its points, and which were chosen.
    """

    spectrum: Spectrum
    samples: Ints
    wave: Floats
    geometry: Surface | None = None
    curvature: Floats = field(default_factory=_nothing)
    form: Floats = field(default_factory=lambda: np.empty((0, 0, 0)))
    lengths: Floats = field(default_factory=_nothing)
    subsample: Subsample | None = None

    @property
    def surface(self) -> Surface:
        """The geometry, where there must be one."""
        if self.geometry is None:
            raise InvalidInputError("surface", "come with its geometry", repr(self))
        return self.geometry

    @property
    def whole(self) -> Spectrum:
        """The spectrum on all points of the surface, dense or not."""
        return self.spectrum if self.subsample is None else self.subsample.spectrum

    @property
    def whole_surface(self) -> Surface:
        """The geometry of all points of the surface, where there must be one."""
        return self.surface if self.subsample is None else self.subsample.surface

    @property
    def chosen(self) -> Ints:
        """Which of all points the surface is matched on, (n,)."""
        return np.arange(self.spectrum.n) if self.subsample is None else self.subsample.chosen

    @property
    def closest(self) -> Ints:
        """Which of the matched points stands for each of all points."""
        return np.arange(self.spectrum.n) if self.subsample is None else self.subsample.closest

    @cached_property
    def links(self) -> Ints:
        """Which samples are neighbours, (l, 2)."""
        return self.surface.links_between(self.samples)

    @cached_property
    def twins(self) -> Ints:
        """Which sample elsewhere looks most like each, (s,): of a left leg, on the right one."""
        count, wave = len(self.samples), self.wave[self.samples]
        long = lengths_of(self.surface.points[self.samples], self.links)
        graph = sparse.csr_array((long, self.links.T), shape=(count, count))
        here = dijkstra(graph, directed=False, limit=_ELSEWHERE) < _ELSEWHERE
        unlike: Floats = cdist(wave, wave, "canberra")
        return np.asarray(np.where(here, np.inf, unlike).argmin(axis=1))

    def on_all_points(self) -> Prepared:
        """Return the surface prepared to be matched on all its points, however dense."""
        if self.subsample is None:
            return self
        return _gathered(self.subsample.spectrum, self.subsample.surface, len(self.samples))

    def truncate(self, k: int) -> Prepared:
        """Return the surface prepared with its first k modes alone, 30 or more."""
        return truncated(self, check_count("k", k, low=LOWEST_K, high=self.spectrum.k))

    def __repr__(self) -> str:
        seen = "spectrum alone" if self.geometry is None else "spectrum and geometry"
        some = "" if self.subsample is None else f" of {self.whole.n}"
        return f"Prepared(n={self.spectrum.n}{some}, k={self.spectrum.k}, from {seen})"


@checked
def prepare(
    spectrum: GeometryLike | Spectrum,
    geometry: GeometryLike | None = None,
    *,
    n_samples: int = 600,
    n_points: int = 5000,
) -> Prepared:
    """Gather what `match` needs to know of a surface.

    Parameters
    ----------
    spectrum : Spectrum, TriangleMesh or PointCloud
        Of one connected surface, in any unit, with at least 30 modes. Of a geometry alone, or its
        file, the lowest 150 modes are solved for.
    geometry : TriangleMesh or PointCloud, optional
        The surface, in the same unit: its sides and its curvature. Faces that are wound against
        their neighbours are turned for it, with a `DoubtfulMatchWarning`; where that does not make
        all agree, the others tell the side (`operators.oriented_triangles`). Without a geometry, a
        match cannot tell left from right, and hardly the front from the back.
    n_samples : int, default 600
        Points on which candidates are refined; capped at n.
    n_points : int, default 5000
        A surface with a geometry and more than twice as many points is dense: it is matched on
        about so many, well spread, and the map is carried to all points in the end.

    Returns
    -------
    Prepared
        At unit area, for any number of matches.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.creature(1000)
    >>> sk.prepare(sk.spectrum(mesh, 60), mesh)
    Prepared(n=1000, k=60, from spectrum and geometry)
    """
    check_count("n_samples", n_samples, low=200)
    check_count("n_points", n_points, low=1000)
    return prepared(spectrum, geometry, n_samples, n_points)


def prepared(
    spectrum: Geometry | Spectrum,
    geometry: Geometry | None = None,
    n_samples: int = 600,
    n_points: int = 5000,
) -> Prepared:
    """Do the same with checked arguments."""
    if not isinstance(spectrum, Spectrum):
        if geometry is not None:
            raise InvalidInputError("geometry", "be left out where `spectrum` is one", "another")
        geometry, spectrum = spectrum, solved(spectrum, min(MODES, spectrum.n))
    if spectrum.dimension != 2:
        raise InvalidInputError(
            "spectrum",
            "be of a surface",
            "that of a volume",
            advice="match their boundaries (`TetrahedralMesh.surface`)",
        )
    if spectrum.k < LOWEST_K:
        raise InvalidInputError(
            "spectrum",
            f"have at least {LOWEST_K} modes to be matched",
            spectrum.k,
            advice="solve for more (150 match best)",
        )
    if spectrum.n_zero_modes == 0:
        raise InvalidInputError(
            "spectrum",
            "hold the constant mode",
            "no zero mode",
            advice="pass it whole, without `.nonzero()`, and of a surface without fixed points",
        )
    if spectrum.n_zero_modes > 1:
        raise InvalidInputError(
            "spectrum",
            "be of one connected surface, with its constant mode",
            f"{spectrum.n_zero_modes} zero modes",
            advice="match the largest part alone, by {}, or each with its own, by {}",
            remedies=("geometry.largest_component(mesh)", "maps.match_components"),
        )
    scale = spectrum.area ** (-1 / spectrum.dimension)
    unit = spectrum.rescale(scale)
    with blas_threads_for(unit.eigenvectors.size):
        surface = None if geometry is None else _in_unit_frame(unit, geometry, scale)
        if surface is None or unit.n <= 2 * n_points:
            return _gathered(unit, surface, min(n_samples, unit.n))
    with single_threaded_blas():
        return _gathered_on(thinned(unit, surface, n_points), min(n_samples, n_points))


def truncated(side: Prepared, k: int) -> Prepared:
    """Return a surface with its first k modes; see `Prepared.truncate`."""
    if k == side.spectrum.k:
        return side
    if (subsample := side.subsample) is not None:
        whole, count = subsample.spectrum.truncate(k), len(subsample.chosen)
        return _gathered_on(thinned(whole, subsample.surface, count), len(side.samples))
    return _gathered(side.spectrum.truncate(k), side.geometry, len(side.samples))


def _gathered_on(subsample: Subsample, n_samples: int) -> Prepared:
    """Return a dense surface with all that depends on its modes, at its chosen points."""
    return _gathered(*subsample.at_chosen(), n_samples, subsample)


def _gathered(
    unit: Spectrum, surface: Surface | None, n_samples: int, subsample: Subsample | None = None
) -> Prepared:
    """Return a surface at unit area with all that depends on its modes."""
    samples = farthest_points(unit, n_samples)
    wave = wave_kernel_signature(unit, count=60)
    if surface is None:
        return Prepared(spectrum=unit, samples=samples, wave=wave)
    curvature = smoothed_mean_curvature(
        unit, surface.points, surface.oriented, tuple(min(mode, unit.k - 1) for mode in _CURVATURES)
    )
    curvature -= unit.mass @ curvature
    spread = np.sqrt(unit.mass @ curvature**2)
    varies = spread > _EVEN
    return Prepared(
        spectrum=unit,
        samples=samples,
        wave=wave,
        geometry=surface,
        curvature=np.divide(curvature, spread, out=np.zeros_like(curvature), where=varies),
        form=area_form(surface.oriented, unit.eigenvectors[:, : min(FORM_K, unit.k)]),
        lengths=surface.lengths_from(samples[:_ENDS]),
        subsample=subsample,
    )


def _in_unit_frame(unit: Spectrum, geometry: Geometry, scale: float) -> Surface:
    """Return a geometry at unit area, and which side is out."""
    if geometry.n != unit.n:
        raise InvalidInputError(
            "geometry", f"be the mesh or cloud of the spectrum, of {unit.n} points", geometry.n
        )
    oriented = oriented_triangles(geometry)
    area = float(oriented.weights @ oriented.areas) * scale**2
    if not 0.5 < area < 2.0:
        raise InvalidInputError(
            "geometry",
            "be in the unit of the spectrum",
            f"{area:.3g} times its area",
            advice="pass the geometry that the spectrum was computed of",
        )
    return Surface(points=geometry.points * scale, mass=unit.mass, oriented=oriented)


def curvatures(source: Prepared, target: Prepared) -> tuple[Floats, Floats] | None:
    """Return the curvatures of both, (n1, 4) and (n2, 4), where they can be compared.

    None without geometries, or where one of them does not bend: curvature tells a sheet from the
    same sheet rolled up, but not where its points are.
    """
    if source.geometry is None or target.geometry is None:
        return None
    both = source.curvature, target.curvature
    return both if all(c.any(axis=0).all() for c in both) else None


def on_matched(source: Prepared, target: Prepared, point_map: Ints) -> Ints:
    """Return the map of all points between the points that the surfaces are matched on."""
    return source.closest[point_map[target.chosen]]
