"""Meshes and point clouds: from a file to clean, normalised input for an operator.

::

    read ──> diagnose ──> repair ──> normalize ──> Laplacian       (spectra_kit.operators)
    sphere, torus, creature … ───┘      └──> sample ──> PointCloud ──> Laplacian

Every step is optional and returns a new object; nothing is repaired, moved or scaled unasked.
"""

from spectra_kit.geometry.adapt import as_geometry
from spectra_kit.geometry.components import Component, components, largest_component
from spectra_kit.geometry.creature import creature, creature_pair, mirrored, permuted
from spectra_kit.geometry.diagnose import Diagnosis, Problem, diagnose
from spectra_kit.geometry.io import read, write
from spectra_kit.geometry.labels import LabelSurface, from_labels
from spectra_kit.geometry.normalize import Normalization, normalize
from spectra_kit.geometry.normals import estimate_normals, orient_normals
from spectra_kit.geometry.overlays import Overlay, read_overlay, write_overlay
from spectra_kit.geometry.reference import Reference, disk, rectangle, sphere, torus
from spectra_kit.geometry.repair import Repaired, RepairReport, repair, restrict, without_nan
from spectra_kit.geometry.sampling import GaussianDensity, Samples, sample, sample_with_origin
from spectra_kit.geometry.shapes import Geometry, GeometryLike, MeshLike, PointCloud, TriangleMesh
from spectra_kit.geometry.tetrahedra import BoundarySurface, TetrahedralMesh

__all__ = [
    "BoundarySurface",
    "Component",
    "Diagnosis",
    "GaussianDensity",
    "Geometry",
    "GeometryLike",
    "LabelSurface",
    "MeshLike",
    "Normalization",
    "Overlay",
    "PointCloud",
    "Problem",
    "Reference",
    "RepairReport",
    "Repaired",
    "Samples",
    "TetrahedralMesh",
    "TriangleMesh",
    "as_geometry",
    "components",
    "creature",
    "creature_pair",
    "diagnose",
    "disk",
    "estimate_normals",
    "from_labels",
    "largest_component",
    "mirrored",
    "normalize",
    "orient_normals",
    "permuted",
    "read",
    "read_overlay",
    "rectangle",
    "repair",
    "restrict",
    "sample",
    "sample_with_origin",
    "sphere",
    "torus",
    "without_nan",
    "write",
    "write_overlay",
]
