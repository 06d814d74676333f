"""What one meets first: the names of the package, its start, Ctrl-C, and what values show."""

import pydoc
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import bumpy

import spectra_kit as sk
from spectra_kit._core.version import VERSION
from spectra_kit.eigen import metrics
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import components, normalize, repair, sample_with_origin, sphere
from spectra_kit.interop import to_pyvista
from spectra_kit.maps import Truth, map_errors

ROOT = Path(__file__).parents[2]


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)


def test_nothing_is_imported_before_it_is_asked_for() -> None:
    """By the package, its catalogue, commands and their help, arrays; nor by other commands."""
    done = run(
        "import sys, spectra_kit as sk\n"
        "def there(*names): print(*({m.split('.')[0] for m in sys.modules} & {*names}))\n"
        "from spectra_kit import catalogue\n"
        "from spectra_kit.cli.program import COMMANDS, app, help_text, parse\n"
        "text = help_text('--help')\n"
        "there('numpy', 'scipy', 'torch', 'numba', 'rich')\n"
        "asked = parse(['spectrum', 'demo'])\n"
        "print(*{'spectra_kit.cli.match', 'spectra_kit.cli.geodesic'} & {*sys.modules})\n"
        "program = app(*COMMANDS)\n"
        "there('scipy', 'torch', 'numba', 'rich')\n"
        "sk.as_geometry([[0, 0, 0]])\n"
        "print(sk.show.plot_modes.__name__, sk.interop.__name__, sk.eigen.metrics.__name__)\n"
        "there('torch', 'pyvista', 'vtk', 'vtkmodules', 'matplotlib', 'trimesh')"
    )
    names = "plot_modes spectra_kit.interop spectra_kit.eigen.metrics"
    assert done.stdout.split("\n")[:5] == ["", "", "", names, ""], done.stderr


def test_modes_of_a_closed_mesh_import_nothing_that_they_do_not_need() -> None:
    done = run(
        "import sys, spectra_kit as sk\n"
        "laplacian = sk.laplacian(sk.geometry.sphere(subdivisions=3).geometry)\n"
        "for solver in (sk.eigen.Lanczos(), sk.eigen.Cascade(target=0.01)):\n"
        "    sk.eigensolve(laplacian, 9, solver)\n"
        "print({'torch', 'matplotlib', 'scipy.spatial', 'scipy.special'} & {*sys.modules})"
    )
    assert done.stdout == "set()\n", done.stderr


def test_a_run_over_shapes_does_not_wait_for_what_matches_them() -> None:
    done = run(
        "import sys; import spectra_kit as sk; sk.datasets.compute_all\n"
        "print('spectra_kit.datasets.run' in sys.modules, 'spectra_kit.maps' in sys.modules)"
    )
    assert done.stdout == "True False\n", done.stderr


def test_metrics_are_there_without_an_import() -> None:
    done = run("import spectra_kit as sk; print(sk.eigen.metrics.align_modes.__name__)")
    assert done.stdout == "align_modes\n", done.stderr


def test_every_name_is_there() -> None:
    for name in dir(sk):
        assert getattr(sk, name) is not None
    names: dict[str, object] = {}
    exec("from spectra_kit import *", names)
    assert set(dir(sk)) <= set(names)
    for name, place in {
        "eigensolver": "eigensolve",
        "ConvergenceError": "errors.ConvergenceError",
        "GivenBasis": "eigen.subspaces.GivenBasis",
        "Plan": "datasets.Plan",
        "align_to_template": "eigen.metrics.align_to_template",
    }.items():
        with pytest.raises(AttributeError, match=rf"did you mean sk\.{place}\b"):
            getattr(sk, name)
    assert "help(sk.eigensolve)" in pydoc.render_doc(sk)[:3000]


def test_the_installed_command_starts_like_the_module() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["scripts"] == {"spectra-kit": "spectra_kit.__main__:main"}
    assert sk.__version__ == VERSION


@cache
def values() -> list[object]:
    mesh = sphere(subdivisions=3).geometry
    laplacian = sk.robust_laplacian(mesh)
    spectrum = sk.eigensolve(laplacian, 40)
    prepared = sk.prepare(spectrum, mesh)
    truth = Truth.of_map(np.arange(mesh.n))
    with pytest.warns(
        sk.errors.DoubtfulMatchWarning, match="alike"
    ):  # all turns of a ball are right
        found = sk.match(prepared, prepared)
    return [
        mesh,
        mesh.as_cloud(),
        laplacian,
        spectrum,
        spectrum.certificate,
        spectrum.provenance,
        sphere(subdivisions=3),
        repair(mesh),
        components(mesh)[0],
        normalize(mesh)[1],
        sample_with_origin(mesh, 500, seed=0),
        metrics.compare_spectra(spectrum, spectrum),
        prepared,
        prepared.surface,
        found,
        found.candidates[0],
        truth,
        map_errors(mesh, found.point_map, truth),
        sk.eigen.subspaces.GivenBasis(spectrum.eigenvectors),
        sk.HeatGeodesics(mesh).distance(0),
        sk.intrinsic_delaunay(mesh),
    ]


def test_what_is_shown_of_a_value_is_short() -> None:
    printed = {type(value).__name__: repr(value) for value in values()}
    assert {name: text for name, text in printed.items() if len(text) > 600 or "\n" in text} == {}
    assert (
        "stiffness=<sparse (642, 642), 4482 entries>, mass=<float64 (642,)>" in printed["Laplacian"]
    )
    drawn = (sk.TriangleMesh, sk.PointCloud)
    tables = {type(v).__name__: v._repr_html_() for v in values() if not isinstance(v, drawn)}
    assert {"Spectrum", "Certificate", "Match", "DistanceField"} <= set(tables)
    for name, shown in tables.items():
        rows = ElementTree.fromstring(shown).findall("tr")
        assert rows
        assert len(shown) < 4000, name
        assert "mappingproxy" not in shown
    spectrum = next(value for value in values() if isinstance(value, sk.Spectrum))
    assert f"{spectrum.eigenvalues[1]:.6g}" in tables["Spectrum"]
    assert "verified" in tables["Spectrum"]
    assert "none" in sk.Spectrum([0.0], [[1.0]], [1.0])._repr_html_()


def test_values_draw_themselves(tmp_path: Path) -> None:
    ball = sphere(subdivisions=1).geometry
    ball.as_cloud().plot(tmp_path / "drawn.png")
    field = sk.geodesic_distance(ball, 0)
    drawn = [sk.spectrum(ball, 4).plot().content, field.plot(ball).content]
    for content in ((tmp_path / "drawn.png").read_bytes(), *drawn):
        assert content.startswith(b"\x89PNG")
    assert ball._repr_html_().startswith('<img src="data:image/png;base64,iVBOR')


def test_results_go_back_to_pyvista(bumpy_laplacian) -> None:
    mesh, spectrum = bumpy(), sk.eigensolve(bumpy_laplacian, 3)
    there = to_pyvista(mesh, mode=spectrum, field=mesh.points, height=mesh.points[:, 2])
    assert there.point_data.keys() == ["mode_0", "mode_1", "mode_2", "field", "height"]
    assert np.array_equal(there.point_data["mode_2"], spectrum.eigenvectors[:, 2])
    back = sk.as_geometry(there)
    assert np.array_equal(back.points, mesh.points)
    assert np.array_equal(back.faces, mesh.faces)
    assert to_pyvista(mesh.as_cloud()).n_points == mesh.n
    with pytest.raises(InvalidInputError) as error:
        to_pyvista(mesh, height=[1.0])
    assert (error.value.argument, error.value.got) == ("height", "shape (1,) of float64")


@pytest.mark.parametrize("module", ["spectra_kit.cli", "numpy", "cyclopts", "spectra_kit.eigen"])
def test_ctrl_c_while_it_starts_ends_it_quietly(module: str) -> None:
    """As if the key were pressed when `module` is looked for."""
    done = run(
        "import os, runpy, signal, sys\n"
        "class Pressed:\n"
        "    def find_spec(self, name, *rest):\n"
        f"        if name == {module!r}:\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Pressed())\n"
        "sys.argv = ['spectra-kit', 'info', 'demo']\n"
        "runpy.run_module('spectra_kit', run_name='__main__')\n"
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
