"""ShapeDNA: a surface as the sequence of its eigenvalues, and how far two of them are apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import pdist, squareform

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, positive_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.features._spectra import Isometric, Solvable, outside_kernel, solved, weyl
from spectra_kit.features.embedding import Surface

Normalization = Literal["area", "weyl", "first"]
Weighting = Literal["index", "inverse"]


@checked
def shape_dna(
    surface: Solvable, count: int | None = None, *, normalize: Normalization | None = "area"
) -> Floats:
    """The eigenvalues outside the kernel as a descriptor of the whole surface (ShapeDNA).

    Isometric surfaces have equal ShapeDNA; a few surfaces that are not isometric share it too
    (Reuter, Wolter and Peinecke, *Laplace-Beltrami Spectra as 'Shape-DNA' of Surfaces and Solids*,
    Computer-Aided Design 38(4), 2006).

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        As of `heat_kernel_signature`; zero modes are left out, and with them the number of
        components.
    count : int, optional
        Number of eigenvalues; by default all outside the kernel.
    normalize : {"area", "weyl", "first"} or None, default "area"
        What takes the place of the unit of length:

        - "area": the area, ``lambda_i area``; of a volume ``lambda_i volume^(2/3)``;
        - "weyl": the area that the eigenvalues themselves suggest by Weyl's law ``lambda_i = 4 pi
          i / area``, a least-squares line through the origin. For a mass that is no area; in a
          volume by ``lambda_i = (6 pi^2 i / volume)^(2/3)``;
        - "first": the first of them, ``lambda_i / lambda_1``;
        - None: nothing; eigenvalues in 1/length^2, for surfaces of different size.

    Returns
    -------
    ndarray of shape (count,)
        Ascending, dimensionless unless `normalize` is None; about ``4 pi i`` for "area" and
        "weyl", of volumes ``(6 pi^2 i)^(2/3)``.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.array([0.0, 1.0, 2.0]), np.eye(3), np.full(3, 2.0))
    >>> sk.features.shape_dna(spectrum)
    array([ 6., 12.])
    >>> sk.features.shape_dna(spectrum, normalize="first")
    array([1., 2.])
    """
    return _dna(solved(surface), count, normalize)


def _dna(spectrum: Spectrum, count: int | None, normalize: Normalization | None = "area") -> Floats:
    values = outside_kernel(spectrum).eigenvalues
    if count is not None:
        values = values[: check_count("count", count, low=1, high=len(values))]
    if normalize == "area":
        return np.asarray(values * spectrum.area ** (2 / spectrum.dimension))
    if normalize == "weyl":
        line = weyl(np.arange(1, len(values) + 1), spectrum.dimension)
        return np.asarray(values * (line @ line / (line @ values)))
    return values / values[0] if normalize == "first" else values.copy()


@checked
def shape_dna_distances(dnas: ArrayLike, *, weight: Weighting | None = "index") -> Floats:
    """Distance of every surface of a collection to every other, by their ShapeDNA.

    Parameters
    ----------
    dnas : array_like of shape (s, count)
        One `shape_dna` in each row, all with the same normalisation.
    weight : {"index", "inverse"} or None, default "index"
        What each difference of eigenvalues is divided by before the Euclidean norm is taken:

        - "index": the index i, so that by Weyl's law all count alike;
        - "inverse": the product of the two, ``1 / a_i - 1 / b_i``: low modes, and so coarse form,
          decide, and the sum converges with more modes;
        - None: nothing; high modes decide.

    Returns
    -------
    ndarray of shape (s, s)
        Symmetric, with zeros on the diagonal; in the unit of `dnas`, or its inverse.

    Notes
    -----
    "index" is the reweighting that later work on ShapeDNA settled on (Wachinger et al.,
    *BrainPrint*, NeuroImage 109, 2015), and "inverse" the weighted spectral distance with p = 2
    (Konukoglu et al., *WESD*, PAMI 35(9), 2013).

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.features.shape_dna_distances([[1.0, 2.0], [1.0, 4.0], [4.0, 2.0]], weight=None)
    array([[0.  , 2.  , 3.  ],
           [2.  , 0.  , 3.6...],
           [3.  , 3.6..., 0.  ]])
    """
    rows = positive_array("dnas", dnas, advice="`shape_dna` leaves out zero modes")
    if rows.ndim != 2 or rows.shape[1] == 0:
        raise InvalidInputError(
            "dnas",
            "have shape (s, count), count >= 1",
            rows.shape,
            advice="give one row for each surface",
        )
    if weight == "index":
        rows = rows / np.arange(1, rows.shape[1] + 1)
    if weight == "inverse":
        rows = 1 / rows
    return np.asarray(squareform(pdist(rows)))


@checked
@dataclass(frozen=True, kw_only=True)
class ShapeDNA(Isometric):
    """The eigenvalues of `shape_dna` over those of Weyl's law, in logarithms.

    Parameters
    ----------
    count : int, default 30
        Eigenvalues.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=4).geometry
    >>> sk.features.embed_shape(ball, sk.features.ShapeDNA(count=3), k=4)
    array([ 0.69...,  0.00..., -0.4...])
    """

    count: int = 30

    def __post_init__(self) -> None:
        check_count("count", self.count, low=1)

    def of_points(self, surface: Surface) -> Floats:
        """Refuse: eigenvalues are of the whole surface."""
        raise InvalidInputError(
            "embedding",
            "be one of points",
            "ShapeDNA, which is one of whole surfaces",
            advice="call `embed_shape`",
        )

    def of_all(self, surface: Surface) -> Floats:
        """Return (count,): ``log(lambda_i area / (4 pi i))``."""
        dna = _dna(surface.spectrum, self.count)
        law = weyl(np.arange(1, self.count + 1), surface.spectrum.dimension)
        return np.asarray(np.log(dna / law))
