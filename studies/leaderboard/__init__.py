"""Many recordings, many estimators, one verdict."""

from stillpoint.studies.leaderboard.board import Leaderboard, Pair, Row, Run, Source, Summary, Table

__all__ = ["Leaderboard", "Pair", "Row", "Run", "Source", "Summary", "Table"]
