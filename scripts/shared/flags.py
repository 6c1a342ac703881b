"""Types of arguments that several verbs take: their flags and how their text is read."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
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

_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*(k|M|G|T)?(i)?B?")
_JOBS = "Processes of this machine; by default one per core, fewer for few inputs."
_SCHEDULER = (
    "Address of a Dask scheduler whose workers do the work, for example tcp://10.0.0.5:8786. They must see the files "
    "under the same paths or URLs (docs/scale.md). Needs the extra cluster."
)
_MEMORY_LIMIT = (
    "Most memory of each process, for example 2GB. An input that needs more is named, and the others are done."
)
_POWERS = {None: 0, "k": 1, "M": 2, "G": 3, "T": 4}
_LEAST_MEMORY_BYTES = 100_000_000  # Python with numpy alone holds more than half of it


def parse_memory(_: Any, tokens: Sequence[Token]) -> int:
    """Read a size of memory, 2GB, 500MB or 1.5GiB, in bytes."""
    text = tokens[0].value
    match = _SIZE.fullmatch(text.strip())
    size = 0.0 if match is None else float(match[1]) * (1024 if match[3] else 1000) ** _POWERS[match[2]]
    if size < _LEAST_MEMORY_BYTES:
        raise ValueError(f"{text!r} is no size of memory of 100MB or more; write for example 2GB.")
    return int(size)


@Parameter(name="*")
@dataclass(frozen=True)
class Workers:
    """Who works on the inputs: this machine's processes, or those of a cluster."""

    jobs: Annotated[int | None, Parameter(converter=parse_whole_number, help=_JOBS)] = None
    scheduler: Annotated[str | None, Parameter(help=_SCHEDULER)] = None
    memory_limit: Annotated[int | None, Parameter(converter=parse_memory, help=_MEMORY_LIMIT)] = None  # bytes


LOCAL = Workers()

_SPAN = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h|d|w|y)")
_SECONDS = {"s": 1, "min": 60, "h": 3600, "d": 86400, "w": 7 * 86400, "y": 365.25 * 86400}


def split_names(text: str) -> list[str]:
    """Return the names in a list with commas, each once and in the given order."""
    return list(dict.fromkeys(name.strip() for name in text.split(",")))


def read_span(text: str, flag: str) -> timedelta:
    """Return a length of time as users write it, 90s, 10min, 1h, 30d; raises :class:`BadParameter` for another text."""
    match = _SPAN.fullmatch(text.strip())
    if match is None:
        raise BadParameter(f"{flag} {text}: write a number and s, min, h, d, w or y, for example 30d")
    return timedelta(seconds=float(match[1]) * _SECONDS[match[2]])
