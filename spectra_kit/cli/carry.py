"""Carry what one shape has to another, along the maps that `match` has written."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

import spectra_kit as sk
from spectra_kit._core.files import atomic_path, parsing
from spectra_kit._core.validate import check_indices, quantity
from spectra_kit.cli import options, tables
from spectra_kit.cli.inputs import check_there, of_file
from spectra_kit.cli.output import check_output, tell
from spectra_kit.cli.progress import step
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from scipy import sparse

    from spectra_kit.geometry import Geometry
    from spectra_kit.maps import Carrier

_TABLES, _OVERLAYS = (".npy", ".csv"), (".gii", ".curv", ".thickness", ".sulc", ".area")
_MESHES = (".ply", ".vtk", ".vtp")
_FINE, _PLAIN, _PART = "precise_map.npz", "point_map.npy", "covered.npy"  # what `match` writes


@dataclass(frozen=True, kw_only=True)
class CarryOptions(options.Command, group="input"):
    """Carry values, labels or landmarks of SOURCE to TARGET along a map between both."""

    examples = (
        "carry cat.off dog.off parts.npy",
        "carry lh.pial atlas.gii thickness.gii -o there.gii",
        "carry cat.off dog.off tips.csv --marks -o there.csv",
    )
    keys = "source, target, values, kind, carried, undefined, confidence, output"
    operands = "SOURCE TARGET VALUES [options]"
    needs = ("maps",)

    source: Annotated[Path, Parameter(help="a mesh or point cloud")] = field(kw_only=False)
    target: Annotated[Path, Parameter(help="another one")] = field(kw_only=False)
    values: Annotated[
        Path,
        Parameter(
            help="one row for each vertex or face of SOURCE (.npy, .csv, .gii, .annot, or values of"
            " FreeSurfer); integers are labels"
        ),
    ] = field(kw_only=False)
    maps: Path = Path("match")
    """the folder that `spectra-kit match SOURCE TARGET` wrote; of --precise, smoother"""
    marks: bool = False
    """VALUES names vertices of SOURCE, counted from 0: tell where on TARGET they are"""
    output: options.Output = Path("carried.npy")
    """the file: .npy or .csv; of vertices also .gii, a file of FreeSurfer, or TARGET with the
    values as .ply, .vtk or .vtp"""


def carry(asked: CarryOptions) -> None:
    """Carry what a file holds, and write it."""
    known = _TABLES if asked.marks else (*_TABLES, *_OVERLAYS, *_MESHES)
    maps = [asked.maps / name for name in (_FINE, _PLAIN, _PART)]
    check_output(asked.output, known, [*asked.inputs, asked.values, *maps])
    for file in (*asked.inputs, asked.values):
        check_there(file)
    with step("reading"):
        source, target = sk.read(asked.source), sk.read(asked.target)
        carrier = sk.maps.Carrier(source, target, _map_in(asked.maps, source, target))
        given = _read(asked.values)
        on_faces = not asked.marks and _on_faces(asked, source, given)
    with step("carrying"):
        if asked.marks:
            kind, sure, found = "landmarks", None, _landmarks(asked, carrier, given)
            lacking = int(np.isnan(found[:, 0]).sum())
        else:
            kind, found, lacking, sure = _carried(carrier, given, on_faces)
    head = "x,y,z,face,weight0,weight1,weight2" if asked.marks else ""
    with step(f"writing {asked.output}"):
        _write(asked.output, target, found, head)
    record = {
        **{"source": str(asked.source), "target": str(asked.target), "values": asked.values},
        **{"kind": kind, "carried": len(found), "undefined": lacking, "confidence": sure},
        "output": asked.output,
    }
    left = ("source", "target", *(("confidence",) if sure is None else ()))
    told = {name: value for name, value in record.items() if name not in left}
    tell(
        asked,
        record,
        f"{tables.size(str(asked.source), source)}\n{tables.size(str(asked.target), target)}",
        tables.pairs(told),
    )


def _on_faces(asked: CarryOptions, source: "Geometry", given: "np.ndarray") -> bool:
    """Tell whether faces have what is given, or vertices; refuse what neither can have."""
    faces = len(source.faces) if isinstance(source, sk.TriangleMesh) else None
    if len(given) == source.n:
        return False
    if len(given) != faces:
        what = f"{source.n} vertices" + (f" or {faces} faces" if faces else "")
        with of_file(asked.values):
            raise InvalidInputError(
                f"holds {quantity(len(given), 'row')}, expected one for each of {what} of"
                f" {asked.source}",
                advice="are SOURCE and TARGET exchanged?",
            )
    if asked.output.suffix.lower() not in _TABLES:
        expected = f"be a {' or '.join(_TABLES)} file for what faces have"
        raise InvalidInputError("output", expected, repr(str(asked.output)))
    return True


def _carried(
    carrier: "Carrier", given: "np.ndarray", on_faces: bool
) -> tuple[str, "np.ndarray", int, float | None]:
    """Return what of which kind is carried, how much is not, and how sure labels are."""
    what = "faces" if on_faces else "vertices"
    if given.dtype.kind in "biu" and given.ndim == 1:
        given = given.astype(np.int64) if given.dtype.kind == "b" else given
        labels, sure = carrier.face_labels(given) if on_faces else carrier.labels(given)
        mean = float(sure[sure > 0].mean()) if sure.any() else 0.0
        return f"labels of {what}", labels, int((sure == 0).sum()), mean
    values = carrier.face_values(given) if on_faces else carrier.values(given)
    lacking = np.isnan(values).reshape(len(values), -1).any(axis=1)
    return f"values of {what}", values, int(lacking.sum()), None


def _landmarks(asked: CarryOptions, carrier: "Carrier", given: "np.ndarray") -> "np.ndarray":
    """Return the place, the face and the weights there of each landmark, NaN where there is none.

    Of one at a vertex, a face that has it.
    """
    target = carrier.target
    with of_file(asked.values):
        points = check_indices("--marks", given.ravel(), carrier.source.n)
    rows = np.full((len(points), 7), np.nan)
    for row, place in zip(rows, carrier.landmarks(points), strict=True):
        if isinstance(place, int):
            row[:3] = target.points[place]
            if isinstance(target, sk.TriangleMesh):
                face, corner = np.argwhere(target.faces == place)[0]
                row[3:] = face, *np.eye(3)[corner]
        elif place is not None:
            assert isinstance(target, sk.TriangleMesh)
            row[:] = *place.position(target), place.face, *place.barycentric
    return rows


def _map_in(folder: Path, source: "Geometry", target: "Geometry") -> "sparse.csr_array":
    """Return the map that `match` has written; rows of points without a partner are empty."""
    from scipy import sparse

    from spectra_kit.geometry.formats.numpy_arrays import read_npy

    fine, plain, part = (folder / name for name in (_FINE, _PLAIN, _PART))
    with of_file(folder):
        if not plain.is_file():
            raise InvalidInputError(
                "holds no point_map.npy", advice="name the folder that `spectra-kit match` wrote"
            )
    with of_file(plain):
        found = np.asarray(read_npy(plain)[0])
        if found.shape != (target.n,) or found.dtype.kind not in "iu" or found.max() >= source.n:
            raise InvalidInputError(
                f"is no map from {target.n} points to {source.n}",
                advice="are SOURCE and TARGET those that were matched, in that order?",
            )
    there = found >= 0
    if part.is_file():
        with of_file(part):
            covered = np.asarray(read_npy(part)[0])
            if covered.shape != there.shape:
                raise InvalidInputError(f"has shape {covered.shape}, not ({target.n},)")
            there &= covered.astype(bool)
    if fine.is_file():
        with parsing(fine, "map", remedy="match again"):
            places: Any = sparse.load_npz(fine)
        with of_file(fine):
            if places.shape != (target.n, source.n):
                raise InvalidInputError(f"has shape {places.shape}, not {target.n} by {source.n}")
        return sparse.csr_array(sparse.diags_array(there.astype(float)) @ places)
    rows = np.append(0, np.cumsum(there))
    return sparse.csr_array((np.ones(rows[-1]), found[there], rows), shape=(target.n, source.n))


def _read(path: Path) -> "np.ndarray":
    """Return what a file has for each vertex or face: (n,) or (n, c)."""
    from spectra_kit.geometry.formats.numpy_arrays import read_npy

    if path.suffix.lower() not in _TABLES:
        return sk.geometry.read_overlay(path).values
    with of_file(path):
        found = np.asarray(read_npy(path)[0]) if path.suffix.lower() == ".npy" else _table(path)
        if found.ndim not in (1, 2) or not found.size:
            raise InvalidInputError(
                f"has shape {found.shape}, expected a row for each vertex or face"
            )
    return found


def _table(path: Path) -> "np.ndarray":
    """Return the numbers of a text, whole ones as such; a first line of names is passed over."""
    lines = path.read_text(errors="replace").splitlines()
    kinds: list[type] = [np.int64, np.float64]
    for kind in kinds:
        for skipped in (0, 1):
            try:
                rows: np.ndarray = np.loadtxt(lines, kind, delimiter=",", skiprows=skipped, ndmin=2)
            except (ValueError, OverflowError) as error:
                why = error
                continue
            if not skipped or not _is_row(lines[0]):
                return rows[:, 0] if rows.shape[1] == 1 else rows
    raise InvalidInputError(f"not a table of numbers parted by commas ({why})")


def _is_row(line: str) -> bool:
    try:
        return bool(np.loadtxt([line], delimiter=",", ndmin=1).size)
    except ValueError:
        return False


def _write(path: Path, target: "Geometry", found: "np.ndarray", head: str) -> None:
    suffix = path.suffix.lower()
    if suffix in _MESHES:
        sk.write(target, path, point_data={"carried": found})
    elif suffix in _OVERLAYS:
        sk.geometry.write_overlay(found, path)
    else:
        with atomic_path(path) as part:
            if suffix == ".npy":
                with part.open("wb") as file:
                    np.save(file, found)
            else:
                form = "%d" if found.dtype.kind in "iu" else "%.17g"
                np.savetxt(part, found, form, ",", header=head, comments="")
