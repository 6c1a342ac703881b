"""How good an estimate is: scores against a truth or a reference, pictures, and the report.

score(estimate, truth, align="heading", frame="nwu", over_s=()) -> Score
score_roll(estimate, truth, zero="start") -> SpinScore, of angle and rate about a spin axis
"""

from stillpoint.scoring.align import ALIGN_KINDS, AlignKind, Alignment
from stillpoint.scoring.compare import Comparison, compare
from stillpoint.scoring.score import Score, score, score_of, score_row
from stillpoint.scoring.spin import SpinScore, score_roll
from stillpoint.scoring.turns import TurnError

__all__ = [
    "ALIGN_KINDS",
    "AlignKind",
    "Alignment",
    "Comparison",
    "Score",
    "SpinScore",
    "TurnError",
    "compare",
    "score",
    "score_of",
    "score_roll",
    "score_row",
]
