"""How much memory a sparse factor takes, and what is made with it, before there is one."""

from __future__ import annotations

import numpy as np


def factor_gigabytes(n: int) -> float:
    """Estimate what a complete factor takes on n points of a surface, in GiB.

    Some ``3 n log2 n`` entries of 12 bytes each, by what factors of meshes of 90,000 and 134,000
    vertices hold (4.9 and 7.2 million), and as much again while it is made.
    """
    return 2 * 12 * 3 * n * float(np.log2(max(n, 2))) / 2**30


def exact_gigabytes(n: int, k: int) -> float:
    """Estimate what the k lowest modes on n points of a surface take by `Arpack`, in GiB.

    The factor, the vectors of a Lanczos run, 704 and a block of eight, and three times the modes:
    found, and put into the order that they are returned in.
    """
    return factor_gigabytes(n) + 8 * n * (712 + 3 * k) / 2**30
