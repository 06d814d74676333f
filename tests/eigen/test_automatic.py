"""Who says how accurate eigenvalues must be gets them so, and is told what was done for it."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from conftest import bumpy, creature, joined, moved
from scipy import sparse

import spectra_kit as sk
from spectra_kit._sparse.memory import factor_gigabytes
from spectra_kit.eigen import automatic
from spectra_kit.geometry import rectangle, sphere

K = 40  # of fewer, a cascade leaves few points to Lanczos


def errors(spectrum: sk.Spectrum, exact: sk.Spectrum) -> np.ndarray:
    zero = exact.certificate.kernel_dimension
    return np.abs(spectrum.eigenvalues[zero:] / exact.eigenvalues[zero:] - 1)


@pytest.fixture(autouse=True)
def few_are_fewer(monkeypatch) -> None:
    """Let thousands of points be many: the rule is the same, and tests are quick."""
    monkeypatch.setattr(automatic, "_FEW", 2_000)
    monkeypatch.setattr(automatic, "_FEW_FOR_EACH", 20)
    monkeypatch.setattr(automatic, "_LOOSELY", 1)


@pytest.fixture(scope="module")
def animal() -> sk.Laplacian:
    return sk.robust_laplacian(creature(2500, seed=0))


@pytest.fixture(scope="module")
def exact(animal) -> sk.Spectrum:
    return sk.eigensolve(animal, K, sk.Arpack())


@pytest.fixture(scope="module")
def flat() -> sk.Laplacian:
    """The animal a thousand times thinner than it is long and wide: far from what is easy."""
    mesh = creature(6000, seed=0)
    return sk.robust_laplacian(mesh.with_points(mesh.points * [1, 1, 1e-3]))


@pytest.fixture(scope="module")
def flat_exact(flat) -> sk.Spectrum:
    return sk.eigensolve(flat, 30, sk.Arpack())


def rough(n: int) -> sk.Laplacian:
    """The animal of a stuff whose conductivity jumps by up to ten orders of magnitude."""
    plain = sk.robust_laplacian(creature(n, seed=0))
    scale = sparse.diags_array(10.0 ** np.random.default_rng(0).uniform(-2.5, 2.5, n))
    weights = scale @ (sparse.diags_array(plain.stiffness.diagonal()) - plain.stiffness) @ scale
    weights = (weights + weights.T) / 2
    stiffness = sparse.csr_array(sparse.diags_array(weights.sum(axis=1)) - weights)
    return sk.Laplacian(stiffness, plain.mass, plain.points)


@pytest.mark.parametrize(
    ("accuracy", "name", "promise"),
    [
        (None, "lanczos", "exact"),
        (1e-14, "lanczos", "exact"),
        (1e-8, "lanczos", "exact"),
        (1e-5, "lanczos", "exact"),
        (1e-4, "cascade", "approximate"),
        (1e-2, "cascade", "approximate"),
    ],
)
def test_the_accuracy_is_met_and_the_choice_is_told(animal, exact, accuracy, name, promise) -> None:
    found = sk.eigensolve(animal, K, sk.Automatic(accuracy=accuracy))
    made, certificate = found.provenance, found.certificate
    assert errors(found, exact).mean() <= max(accuracy or 0.0, 1e-12)
    assert (made.name, made.accuracy) == (name, promise)
    assert made.solver.lower().startswith(f"{name}(")
    assert made.choice == f"{name}: {made.reason}"
    asked = f"for errors of {accuracy}" if accuracy else "exact"
    smooth = f"errors of {accuracy} on {animal.n} points need no factor"
    exactly = f"{asked}, and the factor fits into memory"
    assert made.reason == (smooth if name == "cascade" else exactly)
    assert (certificate.count is None) == (promise == "approximate")
    if promise == "approximate":
        assert certificate.errors.mean() <= accuracy


@pytest.mark.parametrize("accuracy", [1e-2, 1e-4])
def test_lanczos_is_as_loose_as_may_be(monkeypatch, animal, exact, accuracy) -> None:
    monkeypatch.setattr(automatic, "_LOOSELY", 4)
    found = sk.eigensolve(animal, K, sk.Automatic(accuracy=accuracy))
    assert found.provenance.choice == "lanczos: Lanczos is quickest for 40 modes of 2500 points"
    off = errors(found, exact)
    assert off.mean() <= min(accuracy, 3 * found.certificate.errors.mean())
    assert off.max() <= 10 * accuracy
    assert found.certificate.count.missing == 0
    assert found.certificate.orthonormality_error < 1e-9
    on_device = sk.Automatic(accuracy=accuracy, device="cpu:0")
    assert isinstance(on_device.choose(animal.n, K)[0], sk.Cascade)


def test_it_is_the_default() -> None:
    laplacian = sk.robust_laplacian(bumpy())
    [ours, theirs] = [sk.eigensolve(laplacian, 9), sk.eigensolve(laplacian, 9, sk.Arpack())]
    np.testing.assert_array_equal(ours.eigenvectors, theirs.eigenvectors)
    assert ours.provenance.solver == theirs.provenance.solver
    assert (ours.provenance.reason, theirs.provenance.reason) == (
        "an exact solution is quickest for 9 modes of 642 points",
        "",
    )
    assert theirs.provenance.choice == "arpack"
    assert sk.spectrum(bumpy(), 4).provenance.reason


def test_analytic_spectrum_of_the_sphere() -> None:
    """Degrees l up to 6, as far as the mesh itself is off: its errors are of second order."""
    ball = sk.robust_laplacian(sphere(subdivisions=5).geometry)
    found = sk.eigensolve(ball, 49, sk.Automatic(accuracy=1e-4))
    true = np.repeat([degree * (degree + 1) for degree in range(7)], range(1, 15, 2))
    assert found.provenance.name == "cascade"
    assert np.abs(found.eigenvalues[1:] / true[1:] - 1).mean() <= 1e-4 + 3e-3


@pytest.mark.parametrize("accuracy", [1e-3, 1e-7])
def test_points_held_at_zero(accuracy) -> None:
    mesh = rectangle(n=2600).geometry
    drum = sk.robust_laplacian(mesh).dirichlet(mesh.boundary_vertices)
    found = sk.eigensolve(drum, K, sk.Automatic(accuracy=accuracy))
    exact = sk.eigensolve(drum, K, sk.Arpack())
    assert found.provenance.name in ("cascade", "lanczos")
    assert errors(found, exact).mean() <= accuracy
    assert not found.eigenvectors[drum.fixed].any()


@pytest.mark.parametrize(
    ("accuracy", "steps", "left"),
    [
        (1e-7, 1, "1 step of smoothing left errors of "),
        (1e-7, 0, "0 steps of smoothing left unknown errors"),
        (1e-3, 0, "0 steps of smoothing left unknown errors"),
    ],
)
def test_smoothing_that_stalls_goes_on_with_a_factor(
    monkeypatch, animal, exact, accuracy, steps, left
) -> None:
    """From the modes that are there, until the certificate says that they are good enough."""
    monkeypatch.setattr(automatic, "_STEPS", steps)
    monkeypatch.setattr(automatic, "_TIGHT", 1e-7)
    found = sk.eigensolve(animal, K, sk.Automatic(accuracy=accuracy))
    certified = found.certificate.errors.mean()
    assert errors(found, exact).mean() <= min(accuracy, certified)
    assert certified <= accuracy or accuracy > 1e-7  # bounds of close eigenvalues may be larger
    assert found.certificate.relative_residuals.max() <= accuracy
    made = found.provenance
    assert (made.name, made.accuracy) == ("refined", "to tolerance")
    assert made.reason.startswith(left)
    assert made.reason.endswith(f", more than {accuracy:g}")
    assert {"coarsen", "filter", "count"} <= made.seconds.keys(), "all work is told"
    assert found.certificate.level == "verified"
    assert found.certificate.bounded.all(), "what the smoothing left is no more"


def test_a_flat_animal_is_smoothed_as_long_as_that_is_cheap(flat, flat_exact) -> None:
    found = sk.eigensolve(flat, 30, sk.Automatic(accuracy=1e-4))
    assert errors(found, flat_exact).mean() <= 1e-4
    assert found.provenance.name == "refined"
    assert found.provenance.reason.startswith(f"{automatic._STEPS} steps of smoothing left errors")


def test_what_goes_on_and_does_not_converge_keeps_the_modes(monkeypatch, animal, exact) -> None:
    """The partial spectrum is certified, tells who made it, and all the time that it took."""
    monkeypatch.setattr(automatic, "_STEPS", 1)
    monkeypatch.setattr(automatic, "_TIGHT", 1e-9)
    monkeypatch.setattr(automatic, "Refined", partial(sk.Refined, max_sweeps=1))
    with pytest.raises(sk.errors.ConvergenceError, match=r"40 modes reached rtol") as caught:
        sk.eigensolve(animal, K, sk.Automatic(accuracy=1e-9))
    kept = caught.value.partial
    assert (kept.k, kept.provenance.name) == (K, "refined")
    assert kept.provenance.reason.startswith("1 step of smoothing left errors of ")
    assert {"coarsen", "smooth", "filter"} <= kept.provenance.seconds.keys()
    assert errors(kept, exact).mean() < 1e-4


def test_what_goes_on_and_does_not_fit_into_memory_keeps_the_modes(
    monkeypatch, animal, exact
) -> None:
    def full(*_: object, **__: object) -> None:
        raise MemoryError("no room for a factor")

    monkeypatch.setattr(automatic, "_STEPS", 1)
    monkeypatch.setattr(automatic, "_TIGHT", 1e-9)
    monkeypatch.setattr(sk.Refined, "eigenpairs", full)
    with pytest.raises(sk.errors.ConvergenceError, match="no room for a factor") as caught:
        sk.eigensolve(animal, K, sk.Automatic(accuracy=1e-9))
    kept = caught.value.partial
    assert (kept.k, kept.provenance.name, caught.value.n_converged) == (K, "cascade", 0)
    assert kept.certificate.errors.mean() > 1e-9
    assert errors(kept, exact).mean() < 1e-2
    assert str(caught.value).endswith("; raise accuracy")


@pytest.mark.parametrize("accuracy", [None, 1e-7])
def test_without_a_factor(animal, exact, flat, flat_exact, accuracy) -> None:
    """Where none fits into memory, and on a device, which has none."""
    solver = sk.Automatic(memory=1e-3, accuracy=accuracy)
    for laplacian, truth, device in (
        (animal, exact, "cpu"),
        (animal, exact, "cpu:0"),
        (flat, flat_exact, "cpu"),
    ):
        found = sk.eigensolve(laplacian, truth.k, replace(solver, device=device))
        assert errors(found, truth).mean() <= (accuracy or 1e-12)
        assert found.provenance.name == "cascade"
        assert found.provenance.reason.endswith("GiB, more than 0.001")
        assert found.certificate.count is None, "that would take a factor"


def test_smoothing_that_nothing_goes_on_from_keeps_the_modes(monkeypatch) -> None:
    monkeypatch.setattr(automatic, "_MANY", 10)
    laplacian = rough(2500)
    missed = r"10 steps of smoothing left errors of .*, more than 1e-07"
    with pytest.raises(sk.errors.ConvergenceError, match=missed) as caught:
        sk.eigensolve(laplacian, K, sk.Automatic(accuracy=1e-7, memory=1e-3))
    kept = caught.value.partial
    assert (kept.k, kept.provenance.name, caught.value.n_converged) == (K, "cascade", 0)
    assert errors(kept, sk.eigensolve(laplacian, K, sk.Arpack())).mean() < 1e-2


def test_memory_counts_the_factor_and_what_is_made_with_it() -> None:
    """The peak of an exact solution, of points that no factor of a few makes a difference to."""
    for n, k in ((500_000, 96), (100_000, 1000)):
        vectors = 8 * n * (704 + k) / 2**30
        assert sk.Lanczos.memory(n, k) > factor_gigabytes(n) + vectors
        solver, _ = sk.Automatic(memory=vectors).choose(n, k)
        assert isinstance(solver, sk.Cascade)
        assert isinstance(sk.Automatic(memory=sk.Lanczos.memory(n, k)).choose(n, k)[0], sk.Lanczos)


@pytest.fixture(scope="module")
def parts() -> tuple[sk.Laplacian, sk.Laplacian]:
    """A large part and two small ones, and the small ones alone."""
    small = [moved(bumpy(), 4.0 * i, 0, 0, scale=0.2) for i in (1, 2)]
    whole = joined(creature(2500, seed=0), *small)
    return sk.robust_laplacian(whole), sk.robust_laplacian(joined(*small))


def test_each_component_has_its_own(tmp_path, parts) -> None:
    """Approximate if any is, with errors of all; counted where none is."""
    whole, small = parts
    exact = sk.eigensolve(whole, 90, sk.Arpack())
    for solver, accuracy in ((sk.Automatic(accuracy=1e-4), 1e-4), (sk.Cascade(), 1e-3)):
        found = sk.eigensolve(whole, 90, solver)
        made = found.provenance
        assert (made.name, made.accuracy) == ("cascade", "approximate")
        assert made.reason.endswith("of 3 components, 2 by arpack")
        assert found.n_zero_modes == 3
        assert errors(found, exact).mean() <= accuracy
        assert found.certificate.errors.shape == (90,)
        few = sk.eigensolve(small, 20, solver)
        why = "an exact solution is quickest for 17 modes of 642 points"
        assert few.provenance.choice == f"arpack: {why}"
        assert (few.provenance.accuracy, few.certificate.level) == ("exact", "verified")
        assert few.certificate.bounded.all()
    found.save(tmp_path / "parts.npz")
    assert sk.Spectrum.load(tmp_path / "parts.npz").provenance == made
    little = sk.eigensolve(sk.robust_laplacian(bumpy()), 60, sk.Automatic(memory=1e-6))
    assert (little.provenance.name, little.provenance.accuracy) == ("lanczos", "exact")


def test_options_reach_what_is_chosen() -> None:
    for accuracy, memory in ((None, 4.0), (1e-9, 4.0), (1e-3, 4.0), (None, 0.01), (1e-9, 0.01)):
        solver = sk.Automatic(accuracy=accuracy, memory=memory, device="cpu:0", seed=7)
        chosen, reason = solver.choose(100_000, 30)
        assert chosen.seed == 7
        assert getattr(chosen, "device", "cpu:0") == "cpu:0"
        assert reason
    assert chosen.target == 1e-9


def test_nearly_all_modes_of_few_points() -> None:
    laplacian = sk.robust_laplacian(sphere(subdivisions=2).geometry)
    exact = sk.eigensolve(laplacian, laplacian.n, sk.Dense())
    for k in (laplacian.n - 1, laplacian.n):
        found = sk.eigensolve(laplacian, k, sk.Automatic(accuracy=1e-6))
        np.testing.assert_allclose(found.eigenvalues, exact.eigenvalues[:k], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_loose_modes_lack_no_copy_of_an_eigenvalue(monkeypatch, seed) -> None:
    """On a periodic grid, most eigenvalues have eight."""
    monkeypatch.setattr(automatic, "_LOOSELY", 4)
    ring = 2 - 2 * np.cos(2 * np.pi * np.arange(50) / 50)
    exact = np.sort(np.add.outer(ring, ring).ravel())
    shifted = sparse.csr_array(np.roll(np.eye(50), 1, axis=0))
    one = sparse.csr_array(2 * sparse.eye_array(50) - shifted - shifted.T)
    grid = sparse.csr_array(sparse.kronsum(one, one))
    laplacian = sk.Laplacian(grid, np.ones(2500), np.zeros((2500, 3)))
    for k in (150, 200):
        found = sk.eigensolve(laplacian, k, sk.Automatic(accuracy=1e-3, seed=seed))
        assert found.provenance.name == "lanczos"
        assert found.eigenvalues == pytest.approx(exact[:k], rel=1e-5, abs=1e-8)


@pytest.mark.parametrize("k", [10, 50])
def test_few_points_are_solved_densely_but_for_what_rounding_would_hide(k) -> None:
    """One point of hardly any mass has an eigenvalue far above all others: LAPACK rounds by it."""
    ball = sk.robust_laplacian(sphere(subdivisions=2).geometry)
    made = sk.eigensolve(ball, k).provenance
    assert made.choice == f"dense: an exact solution is quickest for {k} modes of 162 points"
    mass = ball.mass.copy()
    mass[0] *= 1e-9
    light = sk.Laplacian(ball.stiffness, mass, ball.points)
    found = sk.eigensolve(light, k)
    assert found.provenance.name == "arpack"
    assert found.certificate.level == "verified"
