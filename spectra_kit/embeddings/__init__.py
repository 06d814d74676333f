"""Numbers that say where on a surface a point is, or which surface it is: for learning and search.

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
>>> sk.embeddings.embed(spectrum, sk.embeddings.WaveSignature()).shape
(800, 64)
>>> sk.embeddings.embed_shape(spectrum, sk.embeddings.ShapeDNA()).shape
(30,)
"""

from spectra_kit.embeddings.base import Embedding, Surface, embed, embed_shape
from spectra_kit.embeddings.functions import (
    Coordinates,
    NeoFunctions,
    PlaneWaves,
    PositionalEncoding,
    embed_batch,
)
from spectra_kit.embeddings.spectral import GlobalPoints, HeatSignature, ShapeDNA, WaveSignature

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
    "embed",
    "embed_batch",
    "embed_shape",
]
