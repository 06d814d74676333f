"""Where geodesic distances begin, what solves for them, and the modes of its coarse space."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_indices
from spectra_kit.cli import program
from spectra_kit.cli.inputs import Numbering
from spectra_kit.cli.options import DEMO, NETWORK, refuse_given
from spectra_kit.cli.solving import check_solvers, refuse_solving, solve
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import Direct, FacePoint, Iterative, WithinMemory, nearest_source
from spectra_kit.geometry import Geometry
from spectra_kit.operators import Laplacian

Source = int | FacePoint
Solver = WithinMemory | Direct | Iterative
_COARSE: dict[str, Literal["additive", "projected", "none"]] = {
    "iterative": "additive",
    "projected": "projected",
    "plain": "none",
}


def check_solver(asked: program.Geodesic) -> None:
    """Refuse options of solvers that are not used, and solvers that lack what they need."""
    if asked.k is not None:
        check_count("-k", asked.k, low=1)
    if asked.spectrum:
        refuse_solving(asked)
    elif asked.solver:
        check_solvers(asked, asked.solver)
    elif not asked.compare:
        why = "without modes; choose what solves for them by --solver"
        refuse_given(asked, ("k", "rtol", "start", *NETWORK), why)
    if asked.method == "direct" and not asked.compare:
        refuse_given(asked, ["poisson_rtol"], "on a direct solver; choose another by --method")
    with_modes = bool(asked.spectrum or asked.solver)
    if asked.method == "projected" and not with_modes:
        raise InvalidInputError(
            "--method projected needs modes", advice="choose what solves for them by --solver"
        )
    if asked.method in ("direct", "plain") and with_modes and not asked.compare:
        named = f"--spectrum {asked.spectrum}" if asked.spectrum else f"--solver {asked.solver}"
        raise InvalidInputError(
            f"--method {asked.method}", "be given no modes", named, advice="leave one out"
        )


def may_be_exact(asked: program.Geodesic) -> bool:
    """Whether nothing is asked for that only the heat method has."""
    heat = asked.compare or asked.spectrum or asked.solver or asked.heat_boundary != "neumann"
    return asked.method == "auto" and asked.time_coefficient == 1 and not heat


def linear_solver(asked: program.Geodesic, modes: int) -> Solver:
    """Return the solver that ``--method`` names, with so many modes at most."""
    rtol = asked.poisson_rtol
    if asked.method == "auto":
        return WithinMemory(modes=modes, rtol=rtol)
    if asked.method == "direct":
        return Direct()
    return Iterative(coarse=_COARSE[asked.method], modes=modes, rtol=rtol)


def why_without_modes(asked: program.Geodesic, solver: Solver, n: int) -> str:
    """Return why a solver that may choose on n points leaves the modes alone; "" if it does not."""
    if not (asked.solver or asked.spectrum) or not isinstance(solver, WithinMemory):
        return ""
    chosen, reason = solver.choose(n)
    return f"not needed by the direct solver: {reason}" if isinstance(chosen, Direct) else ""


def number_of_modes(asked: program.Geodesic, laplacian: Laplacian, *, usual: int) -> int:
    """Return how many modes the coarse space has, those of eigenvalue 0 aside."""
    return usual if asked.k is None else max(asked.k - laplacian.kernel_dimension, 1)


def coarse_spectrum(asked: program.Geodesic, laplacian: Laplacian, modes: int) -> Spectrum | None:
    """Return the modes that were asked for, with those of eigenvalue 0; None if none were."""
    if asked.spectrum:
        spectrum = Spectrum.load(asked.spectrum)
        return spectrum if asked.k is None else spectrum.truncate(min(asked.k, spectrum.k))
    if not asked.solver:
        return None
    k = min(modes + laplacian.kernel_dimension, laplacian.n)
    return solve(laplacian, k, asked.solver, asked)


def check_named(asked: program.Geodesic) -> int:
    """Refuse what needs no geometry to be seen wrong; return how many farthest points to add."""
    check_count("--farthest", asked.farthest, low=0)
    if asked.file != DEMO:
        if not (asked.source or asked.at or asked.face or asked.farthest):
            raise InvalidInputError(
                "distances need at least one source",
                advice="name some by --source, --at, --face or --farthest",
            )
        sampled = asked.cloud is not None and (asked.source or asked.face)
        if sampled or ((asked.repair or asked.largest) and asked.face):
            raise InvalidInputError(
                "--source and --face number the points and faces of the file, which --cloud"
                " changes, and --repair and --largest the faces",
                advice="name places by --at instead",
            )
    for face, *_ in asked.face:
        if not face.is_integer():
            raise InvalidInputError("--face", "begin with the number of a face", f"{face:g}")
    return asked.farthest or int(not (asked.source or asked.at or asked.face))


def named_sources(asked: program.Geodesic, geometry: Geometry, kept: Numbering) -> list[Source]:
    """Return the points that --source, --at and --face name.

    `kept` knows the points of the file, where some were left out.
    """
    check_count("--farthest", asked.farthest, low=0, high=geometry.n)
    named = check_indices("--source", np.array(asked.source, dtype=object), kept.n)
    points = kept.number(named)
    if (points < 0).any():
        lost = ", ".join(map(str, named[points < 0]))
        raise InvalidInputError(
            "--source",
            "name points that --repair and --largest keep",
            f"{lost}, which no face has, or none of that part",
            advice="name others, or places by --at",
        )
    found: list[Source] = points.tolist()
    found += [nearest_source(geometry, place) for place in asked.at]
    return found + [FacePoint(int(face), (a, b, c)) for face, a, b, c in asked.face]


def with_farthest(
    sources: list[Source], count: int, distance: Callable[[list[Source]], Floats]
) -> list[Source]:
    """Add `count` points, each the farthest from all before it; in a part not reached, its first.

    Without sources the first is the farthest from point 0, which is none itself.
    """
    if count and not sources:
        first = int(np.argmax(distance([0])))
        return with_farthest([first], count - 1, distance)
    chosen, latest = list(sources), list(sources)
    nearest: Floats = np.array(np.inf)
    for _ in range(count):
        nearest = np.minimum(nearest, distance(latest))
        latest = [int(np.argmax(nearest))]
        chosen += latest
    return chosen
