"""``stillpoint fetch``: published datasets with independent truth, in one command."""

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.fetch import Fetched, Source, fetch_trials, find_source
from stillpoint.scripts.shared.flags import Jobs, OutBeside
from stillpoint.scripts.shared.inputs import make_output_dir
from stillpoint.scripts.shared.output import print_line
from stillpoint.scripts.verbs.import_ import Flags, import_

_HERE = Path("data")


def fetch(
    dataset: str,
    /,
    *,
    out: OutBeside = None,
    trials: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=True)] = None,
    list_: Annotated[bool, Parameter(name="--list", negative="")] = False,
    to: Annotated[Path | None, Parameter(name="--import")] = None,
    mirror: str | None = None,
    jobs: Jobs = None,
) -> int:
    """Fetch a published dataset with optical truth into FOLDER/DATASET, and say its licence and how to cite it.

    What is there already, whole, is kept, so that the command can be stopped and run again.

    Parameters
    ----------
    dataset
        broad (39 trials of an IMU), tyrex (126 of three phones) or repoimu (29 of an IMU on a stick).
    out
        Folder to write into, data unless given.
    trials
        Names, beginnings of names up to an underscore, or globs: --trials 02 04 "*tapping*". All trials unless given.
    list_
        List the trials, and fetch nothing.
    to
        Also import what was fetched into this folder.
    mirror
        Address of another server with the same paths, http://....
    jobs
        Processes that import; by default one per core for many trials.
    """
    source = find_source(dataset)
    chosen = source.select([text for each in trials or () for text in each.split(",")])
    if list_:
        for trial in chosen:
            print_line(trial)
        return 0
    print_line(source.title)
    print_line(f"licence: {source.licence}")
    print_line(f"cite: {source.citation}")
    folder = make_output_dir((_HERE if out is None else out) / source.name)
    all_fetched = fetch_trials(source, chosen, folder, mirror, _print_fetched)
    new, unpinned = (sum(getattr(one, name) for one in all_fetched) for name in ("downloaded", "first_seen"))
    print_line(f"{len(all_fetched)} files of {len(chosen)} trials in {folder}, {new} of them new")
    if unpinned:
        print_line(f"{unpinned} files have no SHA-256 in stillpoint: what came now holds from here on (SHA256SUMS)")
    items = [folder / source.item(trial) for trial in chosen]
    if to is None:
        print_line("the same command with --import FOLDER makes MCAP files of them")
        return 0
    return _import_trials(source, items, to, jobs)


def _print_fetched(one: Fetched) -> None:
    """Print the name of a file that was downloaded; nothing for one that was there."""
    if one.downloaded:
        print_line(f"  {one.path.name}", flush=True)


def _import_trials(source: Source, items: list[Path], to: Path, jobs: int | None) -> int:
    settings: dict[str, Any] = dict(source.settings)
    return import_(source.kind, *items, out=to, jobs=jobs, flags=Flags(**settings))
