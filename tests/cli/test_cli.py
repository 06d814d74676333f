"""What the commands that solve compute and print."""

import re
import warnings
from itertools import product

import numpy as np
import pytest
from conftest import bumpy, joined, moved, two_parts
from running import printed, record, refusal, write_shapes

from spectra_kit import Cascade, Neo, RayleighRitz, Refined, Spectrum
from spectra_kit.catalogue import SOLVERS
from spectra_kit.cli import main, solving
from spectra_kit.cli.compare import ritz_subspace
from spectra_kit.cli.program import parse
from spectra_kit.eigen.subspaces import AmbientFourier, RandomBasis
from spectra_kit.errors import InvalidInputError, SpectraKitWarning
from spectra_kit.geometry import TriangleMesh, sphere, write


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


@pytest.mark.parametrize("solver", ["arpack", "refined", "fourier"])
def test_spectrum_of_the_sphere(files, capsys, tmp_path, solver):
    saved = tmp_path / "SPHERE.NPZ"
    command = ("spectrum", files / "ball.off", "-k", 9, "--solver", solver, "-o", saved)
    result = record(capsys, *command, "--verify")
    exact = np.repeat([0.0, 2.0, 6.0], [1, 3, 5])
    np.testing.assert_allclose(result["eigenvalues"], exact, rtol=2e-2, atol=1e-9)
    assert result["certificate"]["n_zero_modes"] == 1
    assert result["certificate"]["count"]
    assert result["geometry"] == {"kind": "mesh", "points": 642, "faces": 1280}
    assert result["provenance"]["operator"].startswith("robust_laplacian(mesh")
    assert result["output"] == str(saved)
    np.testing.assert_array_equal(Spectrum.load(saved).eigenvalues, result["eigenvalues"])


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_neo_runs_from_a_weights_file(capsys, tmp_path):
    import torch

    from spectra_kit.neo import NeoConfig, NeoNetwork
    from spectra_kit.neo.pretrained import save_weights

    torch.manual_seed(0)
    weights = tmp_path / "tiny.safetensors"
    config = NeoConfig(width=16, depth=1, heads=2, head_width=8, latents=8, m=40, k=8)
    save_weights(weights, NeoNetwork(config), {})
    command = ("compare", "demo", "--points", 500, "-k", 5, "--weights", weights, "--poses", 2)
    result = record(capsys, *command)
    exact, predicted = result["reference"]["eigenvalues"], result["predicted"]["eigenvalues"]
    assert (np.array(predicted) >= np.array(exact) * (1 - 1e-9) - 1e-9).all()  # Rayleigh-Ritz
    assert "poses=2" in result["predicted"]["provenance"]["solver"]


def test_bad_predictions_are_announced(files, capsys, monkeypatch):
    """With the numbers, on stderr while they are made, and in the JSON."""
    bad = Cascade(subspace=RandomBasis(m=20), max_steps=3)
    made = solving.make_solver
    monkeypatch.setattr(
        solving, "make_solver", lambda name, *told: bad if name == "cascade" else made(name, *told)
    )
    command = (files / "sheet.off", "-k", 4, "--solver", "cascade")
    with warnings.catch_warnings():
        warnings.simplefilter("always", SpectraKitWarning)
        out, err = printed(capsys, "spectrum", *command)
        proved = re.search(r"^verdict +(proved to be more than 10% too high: .*)$", out, re.M)
        assert f"warning: {proved[1]}; smooth it by --solver cascade, " in err
        warnings.simplefilter("ignore", SpectraKitWarning)
        result = record(capsys, "compare", *command)
        compared, _ = printed(capsys, "compare", *command)
    off = np.array(result["comparison"]["eigenvalue_error"][1:])
    worst = 1 + off.argmax()
    change = result["comparison"]["predicted_eigenvalues"][worst]
    change = 100 * (change / result["comparison"]["eigenvalues"][worst] - 1)
    assert result["verdict"].startswith(
        f"doubtful: {(off > 0.1).sum()} of 4 eigenvalues are off by more than 10%, that of mode"
        f" {worst}, by {change:+,.0f} %"
    )
    assert f"verdict: {result['verdict']}\n" in compared
    assert re.search(rf"^ *{worst}\*? .* {re.escape(f'{change:+.2g}')} %", compared, re.M)


def test_a_span_is_that_of_functions_that_were_used():
    """Smoothed modes are in no span but their own."""
    waves = AmbientFourier(m=64)
    assert ritz_subspace(RayleighRitz(subspace=waves)) is waves
    assert ritz_subspace(Neo(max_steps=0)) == Neo().subspace
    for solver in (Cascade(subspace=waves), Neo(), Neo(max_steps=0, coarsest=2000)):
        assert ritz_subspace(solver) is None


def test_two_runs_give_identical_eigenvalues_and_another_seed_others(files, capsys):
    """Of the demo, and of points that are sampled on a mesh."""
    for command in (("demo", "--points", 500), (files / "bumpy.off", "--cloud", 500)):
        first, second, other = (
            record(capsys, "spectrum", *command, "-k", 4, *seed)
            for seed in ((), ("--seed", 0), ("--seed", 1))
        )
        assert first["eigenvalues"] == second["eigenvalues"]
        # The solver's seed alone would change their last digits.
        assert not np.allclose(first["eigenvalues"], other["eigenvalues"], rtol=1e-6)
    assert first["geometry"] == {"kind": "cloud", "points": 500}


@pytest.mark.parametrize("operator", ["robust", "cotan", "knn", "delaunay"])
def test_operators(files, capsys, operator):
    """What `info` takes by default is the robust one to rounding, and needs less memory."""
    ball = files / "ball.off"
    found = record(capsys, "info", ball, "--operator", operator)["operator"]
    assert found["operator"].startswith(f"{operator}_laplacian(")
    usual = record(capsys, "info", ball)["operator"]
    assert usual["operator"].startswith("delaunay_laplacian(mesh")
    if operator == "robust":
        for fact in ("operator area", "operator components", "zero modes", "eigenvalue spacing"):
            assert found[fact] == pytest.approx(usual[fact], rel=1e-12)


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
    assert re.findall(r"^ {,3}(\d)  ", out, flags=re.M) == list("025")
    assert "zero modes                 2 of 2" in out


def test_info_and_repair(files, capsys):
    result = record(capsys, "info", files / "parts.ply")
    assert result["kind"] == "mesh"
    assert result["diagnosis"]["n_components"] == result["operator"]["zero modes"] == 2
    assert result["problems"] == []
    assert record(capsys, "info", files / "cloud.ply")["diagnosis"]["area"] is None
    dirty = files / "dirty.off"
    out, _ = printed(capsys, "info", dirty)
    assert "1 point lies exactly on an earlier one: --repair" in out
    assert "2 vertices join fans of faces that share no edge: use --operator robust" in out
    assert "refused" in out
    assert "without_" not in out
    assert "--repair" in refusal(capsys, "spectrum", dirty, "-k", 4)
    out, err = printed(capsys, "spectrum", dirty, "-k", 4, "--repair")
    assert err == "repaired: 1 merged point, 1 degenerate face, 1 unreferenced vertex\n"
    assert "642 vertices" in out
    _, err = printed(capsys, "info", files / "ball.off", "--repair")
    assert err == "repaired: nothing to do\n"


@pytest.mark.filterwarnings("always::spectra_kit.errors.SplitSurfaceWarning")
def test_info_tells_of_clouds_in_parts(tmp_path, capsys):
    turn = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(100)])
    np.save(tmp_path / "rings.npy", np.concatenate([ring, ring + [0, 0, 1]]))
    _, err = printed(capsys, "info", tmp_path / "rings.npy", "--operator", "knn")
    assert "warning: the cloud falls into 2 parts" in err


def test_compare_measures_a_prediction(files, capsys):
    told = record(capsys, "compare", files / "bumpy.off", "-k", 10, "--solver", "refined")
    result = told["comparison"]
    assert result["mean_span_error"] < 1e-12
    assert result["mean_vector_error"] < 1e-10
    assert result["mean_eigenvalue_error"] < 1e-9
    assert result["eigenvalue_error"][0] is None  # no NaN in JSON
    assert len(result["match"]) == 10
    assert result["span_dimension"] == 16  # six more modes were solved for
    assert result["open_from"] == 10  # so the end of the last cluster is known
    assert told["verdict"].startswith("farthest off is the eigenvalue of mode")
    assert told["predicted"]["verdict"] == told["reference"]["verdict"] == ""


def test_where_eigenvalues_coincide_the_means_are_those_of_spaces(files, capsys):
    """Each basis of an eigenspace is as good: the vectors of the two solvers differ freely."""
    ball = sphere(subdivisions=2).geometry
    write(joined(ball, moved(ball, 4, 0, 0), moved(ball, 8, 0, 0)), files / "three.off")
    command = ("compare", files / "three.off", "-k", 12, "--solver", "refined")
    comparison = record(capsys, *command)["comparison"]
    assert comparison["mean_vector_error"] > 0.1
    assert comparison["mean_cluster_error"] < 1e-20
    out, err = printed(capsys, *command)
    assert err == ""
    means = dict(re.findall(r"^(\w+ error) +(\S+)  mean", out, flags=re.M))
    assert list(means) == ["span error", "eigenvalue error", "cluster error", "eigenvector error"]
    assert float(means["cluster error"]) < 1e-20
    assert "three.off: mesh, 486 vertices" in out
    assert "exact (dense)  exact (refined)" in out
    assert re.search(r"mode +first +second +change", out)
    assert "errors are" not in out
    assert "predicted" not in out
    assert "picture" not in out


def test_options_reach_the_solvers_that_take_them():
    told = {
        "accuracy": ("0.25", "accuracy=0.25", {"automatic"}),
        "rtol": ("1e-4", "rtol=0.0001", {"refined"}),
        "start": ("random", "RandomBasis(", {"refined", "cascade"}),
        "device": ("cpu:0", "device='cpu:0'", {"neo", "cascade", "automatic"}),
        "poses": ("2", "poses=2", {"neo"}),
    }
    seeded = parse(["spectrum", "a", "--seed", "7"])[0]
    assert "seed=7" in repr(solving.make_solver("refined", seeded, 4))
    assert "seed=7" in repr(solving.make_solver("fourier", seeded, 4))
    for solver, (option, (value, text, takers)) in product(SOLVERS, told.items()):
        asked = parse(["spectrum", "a", "--solver", solver, f"--{option}", value])[0]
        if solver in takers:
            solving.check_solvers(asked, solver)
            assert text in repr(solving.make_solver(solver, asked, 4))
        else:
            with pytest.raises(InvalidInputError, match=f"--{option}` must go with"):
                solving.check_solvers(asked, solver)
    asked = parse(["compare", "a", "--solver", "refined", "--start", "neo", "--poses", "4"])[0]
    solving.check_solvers(asked, "arpack", "refined")  # one of the two takes it
    assert solving.make_solver("refined", asked, 4).start == Neo(poses=4).subspace


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
@pytest.mark.parametrize(
    ("solver", "start"), [("refined", "random"), ("cascade", "fourier"), ("cascade", "random")]
)
def test_every_start_is_enough_for_a_comparison_of_few_modes(files, capsys, solver, start):
    """A comparison solves for more modes than were asked for; the starts must span them."""
    command = ("compare", files / "sheet.off", "-k", 1, "--solver", solver, "--start", start)
    assert record(capsys, *command)["predicted"]["certificate"]["n_zero_modes"] == 1


def test_what_converged_is_saved(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(solving, "make_solver", lambda *_: Refined(max_sweeps=2))
    out = tmp_path / "modes.npz"
    command = ["spectrum", "demo", "--points", "600", "-k", "20", "--solver", "refined"]
    assert main([*command, "-o", str(out)]) == 3
    message = capsys.readouterr().err
    assert "; loosen --rtol, or use --solver arpack\n" in message
    assert not out.exists()
    rescued = Spectrum.load(tmp_path / "modes.partial.npz")
    converged = (rescued.certificate.relative_residuals <= 1e-8).sum()
    assert 0 < converged < rescued.k == 20
    assert f"20 modes, of which {converged} converged: " in message


@pytest.mark.filterwarnings("always::spectra_kit.errors.SplitSurfaceWarning")
def test_corners_that_are_not_joined_are_told(tmp_path, capsys) -> None:
    ball = sphere(subdivisions=1).geometry
    soup = TriangleMesh(ball.points[ball.faces.ravel()], np.arange(ball.faces.size).reshape(-1, 3))
    path = tmp_path / "soup.off"
    write(soup, path)
    _, told = printed(capsys, "spectrum", path, "-k", 3)
    assert "the surface falls into 80 parts, and has 1 if they are joined; join them with" in told
    assert told.rstrip().endswith("--repair")
    out, told = printed(capsys, "spectrum", path, "-k", 3, "--repair")
    assert told == "repaired: 198 merged points\n"
    assert "1 component" in out


def test_the_largest_part_alone(tmp_path, capsys) -> None:
    ball, speck = sphere(subdivisions=2).geometry, sphere(subdivisions=0).geometry
    write(joined(moved(speck, 2, 2, 2, scale=0.01), ball), tmp_path / "a.off")
    out, told = printed(capsys, "spectrum", tmp_path / "a.off", "-k", 3, "--largest")
    assert told == "the largest part: 162 points; 12 left out\n"
    assert "1 component" in out
