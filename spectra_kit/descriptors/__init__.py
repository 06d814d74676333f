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
>>> sk.descriptors.heat_kernel_signature(spectrum).shape
(1000, 16)
>>> sk.descriptors.biharmonic_distances(spectrum, [0, 1]).shape
(2, 1000)

Of two surfaces, with one grid of energies for both:

>>> other = sk.eigensolve(sk.robust_laplacian(sk.geometry.creature(900, pose=1)), 50)
>>> first, second = (s.rescale(s.area**-0.5) for s in (spectrum, other))
>>> energies, width = sk.descriptors.wave_energies(first)
>>> sk.descriptors.wave_kernel_signature(second, energies, width=width).shape
(900, 100)
"""

from spectra_kit.descriptors.columns import normalize_descriptors
from spectra_kit.descriptors.distances import (
    biharmonic_distances,
    commute_time_distances,
    diffusion_distances,
    farthest_points,
    global_point_signature,
)
from spectra_kit.descriptors.grids import heat_times, wave_energies
from spectra_kit.descriptors.heat import (
    heat_kernel,
    heat_kernel_signature,
    landmark_heat_kernel_signature,
)
from spectra_kit.descriptors.shape_dna import shape_dna, shape_dna_distance, shape_dna_distances
from spectra_kit.descriptors.wave import landmark_wave_kernel_signature, wave_kernel_signature

__all__ = [
    "biharmonic_distances",
    "commute_time_distances",
    "diffusion_distances",
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
