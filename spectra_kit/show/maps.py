"""Diagrams of maps: the matrix of a functional map, and cumulative curves of errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.validate import check_positive, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps import accuracy_curve, auc
from spectra_kit.show.axes import line_style, tidy
from spectra_kit.show.colours import diverging_colours
from spectra_kit.show.page import Page, new_diagram
from spectra_kit.show.picture import plotted

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@plotted
def plot_functional_map(
    functional_map: ArrayLike,
    *,
    page: Page = Page(),
) -> Figure:
    """Draw the matrix of a functional map.

    Parameters
    ----------
    $path
    functional_map : array_like of shape (k2, k1)
        C_12, from the source's modes (columns) to the target's (rows).
    $page

    $returns

    Notes
    -----
    Between isometric surfaces it is orthogonal, and diagonal with entries of modulus 1 where the
    eigenvalues are simple; a wide band about the diagonal tells of stretch. Colours run from -1 to
    1 for spectra at unit area.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.show import Page, plot_functional_map
    >>> plot_functional_map(np.eye(20), page=Page(dpi=40))
    Picture(path=None)
    """
    from matplotlib.colors import ListedColormap

    matrix = real_array("functional_map", functional_map)
    if matrix.ndim != 2 or not matrix.size:
        raise InvalidInputError("functional_map", "have shape (k2, k1)", matrix.shape)
    rows, columns = matrix.shape
    figure = new_diagram(page, 5.8, float(np.clip(4.4 * rows / columns, 1.5, 9.0)) + 0.5)
    panel = figure.add_subplot()
    colours = ListedColormap(diverging_colours(np.linspace(-1.0, 1.0, 255)) / 255)
    image = panel.imshow(matrix, cmap=colours, vmin=-1, vmax=1, interpolation="none")
    panel.set(xlabel="mode of the source", ylabel="mode of the target")
    figure.colorbar(image, ax=panel, shrink=0.6, aspect=30, ticks=[-1, 0, 1])
    return figure


@plotted
def plot_error_curves(
    errors: Mapping[str, ArrayLike],
    *,
    page: Page = Page(),
    limit: float = 10.0,
    error_label: str = "geodesic error, 100 / √area",
) -> Figure:
    """Draw which share of the correspondences has at most which error.

    Parameters
    ----------
    $path
    errors : mapping of str to array_like of shape (c,)
        For each method its errors, >= 0, of all pairs together.
    $page
    limit : float, default 10
        The largest error shown, in the unit of `errors`.
    error_label : str
        Says what the errors are, and in which unit.

    $returns

    Notes
    -----
    The legend gives the mean of each method and the area under its curve, relative to a perfect
    one's.

    Examples
    --------
    >>> from spectra_kit.show import plot_error_curves
    >>> plot_error_curves({"a": [0.0, 2.5], "b": [8.0]})
    Picture(path=None)
    """
    limit = check_positive("limit", limit)
    if not errors:
        raise InvalidInputError("errors", "hold at least one method", "none")
    at = np.linspace(0.0, limit, 401)
    curves = {name: accuracy_curve(values, at) for name, values in errors.items()}
    figure = new_diagram(page, 6.4, 4.6)
    panel = figure.add_subplot()
    for i, (name, curve) in enumerate(curves.items()):
        values = np.asarray(errors[name], dtype=np.float64)
        colour, dashes = line_style(i)
        text = f"{name}: mean {values.mean():.2f}, AUC {auc(values, limit=limit):.3f}"
        panel.plot(at, 100 * curve, color=colour, ls=dashes, lw=1.8, label=text)
    panel.set(
        xlabel=error_label, ylabel="share of correspondences [%]", xlim=(0, limit), ylim=(0, 101)
    )
    tidy(panel)
    panel.legend(frameon=False, loc="lower right", fontsize=9)
    return figure
