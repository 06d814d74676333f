"""Sparse tensors, stage times and memory errors on a torch device."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from scipy import sparse

from spectra_kit._core.threads import single_threaded
from spectra_kit._sparse.blocks import device_clock, device_memory
from spectra_kit._sparse.torch_device import (
    csr_like,
    csr_product,
    csr_tensor,
    torch_threads,
)

DEVICES = ["cpu"] + ["cuda"] * torch.cuda.is_available()


@pytest.mark.parametrize("device", DEVICES)
def test_sparse_tensors_do_what_scipy_does(device):
    rng = np.random.default_rng(0)
    matrix = sparse.csr_array(sparse.random_array((50, 50), density=0.1, rng=rng))
    tensor = csr_tensor(matrix, device=device)
    np.testing.assert_array_equal(tensor.to_dense().cpu(), matrix.toarray())
    halved = csr_like(tensor, tensor.values() / 2)
    np.testing.assert_array_equal(halved.to_dense().cpu(), matrix.toarray() / 2)
    for given in (torch.float64, torch.float32, torch.bfloat16):
        columns = torch.randn(50, 7, generator=torch.Generator().manual_seed(0)).to(given)
        for dtype, error in ((torch.float64, 1e-14), (torch.float32, 1e-5)):
            product = csr_product(tensor, columns.to(device), dtype)
            assert product.dtype == dtype
            np.testing.assert_allclose(product.cpu(), matrix @ columns.double().numpy(), atol=error)


def test_want_of_memory_is_a_memory_error():
    with pytest.raises(MemoryError, match="can't allocate memory"), device_memory():
        torch.empty(2**50)
    with pytest.raises(RuntimeError, match="must match"), device_memory():
        torch.ones(2) + torch.ones(3)


def test_a_clock_books_time_by_stage():
    clock = device_clock("cpu")
    for stage in ("sleep", "wake", "sleep"):
        time.sleep(0.02 * (stage == "sleep"))
        clock.stage(stage)
    assert 0.04 <= clock.seconds["sleep"] <= clock.total
    assert clock.seconds["wake"] <= clock.total - clock.seconds["sleep"]


def test_torch_keeps_to_one_thread_where_all_else_does():
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    meet = threading.Barrier(2)

    def inside(last: bool) -> tuple[int, int]:
        with single_threaded(), torch_threads():
            meet.wait()
            first = torch.get_num_threads()
            meet.wait()
            if last:
                time.sleep(0.05)  # leaves when the other has
        return first, torch.get_num_threads()

    try:
        with torch_threads():
            assert torch.get_num_threads() == 3
        with ThreadPoolExecutor(2) as pool:
            assert list(pool.map(inside, (False, True))) == [(1, 3), (1, 3)]
        with ThreadPoolExecutor(1) as pool:  # a thread of its own, begun afterwards
            assert pool.submit(torch.get_num_threads).result() == 3
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)
