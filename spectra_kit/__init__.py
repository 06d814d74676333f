"""Certified Laplace-Beltrami spectra of meshes and point clouds.

>>> import spectra_kit as sk
>>> laplacian = sk.robust_laplacian(sk.geometry.sphere(subdivisions=3).geometry)
>>> spectrum = sk.eigensolve(laplacian, 9)
>>> spectrum.eigenvalues.round(1)
array([0., 2., 2., 2., 6., 6., 6., 6., 6.])

A file becomes a geometry (`read`), a geometry a `Laplacian` (`robust_laplacian` and others), that
a `Spectrum` (`eigensolve`, with the backend of your choice), and a spectrum everything else: two of
them a map from one surface to the other (`match`), one of them quicker distances along its surface
(`HeatGeodesics`).

Conventions, everywhere the same:

- Letters: n points, f faces, k modes, m basis functions.
- Rows are points: ``points (n, 3)``, ``faces (f, 3)``, ``eigenvectors (n, k)``, ``basis (n, m)``.
- L is the positive semi-definite weak Laplacian, M the lumped mass: ``L u = lambda M u``.
- Units are the input's: eigenvalues in 1/length^2, mass in length^2, eigenvectors in 1/length.
- Eigenvectors are M-orthonormal; their signs, and bases inside an eigenspace, are unspecified.
- Of two surfaces the first is the source, the second the target. ``point_map (n2,)`` holds the
  source point of each target point; ``functional_map (k2, k1)`` takes functions the other way.

``dir(sk)`` lists all names, and ``help(sk.eigensolve)`` tells about one of them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from spectra_kit._version import VERSION

__version__ = VERSION

if TYPE_CHECKING:
    from spectra_kit import benchmarks as benchmarks
    from spectra_kit import catalogue as catalogue
    from spectra_kit import cli as cli
    from spectra_kit import correspondence as correspondence
    from spectra_kit import descriptors as descriptors
    from spectra_kit import eigensolvers as eigensolvers
    from spectra_kit import errors as errors
    from spectra_kit import explorer as explorer
    from spectra_kit import functional_maps as functional_maps
    from spectra_kit import geodesics as geodesics
    from spectra_kit import geometry as geometry
    from spectra_kit import interop as interop
    from spectra_kit import levels as levels
    from spectra_kit import linalg as linalg
    from spectra_kit import matching as matching
    from spectra_kit import metrics as metrics
    from spectra_kit import neo as neo
    from spectra_kit import operators as operators
    from spectra_kit import spectra as spectra
    from spectra_kit import subspaces as subspaces
    from spectra_kit import training as training
    from spectra_kit import viz as viz
    from spectra_kit.eigensolvers import Arpack as Arpack
    from spectra_kit.eigensolvers import Capped as Capped
    from spectra_kit.eigensolvers import Chebyshev as Chebyshev
    from spectra_kit.eigensolvers import Dense as Dense
    from spectra_kit.eigensolvers import Lobpcg as Lobpcg
    from spectra_kit.eigensolvers import Multilevel as Multilevel
    from spectra_kit.eigensolvers import Neo as Neo
    from spectra_kit.eigensolvers import Polished as Polished
    from spectra_kit.eigensolvers import RayleighRitz as RayleighRitz
    from spectra_kit.eigensolvers import Refined as Refined
    from spectra_kit.eigensolvers import eigensolve as eigensolve
    from spectra_kit.eigensolvers import spectrum as spectrum
    from spectra_kit.eigensolvers import verify as verify
    from spectra_kit.errors import ConvergenceError as ConvergenceError
    from spectra_kit.errors import DoubtfulDistanceWarning as DoubtfulDistanceWarning
    from spectra_kit.errors import DoubtfulMatchWarning as DoubtfulMatchWarning
    from spectra_kit.errors import DoubtfulSpectrumWarning as DoubtfulSpectrumWarning
    from spectra_kit.errors import InvalidFileError as InvalidFileError
    from spectra_kit.errors import InvalidInputError as InvalidInputError
    from spectra_kit.errors import InvalidSpectrumError as InvalidSpectrumError
    from spectra_kit.errors import MissingDependencyError as MissingDependencyError
    from spectra_kit.errors import OutOfMemoryError as OutOfMemoryError
    from spectra_kit.errors import SpectraKitError as SpectraKitError
    from spectra_kit.errors import SpectraKitWarning as SpectraKitWarning
    from spectra_kit.errors import WeightsError as WeightsError
    from spectra_kit.geodesics import HeatGeodesics as HeatGeodesics
    from spectra_kit.geodesics import geodesic_distance as geodesic_distance
    from spectra_kit.geometry import PointCloud as PointCloud
    from spectra_kit.geometry import TriangleMesh as TriangleMesh
    from spectra_kit.geometry import as_geometry as as_geometry
    from spectra_kit.geometry import read as read
    from spectra_kit.geometry import write as write
    from spectra_kit.matching import Match as Match
    from spectra_kit.matching import Prepared as Prepared
    from spectra_kit.matching import match as match
    from spectra_kit.matching import prepare as prepare
    from spectra_kit.operators import Laplacian as Laplacian
    from spectra_kit.operators import cotan_laplacian as cotan_laplacian
    from spectra_kit.operators import delaunay_laplacian as delaunay_laplacian
    from spectra_kit.operators import intrinsic_delaunay as intrinsic_delaunay
    from spectra_kit.operators import knn_laplacian as knn_laplacian
    from spectra_kit.operators import laplacian as laplacian
    from spectra_kit.operators import robust_laplacian as robust_laplacian
    from spectra_kit.spectra import Certificate as Certificate
    from spectra_kit.spectra import ModeCount as ModeCount
    from spectra_kit.spectra import Provenance as Provenance
    from spectra_kit.spectra import Spectrum as Spectrum
    from spectra_kit.subspaces import AmbientFourier as AmbientFourier
    from spectra_kit.subspaces import GivenBasis as GivenBasis
    from spectra_kit.subspaces import RandomBasis as RandomBasis
    from spectra_kit.subspaces import Union as Union

# Where the names come from. They are imported when they are first asked for: a command that needs
# little starts at once, torch and pyvista wait, and `help` does not go on for thousands of lines.
_NAMES = {
    "eigensolvers": (
        "Arpack Capped Chebyshev Dense Lobpcg Multilevel Neo Polished RayleighRitz Refined "
        "eigensolve spectrum verify"
    ),
    "errors": (
        "ConvergenceError DoubtfulDistanceWarning DoubtfulMatchWarning DoubtfulSpectrumWarning "
        "InvalidFileError InvalidInputError InvalidSpectrumError MissingDependencyError "
        "OutOfMemoryError SpectraKitError SpectraKitWarning WeightsError"
    ),
    "geodesics": "HeatGeodesics geodesic_distance",
    "geometry": "PointCloud TriangleMesh as_geometry read write",
    "matching": "Match Prepared match prepare",
    "operators": (
        "Laplacian cotan_laplacian delaunay_laplacian intrinsic_delaunay knn_laplacian "
        "laplacian robust_laplacian"
    ),
    "spectra": "Certificate ModeCount Provenance Spectrum",
    "subspaces": "AmbientFourier GivenBasis RandomBasis Union",
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        value = globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        return value
    if not name.startswith("_"):
        try:
            return import_module(f"{__name__}.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"{__name__}.{name}":
                raise
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    from pkgutil import iter_modules

    modules = {module.name for module in iter_modules(__path__) if not module.name.startswith("_")}
    return sorted({"__version__", "__doc__", *modules, *_HOMES})
