"""`MatchOptions`: what `match` tries, weighs, keeps and believes, in one value."""

from __future__ import annotations

from dataclasses import dataclass

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import check_count, check_weights


@checked
@dataclass(frozen=True, kw_only=True)
class ScoreWeights:
    """Exponents of the mismatches in a score; those of a kind that is absent are left out.

    Parameters
    ----------
    curvature, wave, spacing, embedding, orientation, alignment, lengths, landmarks : float
        See `mismatches`, which tells what they are and which of them a map may lack.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.ScoreWeights().curvature
    3.0
    """

    curvature: float = 3.0
    wave: float = 0.1
    spacing: float = 0.5
    embedding: float = 0.2
    orientation: float = 0.2
    alignment: float = 0.5
    lengths: float = 1.0
    landmarks: float = 2.0

    def __post_init__(self) -> None:
        check_weights(vars(self))


@checked
@dataclass(frozen=True, kw_only=True)
class MatchOptions:
    """How much `match` tries, and what it believes; measured on pairs of bodies and animals.

    What maps are made of, as numbers of modes and samples, is no option: a choice of one of them
    decides what the others must be.

    Parameters
    ----------
    orders : int, default 32
        Likeliest orders of the lowest seven modes that are tried, each with all 64 choices of
        signs: 2048 candidates in all.
    growing : int, default 96
        How many of these start to grow.
    kept : tuple of (int, int), default ((8, 48), (11, 16))
        From so many modes on, how many go on growing.
    turns : int, default 12
        Turns about its longest axis in which the source is laid onto the target, either way along
        it.
    placed : int, default 8
        Candidates that come of it.
    finalists : int, default 8
        Candidates that are refined.
    weights : ScoreWeights
        Of the mismatches in a score.
    mirrored_by : float, default 3.0
        How many times better a mirrored map must be to be believed.
    rounds : int, default 5
        Of finding nearest points, as the source is bent onto the target.
    bends : int, default 2
        Of bending within each round.
    first_bends : int, default 8
        The same in the first round.
    clear_margin : float, default 1.01
        Below which a match is ambiguous, as a rival scored as well: so it was for 22 of 272 right
        maps of bodies and animals, and for 10 of 24 wrong ones.
    doubtful_mirror : float, default 1.1
        How many times better a map of the other orientation must be to raise doubts: it was up to
        1.16 times better for right ones.
    clear_orientation : float, default 0.5
        Size of it below which a map may be flipped in parts: right ones had 0.7 and more.
    clear_sides : float, default 0.9
        Share of the triangles that agree below which it is in doubt which side of a cloud is out.
    convincing_score : float, default 0.42
        Above which a score speaks against the map: unrelated shapes had 0.44 and more, nine of ten
        right maps 0.36 and less.
    convincing_torn : float, default 0.02
        The same of the share that is torn: unrelated shapes had 0.029 and more, nine of ten right
        maps 0.018 and less.
    convincing_coverage : float, default 1.1
        Below which coverage does: all right maps had more.

    Raises
    ------
    InvalidInputError
        If a number is out of range.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.MatchOptions(finalists=12).finalists
    12
    """

    orders: int = 32
    growing: int = 96
    kept: tuple[tuple[int, int], ...] = ((8, 48), (11, 16))
    turns: int = 12
    placed: int = 8
    finalists: int = 8
    weights: ScoreWeights = ScoreWeights()
    mirrored_by: float = 3.0
    rounds: int = 5
    bends: int = 2
    first_bends: int = 8
    clear_margin: float = 1.01
    doubtful_mirror: float = 1.1
    clear_orientation: float = 0.5
    clear_sides: float = 0.9
    convincing_score: float = 0.42
    convincing_torn: float = 0.02
    convincing_coverage: float = 1.1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, int):
                check_count(name, value, low=1)
        check_weights({k: v for k, v in vars(self).items() if isinstance(v, float)})
        for modes, count in self.kept:
            check_count("kept", min(modes, count), low=1)


#: What functions take without options of their own.
DEFAULT = MatchOptions()
