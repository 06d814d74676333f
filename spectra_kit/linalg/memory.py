"""How much memory a sparse factor takes, before there is one."""

from __future__ import annotations

import numpy as np


def factor_gigabytes(n: int) -> float:
    """Estimate what a complete factor takes on n points of a surface, in GiB.

    Some ``3 n log2 n`` entries of 12 bytes each, by what factors of meshes of 90,000 and 134,000
    vertices hold (4.9 and 7.2 million), and as much again while it is made.
    """
    return 2 * 12 * 3 * n * float(np.log2(max(n, 2))) / 2**30
