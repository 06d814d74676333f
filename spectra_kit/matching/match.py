"""`match`: a map between two surfaces that is not flipped, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._validate import Rebuilt, check_count, frozen
from spectra_kit.errors import InvalidInputError
from spectra_kit.functional_maps import zoomout, zoomout_many
from spectra_kit.geometry import Geometry
from spectra_kit.matching.candidates import sign_candidates
from spectra_kit.matching.prepare import LOWEST_K, Prepared, prepare
from spectra_kit.matching.score import mismatches, orientation_of, score_of
from spectra_kit.spectrum import Spectrum

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

Sides = Literal["kept", "reversed", "either"]

_SAME = 0.15  # squared difference per mode below which two maps are one
_FINALISTS = 6  # candidates that are refined
_REFINED = 60  # modes they are refined to
_MIRRORED = 1.5  # how many times better a mirroring map must be to be believed
_CLEAR = 1.1  # margin below which a match is called ambiguous


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate(Rebuilt):
    """One of the maps that `match` chose from.

    Attributes
    ----------
    functional_map : ndarray of shape (k, k)
        Refined to some 60 modes.
    score : float
        The lower, the better: `matching.score_of` of the mismatches.
    mismatches : dict of str to float
        What the score is made of; see `matching.mismatches`.
    reversing : bool
        Whether the map turns the surface over, like a mirror.
    """

    functional_map: Floats
    score: float
    mismatches: dict[str, float]
    reversing: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "functional_map", frozen(self.functional_map))


@dataclass(frozen=True, eq=False, kw_only=True)
class Match(Rebuilt):
    """A map from source to target, and how far it can be trusted.

    Attributes
    ----------
    point_map : ndarray of shape (n2,)
        The source point of each target point (p2p_21).
    functional_map : ndarray of shape (k, k)
        C_12, of the surfaces at unit area.
    mirrored : bool
        Whether the target is a mirror image of the source: the map turns the surface over.
    orientation : float or None
        Near 1 if the map keeps the sides, near -1 if it mirrors; far from both, parts of it are
        flipped. None if a geometry is missing.
    margin : float
        Score of the best other candidate over that of the chosen one, above 1; infinite if there
        was no other.
    candidates : tuple of Candidate
        All that were refined, the chosen one first.
    """

    point_map: Ints
    functional_map: Floats
    mirrored: bool
    orientation: float | None
    margin: float
    candidates: tuple[Candidate, ...]

    def __post_init__(self) -> None:
        for name in ("point_map", "functional_map"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def score(self) -> float:
        """Score of the chosen candidate; the lower, the better."""
        return self.candidates[0].score

    @property
    def ambiguous(self) -> bool:
        """Whether another map is nearly as good, so that this one may be flipped."""
        return self.margin < _CLEAR

    def __repr__(self) -> str:
        how = "mirrored" if self.mirrored else "not mirrored"
        doubt = ", ambiguous" if self.ambiguous else ""
        return (
            f"Match({len(self.point_map)} points, k={len(self.functional_map)}, {how},"
            f" margin {self.margin:.2f}{doubt})"
        )


def match(
    source: Prepared | Spectrum,
    target: Prepared | Spectrum,
    *,
    source_geometry: Geometry | None = None,
    target_geometry: Geometry | None = None,
    sides: Sides = "either",
    k: int = 150,
    step: int = 10,
) -> Match:
    """Find which point of the source corresponds to each point of the target.

    Parameters
    ----------
    source, target : Prepared or Spectrum
        Connected surfaces, in any units; a `Prepared` one saves time over many pairs.
    source_geometry, target_geometry : TriangleMesh or PointCloud, optional
        Of a `Spectrum`: the surface, for its sides and its curvature. Without them the match may
        be flipped, and says so.
    sides : {"either", "kept", "reversed"}
        Whether maps may turn the surface over. ``either`` prefers those that do not, unless a
        mirroring one is 1.5 times better.
    k : int, default 150
        Modes to end with; fewer where a spectrum has fewer.
    step : int, default 10
        Modes to add in each iteration of the final ZoomOut.

    Returns
    -------
    Match

    Raises
    ------
    InvalidInputError
        If a spectrum has fewer than 30 modes or several components, or sides are asked for
        without both geometries.
    """
    a = _prepared("source", source, source_geometry)
    b = _prepared("target", target, target_geometry)
    if sides not in ("either", "kept", "reversed"):
        raise InvalidInputError(f"`sides` must be 'either', 'kept' or 'reversed', got {sides!r}")
    k = min(check_count("k", k, low=LOWEST_K), a.spectrum.k, b.spectrum.k)
    has_sides = a.form is not None and b.form is not None
    if sides == "reversed" and not has_sides:
        raise InvalidInputError(
            "`sides='reversed'` needs both geometries, got"
            f" {'none' if a.form is None and b.form is None else 'one'};"
            " pass source_geometry and target_geometry"
        )
    ways = {"either": (False, True), "kept": (False,), "reversed": (True,)}[sides]
    found = [_candidates(a, b, reversing=way) for way in (ways if has_sides else (False,))]
    if len(found) == 2 and found[1][0].score * _MIRRORED < found[0][0].score:
        found.reverse()
    chosen = found[0][0]
    others = [c.score for c in found[0][1:]]
    result = zoomout(
        a.spectrum,
        b.spectrum,
        chosen.functional_map,
        k_final=k,
        step=step,
    )
    return Match(
        point_map=result.point_map,
        functional_map=result.functional_map,
        mirrored=chosen.reversing,
        orientation=orientation_of(a, b, result.functional_map),
        margin=min(others) / chosen.score if others else float("inf"),
        candidates=tuple(c for way in found for c in way),
    )


def _candidates(a: Prepared, b: Prepared, *, reversing: bool) -> list[Candidate]:
    """Return the refined candidates of one way round, the best first."""
    grown = _distinct(sign_candidates(a, b, reversing=reversing))
    rough = [score_of(mismatches(a, b, C, reversing=reversing, n_samples=200)) for C in grown]
    maps = np.stack([grown[i] for i in np.argsort(rough)[:_FINALISTS]])
    k = min(_REFINED, a.spectrum.k, b.spectrum.k)
    refined, _ = zoomout_many(
        a.spectrum.eigenvectors[a.samples, :k],
        b.spectrum.eigenvectors[b.samples, :k],
        maps,
        k_final=k,
        step=6,
    )
    out = []
    for C in _distinct(refined):
        values = mismatches(a, b, C, reversing=reversing)
        out.append(
            Candidate(
                functional_map=C, score=score_of(values), mismatches=values, reversing=reversing
            )
        )
    return sorted(out, key=lambda c: c.score)


def _distinct(maps: ArrayLike | Sequence[Floats]) -> list[Floats]:
    """Return the maps that differ from all before them."""
    kept: list[Floats] = []
    for C in np.asarray(maps):
        if all(((C - other) ** 2).sum() > _SAME * len(C) for other in kept):
            kept.append(C)
    return kept


def _prepared(name: str, side: Prepared | Spectrum, geometry: Geometry | None) -> Prepared:
    if isinstance(side, Prepared):
        if geometry is not None:
            raise InvalidInputError(
                f"`{name}_geometry` must be left out for a prepared surface, got one;"
                " pass it to prepare"
            )
        return side
    if not isinstance(side, Spectrum):
        raise InvalidInputError(
            f"`{name}` must be a Spectrum or a Prepared surface, got {type(side).__name__}"
        )
    return prepare(side, geometry)
