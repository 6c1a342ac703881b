"""Types of arguments that several verbs take: their flags and how their text is read."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter, Token


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
