"""What is compared: functions that take two sides and return a point map."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from spectra_kit._files import temporary_folder
from spectra_kit._types import Floats, Ints
from spectra_kit.descriptors import normalize_descriptors, wave_kernel_signature
from spectra_kit.errors import InvalidInputError, MissingDependencyError, SpectraKitError
from spectra_kit.evaluation.matching import pyfm_peer
from spectra_kit.functional_maps import FitWeights, fit_functional_map, zoomout
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.matching import match, prepare
from spectra_kit.operators.oriented import oriented_triangles
from spectra_kit.spectra import Spectrum

_FITTED, _THINNED = 30, 4  # modes of a fitted map; of 100 signatures every fourth


@dataclass(frozen=True, eq=False)
class Side:
    """One of the two to match.

    Attributes
    ----------
    geometry : TriangleMesh or PointCloud
        As the method may use it.
    spectrum : Spectrum
        Of its backend, in the units of the geometry.
    """

    geometry: Geometry
    spectrum: Spectrum


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a method returns for a pair.

    Attributes
    ----------
    point_map : ndarray of shape (n2,)
        Source point of each target point.
    seconds, cpu_seconds : float
        Of the matching, spectra given.
    candidates : tuple of ndarray of shape (k, k)
        Functional maps that it chose among, the chosen one first, where it reports them.
    margin : float
        By how much the chosen one was better; NaN where it does not say.
    ambiguous : bool
        Whether it warns that the map may be flipped.
    """

    point_map: Ints
    seconds: float
    cpu_seconds: float
    candidates: tuple[Floats, ...] = ()
    margin: float = float("nan")
    ambiguous: bool = False


def match_best(source: Side, target: Side) -> Outcome:
    """Match as `matching.match` does by default.

    Parameters
    ----------
    source, target : Side
        Connected, with at least 30 modes.

    Returns
    -------
    Outcome
        With candidates and margin; its seconds include preparing both sides.
    """
    clock = _Clock()
    prepared = (prepare(side.spectrum, side.geometry) for side in (source, target))
    found = match(*prepared, k=min(source.spectrum.k, target.spectrum.k))
    return Outcome(
        found.point_map,
        *clock.read(),
        candidates=tuple(candidate.functional_map for candidate in found.candidates),
        margin=found.margin,
        ambiguous=found.ambiguous,
    )


def match_wks(source: Side, target: Side, *, orientation: float = 0.0) -> Outcome:
    """Fit 30 modes to wave kernel signatures, then ZoomOut to all: the plain method.

    Parameters
    ----------
    source, target : Side
        With equal numbers of modes, 31 at least.
    orientation : float, default 0
        Weight of the orientation term; see `fit_functional_map`.

    Returns
    -------
    Outcome
        One map, no candidates.
    """
    clock = _Clock()
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
    return Outcome(refined.point_map, *clock.read())


def match_pyfm(source: Side, target: Side, *, python: str = sys.executable) -> Outcome:
    """PyFM with the parameters of its README, on spectra of its own.

    Parameters
    ----------
    source, target : Side
        Meshes; of the spectra only the number of modes is used.
    python : path, optional
        Of an environment where pyFM is installed; this one by default.

    Returns
    -------
    Outcome
        Its seconds leave out the spectra.

    Raises
    ------
    InvalidInputError
        If a side is no mesh.
    MissingDependencyError
        If there is no such Python, or it has no pyFM.
    SpectraKitError
        If pyFM fails on this pair.
    """
    if not isinstance(source.geometry, TriangleMesh) or not isinstance(
        target.geometry, TriangleMesh
    ):
        raise InvalidInputError("`source` and `target` must be meshes: pyFM knows no clouds")
    with temporary_folder() as folder:
        given, answer = folder / "in.npz", folder / "out.npz"
        np.savez(
            given,
            V1=source.geometry.points,
            F1=source.geometry.faces,
            V2=target.geometry.points,
            F2=target.geometry.faces,
            k=source.spectrum.k,
        )
        command = [python, str(pyfm_peer.__file__), str(given), str(answer)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError as error:
            raise MissingDependencyError(
                f"the Python of pyFM must be a program, got {python} ({error}); name another"
            ) from error
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        if done.returncode == pyfm_peer.MISSING:
            raise MissingDependencyError(
                f"pyFM must be installed in {python}, cannot be imported ({last}); pip install"
                " pyfmaps there, or name another Python"
            )
        if done.returncode:
            raise SpectraKitError(
                f"pyFM failed on this pair with exit status {done.returncode} ({last})"
            )
        with np.load(answer) as file:
            return Outcome(
                file["point_map"].astype(np.int64),
                float(file["seconds"]),
                float(file["cpu_seconds"]),
            )


#: Methods by name; each takes a source and a target `Side`.
METHODS: dict[str, Callable[[Side, Side], Outcome]] = {
    "match": match_best,
    "wks-zoomout": match_wks,
    "wks-orient-zoomout": partial(match_wks, orientation=1.0),
    "pyfm": match_pyfm,
}


class _Clock:
    """Seconds since it was made."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def read(self) -> tuple[float, float]:
        """Return wall and CPU seconds."""
        return time.perf_counter() - self._wall, time.process_time() - self._cpu
