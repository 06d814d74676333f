import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from spectra_kit.geometry import creature, sample, sphere, write

APPS = Path(__file__).parents[1] / "apps"


def load(name):
    specification = importlib.util.spec_from_file_location(name, APPS / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def compare_modes():
    return load("compare_modes").main


def check_picture(path, code, out, err):
    if code == 2 and "OpenGL" in err:
        pytest.skip("no OpenGL library on this machine")
    assert code == 0, err
    assert out.rstrip().endswith(f"picture: {path}")
    assert "eigenvector error" in out
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        assert min(picture.size) > 500


def test_compare_modes_without_arguments_draws_the_demo(
    compare_modes, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    code = compare_modes(["--points", "1500", "-k", "8", "--solver", "fourier"])
    check_picture("compare_modes.png", code, *capsys.readouterr())


def test_compare_modes_of_a_cloud(compare_modes, tmp_path, capsys):
    file, picture = tmp_path / "cloud.ply", tmp_path / "cloud.png"
    write(sample(sphere(subdivisions=3).geometry, 1500, seed=0), file)
    code = compare_modes(
        [str(file), "-k", "6", "--solver", "fourier", "--modes", "1", "--picture", str(picture)]
    )
    check_picture(picture, code, *capsys.readouterr())


def test_apps_explain_themselves():
    command = [sys.executable, str(APPS / "compare_modes.py"), "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "exact | predicted | difference" in done.stdout
    assert done.stderr == ""


def test_evaluate_prints_errors_and_means(tmp_path, capsys):
    for seed in (0, 1):
        write(creature(1500, seed=seed), tmp_path / f"animal{seed}.ply")
    evaluate = load("evaluate").main
    options = ["--points", "1200", "-k", "20", "--poses", "--bandwidth", "5"]
    assert evaluate([str(tmp_path), *options, "--fourier", "60", "200"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert [row[0] for row in rows] == ["animal0"] * 2 + ["animal1"] * 2 + ["mean"] * 2
    few, many = (float(row[-5]) for row in rows[-2:])
    assert many < 0.1 * few
    assert many == pytest.approx(np.mean([float(row[-5]) for row in rows[1:4:2]]), rel=0.1)


def test_evaluate_refuses_what_is_no_mesh(tmp_path, capsys):
    write(sample(sphere().geometry, 100, seed=0), tmp_path / "cloud.xyz")
    assert load("evaluate").main([str(tmp_path), "--poses"]) == 2
    assert "expected a mesh" in capsys.readouterr().err
