"""Match two surfaces without mirroring them: candidates, their scores, the best one refined.

And many, so that their maps agree: `match_collection`.
"""

from spectra_kit.matching.collection import CollectedPair, Collection, match_collection
from spectra_kit.matching.local import local_confidence
from spectra_kit.matching.match import match
from spectra_kit.matching.options import MatchOptions, ScoreWeights
from spectra_kit.matching.partial import match_part
from spectra_kit.matching.prepare import Prepared, prepare
from spectra_kit.matching.result import Candidate, Match
from spectra_kit.matching.score import (
    coverage_over_chance,
    mismatches,
    orientation_of,
    score_of,
)

__all__ = [
    "Candidate",
    "CollectedPair",
    "Collection",
    "Match",
    "MatchOptions",
    "Prepared",
    "ScoreWeights",
    "coverage_over_chance",
    "local_confidence",
    "match",
    "match_collection",
    "match_part",
    "mismatches",
    "orientation_of",
    "prepare",
    "score_of",
]
