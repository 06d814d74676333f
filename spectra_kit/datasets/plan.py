"""`Plan`: what is computed of every shape, and how."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import check_count
from spectra_kit._core.version import VERSION
from spectra_kit._sparse.memory import factor_gigabytes
from spectra_kit.eigen import Automatic, Eigensolver
from spectra_kit.eigen.components import device_of
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import (
    Geometry,
    GeometryLike,
    TriangleMesh,
    largest_component,
    repair,
    sample,
)
from spectra_kit.operators import Laplacian, laplacian, laplacian_many

Descriptor = Literal["hks", "wks", "gps", "dna"]
OperatorName = Literal["stiffness", "gradient"]


@checked
@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is computed of every shape, and how; equal plans of equal shapes, equal results.

    Parameters
    ----------
    k : int, default 96
        Modes, zero modes included.
    solver : Eigensolver, default Automatic()
        Who computes them; its repr tells all that decides its results.
    operator : {"robust", "cotan", "knn", "delaunay"}, optional
        The Laplacian; by default that of `operators.laplacian`.
    boundary : {"neumann", "dirichlet"}, default "neumann"
        Of meshes with a boundary.
    mass : {"lumped", "consistent"}, default "lumped"
        As of `operators.laplacian`.
    repair : bool, default False
        Join seams, merge duplicates, drop degenerate faces and unused vertices, and turn faces, as
        `geometry.repair` does; and leave NaN points of files out, as `geometry.without_nan` does.
    largest : bool, default False
        Keep the largest connected part of a mesh alone, after a repair; whoever needs the way back
        to the points of the file finds it by `geometry.largest_component`.
    cloud : int, optional
        See meshes as so many random points.
    seed : int, default 0
        Of these points.
    descriptors : tuple of {"hks", "wks", "gps", "dna"}, optional
        Signatures to keep beside the spectrum: heat and wave kernel, global point signature, and
        ShapeDNA, each with its default options (`features.DESCRIPTORS`).
    operators : tuple of {"stiffness", "gradient"}, optional
        Operators to keep beside the spectrum, for networks: the Laplacian; and frames with the
        gradients in them, normals outwards (`operators.tangent_gradient`).
    precision : {"float64", "float32"}, default "float64"
        In which eigenvectors, descriptors of points and operators are kept. Eigenvalues and masses
        are kept in float64.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> plan = sk.datasets.Plan(k=24, cloud=500, descriptors=("hks",))
    >>> plan.laplacian(plan.prepared(sk.geometry.creature(900))).n
    500
    """

    k: int = 96
    solver: Eigensolver = Automatic()  # noqa: RUF009
    operator: Literal["robust", "cotan", "knn", "delaunay"] | None = None
    boundary: Literal["neumann", "dirichlet"] = "neumann"
    mass: Literal["lumped", "consistent"] = "lumped"
    repair: bool = False
    largest: bool = False
    cloud: int | None = None
    seed: int = 0
    # Any words pass the check of kinds, which cannot tell which one of several is none of these.
    descriptors: Annotated[tuple[Descriptor, ...], tuple[str, ...]] = ()
    operators: Annotated[tuple[OperatorName, ...], tuple[str, ...]] = ()
    precision: Literal["float64", "float32"] = "float64"

    def __post_init__(self) -> None:
        check_count("k", self.k, low=1)
        check_count("seed", self.seed, low=0)
        if self.cloud is not None:
            check_count("cloud", self.cloud, low=4)
        if " at 0x" in repr(self.solver):
            raise InvalidInputError(
                "solver",
                "tell all that decides its results by its repr",
                repr(self.solver),
                advice="a place in memory tells nothing: make its parts frozen dataclasses",
            )
        for name, kind in (("descriptors", Descriptor), ("operators", OperatorName)):
            named, known = getattr(self, name), get_args(kind)
            if odd := [one for one in named if one not in known]:
                raise InvalidInputError(name, f"be among {', '.join(known)}", ", ".join(odd))
            if len(set(named)) < len(named):
                raise InvalidInputError(name, "be named once each", named)

    def prepared(self, shape: GeometryLike) -> Geometry:
        """Return a shape as it is looked at: repaired, its largest part alone, or sampled."""
        if self.repair:
            shape = repair(shape).geometry
        if self.largest and isinstance(shape, TriangleMesh):
            shape = largest_component(shape).mesh
        if self.cloud is None:
            return shape
        if not isinstance(shape, TriangleMesh):
            raise InvalidInputError("cloud", "sample meshes", "a point cloud")
        return sample(shape, self.cloud, seed=self.seed)

    def laplacian(self, shape: GeometryLike) -> Laplacian:
        """Return the operator of a prepared shape, with its boundary condition."""
        return laplacian(shape, **self._making)

    def laplacians(self, shapes: Sequence[GeometryLike]) -> list[Laplacian]:
        """Return the operators of many prepared shapes; errors say of which (`laplacian_many`)."""
        return laplacian_many(shapes, **self._making)

    @property
    def _making(self) -> dict[str, Any]:
        """How operators are made: where the solver works."""
        where = device_of(self.solver)
        own = {name: getattr(self, name) for name in ("operator", "boundary", "mass")}
        return {**own, "device": where}

    def gigabytes(self, n: int) -> float:
        """Estimate what the modes of n points take while they are solved for, in GiB.

        For a complete factor, and nine vectors for each mode: what `Automatic` took on real meshes
        of 5,000 to 135,000 points was 0.7 to 0.95 of it. Approximate solvers take less.
        """
        return factor_gigabytes(n) + 9 * 8 * self.k * n / 2**30

    @property
    def solved(self) -> dict[str, object]:
        """What decides a spectrum beside the shape."""
        return {
            "k": self.k,
            "solver": repr(self.solver),
            "operator": self.operator,
            "boundary": self.boundary,
            "mass": self.mass,
            "precision": self.precision,
            "release": VERSION,
        }

    @property
    def facts(self) -> dict[str, object]:
        """What decides all that is kept of a file."""
        seed = None if self.cloud is None else self.seed  # of nothing else
        reading = {
            "repair": self.repair,
            "largest": self.largest,
            "cloud": self.cloud,
            "seed": seed,
        }
        kept = {"descriptors": list(self.descriptors), "operators": list(self.operators)}
        return {**self.solved, **reading, **kept}
