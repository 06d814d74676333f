"""What matches: functions that take two sides and return a point map."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from spectra_kit._core.files import temporary_folder
from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError, SpectraKitError
from spectra_kit.features import normalize_descriptors, wave_kernel_signature
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.maps import FitWeights, fit_functional_map, match, prepare, zoomout
from spectra_kit.maps.score import seen_at_points
from spectra_kit.operators.oriented import oriented_triangles
from studies.matching import pyfm_peer
from studies.worker import clocked

_FITTED, _THINNED = 30, 4  # modes of a fitted map; of 100 signatures every fourth


@dataclass(frozen=True, eq=False)
class Side:
    """One of the two to match: a geometry, and its spectrum in the same units."""

    geometry: Geometry
    spectrum: Spectrum


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a method returns for a pair."""

    point_map: Ints  #: (n2,): source point of each target point.
    seconds: float  #: Of the matching, spectra given.
    cpu_seconds: float
    #: (k, k): functional maps that it chose among, the chosen one first, where it reports them.
    candidates: tuple[Floats, ...] = ()
    #: How likely it thinks its map right, from 0 to 1; NaN where it does not say.
    confidence: float = float("nan")
    #: By how much the chosen one was better; NaN where it does not say.
    margin: float = float("nan")
    ambiguous: bool = False  #: Whether it warns that the map may be flipped.
    #: What confidence is made of, by name, where it tells: see `trust`.
    evidence: Mapping[str, Any] = field(default_factory=dict)
    #: (n2, 3): what confidence at points is made of; empty where it does not tell.
    seen: Floats = field(default_factory=lambda: np.empty((0, 3)))


def match_best(source: Side, target: Side) -> Outcome:
    """Match as `maps.match` does by default; the seconds include preparing both sides."""
    with clocked() as clock:
        a, b = (prepare(side.spectrum, side.geometry) for side in (source, target))
        found = match(a, b, k=min(source.spectrum.k, target.spectrum.k))
    told = "score", "discontinuity", "coverage", "convincing", "doubts", "genera", "rims"
    return Outcome(
        found.point_map,
        clock.seconds,
        clock.processor_seconds,
        candidates=tuple(candidate.functional_map for candidate in found.candidates),
        confidence=found.confidence,
        margin=found.margin,
        ambiguous=found.ambiguous,
        evidence={name: getattr(found, name) for name in told},
        seen=seen_at_points(found, a, b)[b.closest],
    )


def match_wks(source: Side, target: Side, *, orientation: float = 0.0) -> Outcome:
    """Fit 30 modes to wave kernel signatures, then ZoomOut to all: the plain method.

    With a weight for `orientation` the fit has that term; see `fit_functional_map`.
    """
    with clocked() as clock:
        a, b = (side.spectrum for side in (source, target))
        oriented = None
        if orientation:
            oriented = oriented_triangles(source.geometry), oriented_triangles(target.geometry)
        f, g = (normalize_descriptors(s, wave_kernel_signature(s))[:, ::_THINNED] for s in (a, b))
        fitted = fit_functional_map(
            a,
            b,
            f,
            g,
            k=_FITTED,
            weights=FitWeights(orientation=orientation),
            oriented=oriented,
        )
        refined = zoomout(a, b, fitted, k_final=min(a.k, b.k))
    return Outcome(refined.point_map, clock.seconds, clock.processor_seconds)


def match_pyfm(source: Side, target: Side, *, python: str = sys.executable) -> Outcome:
    """PyFM with the parameters of its README, on as many modes of its own.

    `python` is that of an environment where pyFM is installed. The seconds leave out the spectra.
    """
    a, b = source.geometry, target.geometry
    if not isinstance(a, TriangleMesh) or not isinstance(b, TriangleMesh):
        raise InvalidInputError("`source` and `target` must be meshes: pyFM knows no clouds")
    with temporary_folder() as folder:
        given, answer = folder / "in.npz", folder / "out.npz"
        k = source.spectrum.k
        np.savez(given, V1=a.points, F1=a.faces, V2=b.points, F2=b.faces, k=k)
        command = [python, str(pyfm_peer.__file__), str(given), str(answer)]
        try:
            subprocess.run(command, capture_output=True, text=True, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            said = (getattr(error, "stderr", "") or str(error)).strip().splitlines()[-1]
            raise SpectraKitError(
                f"pyFM failed on this pair in {python} ({said}); where it is missing, pip install"
                " pyfmaps there, or name another Python"
            ) from error
        with np.load(answer) as file:
            seconds, cpu_seconds = float(file["seconds"]), float(file["cpu_seconds"])
            return Outcome(file["point_map"].astype(np.int64), seconds, cpu_seconds)


@dataclass(frozen=True)
class Entry:
    """A method by its function; one that is `own` solves for itself, on meshes alone."""

    run: Callable[..., Outcome]
    own: bool = False


METHODS = {
    "match": Entry(match_best),
    "wks-zoomout": Entry(match_wks),
    "wks-orient-zoomout": Entry(partial(match_wks, orientation=1.0)),
    "pyfm": Entry(match_pyfm, own=True),
}
