"""What a spectrum promises: certificates, scale, files that are whole or refused, copies."""

import copy
import io
import json
import pickle
import tracemalloc
import zipfile
from functools import partial

import numpy as np
import pytest
from conftest import bumpy, moved, whole_spectrum
from scipy import linalg, sparse
from scipy.spatial import cKDTree

from spectra_kit import (
    Arpack,
    Certificate,
    InvalidInputError,
    InvalidSpectrumError,
    Laplacian,
    ModeCount,
    Spectrum,
    cotan_laplacian,
    eigensolve,
    robust_laplacian,
    verify,
)
from spectra_kit.errors import IgnoredContentWarning, InvalidFileError
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


@pytest.mark.parametrize("mmap", [False, True])
def test_round_trip_through_a_file(tmp_path, bumpy_laplacian, spectrum, mmap: bool) -> None:
    path = tmp_path / "UPPER.NPZ"
    for whole in (spectrum.certify(bumpy_laplacian), verify(spectrum, bumpy_laplacian)):
        whole.save(path)
        again = Spectrum.load(path, mmap=mmap)
        for name in ("eigenvalues", "eigenvectors", "mass"):
            assert np.array_equal(getattr(again, name), getattr(whole, name))
            assert getattr(again, name).dtype == np.float64
        assert again.provenance == whole.provenance
        assert repr(again.certificate) == repr(whole.certificate)
        assert np.array_equal(again.certificate.residuals, whole.certificate.residuals)
    assert again.eigenvectors.ctypes.data % 64 == 0 or not mmap
    assert np.array_equal(np.load(path)["eigenvalues"], spectrum.eigenvalues)
    owner = again.eigenvectors
    while isinstance(owner, np.ndarray) and not isinstance(owner, np.memmap):
        owner = owner.base
    assert isinstance(owner, np.memmap) == mmap


def test_saving(tmp_path, spectrum, monkeypatch) -> None:
    """The same spectrum has the same bytes; one that is interrupted leaves the file as it was."""
    spectrum.save(tmp_path / "a.npz")
    spectrum.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()

    def interrupted(*args: object, **kwargs: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(np.lib.format, "write_array", interrupted)
        with pytest.raises(KeyboardInterrupt):
            spectrum.truncate(3).save(tmp_path / "a.npz")
    assert Spectrum.load(tmp_path / "a.npz").k == 20
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "b.npz"]
    with pytest.raises(InvalidInputError, match=r"must end in \.npz"):
        spectrum.save(tmp_path / "s.mat")


def edited(path, spectrum, change):
    """Save `spectrum`, then again by NumPy with its members changed, checksums and all."""
    spectrum.save(path)
    with np.load(path) as old:
        members = dict(old)
    header = json.loads(str(members["header"]))
    change(header, members)
    members["header"] = np.array(json.dumps(header))
    np.savez(path, **members)


def in_header(*keys: str, value: object):
    """A change of one field of the header."""

    def change(header, members) -> None:
        *parents, last = keys
        for key in parents:
            header = header[key]
        header[last] = value

    return change


def fewer_residuals(header, members) -> None:
    members["relative_residuals"] = members["relative_residuals"][:7]


def tables_of_residuals(header, members) -> None:
    members.update({k: members[k][None] for k in ("residuals", "relative_residuals")})


NOT_WHOLE = "not a whole spectrum file"
TIMES = "`seconds` must be a mapping of strings to numbers, got "
EDITS = [
    (in_header("format", value="x"), NOT_WHOLE),
    (in_header("version", value="2"), NOT_WHOLE),
    (in_header("version", value=99), "it has format version 99"),
    (in_header("provenance", value={}), rf"{NOT_WHOLE} \('solver'\); write it again"),
    (in_header("provenance", "planet", value="earth"), rf"{NOT_WHOLE} .*planet"),
    (in_header("provenance", "seconds", value=None), f"{TIMES}None"),
    (in_header("provenance", "seconds", value={"a": None}), f"{TIMES}{{'a': None}}"),
    (in_header("provenance", "solver", value=[]), "`solver` must be a string, got a list"),
    (in_header("certificate", "n_zero_modes", value="1"), "must be an integer, got '1'"),
    (in_header("certificate", "orthonormality_error", value="a"), "must be a number, got 'a'"),
    (
        in_header("certificate", "count", value={"verified": 3, "radius": None, "floor": 1.0}),
        "`radius` must be a number, got None",
    ),
    (fewer_residuals, r"must have the same shape .* got \(7,\) and \(20,\)"),
    (tables_of_residuals, r"must have the same shape .* got \(1, 20\)"),
]


@pytest.mark.parametrize(("change", "message"), EDITS)
def test_fields_that_cannot_be_are_refused(tmp_path, spectrum, change, message: str) -> None:
    path = tmp_path / "s.npz"
    edited(path, spectrum, change)
    for mmap in (False, True):
        with pytest.raises(InvalidFileError, match=message) as caught:
            Spectrum.load(path, mmap=mmap)
        assert str(caught.value).startswith(f"{path}: ")


def test_files_that_are_none_or_not_whole_are_refused(tmp_path, spectrum) -> None:
    path = tmp_path / "s.npz"

    def refuse(message: str) -> None:
        with pytest.raises(InvalidFileError, match=message):
            Spectrum.load(path)

    refuse("there is no such file")
    np.savez(path, a=np.ones(3))
    refuse(NOT_WHOLE)
    for header in ("[]", "no json", "[" * 100_000):
        np.savez(path, header=np.array(header))
        refuse(NOT_WHOLE)
    spectrum.save(path)
    whole = path.read_bytes()
    for keep in (0, 100, len(whole) // 3, len(whole) - 9):
        path.write_bytes(whole[:keep])
        refuse(NOT_WHOLE)
    # Fewer values leave the end unread, and its checksum; more ask for memory there is not.
    for shape in (b"(642, 19), }      ", b"(642, 20000000), }"):
        path.write_bytes(whole.replace(b"(642, 20), }      ", shape, 1))
        refuse(r"eigenvectors.npy has .* bytes for a shape of")


def repacked(path, member, data, **how):
    """Put other bytes in the place of a member of a spectrum file."""
    with zipfile.ZipFile(path) as old:
        members = {name: old.read(name) for name in old.namelist()}
    with zipfile.ZipFile(path, "w") as new:
        for name, content in members.items():
            new.writestr(
                name, data if name == member else content, **(how if name == member else {})
            )


def announcing(dims, kind="<f8"):
    """The head of an array of these dimensions."""
    head = io.BytesIO()
    told = {"descr": kind, "fortran_order": False, "shape": dims}
    np.lib.format.write_array_header_1_0(head, told)
    return head.getvalue()


@pytest.mark.parametrize("mmap", [False, True])
@pytest.mark.parametrize("member", ["header", "eigenvalues", "eigenvectors", "mass", "residuals"])
@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_compressed_members_are_refused_before_they_are_inflated(
    tmp_path, spectrum, member, method, mmap
) -> None:
    path = tmp_path / "s.npz"
    spectrum.save(path)
    large = announcing((1 << 20,)) + bytes(1 << 23)  # 8 MiB out of some kB
    repacked(path, f"{member}.npy", large, compress_type=method)
    tracemalloc.start()
    with pytest.raises(InvalidFileError, match=f"{member}.npy is compressed") as caught:
        Spectrum.load(path, mmap=mmap)
    assert tracemalloc.get_traced_memory()[1] < 1 << 21
    tracemalloc.stop()
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("dims", "kind"),
    [((1 << 30, 20), "<f8"), ((1 << 40,), "<U0"), ((-642, -20), "<f8"), ((20, 642), "|O")],
)
@pytest.mark.parametrize("mmap", [False, True])
def test_members_that_announce_what_they_do_not_hold(tmp_path, spectrum, dims, kind, mmap) -> None:
    path = tmp_path / "s.npz"
    spectrum.save(path)
    repacked(path, "eigenvectors.npy", announcing(dims, kind) + bytes(8 * 642 * 20))
    with pytest.raises(InvalidFileError, match=str(path)):
        Spectrum.load(path, mmap=mmap)


COUNT = {"verified": 3, "radius": 0.1, "floor": 1.0}
NAN = float("nan")


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("verified", {"count": COUNT | {"verified": 10**9}}),
        ("verified", {"count": COUNT | {"verified": 21}}),
        ("verified", {"count": COUNT | {"verified": -1}}),
        ("missing", {"count": COUNT | {"missing": -1}}),
        ("added", {"count": COUNT | {"added": -1}}),
        ("radius", {"count": COUNT | {"radius": NAN}}),
        ("radius", {"count": COUNT | {"radius": -0.1}}),
        ("floor", {"count": COUNT | {"floor": NAN}}),
        ("orthonormality_error", {"orthonormality_error": NAN}),
        ("orthonormality_error", {"orthonormality_error": -1e-9}),
        ("n_zero_modes", {"n_zero_modes": 21}),
        ("kernel_dimension", {"kernel_dimension": -1}),
        ("excess", {"excess": [-1.0] * 20}),
        ("errors", {"errors": [-1e-9] * 20}),
        ("errors", {"errors": [NAN] * 20}),
    ],
)
def test_certificates_of_what_cannot_be_are_refused(tmp_path, spectrum, name, change) -> None:
    fields = vars(spectrum.certificate) | change
    with pytest.raises(InvalidInputError, match=f"`{name}` must"):
        Certificate(
            **fields | ({"count": ModeCount(**change["count"])} if "count" in change else {})
        )
    edited(tmp_path / "s.npz", spectrum, lambda header, _: header["certificate"].update(change))
    with pytest.raises(InvalidFileError, match=rf"s\.npz: `{name}` must"):
        Spectrum.load(tmp_path / "s.npz")


@pytest.mark.parametrize("name", ["residuals", "relative_residuals"])
@pytest.mark.parametrize("value", [-1e-12, NAN])
def test_residuals_that_cannot_be_are_refused(tmp_path, spectrum, name, value) -> None:
    def change(_, members) -> None:
        members[name] = np.where(np.arange(20) == 7, value, members[name])

    edited(tmp_path / "s.npz", spectrum, change)
    with pytest.raises(InvalidFileError, match=rf"s\.npz: `{name}` must"):
        Spectrum.load(tmp_path / "s.npz")


@pytest.mark.parametrize(
    ("made", "name", "accuracy"),
    [
        ("Arpack(tol=0.0, shift=0.1, seed=0, max_restarts=1000)", "arpack", "exact"),
        ("RayleighRitz(subspace=AmbientFourier(m=9), rank_tol=1e-10)", "fourier", "approximate"),
        ("RayleighRitz(subspace=RandomBasis(m=9), rank_tol=1e-10)", "rayleighritz", ""),
        ("user", "", ""),
    ],
)
def test_files_without_the_name_of_the_solver(tmp_path, spectrum, made, name, accuracy) -> None:
    """Those of version 2 have its repr alone, and not the accuracy either."""

    def change(header, _) -> None:
        del header["provenance"]["name"], header["provenance"]["accuracy"]
        header["provenance"]["solver"] = made

    edited(tmp_path / "s.npz", spectrum, change)
    loaded = Spectrum.load(tmp_path / "s.npz").provenance
    assert (loaded.solver, loaded.name, loaded.accuracy) == (made, name, accuracy)


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
        (lambda: from_arrays(VALUES, VECTORS, -BESIDE), InvalidInputError, "positive row sums"),
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
    seven = to_diffusion_net(spectrum, bumpy_laplacian, tangent_gradient(bumpy()))
    _, mass, L, evals, evecs, _, _ = seven
    net = from_diffusion_net(seven)
    again = from_diffusion_net((mass, L, evals, evecs.requires_grad_()))
    assert np.array_equal(again.eigenvectors, net.eigenvectors)
    assert net.eigenvalues == pytest.approx(spectrum.eigenvalues, abs=1e-5)
    assert abs(L.to_dense().numpy() - bumpy_laplacian.stiffness.toarray()).max() < 1e-6


def consistent_mass(mesh) -> sparse.csr_array:
    """The mass of linear finite elements: a sixth of the area on the diagonal, a twelfth beside."""
    corners = mesh.points[mesh.faces]
    areas = np.linalg.norm(np.cross(*(corners[:, 1:] - corners[:, :1]).transpose(1, 0, 2)), axis=1)
    i, j = (np.tile(mesh.faces, (1, 3)).ravel(), np.repeat(mesh.faces, 3, axis=1).ravel())
    entries = np.repeat(areas / 2, 9) * np.where(i == j, 1 / 6, 1 / 12)
    return sparse.csr_array(sparse.coo_array((entries, (i, j)), shape=(mesh.n, mesh.n)))


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
def test_modes_of_a_full_mass_are_carried_over_to_its_row_sums(form) -> None:
    mesh = bumpy()
    stiffness, mass = cotan_laplacian(mesh).stiffness, consistent_mass(mesh)
    lumped = Laplacian(stiffness, mass.sum(axis=1), mesh.points)
    values, vectors = linalg.eigh(stiffness.toarray(), mass.toarray(), subset_by_index=(0, 19))
    truth = eigensolve(lumped, 20)
    with pytest.warns(IgnoredContentWarning, match="beside its diagonal.*lump=True"):
        brought = from_arrays(values, vectors, form(mass))
    assert np.array_equal(brought.mass, lumped.mass)
    assert brought.orthonormality_error() < 1e-12
    assert np.linalg.matrix_rank(np.hstack([vectors, brought.eigenvectors]), tol=1e-8) == 20
    # Ritz values: above those of the lumped problem, and far nearer than what was brought.
    excess = brought.eigenvalues[1:] / truth.eigenvalues[1:] - 1
    assert excess.min() > -1e-9
    assert excess.max() < 0.02 * (values[1:] / truth.eigenvalues[1:] - 1).max()
    assert brought.certify(lumped).certificate.level == "residuals"


def test_a_mass_that_is_diagonal_in_any_form_is_the_lumped_one(spectrum) -> None:
    mass, arrays = spectrum.mass, (spectrum.eigenvalues, spectrum.eigenvectors)
    stored = sparse.coo_array(sparse.diags_array(mass) + 0 * sparse.eye_array(642, k=1))
    for form in (mass, mass[:, None], np.diag(mass), sparse.diags(mass), stored):
        assert np.array_equal(from_arrays(*arrays, form).mass, mass)


def test_the_advice_for_a_full_mass_makes_a_laplacian(bumpy_laplacian) -> None:
    mass, L = sparse.csc_matrix(consistent_mass(bumpy())), bumpy_laplacian
    with pytest.raises(InvalidInputError, match="pass its row sums instead"):
        Laplacian(L.stiffness, mass, L.points)
    assert Laplacian(L.stiffness, mass.sum(axis=1), L.points).mass.shape == (L.n,)


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
