"""What computes nothing with torch neither imports nor needs it."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CLASSICAL = """
import sys
sys.modules["torch"] = None  # to import it raises
import numpy as np
import spectra_kit as sk
from spectra_kit.cli.entry import main
from spectra_kit.datasets import Plan, SpectrumStore
from spectra_kit.geometry import creature, rectangle
from spectra_kit.maps import zoomout

sk.features.heat_kernel_signature
pose, other = creature(600, seed=0), creature(520, seed=0, pose=1)
laplacian = sk.robust_laplacian(pose)
exact = sk.eigensolve(laplacian, 12, sk.Dense())
solvers = [
    sk.Arpack(), sk.Refined(), sk.Automatic(), sk.Cascade(coarsest=150),
    sk.RayleighRitz(subspace=sk.eigen.subspaces.AmbientFourier(m=200)),
]
for solver in solvers:
    found = sk.eigensolve(laplacian, 12, solver)
    assert np.abs(found.eigenvalues[1:] / exact.eigenvalues[1:] - 1).mean() < 0.05, solver
plane = sk.robust_laplacian(rectangle(n=16_500).geometry)
rough = sk.Automatic(accuracy=1e-2, memory=1e-3)  # GiB, so without a factor
assert sk.eigensolve(plane, 12, rough).provenance.name == "cascade"
sk.HeatGeodesics(pose, exact).distance(0)
sides = [sk.prepare(sk.spectrum(mesh, 40), mesh) for mesh in (pose, other)]
found = sk.match(*sides, options=sk.maps.MatchOptions(growing=16, finalists=3, rounds=1))
spectra = [sk.spectrum(mesh, 30) for mesh in (pose, other)]
zoomout(*spectra, found.point_map, k_final=30)
SpectrumStore(sys.argv[1] + "/store").spectrum(pose, Plan(k=12))
sys.exit(main(["modes", "demo", "--points", "600", "-k", "6", "-o", sys.argv[1] + "/modes.png"]))
"""


def test_the_classical_half_runs_without_torch(tmp_path) -> None:
    """Every exact and every weight-free solver, distances, maps, the store, the command line."""
    command = [sys.executable, "-W", "ignore", "-c", CLASSICAL, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode == 2 and "OpenGL" in done.stderr:
        pytest.skip("no OpenGL library on this machine")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "modes.png").exists()
