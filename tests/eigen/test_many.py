"""Many at once: what single calls return, however they are put together."""

import pickle
from functools import cache

import numpy as np
import pytest
import torch
from conftest import GEOMETRIES, creature, data_folder, joined, laplacian_of, moved
from launches import Launches

import spectra_kit as sk
from spectra_kit import Neo, eigensolve, eigensolve_many, robust_laplacian
from spectra_kit._core.clock import Clock
from spectra_kit._sparse import batched_eigh
from spectra_kit._sparse.ritz import ritz_pairs
from spectra_kit._sparse.torch_device import csr_tensor
from spectra_kit.eigen.base import block_size
from spectra_kit.eigen.multigrid import batched
from spectra_kit.eigen.multigrid.batched import predicted_and_smoothed
from spectra_kit.eigen.multigrid.cascade import prolonged
from spectra_kit.eigen.solve import _groups
from spectra_kit.errors import DoubtfulSpectrumWarning, InvalidInputError, SpectraKitError
from spectra_kit.geometry import rectangle, sample, sphere, torus
from spectra_kit.neo.train.pool import open_pool

K = 24
# What padding and other shapes of products change: rounding of a float32 network, in functions
# that are then smoothed. Of eight real clouds of 2,048 points no eigenvalue differed by over 5e-8.
ROUNDING = 1e-6


@cache
def bodies() -> tuple[sk.Laplacian, ...]:
    """Bodies of several sizes, no two alike; the last is small enough to be solved exactly."""
    return tuple(
        robust_laplacian(creature(n, seed=seed))
        for seed, n in enumerate((900, 1100, 640, 1020, 505))
    )


def pair() -> sk.Laplacian:
    """Two components."""
    return robust_laplacian(joined(creature(600, seed=5), moved(creature(550, seed=6), 9, 0, 0)))


@cache
def alone(i: int) -> sk.Spectrum:
    """Of the body with this number, by a call of its own."""
    return eigensolve(bodies()[i], K, Neo())


def assert_same(found: sk.Spectrum, single: sk.Spectrum, rtol: float = ROUNDING) -> None:
    """The same eigenvalues, and the same span of the modes below a gap."""
    zero = single.n_zero_modes
    assert found.n_zero_modes == zero
    np.testing.assert_allclose(
        found.eigenvalues[zero:], single.eigenvalues[zero:], rtol=rtol, atol=0
    )
    k = zero + int(np.argmax(np.diff(single.eigenvalues[zero:]))) + 1
    both = found.eigenvectors[:, :k].T @ (single.mass[:, None] * single.eigenvectors[:, :k])
    angles = np.arccos(np.clip(np.linalg.svd(both, compute_uv=False), 0, 1))
    assert angles.max() < 1e3 * rtol  # eigenvalues err by the square of what their modes do


@pytest.mark.parametrize("batch", [1, 2500])
def test_spectra_are_those_of_single_calls_in_the_order_given(batch):
    found = eigensolve_many(bodies(), K, Neo(), batch=batch)
    assert [spectrum.n for spectrum in found] == [shape.n for shape in bodies()]
    for i, spectrum in enumerate(found):
        single = alone(i)
        assert_same(spectrum, single)
        ours, theirs = spectrum.provenance, single.provenance
        for name in ("solver", "name", "input_hash", "accuracy", "iterations", "version"):
            assert getattr(ours, name) == getattr(theirs, name)
        assert set(ours.seconds) == set(theirs.seconds)
        assert spectrum.certificate.orthonormality_error < 1e-10
        np.testing.assert_allclose(
            spectrum.certificate.residuals, single.certificate.residuals, rtol=1e-3, atol=1e-6
        )


def test_another_order_changes_rounding_alone():
    order = [3, 0, 4, 2, 1]
    turned = eigensolve_many([bodies()[i] for i in order], K, Neo())
    for i, spectrum in zip(order, turned, strict=True):
        assert_same(spectrum, alone(i))


@pytest.fixture
def torch_in_two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_the_number_of_threads_changes_no_bit(monkeypatch, torch_in_two_threads):
    found = []
    for threads in ("1", "3"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        found.append(eigensolve_many(bodies()[2:], K, Neo(), batch=1100))
        assert torch.get_num_threads() == 2
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one.eigenvalues, other.eigenvalues)
        np.testing.assert_array_equal(one.eigenvectors, other.eigenvectors)


def test_what_cannot_share_a_pass_is_solved_beside_the_others():
    huge = bodies()[0]
    huge = robust_laplacian(creature(900, seed=0).with_points(1e12 * huge.points))
    cut = bodies()[1].dirichlet(np.arange(50))
    beside = [pair(), cut, huge]
    first, *others, last = eigensolve_many([bodies()[0], *beside, bodies()[3]], K, Neo())
    assert_same(first, alone(0))
    assert_same(last, alone(3))
    for spectrum, shape in zip(others, beside, strict=True):
        assert_same(spectrum, eigensolve(shape, K, Neo()))


@pytest.mark.parametrize(
    "solver",
    [Neo(coarsest=300), Neo(max_steps=0), Neo(poses=2, chunk=700)],
    ids=["coarsest", "raw", "poses"],
)
@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_every_option_of_the_solver_holds(solver):
    for spectrum, shape in zip(eigensolve_many(bodies()[:2], K, solver), bodies(), strict=False):
        assert_same(spectrum, eigensolve(shape, K, solver), 1e-4 if not solver.max_steps else 1e-6)


@pytest.mark.parametrize("solver", [sk.Arpack(), sk.Automatic(), sk.Dense()], ids=str)
def test_a_solver_that_takes_one_after_the_other_gives_the_same_bits(solver):
    shapes = [laplacian_of(name) for name in GEOMETRIES]
    for spectrum, shape in zip(eigensolve_many(shapes, 7, solver), shapes, strict=True):
        single = eigensolve(shape, 7, solver)
        np.testing.assert_array_equal(spectrum.eigenvalues, single.eigenvalues)
        np.testing.assert_array_equal(spectrum.eigenvectors, single.eigenvectors)


def test_of_none_there_are_none():
    assert eigensolve_many([], 5) == eigensolve_many([], 5, Neo()) == []


def test_batches_are_of_similar_size_and_of_no_more_points_than_allowed():
    shapes = [*bodies(), pair()]
    for batch in (1, 2300, 10_000):
        groups = _groups(shapes, batch)
        assert sorted(i for group in groups for i in group) == list(range(len(shapes)))
        for group in groups:
            sizes = [shapes[i].n for i in group]
            assert min(sizes) >= 0.8 * max(sizes)
            assert len(group) == 1 or len(group) * max(sizes) <= batch
            assert len(group) == 1 or 5 not in group  # the one with two components
    assert len(_groups(bodies(), 10_000)) < len(bodies())


class Shy(sk.Dense):
    """Fails where it is given several at once."""

    def begin(self, laplacians, k):
        raise MemoryError


def test_what_fails_together_is_tried_apart():
    found = eigensolve_many(bodies()[2:], 9, Shy())
    for spectrum, shape in zip(found, bodies()[2:], strict=True):
        np.testing.assert_array_equal(
            spectrum.eigenvalues, eigensolve(shape, 9, sk.Dense()).eigenvalues
        )


def one_place() -> sk.Laplacian:
    """A good operator whose points say nothing."""
    shape = bodies()[3]
    return sk.Laplacian(shape.stiffness, shape.mass, np.zeros((shape.n, 3)))


def few(laplacians: list[sk.Laplacian], k: int = K) -> list[sk.Spectrum]:
    return eigensolve_many(
        laplacians, k, sk.RayleighRitz(subspace=sk.eigen.subspaces.AmbientFourier(m=12))
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: eigensolve_many([bodies()[0], bodies()[4]], 600, Neo()),
            r"laplacians\[1\]: `k` must be at most the number of free points, ",
        ),
        (
            lambda: eigensolve_many([bodies()[3], one_place(), bodies()[0]], K, Neo()),
            r"laplacians\[1\]: `points` must not share one location",
        ),
        (lambda: few([bodies()[0], bodies()[1]], 30), r"laplacians\[0\]: `basis` must span"),
    ],
)
def test_an_error_says_which_one_it_is_about(call, message):
    with pytest.raises(InvalidInputError, match=message) as caught:
        call()
    assert caught.value.where == message[: message.index(":")].replace("\\", "")


def test_a_warning_says_which_one_it_is_about():
    waves = sk.RayleighRitz(subspace=sk.eigen.subspaces.AmbientFourier(m=40))
    with pytest.warns(DoubtfulSpectrumWarning) as caught:
        eigensolve_many(bodies()[:2], K, waves)
    assert [str(one.message).partition(":")[0] for one in caught] == [
        "laplacians[0]",
        "laplacians[1]",
    ]
    assert {one.filename for one in caught} == {__file__}
    with pytest.warns(DoubtfulSpectrumWarning) as alone:
        eigensolve(bodies()[0], K, waves)
    assert str(caught[0].message) == f"laplacians[0]: {alone[0].message}"


def test_where_is_kept_by_pickle():
    error = InvalidInputError("k", "be positive", 0)
    error.where = "laplacians[2]"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert isinstance(error, SpectraKitError)


# --- one batch on a device: "cpu" alone means arrays ------------------------------------------


def hard() -> list[sk.Laplacian]:
    """Of similar size: flat, round, a ring, thin, as many modes as a third of its points."""
    ball = sphere(subdivisions=3).geometry
    clouds = [rectangle(n=650).geometry, ball, torus(n=700).geometry.as_cloud()]
    thin = ball.with_points(ball.points * [20.0, 1.0, 0.05])
    return [sk.laplacian(shape) for shape in (*clouds, thin, creature(620, seed=2))]


@pytest.mark.parametrize(
    ("shapes", "k", "target", "steps"),
    [
        (lambda: bodies()[:4], K, 1e-3, [1, 1, 1, 1]),
        (lambda: bodies()[:4], K, np.inf, [0, 0, 0, 0]),
        (hard, K, 1e-6, [2, 2, 2, 4, 2]),
        (hard, 200, 1e-3, [3, 2, 3, None, 3]),  # smoothed, those of the thin one are dependent
    ],
    ids=["bodies", "raw", "hard", "many modes"],
)
def test_a_batch_on_a_device_is_as_its_parts(shapes, k, target, steps, monkeypatch):
    """Of the same functions, all but the rounding of a float32 smoother is the same."""
    monkeypatch.setattr(batched_eigh, "_on_host", lambda A: False)
    monkeypatch.setattr(batched_eigh, "_FEW", 2)
    operators, subspace = shapes(), Neo(device="cpu:0").subspace
    basis = subspace._padded([s.points for s in operators], [s.mass for s in operators])
    options = {"keep": block_size(k, 0.2), "target": target, "max_steps": 20 if steps[0] else 0}
    found = predicted_and_smoothed(operators, basis, k, clock=Clock(), **options)
    assert [own and own.steps for own in found] == steps
    for shape, own, functions in zip(operators, found, basis, strict=True):
        if own is None:
            continue
        L, M = csr_tensor(shape.stiffness), torch.tensor(shape.mass)
        begun = ritz_pairs(L, M, functions[: shape.n], options["keep"])[:2]
        single = prolonged(shape, [], *begun, k, device="cpu:0", **options)
        assert own.steps == single.steps
        U, values, size = own.eigenvectors, own.eigenvalues, single.eigenvalues[-1]
        assert values == pytest.approx(single.eigenvalues, rel=1e-8, abs=1e-12 * size)
        assert own.errors == pytest.approx(single.errors, rel=0.02, abs=1e-9)
        assert np.abs(U.T @ (shape.mass[:, None] * U) - np.eye(k)).max() < 1e-10
        quotients = U.T @ (shape.stiffness @ U) - np.diag(values[:k])
        assert np.abs(quotients).max() < 1e-10 * size


def test_launches_and_waits_do_not_grow_with_a_batch():
    shapes, neo, counts = bodies()[:3], Neo(device="cpu:0"), []
    for times in (1, 3):
        some = [shape for shape in shapes for _ in range(times)]
        basis = neo.subspace._padded([s.points for s in some], [s.mass for s in some])
        options = {"keep": 40, "target": 1e-3, "max_steps": 1, "clock": Clock()}
        with Launches() as launches:
            found = predicted_and_smoothed(some, basis, K, **options)
        assert all(one.steps == 1 for one in found)
        counts.append((len(launches.names), launches.waits("_local_scalar_dense")))
    assert counts[0] == counts[1]
    assert counts[0][1] == 2


def test_what_a_batch_cannot_hold_is_left_to_those_that_take_one(monkeypatch):
    """Functions of which two are all but the same, for one of the operators."""
    shapes, neo = bodies()[1::-1], Neo(device="cpu:0")  # the largest first
    basis = neo.subspace._padded([s.points for s in shapes], [s.mass for s in shapes])
    basis[1, :, 7] = basis[1, :, 9] * (1 + 1e-7 * torch.rand(basis.shape[1]))
    options = {"keep": 40, "target": 1e-3, "max_steps": 5, "clock": Clock()}
    good, bad = predicted_and_smoothed(shapes, basis, K, **options)
    assert good is not None
    assert bad is None
    alone = [eigensolve(shape, K, neo) for shape in shapes]
    monkeypatch.setattr(type(neo.subspace), "_padded", lambda self, points, mass: basis)
    for single, found in zip(alone, eigensolve_many(shapes, K, neo, batch=9999), strict=True):
        assert_same(found, single)


def test_a_single_cloud_on_a_device_is_a_batch_of_one():
    neo = Neo(device="cpu:0")
    found = eigensolve(bodies()[2], K, neo)
    assert_same(found, alone(2))
    assert found.provenance.iterations == alone(2).provenance.iterations
    assert found.certificate.errors == pytest.approx(alone(2).certificate.errors, rel=0.05)
    assert "coarsen" not in found.provenance.seconds  # another order of the points gains nothing


def test_a_batch_is_of_lumped_masses_alone():
    consistent = sk.laplacian(creature(700, seed=3), mass="consistent")
    neo = Neo(device="cpu:0")
    found = eigensolve_many([bodies()[2], consistent], K, neo)
    assert_same(found[0], alone(2))
    assert_same(found[1], eigensolve(consistent, K, Neo()))


def test_spacings_of_a_batch_keep_their_digits():
    some = bodies()[:2]
    spacing = batched.Batch.of(some, "cpu").spacing[:, 0]
    assert spacing.tolist() == [one.eigenvalue_spacing for one in some]


@pytest.mark.parametrize("k", [220, 258])
@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_as_many_modes_as_functions(monkeypatch, k):
    """Guards are what is left of them; more modes than functions are refused as on the host."""
    monkeypatch.setattr(batched_eigh, "_on_host", lambda A: False)
    monkeypatch.setattr(batched_eigh, "_FEW", 2)
    neo = Neo(device="cpu:0", max_steps=1)
    if k > neo.subspace.n_functions:
        with pytest.raises(InvalidInputError, match="must span at least k"):
            eigensolve_many(bodies()[:2], k, neo)
        return
    for i, found in enumerate(eigensolve_many(bodies()[:2], k, neo)):
        single = eigensolve(bodies()[i], k, Neo(max_steps=1))
        np.testing.assert_allclose(found.eigenvalues[1:], single.eigenvalues[1:], rtol=1e-3)


def test_an_eigenproblem_that_is_not_solved_right_is_left_to_others(monkeypatch):
    whole = batched.eigh

    def one_wrong(A, keep):
        values, vectors, right = whole(A, keep)
        return values, vectors, right & (torch.arange(len(A)) != (1 if len(A) == 3 else -1))

    monkeypatch.setattr(batched, "eigh", one_wrong)
    shapes, neo = bodies()[:3], Neo(device="cpu:0")
    basis = neo.subspace._padded([s.points for s in shapes], [s.mass for s in shapes])
    options = {"keep": 40, "target": 1e-3, "max_steps": 5, "clock": Clock()}
    assert [x is None for x in predicted_and_smoothed(shapes, basis, K, **options)] == [
        *(False, True, False)
    ]

    def never(A, keep):
        raise torch.linalg.LinAlgError

    monkeypatch.setattr(batched, "eigh", never)
    assert_same(eigensolve(bodies()[2], K, neo), alone(2))


@pytest.mark.parametrize("most", [0, 1])
def test_what_does_not_fit_into_a_devices_memory_is_solved_with_less(monkeypatch, most):
    """Where two do not fit, one by one; where one does not, row by row."""
    whole, tried = batched.Batch.of, []

    def of(laplacians, device):
        tried.append(len(laplacians))
        if len(laplacians) > most:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return whole(laplacians, device)

    monkeypatch.setattr(batched.Batch, "of", of)
    found = eigensolve_many(bodies()[:2], K, Neo(device="cpu:0"))
    assert tried[:3] == [2, 1, 1]
    for i, spectrum in enumerate(found):
        assert_same(spectrum, alone(i))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
def test_an_accelerator_gives_what_the_host_does():
    found = eigensolve_many(bodies(), K, Neo(device="cuda"), batch=65_536)
    for spectrum, shape in zip(found, bodies(), strict=True):
        assert_same(spectrum, eigensolve(shape, K, Neo()), 1e-4)


@pytest.mark.data
@pytest.mark.filterwarnings("ignore:the cloud falls into")  # as one of them has parts
def test_real_clouds_are_solved_as_alone():
    folder = data_folder()
    if folder is None or not (folder / "train_pool").is_dir():
        pytest.skip("set SPECTRA_KIT_DATA to the folder of real shapes to run this")
    pool = open_pool(folder / "train_pool", "val")
    clouds = [sample(pool.mesh(7 * i), 700 + 50 * i, seed=i) for i in range(3, 6)]
    shapes = [sk.laplacian(cloud) for cloud in (*clouds, torus(n=800).geometry)]
    for spectrum, shape in zip(eigensolve_many(shapes, K, Neo()), shapes, strict=True):
        assert_same(spectrum, eigensolve(shape, K, Neo()))
