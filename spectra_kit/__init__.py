"""Certified Laplace-Beltrami spectra of meshes and point clouds.

>>> import spectra_kit as sk
>>> laplacian = sk.robust_laplacian(sk.geometry.sphere(subdivisions=3).geometry)
>>> spectrum = sk.eigensolve(laplacian, 9)
>>> spectrum.eigenvalues.round(1)
array([0., 2., 2., 2., 6., 6., 6., 6., 6.])

A file becomes a geometry (`read`), a geometry a `Laplacian` (`robust_laplacian` and others), that
a `Spectrum` (`eigensolve`, with the backend of your choice), and a spectrum everything else: two of
them a map from one surface to the other (`match`), one of them quicker distances along its surface
(`HeatGeodesics`).

Conventions, everywhere the same:

- Letters: n points, f faces, k modes, m basis functions.
- Rows are points: ``points (n, 3)``, ``faces (f, 3)``, ``eigenvectors (n, k)``, ``basis (n, m)``.
- L is the positive semi-definite weak Laplacian, M the lumped mass: ``L u = lambda M u``.
- Units are the input's: eigenvalues in 1/length^2, mass in length^2, eigenvectors in 1/length.
- Eigenvectors are M-orthonormal; their signs, and bases inside an eigenspace, are unspecified.
- Of two surfaces the first is the source, the second the target. ``point_map (n2,)`` holds the
  source point of each target point; ``functional_map (k2, k1)`` takes functions the other way.

``dir(sk)`` lists all names, and ``help(sk.eigensolve)`` tells about one of them. A file becomes a
spectrum in one line, too: ``sk.spectrum("bunny.obj", 50)``.
"""

from difflib import get_close_matches as _near
from importlib.util import find_spec as _find_spec
from typing import Any as _Any

import lazy_loader

from spectra_kit._core import shown as _shown
from spectra_kit._core.version import VERSION

__version__ = VERSION

# The names stand in __init__.pyi, where type checkers look as well. They are imported when they are
# first asked for: a command that needs little starts at once, torch and pyvista wait.
_get, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def _plots() -> _Any:
    from spectra_kit import show

    return show


_shown.plots = _plots  # by which geometries, spectra and distances draw themselves


def __getattr__(name: str) -> _Any:
    if name in __all__:
        return _get(name)
    if name.startswith("_") or _find_spec(f"spectra_kit.{name}"):
        # Asked for by tools, of whatever they meet, and by imports of modules.
        raise AttributeError(f"spectra_kit has no attribute {name!r}; it may be a module to import")
    place = next((room for room in _ROOMS if name in dir(_room(room))), None)
    near = [f"{place}.{name}"] if place else _near(name, __all__, 2)
    hint = "dir(spectra_kit) lists what it has"
    if near:
        hint = f"did you mean {' or '.join(f'sk.{other}' for other in near)}?"
    raise AttributeError(f"spectra_kit has no attribute {name!r}; {hint}")


# Where a name may be that is not here, the quick to import first; none imports torch.
_ROOMS = ("errors", "eigen.subspaces", "eigen", "operators", "geometry", "geodesics", "features")
_ROOMS += ("eigen.metrics", "maps", "datasets", "show", "interop")


def _room(place: str) -> _Any:
    first, _, rest = place.partition(".")
    return getattr(_get(first), rest) if rest else _get(first)
