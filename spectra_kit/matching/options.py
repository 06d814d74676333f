"""`MatchOptions`: what `match` tries, weighs, keeps and believes, in one value."""

from __future__ import annotations

from dataclasses import dataclass

from spectra_kit._checked import checked
from spectra_kit._validate import check_count, check_weights


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
    >>> sk.matching.ScoreWeights().curvature
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
    """How `match` searches and judges; measured on pairs of bodies and animals.

    Lengths and areas are those of surfaces at unit area.

    Parameters
    ----------
    signed_modes : int, default 7
        Modes whose signs are tried, the constant among them: 2^6 choices.
    orders : int, default 32
        Likeliest orders of these modes that are tried: 2048 candidates in all.
    first_samples : int, default 48
        On which these are compared.
    growing : int, default 96
        How many then start to grow.
    kept : tuple of (int, int), default ((8, 48), (11, 16))
        From so many modes on, how many go on growing.
    growing_samples : int, default 200
        On which they grow.
    grown_modes : int, default 30
        To which they grow.
    form_modes : int, default 8
        Whose area forms are compared.
    forms_until : int, default 20
        Modes from which a map holds its orientation by itself, without area forms.
    form_share : float, default 0.5
        Squared length of the area forms, relative to that of the modes.
    curvature_share : float, default 0.1
        The same for curvature.
    growing_curvatures : int, default 3
        How many of the smoothed curvatures candidates grow by, from the finest.
    aligned_samples : int, default 400
        On which the source is laid onto the target and bent.
    turns : int, default 12
        Turns about the longest axis that are tried, either way along it.
    placed_modes : tuple of int, default (6, 9, 14, 20)
        To which surfaces are smoothed as one is laid onto the other; at last to the grown modes.
    placed : int, default 8
        Candidates that come of it.
    bending_modes : int, default 20
        In which the source is bent.
    stiffness : float, default 0.3
        Of the last of these modes, relative to the pull of the points.
    bent_steps : int, default 4
        From the grown modes to the refined ones.
    aligned_normals : float, default 0.4
        Length that normals count like, beside positions.
    aligned_curvature : float, default 0.1
        Of each curvature.
    aligned_modes : float, default 0.5
        Of all modes together, as one is laid onto the other.
    held_modes : float, default 4.0
        The same as the source is bent: shapes of different kinds, drawn to the nearest point,
        leave a right map.
    landmark_energies : int, default 20
        Of the wave kernel signature seen from each landmark.
    finalists : int, default 8
        Candidates that are refined.
    refined_modes : int, default 60
        To which they are refined.
    same : float, default 0.05
        Squared difference per mode below which two maps are one.
    rival : float, default 0.15
        The same, below which one is no rival of the other.
    weights : ScoreWeights
        Of the mismatches in a score.
    scored_curvatures : int, default 2
        How many of the smoothed curvatures are scored, from the finest.
    rough_samples : int, default 200
        Of a rough score.
    least_mismatch : float, default 1e-3
        Below which maps count as equally good.
    mirrored_by : float, default 3.0
        How many times better a mirrored map must be to be believed.
    contest : float, default 1.15
        Candidates whose scores are within that factor of the best are bent onto the target, too.
        If one leaves no more than the spacing of the points, what counts is the score times the
        square of what each leaves.
    contenders : int, default 4
        How many at most, the best among them.
    last_steps : int, default 3
        From the refined modes to the end.
    curvature_scale : float, default 2.0
        Of each curvature in those steps: it counts like four modes.
    pull : float, default 400.0
        Weight of the target in bending: rigid below lengths of 1/20.
    normal_length : float, default 0.05
        Length that a turn of the normal by one radian counts like.
    rounds : int, default 5
        Of finding nearest points.
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
    >>> sk.matching.MatchOptions(finalists=12).finalists
    12
    """

    signed_modes: int = 7
    orders: int = 32
    first_samples: int = 48
    growing: int = 96
    kept: tuple[tuple[int, int], ...] = ((8, 48), (11, 16))
    growing_samples: int = 200
    grown_modes: int = 30
    form_modes: int = 8
    forms_until: int = 20
    form_share: float = 0.5
    curvature_share: float = 0.1
    growing_curvatures: int = 3
    aligned_samples: int = 400
    turns: int = 12
    placed_modes: tuple[int, ...] = (6, 9, 14, 20)
    placed: int = 8
    bending_modes: int = 20
    stiffness: float = 0.3
    bent_steps: int = 4
    aligned_normals: float = 0.4
    aligned_curvature: float = 0.1
    aligned_modes: float = 0.5
    held_modes: float = 4.0
    landmark_energies: int = 20
    finalists: int = 8
    refined_modes: int = 60
    same: float = 0.05
    rival: float = 0.15
    weights: ScoreWeights = ScoreWeights()
    scored_curvatures: int = 2
    rough_samples: int = 200
    least_mismatch: float = 1e-3
    mirrored_by: float = 3.0
    contest: float = 1.15
    contenders: int = 4
    last_steps: int = 3
    curvature_scale: float = 2.0
    pull: float = 400.0
    normal_length: float = 0.05
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
        for modes in self.placed_modes:
            check_count("placed_modes", modes, low=1)


#: What functions take without options of their own.
DEFAULT = MatchOptions()
