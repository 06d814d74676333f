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
"""

from spectra_kit import (
    correspondence,
    descriptors,
    functional_maps,
    geodesics,
    geometry,
    matching,
)
from spectra_kit.eigensolvers import (
    Arpack,
    Capped,
    Dense,
    Lobpcg,
    Multilevel,
    Neo,
    Polished,
    RayleighRitz,
    Refined,
    eigensolve,
    verify,
)
from spectra_kit.errors import (
    ConvergenceError,
    InvalidInputError,
    InvalidSpectrumError,
    MissingDependencyError,
    OutOfMemoryError,
    SpectraKitError,
    WeightsError,
)
from spectra_kit.geodesics import HeatGeodesics, geodesic_distance
from spectra_kit.geometry import PointCloud, TriangleMesh, read, write
from spectra_kit.matching import Match, Prepared, match, prepare
from spectra_kit.operators import (
    Laplacian,
    cotan_laplacian,
    delaunay_laplacian,
    intrinsic_delaunay,
    knn_laplacian,
    robust_laplacian,
)
from spectra_kit.spectrum import Certificate, ModeCount, Provenance, Spectrum
from spectra_kit.subspaces import AmbientFourier, GivenBasis, RandomBasis, Union

__all__ = [
    "AmbientFourier",
    "Arpack",
    "Capped",
    "Certificate",
    "ConvergenceError",
    "Dense",
    "GivenBasis",
    "HeatGeodesics",
    "InvalidInputError",
    "InvalidSpectrumError",
    "Laplacian",
    "Lobpcg",
    "Match",
    "MissingDependencyError",
    "ModeCount",
    "Multilevel",
    "Neo",
    "OutOfMemoryError",
    "PointCloud",
    "Polished",
    "Prepared",
    "Provenance",
    "RandomBasis",
    "RayleighRitz",
    "Refined",
    "SpectraKitError",
    "Spectrum",
    "TriangleMesh",
    "Union",
    "WeightsError",
    "correspondence",
    "cotan_laplacian",
    "delaunay_laplacian",
    "descriptors",
    "eigensolve",
    "functional_maps",
    "geodesic_distance",
    "geodesics",
    "geometry",
    "intrinsic_delaunay",
    "knn_laplacian",
    "match",
    "matching",
    "prepare",
    "read",
    "robust_laplacian",
    "verify",
    "write",
]
