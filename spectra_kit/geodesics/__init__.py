"""Geodesic distances, exact, by heat, with a sign; paths; vectors carried along a surface."""

from spectra_kit.geodesics.distance import geodesic_distance
from spectra_kit.geodesics.edges import edge_graph, pair_distances
from spectra_kit.geodesics.exact import exact_distances
from spectra_kit.geodesics.farthest import farthest_point_sampling
from spectra_kit.geodesics.heat import HeatGeodesics
from spectra_kit.geodesics.heat_step import Heat
from spectra_kit.geodesics.matrix import distance_matrix
from spectra_kit.geodesics.paths import GeodesicPaths, SurfacePath, geodesic_path
from spectra_kit.geodesics.result import DistanceField
from spectra_kit.geodesics.shorten import shortened_path
from spectra_kit.geodesics.signed import signed_distance
from spectra_kit.geodesics.solvers import Direct, Exact, Iterative, WithinMemory
from spectra_kit.geodesics.sources import FacePoint, Sources, check_sources, nearest_source
from spectra_kit.geodesics.spectral import (
    smallest_spectral_time,
    spectral_distance,
    spectral_heat,
)
from spectra_kit.geodesics.trace import LogarithmicMap, logarithmic_map, trace_geodesic
from spectra_kit.geodesics.vectors import VectorHeat, smoothest_field, transport_vectors

__all__ = [
    "Direct",
    "DistanceField",
    "Exact",
    "FacePoint",
    "GeodesicPaths",
    "Heat",
    "HeatGeodesics",
    "Iterative",
    "LogarithmicMap",
    "Sources",
    "SurfacePath",
    "VectorHeat",
    "WithinMemory",
    "check_sources",
    "distance_matrix",
    "edge_graph",
    "exact_distances",
    "farthest_point_sampling",
    "geodesic_distance",
    "geodesic_path",
    "logarithmic_map",
    "nearest_source",
    "pair_distances",
    "shortened_path",
    "signed_distance",
    "smallest_spectral_time",
    "smoothest_field",
    "spectral_distance",
    "spectral_heat",
    "trace_geodesic",
    "transport_vectors",
]
