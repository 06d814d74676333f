"""Eigenvalues against their number, with Weyl's law, what is certain of them, and differences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.types import Floats
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.show.layout import Page, line_style, log_ticks, new_diagram, short, tidy
from spectra_kit.show.picture import PathLike, plotted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_WIDTH = 8.0  # inches
_FLOOR = 1e-17  # of relative numbers: below there is only rounding
_HEADROOM = 1.5  # bars reach this times the largest eigenvalue, and are cut off there
_SAME_AREA = 0.01  # relative: such spectra share one line of Weyl's law
# Of each spectrum its marker, and the size of it: where several coincide, each one shows.
_MARKERS = (("o", 3.2), ("s", 5.6), ("D", 7.0), ("^", 9.0), ("v", 10.5), ("p", 12.0))
_MANY = 120  # modes: more than so many get smaller markers


@plotted
def plot_spectrum(
    spectra: Spectrum | Mapping[str, Spectrum],
    *,
    path: PathLike | None = None,
    page: Page = Page(),
    weyl: bool = True,
    free_boundary: float = 0.0,
) -> Figure:
    """Draw eigenvalues against their number, what is certain of them, and how they differ.

    Parameters
    ----------
    spectra : Spectrum or mapping of str to Spectrum
        One, or several under their names. The others are compared with the first.
    $path
    $page
    weyl : bool, default True
        Draw the line of Weyl's law.
    free_boundary : float, default 0
        Length of the boundary along which the surface ends freely (Neumann), less the length along
        which it is held at zero (Dirichlet): Weyl's law then has its second term. Of one surface,
        so all spectra must have its area.

    $returns

    Notes
    -----
    **Bars** reach as far as the residuals of the certificate, ``lambda +- ||L u - lambda M u||``
    (in 1/length^2): some true eigenvalue lies within them, which need not be that of the same
    number. They end at zero, below which there is none; where they leave the panel, the legend
    says how many do. Those of an exact solver are too short to be seen: the panel below has their
    length relative to the eigenvalue (see `Certificate`), on a logarithmic axis. Its full markers
    are modes that `verify` has proved to be the ones of their number, its open ones are not.

    **Weyl's law**, ``lambda_j ~ 4 pi j / area`` (Weyl, 1911), is what eigenvalues of a surface
    approach. A boundary shifts them, by a share that fades with j: below the line where the surface
    ends freely, above it where it is held; with `free_boundary` b the line is that of
    ``j = (area lambda + b sqrt(lambda)) / (4 pi)`` (Ivrii, 1980). Points too few for the last modes
    shift them, too.

    **Differences** to the first spectrum are those of the same number, relative to its eigenvalue,
    zero modes left out; the triangles point upwards where the eigenvalue is larger.

    References
    ----------
    H. Weyl, "Ueber die asymptotische Verteilung der Eigenwerte", Nachrichten der Gesellschaft der
    Wissenschaften zu Goettingen, 1911.
    V. Ya. Ivrii, "Second term of the spectral asymptotic expansion of the Laplace-Beltrami operator
    on manifolds with boundary", Functional Analysis and Its Applications 14, 1980.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> from spectra_kit.show import Page, plot_spectrum
    >>> laplacian = sk.robust_laplacian(sk.geometry.sphere(subdivisions=2).geometry)
    >>> plot_spectrum(sk.eigensolve(laplacian, 9), page=Page(dpi=40))
    Picture(path=None)
    """
    named = {"": spectra} if isinstance(spectra, Spectrum) else spectra
    if not isinstance(named, Mapping) or not all(isinstance(s, Spectrum) for s in named.values()):
        expected = "be a Spectrum or a mapping of names to Spectrum objects"
        kind, advice = f"a {type(spectra).__name__}", "write {'name': spectrum}"
        raise InvalidInputError("spectra", expected, kind, advice=advice)
    if not named:
        raise InvalidInputError("spectra", "hold at least one Spectrum", "none")
    for name, spectrum in named.items():
        if not spectrum.k:
            raise InvalidInputError("spectra", "have modes", f"none in {name or 'it'!r}")
    if not np.isfinite(free_boundary):
        raise InvalidInputError("free_boundary", "be a finite length", repr(free_boundary))
    if free_boundary and len(areas := _areas(named)) > 1:
        listed = ", ".join(f"{area:.4g}" for area in areas)
        got, advice = f"{free_boundary:g} for spectra of the areas {listed}", "draw them one by one"
        raise InvalidInputError("free_boundary", "be of one surface", got, advice=advice)
    certified = any(spectrum.certificate is not None for spectrum in named.values())
    first, *others = named.values()
    comparable = any(min(first.k, other.k) > first.n_zero_modes for other in others)
    below = [_draw_residuals] * certified + [_draw_differences] * comparable
    heights = [4.2] + [1.75] * len(below)
    figure = new_diagram(page, _WIDTH, sum(heights))
    (panels,) = figure.subplots(
        len(heights), 1, sharex=True, squeeze=False, height_ratios=heights
    ).T
    if weyl:
        _draw_weyl(panels[0], named, free_boundary)
    _draw_eigenvalues(panels[0], named)
    for panel, draw in zip(panels[1:], below, strict=True):
        draw(panel, named)
    last = max(spectrum.k for spectrum in named.values()) - 1
    margin = 0.015 * last + 0.3
    panels[-1].set(xlabel="mode number j", xlim=(-margin, last + margin))
    for panel in panels:
        tidy(panel)
        panel.xaxis.get_major_locator().set_params(integer=True)
    figure.align_ylabels(panels)
    above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    panels[0].legend(frameon=False, fontsize=9, **above)
    return figure


def _draw_eigenvalues(panel: Axes, spectra: Mapping[str, Spectrum]) -> None:
    """Markers and bars of each spectrum."""
    largest = max(float(spectrum.eigenvalues[-1]) for spectrum in spectra.values()) or 1.0
    tops = [largest, *(float(np.max(_bar(spectrum)[1])) for spectrum in spectra.values())]
    top = min(max(tops), _HEADROOM * largest)
    for i, (name, spectrum) in enumerate(spectra.items()):
        number, style = np.arange(spectrum.k), _marker(i, spectrum.k)
        style |= {"mfc": "none" if i else style["color"], "zorder": 3, "clip_on": False}
        panel.plot(number, spectrum.eigenvalues, label=_told(name, spectrum, top), **style)
        if spectrum.certificate is not None:
            bar = {"color": style["color"], "lw": 3.5 - min(i, 2), "alpha": 0.22, "zorder": 2}
            panel.vlines(number, *_bar(spectrum), label="_", **bar)
    panel.set(ylabel="eigenvalue λ  [1/length²]", ylim=(0, 1.04 * top))


def _draw_residuals(panel: Axes, spectra: Mapping[str, Spectrum]) -> None:
    """Relative residuals: full markers for modes proved to be the ones of their number."""
    for i, spectrum in enumerate(spectra.values()):
        if (certificate := spectrum.certificate) is None:
            continue
        number, style = np.arange(spectrum.k), _marker(i, spectrum.k)
        shown = np.maximum(certificate.relative_residuals, _FLOOR)
        proved = number < certificate.n_verified
        for these, face in ((proved, style["color"]), (~proved, "none")):
            panel.plot(number[these], shown[these], **style, mfc=face)
    panel.set(yscale="log", ylabel="relative residual")
    log_ticks(panel.yaxis)
    if any(s.certificate is not None and s.certificate.n_verified for s in spectra.values()):
        panel.set_title("full: verified, open: not", loc="right", fontsize=8, color="0.35", pad=3)


def _draw_differences(panel: Axes, spectra: Mapping[str, Spectrum]) -> None:
    """Relative differences of eigenvalues to those of the first spectrum, zero modes left out."""
    first, *others = spectra.values()
    for i, other in enumerate(others, start=1):
        number = np.arange(first.n_zero_modes, min(first.k, other.k))
        change = other.eigenvalues[number] / first.eigenvalues[number] - 1
        size, style = np.maximum(np.abs(change), _FLOOR), _marker(0, first.k) | {"ms": 4.0}
        style["color"] = colour = line_style(i)[0]
        for these, marker, face in ((change >= 0, "^", colour), (change < 0, "v", "none")):
            panel.plot(number[these], size[these], **style | {"marker": marker, "mfc": face})
    panel.set(yscale="log", ylabel="relative difference")
    log_ticks(panel.yaxis)


def _draw_weyl(panel: Axes, spectra: Mapping[str, Spectrum], free_boundary: float) -> None:
    """One line for spectra of about the same area; if there are several, in their colours."""
    areas = _areas(spectra)
    last = max(spectrum.k for spectrum in spectra.values()) - 1
    number = np.linspace(0, last, 200) if free_boundary else np.array([0, last])
    for area, i in areas.items():
        law, of = "λ = 4πj / area", f"the area {area:.4g}"
        if free_boundary:
            held = "a held" if free_boundary < 0 else "a free"
            sign = "\N{MINUS SIGN}" if free_boundary < 0 else "+"
            law = f"j = (area λ {sign} length √λ) / 4π"
            of += f" and {held} boundary of length {abs(free_boundary):.4g}"
        panel.plot(
            *(number, weyl_law(number, area, free_boundary)),
            color="0.5" if len(areas) == 1 else line_style(i)[0],
            lw=1.2,
            ls=(0, (5, 2)),
            zorder=1,
            label=f"Weyl's law, {law}, for {of}",
        )


def weyl_law(number: NDArray[Any], area: float, free_boundary: float = 0.0) -> Floats:
    """Solve ``j = (area lambda + free_boundary sqrt(lambda)) / (4 pi)`` for the eigenvalues."""
    half = free_boundary / 2
    root = (np.sqrt(half**2 + 4 * np.pi * area * number) - half) / area
    return np.asarray(root**2)


def _areas(spectra: Mapping[str, Spectrum]) -> dict[float, int]:
    """The different areas, each with the number of the first spectrum that has it."""
    areas: dict[float, int] = {}
    for i, spectrum in enumerate(spectra.values()):
        if not any(abs(area - spectrum.area) <= _SAME_AREA * area for area in areas):
            areas[spectrum.area] = i
    return areas


def _bar(spectrum: Spectrum) -> tuple[Floats, Floats]:
    """Between what some true eigenvalue lies, for each mode: none is below zero."""
    values = spectrum.eigenvalues
    if spectrum.certificate is None:
        return values, values
    residuals = spectrum.certificate.residuals
    return np.maximum(values - residuals, 0.0), values + residuals


def _told(name: str, spectrum: Spectrum, top: float) -> str:
    """Return the name of a spectrum and what is certain of it."""
    certificate = spectrum.certificate
    if certificate is None:
        certain = "no certificate, no bars"
    else:
        certain = f"some true eigenvalue within ±{short(float(certificate.residuals.max()))}"
        if cut := int((_bar(spectrum)[1] > top * (1 + 1e-12)).sum()):
            certain += f" ({cut} bars leave the panel)"
        if certificate.n_verified:
            certain += f", {certificate.n_verified} of {spectrum.k} verified"
    return f"{name}: {certain}" if name else certain


def _marker(i: int, k: int) -> dict[str, Any]:
    """Style of the markers of spectrum number `i`."""
    marker, size = _MARKERS[i % len(_MARKERS)]
    size *= min(1.0, (_MANY / k) ** 0.5)
    return {"ls": "", "color": line_style(i)[0], "marker": marker, "ms": size, "mew": 1.0}


def free_boundary(geometry: Geometry, spectrum: Spectrum) -> float:
    """Length of the boundary that is free, less that where all modes are held at zero.

    Of a cloud it is not known, and taken to be 0.
    """
    if not isinstance(geometry, TriangleMesh):
        return 0.0
    edges, n_faces = geometry.unique_edges
    ends = edges[n_faces == 1]
    start, stop = geometry.points[ends].swapaxes(0, 1)
    held = ~spectrum.eigenvectors[ends].any(axis=(1, 2))
    return float(np.where(held, -1.0, 1.0) @ np.linalg.norm(stop - start, axis=1))
