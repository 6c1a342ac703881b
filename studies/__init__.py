"""Studies that run estimators and the smoother over many recordings, for notebooks and the command line alike.

leaderboard(recordings, estimators, out) -> Leaderboard
"""

from stillpoint.studies.leaderboard import Leaderboard, leaderboard

__all__ = ["Leaderboard", "leaderboard"]
