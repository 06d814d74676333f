"""Reading meshes and point clouds from files, and writing them."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.files import atomic_path
from spectra_kit._core.validate import as_array, quantity
from spectra_kit._core.warn import hearing, warn
from spectra_kit.errors import (
    IgnoredContentWarning,
    InvalidFileError,
    InvalidInputError,
    OutOfMemoryError,
)
from spectra_kit.geometry.formats import (
    elements,
    freesurfer,
    gifti,
    gltf,
    numpy_arrays,
    obj,
    off,
    pcd,
    ply,
    stl,
    vtk,
    xyz,
)
from spectra_kit.geometry.formats._arrays import Arrays
from spectra_kit.geometry.formats._room import PACKED, beginning, format_of, unpacked
from spectra_kit.geometry.formats.foreign import advice_for, is_foreign
from spectra_kit.geometry.polygons import surface
from spectra_kit.geometry.shapes import Geometry, GeometryLike, PointCloud, TriangleMesh

Made = TypeVar("Made")
_WORD = re.compile(r"[!-~]+$")

# FreeSurfer names its surfaces as it likes, so that others of its files are known by content.
_SURFACES = (".graymid", ".inflated", ".midthickness", ".pial", ".smoothwm", ".sphere", ".white")
READERS: dict[str, Callable[[Path], Arrays]] = {
    ".gii": gifti.read,
    ".glb": gltf.read,
    ".gltf": gltf.read,
    ".npy": numpy_arrays.read_npy,
    ".npz": numpy_arrays.read_npz,
    ".obj": obj.read,
    ".off": off.read,
    ".pcd": pcd.read,
    ".ply": ply.read,
    ".stl": stl.read,
    **dict.fromkeys(_SURFACES, freesurfer.read),
    **dict.fromkeys((".vtk", ".vtp", ".vtu"), vtk.read),
    **dict.fromkeys((".asc", ".csv", ".pts", ".txt", ".xyz"), xyz.read),
    **dict.fromkeys(elements.MODULES, elements.read),
}
ANYTHING = (".asc", ".csv", ".txt")  # may hold points, and is read where it is named
MESH_WRITERS: dict[str, Callable[..., None]] = {
    ".gii": gifti.write,
    ".glb": gltf.write,
    ".gltf": gltf.write,
    ".npz": numpy_arrays.write_npz,
    ".obj": obj.write,
    ".off": off.write,
    ".ply": ply.write,
    ".stl": stl.write,
    ".vtk": vtk.write,
    ".vtp": vtk.write,
}
CLOUD_WRITERS: dict[str, Callable[..., None]] = {
    ".npy": numpy_arrays.write_npy,
    ".npz": numpy_arrays.write_npz,
    ".ply": ply.write,
    ".vtk": vtk.write,
    ".vtp": vtk.write,
    ".xyz": xyz.write,
}
_WITH_DATA = (".gii", ".ply", ".vtk", ".vtp")


@checked
def read(path: str | os.PathLike[str], *, kind: Literal["mesh", "cloud"] | None = None) -> Geometry:
    """Read a mesh or a point cloud, with vertices and faces in the order of the file.

    Parameters
    ----------
    path : path-like
        A file of one of the formats below; the extension says which, in any case, or of
        FreeSurfer the content. Packed ones (gz, bz2, xz) are unpacked: of ``a.ply.gz``, what it
        packs is read as ply.
    kind : {"mesh", "cloud"}, optional
        What the caller needs: "mesh" refuses a file without faces, "cloud" drops the faces. By
        default a file with faces gives a mesh and a file without them a cloud.

    Returns
    -------
    TriangleMesh or PointCloud
        In the unit of the file.

    Raises
    ------
    InvalidFileError
        If the file does not exist, is empty, cut short or of an unknown format, if it is not of
        the wanted `kind`, or if its content is no valid geometry (NaN, index out of range). Of
        formats that others read, it says who, and how to hand over what they return.
    OutOfMemoryError
        If the content does not fit into memory.
    MissingDependencyError
        If the format is one that nibabel or meshio reads, and that is not installed.

    Warns
    -----
    IgnoredContentWarning
        If the file holds more than was taken, or otherwise than its format has it: one warning that
        says what was passed over, and where. Texture, normals and colours are not told of.

    Notes
    -----
    ============  ====================================================================
    obj           every vertex once, whichever texture, group or material uses it; a cloud
                  where there are neither faces nor texture
    off           ASCII or binary; without faces where it announces none
    ply           ASCII or binary; faces and triangle strips; without where it announces none
    stl           ASCII or binary; exactly coincident corners are one vertex, which the
                  format repeats
    glb, gltf     all meshes of the scene, moved to their places and stacked; a file may
                  repeat vertices along texture seams, see `with_merged_vertices`; its
                  buffers lie in its folder or below
    npz           arrays points (or V, vertices, verts) and, for a mesh, faces (or F); where
                  none is called so, vert, v, xyz and triangles, tris, tri, TRIV, f
    npy           points of shape (n, 3)
    xyz           the first three columns, or those that a first line calls x, y, z, parted
                  by blanks, commas or semicolons; others, such as normals, are ignored
    pts           as xyz
    txt, csv      as xyz; not looked for in folders, as they may be anything
    asc           as txt
    pcd           ASCII or binary, not compressed
    vtk, vtp      polygons and strips, by VTK
    vtu           as vtk, which may be one, too: a grid whose cells are flat
    pial, white   triangles of FreeSurfer, and all other names that it gives them
    gii           one point set with its triangles, by nibabel (extra ``brain``)
    msh           triangles, quads and polygons of Gmsh, by meshio (extra ``meshio``)
    mesh          as msh, of MEDIT
    ============  ====================================================================

    Polygons become triangles around their first corner where that is right, and are cut by their
    ears where they are concave; holes are part of an outline that passes a bridge twice. One that
    crosses itself is refused. Vertices that are NaN and that no face uses are left out;
    `without_nan` leaves out all that are, and tells which.

    Whatever a file says twice is compared: counts with lengths, the checksums of npz, the columns
    of each line. What no format says twice cannot be: a digit of a coordinate outside npz, a text
    file cut inside its very last number, one of OBJ or XYZ cut between two lines. glTF is
    read without its skins and morph targets, and refused where it requires an extension, such as
    compression, that is not known here. Cells that fill a volume are passed over beside faces, and
    refused alone: the advice makes a surface of them.

    What a packed file unpacks to, the packed arrays of npz, and what a glTF shows, however often it
    shows one mesh, may take 100 times the bytes of the file and of its buffers, or 64 MiB where
    that is more; what would take more is refused, with what to do if it is right.
    Arrays (glTF, npz, npy) take at most four times that while they are read, text takes more.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from spectra_kit.geometry import TriangleMesh, read, write
    >>> mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> with TemporaryDirectory() as folder:
    ...     write(mesh, Path(folder) / "triangle.ply")
    ...     copy = read(Path(folder) / "triangle.ply")
    >>> bool((copy.points == mesh.points).all())
    True
    """
    return content_of(Path(path), lambda points, faces: _geometry(points, faces, kind))


def content_of(path: Path, make: Callable[[Any, Any], Made]) -> Made:
    """Return what `make` makes of the points and faces of a file."""
    reader = _lookup(READERS, path, "read", advice_for(path))
    return taken_of(path, lambda plain: make(*reader(plain)))


def taken_of(path: Path, take: Callable[[Path], Made]) -> Made:
    """Return what `take` makes of a file, unpacked; say what is wrong with it, or odd."""
    if path.is_dir():
        raise InvalidFileError(path, "this is a folder, expected a file")
    if not path.exists():
        raise InvalidFileError(path, f"there is no such file; looked from {Path.cwd()}")
    if path.stat().st_size == 0:
        raise InvalidFileError(path, "the file is empty")
    try:
        with hearing() as heard, unpacked(path) as plain:
            made = take(plain)
        if heard:
            told = "; ".join(dict.fromkeys(map(str, heard)))
            warn(told, IgnoredContentWarning, where=str(path))
        return made  # noqa: TRY300
    except InvalidInputError as error:
        raise InvalidFileError(path, error) from error
    except MemoryError as error:
        raise OutOfMemoryError(
            f"{path}: reading these {path.stat().st_size:,} bytes needs more memory than there is",
            advice="simplify the shape or split the file",
        ) from error


def _geometry(points: Any, faces: Any, kind: Literal["mesh", "cloud"] | None) -> Geometry:
    """Return what is wanted of what a reader found."""
    if isinstance(faces, InvalidInputError) and kind != "cloud":
        raise faces
    if faces is not None and kind != "cloud":
        return surface(points, faces)
    if kind != "mesh":
        return PointCloud(points)
    problem = "holds points without faces, expected a mesh"
    raise InvalidInputError(problem, advice="use {}", remedies=('kind="cloud"',))


@checked
def write(
    geometry: GeometryLike,
    path: str | os.PathLike[str],
    *,
    point_data: Mapping[str, ArrayLike] | None = None,
) -> None:
    """Write a mesh or a point cloud; the file appears whole or not at all.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        What to write.
    path : path-like
        Where. The extension names the format: obj, off, ply, stl, glb, gltf, gii, vtk, vtp or npz
        for a mesh; ply, vtk, vtp, xyz, npy or npz for a cloud. A file that is there is replaced.
    point_data : dict of str to array_like of shape (n,) or (n, d), optional
        Values at the points by their names, which ply, vtk, vtp and gii have room for. NaN says
        that there is none. In ply and gii, columns of one array are called ``name_0``, ``name_1``.

    Notes
    -----
    All formats give the same float64 numbers back when read again, except stl, glb, gltf and gii,
    which store float32. STL also forgets unused vertices and the vertex order. `read` has an
    example.
    """
    path = Path(path)
    writers = MESH_WRITERS if isinstance(geometry, TriangleMesh) else CLOUD_WRITERS
    writer = _lookup(writers, path, f"write a {type(geometry).__name__} to")
    data = _point_data(point_data, geometry.n, path.suffix.lower()) if point_data else None
    with atomic_path(path) as part:
        writer(geometry, part, data) if data else writer(geometry, part)


def _point_data(values: Mapping[str, ArrayLike], n: int, suffix: str) -> dict[str, NDArray[Any]]:
    """Return values at n points as a format has them."""
    if suffix not in _WITH_DATA:
        told = f"be left out in {suffix} files, which have no room for it"
        advice = f"write one of {', '.join(_WITH_DATA)}"
        raise InvalidInputError("point_data", told, ", ".join(map(str, values)), advice=advice)
    columns = dict[str, NDArray[Any]]()
    for name, given in values.items():
        array = as_array("point_data", given)
        if array.ndim not in (1, 2) or len(array) != n or array.dtype.kind not in "fiu":
            expected = f"hold numbers, a row for each of {n} points"
            got = f"shape {array.shape} of {array.dtype} as {name!r}"
            raise InvalidInputError("point_data", expected, got)
        if not name or (suffix == ".ply" and (name in ("x", "y", "z") or not _WORD.match(name))):
            told = "name its arrays" + " by words other than x, y, z" * (suffix == ".ply")
            raise InvalidInputError("point_data", told, repr(name))
        if array.ndim == 1 or suffix in (".vtk", ".vtp"):
            columns[name] = array
        else:
            columns |= {f"{name}_{i}": column for i, column in enumerate(array.T)}
    if suffix == ".ply":
        columns = {name: column.astype(np.float64) for name, column in columns.items()}
    return columns


def is_readable(path: Path) -> bool:
    """Whether this is a file for `read` by its name, which is not that of what may be anything.

    Or a surface of FreeSurfer by its content.
    """
    return _known_as(path) in READERS and format_of(path) not in ANYTHING


def readable_files(paths: Iterable[Path], *, named: bool = False) -> list[Path]:
    """Return those that `read` knows, sorted, and tell of geometries among the rest.

    A link to nothing is one of them: it fails, and is told. So are texts and tables, if `named`.
    """
    paths = list(paths)
    readable = {
        path for path in paths if is_readable(path) or (named and format_of(path) in READERS)
    }
    found = sorted(path for path in paths if path.is_file() or not path.exists())
    files = [path for path in found if path in readable]
    others = [path for path in found if path not in readable and is_foreign(path)]
    if files and others:
        warn(
            f"passed over {quantity(len(others), 'file')} of formats that are not read, the first"
            f" is {others[0].name!r}",
            IgnoredContentWarning,
            advice=advice_for(others[0]),
        )
    return files


def _known_as(path: Path) -> str:
    """Return the extension that names the format."""
    suffix, mark = format_of(path), freesurfer.MARK
    if suffix in READERS or not path.is_file() or beginning(path, len(mark)) != mark:
        return suffix  # who opened a pipe would wait
    return _SURFACES[0]


def _lookup(table: dict[str, Any], path: Path, action: str, advice: str = "") -> Any:
    try:
        return table[_known_as(path) if table is READERS else path.suffix.lower()]
    except KeyError as error:
        known = f"known are {', '.join(sorted(table))}"
        if table is READERS:
            known += f", packed or not ({', '.join(PACKED)})"
        if advice:
            known = f"{advice}; {known}"
        named = Path(path.stem).suffix * (path.suffix.lower() in PACKED) + path.suffix
        problem = InvalidInputError(f"cannot {action} the format {named!r}", advice=known)
        raise InvalidFileError(path, problem) from error
