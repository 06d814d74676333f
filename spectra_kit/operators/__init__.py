"""From a geometry to a discrete Laplacian: ``L u = lambda M u``, L positive semi-definite."""

from spectra_kit.operators.assemble import (
    cotan_laplacian,
    delaunay_laplacian,
    knn_laplacian,
    laplacian,
    robust_laplacian,
)
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
from spectra_kit.operators.tangent import (
    TangentGradient,
    divergence,
    gradient,
    tangent_gradient,
)

__all__ = [
    "IntrinsicTriangulation",
    "Laplacian",
    "OrientedTriangles",
    "TangentGradient",
    "area_form",
    "cotan_laplacian",
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
    "tangent_gradient",
]
