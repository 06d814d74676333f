import copy
import json
import pickle
import zipfile

import numpy as np
import pytest
from conftest import bumpy
from scipy import sparse

from spectra_kit import (
    Arpack,
    InvalidInputError,
    InvalidSpectrumError,
    Laplacian,
    Spectrum,
    eigensolve,
    robust_laplacian,
)
from spectra_kit.errors import InvalidFileError
from spectra_kit.geometry import rectangle, sphere
from spectra_kit.interop import (
    from_arrays,
    from_diffusion_net,
    from_geomfum,
    from_pyfm,
    to_diffusion_net,
    to_geomfum,
    to_pyfm,
)


@pytest.fixture(scope="module")
def spectrum(bumpy_laplacian) -> Spectrum:
    return eigensolve(bumpy_laplacian, 20)


def test_certificate_bounds_the_distance_to_the_true_eigenvalues(bumpy_laplacian, spectrum) -> None:
    exact = spectrum.eigenvalues
    rng = np.random.default_rng(0)
    # Any M-normalised vectors with their Rayleigh quotients: the bound must hold for them too.
    U = spectrum.eigenvectors[:, :10] + 0.02 * spectrum.eigenvectors[:, 5:15]
    U += 1e-4 * rng.standard_normal(U.shape)
    U = np.linalg.qr(np.sqrt(bumpy_laplacian.mass)[:, None] * U)[0]
    U /= np.sqrt(bumpy_laplacian.mass)[:, None]
    values = np.einsum("ij,ij->j", U, bumpy_laplacian.stiffness @ U)
    order = np.argsort(values)
    rough = Spectrum(values[order], U[:, order], bumpy_laplacian.mass).certify(bumpy_laplacian)
    all_values = eigensolve(bumpy_laplacian, bumpy_laplacian.n // 4).eigenvalues
    distance = np.abs(all_values - rough.eigenvalues[:, None]).min(axis=1)
    assert (distance <= rough.certificate.residuals * (1 + 1e-9)).all()
    assert rough.certificate.residuals.min() > 1e-3  # and it isn't trivially zero here
    assert exact[0] == pytest.approx(0, abs=1e-10)


def test_truncate_and_nonzero_carry_the_certificate(spectrum) -> None:
    short = spectrum.truncate(5)
    assert (short.k, short.certificate.n_zero_modes) == (5, 1)
    assert np.array_equal(short.certificate.residuals, spectrum.certificate.residuals[:5])
    live = spectrum.nonzero()
    assert (live.k, live.n_zero_modes) == (19, 0)
    assert live.eigenvalues[0] == spectrum.eigenvalues[1]
    assert spectrum.truncate(20).provenance == spectrum.provenance


def test_nonzero_without_certificate(spectrum) -> None:
    bare = Spectrum(spectrum.eigenvalues, spectrum.eigenvectors, spectrum.mass)
    assert bare.nonzero().k == 19


@pytest.mark.parametrize("factor", [1e-3, 2.5, 1e3])
def test_rescale_is_the_spectrum_of_the_scaled_mesh(spectrum, factor: float) -> None:
    mesh = bumpy()
    scaled = eigensolve(robust_laplacian(mesh.with_points(factor * mesh.points)), 20)
    predicted = spectrum.rescale(factor)
    assert predicted.eigenvalues[1:] == pytest.approx(scaled.eigenvalues[1:], rel=1e-8)
    assert predicted.orthonormality_error() < 1e-10
    cosines = np.abs(
        np.einsum("ij,ij->j", predicted.eigenvectors, scaled.mass[:, None] * scaled.eigenvectors)
    )
    assert cosines == pytest.approx(np.ones(20), abs=1e-8)
    assert predicted.certificate.residuals * factor**2 == pytest.approx(
        spectrum.certificate.residuals
    )


def test_projection_reconstructs_what_is_in_the_span(spectrum) -> None:
    c = np.random.default_rng(0).standard_normal((20, 3))
    f = spectrum.reconstruct(c)
    assert spectrum.project(f) == pytest.approx(c, abs=1e-10)
    assert spectrum.project(f[:, 0]) == pytest.approx(c[:, 0], abs=1e-10)


def test_filter_is_the_heat_equation(bumpy_laplacian, spectrum) -> None:
    """One implicit Euler step of the full operator, against the same response on the modes."""
    t = 0.05
    f = spectrum.reconstruct(np.random.default_rng(1).standard_normal(20))
    from scipy import sparse

    M = sparse.diags_array(bumpy_laplacian.mass)
    full = sparse.linalg.spsolve((M + t * bumpy_laplacian.stiffness).tocsc(), M @ f)
    assert spectrum.filter(lambda lam: 1 / (1 + t * lam), f) == pytest.approx(full, abs=1e-9)


@pytest.mark.parametrize("mmap", [False, True])
def test_round_trip_through_a_file(tmp_path, spectrum, mmap: bool) -> None:
    path = tmp_path / "s.npz"
    spectrum.save(path)
    again = Spectrum.load(path, mmap=mmap)
    for name in ("eigenvalues", "eigenvectors", "mass"):
        assert np.array_equal(getattr(again, name), getattr(spectrum, name))
        assert getattr(again, name).dtype == np.float64
    assert again.provenance == spectrum.provenance
    assert np.array_equal(again.certificate.residuals, spectrum.certificate.residuals)
    assert again.certificate.kernel_dimension == 1
    assert again.eigenvectors.ctypes.data % 64 == 0 or not mmap
    assert np.array_equal(np.load(path)["eigenvalues"], spectrum.eigenvalues)
    owner = again.eigenvectors
    while isinstance(owner, np.ndarray) and not isinstance(owner, np.memmap):
        owner = owner.base
    assert isinstance(owner, np.memmap) == mmap


def test_same_spectrum_same_bytes(tmp_path, spectrum) -> None:
    spectrum.save(tmp_path / "a.npz")
    spectrum.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_interrupted_save_keeps_the_old_file(tmp_path, spectrum, monkeypatch) -> None:
    path = tmp_path / "s.npz"
    spectrum.truncate(3).save(path)

    def interrupted(*args: object, **kwargs: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(np.lib.format, "write_array", interrupted)
    with pytest.raises(KeyboardInterrupt):
        spectrum.save(path)
    assert Spectrum.load(path).k == 3
    assert [p.name for p in tmp_path.iterdir()] == ["s.npz"]


NOT_WHOLE = "not a whole spectrum file"
OTHER_FILES = {
    "nothing": (lambda path: None, "there is no such file"),
    "an empty file": (lambda path: path.write_bytes(b""), NOT_WHOLE),
    "other arrays": (lambda path: np.savez(path, a=np.ones(3)), NOT_WHOLE),
    **{
        header[:50]: (lambda path, header=header: np.savez(path, header=np.array(header)), message)
        for header, message in (
            ("[]", NOT_WHOLE),
            ("no json", NOT_WHOLE),
            ("[" * 100_000, "not a whole spectrum file .maximum recursion"),
            ('{"format": "x"}', NOT_WHOLE),
            ('{"format": "spectra_kit spectrum", "version": "x"}', NOT_WHOLE),
            ('{"format": "spectra_kit spectrum", "version": 99}', "it has format version 99"),
        )
    },
}


@pytest.mark.parametrize("case", OTHER_FILES)
def test_other_files_are_refused(tmp_path, case: str) -> None:
    write, message = OTHER_FILES[case]
    path = tmp_path / "other.npz"
    write(path)
    with pytest.raises(InvalidFileError, match=message) as caught:
        Spectrum.load(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("keep", [100, 0.3, 0.7, 0.99])
def test_truncated_files_are_refused(tmp_path, spectrum, keep: float) -> None:
    spectrum.save(tmp_path / "s.npz")
    whole = (tmp_path / "s.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: int(keep if keep > 1 else keep * len(whole))])
    with pytest.raises(InvalidFileError, match="not a whole spectrum file"):
        Spectrum.load(tmp_path / "cut.npz")
    with pytest.raises(InvalidInputError, match=r"must end in \.npz"):
        spectrum.save(tmp_path / "s.mat")


def test_compressed_files_cannot_be_mapped(tmp_path, spectrum) -> None:
    spectrum.save(tmp_path / "s.npz")
    with (
        zipfile.ZipFile(tmp_path / "s.npz") as old,
        zipfile.ZipFile(tmp_path / "z.npz", "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for name in old.namelist():
            new.writestr(name, old.read(name))
    assert Spectrum.load(tmp_path / "z.npz").k == 20
    with pytest.raises(InvalidInputError, match="cannot be mapped"):
        Spectrum.load(tmp_path / "z.npz", mmap=True)


def test_frozen(spectrum) -> None:
    with pytest.raises(ValueError, match="read-only"):
        spectrum.eigenvalues[0] = 1
    with pytest.raises(AttributeError):
        spectrum.mass = np.ones(3)
    assert spectrum == spectrum
    assert hash(spectrum)


VALUES, VECTORS, ONES = np.arange(3.0), np.eye(4)[:, :3], np.ones(4)
BAD = {
    "transposed": (
        lambda: Spectrum(VALUES, VECTORS.T, ONES),
        r"must have shape \(4, 3\).*transposed",
    ),
    "descending": (lambda: Spectrum(VALUES[::-1], VECTORS, ONES), "non-negative and ascending"),
    "negative": (lambda: Spectrum(VALUES - 1, VECTORS, ONES), "non-negative and ascending"),
    "nan": (lambda: Spectrum(VALUES, VECTORS * np.nan, ONES), "`eigenvectors` must be finite"),
    "mass": (lambda: Spectrum(VALUES, VECTORS, ONES - 1), "`mass` must be positive"),
}


@pytest.mark.parametrize("case", BAD)
def test_invariants(case: str) -> None:
    build, message = BAD[case]
    with pytest.raises(InvalidSpectrumError, match=message):
        build()


def test_bad_arguments(spectrum, bumpy_laplacian) -> None:
    with pytest.raises(InvalidInputError, match=r"`k` must be in \[1, 20\], got 21"):
        spectrum.truncate(21)
    with pytest.raises(InvalidInputError, match="`factor` must be positive"):
        spectrum.rescale(0)
    with pytest.raises(InvalidInputError, match=r"`values` must be real, of shape \(642,\)"):
        spectrum.project(np.ones(5))
    with pytest.raises(InvalidInputError, match=r"`coefficients` must be real, of shape \(20,\)"):
        spectrum.reconstruct(np.ones(5))
    with pytest.raises(InvalidInputError, match="got dtype complex128"):
        spectrum.project(np.ones(642) * 1j)
    with pytest.raises(InvalidInputError, match="`eigenvectors` must hold real numbers, got dtype"):
        Spectrum(VALUES, VECTORS * 1j, ONES)
    with pytest.raises(InvalidInputError, match="`response` must return shape"):
        spectrum.filter(lambda lam: lam[:3], np.ones(642))
    with pytest.raises(InvalidInputError, match="`laplacian` must live on the 642 points"):
        spectrum.residuals(bumpy_laplacian.restricted(np.arange(600)))
    short = spectrum.truncate(3).certificate
    with pytest.raises(InvalidSpectrumError, match="`certificate` must cover 20 modes, got 3"):
        Spectrum(spectrum.eigenvalues, spectrum.eigenvectors, spectrum.mass, short)


def test_to_torch(spectrum) -> None:
    torch = pytest.importorskip("torch")
    values, vectors, mass = spectrum.to_torch(dtype=torch.float32)
    assert vectors.shape == (642, 20)
    assert vectors.dtype == torch.float32
    assert values.numpy() == pytest.approx(spectrum.eigenvalues, abs=1e-5)
    assert spectrum.to_torch()[2].numpy() == pytest.approx(mass.numpy())


def test_adapters_there_and_back(spectrum, bumpy_laplacian) -> None:
    pyfm = to_pyfm(spectrum, bumpy_laplacian)
    geomfum = to_geomfum(spectrum, bumpy_laplacian)
    for arrays, L in ((pyfm, pyfm["stiffness"]), (geomfum, geomfum["stiffness_matrix"])):
        assert abs(L - bumpy_laplacian.stiffness).max() == 0, arrays
    back = [
        from_pyfm(pyfm["eigenvalues"], pyfm["eigenvectors"], pyfm["mass"]),
        from_geomfum(geomfum["vals"], geomfum["vecs"], geomfum["mass_matrix"]),
    ]
    for other in back:
        assert np.array_equal(other.eigenvectors, spectrum.eigenvectors)
        certificate = other.certify(bumpy_laplacian).certificate
        assert np.array_equal(certificate.residuals, spectrum.certificate.residuals)
    mass, L, evals, evecs = to_diffusion_net(spectrum, bumpy_laplacian)
    frames = gradient = None
    net = from_diffusion_net((frames, mass, L, evals, evecs, gradient, gradient))
    again = from_diffusion_net((mass, L, evals, evecs.requires_grad_()))
    assert np.array_equal(again.eigenvectors, net.eigenvectors)
    assert net.eigenvalues == pytest.approx(spectrum.eigenvalues, abs=1e-5)
    assert abs(L.to_dense().numpy() - bumpy_laplacian.stiffness.toarray()).max() < 1e-6


def test_adapters_refuse_what_is_no_spectrum(spectrum) -> None:
    U, mass = spectrum.eigenvectors, spectrum.mass
    with pytest.raises(InvalidInputError, match="must be M-orthonormal"):
        from_arrays(spectrum.eigenvalues, U, 2 * mass)
    with pytest.raises(InvalidInputError, match="up to rounding, got -"):
        from_arrays(spectrum.eigenvalues[::-1] * -1, U, mass)
    with pytest.raises(InvalidInputError, match="got 2 entries"):
        from_diffusion_net((U, mass))
    other = robust_laplacian(sphere(subdivisions=2).geometry)
    for export in (to_pyfm, to_geomfum, to_diffusion_net):
        with pytest.raises(InvalidInputError, match="must be the one of `spectrum`"):
            export(spectrum, other)


def test_input_hash_and_seed_are_recorded(bumpy_laplacian, spectrum) -> None:
    other = eigensolve(bumpy_laplacian, 4, Arpack(seed=5)).provenance
    assert other.input_hash == spectrum.provenance.input_hash
    assert (other.seed, spectrum.provenance.seed) == (5, 0)
    moved = eigensolve(bumpy_laplacian.dirichlet([0]), 4).provenance
    assert moved.input_hash != spectrum.provenance.input_hash
    assert {"assembly", "factor", "lanczos", "certify"} <= set(spectrum.provenance.seconds)
    assert spectrum.provenance.operator.startswith("robust_laplacian(mesh")


def test_certify_refuses_what_it_cannot_judge(bumpy_laplacian, spectrum) -> None:
    """A residual is a bound only for these unknowns, this mass, and these fixed points."""
    flat = rectangle(n=400).geometry
    free = robust_laplacian(flat)
    with pytest.raises(InvalidInputError, match="belong to another boundary condition"):
        eigensolve(free, 8).certify(free.dirichlet(flat.boundary_vertices))
    with pytest.raises(InvalidInputError, match="must have the mass of this spectrum"):
        spectrum.rescale(2.0).certify(bumpy_laplacian)
    zeros = Spectrum(spectrum.eigenvalues, 0 * spectrum.eigenvectors, spectrum.mass)
    with pytest.raises(InvalidSpectrumError, match="a column of zeros"):
        zeros.certify(bumpy_laplacian)


def test_the_bound_does_not_depend_on_the_length_of_the_vectors(bumpy_laplacian, spectrum) -> None:
    wrong = Spectrum(spectrum.eigenvalues + 3, 1e-9 * spectrum.eigenvectors, spectrum.mass)
    assert wrong.certify(bumpy_laplacian).certificate.residuals == pytest.approx(np.full(20, 3.0))


def test_copies_are_as_frozen_as_the_original(bumpy_laplacian, spectrum) -> None:
    for thing in (bumpy(), bumpy().as_cloud(), bumpy_laplacian, spectrum, spectrum.certificate):
        for other in (pickle.loads(pickle.dumps(thing)), copy.deepcopy(thing)):
            assert type(other) is type(thing)
            arrays = {k: v for k, v in vars(other).items() if isinstance(v, np.ndarray)}
            assert arrays
            for name, array in arrays.items():
                assert not array.flags.writeable, name
                assert np.array_equal(array, getattr(thing, name))
    assert pickle.loads(pickle.dumps(spectrum)).provenance == spectrum.provenance
    assert hash(spectrum.provenance)
    with pytest.raises(TypeError):
        spectrum.provenance.seconds["x"] = 1.0


def test_laplacian_does_not_follow_its_input(bumpy_laplacian) -> None:
    points = np.array(bumpy_laplacian.points)
    mine = Laplacian(bumpy_laplacian.stiffness, bumpy_laplacian.mass, points)
    points[0] = 99
    assert np.array_equal(mine.points, bumpy_laplacian.points)
    with pytest.raises(ValueError, match="read-only"):
        mine.stiffness.data[0] = 1


def test_numpy_seeds_are_saved_and_the_hash_ignores_index_widths(tmp_path, bumpy_laplacian) -> None:
    L = bumpy_laplacian
    wide = sparse.csr_array(
        (L.stiffness.data, L.stiffness.indices.astype(np.int64), L.stiffness.indptr),
        L.stiffness.shape,
    )
    other = Laplacian(wide, L.mass, L.points)
    s = eigensolve(other, 3, Arpack(seed=np.int64(3)))
    s.save(tmp_path / "UPPER.NPZ")
    assert Spectrum.load(tmp_path / "UPPER.NPZ").provenance.seed == 3
    assert s.provenance.input_hash == eigensolve(L, 3).provenance.input_hash
    assert s.rescale(2).provenance.input_hash == ""


def edited(path, spectrum, change):
    """Save `spectrum`, then again by NumPy with its members changed, checksums and all."""
    spectrum.save(path)
    with np.load(path) as old:
        members = dict(old)
    header = json.loads(str(members["header"]))
    change(header, members)
    members["header"] = np.array(json.dumps(header))
    np.savez(path, **members)
    return path


EDITS = {
    "a planet": (
        lambda header, _: header["provenance"].update(planet="earth"),
        "has an unknown header",
    ),
    "no seconds": (
        lambda header, _: header["provenance"].update(seconds=None),
        "`seconds` must be a mapping of strings to numbers, got None",
    ),
    "odd seconds": (
        lambda header, _: header["provenance"].update(seconds={"solve": None}),
        "`seconds` must be a mapping of strings to numbers, got {'solve': None}",
    ),
    "a list as solver": (
        lambda header, _: header["provenance"].update(solver=[]),
        "`solver` must be a string, got a list",
    ),
    "no provenance": (
        lambda header, _: header.pop("provenance"),
        r"not a whole spectrum file \('provenance'\); write it again",
    ),
    "a text as a count": (
        lambda header, _: header["certificate"].update(n_zero_modes="1"),
        "`n_zero_modes` must be an integer, got '1'",
    ),
    "a text as an error": (
        lambda header, _: header["certificate"].update(orthonormality_error="small"),
        "`orthonormality_error` must be a number, got 'small'",
    ),
    "half a proof": (
        lambda header, _: header["certificate"].update(
            count={"verified": 3, "radius": None, "floor": 1.0}
        ),
        "`radius` must be a number, got None",
    ),
    "few residuals": (
        lambda _, members: members.update(relative_residuals=members["relative_residuals"][:7]),
        r"must have the same shape .* got \(7,\) and \(20,\)",
    ),
    "a table of residuals": (
        lambda _, members: members.update(
            {name: members[name][None] for name in ("residuals", "relative_residuals")}
        ),
        r"must have the same shape .* got \(1, 20\)",
    ),
    "a version as text": (lambda header, _: header.update(version="2"), "not a whole spectrum"),
}


@pytest.mark.parametrize("edit", EDITS)
def test_fields_that_cannot_be_are_refused(tmp_path, spectrum, edit) -> None:
    change, message = EDITS[edit]
    path = edited(tmp_path / "s.npz", spectrum, change)
    for mmap in (False, True):
        with pytest.raises(InvalidInputError, match=message) as caught:
            Spectrum.load(path, mmap=mmap)
        assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("made", "name", "accuracy"),
    [
        ("Arpack(tol=0.0, shift=0.1, seed=0, max_restarts=1000)", "arpack", "exact"),
        ("RayleighRitz(subspace=AmbientFourier(m=9, bandwidth=1.0, seed=0), rank_tol=1e-10)",
         "fourier", "approximate"),
        ("RayleighRitz(subspace=RandomBasis(m=9, seed=0), rank_tol=1e-10)", "rayleighritz", ""),
        ("pyFM", "pyfm", ""),
        ("user", "", ""),
    ],
)  # fmt: skip
def test_files_without_the_name_of_the_solver(tmp_path, spectrum, made, name, accuracy) -> None:
    """Those of version 2 have its repr alone, and not the accuracy either."""

    def change(header, _) -> None:
        del header["provenance"]["name"], header["provenance"]["accuracy"]
        header["provenance"]["solver"] = made

    loaded = Spectrum.load(edited(tmp_path / "s.npz", spectrum, change)).provenance
    assert (loaded.solver, loaded.name, loaded.accuracy) == (made, name, accuracy)


@pytest.mark.parametrize("shape", [b"(642, 19), }      ", b"(642, 20000000), }"])
def test_the_shape_accounts_for_every_byte(tmp_path, spectrum, shape: bytes) -> None:
    """Fewer values leave the end unread, and its checksum; more ask for memory there is not."""
    path = tmp_path / "s.npz"
    spectrum.save(path)
    path.write_bytes(path.read_bytes().replace(b"(642, 20), }      ", shape, 1))
    with pytest.raises(InvalidInputError, match=r"eigenvectors.npy has .* bytes for a shape of"):
        Spectrum.load(path)


def test_a_region_is_projected_as_its_indicator(any_laplacian) -> None:
    spectrum = eigensolve(any_laplacian, 6)
    region = any_laplacian.points[:, 0] > np.median(any_laplacian.points[:, 0])
    assert np.array_equal(spectrum.project(region), spectrum.project(region.astype(float)))
