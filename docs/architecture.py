"""Draw the architecture: what flows through the toolkit, and which package may import which.

The rows are those of ``tests/package/test_architecture.py``: the picture shows what is enforced::

    python docs/architecture.py docs/pictures/architecture.svg
"""

from __future__ import annotations

import ast
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROOT = Path(__file__).parents[1]
#: What each package is for: its colour, and a few words.
PURPOSE = {
    "errors": ("base", "what is raised"),
    "catalogue": ("base", "all names"),
    "geometry": ("input", "meshes, clouds, files,\nrepair, sampling"),
    "operators": ("input", "Laplacian: L, M"),
    "eigen": ("solve", "eigensolve, verify,\nSpectrum, solvers"),
    "neo": ("solve", "the network, its weights,\nand its training"),
    "features": ("use", "signatures, distances,\nembeddings"),
    "geodesics": ("use", "heat method,\nexact distances"),
    "maps": ("use", "match, functional maps,\nhow good a map is"),
    "datasets": ("use", "a store, many shapes,\nmany workers"),
    "interop": ("use", "to and from\nother toolkits"),
    "learn": ("use", "labels of shapes\nand of their points"),
    "show": ("see", "pictures, animations,\na page to turn"),
    "cli": ("see", "spectra-kit"),
}
#: The way of the data: what it is at each stage, and the call that takes it to the next.
FLOW = (
    ("input", "obj, ply, npy …", "read"),
    ("input", "TriangleMesh\nPointCloud", "robust_laplacian …"),
    ("input", "Laplacian\nL u = λ M u", "eigensolve"),
    ("solve", "Spectrum\nλ, U, certificate", "match, HeatGeodesics …"),
    ("use", "maps, distances,\nsignatures", "plot_…, explore"),
    ("see", "pictures, pages", ""),
)
LABELS = {
    "base": "foundations",
    "input": "surface to operator",
    "solve": "operator to spectrum",
    "use": "what spectra are for",
    "see": "see it",
}
# Okabe and Ito's colours, mixed with white so that black text reads well on them.
COLOURS = {
    "base": "#e3e3e3",
    "input": "#bcdff3",
    "solve": "#f8d899",
    "use": "#b0dfce",
    "see": "#efcade",
}
_WIDTH, _HEIGHT, _GAP = 1.8, 0.68, 0.17


def layers() -> list[list[str]]:
    """Public packages and modules, lowest layer first, as the test of the imports has them."""
    tree = ast.parse((ROOT / "tests" / "package" / "test_architecture.py").read_text())
    rows = next(
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "LAYERS"
    )
    public = [[name for name in row.split() if not name.startswith("_")] for row in rows]
    return [row for row in public if row]


def draw_architecture(path: str | os.PathLike[str]) -> Path:
    """Write the picture, as .svg, .png or .pdf; the same bytes from the same packages."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    path = Path(path)
    rows = layers()
    width = max(map(len, rows)) * (_WIDTH + _GAP) + 1.2
    height = len(rows) * (_HEIGHT + _GAP) + 2.7
    with rc_context({"svg.hashsalt": "architecture", "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(width, height), facecolor="white")
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, width), ylim=(0, height))
        axes.set_axis_off()
        _draw_flow(axes, width, height - 1.05)
        _draw_layers(axes, rows, width)
        _draw_legend(axes, width)
        fixed = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix)
        figure.savefig(path, dpi=160, metadata=fixed)
    return path


def _box(axes: Axes, x: float, y: float, size: tuple[float, float], role: str, name: str) -> None:
    """Draw a rounded box around (x, y); in an SVG its group is named after what it stands for."""
    from matplotlib.patches import FancyBboxPatch

    w, h = size
    axes.add_patch(
        FancyBboxPatch(
            (x - w / 2, y - h / 2),
            w,
            h,
            boxstyle="round,pad=0,rounding_size=0.08",
            facecolor=COLOURS[role],
            edgecolor="#555555",
            linewidth=0.8,
            gid=name,
        )
    )


def _draw_flow(axes: Axes, width: float, y: float) -> None:
    """Draw the stages of the data from left to right, with the calls on the arrows."""
    _heading(axes, y + 0.78, "What flows")
    size = (1.42, 0.66)
    step = (width - 0.8 - size[0]) / (len(FLOW) - 1)
    for i, (role, stage, call) in enumerate(FLOW):
        x = 0.4 + size[0] / 2 + i * step
        _box(axes, x, y, size, role, f"stage-{i}")
        axes.text(x, y, stage, ha="center", va="center", fontsize=9.5)
        if call:
            start, end = x + size[0] / 2 + 0.04, x + step - size[0] / 2 - 0.04
            arrow = {"arrowstyle": "-|>", "color": "#333333", "lw": 1.3}
            axes.annotate("", (end, y), (start, y), arrowprops=arrow)
            middle = (start + end) / 2
            axes.text(
                middle,
                y + 0.4,
                call,
                ha="center",
                va="bottom",
                fontsize=8,
                family="DejaVu Sans Mono",
                color="#333333",
            )


def _draw_layers(axes: Axes, rows: list[list[str]], width: float) -> None:
    """Draw the packages, row on row, and the arrow of the imports beside them."""
    bottom = 0.75 + _HEIGHT / 2
    top = bottom + (len(rows) - 1) * (_HEIGHT + _GAP)
    _heading(axes, top + _HEIGHT / 2 + 0.22, "What may import what: packages, only from rows below")
    centre = (width + 0.6) / 2
    for i, row in enumerate(rows):
        y = bottom + i * (_HEIGHT + _GAP)
        for j, name in enumerate(row):
            role, words = PURPOSE[name]
            x = centre + (j - (len(row) - 1) / 2) * (_WIDTH + _GAP)
            _box(axes, x, y, (_WIDTH, _HEIGHT), role, f"package-{name}")
            lines = words.count("\n") + 1
            axes.text(
                x,
                y + 0.08 * (lines + 0.3),
                name,
                ha="center",
                va="center",
                fontsize=11,
                fontweight="bold",
            )
            axes.text(
                x,
                y - 0.14 if lines == 1 else y - 0.12,
                words,
                ha="center",
                va="center",
                fontsize=8.8,
                linespacing=1.05,
                color="#333333",
            )
    arrow = {"arrowstyle": "-|>", "color": "#333333", "lw": 1.6}
    axes.annotate("", (0.62, bottom - 0.2), (0.62, top + 0.2), arrowprops=arrow)
    axes.text(0.44, (bottom + top) / 2, "imports point down", rotation=90, ha="center", va="center")


def _draw_legend(axes: Axes, width: float) -> None:
    """Name the colours below everything else."""
    step = (width - 0.8) / len(LABELS)
    for i, (role, label) in enumerate(LABELS.items()):
        x = 0.4 + (i + 0.5) * step
        _box(axes, x - 0.78, 0.3, (0.26, 0.2), role, f"colour-{role}")
        axes.text(x - 0.58, 0.3, label, ha="left", va="center", fontsize=9)


def _heading(axes: Axes, y: float, text: str) -> None:
    axes.text(0.4, y, text, fontsize=12, fontweight="bold", va="center")


if __name__ == "__main__":
    draw_architecture(sys.argv[1])
