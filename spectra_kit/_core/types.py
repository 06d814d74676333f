"""Arrays by what they hold, as annotations name them."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Reals = NDArray[np.float64] | NDArray[np.float32]
Ints = NDArray[np.int64]
Ints32 = NDArray[np.int32]
Indices = NDArray[np.int32] | NDArray[np.int64]  # of sparse matrices
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]
