"""What a match is asked to try, and what it returns: the map, its rivals, how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import as_array, check_count, check_weights, quantity, real_array
from spectra_kit._core.warn import warn
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.maps import calibration
from spectra_kit.maps.places import as_places, carried_values, coded, voted

#: What may be wrong with a map: see `Match.doubts`.
Doubt = Literal[
    "margin", "mirror_margin", "alike", "orientation", "consistent", "coverage", "score",
    "discontinuity", "genera", "rims", "landmark_distances", "initial", "unconnected",
]  # fmt: skip
_AMBIGUOUS = {"margin", "mirror_margin", "alike", "orientation", "consistent"}
_ALONE = {"alike", "rims", "score", "unconnected"}  # that count by themselves
_OTHERS = {"orientation", "coverage", "discontinuity", "genera"}  # right maps have one at most

_CLUSTERED = 1.5  # times chance: bodies and animals have less, round shapes more
_NOTHING_SHARED = 1.0  # squared difference per mode: half of that of maps at random
_ALIKE = 2.0  # a map that is right scores better than one that shares nothing with it by more
_GOOD = 0.1  # what scores better is right by itself, as far as can be seen
_OPEN = 0.5  # length of a rim at unit area: that of a round cut of 2 % of the area


@checked
@dataclass(frozen=True, kw_only=True)
class MatchOptions:
    """How much `match` tries; measured on pairs of bodies and animals.

    What maps are made of, as numbers of modes and samples, is no option: a choice of one of them
    decides what the others must be. Nor is what was fitted (`maps.calibration`).

    Parameters
    ----------
    orders : int, default 32
        Likeliest orders of the lowest seven modes that are tried, each with all 64 choices of
        signs: 2048 candidates in all.
    growing : int, default 96
        How many of these start to grow.
    turns : int, default 12
        Turns about its longest axis in which the source is laid onto the target, either way along
        it.
    finalists : int, default 8
        Candidates that are refined.
    rounds : int, default 5
        Of finding nearest points, as the source is bent onto the target.
    mirrored_by : float, default 3.0
        How many times better a mirrored map must be to be believed.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.MatchOptions(finalists=12).finalists
    12
    """

    orders: int = 32
    growing: int = 96
    turns: int = 12
    finalists: int = 8
    rounds: int = 5
    mirrored_by: float = 3.0

    def __post_init__(self) -> None:
        for name in ("orders", "growing", "turns", "finalists", "rounds"):
            check_count(name, getattr(self, name), low=1)
        check_weights({"mirrored_by": self.mirrored_by})


#: What functions take without options of their own.
DEFAULT = MatchOptions()


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate(Rebuilt):
    """One of the maps that `match` chose from.

    Attributes
    ----------
    functional_map : ndarray of shape (k, k)
        Refined to some 60 modes.
    score : float
        The lower, the better, at least 0.001: the weighted geometric mean of the mismatches.
    mismatches : dict of str to float
        What the score is made of; see `maps.score_map`.
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
        1 if that one leaves more between the bent source and the target, or tears or alters more.
        Infinite if no other was found. Maps that differ in small parts do not count.
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
    discontinuity : float or None
        How much of the map is torn: the share of the target's edges whose ends lead far apart, six
        times their length and more. None if a geometry is missing.
    candidates : tuple of Candidate
        Those that were refined and came out different, the chosen one first.
    precise : csr_array of shape (n2, n1) or None
        Where on a triangle of the source each target point lies, if that was asked for, in the form
        of `precise_map`.
    covered : ndarray of bool of shape (n2,), optional
        Which target points have a partner on a source that is a part; see `match_part`. None where
        both are wholes, and all points have one.
    clustered : float, default 1.0
        How much closer than by chance the lowest eigenvalues lie, of the rounder surface: above 1.5
        for round and symmetric ones, which many maps take to themselves.
    genera : (int, int) or None, optional
        Handles of source and target, holes being closed. None if one is a cloud, or not manifold.
    rims : (float, float), default (0.0, 0.0)
        How long the rim of one round hole is, at unit area, across which as much is cut off as
        across all holes of source and target. Gaps in a wall, which they lie in, do not count.
    landmark_distances : ndarray of shape (l,), optional
        How far the map by itself leads from each landmark, at unit area; None without landmarks.
    lost_from : float
        Beyond which distance a landmark is lost: three steps between neighbours of the source, or
        0.05 where that is more.
    convincing_score : float
        Above which the score speaks against the map: 0.42, or 0.4 of the best of many regions.
    n_source : int or None, optional
        Number of source points; None where it is not known.
    initial : bool, default False
        Whether it was refined from a map that was given: nothing else was tried, and where that one
        is turned, so is this.
    unconnected : bool, default False
        Whether it is of a collection of which no convincing pairs connect the two surfaces.
    """

    point_map: Ints
    functional_map: Floats
    mirrored: bool
    orientation: float | None
    margin: float
    mirror_margin: float
    consistent: float
    coverage: float
    discontinuity: float | None
    candidates: tuple[Candidate, ...]
    precise: sparse.csr_array | None = None
    covered: Bools | None = None
    clustered: float = 1.0
    genera: tuple[int, int] | None = None
    rims: tuple[float, float] = (0.0, 0.0)
    landmark_distances: Floats | None = None
    lost_from: float = float("inf")
    convincing_score: float = calibration.CONVINCING_SCORE
    n_source: int | None = None
    initial: bool = False
    unconnected: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.covered is not None and self.covered.shape != self.point_map.shape:
            raise InvalidInputError(
                "covered",
                "have the shape of `point_map`",
                f"{self.covered.shape} and {self.point_map.shape}",
            )
        if self.landmark_distances is not None:
            apart = real_array("landmark_distances", self.landmark_distances)
            if apart.ndim != 1 or not len(apart):
                raise InvalidInputError(
                    "landmark_distances", "have shape (l,), l >= 1", apart.shape
                )

    @property
    def score(self) -> float:
        """Score of the chosen candidate; the lower, the better."""
        return self.candidates[0].score

    @property
    def alike(self) -> int:
        """Number of other maps that are as good, as far as can be seen, of a round surface.

        Of the same orientation, with nothing in common with the chosen one, and not twice as bad,
        or good by themselves, in score and at the landmarks. 0 of surfaces that are not
        `clustered`.
        """
        if self.clustered < _CLUSTERED:
            return 0
        chosen, *others = self.candidates
        return sum(_as_good(other, chosen) for other in others)

    @property
    def landmarks_held(self) -> Bools | None:
        """Which landmarks the map holds, (l,); None without any.

        Where it does, `point_map` has the very points that were given.
        """
        if self.landmark_distances is None:
            return None
        return np.asarray(self.landmark_distances <= self.lost_from)

    @property
    def confidence(self) -> float:
        """How likely the map is right, in [0, 1].

        A logistic of score, tears, margin and coverage, fitted to `match` of bodies (FAUST, SCAPE)
        and animals (SMAL, TOSCA), and of bodies with animals: of other kinds of shapes, and of
        parts (`covered`), it is a guess; of maps that were not bent (`elastic`), which tear more,
        it is too low between species; spectra alone do not show it what is flipped.

        Doubts about orientation lower its odds to a fiftieth, about genera to a fifth; maps that
        are `alike` have equal shares of it; and so much of it is lost as of the landmarks. An only
        candidate, as of a collection or of an `initial` map, has as much as if a rival scored as
        well: it tells how well the map fits, not that no other would, so that of an `initial` map
        that is turned is near 1 on a round surface. Where a collection leaves two surfaces
        `unconnected`, it is half as much; where `rims` say that what one has the other may lack, a
        third. It does not see other symmetries: of a surface that is one with itself turned or
        mirrored, a wrong map looks like a right one. See `ambiguous`.
        """
        margin = self.margin if len(self.candidates) > 1 else None
        likely = calibration.confidence_of(
            score=self.score,
            discontinuity=self.discontinuity,
            margin=margin,
            coverage=self.coverage,
            against=self.doubts,
        )
        held = self.landmarks_held
        likely /= (1 + self.alike) * (1 + self.unconnected) * (1 + 2 * ("rims" in self.doubts))
        return likely * (1.0 if held is None else float(held.mean()))

    @property
    def ambiguous(self) -> bool:
        """Whether the map may be flipped or turned, in whole or in part.

        That is: a rival scored as well, others of a round surface hardly worse (`alike`), one of
        the other orientation clearly better, that of the map is not what it should be, or the sides
        of a cloud are in doubt.
        """
        return bool(_AMBIGUOUS & set(self.doubts))

    @property
    def convincing(self) -> bool:
        """Whether the map is rather right than wrong, by confidence and doubts.

        Its confidence is 0.5 or more, no map is `alike`, the two are not `unconnected`, neither
        score nor rims speak against it, and of orientation, coverage, tears and genera one does at
        most. Of a part, for which confidence is not calibrated, neither score, coverage nor rims
        may.
        """
        doubts = set(self.doubts)
        if self.covered is not None:
            return not {"coverage", "score", "rims"} & doubts
        if _ALONE & doubts or len(_OTHERS & doubts) > 1:
            return False
        return self.confidence >= 0.5

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """Names of the attributes that speak against the map."""
        kept, held = 1.0, self.landmarks_held
        if self.orientation is not None:
            kept = -self.orientation if self.mirrored else self.orientation
        clear: dict[Doubt, bool] = {
            "margin": self.margin >= calibration.CLEAR_MARGIN,
            "mirror_margin": self.mirror_margin * calibration.DOUBTFUL_MIRROR >= 1,
            "alike": self.alike == 0,
            "orientation": kept >= calibration.CLEAR_ORIENTATION,
            "consistent": self.consistent >= calibration.CLEAR_SIDES,
            "coverage": self.coverage >= calibration.CONVINCING_COVERAGE,
            "score": self.score <= self.convincing_score,
            "discontinuity": self.discontinuity is None
            or self.discontinuity <= calibration.CONVINCING_DISCONTINUITY,
            "genera": self.genera is None or self.genera[0] == self.genera[1],
            "rims": self._rims_agree(),
            "landmark_distances": held is None or bool(held.all()),
            "initial": not self.initial,
            "unconnected": not self.unconnected,
        }
        return tuple(name for name, fine in clear.items() if not fine)

    def carry(self, values: ArrayLike) -> Floats | Ints:
        """Carry what each source point has to the target's: real values, or labels.

        Values (n1,) or (n1, c), mixed where the match is `precise`, become (n2,) or (n2, c), NaN
        where nothing is `covered`; integers (n1,) are taken for labels, and go by the majority, -1
        there. For labels of faces, landmarks, vectors, textures and poses, and for the way back,
        see `maps.Carrier`.
        """
        given = as_array("values", values)
        least = 1 + int(self.point_map.max())
        n1 = self.n_source or max(len(given) if given.ndim else 0, least)
        n1 = n1 if self.precise is None else self.precise.shape[1]
        along = self.point_map if self.precise is None else self.precise
        places = as_places("the match", along, n1, len(self.point_map))
        if given.dtype.kind not in "biu" or given.ndim != 1:
            return carried_values(places, self.covered, given)
        found, codes = coded("values", given, n1, "point")
        labels = found[voted(places, codes, len(found))]
        return labels if self.covered is None else np.where(self.covered, labels, -1)

    def _rims_agree(self) -> bool:
        """Tell whether both surfaces may be wholes: what is cut off elsewhere is no partner.

        Where both are wide open, as two sheets are and two parts of one body, only a map much
        better than those that convince elsewhere tells them apart. A part may be open, its whole
        not.
        """
        open1, open2 = (rim > _OPEN for rim in self.rims)
        if self.covered is not None:
            return not open2
        if open1 and open2:
            return self.score <= 0.5 * self.convincing_score
        return abs(self.rims[0] - self.rims[1]) <= _OPEN

    def __repr__(self) -> str:
        how = "mirrored" if self.mirrored else "not mirrored"
        doubt = ", ambiguous" if self.ambiguous else ""
        doubt += "" if self.convincing else ", not convincing"
        sure = f"confidence {self.confidence:.2f}"
        if self.covered is not None:
            sure = f"{self.covered.sum()} covered"
        size = f"{len(self.point_map)} points, k={len(self.functional_map)}"
        return f"Match({size}, {how}, {sure}{doubt})"


def warn_of(found: Match) -> None:
    """Warn of a match that does not convince, or keep its landmarks."""
    held, apart = found.landmarks_held, found.landmark_distances
    lost = ""
    if held is not None and apart is not None and not held.all():
        lost = (
            f"{(~held).sum()} of {quantity(len(held), 'landmark')} are lost: the map leads"
            f" {apart.max():.2g} times the root of the area away from them (at"
            f" most {found.lost_from:.2g} is exact enough)"
        )
    if found.convincing and not lost:
        return
    doubts = [doubt for doubt in found.doubts if not (lost and doubt == "landmark_distances")]
    against = "; ".join(filter(None, (", ".join(doubts), lost))) or "nothing alone"
    convincing = "a map in doubt" if found.convincing else "no convincing map"
    told = f"{convincing}: its confidence is {found.confidence:.2f}; what speaks against it: "
    if lost:
        advice = "look there: the map may be wrong, or these contradict each other"
        warn(told + against, DoubtfulMatchWarning, advice=advice)
        return
    warn(
        told + against,
        DoubtfulMatchWarning,
        advice="the surfaces may not correspond; look at the map, try another {} (150 match best),"
        " or match these two alone with {}",
        remedies=("k", "landmarks"),
    )


def _as_good(other: Candidate, chosen: Candidate) -> bool:
    """Tell whether a map that shares nothing with the chosen one may be right as well."""
    C, values, best = chosen.functional_map, other.mismatches, chosen.mismatches
    tells = [(other.score, chosen.score), (values.get("landmarks", 0), best.get("landmarks", 0))]
    return (
        other.mirrored == chosen.mirrored
        and all(it < max(_ALIKE * right, _GOOD) for it, right in tells)
        and bool(((other.functional_map - C) ** 2).sum() > _NOTHING_SHARED * len(C))
    )
