"""The neural backend: a network that predicts a subspace, and Rayleigh-Ritz inside it.

>>> from spectra_kit.neo import NeoConfig, NeoNetwork
>>> network = NeoNetwork(NeoConfig.named("paper-base"))
>>> sum(parameter.numel() for parameter in network.parameters())
5365632
"""

from spectra_kit.neo.backbones import build_network
from spectra_kit.neo.model import NeoConfig, NeoNetwork
from spectra_kit.neo.pretrained import (
    WEIGHTS,
    Pretrained,
    Shipped,
    load_pretrained,
    save_weights,
)
from spectra_kit.neo.subspace import NeoSubspace

__all__ = [
    "WEIGHTS",
    "NeoConfig",
    "NeoNetwork",
    "NeoSubspace",
    "Pretrained",
    "Shipped",
    "build_network",
    "load_pretrained",
    "save_weights",
]
