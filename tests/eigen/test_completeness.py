"""No mode is passed over: symmetric shapes at many k, against LAPACK."""

from functools import cache, partial

import numpy as np
import pytest
import trimesh
from conftest import bumpy, creature, joined, moved, two_sheets, whole_spectrum
from scipy import sparse

import spectra_kit as sk
from spectra_kit._sparse.pencil import Pencil
from spectra_kit.eigen import Eigenpairs, accuracy, automatic, lanczos, run
from spectra_kit.geometry import sphere, torus


def cube() -> sk.TriangleMesh:
    solid = trimesh.creation.box().subdivide().subdivide().subdivide()
    solid.merge_vertices()
    return sk.TriangleMesh(np.array(solid.vertices), np.array(solid.faces))


def spheres(number: int) -> sk.TriangleMesh:
    ball = sphere(subdivisions=1).geometry
    return joined(*(moved(ball, 5.0 * i, 0, 0) for i in range(number)))


SHAPES = {
    "sphere": lambda: sphere(subdivisions=3).geometry,
    "cube": cube,
    "torus": lambda: torus(n=500).geometry,
    "coincident sheets": two_sheets,
    "twelve spheres": lambda: spheres(12),
}
OTHERS = [
    sk.Dense(),
    sk.Refined(),
]


@cache
def shape(name: str) -> tuple[sk.Laplacian, np.ndarray]:
    laplacian = sk.robust_laplacian(SHAPES[name]())
    return laplacian, whole_spectrum(laplacian)[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_the_default_solver_misses_no_mode(name: str) -> None:
    """At every eleventh number of modes, others for each shape."""
    laplacian, exact = shape(name)
    for k in range(1 + 2 * list(SHAPES).index(name), 101, 11):
        spectrum = sk.eigensolve(laplacian, k)
        assert spectrum.eigenvalues == pytest.approx(exact[:k], rel=1e-9, abs=1e-9 * exact[-1]), k
        assert spectrum.certificate.level == "verified", (k, spectrum.certificate.count)
        assert np.abs(spectrum.eigenvalues - exact[:k]).max() <= (
            spectrum.certificate.count.radius + 1e-12 * exact[-1]
        )


@pytest.mark.slow
@pytest.mark.parametrize("solver", OTHERS, ids=repr)
@pytest.mark.parametrize("name", ["sphere", "coincident sheets", "twelve spheres"])
def test_no_exact_solver_misses_a_mode(name: str, solver) -> None:
    """At a number of modes of its own for each shape and solver.

    Functions of the points alone are even across coincident sheets: half of the modes.
    """
    laplacian, exact = shape(name)
    k = 2 + (7 * list(SHAPES).index(name) + 13 * OTHERS.index(solver)) % 60
    spectrum = sk.eigensolve(laplacian, k, solver)
    assert spectrum.eigenvalues == pytest.approx(exact[:k], rel=1e-5, abs=1e-9 * exact[-1]), k
    assert spectrum.certificate.level == "verified", k


class Forgetful:
    """An exact backend that passes over modes, as Lanczos may those that occur more than once."""

    def __init__(self, *missed: int, promise: str = "exact") -> None:
        self.missed, self.promise = missed, promise

    def __repr__(self) -> str:
        return f"Forgetful{self.missed}"

    def eigenpairs(self, laplacian: sk.Laplacian, k: int) -> Eigenpairs:
        pairs = sk.Dense().eigenpairs(laplacian, min(k + len(self.missed), laplacian.n))
        keep = [i for i in range(len(pairs.eigenvalues)) if i not in self.missed][:k]
        return Eigenpairs(pairs.eigenvalues[keep], pairs.eigenvectors[:, keep])


@pytest.mark.parametrize("missed", [(0,), (2, 9, 19), tuple(range(5, 15))])
def test_what_a_solver_passed_over_is_found_and_told(bumpy_laplacian, missed) -> None:
    laplacian = bumpy_laplacian
    exact = sk.eigensolve(laplacian, 20)
    completed = sk.eigensolve(laplacian, 20, Forgetful(*missed))
    assert completed.eigenvalues == pytest.approx(exact.eigenvalues, rel=1e-10, abs=1e-10)
    count = completed.certificate.count
    assert (completed.certificate.level, count.added) == ("verified", len(missed))
    assert "that the solver had passed over added" in completed.certificate.completeness
    assert completed.certificate.relative_residuals.max() < 1e-11
    assert completed.provenance.seconds["count"] > 0
    # What does not claim to be exact is left as it is, and not called complete.
    left = sk.eigensolve(laplacian, 20, Forgetful(*missed, promise="approximate")).certificate
    assert (left.level, left.count) == ("residuals", None)
    assert left.completeness == "not counted: modes may be missing between these"


def test_parts_are_completed_one_by_one() -> None:
    laplacian = sk.robust_laplacian(joined(bumpy(), moved(bumpy(), 9, 0, 0, scale=0.5)))
    exact = sk.eigensolve(laplacian, 20).eigenvalues
    completed = sk.eigensolve(laplacian, 20, Forgetful(3))
    assert completed.eigenvalues == pytest.approx(exact, rel=1e-10, abs=1e-10)
    assert completed.certificate.level == "verified"


def test_what_cannot_be_completed_is_an_error(bumpy_laplacian, monkeypatch) -> None:
    """The modes found are handed over, and the certificate says that some are missing."""
    monkeypatch.setattr(run, "Refined", partial(sk.Refined, max_sweeps=1))
    monkeypatch.setattr(sk.Dense, "few", 0)
    with pytest.raises(
        sk.errors.ConvergenceError, match="at least 10 modes of the lowest 20 were"
    ) as error:
        sk.eigensolve(bumpy_laplacian, 20, Forgetful(*range(5, 15)))
    certificate = error.value.partial.certificate
    assert (certificate.level, certificate.count.missing) == ("residuals", 10)
    assert certificate.completeness.startswith("the first 5 of 20; ")


def test_what_sweeps_cannot_complete_is_solved_densely_on_few_points(
    bumpy_laplacian, monkeypatch
) -> None:
    monkeypatch.setattr(run, "Refined", partial(sk.Refined, max_sweeps=1))
    completed = sk.eigensolve(bumpy_laplacian, 20, Forgetful(*range(5, 15)))
    exact = sk.eigensolve(bumpy_laplacian, 20).eigenvalues
    assert completed.eigenvalues == pytest.approx(exact, rel=1e-10, abs=1e-10)
    assert (completed.certificate.level, completed.provenance.name) == ("verified", "dense")
    assert "passed over" in completed.provenance.reason


class Memory:
    """Room for so many factors of a pencil, and never for eight at once."""

    def __init__(self, monkeypatch, room: int) -> None:
        self.room, self.ended, factor = room, False, Pencil.factor

        def within(pencil, sigma):
            if not self.room:
                self.ended = True
                raise MemoryError
            self.room -= 1
            return factor(pencil, sigma)

        def together(pencil, shifts):
            raise MemoryError

        monkeypatch.setattr(Pencil, "factor", within)
        monkeypatch.setattr(Pencil, "inertias", together)


@pytest.mark.parametrize(
    ("solver", "told"),
    [
        (sk.Automatic(), "the first 0 of 20; not counted: out of memory"),
        (sk.Cascade(coarsest=150), "not counted: modes may be missing between these"),
    ],
    ids=repr,
)
def test_modes_are_kept_where_the_count_does_not_fit_into_memory(
    bumpy_laplacian, monkeypatch, solver, told
) -> None:
    memory = Memory(monkeypatch, 0)
    certificate = sk.eigensolve(bumpy_laplacian, 20, solver).certificate
    assert memory.ended
    assert (certificate.level, certificate.n_verified) == ("residuals", 0)
    assert certificate.completeness == told


def hidden() -> sk.Laplacian:
    """Three grids that hang by almost nothing, in a spiral: a mode that no coarse level sees."""
    path = sparse.diags_array([np.ones(14)] * 2, offsets=[1, -1])
    grid = sparse.kron(path, sparse.eye_array(15)) + sparse.kron(sparse.eye_array(15), path)
    links = sparse.coo_array(([1e-8, 1e-8], ([0, 225], [225, 450])), (675, 675))
    weights = sparse.block_diag([grid] * 3) + links + links.T
    t = np.arange(675)
    spiral = np.column_stack([np.cos(0.1 * t) * t, np.sin(0.1 * t) * t, 0.01 * t])
    stiffness = sparse.csr_array(sparse.diags_array(weights.sum(axis=1)) - weights)
    return sk.Laplacian(stiffness, np.ones(675), spiral)


@pytest.mark.parametrize("solver", [sk.Automatic(accuracy=0.1), sk.Cascade(max_steps=1)], ids=repr)
@pytest.mark.parametrize(("room", "refuted"), [(3, False), (6, True)])
@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_what_was_refuted_before_memory_ended_is_told(monkeypatch, solver, room, refuted) -> None:
    monkeypatch.setattr(automatic, "_FEW", 0)
    monkeypatch.setattr(automatic, "_FEW_FOR_EACH", 0)
    monkeypatch.setattr(lanczos, "_MANY", 41)  # one factor is enough
    memory = Memory(monkeypatch, room)
    found = sk.eigensolve(hidden(), 40, solver)
    assert memory.ended
    if refuted and solver == sk.Automatic(accuracy=0.1):  # it goes on
        assert found.provenance.name == "arpack"
        assert "of smoothing left errors of" in found.provenance.reason
    else:
        assert found.provenance.name == "cascade"
        assert (found.certificate.errors.max() > 0.1) == refuted


def test_the_fewer_counts_there_is_memory_for_the_more_they_leave_open(monkeypatch) -> None:
    """Of a mode that is missing, from the first count that tells it on."""
    animal = sk.robust_laplacian(creature(600))
    truth = sk.eigensolve(animal, 14, sk.Dense()).eigenvalues
    values = np.delete(truth, 4)
    whole = accuracy.counted_errors(animal, values, np.full(13, 1e-9))
    assert whole[4] == pytest.approx(values[4] - values[3], rel=1e-3)
    for room in (4, 6, 9):
        with monkeypatch.context() as patch:
            memory = Memory(patch, room)
            errors = accuracy.counted_errors(animal, values, np.full(13, 1e-9))
        assert memory.ended
        assert (errors >= whole).all()
        assert (errors >= values - truth[:13]).all()
        assert (errors[:4] == 1e-9).all()


def strip() -> sk.Laplacian:
    """Long and narrow: low eigenvalues far below the typical gap of the operator."""
    x, y = np.meshgrid(np.linspace(0, 1000, 200), [0, 0.1, 0.2], indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    i = np.arange(600).reshape(200, 3)[:-1, :-1].ravel()
    faces = np.vstack([np.column_stack([i, i + 3, i + 4]), np.column_stack([i, i + 4, i + 1])])
    return sk.robust_laplacian(sk.TriangleMesh(points, faces))


def well() -> sk.Laplacian:
    """A potential on most of a sphere, which the typical gap of the operator is full of."""
    ball = sk.robust_laplacian(sphere(subdivisions=3).geometry)
    height = np.where(ball.points[:, 2] <= 0.6, 1e6, 0.0)
    return sk.Laplacian(
        ball.stiffness + sparse.diags_array(height * ball.mass), ball.mass, ball.points
    )


def bonded(bond: float, *potentials: float) -> sk.Laplacian:
    """Spheres of 42 points that hardly touch, each with a potential of its own."""
    parts = sk.robust_laplacian(spheres(len(potentials)))
    stiffness = parts.stiffness + sparse.diags_array(np.repeat(potentials, 42) * parts.mass)
    first = np.arange(0, 42 * (len(potentials) - 1), 42)
    links = sparse.coo_array((np.full(len(first), bond), (first, first + 42)), stiffness.shape)
    links = links + links.T
    laplacian = stiffness + sparse.diags_array(links.sum(axis=1)) - links
    return sk.Laplacian(sparse.csr_array(laplacian), parts.mass, parts.points)


def chain() -> sk.Laplacian:
    return bonded(1e-3, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize("potentials", [(0, 2e-9), (1e-10, 2e-10, 3e-10, 4e-10), (0, 1e-9, 1e-9)])
def test_potentials_of_almost_nothing_are_no_zero_modes(potentials) -> None:
    laplacian = bonded(1e-13, *potentials)
    assert laplacian.kernel_dimension == 0
    exact, modes = whole_spectrum(laplacian)
    for k in range(1, len(potentials) + 1):
        for solver in (sk.Arpack(), sk.Dense()):
            spectrum = sk.eigensolve(laplacian, k, solver)
            count = spectrum.certificate.count
            assert (count.verified, count.added) == (k, 0)
            assert spectrum.eigenvalues == pytest.approx(exact[:k], rel=1e-3, abs=1e-12)
    above = sk.Spectrum(exact[1:2], modes[:, 1:2], laplacian.mass)
    count = sk.verify(above, laplacian).certificate.count
    assert (count.verified, count.missing) == (0, 1)


@pytest.mark.parametrize(("value", "norm"), [(100.0, 1.0), (0.0, 2.0)])
def test_a_constant_of_another_eigenvalue_or_norm_proves_nothing(value, norm) -> None:
    ball = sk.robust_laplacian(sphere(subdivisions=2).geometry)
    constant = sk.Spectrum([value], np.full((ball.n, 1), norm / np.sqrt(ball.area)), ball.mass)
    assert sk.verify(constant, ball).certificate.level == "residuals"


def test_lapack_is_asked_again_where_it_loses_orthogonality() -> None:
    """Its quicker way does so on this path, which three bonds of almost nothing cut."""
    bonds = np.ones(113)
    bonds[[5, 95, 100]] = 1.13919819e-15
    graph = sparse.diags_array([bonds, bonds], offsets=[1, -1])
    stiffness = sparse.csr_array(sparse.diags_array(graph.sum(axis=1)) - graph)
    points = np.column_stack([np.arange(114.0), np.zeros((114, 2))])
    laplacian = sk.Laplacian(stiffness, np.ones(114), points)
    for k in (113, 114):
        spectrum = sk.eigensolve(laplacian, k, sk.Dense())
        assert spectrum.certificate.orthonormality_error < 1e-12
        assert spectrum.eigenvalues == pytest.approx(whole_spectrum(laplacian)[0][:k], abs=1e-12)


@pytest.mark.parametrize("build", [strip, well, chain])
@pytest.mark.parametrize("missed", [(1, 3), (0, 2)])
def test_low_modes_far_below_the_typical_gap_are_counted(build, missed) -> None:
    laplacian = build()
    exact = whole_spectrum(laplacian)[0]
    kernel = laplacian.kernel_dimension
    pairs = Forgetful(*missed).eigenpairs(laplacian, 5)
    lacking = sk.Spectrum(np.maximum(pairs.eigenvalues, 0), pairs.eigenvectors, laplacian.mass)
    count = sk.verify(lacking, laplacian).certificate.count
    assert count.verified <= missed[0]
    found = sk.eigensolve(laplacian, 5, Forgetful(*missed))
    assert found.certificate.count.verified in (0, 5)  # rounding may leave it open
    assert found.eigenvalues[kernel:] == pytest.approx(exact[kernel:5], rel=1e-6)


def test_zero_modes_that_are_missing_leave_nothing_verified() -> None:
    """However close to zero the modes are that stand in their place."""
    laplacian = chain()
    pairs = sk.Dense().eigenpairs(laplacian, 6)
    without = sk.Spectrum(pairs.eigenvalues[1:], pairs.eigenvectors[:, 1:], laplacian.mass)
    count = sk.verify(without, laplacian).certificate.count
    assert (count.verified, count.missing) == (0, 1)
    assert "1 of 1 zero modes are not in this spectrum" in count.reason


def test_zero_modes_alone_are_the_lowest() -> None:
    spectrum = sk.eigensolve(sk.robust_laplacian(spheres(12)), 7)
    assert spectrum.certificate.level == "verified"
    assert spectrum.certificate.completeness == "all 7, none missed"
