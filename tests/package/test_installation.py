"""Installed, used, installed again and removed, in an environment of its own, as a user would."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Without the package's own folder as the current one, which would be found first.
WHERE = "import spectra_kit as sk; print(sk.__file__)"
# Walks along edges in a compiled loop.
USE = """
import numpy as np
ball = sk.geometry.sphere(subdivisions=1).geometry
sk.maps.map_errors(
    ball, np.arange(ball.n)[::-1], sk.maps.Truth.of_map(np.arange(ball.n))
)
"""


@pytest.mark.slow
def test_the_commands_of_the_readme_one_after_the_other(tmp_path: Path) -> None:
    """A copy, an editable one on top of it, none: each finds what it should and leaves nothing."""
    source = tmp_path / "source"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "spectra_kit", source / "spectra_kit", ignore=ignored)
    for name in ("README.md", "LICENSE", "pyproject.toml"):
        shutil.copy(ROOT / name, source / name)
    environment = tmp_path / "environment"
    python = str(environment / "bin" / "python")

    def run(*command: str) -> subprocess.CompletedProcess[str]:
        quiet = {"PYTHONPATH", "NUMBA_CACHE_DIR"}
        return subprocess.run(
            command,
            cwd=tmp_path,
            env={k: v for k, v in os.environ.items() if k not in quiet}
            | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"},
            capture_output=True,
            text=True,
        )

    def install(*what: str) -> None:
        done = run(
            *(python, "-m", "pip", "install", "--no-deps", "--no-build-isolation"),
            *("--no-index", *what),
        )
        assert done.returncode == 0, done.stderr

    def used(code: str = "") -> Path:
        done = run(python, "-c", f"{WHERE}\n{code}")
        assert done.returncode == 0, done.stderr
        return Path(done.stdout.strip()).parent

    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
    (site,) = environment.glob("lib/python*/site-packages")
    # The dependencies, pip and setuptools are those that run this test.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")

    install(str(source))
    assert used(USE) == site / "spectra_kit"
    assert list((tmp_path / "cache").rglob("*.nbc"))  # it did compile, and keep it elsewhere
    assert not list(site.rglob("*.nb[ci]"))

    install("-e", str(source))
    assert used() == source / "spectra_kit"
    assert not list(source.rglob("*.nb[ci]"))

    assert run(python, "-m", "pip", "uninstall", "-y", "spectra_kit").returncode == 0
    # Nothing is left of either; a bare folder would shadow the next installation.
    assert not [path.name for path in site.iterdir() if "spectra" in path.name]


@pytest.mark.parametrize("page", ["README.md", "docs/quickstart.md", "CONTRIBUTING.md"])
def test_the_first_installation_brings_no_cuda(page: str) -> None:
    """The same index on all pages, each of which may be the first that is followed."""
    first = (ROOT / page).read_text().split("-m venv .venv")[1].split("```")[0]
    assert "--extra-index-url https://download.pytorch.org/whl/cpu" in first
