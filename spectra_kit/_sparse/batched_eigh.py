"""Symmetric eigenproblems of many small matrices at once, without a launch for each of them.

Accelerators are handed such matrices one after the other, at milliseconds for each of a few hundred
rows, while products of as many take microseconds. This is made of what does batch: products, sums
along rows, and Jacobi's method for up to 32 rows. It goes LAPACK's way: Householder's reduction to
tridiagonal form, then divide and conquer with the eigenvectors of Gu and Eisenstat (*A divide-and-
conquer algorithm for the symmetric tridiagonal eigenproblem*, SIAM J. Matrix Anal. Appl. 16, 1995).
Deflation, which differs from matrix to matrix, gives way to perturbations as small as rounding:
poles are kept so far apart, and weights so far from zero.
"""

from __future__ import annotations

import torch
from torch import Tensor

_LEAF = 32  # rows up to which cuSOLVER solves a batch at once
_FEW = 16  # matrices, below which launches cost more than one after the other is expected to
_STEPS = 14  # to roots of the secular equation: 11 were enough for all matrices tried
_SLOW = 0.1  # share of the sum that a good step leaves
_SETTLED = 1e-10  # relative steps, after which it may be rounding that leads out of a bracket
_NEAR = 1e-12  # distances to a pole, of that to the next one, which are looked at first
_EPS = torch.finfo(torch.float64).eps
_APART = 4 * _EPS  # between poles, of matrices of norm one
_NOTHING = 1e-300  # for the square of a column that is zero already
_FAITHFUL = 16 * _EPS  # times the rows: what a decomposition may be off, for a norm of one


def eigh(A: Tensor, keep: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return the lowest eigenvalues (b, keep), orthonormal vectors (b, n, keep), and what is right.

    Of finite symmetric float64 matrices (b, n, n), n >= keep: by ``torch.linalg.eigh`` on the host,
    and where they are few or small. Else what is not faithful to its matrix is marked by False.
    """
    b, n, _ = A.shape
    if _on_host(A) or n <= _LEAF or b < _FEW:
        values, vectors = torch.linalg.eigh(A)
        right = torch.ones(b, dtype=torch.bool, device=A.device)
        return values[:, :keep], vectors[..., :keep], right
    values, vectors = divide_and_conquer(A, keep)
    off = (A @ vectors - vectors * values.unsqueeze(1)) / _size(A).clamp(min=_NOTHING)
    eye = torch.eye(keep, dtype=A.dtype, device=A.device)
    worst = torch.cat([off, vectors.mT @ vectors - eye], 1).abs().amax((1, 2))
    return values, vectors, worst <= _FAITHFUL * n


def _on_host(A: Tensor) -> bool:
    return A.device.type == "cpu"


def divide_and_conquer(A: Tensor, keep: int) -> tuple[Tensor, Tensor]:
    """Return the same eigenvalues and vectors by the way above, whatever the device; n >= 2."""
    leaves, joints, reflectors, halves, size = _torn(A)
    values, vectors = torch.linalg.eigh(leaves)
    return _joined(values, vectors, joints, reflectors, halves, size, keep)


def _size(A: Tensor) -> Tensor:
    """Return a bound (b, 1, 1) on the norms of matrices: the largest sum of a row."""
    return A.abs().sum(2, keepdim=True).amax(1, keepdim=True)


def _tridiagonal(A: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Reduce matrices: return diagonals (b, n), those beside them, reflectors v (b, n, n - 2).

    And the halves (b, n - 2) of their squares: each reflection is ``I - v v^T / half``.
    """
    A, (b, n, _) = A.clone(), A.shape
    beside, halves = A.new_empty(b, n - 1), A.new_empty(b, n - 2)
    for j in range(n - 2):
        v, rest = A[:, j + 1 :, j : j + 1], A[:, j + 1 :, j + 1 :]
        first, half = v[:, 0], halves[:, j : j + 1]
        norm = torch.linalg.vector_norm(v, dim=1)
        torch.mul(norm, first.abs() + norm, out=half)
        half.clamp_(min=_NOTHING)
        beside[:, j : j + 1] = image = -norm.copysign(first)
        first -= image
        w = (rest @ v).div_(half.unsqueeze(2))
        w -= v * ((w.mT @ v) / (2 * half.unsqueeze(2)))
        rest.baddbmm_(torch.cat([v, w], 2), torch.cat([w, v], 2).mT, alpha=-1)
    beside[:, n - 2] = A[:, n - 1, n - 2]
    return A.diagonal(dim1=1, dim2=2), beside, A.tril(-1)[..., : n - 2], halves


def _torn(A: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Return the parts of tridiagonal matrices (b p, w, w), and what joins them to a whole again.

    With ``rho u u^T`` taken away for each entry `beside` that joins two, u = (..., 1, sign, ...).
    """
    b, n, _ = A.shape
    size = _size(A)
    diagonal, beside, reflectors, halves = _tridiagonal(A / size.clamp(min=_NOTHING))
    parts = 1 << (-(-n // _LEAF) - 1).bit_length()  # halved and halved again
    more = -n % parts
    # Rows that fill the last part are joined to nothing, with eigenvalues above all others.
    above = 2 + torch.arange(more, device=A.device).to(A) / n
    diagonal = torch.cat([diagonal, above.expand(b, -1)], 1).reshape(b, parts, -1)
    beside = torch.cat([beside, beside.new_zeros(b, more + 1)], 1).reshape(diagonal.shape)
    joints = beside[:, :-1, -1]
    rho = joints.abs().clamp(min=_EPS)
    diagonal[:, :-1, -1] -= rho
    diagonal[:, 1:, 0] -= rho
    off = torch.diag_embed(beside[..., :-1], 1)
    leaves = torch.diag_embed(diagonal) + off + off.mT
    return leaves.flatten(0, 1), joints, reflectors, halves, size


def _joined(
    values: Tensor,
    vectors: Tensor,
    joints: Tensor,
    reflectors: Tensor,
    halves: Tensor,
    size: Tensor,
    keep: int,
) -> tuple[Tensor, Tensor]:
    """Return the `keep` lowest eigenpairs of matrices from those of their parts."""
    b, apart = len(size), 1
    while (parts := len(values) // b) > 1:
        half = values.shape[1]
        kept = keep if parts == 2 else 2 * half
        joint = joints[:, apart - 1 :: 2 * apart].reshape(-1, 1)
        rho, sign = joint.abs().clamp(min=_EPS), torch.where(joint < 0, -1.0, 1.0).to(joint)
        poles, order = values.reshape(-1, 2 * half).sort(1)
        vectors = vectors.reshape(-1, 2, half, half)
        z = torch.cat([vectors[:, 0, -1], vectors[:, 1, 0] * sign], 1)
        values, inner = _of_rank_one(poles, z.gather(1, order), rho, kept)
        place = order.argsort(1)[:, None].expand(-1, kept, -1)
        inner = inner.gather(2, place).reshape(-1, kept, 2, half).permute(0, 2, 3, 1)
        vectors = (vectors @ inner).reshape(-1, 2 * half, kept)
        apart *= 2
    values, vectors = values[:, :keep], vectors[:, : reflectors.shape[1], :keep]
    # All reflections at once: their product is I - V T^-1 V^T.
    triangle = (reflectors.mT @ reflectors).triu(1) + torch.diag_embed(halves)
    inner = torch.linalg.solve_triangular(triangle, reflectors.mT @ vectors, upper=True)
    return values * size[..., 0], vectors - reflectors @ inner


def _of_rank_one(d: Tensor, z: Tensor, rho: Tensor, keep: int) -> tuple[Tensor, Tensor]:
    """Return the `keep` lowest eigenvalues of ``diag(d) + rho z z^T``, and vectors in rows.

    For ascending d (b, n), z (b, n) and rho (b, 1).
    """
    n = d.shape[1]
    raised = _APART * torch.arange(n, device=d.device).to(d)
    d = (d - raised).cummax(1).values + raised
    z = z.abs().clamp(min=_EPS).copysign(z)
    origin, steps = _secular_roots(d, z.square(), rho)
    # Distances lambda_i - d_j keep their digits, however near a pole is.
    apart = (origin.unsqueeze(2) - d.unsqueeze(1)) + steps.unsqueeze(2)
    # The z of which these lambda are the exact eigenvalues: vectors are orthogonal with it.
    between = d.unsqueeze(2) - d.unsqueeze(1)
    following = torch.cat([between[:, 1:], torch.ones_like(between[:, :1])], 1)
    later = torch.ones_like(between[0], dtype=torch.bool).triu(1)  # j > i
    pairs = torch.where(later, between, following)
    exact = (apart / pairs).prod(1).abs().sqrt().copysign(z)
    vectors = exact.unsqueeze(1) / apart[:, :keep]
    vectors /= torch.linalg.vector_norm(vectors, dim=2, keepdim=True)
    return (origin + steps)[:, :keep], vectors


def _secular_roots(d: Tensor, weights: Tensor, rho: Tensor) -> tuple[Tensor, Tensor]:
    """Return roots of ``1 / rho + sum_j weights_j / (d_j - x) = 0`` as poles and steps from them.

    One between each pole and the next, from the nearer of the two, and one after the last. That
    pole is kept as it is; the sum over the others is replaced by a function of its value and slope
    with one pole, the next on the other side: the fixed weight method of Li (*Solving secular
    equations stably and efficiently*, LAPACK Working Note 89, 1993).
    """
    n = d.shape[1]
    last = d[:, -1:] + 2 * rho * weights.sum(1, keepdim=True)
    upper = torch.cat([d[:, 1:], last], 1)
    after = torch.cat([weights[:, 1:], torch.zeros_like(last)], 1)
    width, mid = upper - d, (upper - d) / 2
    away = d.unsqueeze(1) - d.unsqueeze(2) - mid.unsqueeze(2)
    f = 1 / rho + (weights.unsqueeze(1) / away).sum(2)
    left = f >= 0
    left[:, -1] = True
    # From the nearer pole up or down, y > 0: mirrored, the one is like the other.
    sign = torch.where(left, 1.0, -1.0).to(d)
    origin, constant = torch.where(left, d, upper), sign / rho
    index = torch.arange(n, device=d.device) + (~left).long()
    poles = (d.unsqueeze(1) - origin.unsqueeze(2)) * sign.unsqueeze(2)
    own = weights.gather(1, index)
    others = weights.unsqueeze(1).repeat(1, n, 1).scatter_(2, index.unsqueeze(2), 0.0)
    behind = (poles < 0).to(d)
    low, high = torch.zeros_like(d), torch.cat([mid[:, :-1], width[:, -1:]], 1)
    # The nearest two poles as they are, all others as at the middle.
    rest = sign * (f + (weights - after) / mid)
    y = _root(rest, rest * width + weights + after, own * width)
    y = torch.where((y > low) & (y < high), y, high / 2)
    before, both = torch.full_like(y, torch.inf), torch.zeros_like(left)
    for _ in range(_STEPS):
        away = poles - y.unsqueeze(2)
        terms = others / away
        rest = constant + terms.sum(2)
        terms /= away
        slope, same = terms.sum(2), terms.mul_(behind).sum(2)
        near = own / y
        f, q = rest - near, width - y
        is_low = f < 0
        low, high = torch.where(is_low, y, low), torch.where(is_low, high, y)
        # Where the sum falls slowly, poles behind the nearest count as one with it.
        size = f.abs()
        both, before = both ^ (size > _SLOW * before), size
        c = torch.addcmul(rest, q, slope, value=-1)
        c = torch.where(both, torch.addcmul(c, width, same), c)
        product = y * q
        a = torch.addcmul((q - y) * f, product, torch.addcdiv(slope, near, y))
        step = _root(c, a, -product * f)
        found = y + step
        inside = found == found.clamp(low, high)
        stays = step.abs() <= _SETTLED * y
        between = (torch.maximum(low, _NEAR * high) * high).sqrt()
        y = torch.where(inside, found, torch.where(stays, y, between))
    return origin, sign * y


def _root(c: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Return the root ``(a - sqrt(a^2 - 4 b c)) / 2 c`` without loss of digits."""
    sum_ = a + torch.addcmul(a.square(), b, c, value=-4).clamp_(min=0).sqrt_().copysign(a)
    return torch.where(a > 0, 2 * b / sum_, sum_ / (2 * c))
