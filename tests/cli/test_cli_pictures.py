"""The commands that draw: what they write, and from which modes."""

import re
from pathlib import Path

import numpy as np
import pytest
from conftest import creature
from PIL import Image
from running import record

from spectra_kit import (
    AmbientFourier,
    Certificate,
    Provenance,
    RayleighRitz,
    Spectrum,
    eigensolve,
    robust_laplacian,
)
from spectra_kit.cli import main
from spectra_kit.cli.compare import is_exact, reference_name
from spectra_kit.geometry import read, rectangle, write

DRAWN = ("--dpi", "40", "-q")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An animal in a file, and its modes in another."""
    folder = tmp_path_factory.mktemp("files")
    mesh = creature(500)
    write(mesh, folder / "animal.ply")
    eigensolve(robust_laplacian(mesh), 9).save(folder / "animal.npz")
    return folder


def coloured(path):
    """Shares of the pixels that are clearly red, and clearly blue."""
    with Image.open(path) as picture:
        red, _, blue = np.moveaxis(np.asarray(picture.convert("RGB")).astype(int), 2, 0)
    return (red - blue > 60).mean(), (blue - red > 60).mean()


def test_saved_modes_are_drawn_without_solving(folder, capsys, tmp_path):
    out = tmp_path / "modes.png"
    told = record(
        capsys, "modes", folder / "animal.ply", "--spectrum", folder / "animal.npz",
        "--modes", "1,2", "-o", out, *DRAWN,
    )  # fmt: skip
    assert told["modes"] == [1, 2]
    assert told["picture"] == str(out)
    assert len(told["eigenvalues"]) == 9  # all that were saved
    assert min(coloured(out)) > 0.01
    with Image.open(out) as picture:
        assert picture.width > picture.height  # two modes beside each other


def test_as_many_modes_are_solved_for_as_are_shown(folder, capsys, tmp_path):
    out = tmp_path / "modes.svg"
    told = record(
        capsys, "modes", folder / "animal.ply", "--modes", "3", "--no-lines", "--columns", "3",
        "-o", out, *DRAWN,
    )  # fmt: skip
    assert len(told["eigenvalues"]) == 4
    assert out.read_text().startswith("<?xml")


def test_an_animation_swings(folder, capsys, tmp_path):
    out = tmp_path / "modes.gif"
    told = record(
        capsys, "animate", folder / "animal.ply", "--spectrum", folder / "animal.npz",
        "--modes", "1", "--seconds", "0.4", "--fps", "10", "--width", "90", "-o", out, "-q",
    )  # fmt: skip
    assert told["animation"] == str(out)
    with Image.open(out) as film:
        assert (film.n_frames, film.width) == (4, 90)
        frames = []
        for i in range(4):
            film.seek(i)
            frames.append(np.asarray(film.convert("RGB")).astype(int))
    assert np.abs(frames[0] - frames[2]).max() > 100  # half a period later the colours are changed


def test_eigenvalues_are_drawn(folder, capsys, tmp_path):
    command = ("spectrum", folder / "animal.ply", "-k", "6", "--picture")
    out = tmp_path / "spectrum.pdf"
    told = record(capsys, *command, out, "-q")
    assert told["picture"] == str(out)
    assert told["output"] is None
    assert out.read_bytes().startswith(b"%PDF")
    record(capsys, *command, tmp_path / "spectrum.png", *DRAWN)
    with Image.open(tmp_path / "spectrum.png") as picture:
        assert picture.width == 320  # 8 inches


def test_the_boundary_of_a_mesh_is_part_of_weyls_law(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(rectangle(width=2.0, height=1.0, n=300).geometry, "sheet.off")
    for boundary, what in (("neumann", "free"), ("dirichlet", "held")):
        out = Path(f"{what}.svg")
        record(capsys, "spectrum", "sheet.off", "-k", "5", "--boundary", boundary, "--picture", out)
        assert f"area 2 and a {what} boundary of length 6" in out.read_text()
    record(capsys, "spectrum", "sheet.off", "-k", "5", "--cloud", "300", "--picture", "cloud.svg")
    text = Path("cloud.svg").read_text()
    assert "λ = 4πj / area, for the area" in text
    assert "boundary" not in text


def test_the_page_has_the_name_of_the_file_and_says_what_it_holds(
    folder, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    command = ("explore", folder / "animal.ply", "--spectrum", folder / "animal.npz")
    told = record(capsys, *command, "-k", "8", "--solver", "fourier", "--max-points", "200")
    page = tmp_path / "animal.html"
    explorer = told["explorer"]
    assert explorer["path"] == "animal.html"
    assert '"names":["exact (arpack)","predicted (fourier)"]' in page.read_text()
    assert explorer["bytes"] == page.stat().st_size
    assert explorer["n_points"] == 500
    assert explorer["decimated"]
    assert explorer["n_shown"] <= 210
    assert told["url"] is None
    assert len(told["comparison"]["match"]) == 8
    assert main([*map(str, command), "--max-points", "200", "--solver", "none"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert f"{explorer['n_shown']} of 500 points (--max-points shows more)" in out
    assert "page: animal.html, " in out
    assert "9 modes on" in out


def test_exact_modes_of_a_comparison_may_be_saved_ones(folder, capsys):
    command = ("compare", folder / "animal.ply", "-q", "--solver", "dense", "-k", "9")
    told = record(capsys, *command, "--spectrum", folder / "animal.npz")
    assert told["comparison"]["mean_span_error"] < 1e-12
    assert "Arpack" in told["reference"]["provenance"]["solver"]
    assert main([*map(str, command), "--spectrum", str(folder / "animal.npz")]) == 0
    out = capsys.readouterr().out
    assert "exact (arpack)  exact (dense)" in out
    assert re.search(r"mode +first +second +change", out)
    assert "errors are" not in out
    assert "predicted" not in out


def test_where_the_second_side_is_exact_the_errors_are_those_of_the_first(
    folder, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    command = ("compare", str(folder / "animal.ply"), "-q", "--against", "fourier", "-k", "6")
    told = record(capsys, *command, "--solver", "arpack")
    assert [told[side]["exact"] for side in ("reference", "predicted")] == [False, True]
    names = [told[side]["name"] for side in ("reference", "predicted")]
    assert names == ["reference, predicted (fourier)", "exact (arpack)"]
    assert main([*command, "--solver", "arpack", "-o", "errors.svg", "--dpi", "40"]) == 0
    out, drawn = capsys.readouterr().out, Path("errors.svg").read_text()
    assert "reference, predicted (fourier)  exact (arpack)" in out
    assert re.search(r"mode +reference +exact +change", out)
    caution = "errors are those of the reference, predicted (fourier): the other side is exact"
    for text in (out, drawn):
        assert caution in text
        assert "predicted (arpack)" not in text
    assert ", cluster error " in drawn


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_modes_that_were_predicted_are_never_called_exact(folder, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mesh = str(folder / "animal.ply")
    guess = RayleighRitz(subspace=AmbientFourier(m=60))
    eigensolve(robust_laplacian(read(mesh)), 9, guess).save("guess.npz")
    for reference, name in (
        (("--spectrum", "guess.npz"), "predicted (fourier)"),
        (("--against", "capped"), "predicted (capped)"),
    ):
        command = ("compare", mesh, "-q", "--solver", "fourier", "-k", "8", *reference)
        told = record(capsys, *command)
        assert "exact" not in told
        assert told["reference"]["name"] == f"reference, {name}"
        assert [told[side]["exact"] for side in ("reference", "predicted")] == [False, False]
        assert main([*command, "-o", "errors.svg", "--dpi", "40"]) == 0
        out, drawn = capsys.readouterr().out, Path("errors.svg").read_text()
        assert f"\n\nerrors are against the reference, {name}, not against exact modes" in out
        assert re.search(r"mode +reference +predicted +change", out)
        for text in (out, drawn):
            assert "exact" not in text.replace("not against exact modes", "")
    page = ("explore", mesh, "--spectrum", "guess.npz", "-k", "8", "-q")
    assert main([*page, "--solver", "fourier"]) == 0
    out = capsys.readouterr().out
    assert "errors are against the reference, predicted (fourier), not against exact" in out
    names = '"names":["reference, predicted (fourier)","predicted (fourier)"]'
    assert names in Path("animal.html").read_text()
    assert record(capsys, *page, "--solver", "none")["reference"]["name"] == "predicted (fourier)"
    assert '"names":["predicted (fourier)",""]' in Path("animal.html").read_text()


@pytest.mark.parametrize(
    ("solver", "accuracy", "residual", "name"),
    [
        ("lobpcg", "to tolerance", 9e-4, "exact (lobpcg)"),
        ("lobpcg", "to tolerance", 0.02, "reference, solved to 2e-02 (lobpcg)"),
        ("neo", "approximate", 1e-9, "reference, predicted (neo)"),
        ("pyfm", "", 1e-9, "reference, modes (pyfm)"),
        ("", "", 1e-9, "reference, modes (solver unknown)"),
    ],
)
def test_a_reference_is_exact_only_if_a_solver_to_tolerance_made_it(
    solver, accuracy, residual, name
):
    certificate = Certificate(
        residuals=[residual],
        relative_residuals=[residual],
        orthonormality_error=0.0,
        kernel_dimension=1,
        n_zero_modes=1,
        n_components=1,
    )
    provenance = Provenance(name=solver, accuracy=accuracy)
    made = Spectrum([0.0], [[0.5]] * 4, [1.0] * 4, certificate, provenance)
    assert reference_name(made) == name
    assert is_exact(made) == name.startswith("exact")
