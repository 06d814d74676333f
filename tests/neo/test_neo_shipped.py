"""The weights inside the package: they are the ones that were trained, and they are worth it."""

from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import creature
from safetensors.torch import load_file

from spectra_kit import eigensolve, robust_laplacian
from spectra_kit._sparse import orthonormalize
from spectra_kit.eigen.neo import Neo
from spectra_kit.eigen.subspaces import AmbientFourier
from spectra_kit.neo import WEIGHTS, NeoSubspace, load_pretrained

HERE = Path(__file__).parent


@pytest.mark.parametrize("name", sorted(WEIGHTS))
def test_the_file_is_the_one_that_was_trained(name):
    file, digest = WEIGHTS[name]
    golden = load_file(HERE / "golden" / file)
    loaded = load_pretrained(name)
    assert loaded.sha256 == digest
    with torch.no_grad():
        basis = loaded.network(golden["points"][None], golden["mass"][None])[0]
    torch.testing.assert_close(basis, golden["basis"], rtol=1e-3, atol=1e-4)
    assert loaded.record["samples"] > 10_000
    assert loaded.record["minutes"] > 1
    errors = [row["validation"] for row in loaded.record["history"]]
    # After a leg the last row is of the weights as shipped, the others of those in training.
    assert loaded.record["span_error"] == errors[-1] <= 1.05 * min(errors)
    assert (HERE.parents[1] / "spectra_kit/neo/weights" / file).stat().st_size < 12e6


@pytest.fixture(scope="module")
def exact():
    """A creature that no training saw, with its exact spectrum."""
    laplacian = robust_laplacian(creature(2500, seed=123))
    return laplacian, eigensolve(laplacian, 96)


@pytest.fixture(scope="module")
def joined(exact):
    """The subspace that the network predicts for the creature in four poses."""
    laplacian, _ = exact
    return NeoSubspace("small", poses=4)(laplacian.points, laplacian.mass)


def span_error(basis, spectrum):
    Y = orthonormalize(basis, spectrum.mass)
    return 1 - np.square(Y.T @ (spectrum.mass[:, None] * spectrum.eigenvectors)).sum(0).mean()


def test_small_covers_the_low_modes_better_than_as_many_functions_without_training(exact, joined):
    laplacian, spectrum = exact
    one = joined[:, :257]
    assert span_error(one, spectrum) < 0.004
    assert span_error(joined, spectrum) < 2e-4
    errors = [
        span_error(
            AmbientFourier(m=257, bandwidth=width)(laplacian.points, laplacian.mass), spectrum
        )
        for width in (5.0, 7.0)
    ]
    assert span_error(one, spectrum) < min(errors) / 3


def test_eigenvalues_of_the_solver(exact):
    laplacian, spectrum = exact
    predicted = eigensolve(laplacian, 48, Neo(weights="small", poses=4))
    relative = predicted.eigenvalues[1:] / spectrum.eigenvalues[1:48] - 1
    assert relative.min() > -1e-9
    assert relative.mean() < 0.0015  # two poses alone: 0.0021
