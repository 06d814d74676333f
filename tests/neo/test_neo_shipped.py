"""The weights inside the package: they are the ones that were trained, and they are worth it."""

from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import creature
from safetensors.torch import load_file

from spectra_kit import RayleighRitz, eigensolve, robust_laplacian
from spectra_kit.eigensolvers.neo import Neo
from spectra_kit.linalg import orthonormalize
from spectra_kit.neo import WEIGHTS, NeoSubspace, load_pretrained
from spectra_kit.subspaces import AmbientFourier

GOLDEN = Path(__file__).parent / "golden"


@pytest.mark.parametrize("name", sorted(WEIGHTS))
def test_golden_tensors(name):
    file, digest = WEIGHTS[name]
    golden = load_file(GOLDEN / file)
    loaded = load_pretrained(name)
    assert loaded.sha256 == digest
    with torch.no_grad():
        basis = loaded.network(golden["points"][None], golden["mass"][None])[0]
    torch.testing.assert_close(basis, golden["basis"], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", sorted(WEIGHTS))
def test_a_weights_file_tells_how_it_was_trained(name):
    record = load_pretrained(name).record
    assert record["samples"] > 10_000
    assert record["minutes"] > 1
    errors = [row["validation"] for row in record["history"]]
    # After a leg the last row is of the weights as shipped, the others of those in training.
    assert record["span_error"] == errors[-1] <= 1.05 * min(errors)
    path = Path(str(Path(__file__).parents[2] / "spectra_kit/neo/weights" / WEIGHTS[name][0]))
    assert path.stat().st_size < 12e6


@pytest.fixture(scope="module")
def exact():
    """A creature that no training saw, with its exact spectrum."""
    laplacian = robust_laplacian(creature(4000, seed=123))
    return laplacian, eigensolve(laplacian, 96)


def span_error(basis, spectrum):
    Y = orthonormalize(basis, spectrum.mass)
    return 1 - np.square(Y.T @ (spectrum.mass[:, None] * spectrum.eigenvectors)).sum(0).mean()


@pytest.fixture(scope="module")
def bases(exact):
    """The subspaces that the network predicts for the creature, of one pose and of four."""
    laplacian, _ = exact
    return tuple(
        NeoSubspace("small", poses=poses)(laplacian.points, laplacian.mass) for poses in (1, 4)
    )


def test_small_covers_the_low_modes_of_an_unseen_creature(exact, bases):
    assert bases[0].shape[1] == 257
    one, joined = (span_error(basis, exact[1]) for basis in bases)
    assert one < 0.004
    assert joined < 2e-4


def test_small_beats_training_free_functions_of_the_same_number(exact, bases):
    laplacian, spectrum = exact
    errors = [
        span_error(
            AmbientFourier(m=257, bandwidth=width)(laplacian.points, laplacian.mass), spectrum
        )
        for width in (3.0, 5.0, 7.0, 10.0)
    ]
    assert span_error(bases[0], spectrum) < min(errors) / 3


def test_eigenvalues_of_the_solver(exact, bases):
    laplacian, spectrum = exact
    predicted = eigensolve(laplacian, 48, Neo(weights="small", poses=4))
    relative = predicted.eigenvalues[1:] / spectrum.eigenvalues[1:48] - 1
    assert relative.min() > -1e-9
    assert relative.mean() < 0.004
    twin = eigensolve(laplacian, 48, RayleighRitz(subspace=lambda points, mass: bases[1]))
    np.testing.assert_allclose(predicted.eigenvalues, twin.eigenvalues, rtol=1e-6, atol=1e-8)
