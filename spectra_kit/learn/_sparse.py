"""Sparse matrices as tensors: one of each shape, or all of a batch along a diagonal."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

with warnings.catch_warnings():
    # PyTorch says once in a process that CSR is in beta and that invariants are not checked: where
    # it is used first, be it by the tensors of a worker that arrive. It is said here, to nobody.
    warnings.filterwarnings("ignore", "Sparse ", UserWarning)
    torch.sparse_csr_tensor([0, 1], [0], [1.0])


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
