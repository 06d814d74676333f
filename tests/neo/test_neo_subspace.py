"""`NeoSubspace`: a random network must already obey the laws; the shipped one must be itself."""

import numpy as np
import pytest
import torch
from conftest import creature, refused

from spectra_kit.eigen import Cascade, Neo, RayleighRitz, eigensolve
from spectra_kit.eigen.subspaces.frame import POSES
from spectra_kit.errors import WeightsError
from spectra_kit.geometry import PointCloud
from spectra_kit.neo import NeoConfig, NeoNetwork, NeoSubspace, save_weights
from spectra_kit.neo.pretrained import weights_digest
from spectra_kit.operators import robust_laplacian

SIZES = {"width": 40, "depth": 2, "heads": 2, "head_width": 16, "latents": 8, "m": 24, "k": 8}


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    return NeoNetwork(NeoConfig(**SIZES))


@pytest.fixture(scope="module")
def laplacian():
    """Of a cloud without symmetry: a bent, bumpy ellipsoid of 400 points."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((400, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    x = x * (1 + 0.3 * np.sin(2 * x[:, [0]]) + 0.1 * x[:, [1]]) * [3, 2, 1]
    x[:, 2] += 0.1 * x[:, 0] ** 2 + 0.05 * x[:, 0] * x[:, 1]
    return robust_laplacian(PointCloud(x))


def rotation(seed):
    Q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return Q * np.linalg.det(Q)


def span_distance(A, B, mass):
    """Largest sine between the span of A and that of B."""
    root = np.sqrt(mass)[:, None]
    A, B = (np.linalg.qr(root * X)[0] for X in (A.astype(float), B.astype(float)))
    return np.linalg.norm(A - B @ (B.T @ A), ord=2)


@pytest.fixture(scope="module")
def expected(network, laplacian):
    """The basis of one pose."""
    return NeoSubspace(network)(laplacian.points, laplacian.mass)


def test_shape_and_constant(network, laplacian, expected):
    assert (expected.shape, expected.dtype) == ((400, 25), np.float32)
    np.testing.assert_array_equal(expected[:, 0], 1.0)
    tensor = NeoSubspace(network, poses=2).tensor(laplacian.points, laplacian.mass)
    assert tensor.shape == (400, NeoSubspace(network, poses=2).n_functions) == (400, 49)
    np.testing.assert_allclose(tensor[:, :25].numpy(), expected, atol=1e-5)


@pytest.mark.parametrize("size", [1e-3, 1e6])
def test_motion_and_unit_of_the_cloud_do_not_matter(network, laplacian, expected, size):
    moved = size * (laplacian.points @ rotation(1).T + [5, -3, 1])
    basis = NeoSubspace(network)(moved, size**2 * laplacian.mass)
    np.testing.assert_allclose(basis, expected, atol=1e-4)


def test_without_a_frame_only_place_and_unit_do_not_matter(laplacian):
    torch.manual_seed(0)
    subspace = NeoSubspace(NeoNetwork(NeoConfig(**SIZES, frame="none")))
    points, mass = laplacian.points, laplacian.mass
    basis = subspace(points, mass)
    np.testing.assert_allclose(subspace(1e3 * points + 7, mass), basis, atol=1e-4)
    assert np.abs(subspace(points @ rotation(1).T, mass) - basis).max() > 1e-2


def test_four_poses_predict_the_same_set_in_every_flip_of_the_frame(network, laplacian, expected):
    points, mass = laplacian.points, laplacian.mass
    subspace = NeoSubspace(network, poses=4)
    basis = subspace(points, mass)[:, 1:].reshape(400, 4, 24)
    np.testing.assert_allclose(basis[:, 0], expected[:, 1:], atol=1e-5)
    frame = subspace.frame(points, mass)
    flipped = frame._replace(rotation=frame.rotation * POSES[2])
    again = subspace.predict(points, mass, flipped).numpy()[:, 1:].reshape(400, 4, 24)
    np.testing.assert_allclose(again, basis[:, [2, 3, 0, 1]], atol=1e-4)


def test_chunks_and_precisions_agree(network, laplacian):
    points, mass = laplacian.points, laplacian.mass
    basis = NeoSubspace(network, poses=2)(points, mass)
    chunked = NeoSubspace(network, poses=2, chunk=150)(points, mass)
    np.testing.assert_allclose(chunked, basis, atol=1e-5)
    for dtype, error in (("float16", 0.02), ("bfloat16", 0.15)):
        half = NeoSubspace(network, poses=2, dtype=dtype)(points, mass)
        assert half.dtype == np.float32
        assert np.abs(half - basis).max() < error * np.abs(basis).max()
    assert next(network.parameters()).dtype == torch.float32


@pytest.mark.parametrize(
    "options", [{}, {"mass_aware": False}, {"frame": "none"}], ids=["", "no mass", "no frame"]
)
def test_clouds_predicted_together_are_predicted_as_alone(laplacian, options):
    torch.manual_seed(0)
    subspace = NeoSubspace(NeoNetwork(NeoConfig(**SIZES, **options)), poses=2)
    some = [slice(0, 400), slice(0, 250), slice(100, 397)]
    points, mass = ([array[part] for part in some] for array in (laplacian.points, laplacian.mass))
    together = subspace.predict_many(points, mass)
    assert [tuple(basis.shape) for basis in together] == [(400, 49), (250, 49), (297, 49)]
    for basis, x, w in zip(together, points, mass, strict=True):
        np.testing.assert_allclose(basis.numpy(), subspace(x, w), atol=1e-5)
    assert subspace.predict_many([], []) == []


def test_a_file_is_read_once_and_again_when_it_has_changed(tmp_path, laplacian):
    path, bases = tmp_path / "mine.safetensors", []
    for seed in (0, 1):
        torch.manual_seed(seed)
        save_weights(path, NeoNetwork(NeoConfig(**SIZES)), {})
        one, same = NeoSubspace(path), NeoSubspace(path)
        bases.append(one(laplacian.points, laplacian.mass))
        np.testing.assert_array_equal(same(laplacian.points, laplacian.mass), bases[-1])
        assert one._model is same._model
    assert np.abs(bases[1] - bases[0]).max() > 0.1


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_the_shipped_network_gains_from_a_cap():
    laplacian = robust_laplacian(creature(1300, seed=1))
    exact = eigensolve(laplacian, 64).eigenvalues[1:]

    def error(solver):
        return (eigensolve(laplacian, 64, solver).eigenvalues[1:] / exact - 1).mean()

    raw, capped = (error(Neo(coarsest=cap, max_steps=0)) for cap in (None, 600))
    assert 0 < error(Neo(coarsest=600)) < 0.2 * min(raw, capped)
    assert 0 < error(Neo()) < 0.2 * raw


@pytest.mark.parametrize("device", ["cpu"] + ["cuda"] * torch.cuda.is_available())
def test_a_prediction_is_refined_where_it_was_made(device):
    laplacian = robust_laplacian(creature(1500, seed=2))
    exact = eigensolve(laplacian, 40).eigenvalues
    solver = Cascade(
        subspace=Neo(device=device).subspace, device=device, target=1e-11, max_steps=60
    )
    refined = eigensolve(laplacian, 40, solver)
    assert np.abs(refined.eigenvalues[1:] / exact[1:] - 1).mean() < 1e-11
    assert {"subspace", "smooth"} <= set(refined.provenance.seconds)


def test_the_zero_mode_is_exact_and_eigenvalues_scale(network, laplacian):
    solver = RayleighRitz(subspace=NeoSubspace(network))
    values = solver.eigenpairs(laplacian, 8).eigenvalues
    assert abs(values[0]) < 1e-12 * values[-1]
    scaled = robust_laplacian(PointCloud(1000 * laplacian.points))
    again = solver.eigenpairs(scaled, 8).eigenvalues
    np.testing.assert_allclose(1e6 * again[1:], values[1:], rtol=1e-4)


def test_repr_tells_weights_and_options(network, tmp_path):
    path = tmp_path / "mine.safetensors"
    digest = save_weights(path, network, {})
    text = repr(NeoSubspace(str(path), poses=2))
    assert text == (
        f"NeoSubspace({str(path)!r}, poses=2, dtype='float32', device='cpu',"
        f" sha256={digest[:12]!r})"
    )
    given = repr(NeoSubspace(network))
    assert given.startswith("NeoSubspace(<NeoNetwork>")
    assert weights_digest(network) in given
    assert "coarsest=2048, max_steps=20" in repr(Neo(coarsest=2048))
    assert "coarsest" not in repr(Neo())


def test_what_cannot_be_done_is_refused(network, laplacian):
    for argument, expected, call, options in (
        ("poses", "be 1, 2 or 4, got 3", NeoSubspace, {"poses": 3}),
        ("dtype", "be 'float32', ", NeoSubspace, {"dtype": "int8"}),
        ("chunk", "be at least 1", NeoSubspace, {"chunk": 0}),
        ("coarsest", "be at least 100, got 0", Neo, {"coarsest": 0}),
        ("max_steps", "be at least 0", Neo, {"max_steps": -1}),
    ):
        refused(argument, expected, call, **options)
    points, mass = laplacian.points, laplacian.mass
    subspace = NeoSubspace(network)
    refused("points", "be as many as `mass`, 1", subspace.predict_many, [points, points], [mass])
    refused("mass", "have shape (400,)", subspace.predict_many, [points, points], [mass, mass[1:]])
    with pytest.raises(WeightsError, match="must be one of"):
        NeoSubspace("huge")


def test_a_device_may_be_torchs_own():
    assert Neo(device=torch.device("cpu")) == Neo(device="cpu")
