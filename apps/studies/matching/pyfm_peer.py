"""Match two meshes with pyFM as its own documentation does; a program for a process of its own.

``python pyfm_peer.py IN.npz OUT.npz``: IN holds V1, F1, V2, F2 and k, the modes of the spectra; OUT
gets the point map (n2,), the seconds of the matching and those of the spectra. It imports nothing
of this package, so that pyFM may live in another environment.
"""

from __future__ import annotations

import sys
import time

_DESCRIBED = 128  # modes of its signatures, where nothing else is said


def main() -> None:
    """Read, match, write."""
    import numpy as np
    from pyFM.functional import FunctionalMapping  # type: ignore[import-not-found]
    from pyFM.mesh import TriMesh  # type: ignore[import-not-found]

    with np.load(sys.argv[1]) as file:
        arrays = dict(file.items())
    meshes = [
        TriMesh(arrays[f"V{i}"], arrays[f"F{i}"], area_normalize=True, center=True) for i in (1, 2)
    ]
    start = time.perf_counter()
    k = max(int(arrays["k"]), _DESCRIBED)  # fewer, and it would solve again, while it is timed
    for mesh in meshes:
        mesh.process(k)
    solved, cpu = time.perf_counter(), time.process_time()
    model = FunctionalMapping(*meshes)
    # The quick start of its README, version 1.3.1, letter by letter: 30 modes fitted to wave kernel
    # signatures with orientation, ZoomOut to 110.
    model.preprocess(descr_type="WKS", subsample_step=2, k_process=k)
    model.fit(K=30, w_descr=1e0, w_lap=1e-1, w_dcomm=1e0, w_orient=1e0)
    point_map = model.get_p2p(model.zoomout_refine(nit=16, step=5))
    np.savez(
        sys.argv[2],
        point_map=point_map,
        seconds=time.perf_counter() - solved,
        cpu_seconds=time.process_time() - cpu,
        solve_seconds=solved - start,
    )


if __name__ == "__main__":
    main()
