"""Types of arguments that several verbs take: their flags and how their text is read."""

import re
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter, Token

from stillpoint.datasets.errors import BadParameter


def parse_whole_number(_: Any, tokens: Sequence[Token]) -> int:
    """Read an integer; cyclopts alone would round 1.5 in silence."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value!r} is not a whole number.") from None


Inputs = Annotated[list[Path], Parameter(negative=(), json_list=False)]
OutDir = Annotated[Path, Parameter(name=["--out", "-o"])]
OutBeside = Annotated[Path | None, Parameter(name=["--out", "-o"])]  # None: beside the file it is made of
SetFlag = Annotated[list[str] | None, Parameter(name="--set", negative=())]
Whole = Annotated[int, Parameter(converter=parse_whole_number)]
Jobs = Annotated[int | None, Parameter(converter=parse_whole_number)]
Columns = Annotated[str | None, Parameter(name="--columns")]

_SPAN = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h|d|w|y)")
_SECONDS = {"s": 1, "min": 60, "h": 3600, "d": 86400, "w": 7 * 86400, "y": 365.25 * 86400}


def read_span(text: str, flag: str) -> timedelta:
    """Return a length of time as users write it, 90s, 10min, 1h, 30d; raises :class:`BadParameter` for another text."""
    match = _SPAN.fullmatch(text.strip())
    if match is None:
        raise BadParameter(f"{flag} {text}: write a number and s, min, h, d, w or y, for example 30d")
    return timedelta(seconds=float(match[1]) * _SECONDS[match[2]])
