"""The parts that verbs with one output file per input share: settings, targets, refusals, exit codes."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.scripts.shared.children import Outcome
from stillpoint.scripts.shared.output import STDOUT, write_json
from stillpoint.scripts.shared.tables import print_refusals, print_table


def parse_assignments(pairs: Sequence[str] | None, example: str) -> dict[str, str]:
    """Read texts NAME=VALUE as ``{name: value}``; raises :class:`BadParameter` with the example for another text."""
    changes = {}
    for pair in pairs or ():
        name, equals, value = pair.partition("=")
        if not (equals and name.strip()):
            raise BadParameter(f"--set {pair}: write NAME=VALUE, for example {example}")
        changes[name.strip()] = value.strip()
    return changes


def require_distinct(targets: Iterable[Path]) -> None:
    """Raise :class:`BadParameter` when two inputs would be written to one file."""
    twice = [target for target, count in Counter(targets).items() if count > 1]
    if twice:
        raise BadParameter(f"{twice[0].name}: two recordings have this name; write them to different folders")


def make_row(named: Mapping[str, str], target: Path, outcome: Outcome[dict[str, Any]]) -> dict[str, Any]:
    """Return the row of one file: what it was made of, where it is, and its facts or the reason why there is none."""
    if outcome.value is None:
        return {**named, "file": None, "error": outcome.error, "defect": outcome.defect}
    return {**named, "file": str(target), **outcome.value, "error": None, "kept": outcome.kept}


def report_made(
    title: str,
    columns: Sequence[str],
    rows: Sequence[dict[str, Any]],
    cells: Callable[[dict[str, Any]], list[str]],
    json: str | None,
    wanted: str | None = None,
) -> int:
    """Print and write the rows; return 0, 1 when one is a defect of stillpoint, 2 when one has another error.

    The error of a single row is raised when the user can fix it. The second column is what the file was made by; its
    heading is the key of that in the rows. ``wanted`` names the columns to show, as for
    :func:`~stillpoint.scripts.shared.tables.print_table`.
    """
    if len(rows) == 1 and rows[0]["error"] is not None and not rows[0]["defect"]:
        raise StillpointError(rows[0]["error"])
    if json != STDOUT:
        print_table(title, columns, [[cells(row) for row in rows]], wanted=wanted)
        print_refusals("not made", ((row["error"], row[columns[1]]) for row in rows if row["error"] is not None))
    write_json(json, rows)
    if any(row.get("defect") for row in rows):
        return 1
    return 2 if any(row["error"] is not None for row in rows) else 0
