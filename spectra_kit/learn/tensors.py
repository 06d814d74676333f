"""What is known of a shape as tensors, and many shapes of it side by side."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from scipy import sparse
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from spectra_kit._core.checked import checked
from spectra_kit.errors import InvalidInputError
from spectra_kit.interop import DiffusionNetTensors

UNKNOWN = -1  #: label of points that nothing is known of
_POWERS = {"hks": -2, "wks": -2, "gps": 0, "dna": 0}  # of length, in the unit of descriptors

with warnings.catch_warnings():
    # PyTorch says once in a process that CSR is in beta and that invariants are not checked: where
    # it is used first, be it by the tensors of a worker that arrive. It is said here, to nobody.
    warnings.filterwarnings("ignore", "Sparse ", UserWarning)
    torch.sparse_csr_tensor([0, 1], [0], [1.0])


class ShapeTensors(NamedTuple):
    """What is known of a shape of n points, as tensors; None is what was not asked for.

    Attributes
    ----------
    name : str
        Of the shape.
    points : Tensor of shape (n, 3)
        In any unit of length, which all else is in, too.
    faces : Tensor of shape (f, 3)
        Indices of points; none of a cloud.
    mass : Tensor of shape (n,)
        In length^2.
    eigenvalues : Tensor of shape (k,)
        In 1/length^2.
    eigenvectors : Tensor of shape (n, k)
        In 1/length.
    descriptors : dict of str to Tensor
        Signatures by their names, (n, c), or (c,) of ShapeDNA.
    stiffness : Tensor of shape (n, n), sparse CSR, or None
        The weak Laplacian.
    frames : Tensor of shape (n, 3, 3) or None
        Rows are the axes of the tangent plane at a point, and the normal.
    gradient_x, gradient_y : Tensor of shape (n, n), sparse CSR, or None
        Slopes along these axes, in 1/length.
    labels : Tensor of shape (), (n,) or (f,), or None
        For a transform to fill: of the whole, of points or of faces.
    """

    name: str
    points: Tensor
    faces: Tensor
    mass: Tensor
    eigenvalues: Tensor
    eigenvectors: Tensor
    descriptors: Mapping[str, Tensor]
    stiffness: Tensor | None = None
    frames: Tensor | None = None
    gradient_x: Tensor | None = None
    gradient_y: Tensor | None = None
    labels: Tensor | None = None

    def to(self, device: str | torch.device) -> ShapeTensors:
        """Return the same on a device."""
        return ShapeTensors(*(moved(part, device) for part in self))

    def diffusion_net(self) -> DiffusionNetTensors:
        """Return what DiffusionNet's ``get_operators`` would: see `interop.to_diffusion_net`."""
        L, frames, x, y = _operators(self)
        L, x, y = (matrix.to_sparse() for matrix in (L, x, y))
        return DiffusionNetTensors(frames, self.mass, L, self.eigenvalues, self.eigenvectors, x, y)


class ShapeBatch(NamedTuple):
    """What is known of b shapes of up to n points and f faces, padded by zeros.

    Sparse matrices are blocks along the diagonal of one: a single product ``gradient_x @
    values.flatten(0, 1)`` serves the whole batch.

    Attributes
    ----------
    names : tuple of str
        Of the shapes.
    points : Tensor of shape (b, n, 3)
    mask : Tensor of shape (b, n)
        True where there is a point.
    faces : Tensor of shape (b, f, 3)
        Indices of points of their own shape.
    face_mask : Tensor of shape (b, f)
        True where there is a face.
    mass : Tensor of shape (b, n)
        So padding counts for nothing in integrals.
    eigenvalues : Tensor of shape (b, k)
    eigenvectors : Tensor of shape (b, n, k)
    descriptors : dict of str to Tensor
        (b, n, c), or (b, c) of ShapeDNA.
    stiffness, gradient_x, gradient_y : Tensor of shape (b n, b n), sparse CSR, or None
        Block-diagonal.
    frames : Tensor of shape (b, n, 3, 3) or None
    labels : Tensor of shape (b,), (b, n) or (b, f), or None
        Padded by -1.
    """

    names: tuple[str, ...]
    points: Tensor
    mask: Tensor
    faces: Tensor
    face_mask: Tensor
    mass: Tensor
    eigenvalues: Tensor
    eigenvectors: Tensor
    descriptors: Mapping[str, Tensor]
    stiffness: Tensor | None = None
    frames: Tensor | None = None
    gradient_x: Tensor | None = None
    gradient_y: Tensor | None = None
    labels: Tensor | None = None

    @property
    def features(self) -> Tensor:
        """What networks see of each point: where it is, and its descriptors, (b, n, 3 + c).

        For others, make a `Batch` of them and what else is here.
        """
        signatures = [part for part in self.descriptors.values() if part.ndim == 3]
        return torch.cat([self.points, *signatures], dim=-1)

    @property
    def slopes(self) -> tuple[Tensor, Tensor] | None:
        """Both gradients, as networks take them; None where they were not asked for."""
        if self.gradient_x is None or self.gradient_y is None:
            return None
        return self.gradient_x, self.gradient_y

    def to(self, device: str | torch.device) -> ShapeBatch:
        """Return the same on a device."""
        return ShapeBatch(*(moved(part, device) for part in self))

    def diffusion_net(self) -> DiffusionNetTensors:
        """Return what the layers of DiffusionNet take for a batch: sparse COO (b, n, n)."""
        L, frames, x, y = _operators(self)
        L, x, y = (blocks(matrix, len(self.names)) for matrix in (L, x, y))
        return DiffusionNetTensors(frames, self.mass, L, self.eigenvalues, self.eigenvectors, x, y)


@checked
def collate(items: Sequence[ShapeTensors]) -> ShapeBatch:
    """Return shapes side by side: for ``torch.utils.data.DataLoader(..., collate_fn=collate)``.

    Parameters
    ----------
    items : sequence of ShapeTensors
        With as many modes each; what one of them has, all have.

    Returns
    -------
    ShapeBatch
        Padded by zeros, labels by -1.
    """
    if not items:
        raise InvalidInputError("items", "hold at least one shape", "none")
    modes = sorted({len(item.eigenvalues) for item in items})
    if len(modes) > 1:
        raise InvalidInputError("items", "have as many modes each", f"{modes[0]} and {modes[-1]}")
    points, faces = (_padded(items, name) for name in ("points", "faces"))
    n = points.shape[1]

    def side_by_side(name: str) -> Tensor | None:
        matrices = _of_all(items, name)
        return block_diagonal(matrices, n) if matrices else None

    return ShapeBatch(
        tuple(item.name for item in items),
        points,
        _mask([len(item.points) for item in items], points),
        faces,
        _mask([len(item.faces) for item in items], faces),
        _padded(items, "mass"),
        torch.stack([item.eigenvalues for item in items]),
        _padded(items, "eigenvectors"),
        _descriptors(items),
        side_by_side("stiffness"),
        _padded(items, "frames") if _of_all(items, "frames") else None,
        side_by_side("gradient_x"),
        side_by_side("gradient_y"),
        _labels(items),
    )


@checked
def normalized(item: ShapeTensors, *, by: Literal["radius", "area"] = "radius") -> ShapeTensors:
    """Return a shape about the mean of its points, in a unit of its own: a transform.

    Parameters
    ----------
    item : ShapeTensors
        In any unit, without descriptors of your own: add those after it.
    by : {"radius", "area"}, default "radius"
        What becomes one: the largest distance from the mean, as in DiffusionNet's scripts, or the
        area, as networks of this package see it.

    Returns
    -------
    ShapeTensors
        All of it in the new unit.
    """
    if unknown := sorted(set(item.descriptors) - set(_POWERS)):
        raise InvalidInputError(
            "item",
            f"have descriptors among {', '.join(_POWERS)}, whose units are known",
            ", ".join(unknown),
            advice="add your own after it",
        )
    points = item.points - item.points.mean(dim=0)
    unit = points.norm(dim=1).max() if by == "radius" else item.mass.sum().sqrt()
    x, y = (
        None if matrix is None else scaled(matrix, unit)
        for matrix in (item.gradient_x, item.gradient_y)
    )
    return item._replace(
        points=points / unit,
        mass=item.mass / unit**2,
        eigenvalues=item.eigenvalues * unit**2,
        eigenvectors=item.eigenvectors * unit,
        descriptors={
            name: values * unit ** -_POWERS[name] for name, values in item.descriptors.items()
        },
        gradient_x=x,
        gradient_y=y,
    )


def moved(part: Any, device: str | torch.device) -> Any:
    """Return tensors, or what holds them, on a device, and anything else as it is."""
    if isinstance(part, Mapping):
        return {name: values.to(device) for name, values in part.items()}
    if isinstance(part, tuple):
        return tuple(moved(one, device) for one in part)
    return part.to(device) if isinstance(part, Tensor) else part


def _operators(item: ShapeTensors | ShapeBatch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    L, frames, x, y = item.stiffness, item.frames, item.gradient_x, item.gradient_y
    if L is None or frames is None or x is None or y is None:
        raise InvalidInputError(
            "operators", "hold 'stiffness' and 'gradient', for DiffusionNet", "less"
        )
    return L, frames, x, y


def _of_all(items: Sequence[ShapeTensors], name: str) -> list[Tensor]:
    """Return what all have of a name, an empty list if none has it."""
    found = [part for item in items if (part := getattr(item, name)) is not None]
    if len(found) not in (0, len(items)):
        raise InvalidInputError("items", f"all have `{name}`, or none", f"{len(found)} of them")
    return found


def _padded(items: Sequence[ShapeTensors], name: str) -> Tensor:
    return pad_sequence(_of_all(items, name), batch_first=True)


def _mask(counts: Sequence[int], padded: Tensor) -> Tensor:
    places = torch.arange(padded.shape[1], device=padded.device)
    return places < torch.tensor(counts, device=padded.device)[:, None]


def _descriptors(items: Sequence[ShapeTensors]) -> dict[str, Tensor]:
    names = [*items[0].descriptors]
    if any([*item.descriptors] != names for item in items):
        raise InvalidInputError("items", "have the same `descriptors`", "others")
    several = {name: [item.descriptors[name] for item in items] for name in names}
    for name, some in several.items():
        if len(widths := {values.shape[-1] for values in some}) > 1:
            raise InvalidInputError(
                "items",
                f"have as many numbers each in the descriptor {name!r}",
                " and ".join(map(str, sorted(widths))),
                advice="surfaces of several components have fewer: leave them, or it, out",
            )
    return {
        name: torch.stack(some) if some[0].ndim == 1 else pad_sequence(some, batch_first=True)
        for name, some in several.items()
    }


def _labels(items: Sequence[ShapeTensors]) -> Tensor | None:
    labels = _of_all(items, "labels")
    if not labels or labels[0].ndim == 0:
        return torch.stack(labels) if labels else None
    return pad_sequence(labels, batch_first=True, padding_value=UNKNOWN)


def csr_tensor(matrix: sparse.csr_array, dtype: torch.dtype) -> Tensor:
    """Return a SciPy matrix as a sparse CSR tensor."""
    rows, columns = (part.astype(np.int64) for part in (matrix.indptr, matrix.indices))
    values = torch.tensor(matrix.data, dtype=dtype)
    return _csr(torch.from_numpy(rows), torch.from_numpy(columns), values, matrix.shape)


def scaled(matrix: Tensor, factor: Tensor) -> Tensor:
    """Return a CSR tensor times a number."""
    return _csr(matrix.crow_indices(), matrix.col_indices(), matrix.values() * factor, matrix.shape)


def block_diagonal(matrices: Sequence[Tensor], n: int) -> Tensor:
    """Return b square CSR tensors along the diagonal of one (b n, b n): rows up to n are empty."""
    device = matrices[0].device
    counts = torch.zeros(len(matrices), n, dtype=torch.int64, device=device)  # entries of each row
    for row, matrix in zip(counts, matrices, strict=True):
        row[: len(matrix)] = matrix.crow_indices().diff()
    rows = torch.cat([counts.new_zeros(1), counts.flatten().cumsum(0)])
    columns = torch.cat([matrix.col_indices() + i * n for i, matrix in enumerate(matrices)])
    values = torch.cat([matrix.values() for matrix in matrices])
    return _csr(rows, columns, values, (len(rows) - 1,) * 2)


def blocks(matrix: Tensor, b: int) -> Tensor:
    """Return the b blocks of a diagonal, side by side: sparse COO (b, n, n)."""
    n = len(matrix) // b
    coo = matrix.to_sparse()
    rows, columns = coo.indices()
    where = torch.stack([rows // n, rows % n, columns % n])
    return torch.sparse_coo_tensor(
        where, coo.values(), (b, n, n), is_coalesced=True, check_invariants=False
    )


def _csr(rows: Tensor, columns: Tensor, values: Tensor, size: tuple[int, ...]) -> Tensor:
    return torch.sparse_csr_tensor(rows, columns, values, size, check_invariants=False)
