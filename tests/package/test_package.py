"""What one meets first: the names of the package, its help, its start and Ctrl-C."""

import pydoc
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import spectra_kit as sk
from spectra_kit import metrics
from spectra_kit.correspondence import Truth, map_errors
from spectra_kit.geometry import components, normalize, repair, sample_with_origin, sphere

ROOT = Path(__file__).parents[2]


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)


def test_every_part_is_at_hand_and_none_is_imported_before() -> None:
    done = run(
        "import sys, spectra_kit as sk;"
        "print(sorted({m.split('.')[0] for m in sys.modules} & {'numpy', 'scipy', 'torch'}));"
        "print(sk.viz.plot_modes.__name__, sk.interop.__name__, sk.metrics.__name__);"
        "print(sorted({'torch', 'pyvista', 'matplotlib'} & set(sys.modules)))"
    )
    assert done.stdout.split("\n")[:3] == [
        "[]",
        "plot_modes spectra_kit.interop spectra_kit.metrics",
        "[]",
    ], done.stderr


def test_the_version_is_that_of_the_project() -> None:
    from spectra_kit._version import VERSION

    assert sk.__version__ == VERSION


def test_every_name_is_there() -> None:
    for name in dir(sk):
        assert getattr(sk, name) is not None
    names: dict[str, object] = {}
    exec("from spectra_kit import *", names)
    assert set(dir(sk)) <= set(names)


def test_a_name_that_is_not_there() -> None:
    with pytest.raises(AttributeError, match="eigensolver"):
        sk.eigensolver  # noqa: B018


def test_the_help_begins_with_what_there_is() -> None:
    assert "help(sk.eigensolve)" in pydoc.render_doc(sk)[:3000]


def values() -> list[object]:
    mesh = sphere(subdivisions=3).geometry
    laplacian = sk.robust_laplacian(mesh)
    spectrum = sk.eigensolve(laplacian, 40)
    prepared = sk.prepare(spectrum, mesh)
    truth = Truth.of_map(np.arange(mesh.n))
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
        sk.GivenBasis(spectrum.eigenvectors),
        sk.HeatGeodesics(mesh).distance(0),
        sk.intrinsic_delaunay(mesh),
    ]


def test_what_is_printed_of_a_value_is_short() -> None:
    shown = {type(value).__name__: repr(value) for value in values()}
    assert {name: text for name, text in shown.items() if len(text) > 600 or "\n" in text} == {}
    assert (
        "stiffness=<sparse (642, 642), 4482 entries>, mass=<float64 (642,)>" in shown["Laplacian"]
    )


@pytest.mark.parametrize(
    "module",
    ["spectra_kit.cli", "numpy", "scipy.sparse", "spectra_kit.eigensolvers", "cyclopts"],
)
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


def test_the_installed_command_starts_like_the_module() -> None:
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["scripts"] == {"spectra-kit": "spectra_kit.__main__:main"}


def test_reading_the_command_line_waits_for_no_number() -> None:
    done = run(
        "import sys; from spectra_kit.cli.program import COMMANDS, parse; parse(['info', 'demo']);"
        "from spectra_kit.cli.help import help_text; text = [help_text(c) for c in COMMANDS];"
        "heavy = {'numpy', 'scipy', 'numba', 'rich'};"
        "print(sorted({m.split('.')[0] for m in sys.modules} & heavy));"
        "print(all(callable(c.load()) for c in COMMANDS))"
    )
    assert done.stdout.split() == ["[]", "True"], done.stderr
