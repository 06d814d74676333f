"""The picture at the head of the README: one spectrum, and what becomes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import spectra_kit as sk
from spectra_kit.eigen.metrics import Comparison, align_modes
from spectra_kit.features import heat_kernel_signature, heat_times
from spectra_kit.show.camera import View
from spectra_kit.show.colours import distance_colours, position_colours, refined
from spectra_kit.show.contours import distance_levels
from spectra_kit.show.fields import Panel, draw_panels
from spectra_kit.show.isolines import distance_lines
from spectra_kit.show.layout import LINE_COLOURS, MARGIN, Canvas, Page, new_figure, tidy
from spectra_kit.show.modes import display_signs
from spectra_kit.show.picture import save
from spectra_kit.show.render import Scene, render

MODE, ENLARGED = 33, 100
COLUMNS, CELL, TALL, GAP, CAPTION = 4, 2.75, 2.05, 0.22, 0.56  # inches
PATTERN = 200_000  # vertices at which the colours of positions look sharp


def draw_hero(
    path: Path,
    mesh: sk.TriangleMesh,
    exact: sk.Spectrum,
    predicted: sk.Spectrum,
    comparison: Comparison,
    *,
    source: int,
    pair: tuple[sk.TriangleMesh, sk.TriangleMesh, sk.Match],
    dpi: int,
) -> None:
    """Draw two rows of four: a mode in three panels and errors; then the applications."""
    view, width = View().rotation(mesh), round(CELL * dpi)
    sign = display_signs(exact.eigenvectors)[MODE]
    left = sign * exact.eigenvectors[:, MODE]
    right = sign * align_modes(exact, predicted, comparison)[:, MODE]
    limit = float(np.percentile(np.abs(left), 99))
    modes = [Panel(values=f, limit=limit, levels=(0.0,)) for f in (left, right)]
    modes.append(Panel(values=right - left, limit=limit / ENLARGED))
    field = sk.HeatGeodesics(mesh, exact).distance(source).distance
    unit = float(np.ptp(mesh.points @ view.T, axis=0)[0]) / CELL
    lines, widths = distance_lines(mesh, field, distance_levels(field, None, inch=unit))
    distances = Scene(
        geometry=mesh,
        functions=[distance_colours(field)],
        rotation=view,
        width=width,
        lines=[lines],
        line_width=widths * dpi / 72,
    )
    times = heat_times(exact, 12)
    heat = np.log(heat_kernel_signature(exact, times)[:, 3])
    signature = Panel(
        values=heat,
        low=heat.min(),
        limit=heat.max(),
        levels=tuple(np.linspace(heat.min(), heat.max(), 12)[1:-1]),
    )
    panels = draw_panels(mesh, [*modes, signature], rotation=view, width=width, dpi=dpi)
    (distance,), *maps = render([distances, *map_scenes(pair, width)])
    pictures = [*panels[:3], distance, panels[3], *(picture for (picture,) in maps)]

    row = TALL + CAPTION
    page = 2 * MARGIN + COLUMNS * (CELL + GAP) - GAP
    figure = new_figure(Page(dpi=dpi), page, 2 * row + MARGIN)
    canvas = Canvas(figure)
    error = float(np.sqrt(exact.mass @ (right - left) ** 2))  # the mode itself has norm 1
    captions = (
        ("exact eigenfunction", f"mode {MODE}, ARPACK"),
        ("predicted by NEO", "one forward pass, then smoothed"),
        ("their difference", f"{ENLARGED} times enlarged; {100 * error:.1f} % of the mode"),
        ("an estimate for every mode", "of its eigenvalue's error, without the exact one"),
        ("geodesic distances", "heat method, modes as coarse space"),
        ("heat kernel signature", "what each point sees around it"),
        ("shape matching", "source, coloured by position"),
        ("the map found", "target, in the colours it brings"),
    )
    places = [0, 1, 2, 4, 5, 6, 7]
    for place, picture in zip(places, pictures, strict=True):
        high, wide = (side / dpi for side in picture.shape[:2])
        x = MARGIN + (place % COLUMNS) * (CELL + GAP) + (CELL - wide) / 2
        y = MARGIN + (place // COLUMNS) * row + (TALL - high) / 2
        canvas.picture(picture, x, y)
    for place, (head, below) in enumerate(captions):
        x = MARGIN + (place % COLUMNS) * (CELL + GAP)
        y = MARGIN + (place // COLUMNS) * row + TALL
        canvas.text(head, x, y + 0.24, CELL, 11, bold=True, centred=True)
        canvas.text(below, x, y + 0.42, CELL, 8.5, centred=True, colour="0.4")
    corner = MARGIN + 3 * (CELL + GAP)
    height = canvas.height
    panel = figure.add_axes(
        (
            (corner + 0.5) / page,
            1 - (MARGIN + TALL - 0.2) / height,
            (CELL - 0.55) / page,
            (TALL - 0.25) / height,
        )
    )
    assert predicted.certificate is not None
    told, found, true = predicted.certificate.errors, predicted.eigenvalues, exact.eigenvalues
    assert told is not None
    modes_shown = np.arange(1, exact.k)
    off = np.abs(found[1:] - true[1:]) / true[1:]
    for values, name, colour in ((off, "true", 0), (told[1:], "estimated", 1)):
        panel.semilogy(modes_shown, values, "o", ms=2.6, color=LINE_COLOURS[colour], label=name)
    panel.set(ylabel="relative error")
    tidy(panel)
    panel.legend(loc="upper center", fontsize=8, frameon=False, ncols=2, handletextpad=0.2)
    panel.set_ylim(top=5 * max(off.max(), told.max()))
    save(figure, path)


def map_scenes(
    pair: tuple[sk.TriangleMesh, sk.TriangleMesh, sk.Match], width: int
) -> tuple[Scene, Scene]:
    """The source coloured by position, the target in the colours that the map brings it."""
    source, target, match = pair
    view = View("z").rotation(source)
    seen = source.points @ view.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    scenes = []
    for mesh, places in ((source, seen), (target, seen[match.point_map])):
        fine, positions, normals = refined(mesh, places, PATTERN)
        colours = position_colours(positions, low, high, squares=True)
        scenes.append(
            Scene(geometry=fine, functions=[colours], rotation=view, width=width, normals=normals)
        )
    return scenes[0], scenes[1]
