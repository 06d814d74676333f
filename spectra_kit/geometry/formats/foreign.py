"""Formats that other libraries read: what is taken of them, and what is left to who has them.

Each call gives a thing that `as_geometry` takes; none of these libraries is needed by this one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit.errors import InvalidInputError, SpectraKitError
from spectra_kit.geometry.formats._arrays import BROKEN, Arrays
from spectra_kit.geometry.formats._room import PACKED, format_of
from spectra_kit.geometry.toolkits import arrays_of

# What parsers in Python raise of damaged files, beside what NumPy does.
_BROKEN = (*BROKEN, ArithmeticError, AssertionError, AttributeError, StopIteration)

_CALLS = {
    "pyvista.read(path).extract_surface()": ".vts .vtr",
    "pyvista.read(path).combine().extract_surface()": ".vtm .vtmb .case .foam",
    "meshio.read(path)": ".meshb .bdf .nas .fem .avs .su2 .med .xdmf .f3grid .node",
    "trimesh.load_scene(path).to_mesh()": ".3mf .dae .zae .3dxml .xaml",
    "laspy.read(path).xyz": ".las .laz",
}
_WORDS = {
    "hand over its arrays: m = scipy.io.loadmat(path), (m['VERT'], m['TRIV'] - 1) or as they are"
    " called; MATLAB counts from 1": ".mat",
    "if each line holds a point, rename it to .xyz": ".dat .tsv .xyzn .xyzrgb",
    "Blender or MeshLab exports what it holds as .ply or .glb": (
        ".fbx .blend .usd .usda .usdc .usdz .abc .3ds .lwo .x3d .wrl .ctm .dxf"
    ),
    "it holds curved surfaces, of which gmsh makes triangles: gmsh -2 FILE -o mesh.stl": (
        ".step .stp .iges .igs .brep"
    ),
    "of values at vertices, geometry.read_overlay(path) reads them; of an image of labels,"
    " geometry.from_labels(image) makes a surface of each": ".mgz .mgh",
    "it holds an image; if of labels, geometry.from_labels(image) makes a surface of each": (
        ".nii .nrrd .tif .tiff .dcm .mha .mhd .vti"
    ),
    "it holds values at the vertices of a surface: geometry.read_overlay(path)": (
        ".annot .curv .label .sulc .thickness .area"
    ),
    "unpack it first": ".zip .tar .tgz .7z .rar .zst",
}
_ANYTHING = (
    ".annot .area .curv .label .sulc .thickness .mat .dat .tsv .tif .tiff .zip .tar .tgz .7z .rar"
    " .zst"
)


def is_foreign(path: Path) -> bool:
    """Whether the name is that of a geometry that others read, and not of what may be anything."""
    known = f"{' '.join(_CALLS.values())} {' '.join(_WORDS.values())}".split()
    return format_of(path) in known and format_of(path) not in _ANYTHING.split()


def advice_for(path: Path) -> str:
    """Return what to do with a file of that name; its format may be one that is read here."""
    suffix = format_of(path)
    first, last = "", ""
    if path.suffix.lower() in PACKED:
        first, last = "unpack it, then ", f", of {path.stem}"
    for call, formats in _CALLS.items():
        if suffix in formats.split():
            copy = Path(path.stem).with_suffix(".ply").name
            return (
                f"{first}hand over {call}, or convert it once: spectra_kit.write({call},"
                f" {copy!r}){last}"
            )
    for words, formats in _WORDS.items():
        if suffix in formats.split():
            return words
    return "what meshio, PyVista or trimesh read is taken as it is: hand over meshio.read(path)"


@contextmanager
def read_by(library: str, *errors: type[Exception]) -> Iterator[None]:
    """Tell what a library says of a file that it cannot take apart; `errors` are its own."""
    try:
        yield
    except SpectraKitError:
        raise
    except _BROKEN + errors as error:
        told = " ".join(str(error).split())[:200] or type(error).__name__
        raise InvalidInputError(
            f"{library} cannot read it ({told})", advice="the file may be cut short or damaged"
        ) from error


def held_by(thing: Any, call: str, *, is_bare: bool = False) -> Arrays:
    """Return what an object holds that `call` has read of a file; no cells at all are doubtful."""
    try:
        points, faces = arrays_of(thing) or (np.empty((0, 3)), None)
        if is_bare:
            problem = "holds points, and no cells; it may be cut short"
            faces = InvalidInputError(problem, advice="use {}", remedies=('kind="cloud"',))
        return points, faces  # noqa: TRY300
    except InvalidInputError as error:
        if not error.expected:
            raise
        name = type(thing).__name__
        raise InvalidInputError(
            f"is no surface or cloud, but a {name}",
            advice=f"of what {call} returns, {error.advice}",
        ) from error
