"""What is to be done with files of formats that are not read here: who reads them, and what then.

Each call gives a thing that `as_geometry` takes; none of these libraries is needed by this one.
"""

from __future__ import annotations

from pathlib import Path

from spectra_kit.geometry.formats._room import PACKED, format_of

_CALLS = {
    "pyvista.read(path)": ".vtp",
    "pyvista.read(path).extract_surface()": ".vtk .vtu .vts .vtr",
    "pyvista.read(path).combine().extract_surface()": ".vtm .vtmb .case .foam",
    "meshio.read(path)": ".msh .mesh .meshb .inp .med .xdmf .bdf .nas .fem .avs .su2 .f3grid .node",
    "trimesh.load_scene(path).to_mesh()": ".3mf .dae .zae .3dxml .xaml",
    "nibabel.load(path)": ".gii",
    "nibabel.freesurfer.read_geometry(path)": (
        ".pial .white .inflated .sphere .reg .orig .nofix .smoothwm .midthickness .graymid"
    ),
    "open3d.io.read_point_cloud(path)": ".pcd .pts",
    "laspy.read(path).xyz": ".las .laz",
    "numpy.loadtxt(path, delimiter=',', skiprows=1)[:, :3]": ".csv",
}
_WORDS = {
    "hand over its arrays: m = scipy.io.loadmat(path), (m['VERT'], m['TRIV'] - 1) or as they are"
    " called; MATLAB counts from 1": ".mat",
    "if each line holds a point, rename it to .xyz": ".txt .asc .dat .tsv .xyzn .xyzrgb",
    "Blender or MeshLab exports what it holds as .ply or .glb": (
        ".fbx .blend .usd .usda .usdc .usdz .abc .3ds .lwo .x3d .wrl .ctm .dxf"
    ),
    "it holds curved surfaces, of which gmsh makes triangles: gmsh -2 FILE -o mesh.stl": (
        ".step .stp .iges .igs .brep"
    ),
    "it holds an image; hand over what skimage.measure.marching_cubes(image, level) returns": (
        ".nii .mgz .mgh .nrrd .tif .tiff .dcm .mha .mhd .vti"
    ),
    "unpack it first": ".zip .tar .tgz .7z .rar .zst",
}
_ANYTHING = ".csv .mat .txt .asc .dat .tsv .tif .tiff .zip .tar .tgz .7z .rar .zst"


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
