"""What computing with torch on any device needs: sparse matrices, threads, checks."""

from __future__ import annotations

import re
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from spectra_kit._core.threads import alone
from spectra_kit._sparse.products import spmm
from spectra_kit.errors import InvalidInputError


def csr_tensor(
    csr: sparse.csr_array, dtype: torch.dtype = torch.float64, device: str = "cpu"
) -> Tensor:
    """Return a SciPy array as a sparse CSR tensor of a dtype on a device."""
    rows, columns = torch.tensor(csr.indptr), torch.tensor(csr.indices)
    values = torch.tensor(csr.data, dtype=dtype)
    return _csr_tensor(rows, columns, values, csr.shape, device)


def csr_like(pattern: Tensor, values: Tensor) -> Tensor:
    """Return a sparse CSR tensor with the pattern of another, and other values."""
    rows, columns = pattern.crow_indices(), pattern.col_indices()
    return _csr_tensor(rows, columns, values, pattern.shape, pattern.device)


def csr_product(matrix: Tensor, columns: Tensor, dtype: torch.dtype) -> Tensor:
    """Return ``matrix @ columns`` in `dtype`, float32 or float64.

    On the CPU by loops that beat torch's, and that sum in `dtype` what is stored in another.
    """
    if columns.device.type != "cpu":
        return matrix.to(dtype) @ columns.to(dtype).contiguous()
    if columns.dtype not in (torch.float32, torch.float64):
        columns = columns.float()
    rows, indices, values = matrix.crow_indices(), matrix.col_indices(), matrix.values()
    csr = sparse.csr_array(
        (values.numpy(), indices.numpy(), rows.numpy()), shape=tuple(matrix.shape)
    )
    result = np.float64 if dtype == torch.float64 else np.float32
    return torch.from_numpy(spmm(csr, columns.contiguous().numpy(), dtype=result))


def _csr_tensor(
    rows: Tensor,
    columns: Tensor,
    values: Tensor,
    shape: tuple[int, ...],
    device: str | torch.device,
) -> Tensor:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        # From 2.11 on torch says so even where one opts out (pytorch/pytorch, pull request 183256).
        warnings.filterwarnings("ignore", message="Sparse invariant checks are implicitly")
        return torch.sparse_csr_tensor(
            rows,
            columns,
            values,
            size=shape,
            device=device,
            check_invariants=False,  # SciPy's arrays keep them
        )


def check_device(name: str) -> torch.device:
    """Return the device of this name, if torch can compute in float64 on it here."""
    try:
        device = torch.device(name)
        torch.ones(1, dtype=torch.float64, device=device).cpu()
    # Without CUDA torch raises AssertionError, for an unknown name RuntimeError, and TypeError
    # where there is no float64.
    except (RuntimeError, AssertionError, TypeError) as error:
        reason = re.split(r"\n|\. ", str(error))[0]  # torch tells a whole page
        raise InvalidInputError(
            "device", "be one that torch can use here", f"{name!r} ({reason})", advice="try 'cpu'"
        ) from error
    return device


def check_float_dtype(dtype: object) -> torch.dtype:
    """Return `dtype` if it is one of torch's for real numbers."""
    if not isinstance(dtype, torch.dtype) or not dtype.is_floating_point:
        raise InvalidInputError(
            "dtype", "be a torch.dtype of real numbers, such as torch.float32", f"{dtype!r}"
        )
    return dtype


_lock = threading.Lock()
_depth = 0
_threads = 1  # of torch, while it is kept to fewer


@contextmanager
def torch_threads() -> Iterator[None]:
    """Keep torch to one thread inside where `threads.single_threaded` keeps all else to one.

    May be entered from several threads; the last to leave restores what was before. torch counts
    for each thread of ours apart, but what one sets is what later ones begin with.
    """
    if not alone():
        yield
        return
    global _depth, _threads
    with _lock:
        count = torch.get_num_threads()  # asked in any case: the first question sets it
        if _depth == 0:
            _threads = count
        _depth += 1
        torch.set_num_threads(1)
    try:
        yield
    finally:
        with _lock:
            _depth -= 1
            torch.set_num_threads(_threads)
