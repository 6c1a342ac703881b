"""``stillpoint recover``: rescue what is readable of a damaged MCAP file."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.mcap.recover import Recovered, recover_file
from stillpoint.scripts.shared.batch import require_distinct
from stillpoint.scripts.shared.flags import Inputs, Jobs, OutDir, Workers
from stillpoint.scripts.shared.inputs import make_output_dir
from stillpoint.scripts.shared.jobs import SHORT, choose_exit_code, run_jobs
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json


def recover(paths: Inputs, /, *, out: OutDir, jobs: Jobs = None, json: JsonFile = None) -> int:
    """Save the readable part of damaged MCAP files, chunk by chunk, and print what was lost.

    Writes NAME.mcap for each file into another folder; the damaged file stays as it is. The exit code is 2 when there
    is nothing to rescue in one of them.

    Parameters
    ----------
    paths
        MCAP files of stillpoint or of any other program.
    out
        Folder to write into; made when it is not there.
    jobs
        Processes; by default one per core for many files, else this one alone.
    json
        Also write what was kept and lost as JSON to this file; - is the standard output.
    """
    folder = make_output_dir(out)
    for path in paths:
        if (folder / path.name).resolve() == path.resolve():
            raise BadParameter(f"--out {out}: is the folder of {path.name} itself; name another one")
    require_distinct(folder / path.name for path in paths)
    outcomes = run_jobs(partial(_recover_into, folder), paths, Workers(jobs), "recover", here_up_to=SHORT)
    rows: list[dict[str, Any]] = []
    for path, outcome in zip(paths, outcomes, strict=True):
        found, target = outcome.value, folder / path.name
        if found is None:
            rows.append({"file": str(path), "error": outcome.error})
            continue
        row = {"file": str(path), "recovered": str(target), "kept": dict(found.kept), "expected": dict(found.expected)}
        rows.append({**row, "lost": list(found.lost), "error": None})
        if json != STDOUT:
            _print_recovered(target, found)
    _print_failures(rows, len(paths))
    write_json(json, rows)
    return choose_exit_code(outcomes)


def _recover_into(folder: Path, path: Path) -> Recovered:
    return recover_file(path, folder / path.name)


def _print_recovered(target: Path, found: Recovered) -> None:
    """Print how many messages a rescued file has, and what was lost."""
    print_line(f"{target}: {sum(found.kept.values())} messages")
    for line in found.lost or ("nothing",):
        print_line(f"    lost: {line}")


def _print_failures(rows: Sequence[dict[str, Any]], count: int) -> None:
    """Print why files could not be recovered; raises :class:`StillpointError` for a single one."""
    errors = [row["error"] for row in rows if row["error"]]
    if errors and count == 1:
        raise StillpointError(errors[0])
    for error in errors:
        print_line(f"not recovered: {error}")
