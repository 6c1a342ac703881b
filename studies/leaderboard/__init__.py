"""Many recordings, many estimators, one verdict."""

from stillpoint.studies.leaderboard.board import Leaderboard, Pair, Row, Run, Source, Summary, Table
from stillpoint.studies.leaderboard.run import leaderboard, run_study
from stillpoint.studies.leaderboard.series import ErrorOverTime, read_error_series
from stillpoint.studies.leaderboard.study import Study, format_study, read_study

__all__ = [
    "ErrorOverTime",
    "Leaderboard",
    "Pair",
    "Row",
    "Run",
    "Source",
    "Study",
    "Summary",
    "Table",
    "format_study",
    "leaderboard",
    "read_error_series",
    "read_study",
    "run_study",
]
