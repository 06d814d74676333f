"""Want of memory, with a real limit on it: a clear error, and what was solved before is kept."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from spectra_kit import eigensolve
from spectra_kit.errors import OutOfMemoryError

STARVED = """
import json, resource, sys
import numpy as np
from scipy import sparse
from spectra_kit import Laplacian, Refined, eigensolve, robust_laplacian
from spectra_kit.errors import OutOfMemoryError
from spectra_kit.geometry import sphere

small = robust_laplacian(sphere(subdivisions=3).geometry)
side = 30  # of a cube of points, whose factor fills up
path = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(side, side))
square = sparse.kron(path, sparse.eye_array(side)) + sparse.kron(sparse.eye_array(side), path)
cube = sparse.kron(square, sparse.eye_array(side)) + sparse.kron(sparse.eye_array(side**2), path)
grid = np.stack(np.meshgrid(*[np.arange(side)] * 3), axis=-1).reshape(-1, 3)
laplacian = Laplacian(
    sparse.csr_array(sparse.block_diag([small.stiffness, cube])),
    np.append(small.mass, np.full(side**3, small.area / side**3)),
    np.vstack([small.points, grid + 9.0]),
)
eigensolve(small, 30, Refined())  # imports, compiles
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + int(sys.argv[1]) * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
try:
    eigensolve(laplacian, 30, Refined())
except OutOfMemoryError as error:
    partial = error.partial
    print(json.dumps({
        "message": str(error),
        "eigenvalues": partial.eigenvalues.tolist(),
        "residual": partial.certificate.relative_residuals.max(),
        "outside": float(abs(partial.eigenvectors[small.n :]).max()),
        "iterations": partial.provenance.iterations,
    }))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="counts memory as Linux does")
def test_components_solved_before_are_kept() -> None:
    done = subprocess.run(
        [sys.executable, "-c", STARVED, "50"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert "30 modes on 27642 points do not fit into memory" in record["message"]
    assert "such as Cascade()" in record["message"]
    shells = np.repeat([l * (l + 1) for l in range(6)], [2 * l + 1 for l in range(6)])
    found = np.array(record["eigenvalues"])
    assert 15 < len(found) <= 30
    np.testing.assert_allclose(found, shells[: len(found)], rtol=3e-2, atol=1e-9)
    assert record["residual"] <= 1e-8
    assert record["outside"] == 0
    assert record["iterations"] > 0


def test_without_a_component_solved_there_is_nothing_to_keep(bumpy_laplacian) -> None:
    class Greedy:
        def eigenpairs(self, laplacian, k):
            return np.empty(1 << 44), None

    with pytest.raises(OutOfMemoryError, match="5 modes on 642 points do not fit") as caught:
        eigensolve(bumpy_laplacian, 5, Greedy())
    assert caught.value.partial is None


SMALL_ROOM = """
import resource
from spectra_kit import delaunay_laplacian, robust_laplacian
from spectra_kit.errors import OutOfMemoryError
from spectra_kit.geometry import sphere

delaunay_laplacian(sphere(subdivisions=2).geometry)  # imports, compiles
mesh = sphere(subdivisions=6).geometry
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + 150 * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
try:
    robust_laplacian(mesh)
except OutOfMemoryError as error:
    print(error)
print(delaunay_laplacian(mesh).area / mesh.area)
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="counts memory as Linux does")
def test_the_library_is_not_asked_where_it_would_end_the_process() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SMALL_ROOM], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    of_mesh, ratio = done.stdout.splitlines()
    assert "robust_laplacian needs up to 0.2 GB, more than there is; use delaunay" in of_mesh
    assert float(ratio) == pytest.approx(1, rel=1e-12)
