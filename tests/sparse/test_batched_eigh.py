"""Symmetric eigenproblems in batches against LAPACK, on what is hard for divide and conquer."""

import numpy as np
import pytest
import torch
from launches import Launches

from spectra_kit._sparse import batched_eigh as module
from spectra_kit._sparse.batched_eigh import divide_and_conquer, eigh

EPS = np.finfo(np.float64).eps


def tridiagonal(diagonal, beside):
    return torch.diag_embed(diagonal) + torch.diag_embed(beside, 1) + torch.diag_embed(beside, -1)


def matrices(n, b=2):
    """Name and matrices (b, n, n) of each kind."""
    rng = torch.Generator().manual_seed(n)

    def normal(*shape):
        return torch.randn(*shape, generator=rng, dtype=torch.float64)

    def of_spectrum(values):
        return (Q * values.unsqueeze(-2)) @ Q.mT

    Q = torch.linalg.qr(normal(b, n, n))[0]
    levels = torch.randint(0, 5, (b, n), generator=rng).double()
    i, ones = torch.arange(n).double(), torch.ones(n - 1, dtype=torch.float64)
    grades = 10 ** torch.linspace(0, -16, n, dtype=torch.float64)
    full = normal(b, n, n)
    wilkinson = tridiagonal((i % 21 - 10).abs(), torch.where(i[1:] % 21 == 0, 1e-7, 1.0))
    yield "random", full + full.mT
    yield "huge", 1e200 * (full + full.mT)
    yield "tiny", 1e-250 * (full + full.mT)
    yield "clusters", of_spectrum(levels)
    yield "near clusters", of_spectrum(levels + 1e-10 * normal(b, n))
    yield "nearer clusters", of_spectrum(levels + 1e-14 * normal(b, n))
    yield "graded spectrum", of_spectrum(grades.expand(b, n))
    yield "graded rows", (full + full.mT) * grades.sqrt()[:, None] * grades.sqrt()
    yield "near singular", of_spectrum(torch.where(i < n // 2, 1e-18, normal(b, n).abs()))
    yield "low rank", full[..., :3] @ full[..., :3].mT
    yield "one", torch.eye(n, dtype=torch.float64).expand(b, n, n)
    yield "zero", torch.zeros(b, n, n, dtype=torch.float64)
    yield "diagonal", torch.diag_embed(normal(b, n))
    yield "path", tridiagonal(2 + 0 * i, -ones).expand(b, n, n)
    yield "glued Wilkinson", wilkinson.expand(b, n, n)


@pytest.mark.parametrize("n", [33, 64, 101, 134, 257])
def test_as_good_as_lapack(n):
    for name, A in matrices(n):
        A = (A + A.mT) / 2
        norm = torch.linalg.matrix_norm(A, ord=2).max().clamp(min=1e-300)
        values, vectors = divide_and_conquer(A, n)
        rounding = 16 * n * EPS
        assert (values.diff(dim=1) >= 0).all(), name
        assert (values - torch.linalg.eigvalsh(A)).abs().max() <= rounding * norm, name
        assert (A @ vectors - vectors * values.unsqueeze(1)).abs().max() <= rounding * norm, name
        assert (vectors.mT @ vectors - torch.eye(n)).abs().max() <= rounding, name


def test_the_lowest_alone_are_the_same():
    A = dict(matrices(70))["random"]
    values, vectors = divide_and_conquer(A, 70)
    some, theirs = divide_and_conquer(A, 20)
    assert torch.equal(some, values[:, :20])
    assert torch.allclose(theirs, vectors[..., :20], rtol=0, atol=1e-14)


def test_each_is_solved_as_if_alone():
    A = torch.cat([matrix for _, matrix in matrices(40)])
    values, vectors = divide_and_conquer(A, 40)
    own = [divide_and_conquer(one.unsqueeze(0), 40) for one in A]
    for i, (alone, theirs) in enumerate(own):
        size = alone.abs().max().item()
        assert torch.allclose(values[i], alone[0], rtol=0, atol=1e-13 * size)
        if alone.diff().min() > 1e-6 * size:  # else rounding decides about vectors
            assert torch.allclose(vectors[i], theirs[0], rtol=0, atol=1e-8)


def test_launches_do_not_grow_with_a_batch_and_nothing_is_read():
    counts = []
    for b in (2, 5):
        with Launches() as launches:
            divide_and_conquer(dict(matrices(50, b))["random"], 10)
        counts.append(launches.names)
    assert counts[0] == counts[1]
    assert "_local_scalar_dense" not in counts[0]


def test_what_is_not_faithful_is_told(monkeypatch):
    """As if the roots were not found."""
    A = dict(matrices(70, module._FEW))["random"]
    monkeypatch.setattr(module, "_on_host", lambda A: False)
    values, _, right = eigh(A, 30)
    assert right.all()
    assert torch.allclose(values, torch.linalg.eigvalsh(A)[:, :30], rtol=0, atol=1e-12)
    monkeypatch.setattr(module, "_STEPS", 2)
    assert not eigh(A, 30)[2].any()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
def test_an_accelerator_gives_what_the_host_does():
    full = torch.randn(21, 70, 70, generator=torch.Generator().manual_seed(0)).double()
    A = full + full.mT
    values, vectors, right = (part.cpu() for part in eigh(A.cuda(), 40))
    assert right.all()
    assert (values - torch.linalg.eigvalsh(A)[:, :40]).abs().max() < 1e-12 * 70
    assert (A @ vectors - vectors * values.unsqueeze(1)).abs().max() < 1e-12 * 70
