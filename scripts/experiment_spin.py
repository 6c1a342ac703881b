"""``stillpoint experiment spin-constant`` and ``spin-variable``: the two scenarios of paper 000."""

from pathlib import Path

from stillpoint.scripts.flags import OutDir


def constant(*, out: OutDir = Path()) -> None:
    """Roll at constant speed."""


def variable(*, out: OutDir = Path()) -> None:
    """Roll at variable speed."""
