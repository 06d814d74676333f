"""Units in which squares and products of eigenvalues and masses are safe, in float32 as well."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.operators.laplacian import Laplacian

_ORDINARY = 30  # powers of two from one within which sizes and energies need no other unit


class Units(NamedTuple):
    """A length and an energy as powers of two: no digit changes with them."""

    length: int
    energy: int

    @classmethod
    def of(cls, laplacian: Laplacian) -> Units:
        """Return those of an operator; zeros where it is of ordinary size, within 1e9 of one."""
        length = round(0.5 * float(np.log2(laplacian.mass.max()) + np.log2(laplacian.n)))
        typical = float(np.median(laplacian.stiffness.diagonal()))  # needles may be far above it
        energy = round(np.log2(typical)) if typical > 0 else 0
        return cls(*(0 if abs(power) <= _ORDINARY else power for power in (length, energy)))

    def taken_from(self, laplacian: Laplacian) -> Laplacian:
        """Return the operator measured in these units."""
        L = laplacian.stiffness
        data = np.ldexp(L.data, -self.energy)
        return replace(
            laplacian,
            stiffness=sparse.csr_array((data, L.indices, L.indptr), shape=L.shape),
            mass=np.ldexp(laplacian.mass, -2 * self.length),
            points=np.ldexp(laplacian.points, -self.length),
        )

    def given_to(self, spectrum: Spectrum) -> Spectrum:
        """Return a spectrum that was computed in these units in those of the operator."""
        energy = 2.0**self.energy
        spectrum = spectrum.rescale(2.0**self.length)
        found = spectrum.certificate
        return replace(
            spectrum,
            eigenvalues=spectrum.eigenvalues * energy,
            certificate=found
            and replace(
                found,
                residuals=found.residuals * energy,
                count=found.count and found.count.rescaled(1 / energy),
            ),
        )
