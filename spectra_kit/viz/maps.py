"""Diagrams of maps: the matrix of a functional map, and cumulative curves of errors."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._files import atomic_path
from spectra_kit._validate import check_positive, real_array
from spectra_kit.correspondence import accuracy_curve, auc
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's colours: told apart with every kind of colour blindness; dashes help in print.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_DASHES = ("-", "--", "-.", ":")


def plot_functional_map(
    path: str | os.PathLike[str],
    functional_map: ArrayLike,
    *,
    title: str = "",
    subtitle: str = "",
    dpi: int = 200,
) -> None:
    """Draw the matrix of a functional map.

    Parameters
    ----------
    path : path-like
        The ``.png`` file to write, whole or not at all.
    functional_map : array_like of shape (k2, k1)
        C_12, from the source's modes (columns) to the target's (rows).
    title, subtitle : str, optional
        Set above and below.
    dpi : int, default 200
        Pixels per inch.

    Raises
    ------
    InvalidInputError
        If `functional_map` is no finite matrix, or `path` is not a ``.png`` in an existing folder.

    Notes
    -----
    Between isometric surfaces it is orthogonal, and diagonal with entries of modulus 1 where the
    eigenvalues are simple; a wide band about the diagonal tells of stretch. Colours run from -1 to
    1 for spectra at unit area.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "map.png"
    ...     plot_functional_map(path, np.eye(20), dpi=40)
    ...     path.exists()
    True
    """
    matrix = real_array("functional_map", functional_map)
    if matrix.ndim != 2 or not matrix.size:
        raise InvalidInputError(f"`functional_map` must have shape (k2, k1), got {matrix.shape}")
    with atomic_path(_png(path)) as part:
        rows, columns = matrix.shape
        tall = float(np.clip(4.4 * rows / columns, 1.5, 9.0))
        figure = _figure(5.8, tall + 0.75, title, subtitle)
        panel = figure.add_subplot()
        image = panel.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1, interpolation="none")
        panel.set(xlabel="mode of the source", ylabel="mode of the target")
        figure.colorbar(image, ax=panel, shrink=0.6, aspect=30, ticks=[-1, 0, 1])
        figure.savefig(part, dpi=dpi)


def plot_error_curves(
    path: str | os.PathLike[str],
    errors: Mapping[str, ArrayLike],
    *,
    limit: float = 10.0,
    error_label: str = "geodesic error, 100 / √area",
    title: str = "",
    subtitle: str = "",
    dpi: int = 200,
) -> None:
    """Draw which share of the correspondences has at most which error.

    Parameters
    ----------
    path : path-like
        The ``.png`` file to write, whole or not at all.
    errors : mapping of str to array_like of shape (c,)
        For each method its errors, >= 0, of all pairs together.
    limit : float, default 10
        The largest error shown, in the unit of `errors`.
    error_label : str
        Says what the errors are, and in which unit.
    title, subtitle : str, optional
        Set above and below.
    dpi : int, default 200
        Pixels per inch.

    Raises
    ------
    InvalidInputError
        If there is no method, errors are negative or NaN, or `path` is not a ``.png`` in an
        existing folder.

    Notes
    -----
    The legend gives the mean of each method and the area under its curve, relative to a perfect
    one's.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "curves.png"
    ...     plot_error_curves(path, {"ours": [0.0, 1.0, 2.5], "theirs": [1.0, 8.0, 30.0]}, dpi=40)
    ...     path.exists()
    True
    """
    limit = check_positive("limit", limit)
    if not errors:
        raise InvalidInputError("`errors` must hold at least one method, got none")
    at = np.linspace(0.0, limit, 401)
    curves = {name: accuracy_curve(values, at) for name, values in errors.items()}
    with atomic_path(_png(path)) as part:
        figure = _figure(6.4, 4.4, title, subtitle)
        panel = figure.add_subplot()
        for i, (name, curve) in enumerate(curves.items()):
            values = np.asarray(errors[name], dtype=np.float64)
            panel.plot(
                at,
                100 * curve,
                color=_COLOURS[i % len(_COLOURS)],
                ls=_DASHES[i // len(_COLOURS) % len(_DASHES)],
                lw=1.8,
                label=f"{name}: mean {values.mean():.2f}, AUC {auc(values, limit=limit):.3f}",
            )
        panel.set(
            xlabel=error_label,
            ylabel="share of correspondences [%]",
            xlim=(0, limit),
            ylim=(0, 101),
        )
        panel.grid(color="0.9")
        panel.spines[["top", "right"]].set_visible(False)
        panel.legend(frameon=False, loc="lower right", fontsize=9)
        figure.savefig(part, dpi=dpi)


def _png(path: str | os.PathLike[str]) -> str | os.PathLike[str]:
    if Path(path).suffix.lower() != ".png":
        raise InvalidInputError(f"`path` must end in .png, got {str(path)!r}")
    return path


def _figure(width: float, height: float, title: str, subtitle: str) -> Figure:
    """An empty figure with its head set."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=12, fontweight="bold", parse_math=False)
    if subtitle:
        figure.supxlabel(subtitle, fontsize=8, color="0.35", parse_math=False)
    return figure
