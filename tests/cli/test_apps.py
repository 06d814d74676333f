import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from spectra_kit.geometry import sample, sphere, write

APPS = Path(__file__).parents[2] / "apps"


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
    code = compare_modes(["--points", "800", "-k", "8", "--solver", "fourier"])
    check_picture("compare_modes.png", code, *capsys.readouterr())


def test_compare_modes_of_a_cloud(compare_modes, tmp_path, capsys):
    file, picture = tmp_path / "cloud.ply", tmp_path / "cloud.png"
    write(sample(sphere(subdivisions=3).geometry, 800, seed=0), file)
    code = compare_modes(
        [str(file), "-k", "6", "--solver", "fourier", "--modes", "1", "--picture", str(picture)]
    )
    check_picture(picture, code, *capsys.readouterr())


def test_apps_explain_themselves():
    command = [sys.executable, str(APPS / "compare_modes.py"), "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "exact | predicted | difference" in done.stdout
    assert done.stderr == ""
