"""From a geometry to a discrete Laplacian: ``L u = lambda M u``, L positive semi-definite."""

from spectra_kit.operators.anisotropic import anisotropic_laplacian, tensor_laplacian
from spectra_kit.operators.assemble import (
    cotan_laplacian,
    delaunay_laplacian,
    knn_laplacian,
    laplacian,
    robust_laplacian,
)
from spectra_kit.operators.connection import (
    TangentFrames,
    connection_laplacian,
    tangent_frames,
)
from spectra_kit.operators.curvature import Curvature, curvature
from spectra_kit.operators.equations import diffuse, poisson, schroedinger
from spectra_kit.operators.intrinsic import IntrinsicTriangulation, intrinsic_delaunay
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.operators.many import laplacian_many
from spectra_kit.operators.oriented import (
    OrientedTriangles,
    area_form,
    orientation_operator,
    oriented_triangles,
    skew,
)
from spectra_kit.operators.smoothing import smooth
from spectra_kit.operators.tangent import (
    TangentGradient,
    divergence,
    gradient,
    tangent_gradient,
)
from spectra_kit.operators.tetrahedra import tetrahedral_laplacian

__all__ = [
    "Curvature",
    "IntrinsicTriangulation",
    "Laplacian",
    "OrientedTriangles",
    "TangentFrames",
    "TangentGradient",
    "anisotropic_laplacian",
    "area_form",
    "connection_laplacian",
    "cotan_laplacian",
    "curvature",
    "delaunay_laplacian",
    "diffuse",
    "divergence",
    "gradient",
    "intrinsic_delaunay",
    "knn_laplacian",
    "laplacian",
    "laplacian_many",
    "orientation_operator",
    "oriented_triangles",
    "poisson",
    "robust_laplacian",
    "schroedinger",
    "skew",
    "smooth",
    "tangent_frames",
    "tangent_gradient",
    "tensor_laplacian",
    "tetrahedral_laplacian",
]
