"""The commands that draw: what they write, and from which modes."""

import re
from pathlib import Path

import numpy as np
import pytest
from conftest import creature
from PIL import Image
from running import printed, record

from spectra_kit import Spectrum, eigensolve, robust_laplacian, show
from spectra_kit.catalogue import SOLVERS
from spectra_kit.cli.compare import is_exact, reference_name
from spectra_kit.eigen import Certificate, Provenance
from spectra_kit.geometry import rectangle, write

DRAWN = ("--dpi", "40", "-q")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An animal in a file, its modes in another, and guesses of them in a third."""
    folder = tmp_path_factory.mktemp("files")
    mesh = creature(500)
    write(mesh, folder / "animal.ply")
    laplacian = robust_laplacian(mesh)
    eigensolve(laplacian, 9).save(folder / "animal.npz")
    eigensolve(laplacian, 9, SOLVERS["fourier"]()).save(folder / "guess.npz")
    return folder


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def coloured(path):
    """Shares of the pixels that are clearly red, and clearly blue."""
    with Image.open(path) as picture:
        red, _, blue = np.moveaxis(np.asarray(picture.convert("RGB")).astype(int), 2, 0)
    return (red - blue > 60).mean(), (blue - red > 60).mean()


def test_saved_modes_are_drawn_without_solving(folder, capsys):
    command = ("modes", folder / "animal.ply", "--spectrum", folder / "animal.npz")
    told = record(capsys, *command, "--modes", "1,2", *DRAWN)
    assert told["modes"] == [1, 2]
    assert told["picture"] == "modes.png"
    assert len(told["eigenvalues"]) == 9  # all that were saved
    assert min(coloured("modes.png")) > 0.01
    with Image.open("modes.png") as picture:
        assert picture.width > picture.height  # two modes beside each other
    one_column = record(capsys, *command, "-k", 3, "--columns", 1, "-o", "two.png", *DRAWN)
    assert one_column["modes"] == [1, 2]
    with Image.open("two.png") as picture:
        assert picture.width < picture.height


def test_as_many_modes_are_solved_for_as_are_shown(folder, capsys):
    command = ("modes", folder / "animal.ply", "--modes", "3", "--no-lines", "-o", "modes.svg")
    told = record(capsys, *command, *DRAWN)
    assert len(told["eigenvalues"]) == 4
    assert Path("modes.svg").read_text().startswith("<?xml")


@pytest.mark.parametrize(
    ("command", "plot"), [("modes", "plot_modes"), ("animate", "animate_modes")]
)
def test_what_is_asked_of_a_picture_reaches_it(folder, capsys, monkeypatch, command, plot):
    asked = []
    monkeypatch.setattr(show, plot, lambda *_, **options: asked.append(options))
    dpi = ("--dpi", 50) if command == "modes" else ()
    files = (folder / "animal.ply", "--spectrum", folder / "animal.npz")
    record(capsys, command, *files, "--up", "y", "--turn", 30, *dpi, "-q")
    assert asked[0]["view"] == show.View("y", 30.0)
    assert asked[0]["modes"] == tuple(range(1, 9 if command == "modes" else 7))
    assert not dpi or asked[0]["page"].dpi == 50


def test_an_animation_swings(folder, capsys):
    command = ("animate", folder / "animal.ply", "--spectrum", folder / "animal.npz")
    film = ("--modes", "1", "--seconds", "0.4", "--fps", "10", "--width", "90", "-q")
    assert record(capsys, *command, *film)["animation"] == "modes.gif"
    with Image.open("modes.gif") as film:
        assert (film.n_frames, film.width) == (4, 90)
        frames = []
        for i in range(4):
            film.seek(i)
            frames.append(np.asarray(film.convert("RGB")).astype(int))
    assert np.abs(frames[0] - frames[2]).max() > 100  # half a period later the colours are changed


def test_eigenvalues_are_drawn_with_the_boundary_as_part_of_weyls_law(capsys):
    write(rectangle(width=2.0, height=1.0, n=300).geometry, "sheet.off")
    command = ("spectrum", "sheet.off", "-k", "5", "--picture")
    told = record(capsys, *command, "spectrum.png", *DRAWN)
    assert (told["picture"], told["output"]) == ("spectrum.png", None)
    with Image.open("spectrum.png") as picture:
        assert picture.width == 320  # 8 inches
    for boundary, what in (("neumann", "free"), ("dirichlet", "held")):
        record(capsys, *command, "sheet.svg", "--boundary", boundary)
        text = Path("sheet.svg").read_text()
        assert f"area 2 and a {what} boundary of length 6" in text
    out, _ = printed(capsys, *command, "cloud.svg", "--cloud", "300")
    assert out.endswith("\n\npicture: cloud.svg\n")
    text = Path("cloud.svg").read_text()
    assert "λ = 4πj / area, for the area" in text
    assert "boundary" not in text


def test_the_page_has_the_name_of_the_file_and_says_what_it_holds(folder, capsys):
    command = ("explore", folder / "animal.ply", "--spectrum", folder / "animal.npz")
    told = record(capsys, *command, "-k", "8", "--solver", "fourier", "--max-points", "200")
    page, explorer = Path("animal.html"), told["explorer"]
    assert explorer["path"] == "animal.html"
    assert '"names":["exact (arpack)","predicted (fourier)"]' in page.read_text()
    assert explorer["bytes"] == page.stat().st_size
    assert explorer["n_points"] == 500
    assert explorer["decimated"]
    assert explorer["n_shown"] <= 210
    assert told["url"] is None
    assert len(told["comparison"]["match"]) == 8
    out, err = printed(capsys, *command, "--max-points", "200", "--solver", "none")
    assert err == ""
    assert f"{explorer['n_shown']} of 500 points (--max-points shows more)" in out
    assert "page: animal.html, " in out
    assert "9 modes on" in out


def test_where_the_second_side_is_exact_the_errors_are_those_of_the_first(folder, capsys):
    command = ("compare", folder / "animal.ply", "--solver", "arpack", "--against", "fourier")
    told = record(capsys, *command, "-k", "6", "-o", "errors.svg", *DRAWN)
    assert [told[side]["exact"] for side in ("reference", "predicted")] == [False, True]
    names = [told[side]["name"] for side in ("reference", "predicted")]
    assert names == ["reference, predicted (fourier)", "exact (arpack)"]
    out, _ = printed(capsys, *command, "-k", "6", "-q")
    assert "reference, predicted (fourier)  exact (arpack)" in out
    assert re.search(r"mode +reference +exact +change", out)
    drawn = Path("errors.svg").read_text()
    for text in (out, drawn):
        assert "errors are those of the reference, predicted (fourier): the other side is" in text
        assert "predicted (arpack)" not in text
    assert ", cluster error " in drawn


def test_modes_that_were_predicted_are_never_called_exact(folder, capsys):
    mesh, guess = folder / "animal.ply", ("--spectrum", folder / "guess.npz")
    name = "predicted (fourier)"
    command = (mesh, "-q", "-k", "8", *guess)
    told = record(capsys, "compare", *command, "--solver", "fourier")
    assert "exact" not in told
    assert told["reference"]["name"] == f"reference, {name}"
    assert [told[side]["exact"] for side in ("reference", "predicted")] == [False, False]
    out, _ = printed(capsys, "compare", *command, "--solver", "fourier")
    caution = f"errors are against the reference, {name}, not against exact modes"
    assert f"\n\n{caution}" in out
    assert re.search(r"mode +reference +predicted +change", out)
    assert "exact" not in out.replace(caution, "")
    assert caution in printed(capsys, "explore", *command, "--solver", "fourier")[0]
    assert f'"names":["reference, {name}","{name}"]' in Path("animal.html").read_text()
    alone = record(capsys, "explore", *command, "--solver", "none")
    assert alone["reference"]["name"] == name
    assert f'"names":["{name}",""]' in Path("animal.html").read_text()


@pytest.mark.parametrize(
    ("solver", "accuracy", "residual", "name"),
    [
        ("refined", "to tolerance", 9e-4, "exact (refined)"),
        ("refined", "to tolerance", 0.02, "reference, solved to 2e-02 (refined)"),
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
