"""Counting what may be wrong with a geometry, without changing it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit.geometry.seams import HANGING, seams
from spectra_kit.geometry.shapes import (
    GeometryLike,
    TriangleMesh,
    box_unit,
    connected,
    distinct_rows,
)
from spectra_kit.geometry.winding import wound_against


@checked
@dataclass(frozen=True)
class Problem:
    """Something about a geometry that an operator may refuse; printed, it is a sentence.

    Parameters
    ----------
    count : int
        How many points, edges or faces it is about.
    finding : str
        What is wrong.
    advice : str
        What helps; ``{}`` stands where one of the `remedies` is named.
    remedies : tuple of str
        Calls that help, as Python has them.
    """

    count: int
    finding: str
    advice: str
    remedies: tuple[str, ...] = ()

    def told(self, word: Callable[[str], str] = str) -> str:
        """Return the sentence, with `word` applied to each remedy, as in `SpectraKitError`."""
        return f"{self.finding}: {self.advice.format(*map(word, self.remedies))}"

    def __str__(self) -> str:
        return self.told()

    def __repr__(self) -> str:
        return f"Problem({self.count}, {self.told()!r})"


# What a count of `Diagnosis` says of one and of several, and what helps: a call, "" for joining
# points, or words.
_PROBLEMS = {
    "duplicate_points": (
        "point lies exactly on an earlier one",
        "points lie exactly on earlier ones",
        "",
    ),
    "near_points": (
        "point of a boundary repeats an earlier one up to rounding",
        "points of boundaries repeat earlier ones up to rounding",
        "geometry.repair(mesh)",
    ),
    "seam_edges": (
        "boundary edge lies on another, unjoined",
        "boundary edges lie on others, unjoined",
        "geometry.repair(mesh)",
    ),
    "hanging_vertices": (
        *(f"{told}, unjoined" for told in HANGING),
        "geometry.repair(mesh)",
    ),
    "turned_faces": (
        "face is wound against its neighbours",
        "faces are wound against their neighbours",
        "geometry.repair(mesh)",
    ),
    "degenerate_faces": (
        "face has no area",
        "faces have no area",
        "mesh.without_degenerate_faces()",
    ),
    "duplicate_faces": (
        "face repeats an earlier one",
        "faces repeat earlier ones",
        "mesh.without_duplicate_faces()",
    ),
    "unreferenced_vertices": (
        "vertex has no face",
        "vertices have no face",
        "mesh.without_unreferenced()",
    ),
    "nonmanifold_edges": (
        "edge has three or more faces",
        "edges have three or more faces",
        "robust_laplacian",
    ),
    "clashing_edges": (
        "edge has faces that no turning makes agree",
        "edges have faces that no turning makes agree",
        "maps between surfaces do without sides there",
    ),
    "nonmanifold_vertices": (
        "vertex joins fans of faces that share no edge",
        "vertices join fans of faces that share no edge",
        "robust_laplacian",
    ),
}


@checked
@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """What a geometry consists of, and what about it deserves attention.

    Counts that only a mesh can have are 0 for a cloud.

    Parameters
    ----------
    n_points, n_faces : int
        Vertices or points, and triangles.
    n_components : int
        Connected components that have faces; for a cloud they are a matter of its Laplacian.
    dimension : int
        0 if all points coincide, 1 on a line, 2 in a plane, 3 otherwise.
    boundary_edges : int
        Edges of exactly one face; 0 on a closed surface.
    nonmanifold_edges : int
        Edges of three or more faces.
    nonmanifold_vertices : int
        Vertices whose faces do not form a single fan, such as the tip of two touching cones.
    degenerate_faces : int
        Faces with a repeated vertex or (numerically) without area.
    duplicate_faces : int
        Faces that repeat the vertices of an earlier face, in any order.
    unreferenced_vertices : int
        Vertices of no face.
    duplicate_points : int
        Points at exactly the place of an earlier one.
    near_points : int
        Vertices that repeat an earlier one but for rounding, where boundary edges lie on others.
    seam_edges : int
        Boundary edges that lie on another, so that the surface is cut there though it looks whole.
    hanging_vertices : int
        Vertices inside a boundary edge of another face, along which an edge of theirs goes on: it
        is cut there, too.
    turned_faces : int
        Faces wound against their neighbours; as few as must be turned for all to agree.
    clashing_edges : int
        Edges at which faces do not agree however they are turned, as on a Möbius strip.
    euler_characteristic : int
        Vertices in use - edges + faces; 2 - 2 * genus for one closed orientable surface.
    area : float
        In length^2; nan for a cloud.
    volume : float
        In length^3, what a closed surface encloses, negative where its faces look inwards; nan of a
        cloud, and where there is a boundary or faces disagree on which side is out.
    lower, upper : tuple of 3 floats
        Corners of the bounding box.
    """

    n_points: int
    n_faces: int = 0
    n_components: int = 0
    dimension: int
    boundary_edges: int = 0
    nonmanifold_edges: int = 0
    nonmanifold_vertices: int = 0
    degenerate_faces: int = 0
    duplicate_faces: int = 0
    unreferenced_vertices: int = 0
    duplicate_points: int
    near_points: int = 0
    seam_edges: int = 0
    hanging_vertices: int = 0
    turned_faces: int = 0
    clashing_edges: int = 0
    euler_characteristic: int = 0
    area: float = float("nan")
    volume: float = float("nan")
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    @property
    def problems(self) -> tuple[Problem, ...]:
        """What an operator may refuse, with what to do about it."""
        merge = "mesh.with_merged_vertices()" if self.n_faces else "cloud.without_duplicates()"
        found = []
        for name, (one, several, remedy) in _PROBLEMS.items():
            if count := getattr(self, name):
                finding = f"{count:,} {one if count == 1 else several}"
                if " " in remedy:
                    found.append(Problem(count, finding, remedy))
                    continue
                advice = "use {}" if remedy == "robust_laplacian" else "{}"
                found.append(Problem(count, finding, advice, (remedy or merge,)))
        if self.dimension < 2:
            shape = ("all points coincide", "all points lie on one line")[self.dimension]
            found.append(Problem(self.n_points, shape, "no surface"))
        return tuple(found)

    @property
    def is_clean(self) -> bool:
        """Whether there are no problems; boundaries and several components are none."""
        return not self.problems


@checked
def diagnose(geometry: GeometryLike) -> Diagnosis:
    """Count what may be wrong with `geometry`.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Is left as it is.

    Returns
    -------
    Diagnosis
        Counts; ``problems`` says which of them matter and which method helps.

    Examples
    --------
    >>> from spectra_kit.geometry import TriangleMesh, diagnose
    >>> mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 9, 9]], [[0, 1, 2]])
    >>> print(*diagnose(mesh).problems)
    1 vertex has no face: mesh.without_unreferenced()
    """
    points = geometry.points
    counts = _face_counts(geometry) if isinstance(geometry, TriangleMesh) else {}
    first, _ = distinct_rows(points)
    scaled = points / box_unit(points)
    return Diagnosis(
        n_points=geometry.n,
        dimension=int(np.linalg.matrix_rank(scaled - scaled[0], rtol=1e-7)),
        duplicate_points=geometry.n - len(first),
        lower=tuple(points.min(axis=0).tolist()),
        upper=tuple(points.max(axis=0).tolist()),
        **counts,
    )


def _face_counts(mesh: TriangleMesh) -> dict[str, Any]:
    edges, faces_at_edge = mesh.unique_edges
    n_used, n_faces = len(mesh.referenced_vertices), len(mesh.faces)
    cut, (turned, clashing) = seams(mesh), wound_against(mesh)
    is_closed = n_faces > 0 and bool((faces_at_edge == 2).all()) and not (turned.any() or clashing)
    return {
        "n_faces": n_faces,
        "n_components": len(np.unique(mesh.component_labels[mesh.referenced_vertices])),
        "boundary_edges": int((faces_at_edge == 1).sum()),
        "nonmanifold_edges": int((faces_at_edge > 2).sum()),
        "nonmanifold_vertices": _count_split_fans(mesh),
        "degenerate_faces": int(mesh.degenerate_faces().sum()),
        "duplicate_faces": n_faces - len(distinct_rows(np.sort(mesh.faces, axis=1))[0]),
        "unreferenced_vertices": mesh.n - n_used,
        "near_points": cut.near if cut else 0,
        "seam_edges": cut.edges if cut else 0,
        "hanging_vertices": len(np.unique(cut.hanging)) if cut else 0,
        "turned_faces": int(turned.sum()),
        "clashing_edges": clashing,
        "euler_characteristic": n_used - len(edges) + n_faces,
        "area": mesh.area,
        "volume": enclosed(mesh.points, mesh.faces) if is_closed else float("nan"),
    }


def enclosed(points: Floats, faces: NDArray[Any]) -> float:
    """Return the volume inside a closed surface, negative where it faces inwards."""
    a, b, c = (points - points[0])[faces].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _count_split_fans(mesh: TriangleMesh) -> int:
    """Count vertices whose faces are not connected through edges at that vertex."""
    corner = np.arange(3 * len(mesh.faces), dtype=np.int32)
    following = np.roll(corner.reshape(-1, 3), -1, axis=1).ravel()
    vertex = mesh.faces.ravel()
    is_upward = vertex < vertex[following]
    low = np.where(is_upward, corner, following)  # ends of the side that begins at each corner
    high = np.where(is_upward, following, corner)
    edge = vertex[low] * mesh.n + vertex[high]
    by_edge = np.argsort(edge)
    shared = np.flatnonzero(np.diff(edge[by_edge]) == 0)
    one, other = by_edge[shared], by_edge[shared + 1]
    del edge, by_edge, shared, following, is_upward  # as large as what comes now
    # Where two faces share an edge, their corners at each end of it belong to one fan.
    links = np.concatenate([low[one], high[one]]), np.concatenate([low[other], high[other]])
    fan = connected(*links, len(corner))
    at = np.empty(fan.max() + 1, dtype=np.int64)  # the vertex of each fan
    at[fan] = vertex
    return int((np.bincount(at) > 1).sum())
