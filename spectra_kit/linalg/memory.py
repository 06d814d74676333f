"""How much memory a sparse factor takes, before there is one."""

from __future__ import annotations

import numpy as np


def factor_gigabytes(n: int) -> float:
    """Estimate what a complete factor takes on n points of a surface, in GiB.

    Up to ``4 n log2 n`` entries of 8 bytes, as on meshes of even triangles (1.1 to 3.7 on 15 real
    ones), and half as much again while it is made. `Elimination.gigabytes` counts.
    """
    return 1.5 * 8 * 4 * n * float(np.log2(max(n, 2))) / 2**30
