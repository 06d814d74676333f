"""What a match returns: the map, what it was chosen from, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from scipy import sparse

from spectra_kit._checked import checked
from spectra_kit._types import Bools, Floats, Ints
from spectra_kit._validate import Rebuilt
from spectra_kit.errors import InvalidInputError
from spectra_kit.matching.confidence import confidence_of
from spectra_kit.matching.options import DEFAULT, MatchOptions

#: What may be wrong with a map: see `Match.doubts`.
Doubt = Literal["margin", "mirror_margin", "orientation", "consistent", "coverage", "score", "torn"]


@checked
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
    mirrored : bool
        Whether the map turns the surface over, like a mirror.
    """

    functional_map: Floats
    score: float
    mismatches: dict[str, float]
    mirrored: bool


@checked
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
        Whether the map turns the surface over, as one to a mirror image does.
    orientation : float or None
        Near 1 if the map keeps it, near -1 if it mirrors; far from both, parts of it are
        flipped. None if a geometry is missing.
    margin : float
        Score of the best other candidate of the same orientation over that of the chosen one; below
        1 if that one leaves more between the bent source and the target. Infinite if no other was
        found. Maps that differ in small parts do not count.
    mirror_margin : float
        Score of the best candidate of the other orientation (mirrored, if the chosen one is not)
        over that of the chosen one; near 1 for bodies whose halves are alike, infinite if there
        was none.
    consistent : float
        Share of the triangles that agree on which side is out, of the worse of both surfaces: 1
        for meshes.
    coverage : float
        Area of the source that the target points reach, over what as many thrown at random would
        reach: above 1.1 for right maps, whatever the resolutions. Of dense surfaces, by the points
        that they are matched on.
    torn : float or None
        Share of the target's edges whose ends lead far apart: six times their length and more. None
        if a geometry is missing.
    candidates : tuple of Candidate
        Those that were refined and came out different, the chosen one first.
    precise : csr_array of shape (n2, n1) or None
        Where on a triangle of the source each target point lies, if that was asked for: rows of at
        most three barycentric coordinates, which are positive and sum to 1. The map times values at
        the source points, or the points themselves, gives those at the target points.
    options : MatchOptions
        How they were found and judged.
    covered : ndarray of bool of shape (n2,), optional
        Which target points have a partner on a source that is a part; see `match_part`. None where
        both are wholes, and all points have one.
    """

    point_map: Ints
    functional_map: Floats
    mirrored: bool
    orientation: float | None
    margin: float
    mirror_margin: float
    consistent: float
    coverage: float
    torn: float | None
    candidates: tuple[Candidate, ...]
    precise: sparse.csr_array | None = None
    options: MatchOptions = DEFAULT
    covered: Bools | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.covered is not None and self.covered.shape != self.point_map.shape:
            raise InvalidInputError(
                "covered",
                "have the shape of `point_map`",
                f"{self.covered.shape} and {self.point_map.shape}",
            )

    @property
    def score(self) -> float:
        """Score of the chosen candidate; the lower, the better."""
        return self.candidates[0].score

    @property
    def confidence(self) -> float:
        """How likely the map is right, in [0, 1], by its score, tears, margin and coverage.

        Calibrated on `match` of bodies and animals, not on parts (`covered`). An only candidate, as
        those of a collection are, has as much as if a rival scored as well. It does not see
        symmetries: of a surface that is one with itself turned or mirrored, a wrong map looks like
        a right one. See `ambiguous`.
        """
        margin = self.margin if len(self.candidates) > 1 else None
        return confidence_of(
            score=self.score, torn=self.torn, margin=margin, coverage=self.coverage
        )

    @property
    def ambiguous(self) -> bool:
        """Whether the map may be flipped, in whole or in part.

        That is: a rival scored as well, one of the other orientation clearly better, that of
        the map is not what it should be, or the sides of a cloud are in doubt. A surface with a
        symmetry that no rival happened to show, such as a sphere, may pass for clear.
        """
        return not set(self.doubts) <= {"coverage", "score", "torn"}

    @property
    def convincing(self) -> bool:
        """Whether the map is rather right than wrong: its confidence is 0.5 or more.

        Bodies and animals that do not correspond rarely have such a map; surfaces without limbs,
        such as a ring and an ellipsoid, look much alike and may have one. Of a part, for which
        confidence is not calibrated, neither score nor coverage may speak against it.
        """
        if self.covered is not None:
            return not {"coverage", "score"} & set(self.doubts)
        return self.confidence >= 0.5

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """Names of the attributes that speak against the map."""
        limits, kept = self.options, 1.0
        if self.orientation is not None:
            kept = -self.orientation if self.mirrored else self.orientation
        clear: dict[Doubt, bool] = {
            "margin": self.margin >= limits.clear_margin,
            "mirror_margin": self.mirror_margin * limits.doubtful_mirror >= 1,
            "orientation": kept >= limits.clear_orientation,
            "consistent": self.consistent >= limits.clear_sides,
            "coverage": self.coverage >= limits.convincing_coverage,
            "score": self.score <= limits.convincing_score,
            "torn": self.torn is None or self.torn <= limits.convincing_torn,
        }
        return tuple(name for name, fine in clear.items() if not fine)

    def __repr__(self) -> str:
        how = "mirrored" if self.mirrored else "not mirrored"
        doubt = ", ambiguous" if self.ambiguous else ""
        doubt += "" if self.convincing else ", not convincing"
        sure = f"confidence {self.confidence:.2f}"
        if self.covered is not None:
            sure = f"{self.covered.sum()} covered"
        size = f"{len(self.point_map)} points, k={len(self.functional_map)}"
        return f"Match({size}, {how}, {sure}{doubt})"
