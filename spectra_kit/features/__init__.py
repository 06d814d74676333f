"""Descriptors of points and of whole surfaces, and distances, from a `Spectrum` alone.

===============  =====================================================  ================
of a point       `heat_kernel_signature`, `wave_kernel_signature`       (n, columns)
seen from some   `landmark_heat_kernel_signature`, `heat_kernel`,       (n, columns)
                 `landmark_wave_kernel_signature`
an embedding     `global_point_signature`                               (n, modes)
of two points    `diffusion_distances`, `biharmonic_distances`,         (sources, n)
                 `commute_time_distances`
of a surface     `shape_dna`, compared by `shape_dna_distances`         (modes,)
===============  =====================================================  ================

Units are the input's: times in length^2, energies are logarithms of eigenvalues. The grids that
`heat_times` and `wave_energies` suggest follow the spectrum, so that descriptors of a scaled copy
are the descriptors times a power of the scale. To compare surfaces, bring both to unit area
(``spectrum.rescale(spectrum.area**-0.5)``); then one grid may serve both.

The kernel (a constant for each component) takes part where it has a meaning: in the heat kernel,
whose limit for long times it is. Grids, wave kernel, embeddings and ShapeDNA leave it out.

Signs, and bases inside eigenspaces, do not touch any of these but the embedding, *as long as the
last eigenspace is complete*. Where k cuts one, what is left of it depends on the solver. The grids
keep that harmless: the highest mode enters the heat kernel signature with a weight of at most
1e-4, and the wave kernel signature two widths away from the last energy. Distances and your own
shorter times or higher energies have no such protection: compute some modes more, and truncate at
a gap.

>>> import spectra_kit as sk
>>> laplacian = sk.robust_laplacian(sk.geometry.creature(1000))
>>> spectrum = sk.eigensolve(laplacian, 50)
>>> sk.features.heat_kernel_signature(spectrum).shape
(1000, 16)
>>> sk.features.biharmonic_distances(spectrum, [0, 1]).shape
(2, 1000)

Of two surfaces, with one grid of energies for both:

>>> other = sk.eigensolve(sk.robust_laplacian(sk.geometry.creature(900, pose=1)), 50)
>>> first, second = (s.rescale(s.area**-0.5) for s in (spectrum, other))
>>> energies, width = sk.features.wave_energies(first)
>>> sk.features.wave_kernel_signature(second, energies, width=width).shape
(900, 100)



Numbers that say where on a surface a point is, or which surface it is: for learning and search.

====================  ====================================  ==================================
embedding             of each point, and of all             does not change with
====================  ====================================  ==================================
`HeatSignature`       logarithms of the heat that stays     rotation, scale, isometry, sampling
`WaveSignature`       logarithms of bands of frequencies    rotation, scale, isometry, sampling
`GlobalPoints`        modes, over their frequencies         rotation, scale, isometry, sampling
`ShapeDNA`            eigenvalues; of whole surfaces only   rotation, scale, isometry, sampling
`NeoFunctions`        functions that a network predicts     rotation, scale, sampling
`PlaneWaves`          random waves of space                 rotation, scale, sampling
`Coordinates`         the points themselves                 scale, sampling
`PositionalEncoding`  waves along the axes                  scale, sampling
====================  ====================================  ==================================

The spectral ones are made of any `Spectrum`, exact or predicted. Whatever an embedding does not
change with, its ``invariant_to`` tells, and tests hold it to it.

>>> import spectra_kit as sk
>>> cloud = sk.geometry.creature(800)
>>> spectrum = sk.eigensolve(sk.robust_laplacian(cloud), 64, sk.Neo())
>>> sk.features.embed(spectrum, sk.features.WaveSignature()).shape
(800, 64)
>>> sk.features.embed_shape(spectrum, sk.features.ShapeDNA()).shape
(30,)
"""

from typing import TYPE_CHECKING, Any

from spectra_kit.features.base import Embedding, Surface, embed, embed_shape
from spectra_kit.features.columns import normalize_descriptors
from spectra_kit.features.distances import (
    biharmonic_distances,
    commute_time_distances,
    diffusion_distances,
    farthest_points,
    global_point_signature,
)
from spectra_kit.features.grids import heat_times, wave_energies
from spectra_kit.features.heat import (
    heat_kernel,
    heat_kernel_signature,
    landmark_heat_kernel_signature,
)
from spectra_kit.features.shape_dna import shape_dna, shape_dna_distance, shape_dna_distances
from spectra_kit.features.spectral import GlobalPoints, HeatSignature, ShapeDNA, WaveSignature
from spectra_kit.features.wave import landmark_wave_kernel_signature, wave_kernel_signature

if TYPE_CHECKING:
    from spectra_kit.features.functions import (
        Coordinates,
        NeoFunctions,
        PlaneWaves,
        PositionalEncoding,
        embed_batch,
    )

__all__ = [
    "Coordinates",
    "Embedding",
    "GlobalPoints",
    "HeatSignature",
    "NeoFunctions",
    "PlaneWaves",
    "PositionalEncoding",
    "ShapeDNA",
    "Surface",
    "WaveSignature",
    "biharmonic_distances",
    "commute_time_distances",
    "diffusion_distances",
    "embed",
    "embed_batch",
    "embed_shape",
    "farthest_points",
    "global_point_signature",
    "heat_kernel",
    "heat_kernel_signature",
    "heat_times",
    "landmark_heat_kernel_signature",
    "landmark_wave_kernel_signature",
    "normalize_descriptors",
    "shape_dna",
    "shape_dna_distance",
    "shape_dna_distances",
    "wave_energies",
    "wave_kernel_signature",
]


def __getattr__(name: str) -> Any:
    """Import what is computed with torch when it is asked for: the others need none."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from spectra_kit.features import functions

    return getattr(functions, name)
