"""What a spectrum promises: certificates, scale, copies."""

import copy
import pickle
from functools import partial

import numpy as np
import pytest
from conftest import bumpy, moved, refused, whole_spectrum
from scipy import linalg, sparse
from scipy.spatial import cKDTree

from spectra_kit import (
    Arpack,
    InvalidInputError,
    Laplacian,
    Spectrum,
    cotan_laplacian,
    eigensolve,
    robust_laplacian,
    verify,
)
from spectra_kit.errors import InvalidSpectrumError
from spectra_kit.geometry import rectangle, sphere
from spectra_kit.interop import (
    from_arrays,
    from_diffusion_net,
    from_geomfum,
    from_geomfum_map,
    from_pyfm,
    from_pyfm_map,
    to_diffusion_net,
    to_geomfum,
    to_geomfum_map,
    to_pyfm,
    to_pyfm_map,
)
from spectra_kit.maps import (
    functional_map_from_point_map,
    point_map_from_functional_map,
)
from spectra_kit.operators import tangent_gradient


@pytest.fixture(scope="module")
def spectrum(bumpy_laplacian) -> Spectrum:
    return eigensolve(bumpy_laplacian, 20)


def test_certificate_bounds_the_distance_to_the_true_eigenvalues(bumpy_laplacian, spectrum) -> None:
    # Any M-normalised vectors with their Rayleigh quotients: the bound must hold for them too.
    U = spectrum.eigenvectors[:, :10] + 0.02 * spectrum.eigenvectors[:, 5:15]
    U += 1e-4 * np.random.default_rng(0).standard_normal(U.shape)
    U = np.linalg.qr(np.sqrt(bumpy_laplacian.mass)[:, None] * U)[0]
    U /= np.sqrt(bumpy_laplacian.mass)[:, None]
    values = np.einsum("ij,ij->j", U, bumpy_laplacian.stiffness @ U)
    order = np.argsort(values)
    rough = Spectrum(values[order], U[:, order], bumpy_laplacian.mass).certify(bumpy_laplacian)
    exact = whole_spectrum(bumpy_laplacian)[0]
    distance = np.abs(exact - rough.eigenvalues[:, None]).min(axis=1)
    assert (distance <= rough.certificate.residuals * (1 + 1e-9)).all()
    assert rough.certificate.residuals.min() > 1e-3  # and it isn't trivially zero here
    # Nor does it depend on the length of the vectors.
    wrong = Spectrum(spectrum.eigenvalues + 3, 1e-9 * spectrum.eigenvectors, spectrum.mass)
    assert wrong.certify(bumpy_laplacian).certificate.residuals == pytest.approx(np.full(20, 3.0))


def test_truncate_and_nonzero_carry_the_certificate(spectrum) -> None:
    short, live = spectrum.truncate(5), spectrum.nonzero()
    assert (short.k, short.certificate.n_zero_modes) == (5, 1)
    assert np.array_equal(short.certificate.residuals, spectrum.certificate.residuals[:5])
    assert (live.k, live.n_zero_modes, live.certificate.kernel_dimension) == (19, 0, 0)
    assert live.eigenvalues[0] == spectrum.eigenvalues[1]
    assert spectrum.truncate(20).provenance == spectrum.provenance
    bare = Spectrum(spectrum.eigenvalues, spectrum.eigenvectors, spectrum.mass)
    assert bare.nonzero().k == 19


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_rescale_is_the_spectrum_of_the_scaled_mesh(spectrum, factor: float) -> None:
    scaled = eigensolve(robust_laplacian(moved(bumpy(), 0, scale=factor)), 20)
    predicted = spectrum.rescale(factor)
    assert predicted.eigenvalues[1:] == pytest.approx(scaled.eigenvalues[1:], rel=1e-8)
    assert predicted.mass == pytest.approx(scaled.mass)
    assert predicted.orthonormality_error() < 1e-10
    U, V = predicted.eigenvectors, scaled.eigenvectors
    assert np.abs(np.einsum("ij,i,ij->j", U, scaled.mass, V)) == pytest.approx(np.ones(20))
    before, after = spectrum.certificate, predicted.certificate
    assert after.residuals * factor**2 == pytest.approx(before.residuals)
    assert after.count.radius * factor**2 == pytest.approx(before.count.radius, rel=1e-12)
    assert after.count.floor == pytest.approx(scaled.certificate.count.floor, rel=1e-6)


def test_projection_reconstructs_what_is_in_the_span(spectrum) -> None:
    c = np.random.default_rng(0).standard_normal((20, 3))
    f = spectrum.reconstruct(c)
    assert spectrum.project(f) == pytest.approx(c, abs=1e-10)
    assert spectrum.project(f[:, 0]) == pytest.approx(c[:, 0], abs=1e-10)
    region = f[:, 0] > 0
    assert np.array_equal(spectrum.project(region), spectrum.project(region.astype(float)))


def test_filter_is_the_heat_equation(bumpy_laplacian, spectrum) -> None:
    """One implicit Euler step of the full operator, against the same response on the modes."""
    t = 0.05
    f = spectrum.reconstruct(np.random.default_rng(1).standard_normal(20))
    M = sparse.diags_array(bumpy_laplacian.mass)
    full = sparse.linalg.spsolve((M + t * bumpy_laplacian.stiffness).tocsc(), M @ f)
    assert spectrum.filter(lambda lam: 1 / (1 + t * lam), f) == pytest.approx(full, abs=1e-9)


VALUES, VECTORS, ONES = np.arange(3.0), np.eye(4)[:, :3], np.ones(4)
BESIDE = np.eye(4) + 0.1 * np.eye(4, k=1) + 0.1 * np.eye(4, k=-1)  # a mass that is not diagonal


def test_what_is_refused(spectrum, bumpy_laplacian) -> None:
    flat = rectangle(n=400).geometry
    free = robust_laplacian(flat)
    U, mass = spectrum.eigenvectors, spectrum.mass
    held = free.dirichlet(flat.boundary_vertices)
    short = spectrum.truncate(3).certificate
    zeros = Spectrum(spectrum.eigenvalues, 0 * U, mass)
    small = sphere(subdivisions=2).geometry
    other = robust_laplacian(small)
    slopes, few = tangent_gradient(bumpy()), tangent_gradient(small)
    for call, kind, message in (
        (lambda: Spectrum(VALUES, VECTORS.T, ONES), InvalidSpectrumError, r"\(4, 3\).*transposed"),
        (lambda: Spectrum(VALUES[::-1], VECTORS, ONES), InvalidSpectrumError, "ascending"),
        (lambda: Spectrum(VALUES - 1, VECTORS, ONES), InvalidSpectrumError, "be non-negative"),
        (lambda: Spectrum(VALUES, VECTORS * np.nan, ONES), InvalidSpectrumError, "be finite"),
        (lambda: Spectrum(VALUES, VECTORS, ONES - 1), InvalidSpectrumError, "`mass` must be posi"),
        (lambda: Spectrum(VALUES, VECTORS, ONES, short.count), InvalidInputError, "`certificate`"),
        (lambda: Spectrum(VALUES, VECTORS * 1j, ONES), InvalidInputError, "must hold real numbers"),
        (
            lambda: Spectrum(spectrum.eigenvalues, U, mass, short),
            InvalidSpectrumError,
            "`certificate` must cover 20 modes, got 3",
        ),
        (lambda: spectrum.truncate(21), InvalidInputError, r"`k` must be in \[1, 20\], got 21"),
        (lambda: spectrum.rescale(0), InvalidInputError, "`factor` must be positive"),
        (lambda: spectrum.rescale(1e200), InvalidInputError, "`factor` must be in"),
        (lambda: spectrum.project(np.ones(5)), InvalidInputError, r"be real, of shape \(642,\)"),
        (lambda: spectrum.project(np.ones(642) * 1j), InvalidInputError, "got dtype complex128"),
        (lambda: spectrum.reconstruct(np.ones(5)), InvalidInputError, r"of shape \(20,\)"),
        (lambda: spectrum.filter(lambda lam: lam[:3], mass), InvalidInputError, "return shape"),
        # A residual is a bound only for these unknowns, this mass, and these fixed points.
        (lambda: spectrum.residuals(other), InvalidInputError, "live on the 642 points"),
        (lambda: eigensolve(free, 8).certify(held), InvalidInputError, "another boundary condit"),
        (lambda: spectrum.rescale(2).certify(bumpy_laplacian), InvalidInputError, "have the mass"),
        (lambda: zeros.certify(bumpy_laplacian), InvalidSpectrumError, "a column of zeros"),
        (lambda: from_arrays(VALUES, VECTORS, 2 * ONES), InvalidInputError, "be M-orthonormal"),
        (
            lambda: from_arrays(VALUES, VECTORS, 5 * BESIDE),
            InvalidInputError,
            "be M-orthonormal.*pass it whole",
        ),
        (lambda: from_arrays(VALUES, VECTORS, -BESIDE), InvalidInputError, "positive definite"),
        (lambda: from_arrays(VALUES, VECTORS, BESIDE[:2]), InvalidInputError, "have shape .4,. or"),
        (lambda: from_arrays(-VALUES, VECTORS, ONES), InvalidInputError, "up to rounding, got -"),
        (lambda: from_diffusion_net((U, mass)), InvalidInputError, "got 2 entries"),
        *(
            (lambda f=f: f(spectrum, other), InvalidInputError, "must be the one of `spectrum`")
            for f in (to_pyfm, to_geomfum, partial(to_diffusion_net, gradient=slopes))
        ),
        (
            lambda: to_diffusion_net(spectrum, bumpy_laplacian, few),
            InvalidInputError,
            r"`gradient` must be the one of `spectrum` \(642 points\), got 162",
        ),
    ):
        with pytest.raises(kind, match=message):
            call()


def test_to_torch(spectrum) -> None:
    import torch

    values, vectors, mass = spectrum.to_torch(dtype=torch.float32)
    assert (vectors.shape, vectors.dtype) == ((642, 20), torch.float32)
    assert values.numpy() == pytest.approx(spectrum.eigenvalues, abs=1e-5)
    mass[0] = 7  # they are copies
    assert spectrum.to_torch()[2].numpy() == pytest.approx(spectrum.mass, rel=1e-15)


def test_adapters_there_and_back(spectrum, bumpy_laplacian) -> None:
    pyfm = to_pyfm(spectrum, bumpy_laplacian)
    geomfum = to_geomfum(spectrum, bumpy_laplacian)
    for L in (pyfm["stiffness"], geomfum["stiffness_matrix"]):
        assert abs(L - bumpy_laplacian.stiffness).max() == 0
    for other in (
        from_pyfm(pyfm["eigenvalues"], pyfm["eigenvectors"], pyfm["mass"]),
        from_geomfum(geomfum["vals"], geomfum["vecs"], geomfum["mass_matrix"]),
    ):
        assert np.array_equal(other.eigenvectors, spectrum.eigenvectors)
        certificate = other.certify(bumpy_laplacian).certificate
        assert np.array_equal(certificate.residuals, spectrum.certificate.residuals)
    slopes = tangent_gradient(bumpy())
    told = "be one that torch can use here"
    refused("device", told, to_diffusion_net, spectrum, bumpy_laplacian, slopes, device="nowhere")
    seven = to_diffusion_net(spectrum, bumpy_laplacian, slopes, device="cpu:0")
    _, mass, L, evals, evecs, _, _ = seven
    net = from_diffusion_net(seven)
    again = from_diffusion_net((mass, L, evals, evecs.requires_grad_()))
    assert np.array_equal(again.eigenvectors, net.eigenvectors)
    assert net.eigenvalues == pytest.approx(spectrum.eigenvalues, abs=1e-5)
    assert abs(L.to_dense().numpy() - bumpy_laplacian.stiffness.toarray()).max() < 1e-6


@pytest.mark.parametrize(
    "form",
    [
        sparse.csr_matrix,
        sparse.csc_array,
        sparse.coo_array,
        sparse.bsr_array,
        sparse.lil_matrix,
        lambda mass: mass.toarray(),
        lambda mass: mass.toarray().tolist(),
    ],
)
def test_modes_of_a_full_mass_are_taken_as_they_are(form) -> None:
    laplacian = cotan_laplacian(bumpy(), mass="consistent")
    stiffness, mass = laplacian.stiffness, laplacian.consistent_mass
    values, vectors = linalg.eigh(stiffness.toarray(), mass.toarray(), subset_by_index=(0, 19))
    brought = from_arrays(values, vectors, form(mass))
    assert brought.orthonormality_error() < 1e-12
    assert np.array_equal(brought.eigenvectors, vectors)
    assert brought.mass == pytest.approx(laplacian.mass, rel=1e-14)
    assert verify(brought, laplacian).certificate.level == "verified"
    back = to_pyfm(brought, laplacian)["mass"]
    assert abs(back - mass).max() == 0
    refused("laplacian", "have the mass", brought.certify, cotan_laplacian(bumpy()))


def test_a_mass_that_is_diagonal_in_any_form_is_the_lumped_one(spectrum) -> None:
    mass, arrays = spectrum.mass, (spectrum.eigenvalues, spectrum.eigenvectors)
    stored = sparse.coo_array(sparse.diags_array(mass) + 0 * sparse.eye_array(642, k=1))
    for form in (mass, mass[:, None], np.diag(mass), sparse.diags(mass), stored):
        assert np.array_equal(from_arrays(*arrays, form).mass, mass)


@pytest.mark.parametrize("sizes", [(1.0, 1.0), (1.0, 1000.0), (7.0, 0.02)])
def test_functional_maps_of_pyfm_and_geomfum(spectrum, sizes) -> None:
    # Their formulas, in the units of their modes: p2p_to_FM, and FM_to_p2p with the adjoint.
    a, b = spectrum.rescale(sizes[0]), spectrum.rescale(sizes[1]).truncate(16)
    point_map = np.random.default_rng(0).integers(0, a.n, b.n)
    theirs = b.eigenvectors.T @ (b.mass[:, None] * a.eigenvectors[point_map])
    ours = functional_map_from_point_map(a, b, point_map)
    for there, back in ((to_pyfm_map, from_pyfm_map), (to_geomfum_map, from_geomfum_map)):
        assert there(ours, a, b) == pytest.approx(theirs, abs=1e-10 * abs(theirs).max())
        assert back(theirs, a, b) == pytest.approx(ours, abs=1e-12)
        cut = there(ours[:9, :12], a, b)
        nearest = cKDTree(a.eigenvectors[:, :12]).query(b.eigenvectors[:, :9] @ cut)[1]
        found = point_map_from_functional_map(a, b, ours[:9, :12], adjoint=True)
        assert np.array_equal(nearest, found)
        with pytest.raises(InvalidInputError, match="functional_map"):
            there(theirs.T, a, b)


def test_provenance(bumpy_laplacian, spectrum) -> None:
    provenance = spectrum.provenance
    assert {"assembly", "factor", "lanczos", "certify"} <= set(provenance.seconds)
    assert provenance.operator.startswith("robust_laplacian(mesh")
    assert spectrum.rescale(2).provenance.input_hash == ""
    L = bumpy_laplacian
    wide = sparse.csr_array(
        (L.stiffness.data, L.stiffness.indices.astype(np.int64), L.stiffness.indptr),
        L.stiffness.shape,
    )
    other = eigensolve(Laplacian(wide, L.mass, L.points), 4, Arpack(seed=np.int64(5))).provenance
    assert other.input_hash == provenance.input_hash  # whatever the width of the indices
    assert (other.seed, provenance.seed) == (5, 0)
    assert eigensolve(L.dirichlet([0]), 4).provenance.input_hash != provenance.input_hash


def test_copies_are_as_frozen_as_the_original(bumpy_laplacian, spectrum) -> None:
    for thing in (bumpy(), bumpy().as_cloud(), bumpy_laplacian, spectrum, spectrum.certificate):
        for other in (thing, pickle.loads(pickle.dumps(thing)), copy.deepcopy(thing)):
            assert type(other) is type(thing)
            arrays = {k: v for k, v in vars(other).items() if isinstance(v, np.ndarray)}
            assert arrays
            for name, array in arrays.items():
                assert not array.flags.writeable, name
                assert np.array_equal(array, getattr(thing, name))
    assert pickle.loads(pickle.dumps(spectrum)).provenance == spectrum.provenance
    assert hash(spectrum)
    assert hash(spectrum.provenance)
    with pytest.raises(AttributeError):
        spectrum.mass = np.ones(3)
    with pytest.raises(TypeError):
        spectrum.provenance.seconds["x"] = 1.0


def test_a_laplacian_does_not_follow_its_input(bumpy_laplacian) -> None:
    points = np.array(bumpy_laplacian.points)
    mine = Laplacian(bumpy_laplacian.stiffness, bumpy_laplacian.mass, points)
    points[0] = 99
    assert np.array_equal(mine.points, bumpy_laplacian.points)
    with pytest.raises(ValueError, match="read-only"):
        mine.stiffness.data[0] = 1
