"""Numbers that say where on a surface a point is, or which surface it is; and distances.

==============  ======================================================  ============
of a point      `heat_kernel_signature`, `wave_kernel_signature`, also  (n, columns)
                as seen from landmarks; `global_point_signature`
of all points   `fiedler_order`, `spectral_segments`                    (n,)
of two points   `diffusion_distances`, `biharmonic_distances`,          (sources, n)
                `commute_time_distances`; `heat_kernel`
of a surface    `shape_dna`, compared by `shape_dna_distances`          (modes,)
==============  ======================================================  ============

All take a `Spectrum`, or what has one: of a mesh, a cloud, a path or a Laplacian they compute the
96 lowest modes by the default solver. `DESCRIPTORS` has the names under which a store keeps them.

Units are the input's: times in length^2, energies are logarithms of eigenvalues. The grids that
`heat_times` and `wave_energies` suggest follow the spectrum, so that descriptors of a scaled copy
are the descriptors times a power of the scale. To compare surfaces, bring both to unit area
(``spectrum.rescale(spectrum.area**-0.5)``); then one grid may serve both.

The kernel (a constant for each component) takes part where it has a meaning: in the heat kernel,
whose limit for long times it is. Grids, wave kernel, embeddings and ShapeDNA leave it out.

Signs, and bases inside eigenspaces, do not touch any of these but the global point signature, *as
long as the last eigenspace is complete*. Where k cuts one, what is left of it depends on the
solver. The grids keep that harmless: the highest mode enters the heat kernel signature with a
weight of at most 1e-4, and the wave kernel signature two widths away from the last energy.
Distances and your own shorter times or higher energies have no such protection: compute some modes
more, and truncate at a gap.

>>> import spectra_kit as sk
>>> spectrum = sk.spectrum(sk.geometry.creature(1000), 50)
>>> sk.features.heat_kernel_signature(spectrum).shape
(1000, 16)
>>> sk.features.biharmonic_distances(spectrum, [0, 1]).shape
(2, 1000)

Of two surfaces, with one grid of energies for both:

>>> other = sk.spectrum(sk.geometry.creature(900, pose=1), 50)
>>> first, second = (s.rescale(s.area**-0.5) for s in (spectrum, other))
>>> energies, width = sk.features.wave_energies(first)
>>> sk.features.wave_kernel_signature(second, energies, width=width).shape
(900, 100)

For learning and search the same are embeddings: classes of options, on scales that all surfaces
share, without a unit, of each point or of all (`embed`, `embed_shape`).

======================  ====================================  ==================================
embedding               of each point, and of all             does not change with
======================  ====================================  ==================================
`HeatKernelSignature`   logarithms of the heat that stays     rotation, scale, isometry, sampling
`WaveKernelSignature`   logarithms of bands of frequencies    rotation, scale, isometry, sampling
`GlobalPointSignature`  modes, over their frequencies         rotation, scale, isometry, sampling
`ShapeDNA`              eigenvalues; of whole surfaces only   rotation, scale, isometry, sampling
`BasisFunctions`        what a network predicts; plane waves  rotation, scale, sampling
`Coordinates`           the points themselves                 scale, sampling
`PositionalEncoding`    waves along the axes                  scale, sampling
======================  ====================================  ==================================

The spectral ones are made of any `Spectrum`, exact or predicted. Whatever an embedding does not
change with, its ``invariant_to`` tells, and tests hold it to it.

>>> cloud = sk.geometry.creature(800)
>>> predicted = sk.spectrum(cloud, 64, sk.Neo())
>>> sk.features.embed(predicted, sk.features.WaveKernelSignature()).shape
(800, 64)
>>> sk.features.embed_shape(predicted, sk.features.ShapeDNA()).shape
(30,)
"""

from spectra_kit.features.descriptors import DESCRIPTORS, normalize_descriptors
from spectra_kit.features.distances import (
    biharmonic_distances,
    commute_time_distances,
    diffusion_distances,
    farthest_points,
)
from spectra_kit.features.embedding import Embedding, Surface, embed, embed_shape
from spectra_kit.features.gps import GlobalPointSignature, global_point_signature
from spectra_kit.features.heat import (
    HeatKernelSignature,
    heat_kernel,
    heat_kernel_signature,
    heat_times,
)
from spectra_kit.features.segments import fiedler_order, spectral_segments
from spectra_kit.features.shape_dna import (
    ShapeDNA,
    shape_dna,
    shape_dna_distances,
)
from spectra_kit.features.space import (
    BasisFunctions,
    Coordinates,
    PositionalEncoding,
    embed_batch,
)
from spectra_kit.features.wave import (
    WaveKernelSignature,
    wave_energies,
    wave_kernel_signature,
)

__all__ = [
    "DESCRIPTORS",
    "BasisFunctions",
    "Coordinates",
    "Embedding",
    "GlobalPointSignature",
    "HeatKernelSignature",
    "PositionalEncoding",
    "ShapeDNA",
    "Surface",
    "WaveKernelSignature",
    "biharmonic_distances",
    "commute_time_distances",
    "diffusion_distances",
    "embed",
    "embed_batch",
    "embed_shape",
    "farthest_points",
    "fiedler_order",
    "global_point_signature",
    "heat_kernel",
    "heat_kernel_signature",
    "heat_times",
    "normalize_descriptors",
    "shape_dna",
    "shape_dna_distances",
    "spectral_segments",
    "wave_energies",
    "wave_kernel_signature",
]
