"""``stillpoint archive verify``, ``repair`` and ``rebuild``: they check and repair an archive."""

import time
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Annotated

from cyclopts import Parameter

from stillpoint.datasets.archive import Archive
from stillpoint.datasets.archive.repair import Copies, repair_archive
from stillpoint.datasets.archive.verify import Fault, verify_archive
from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.shared.flags import Jobs, Whole, Workers
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.verbs.archives.common import ArchiveDir, open_named

_TOLERANCE_RAD = 1e-9  # on one kind of processor, where the same bits come out; docs/archive.md has what others change


def verify(
    *,
    archive: ArchiveDir = None,
    thorough: Annotated[bool, Parameter(negative="")] = False,
    remake: str | None = None,
    seed: Whole = 0,
    tolerance: float = _TOLERANCE_RAD,
    jobs: Jobs = None,
    json: JsonFile = None,
) -> int:
    """Read everything, and list what is wrong and how to repair it; the exit code is 1 when something is.

    Checked are the hash of every object, every record, the catalogue against the objects, the links, and that
    everything that was made has what it was made from. All checksums in an MCAP file were tested when it was added;
    they are tested again where hash, record and catalogue do not agree.

    Parameters
    ----------
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    thorough
        Test all checksums in every MCAP file again.
    remake
        Also make this many references and estimates again, drawn at random, or all, with their recorded settings and
        inputs, and compare them with those that are kept.
    seed
        Of the draw.
    tolerance
        Largest difference, in rad; the default is for one kind of processor, 1e-7 for others (docs/archive.md).
    jobs
        Processes for --remake; by default one per core.
    json
        Also write the faults as JSON to this file; - is the standard output.
    """
    count = _read_count(remake)
    begun = time.perf_counter()
    with open_named(archive) as opened:
        found = verify_archive(opened, thorough)
        seconds = time.perf_counter() - begun
        if json != STDOUT:
            _print_faults(found.faults)
            state = f"{len(found.faults)} faults" if found.faults else "clean"
            speed = found.bytes / 1e6 / max(seconds, 1e-9)
            read = f"{found.bytes / 1e6:.1f} MB read in {seconds:.1f} s ({speed:.0f} MB/s)"
            inside = "tested" if thorough else "as tested when added"
            print_line(f"{found.objects} objects, {read}, checksums in MCAP files {inside}: {state}")
        faults = list(found.faults)
        if remake is not None:
            differing, lines = _remake(opened, count, seed, tolerance, jobs)
            faults += differing
            if json != STDOUT:
                _print_faults(differing)
                for line in lines:
                    print_line(line)
    write_json(json, [asdict(fault) for fault in faults])
    return 1 if faults else 0


def _read_count(remake: str | None) -> int | None:
    """Return how many to make again; None for all."""
    if remake is None or remake == "all":
        return None
    if not remake.isdecimal():
        raise BadParameter(f"--remake {remake}: give a number, or all")
    return int(remake)


def _remake(
    archive: Archive, count: int | None, seed: int, tolerance: float, jobs: int | None
) -> tuple[list[Fault], list[str]]:
    """Make the drawn objects again; return those that differ, and lines that say what was done."""
    from stillpoint.scripts.shared.jobs import run_jobs  # loads estimators and smoother, which verify alone needs not
    from stillpoint.studies.remake import draw_jobs, remake

    drawn, reasons = draw_jobs(archive, count, seed)
    outcomes = run_jobs(remake, drawn, Workers(jobs), "remake") if drawn else []
    here = version("stillpoint")
    faults = []
    for job, outcome in zip(drawn, outcomes, strict=True):
        if outcome.value is None:
            what = f"{job.file_name} could not be made again: {outcome.error}"
        elif outcome.value.difference_rad > tolerance:
            what = f"{job.file_name} differs by {outcome.value.difference_rad:.3g} rad from what is made now"
        else:
            continue
        if job.version != here:
            what += f" (stillpoint {job.version} made it, this is {here})"
        repair = f"install stillpoint {job.version}, or make the file again and add it"
        faults.append(Fault("remade", job.sha256, str(job.kept), what, repair))
    largest = max((one.value.difference_rad for one in outcomes if one.value is not None), default=0.0)
    lines = [
        f"{len(drawn)} made again, {len(faults)} differ by more than {tolerance:g} rad; the largest: {largest:.3g}"
    ]
    return faults, lines + [f"not made again: {name}: {reason}" for name, reason in reasons.items()]


def repair(
    *,
    archive: ArchiveDir = None,
    from_: Annotated[str | None, Parameter(name="--from")] = None,
    json: JsonFile = None,
) -> int:
    """Repair damaged objects from a copy, and damaged records from a copy or from the catalogue.

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
            print_line(line)
        _print_faults(left)
        print_line(f"{len(done)} repaired, {len(left)} left")
    write_json(json, [asdict(fault) for fault in left])
    return 1 if left else 0


def rebuild(*, archive: ArchiveDir = None) -> int:
    """Make the catalogue again from the objects and their records; the exit code is 1 when one could not be read.

    Parameters
    ----------
    archive
        The archive; by default STILLPOINT_ARCHIVE.
    """
    with open_named(archive) as opened:
        problems = opened.rebuild()
        count = len(opened.catalogue.entries())
    for problem in problems:
        print_line(problem)
    print_line(f"{count} objects in the catalogue")
    return 1 if problems else 0


def _print_faults(faults: Sequence[Fault]) -> None:
    """Print two lines per fault: what is wrong where, and how to repair it."""
    for fault in faults:
        print_line(f"{fault.level}: {fault.where}: {fault.what}")
        print_line(f"    {fault.repair}")
