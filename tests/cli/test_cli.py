"""What the commands that solve compute, print and refuse."""

import re
import warnings

import numpy as np
import pytest
from conftest import bumpy, two_parts
from running import printed, record, refusal, write_shapes

from spectra_kit import (
    AmbientFourier,
    Capped,
    Lobpcg,
    RayleighRitz,
    Spectrum,
)
from spectra_kit.catalogue import SOLVERS
from spectra_kit.cli import main, solving
from spectra_kit.cli.compare import ritz_subspace
from spectra_kit.errors import SpectraKitWarning
from spectra_kit.geometry import TriangleMesh, rectangle, sphere, write


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Small files of every kind."""
    folder = tmp_path_factory.mktemp("files")
    ball = write_shapes(folder)
    write(two_parts(), folder / "parts.ply")
    write(bumpy(), folder / "bumpy.off")
    dirty = TriangleMesh(
        np.vstack([ball.points, ball.points[:1], [[9, 9, 9]]]),
        np.vstack([ball.faces, [[0, 1, ball.n]]]),
    )
    write(dirty, folder / "dirty.off")
    return folder


@pytest.mark.parametrize(
    "solver",
    ["arpack", "multilevel", "refined", "lobpcg", "dense", "polished", "capped", "fourier"],
)
def test_spectrum_of_the_sphere(files, capsys, tmp_path, solver):
    saved = tmp_path / "SPHERE.NPZ"
    result = record(
        capsys, "spectrum", files / "ball.off", "-k", 9, "--solver", solver, "-o", saved
    )
    exact = np.repeat([0.0, 2.0, 6.0], [1, 3, 5])
    np.testing.assert_allclose(result["eigenvalues"], exact, rtol=2e-2, atol=1e-9)
    assert result["certificate"]["n_zero_modes"] == 1
    assert result["geometry"] == {"kind": "mesh", "points": 642, "faces": 1280}
    assert result["provenance"]["operator"].startswith("robust_laplacian(mesh")
    np.testing.assert_array_equal(Spectrum.load(saved).eigenvalues, result["eigenvalues"])


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_neo_runs_from_a_weights_file(capsys, tmp_path):
    import torch

    from spectra_kit.neo import NeoConfig, NeoNetwork
    from spectra_kit.neo.pretrained import save_weights

    torch.manual_seed(0)
    weights = tmp_path / "tiny.safetensors"
    save_weights(
        weights,
        NeoNetwork(NeoConfig(width=16, depth=1, heads=2, head_width=8, latents=8, m=40, k=8)),
        {},
    )
    result = record(
        capsys, "compare", "demo", "--points", 700, "-k", 5, "--solver", "neo",
        "--weights", weights, "--poses", 2,
    )  # fmt: skip
    exact, predicted = result["reference"]["eigenvalues"], result["predicted"]["eigenvalues"]
    assert (np.array(predicted) >= np.array(exact) * (1 - 1e-9) - 1e-9).all()  # Rayleigh-Ritz
    assert result["comparison"]["span_dimension"] == 81


def test_bad_predictions_are_announced(capsys, tmp_path):
    """With the numbers, on stderr while they are made, and in the JSON."""
    sheet = rectangle(n=900).geometry  # rolled up: far points are near, which the network confuses
    x, y, _ = sheet.points.T
    angle = 8 * np.pi * y / y.max()
    radius = 0.1 + 0.02 * angle
    rolled = np.column_stack([x, radius * np.cos(angle), radius * np.sin(angle)])
    write(TriangleMesh(rolled, sheet.faces), tmp_path / "roll.off")
    command = (tmp_path / "roll.off", "-k", 12, "--solver", "neo")
    with warnings.catch_warnings():
        warnings.simplefilter("always", SpectraKitWarning)
        out, err = printed(capsys, "spectrum", *command)
    proved = re.search(r"^verdict +(proved to be more than 10% too high: .*)$", out, re.M)
    assert f"warning: {proved[1]}; take " in err
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SpectraKitWarning)
        result = record(capsys, "compare", *command)
        compared, _ = printed(capsys, "compare", *command)
    off = np.array(result["comparison"]["eigenvalue_error"][1:])
    worst = 1 + off.argmax()
    change = result["comparison"]["predicted_eigenvalues"][worst]
    change = 100 * (change / result["comparison"]["eigenvalues"][worst] - 1)
    assert result["verdict"].startswith(
        f"doubtful: {(off > 0.1).sum()} of 12 eigenvalues are off by more than 10%, that of mode"
        f" {worst} by {change:+,.0f} %"
    )
    assert f"verdict: {result['verdict']}\n" in compared


def test_good_predictions_are_called_so(capsys):
    result = record(capsys, "compare", "demo", "--points", 700, "-k", 8, "--solver", "polished")
    assert result["verdict"].startswith("every eigenvalue is within 10%; the farthest off is that")
    assert result["predicted"]["verdict"] == result["reference"]["verdict"] == ""


def test_a_span_is_that_of_functions_that_were_used():
    """`Capped` evaluates its subspace on a few points: its modes alone span what it returns."""
    waves = AmbientFourier(m=64)
    assert ritz_subspace(RayleighRitz(subspace=waves)) is waves
    assert ritz_subspace(Capped(subspace=waves)) is None


def test_two_runs_give_identical_eigenvalues(capsys):
    command = ("spectrum", "demo", "--points", 600, "--cloud", 700, "-k", 6)
    first, second = record(capsys, *command), record(capsys, *command)
    assert first["eigenvalues"] == second["eigenvalues"]
    assert first["geometry"] == {"kind": "cloud", "points": 700}
    other = record(capsys, *command, "--seed", 1)
    assert other["eigenvalues"] != first["eigenvalues"]


@pytest.mark.parametrize("operator", ["robust", "cotan", "knn", "delaunay"])
def test_operators(files, capsys, operator):
    cloud = ("--cloud", 500) if operator == "delaunay" else ()
    command = ("spectrum", files / "bumpy.off", "-k", 4, "--operator", operator, *cloud)
    result = record(capsys, *command)
    assert operator in result["provenance"]["operator"]
    assert result["eigenvalues"][0] == pytest.approx(0, abs=1e-9)


def test_dirichlet_boundary(files, capsys):
    """The lowest eigenvalue of a rectangle 1 x golden ratio with fixed boundary."""
    result = record(capsys, "spectrum", files / "sheet.off", "-k", 2, "--boundary", "dirichlet")
    golden = (1 + 5**0.5) / 2
    assert result["eigenvalues"][0] == pytest.approx(np.pi**2 * (1 + golden**-2), rel=2e-2)
    assert result["certificate"]["n_zero_modes"] == 0


def test_spectrum_table(files, capsys):
    out, err = printed(capsys, "spectrum", files / "parts.ply", "-k", 6, "--modes", "0,2,5")
    assert err == ""
    assert "parts.ply: mesh, 804 vertices" in out
    assert "2 components" in out
    assert [line.split()[0] for line in out.splitlines() if line[:4].strip().isdigit()] == list(
        "025"
    )
    assert "zero modes                 2 of 2" in out


def test_info_takes_the_operator_that_needs_little_memory(files, capsys):
    """It is the robust one to rounding, and needs no library that a want of memory would end."""
    found = record(capsys, "info", files / "ball.off")["operator"]
    assert found["operator"].startswith("delaunay_laplacian(mesh")
    other = record(capsys, "info", files / "ball.off", "--operator", "robust")["operator"]
    assert other["operator"].startswith("robust_laplacian(mesh")
    for fact in ("operator area", "operator components", "zero modes", "eigenvalue spacing"):
        assert found[fact] == pytest.approx(other[fact], rel=1e-12)


def test_repair_is_told(files, capsys):
    dirty = files / "dirty.off"
    assert "--repair" in refusal(capsys, "spectrum", dirty, "-k", 4)
    out, err = printed(capsys, "spectrum", dirty, "-k", 4, "--repair")
    assert err == "repaired: 1 merged point, 1 degenerate face, 1 unreferenced vertex\n"
    assert "642 vertices" in out
    _, err = printed(capsys, "info", files / "ball.off", "--repair")
    assert err == "repaired: nothing to do\n"


def test_compare_measures_a_prediction(files, capsys):
    result = record(capsys, "compare", files / "bumpy.off", "-k", 10, "--solver", "lobpcg")[
        "comparison"
    ]
    assert result["mean_span_error"] < 1e-12
    assert result["mean_vector_error"] < 1e-10
    assert result["mean_eigenvalue_error"] < 1e-9
    assert result["eigenvalue_error"][0] is None  # no NaN in JSON
    assert len(result["match"]) == 10
    assert result["span_dimension"] == 16  # six more modes were solved for
    assert result["open_from"] == 10  # so the end of the last cluster is known


def test_compare_prints_a_table(capsys):
    command = ("compare", "demo", "--points", 800, "-k", 12, "--solver", "fourier")
    out, err = printed(capsys, *command, "--modes", "1,11")
    assert err == ""
    assert "demo: mesh, 800 vertices" in out
    assert "exact (arpack)  predicted (fourier)" in out
    assert re.search(r"mean of 12 modes, span of \d+ functions", out)
    assert "picture" not in out


def test_where_eigenvalues_coincide_the_means_are_those_of_spaces(files, capsys):
    """Each basis of an eigenspace is as good: the vectors of the two solvers differ freely."""
    ball = sphere(subdivisions=2).geometry
    three = [ball.points + [4 * i, 0, 0] for i in range(3)]
    faces = [ball.faces + i * ball.n for i in range(3)]
    write(TriangleMesh(np.vstack(three), np.vstack(faces)), files / "three.off")
    command = ("compare", files / "three.off", "-k", 12, "--solver", "dense")
    comparison = record(capsys, *command)["comparison"]
    assert comparison["mean_vector_error"] > 0.1
    assert comparison["mean_cluster_error"] < 1e-20
    out, _ = printed(capsys, *command)
    means = dict(re.findall(r"^(\w+ error) +(\S+)  mean", out, flags=re.M))
    assert list(means) == ["span error", "eigenvalue error", "cluster error", "eigenvector error"]
    assert float(means["cluster error"]) < 1e-20


def test_info(files, capsys):
    result = record(capsys, "info", files / "parts.ply")
    assert result["kind"] == "mesh"
    assert result["diagnosis"]["n_components"] == result["operator"]["zero modes"] == 2
    assert result["problems"] == []
    out, _ = printed(capsys, "info", files / "dirty.off")
    assert "1 point lies exactly on an earlier one: --repair" in out
    assert "2 vertices join fans of faces that share no edge: use --operator robust" in out
    assert "refused" in out
    assert "without_" not in out
    assert record(capsys, "info", files / "cloud.ply")["diagnosis"]["area"] is None


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_options_reach_the_solvers_that_take_them(files, capsys):
    ball = files / "ball.off"
    takers = {
        "rtol": {"refined", "multilevel", "lobpcg", "chebyshev"},
        "start": {"refined", "polished", "capped", "lobpcg", "chebyshev"},
    }
    for solver in set(SOLVERS) - {"neo"}:
        for option, value in (("rtol", "1e-4"), ("start", "random")):
            command = ("spectrum", ball, "-k", 4, "--solver", solver, f"--{option}", value)
            if solver in takers[option]:
                shown = "rtol=0.0001" if option == "rtol" else "RandomBasis("
                assert shown in record(capsys, *command)["provenance"]["solver"]
            else:
                assert f"--{option} is for the solvers" in refusal(capsys, *command)
    comparison = ("compare", ball, "-k", 4, "--solver", "fourier")
    exact = record(capsys, *comparison, "--against", "refined", "--rtol", "1e-4")["reference"]
    assert "rtol=0.0001" in exact["provenance"]["solver"]  # one of the two takes it


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
@pytest.mark.parametrize("start", ["random", "fourier"])
@pytest.mark.parametrize("solver", ["refined", "polished", "capped"])
def test_every_start_is_enough_for_a_comparison_of_few_modes(files, capsys, solver, start):
    """A comparison solves for more modes than were asked for; the starts must span them."""
    command = ("compare", files / "ball.off", "-k", 1, "--solver", solver, "--start", start)
    assert record(capsys, *command)["predicted"]["certificate"]["n_zero_modes"] == 1


def test_what_converged_is_saved(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(solving, "make_solver", lambda *_: Lobpcg(max_steps=8))
    out = tmp_path / "modes.npz"
    command = ["spectrum", "demo", "--points", "600", "-k", "20", "--solver", "lobpcg"]
    assert main([*command, "-o", str(out)]) == 3
    message = capsys.readouterr().err
    assert "; loosen --rtol, or use --solver arpack\n" in message
    assert not out.exists()
    rescued = Spectrum.load(tmp_path / "modes.partial.npz")
    assert 0 < rescued.k < 20
    assert f"{rescued.k} modes, of which {rescued.k} converged: " in message
    assert rescued.certificate.relative_residuals.max() < 1e-6


def test_corners_that_are_not_joined_are_told(tmp_path, capsys) -> None:
    ball = sphere(subdivisions=1).geometry
    soup = TriangleMesh(ball.points[ball.faces.ravel()], np.arange(ball.faces.size).reshape(-1, 3))
    path = tmp_path / "soup.off"
    write(soup, path)
    _, told = printed(capsys, "spectrum", path, "-k", 3)
    assert "198 points lie exactly on earlier ones, and the surface has 80 parts" in told
    _, told = printed(capsys, "spectrum", path, "-k", 3, "--repair")
    assert "lie exactly" not in told
