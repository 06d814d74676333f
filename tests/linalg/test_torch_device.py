"""Sparse tensors, stage times and memory errors on a torch device."""

import time

import numpy as np
import pytest
import torch
from scipy import sparse

from spectra_kit.linalg.torch_device import (
    csr_diagonal,
    csr_like,
    csr_product,
    csr_rows,
    device_clock,
    device_memory,
    sparse_tensor,
)

DEVICES = ["cpu"] + ["cuda"] * torch.cuda.is_available()


@pytest.fixture
def matrix():
    rng = np.random.default_rng(0)
    return sparse.csr_array(sparse.random_array((50, 50), density=0.1, rng=rng))


@pytest.mark.parametrize("device", DEVICES)
def test_sparse_tensors_say_what_scipy_says(matrix, device):
    tensor = sparse_tensor(matrix, device)
    np.testing.assert_array_equal(tensor.to_dense().cpu(), matrix.toarray())
    np.testing.assert_array_equal(csr_rows(tensor).cpu(), matrix.tocoo().row)
    np.testing.assert_array_equal(csr_diagonal(tensor).cpu(), matrix.diagonal())
    halved = csr_like(tensor, tensor.values() / 2)
    np.testing.assert_array_equal(halved.to_dense().cpu(), matrix.toarray() / 2)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("given", [torch.float64, torch.float32, torch.bfloat16])
@pytest.mark.parametrize(("dtype", "error"), [(torch.float64, 1e-14), (torch.float32, 1e-5)])
def test_products_are_of_the_precision_asked_for(matrix, device, given, dtype, error):
    columns = torch.randn(50, 7, generator=torch.Generator().manual_seed(0)).to(given)
    product = csr_product(sparse_tensor(matrix, device), columns.to(device), dtype)
    assert product.dtype == dtype
    np.testing.assert_allclose(product.cpu(), matrix @ columns.double().numpy(), atol=error)


def test_want_of_memory_is_a_memory_error():
    with pytest.raises(MemoryError, match="can't allocate memory"), device_memory():
        torch.empty(2**50)
    with pytest.raises(RuntimeError, match="must match"), device_memory():
        torch.ones(2) + torch.ones(3)


def test_a_clock_books_time_by_stage():
    clock = device_clock("cpu")
    time.sleep(0.02)
    before = time.perf_counter()
    clock.stage("sleep")
    clock.stage("wake")
    after = time.perf_counter()
    time.sleep(0.02)
    clock.stage("sleep")
    assert clock.seconds["sleep"] >= 0.04
    assert clock.seconds["wake"] <= after - before
