"""How shapes become what networks see: a `Recipe` for all, an `Example` of each, batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit.eigen import Automatic, Eigensolver
from spectra_kit.errors import InvalidInputError
from spectra_kit.features import Embedding, Surface, embed_batch
from spectra_kit.features.embedding import finite
from spectra_kit.geometry import Geometry, GeometryLike, TriangleMesh, sample
from spectra_kit.learn.networks import Batch, Need
from spectra_kit.learn.tensors import block_diagonal, csr_tensor
from spectra_kit.operators import tangent_gradient

_STRETCH = float(np.log(4 / 3))


@checked
@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How the points of shapes become numbers.

    Parameters
    ----------
    embeddings : tuple of Embedding
        Whose columns stand side by side.
    k : int, default 96
        Modes of a shape's spectrum.
    solver : Eigensolver, default Automatic()
        Who computes them: ``Neo()`` predicts them.
    upright : bool, default False
        All shapes stand alike, and which way is up counts: they are not turned in training. Without
        it, where rotations change an embedding, networks learn from shapes turned at random.
    points : int, optional
        See meshes as clouds of so many random points; by default by their own vertices.
    seed : int, default 0
        Of these points.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> waves = sk.features.WaveKernelSignature(count=32, width=1.5, first=3)
    >>> recipe = sk.learn.Recipe(
    ...     embeddings=(waves, sk.features.ShapeDNA(count=45)), solver=sk.Neo()
    ... )
    >>> recipe.vector(sk.geometry.creature(1000)).shape
    (365,)
    """

    embeddings: tuple[Embedding, ...]
    k: int = 96
    solver: Eigensolver = Automatic()  # noqa: RUF009
    upright: bool = False
    points: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_count("k", self.k, low=1)
        check_count("seed", self.seed, low=0)
        if self.points is not None:
            check_count("points", self.points, low=4)
        if not self.embeddings:
            raise InvalidInputError("embeddings", "hold at least one", "none")

    @property
    def turns(self) -> bool:
        """Whether shapes are turned to learn from: rotations change the numbers, and should not."""
        return not self.upright and any(
            "rotation" not in one.invariant_to for one in self.embeddings
        )

    def vector(self, shape: GeometryLike) -> Floats:
        """Return the embeddings of a whole shape, one after the other: (c,)."""
        surface = _surface(self, _seen(self, shape))
        return finite(np.concatenate([e.of_all(surface) for e in self.embeddings]))


@dataclass(frozen=True, eq=False)
class Example:
    """A shape of area one as networks see it; all float32."""

    points: Tensor  #: (n, 3)
    mass: Tensor  #: (n,), which sum to one
    features: Tensor  #: (n, c): of the embeddings that do not change with rotation
    eigenvalues: Tensor | None  #: (k,)
    eigenvectors: Tensor | None  #: (n, k)
    slopes: tuple[Tensor, Tensor] | None  #: (n, n), sparse CSR: along the tangents

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.points)

    def some(self, rows: Tensor) -> Example:
        """Return the example of some points; of these, no operator is known."""
        mass = self.mass[rows]
        return Example(self.points[rows], mass / mass.sum(), self.features[rows], None, None, None)


def prepared(
    recipe: Recipe, shape: Geometry, sees: frozenset[Need] = frozenset()
) -> tuple[Example, Geometry]:
    """Return what networks that need `sees` are told of a shape, and the points they see."""
    shape = _seen(recipe, shape)
    surface = _surface(recipe, shape)
    laplacian = surface.laplacian
    scale = float(laplacian.mass.sum()) ** -0.5
    still = [e.of_points(surface) for e in recipe.embeddings if "rotation" in e.invariant_to]
    spectrum = surface.spectrum if "spectrum" in sees else None
    example = Example(
        points=_tensor((laplacian.points - laplacian.points.mean(axis=0)) * scale),
        mass=_tensor(surface.mass),
        features=_tensor(finite(np.column_stack([np.empty((laplacian.n, 0)), *still]))),
        eigenvalues=None if spectrum is None else _tensor(spectrum.eigenvalues),
        eigenvectors=None if spectrum is None else _tensor(spectrum.eigenvectors),
        slopes=_slopes(shape, scale) if "slopes" in sees else None,
    )
    return example, shape


def batched(
    recipe: Recipe, examples: Sequence[Example], *, rotations: Tensor | None = None
) -> Batch:
    """Return examples side by side, turned by (b, 3, 3) where these are given."""
    points, mass, features = (
        pad_sequence([getattr(e, name) for e in examples], batch_first=True)
        for name in ("points", "mass", "features")
    )
    if rotations is not None:
        points = points @ rotations.transpose(1, 2)
    turned = [
        embed_batch(points, mass, e) for e in recipe.embeddings if "rotation" not in e.invariant_to
    ]
    values = [e.eigenvalues for e in examples if e.eigenvalues is not None]
    vectors = [e.eigenvectors for e in examples if e.eigenvectors is not None]
    along, across = ([e.slopes[axis] for e in examples if e.slopes is not None] for axis in (0, 1))
    n = points.shape[1]
    return Batch(
        torch.cat([features, *turned], dim=-1),
        points,
        mass,
        torch.stack(values) if values else None,
        pad_sequence(vectors, batch_first=True) if vectors else None,
        (block_diagonal(along, n), block_diagonal(across, n)) if along else None,
    )


def stretched(shape: Geometry, rng: np.random.Generator) -> Geometry:
    """Return a shape stretched and squeezed by up to a third along three random axes."""
    axes = Rotation.random(rng=rng).as_matrix()
    stretch = axes.T @ np.diag(np.exp(rng.uniform(-_STRETCH, _STRETCH, 3))) @ axes
    return shape.with_points(shape.points @ stretch)


def _seen(recipe: Recipe, shape: Geometry) -> Geometry:
    if recipe.points is None or not isinstance(shape, TriangleMesh):
        return shape
    return sample(shape, recipe.points, seed=recipe.seed)


def _surface(recipe: Recipe, shape: Geometry) -> Surface:
    surface = Surface(shape, recipe.k, recipe.solver)
    spectral = any("isometry" in e.invariant_to for e in recipe.embeddings)
    if spectral and surface.laplacian.kernel_dimension > 1:
        raise InvalidInputError(
            "shape",
            "be connected, for embeddings by its spectrum",
            f"{surface.laplacian.kernel_dimension} components",
            advice="take the largest alone, by {}, or label them one by one (geometry.components)",
            remedies=("geometry.largest_component(mesh)",),
        )
    return surface


def _tensor(values: Floats) -> Tensor:
    return torch.tensor(values, dtype=torch.float32)


def _slopes(shape: Geometry, scale: float) -> tuple[Tensor, Tensor]:
    _, x, y = tangent_gradient(shape)
    return csr_tensor(x / scale, torch.float32), csr_tensor(y / scale, torch.float32)
