"""Values show themselves in notebooks, draw themselves, and go back to PyVista."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from conftest import bumpy
from test_package import values

import spectra_kit as sk
from spectra_kit.errors import InvalidInputError
from spectra_kit.interop import to_pyvista


def test_tables_are_small_and_well_formed() -> None:
    shown = {type(v).__name__: v._repr_html_() for v in values() if hasattr(v, "_repr_html_")}
    assert {"Spectrum", "Certificate", "Match", "DistanceField", "TriangleMesh"} <= set(shown)
    for name in set(shown) - {"TriangleMesh", "PointCloud"}:
        rows = ElementTree.fromstring(shown[name]).findall("tr")
        assert rows
        assert len(shown[name]) < 4000, name


def test_a_spectrum_shows_its_eigenvalues(bumpy_laplacian) -> None:
    spectrum = sk.eigensolve(bumpy_laplacian, 20)
    html = spectrum._repr_html_()
    assert f"{spectrum.eigenvalues[1]:.6g}" in html
    assert f"{spectrum.eigenvalues[-1]:.6g}" in html
    assert "verified" in html
    assert "none" in sk.Spectrum([0.0], [[1.0]], [1.0])._repr_html_()


def test_geometries_and_spectra_draw_themselves(tmp_path: Path) -> None:
    mesh = bumpy()
    for thing in (mesh, mesh.as_cloud(), sk.spectrum(mesh, 4)):
        thing.plot(tmp_path / "drawn.png")
        assert (tmp_path / "drawn.png").read_bytes().startswith(b"\x89PNG")
        assert "image/png" in thing.plot()._repr_mimebundle_()
    assert mesh._repr_html_().startswith('<img src="data:image/png;base64,iVBOR')


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
