"""Files of spectra: whole, or refused."""

import io
import json
import tracemalloc
import zipfile

import numpy as np
import pytest

from spectra_kit import InvalidInputError, Spectrum, eigensolve, verify
from spectra_kit.eigen import Certificate, ModeCount
from spectra_kit.errors import InvalidFileError


@pytest.fixture(scope="module")
def spectrum(bumpy_laplacian) -> Spectrum:
    return eigensolve(bumpy_laplacian, 20)


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
