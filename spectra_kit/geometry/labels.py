"""From images whose voxels are labelled, as segmentations are, to surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import as_array, positive_array, quantity, real_array
from spectra_kit._core.warn import warn
from spectra_kit.errors import InvalidInputError, SplitSurfaceWarning
from spectra_kit.geometry.diagnose import enclosed
from spectra_kit.geometry.shapes import TriangleMesh, distinct_rows

_STEPS, _PASS = 30, 0.07  # of Taubin's filter: fewer leave stairs of voxels, more take small parts
_LOST = 0.1  # of its volume, at most, is what smoothing may take from a label


@checked
@dataclass(frozen=True, eq=False)
class LabelSurface(Rebuilt):
    """The surface of one label of an image.

    Parameters
    ----------
    label : int
        As in the image.
    geometry : TriangleMesh
        Its surface, closed and facing outwards, in the unit of the spacing; all parts of it.
    volume : float
        Of its voxels, in length^3: the surface encloses about as much.
    area : float
        Of the surface, in length^2.
    is_smooth : bool
        Whether it was smoothed; a label of a few voxels, which would vanish, keeps its stairs, and
        half as much area again as what they stand for.
    touches_border : bool
        Whether it has voxels in the outermost layers of the image, where it is closed: of a cell
        that goes on outside, volume and area are of the part inside.
    n_pieces : int
        Number of pieces that share no face of a voxel, as a cell and loose voxels around it.
    """

    label: int
    geometry: TriangleMesh
    volume: float
    area: float
    is_smooth: bool
    touches_border: bool
    n_pieces: int


@checked
def from_labels(
    image: Any,
    *,
    spacing: float | Sequence[float] | None = None,
    labels: Sequence[int] | None = None,
) -> list[LabelSurface]:
    """Make a surface of each label of an image: of each cell, organ or grain.

    Parameters
    ----------
    image : array_like of shape (a, b, c), or image of nibabel
        Integers, or whether a voxel belongs to the only label; 0 is the background. The centre of
        voxel (0, 0, 0) is the origin; images of nibabel say by their `affine` where it lies.
    spacing : float or three floats, optional
        Distance of neighbouring voxels, along each axis if they differ; by default 1. Images of
        nibabel have their own.
    labels : sequence of int, optional
        Which to take, by default all; the others are background then.

    Returns
    -------
    list of LabelSurface
        In the order of the labels.

    Warns
    -----
    SplitSurfaceWarning
        If labels are in several pieces; one warning for the image.

    Notes
    -----
    Surface nets [1]_, one for the whole image, so that smooth labels that touch share their border,
    are smoothed by Taubin's filter [2]_, which keeps volumes: the longer, the more the spacings
    differ, or steps along the coarsest would stay. Where a label meets the border of the image it
    is closed there. Edges are rounded by about a voxel. Counted in voxels of the coarsest axis,
    whose spacing may be ten times the others', areas of balls of 6 in radius and more are within
    about 1 % of those of balls of the same volume. Those of 3 are within 3 %, enclose up to 6 %
    less than their voxels, or keep their stairs.

    References
    ----------
    .. [1] Sarah Frisken, "SurfaceNets for Multi-Label Segmentations with Preservation of Sharp
       Boundaries", Journal of Computer Graphics Techniques, 2022.
    .. [2] Gabriel Taubin, "A Signal Processing Approach to Fair Surface Design", SIGGRAPH, 1995.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import from_labels
    >>> x, y, z = np.mgrid[:20, :20, :20] - 9.5
    >>> cells = np.where(x**2 + y**2 + z**2 < 64, np.where(x > 0, 2, 1), 0)
    >>> [(cell.label, round(cell.volume)) for cell in from_labels(cells, spacing=0.5)]
    [(1, 136), (2, 136)]
    """
    from scipy import ndimage  # which is slow to import

    voxels, affine = _voxels(image, spacing)
    held = np.setdiff1d(voxels, 0)
    if labels is not None:
        if missing := [label for label in labels if label not in held]:
            raise InvalidInputError("labels", "be in the image, and not 0", missing[0])
        held = np.unique(labels)
    if not len(held):
        raise InvalidInputError("image", "hold a label", "nothing but 0, the background")
    place = np.minimum(np.searchsorted(held, voxels), len(held) - 1)
    number = np.where(held[place] == voxels, place + 1, 0).astype(np.int32)
    where = np.nonzero(number)
    corner = np.array([axis.min() for axis in where])
    box = tuple(slice(axis.min(), axis.max() + 1) for axis in where)
    steps = np.linalg.norm(affine[:3, :3], axis=0)
    stairs, smooth, faces, sides = _nets(number[box], float(steps.max() / steps.min()))
    scale = float(np.linalg.det(affine[:3, :3]))
    counts = np.bincount(number[box].ravel(), minlength=len(held) + 1)
    at_border = {i for axis in range(3) for i in np.unique(number.take([0, -1], axis)).tolist()}
    where_each = ndimage.find_objects(number)
    found = []
    for i, label in enumerate(held.tolist(), start=1):
        is_side = (sides == i).any(axis=1)
        # A face looks away from the first of its two labels; a mirroring turns them all.
        is_turned = (sides[is_side, 0] != i)[:, None]
        own = np.where(is_turned, faces[is_side][:, ::-1], faces[is_side])
        used, own = np.unique(own, return_inverse=True)
        is_smooth = abs(enclosed(smooth[used], own) - counts[i]) <= _LOST * counts[i]
        points = (smooth if is_smooth else stairs)[used] + corner
        mesh = TriangleMesh(
            points @ affine[:3, :3].T + affine[:3, 3], own if scale > 0 else own[:, ::-1]
        )
        volume = float(counts[i]) * abs(scale)
        n_pieces = ndimage.label(number[where_each[i - 1]] == i)[1]
        told = bool(is_smooth), i in at_border, n_pieces
        found.append(LabelSurface(int(label), mesh, volume, mesh.area, *told))
    if several := [one for one in found if one.n_pieces > 1]:
        warn(
            f"{len(several):,} of {quantity(len(found), 'label')}, such as"
            f" {several[0].label} of {several[0].n_pieces} pieces, in parts or with loose voxels:"
            " volumes, areas and modes are of all of these",
            SplitSurfaceWarning,
            advice="{} keeps the largest",
            remedies=("geometry.largest_component(mesh)",),
        )
    return found


def _voxels(image: Any, spacing: Any) -> tuple[NDArray[Any], Floats]:
    """Return the labels, and the affine map (4, 4) of their indices to places."""
    if is_image := hasattr(image, "affine") and hasattr(image, "dataobj"):
        voxels, affine = np.asanyarray(image.dataobj), real_array("image.affine", image.affine)
        if spacing is not None:
            raise InvalidInputError("spacing", "be left out: the image has an affine map")
        if not np.linalg.det(affine[:3, :3]):
            raise InvalidInputError("image.affine", "keep volumes apart from 0")
    else:
        voxels = as_array("image", image)
        steps = positive_array("spacing", 1.0 if spacing is None else spacing, advice="")
        if steps.shape not in ((), (3,)):
            raise InvalidInputError("spacing", "be a number, or three", f"shape {steps.shape}")
        affine = np.diag([*np.broadcast_to(steps, 3), 1.0])
    if voxels.ndim != 3 or not voxels.size:
        raise InvalidInputError(
            "image",
            "have three axes, and voxels along each",
            f"shape {voxels.shape}",
            advice="of a series, give each image by itself",
        )
    if voxels.dtype.kind not in "iub":
        whole = "image.astype(int)"
        if is_image:
            whole = "nibabel.Nifti1Image(image.get_fdata().astype('i4'), image.affine)"
        raise InvalidInputError(
            "image",
            "hold integers, which tell labels apart",
            f"dtype {voxels.dtype}",
            advice=f"if its numbers are whole, {whole} has integers; of grey values, a comparison"
            " such as image > level makes a label",
        )
    return voxels, affine


def _nets(
    number: NDArray[np.int32], ratio: float
) -> tuple[Floats, Floats, NDArray[Any], NDArray[Any]]:
    """Return points before and after smoothing, faces, and the two labels (f, 2) that each parts.

    Points are in indices of voxels, whose longest side is `ratio` times the shortest.
    """
    import pyvista  # which is slow to import

    padded = np.pad(number, 1)  # so that all is closed; PyVista pads no single layer
    grid = pyvista.ImageData(dimensions=padded.shape, origin=(-1, -1, -1))
    grid["label"] = padded.ravel(order="F")
    net: Any = grid.contour_labels(
        "all", smoothing=False, pad_background=False, output_mesh_type="triangles"
    )
    sides = np.asarray(net.cell_data["boundary_labels"])
    # VTK repeats points where voxels touch at an edge, and tears some of these open.
    first, label = distinct_rows(np.asarray(net.points, dtype=np.float64))
    stairs, faces = np.asarray(net.points, dtype=np.float64)[first], label[net.regular_faces]
    smooth = pyvista.PolyData.from_regular_faces(stairs, faces).smooth_taubin(
        n_iter=round(_STEPS * ratio),  # terraces between coarse steps are as wide
        pass_band=_PASS / ratio,
        boundary_smoothing=True,
        non_manifold_smoothing=True,
    )
    return stairs, np.asarray(smooth.points, dtype=np.float64), faces, sides
