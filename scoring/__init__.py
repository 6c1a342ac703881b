"""How good an estimate is: scores against a truth or a reference, pictures, and the report.

score(estimate, truth, align="heading", frame="nwu") -> Score
"""

from stillpoint.scoring.align import ALIGN_KINDS, AlignKind, Alignment
from stillpoint.scoring.compare import Comparison, compare
from stillpoint.scoring.score import Score, score, score_of, score_row

__all__ = ["ALIGN_KINDS", "AlignKind", "Alignment", "Comparison", "Score", "compare", "score", "score_of", "score_row"]
