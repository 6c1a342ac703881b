"""``stillpoint archive verify``, ``repair`` and ``rebuild``: what checks and mends an archive."""

import time
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated

from cyclopts import Parameter

from stillpoint.datasets.archive.repair import Copies, repair_archive
from stillpoint.datasets.archive.verify import Fault, verify_archive
from stillpoint.scripts.shared.json_file import STDOUT, JsonFile, write_json
from stillpoint.scripts.verbs.archives.common import ArchiveDir, open_named


def verify(*, archive: ArchiveDir = None, json: JsonFile = None) -> int:
    """Read everything, and list what is wrong and how to repair it; the exit code is 1 when something is.

    Checked are the hash of every object, all checksums in MCAP files, every record, the catalogue against the
    objects, the links, and that everything that was made has what it was made from.

    Parameters
    ----------
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    json
        Also write the faults as JSON to this file; - is the standard output.
    """
    begun = time.perf_counter()
    with open_named(archive) as opened:
        found = verify_archive(opened)
    seconds = time.perf_counter() - begun
    if json != STDOUT:
        print_faults(found.faults)
        speed = found.bytes / 1e6 / max(seconds, 1e-9)
        state = f"{len(found.faults)} faults" if found.faults else "clean"
        print(
            f"{found.objects} objects, {found.bytes / 1e6:.1f} MB read in {seconds:.1f} s ({speed:.0f} MB/s): {state}"
        )
    write_json(json, [asdict(fault) for fault in found.faults])
    return 1 if found.faults else 0


def repair(
    *,
    archive: ArchiveDir = None,
    from_: Annotated[str | None, Parameter(name="--from")] = None,
    json: JsonFile = None,
) -> int:
    """Mend damaged objects from a copy, and damaged records from a copy or from the catalogue.

    Only bytes with the right SHA-256 are taken. The exit code is 1 when something is left.

    Parameters
    ----------
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    from_
        Another archive, a bundle, or any folder of files that may hold copies.
    json
        Also write what is left as JSON to this file; - is the standard output.
    """
    with open_named(archive) as opened:
        copies = None if from_ is None else Copies(from_)
        done, left = repair_archive(opened, verify_archive(opened).faults, copies)
    if json != STDOUT:
        for line in done:
            print(line)
        print_faults(left)
        print(f"{len(done)} repaired, {len(left)} left")
    write_json(json, [asdict(fault) for fault in left])
    return 1 if left else 0


def rebuild(*, archive: ArchiveDir = None) -> int:
    """Make the catalogue anew from the objects and their records; the exit code is 1 when one could not be read.

    Parameters
    ----------
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    """
    with open_named(archive) as opened:
        problems = opened.rebuild()
        count = len(opened.catalogue.entries())
    for problem in problems:
        print(problem)
    print(f"{count} objects in the catalogue")
    return 1 if problems else 0


def print_faults(faults: Sequence[Fault]) -> None:
    """Two lines per fault: what is wrong where, and how to repair it."""
    for fault in faults:
        print(f"{fault.level}: {fault.where}: {fault.what}")
        print(f"    {fault.repair}")
