"""One HTML file with everything in it: geometry, modes, numbers, and what shows them."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.files import atomic_path, check_target
from spectra_kit._core.validate import check_count
from spectra_kit.eigen import Spectrum
from spectra_kit.eigen.metrics import Comparison, compare_spectra
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, GeometryLike, TriangleMesh
from spectra_kit.show.camera import View
from spectra_kit.show.colours import diverging_colours
from spectra_kit.show.contours import triangles_of
from spectra_kit.show.explorer.display import for_display, functions_of, normal_steps
from spectra_kit.show.explorer.payload import (
    LEVELS,
    colour_facts,
    comparison_facts,
    face_bytes,
    numbers,
    packed,
    quantised,
    renumbered,
    spectrum_facts,
    steps,
    walk,
)
from spectra_kit.show.render import ball_diameter
from spectra_kit.show.spectra import free_boundary

_BOX = 65535  # positions are this many steps along the longest side


@checked
@dataclass(frozen=True, kw_only=True)
class Explorer:
    """A page that was written, and how faithful it is.

    Attributes
    ----------
    path : Path
        The HTML file.
    n_points, n_shown : int
        Points of the geometry, and of what is drawn.
    n_modes : int
        Modes on the page.
    bytes : int
        Size of the file.
    quantisation : float
        Largest error of a value on the page from rounding to 16 bits, relative to the largest value
        of its mode.
    decimated : bool
        Whether fewer points are drawn than there are.
    """

    path: Path
    n_points: int
    n_shown: int
    n_modes: int
    bytes: int
    quantisation: float
    decimated: bool


@checked
def write_explorer(
    path: str | os.PathLike[str],
    geometry: GeometryLike,
    exact: Spectrum,
    predicted: Spectrum | None = None,
    *,
    comparison: Comparison | None = None,
    names: tuple[str, str] | None = None,
    title: str = "",
    max_points: int = 50_000,
    view: View = View(),
    progress: Callable[[int, int], None] | None = None,
) -> Explorer:
    """Write a page on which modes can be turned, compared and leafed through.

    It opens in any browser of today, from the disk, without a network.

    Parameters
    ----------
    path : path-like
        The ``.html`` file to write, whole or not at all.
    geometry : TriangleMesh or PointCloud
        The n points that the spectra live on.
    exact : Spectrum
        Shown alone, or beside `predicted`.
    predicted : Spectrum, optional
        Another spectrum on the same points; the page then shows both and their difference.
    comparison : Comparison, optional
        Of these two; by default ``compare_spectra(exact, predicted)``. Its k modes are shown.
    names : tuple of str, optional
        What to call the two; by default "exact", or "approximate" where the solver of `exact` goes
        on for no more, and "predicted".
    title : str, optional
        At the head of the page.
    max_points : int, default 50000
        A geometry with more points is drawn with at most about as many: a mesh after
        quadric decimation, with values interpolated at the closest points of the full mesh, a cloud
        thinned evenly. The numbers on the page are those of the full geometry.
    view : View, optional
        Where it is seen from at first.
    progress : callable, optional
        Called with the steps done and their number, after each.

    Notes
    -----
    Modes have the scale and the signs of `plot_modes`, and predicted ones are aligned to the exact
    by `align_modes`, for display only. Positions are rounded to 1/65535 of the longest side, values
    to 1/65534 of the range of their mode. Equal input makes equal files.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from spectra_kit import eigensolve, robust_laplacian
    >>> from spectra_kit.show.explorer import write_explorer
    >>> from spectra_kit.geometry import sphere
    >>> ball = sphere(subdivisions=2).geometry
    >>> spectrum = eigensolve(robust_laplacian(ball), 4)
    >>> with TemporaryDirectory() as folder:
    ...     explorer = write_explorer(Path(folder) / "ball.html", ball, spectrum)
    >>> explorer.n_shown, explorer.n_modes, explorer.quantisation < 1 / 65534
    (162, 4, True)
    """
    _check(path, geometry, exact, predicted, comparison)
    check_count("max_points", max_points, low=4)
    done = count(1)

    def tell() -> None:
        if progress is not None:
            progress(next(done), 4)

    if predicted is not None and comparison is None:
        comparison = compare_spectra(exact, predicted)
    functions = functions_of(exact, predicted, comparison)
    k = functions[0].shape[1]
    tell()

    drawn, carry = for_display(geometry, max_points)
    tell()

    order = walk(drawn)
    carried = [np.asarray((carry @ f)[order]) for f in functions]
    scale = np.max([np.abs(f).max(axis=0) for f in carried], axis=0)
    values = [quantised(f, scale) for f in carried]
    errors = [np.abs(v * (scale / LEVELS) - f) for v, f in zip(values, carried, strict=True)]
    tell()

    palette = diverging_colours(np.linspace(-1.0, 1.0, 256))
    facts = {
        "title": title,
        "names": list(names or (_called(exact), "predicted")),
        "points": geometry.n,
        "area": exact.area,
        "boundary": free_boundary(geometry, exact),
        "first": min(exact.n_zero_modes, k - 1),
        "decimated": drawn.n < geometry.n,
        "palette": base64.b64encode(palette.tobytes()).decode("ascii"),
        **_first_view(geometry, view),
        "exact": spectrum_facts(exact.truncate(k), np.arange(k)),
        "colours": colour_facts(functions[0], functions[1] if predicted else None, scale),
    }
    if predicted is not None and comparison is not None:
        facts["predicted"] = spectrum_facts(predicted, comparison.match)
        facts["comparison"] = comparison_facts(comparison)
    size = _write(path, facts, drawn, order, values)
    tell()
    return Explorer(
        path=Path(path),
        n_points=geometry.n,
        n_shown=drawn.n,
        n_modes=k,
        bytes=size,
        quantisation=float(np.max(errors / np.where(scale > 0, scale, 1))),
        decimated=drawn.n < geometry.n,
    )


def _check(
    path: str | os.PathLike[str],
    geometry: Geometry,
    exact: Spectrum,
    predicted: Spectrum | None,
    comparison: Comparison | None,
) -> None:
    """Refuse what cannot become a page, before any work is done."""
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise InvalidInputError("path", "end in .html", repr(os.fspath(path)))
    check_target(path)
    if geometry.n != exact.n:
        raise InvalidInputError(
            "geometry", f"have the {exact.n} points of the spectrum", geometry.n
        )
    if exact.k == 0:
        raise InvalidInputError("exact", "have at least one mode to show", "none")
    if comparison is None:
        return
    if predicted is None:
        raise InvalidInputError(
            "comparison", "be of two spectra", "one", advice="pass `predicted` as well"
        )
    if comparison.k > exact.k or comparison.match.max(initial=0) >= predicted.k:
        raise InvalidInputError(
            "comparison",
            f"be of these spectra of {exact.k} and {predicted.k} modes",
            f"one of {comparison.k} modes, matched to as many as {comparison.match.max() + 1}",
        )


def _called(spectrum: Spectrum) -> str:
    """Return what the first spectrum is called where nobody has named it."""
    return "approximate" if spectrum.provenance.accuracy == "approximate" else "exact"


def _first_view(geometry: Geometry, view: View) -> dict[str, Any]:
    """Where the viewer stands at first, and the axis around which a drag turns."""
    right, _, towards = view.rotation(geometry)
    vertical = np.eye(3)[np.argmin(np.abs(right))]  # the view is level: only this one is across
    return {"towards": numbers(towards), "vertical": vertical.tolist()}


def _write(
    path: str | os.PathLike[str],
    facts: dict[str, Any],
    geometry: Geometry,
    order: NDArray[np.int64],
    functions: list[NDArray[np.int16]],
) -> int:
    """Write the file; return its size in bytes."""
    points = geometry.points[order]
    low, side = points.min(axis=0), float(np.ptp(points, axis=0).max()) or 1.0
    positions = np.round((points - low) * (_BOX / side)).astype(np.int64)
    # The page draws in a box of side one: it needs the form, and numbers of a fit size.
    facts["box"] = (np.ptp(points, axis=0) / side).tolist()
    facts["shown"] = geometry.n
    facts["diameter"] = ball_diameter(geometry) / side
    parts = [steps(positions, 16)]
    triangles = renumbered(triangles_of(geometry), order)
    if isinstance(geometry, TriangleMesh):
        facts["faces"] = len(triangles)
    else:  # they carry its nodal lines alone
        facts |= {"faces": 0, "stars": len(triangles)}
        parts.append(steps(normal_steps(geometry)[order], 16))
    blocks = {"geometry": packed(*parts, face_bytes(triangles))}
    for name, values in zip(("exact", "predicted"), functions, strict=False):
        blocks[name] = packed(steps(values, 16))
    text = assembled(facts, blocks).encode("utf-8")
    with atomic_path(path) as part:
        part.write_bytes(text)
    return len(text)


def assembled(facts: dict[str, Any], blocks: dict[str, str]) -> str:
    """The template with everything in its place."""
    script = _asset("explorer.js").replace("</script", "<\\/script")
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    # Inside <script> only "<" could end the block; JSON may write it as an escape.
    record = json.dumps(facts, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    data = "\n".join(
        f'<script type="application/octet-stream" id="{name}">{text}</script>'
        for name, text in blocks.items()
    )
    content = {
        "TITLE": html.escape(facts["title"] or "Spectrum explorer"),
        "DIGEST": digest,
        "STYLE": _asset("explorer.css"),
        "FACTS": record,
        "DATA": data,
        "SCRIPT": script,
    }
    # One pass: what is put in is not searched again.
    return re.sub(r"%%([A-Z]+)%%", lambda m: content[m[1]], _asset("explorer.html"))


@cache
def _asset(name: str) -> str:
    return (resources.files("spectra_kit.show.explorer") / "assets" / name).read_text("utf-8")
