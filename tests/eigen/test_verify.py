"""The count of eigenvalues, against LAPACK's; and that nothing incomplete passes for verified."""

import numpy as np
import pytest
from conftest import bumpy, joined, moved, two_parts, whole_spectrum
from scipy import sparse

import spectra_kit as sk
from spectra_kit._sparse import SparseLDL
from spectra_kit.cli import main
from spectra_kit.eigen import verify
from spectra_kit.eigen.counting import _Prover
from spectra_kit.geometry import rectangle, sphere


def columns(spectrum: sk.Spectrum, keep: list[int]) -> sk.Spectrum:
    return sk.Spectrum(
        spectrum.eigenvalues[keep], np.array(spectrum.eigenvectors[:, keep]), spectrum.mass
    )


@pytest.fixture(scope="module")
def spectrum(bumpy_laplacian) -> sk.Spectrum:
    return sk.eigensolve(bumpy_laplacian, 20).certify(bumpy_laplacian)  # not counted


def test_exact_modes_are_verified(any_laplacian) -> None:
    exact = whole_spectrum(any_laplacian)[0]
    k = 10 + int(np.argmax(np.diff(exact[9:21])))  # cuts no cluster
    verified = verify(sk.eigensolve(any_laplacian, k), any_laplacian)
    count = verified.certificate.count
    assert (verified.certificate.level, count.verified, count.reason) == ("verified", k, "")
    assert np.abs(verified.eigenvalues - exact[:k]).max() <= count.radius + 1e-12 * exact[-1]
    assert exact[k - 1] < count.floor <= exact[k] + 1e-12 * exact[-1]
    assert count.radius < 1e-6 * any_laplacian.eigenvalue_spacing
    assert verified.provenance.seconds["verify"] > 0


def test_a_dropped_mode_is_missed(bumpy_laplacian, spectrum) -> None:
    for dropped in (0, 7, 18):
        keep = [i for i in range(20) if i != dropped]
        certificate = sk.verify(columns(spectrum, keep), bumpy_laplacian).certificate
        assert (certificate.level, certificate.n_verified) == ("residuals", dropped)
        assert f"some beyond the first {dropped} are missing" in certificate.count.reason
        assert ("zero modes are not in" in certificate.count.reason) == (dropped == 0)


def test_a_duplicate_in_place_of_a_mode_is_seen(bumpy_laplacian, spectrum) -> None:
    keep = [0, 1, 2, 3, 4, 5, 6, 6, *range(8, 20)]
    certificate = verify(columns(spectrum, keep), bumpy_laplacian).certificate
    assert certificate.n_verified == 6  # where the two begin, nothing is apart from the next
    assert "mode 7 is far from M-orthonormal" in certificate.count.reason
    # A small tilt does not make a mode of its own of it either.
    vectors = np.array(spectrum.eigenvectors[:, keep])
    vectors[:, 7] += 1e-5 * spectrum.eigenvectors[:, 7]
    vectors[:, 7] /= np.sqrt(spectrum.mass @ vectors[:, 7] ** 2)
    tilted = sk.Spectrum(spectrum.eigenvalues[keep], vectors, spectrum.mass)
    assert verify(tilted, bumpy_laplacian).certificate.n_verified == 6


def test_a_wrong_eigenvalue_ends_what_is_verified(bumpy_laplacian, spectrum) -> None:
    values = np.array(spectrum.eigenvalues)
    values[9] = (values[9] + values[10]) / 2
    wrong = sk.Spectrum(values, spectrum.eigenvectors, spectrum.mass)
    certificate = verify(wrong, bumpy_laplacian).certificate
    assert certificate.n_verified == 9
    assert "too wide to tell one from the next" in certificate.count.reason


def test_nothing_false_is_ever_verified(bumpy_laplacian, spectrum) -> None:
    """Any modes left out, mixed and noised: what is verified holds of the dense spectrum."""
    exact = whole_spectrum(bumpy_laplacian)[0]
    for seed in range(4):
        rng = np.random.default_rng(seed)
        keep = np.sort(rng.choice(20, 17, replace=False))
        vectors = np.array(spectrum.eigenvectors[:, keep])
        vectors += 10.0 ** rng.uniform(-12, -2) * rng.standard_normal(vectors.shape)
        vectors[:, 9:11] @= np.linalg.qr(rng.standard_normal((2, 2)))[0]
        changed = sk.Spectrum(spectrum.eigenvalues[keep], vectors, spectrum.mass)
        count = sk.verify(changed, bumpy_laplacian).certificate.count
        v = count.verified
        assert v <= 10
        assert (np.abs(changed.eigenvalues[:v] - exact[:v]) <= count.radius + 1e-10).all()
        assert exact[v] >= count.floor


def test_a_cluster_may_be_cut_at_k() -> None:
    """The copies left out are no lower than those found: exact to within the step below them."""
    ball = sk.robust_laplacian(sphere(subdivisions=3).geometry)
    exact = whole_spectrum(ball)[0]
    closed = verify(sk.eigensolve(ball, 16), ball)
    assert (closed.certificate.level, closed.certificate.count.radius < 1e-8) == ("verified", True)
    for k in (11, 12, 14):  # 1 + 3 + 5 close; the seven that follow are 3 and 4
        cut = verify(sk.eigensolve(ball, k), ball)
        count = cut.certificate.count
        assert (cut.certificate.level, count.verified, count.missing) == ("verified", k, 0)
        assert np.abs(cut.eigenvalues - exact[:k]).max() <= count.radius
        assert count.radius < 2e-3 * ball.eigenvalue_spacing
        assert exact[k - 1] - 2e-3 * ball.eigenvalue_spacing < count.floor <= exact[k]
    # Truncation of a verified spectrum stays so: what follows is known.
    assert closed.truncate(12).certificate.level == "verified"
    found = sk.eigensolve(ball, 30)  # what is missing is told from what k cuts
    for dropped in (0, 4, 24):
        lacking = columns(found, [i for i in range(30) if i != dropped])
        count = sk.verify(lacking, ball).certificate.count
        assert (count.verified < 29, count.missing) == (True, 1)


def test_several_components_and_isolated_points(bumpy_laplacian) -> None:
    parts = sk.robust_laplacian(two_parts())
    found = sk.eigensolve(parts, 25)
    assert verify(found, parts).certificate.level == "verified"
    lost = verify(columns(found, [0, *range(2, 25)]), parts).certificate
    assert (lost.n_verified, lost.n_zero_modes) == (0, 1)
    alone = sk.Laplacian(
        sparse.block_diag([bumpy_laplacian.stiffness, sparse.csr_array((2, 2))]).tocsr(),
        np.append(bumpy_laplacian.mass, [1e-3, 1e-3]),
        np.vstack([bumpy_laplacian.points, [[9, 9, 9], [8, 8, 8]]]),
    )
    certificate = verify(sk.eigensolve(alone, 15), alone).certificate
    assert (certificate.level, certificate.n_zero_modes) == ("verified", 3)
    speck = sk.robust_laplacian(joined(bumpy(), moved(bumpy(), 5, 5, 5, scale=1e-2)))
    assert verify(sk.eigensolve(speck, 20), speck).certificate.level == "verified"


def test_dirichlet_modes_are_counted_on_the_free_points() -> None:
    mesh = rectangle(n=600).geometry
    free = sk.robust_laplacian(mesh)
    held = free.dirichlet(mesh.boundary_vertices)
    exact = sk.eigensolve(held, 12)
    assert verify(exact, held).certificate.level == "verified"
    assert verify(columns(exact, [0, 1, *range(3, 12)]), held).certificate.n_verified == 2
    # Of the free plate these are no modes at all.
    assert verify(exact, free).certificate.n_verified == 0


def test_a_prediction_claims_only_what_holds(bumpy_laplacian) -> None:
    waves = sk.RayleighRitz(subspace=sk.eigen.subspaces.AmbientFourier(m=200))
    predicted, loose = (
        sk.verify(sk.eigensolve(bumpy_laplacian, 16, solver), bumpy_laplacian).certificate
        for solver in (waves, sk.Refined(rtol=1e-5))
    )
    assert predicted.level == "residuals"
    assert predicted.n_verified <= 4
    assert "refine the modes" in predicted.count.reason
    assert loose.level == "verified"


def test_backward_error_is_a_bound() -> None:
    """Against the product of the factors in twice the digits, near singular shifts included."""
    rng = np.random.default_rng(0)
    for seed in range(6):
        A = sparse.random_array((60, 60), density=0.06, rng=np.random.default_rng(seed))
        A = sparse.csr_array(A + A.T + sparse.diags_array(rng.standard_normal(60)))
        weight = rng.uniform(0.1, 3, 60)
        near = np.linalg.eigvalsh(A.toarray())[20] * (1 + 1e-10)
        shifted = sparse.csr_array(A - near * sparse.eye_array(60))
        factor = SparseLDL(shifted, definite=False)
        order = factor.elimination.order
        L = np.eye(60, dtype=np.longdouble) + factor.lower.toarray()
        product = (L * factor.pivots) @ L.T
        error = (shifted.toarray()[order][:, order] - product).astype(float)
        root = 1 / np.sqrt(weight[order])
        actual = np.linalg.norm(root[:, None] * error * root, 2)
        assert actual <= factor.backward_error(weight)
        assert factor.backward_error(weight) < 1e-8


def test_an_overflowing_bound_is_infinite() -> None:
    tiny = SparseLDL(sparse.csr_array([[1e-300, 1.0], [1.0, 1e-300]]), definite=False)
    assert tiny.backward_error(np.full(2, 1e-200)) == np.inf


def test_rounding_is_confessed() -> None:
    """Modes that no shift can separate from rounding: a stiff pair beside a soft spectrum."""
    n = 12
    path = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)).tolil()
    path[0, 0] = path[-1, -1] = 1.0
    stiff = sparse.block_diag([path, 1e17 * np.array([[1.0, -1.0], [-1.0, 1.0]])]).tocsr()
    points = np.random.default_rng(0).standard_normal((n + 2, 3))
    laplacian = sk.Laplacian(stiff, np.ones(n + 2), points)
    certificate = verify(sk.eigensolve(laplacian, 6), laplacian).certificate
    assert certificate.level == "residuals"
    assert certificate.n_verified == 0
    assert certificate.count.reason


def test_count_survives_what_spectra_go_through(bumpy_laplacian, spectrum) -> None:
    verified = verify(spectrum, bumpy_laplacian)
    count = verified.certificate.count
    short = verified.truncate(5).certificate
    assert (short.level, short.n_verified) == ("verified", 5)
    assert verified.eigenvalues[4] < short.count.floor <= verified.eigenvalues[5]
    assert verified.truncate(20).certificate.count == count
    beyond = verified.nonzero().certificate
    assert (beyond.level, beyond.n_verified, beyond.count.floor) == ("verified", 19, count.floor)

    assert "verified, relative residuals" in repr(verified)
    assert "verified" not in repr(spectrum)
    partly = verify(columns(spectrum, [0, 1, 2, *range(4, 20)]), bumpy_laplacian)
    assert (partly.certificate.level, partly.certificate.n_verified) == ("residuals", 3)
    assert partly.truncate(3).certificate.level == "verified"
    assert partly.truncate(3).certificate.count.reason == ""
    assert partly.truncate(4).certificate.level == "residuals"
    assert partly.nonzero().certificate.n_verified == 2


def test_no_modes_are_nothing_verified(bumpy_laplacian, spectrum) -> None:
    empty = sk.verify(spectrum, bumpy_laplacian).truncate(1).nonzero().certificate
    assert (empty.level, empty.n_verified, len(empty.residuals)) == ("residuals", 0, 0)
    assert empty.count.reason == ""  # there is none that is not


def test_a_pivot_lost_in_rounding_may_be_negative() -> None:
    """Operators whose second pivot, at the shift 1, is rounding alone: of either sign."""
    rng = np.random.default_rng(0)
    negative = 0
    for _ in range(50):
        a, c = rng.uniform(1, 2, 2).astype(np.float32).astype(float)
        b = np.sqrt(a * c)
        stiffness = sparse.csr_array([[a + 1, b], [b, c + 1]])
        laplacian = sk.Laplacian(stiffness, np.ones(2), np.zeros((2, 3)))
        prover = _Prover(laplacian, 1000.0, np.zeros(1), np.zeros(1), [laplacian])
        try:
            factor = SparseLDL(sparse.csr_array([[a, b], [b, c]]), definite=False)
        except sk.InvalidInputError:  # an exact zero
            continue
        lost = int((factor.pivots < 0).sum())
        negative += lost
        below = prover._count(1)
        assert below.number >= lost
        assert below.floor < 1
    assert negative > 5


def test_counts_by_blocks_are_those_of_the_whole() -> None:
    """Nothing joins parts, so their pivots add up, whichever parts are taken together."""
    balls = [sk.geometry.sphere(subdivisions=s).geometry for s in (3, 2, 3)]
    points = np.vstack([ball.points * (1 + i / 9) + 4 * i for i, ball in enumerate(balls)])
    ends = np.cumsum([0, *(ball.n for ball in balls)])
    faces = [ball.faces + start for ball, start in zip(balls, ends, strict=False)]
    whole = sk.robust_laplacian(sk.TriangleMesh(points, np.vstack(faces)))
    parts = np.split(np.arange(whole.n), ends[1:-1])
    blocks = [whole.restricted(np.concatenate([parts[0], parts[2]])), whole.restricted(parts[1])]
    nothing = np.zeros(1)
    alone, apart = (
        _Prover(whole, whole.eigenvalue_spacing, nothing, nothing, some)
        for some in ([whole], blocks)
    )
    exact = sk.eigensolve(whole, 40).eigenvalues
    for sigma in (1.0, 2.5, 5.0):
        (negative, zero, error), counted = alone._inertia(sigma), apart._inertia(sigma)
        assert counted[:2] == (negative, zero) == ((exact < sigma).sum(), 0)
        assert counted[2] == pytest.approx(error, rel=0.5)  # bounds of another order of elimination


def test_the_command_line_says_what_is_verified(tmp_path, capsys) -> None:
    path = str(tmp_path / "bumpy.off")
    sk.write(bumpy(), path)
    for solver, told in (
        ("arpack", "all 12, none missed below"),
        ("fourier", "not counted: modes may be missing between these"),
    ):
        assert main(["spectrum", path, "-k", "12", "--solver", solver]) == 0
        assert told in capsys.readouterr().out
