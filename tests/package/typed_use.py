"""What users write passes a type checker: `mypy` reads this file, and nothing runs it.

An ignored error that is none is an error.
"""

from pathlib import Path

import spectra_kit as sk


def use(mesh: sk.TriangleMesh) -> None:
    """Give what becomes a geometry for one, and what becomes nothing of the kind."""
    for given in (mesh, "bunny.obj", Path("bunny.obj"), (mesh.points, mesh.faces), mesh.points):
        spectrum: sk.Spectrum = sk.spectrum(given, 40)
        operator: sk.Laplacian = sk.laplacian(given)
        sk.eigensolve(operator, 40, sk.Lanczos())
        sk.HeatGeodesics(given, spectrum).distance([0, 1]).distance.max()
        sk.show.plot_modes(given, spectrum, path="modes.png")
        sk.match(given, sk.prepare(spectrum, given), mirrored=False).point_map.max()
    sk.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    sk.operators.laplacian_many(["a.obj", mesh])
    sk.spectrum(mesh, "40")  # type: ignore[arg-type]
    sk.spectrum(mesh, 40, "arpack")  # type: ignore[arg-type]
