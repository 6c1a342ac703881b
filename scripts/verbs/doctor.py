"""``stillpoint doctor``: test recordings by physics and say what to do."""

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from rich.console import Console

from stillpoint.datasets.doctor import SEVERITIES, Diagnosis, Finding, Remedy, Severity, apply, diagnose
from stillpoint.datasets.doctor.stretches import choose_stretches, merge_diagnoses
from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.importers.options import parse_date, parse_place
from stillpoint.datasets.mcap.indexed import Window
from stillpoint.datasets.mcap.pieces import read_window
from stillpoint.datasets.mcap.store import read_recording, write
from stillpoint.datasets.names import make_printable
from stillpoint.datasets.recording import Recording
from stillpoint.scripts.shared.batch import require_distinct
from stillpoint.scripts.shared.flags import LOCAL, Inputs, Workers
from stillpoint.scripts.shared.inputs import find_recordings, make_output_dir
from stillpoint.scripts.shared.jobs import choose_exit_code
from stillpoint.scripts.shared.kept import REUSE, Deciding, Keeping, Task, run_kept
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.shared.recordings import find_rests_at_default
from stillpoint.scripts.shared.tables import print_table

_UNREADABLE = "unreadable"  # the code of a file that could not be opened
_COLOURS = {"error": "red", "warning": "yellow", "fact": "default"}
_MOST_NAMED = 3  # recordings that a row of the summary names


@dataclass(frozen=True)
class _Job:
    """One file: what is known of it, where the repaired recording goes, and what is left out of the repair."""

    source: Path
    place: tuple[float, float, float] | None
    date: str
    target: Path | None
    skip: tuple[str, ...]


@dataclass(frozen=True)
class _Examined:
    """The diagnosis of one file, and how many of its remedies were applied."""

    diagnosis: Diagnosis
    applied: int


def doctor(
    paths: Inputs,
    /,
    *,
    repair: Annotated[bool, Parameter(name=["--repair", "--apply"], negative="")] = False,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    skip: Annotated[tuple[str, ...], Parameter(name="--skip", negative="")] = (),
    place: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    date: str | None = None,
    errors: Annotated[bool, Parameter(negative="")] = False,
    strict: Annotated[bool, Parameter(negative="")] = False,
    workers: Workers = LOCAL,
    keeping: Keeping = REUSE,
    json: JsonFile = None,
) -> int:
    """Test recordings by physics and say what to do.

    Axes, signs, units, clocks, lags, clipping, the field, noise, bias, and the truth. Findings do not change the exit
    code; a file that cannot be read makes it 2, and the others are tested. Several files end in a summary, and their
    facts stand in the JSON only.

    A recording of more than a million samples of its IMU is examined by four stretches, which a fact names; with
    --repair it is read whole.

    Parameters
    ----------
    paths
        Recordings: MCAP files, folders or globs.
    repair
        Write recordings with the remedies applied to the folder --out.
    out
        Folder for the repaired recordings; must not be the one they come from.
    skip
        Code of a finding whose remedy --repair leaves out; may be given several times.
    place
        Where the recordings were made: LAT,LON or LAT,LON,ALT in deg and m. It determines the dip of the Earth's field.
    date
        When they were made, for example 2025-08-31.
    errors
        Print errors only.
    strict
        Exit with 2 when a recording has an error or a warning.
    json
        Also write the findings as JSON to this file; - is the standard output.
    """
    if repair != (out is not None):
        raise BadParameter("doctor: --repair and --out DIR belong together; give both or neither")
    where = None if place is None else parse_place(place)
    when = "" if date is None else parse_date(date)
    sources = find_recordings(paths)
    targets = {} if out is None else _choose_targets(sources, make_output_dir(out))
    work = [_Job(source, where, when, targets.get(source), skip) for source in sources]
    console = Console(highlight=False, markup=False, soft_wrap=True, stderr=json == STDOUT)
    shown = _choose_severities(errors, single=len(sources) == 1)
    outcomes = run_kept(_examine_file, work, _decide, workers, keeping, "doctor", _Examined)
    made: list[Diagnosis] = []
    for job, outcome in zip(work, outcomes, strict=True):
        if outcome.value is None:
            if len(work) == 1 and not outcome.defect:
                raise StillpointError(str(outcome.error))
            print_line(f"stillpoint: {outcome.error}", file=sys.stderr)
            made.append(Diagnosis(job.source.stem, (Finding(_UNREADABLE, "error", str(outcome.error)),)))
            continue
        diagnosis = outcome.value.diagnosis
        made.append(diagnosis)
        _show(console, job.source, diagnosis, shown)
        if job.target is not None:
            count = f"{outcome.value.applied} of {len(diagnosis.remedies)} remedies applied"
            console.print(make_printable(f"  {count}: {job.target}"))
    codes = {code for diagnosis in made for code in diagnosis.codes()}
    for code in sorted(set(skip) - codes):
        console.print(make_printable(f"--skip {code}: nothing of this name was found"))
    if len(made) > 1 and json != STDOUT:
        _print_summary(made, ("error",) if errors else ("error", "warning"))
    write_json(json, [row for diagnosis in made for row in diagnosis.rows()])
    failed = choose_exit_code(outcomes)
    if failed == 0 and strict and not all(diagnosis.clean for diagnosis in made):
        print_line("stillpoint: doctor found errors or warnings (--strict)", file=sys.stderr)
        return 2
    return failed


def _choose_severities(errors: bool, single: bool) -> tuple[Severity, ...]:
    """Return which findings are printed: all of a single file, errors and warnings of several."""
    if errors:
        return ("error",)
    return SEVERITIES if single else ("error", "warning")


def _decide(job: _Job) -> Deciding:
    """Return what decides a diagnosis: the recording, what else is known of it, and the repair that is asked for."""
    repair = {"repair": job.target is not None, "skip": list(job.skip) if job.target is not None else []}
    return Deciding((job.source,), {"place": job.place, "date": job.date, **repair}, job.target)


def _examine_file(task: Task[_Job]) -> _Examined:
    """Diagnose one file and write the repaired recording where that is asked for."""
    job = task.item
    stretches = choose_stretches(job.source) if job.target is None else []
    if stretches:
        return _Examined(_examine_stretches(job, stretches), 0)
    recording = _place_recording(job, read_recording(job.source, units_unchecked=True))
    diagnosis = examine(recording)
    if job.target is None:
        return _Examined(diagnosis, 0)
    remedies = select_remedies(diagnosis, job.skip)
    write(job.target, apply(recording, remedies), origin=task.origin)
    return _Examined(diagnosis, len(remedies))


def _examine_stretches(job: _Job, stretches: Sequence[Window]) -> Diagnosis:
    """Diagnose a long recording by some stretches, of which one is in memory at a time."""
    made = []
    for stretch in stretches:
        recording = read_window(job.source, stretch, units_unchecked=True)
        made.append((stretch, examine(_place_recording(job, recording))))
    return merge_diagnoses(made)


def _place_recording(job: _Job, recording: Recording) -> Recording:
    """Return the recording with the place and the date that the user knows."""
    info = recording.info
    if job.place is None and not job.date:
        return recording
    place = info.place_lat_lon_alt if job.place is None else job.place
    return replace(recording, info=replace(info, place_lat_lon_alt=place, date=job.date or info.date))


def _print_summary(made: Sequence[Diagnosis], severities: tuple[Severity, ...]) -> None:
    """Print one row per code: how many recordings have it, and the first of them."""
    found: dict[tuple[str, str], list[str]] = {}
    for diagnosis in made:
        for finding in diagnosis.findings:
            if finding.severity in severities:
                names = found.setdefault((finding.severity, finding.code), [])
                if diagnosis.recording not in names:
                    names.append(diagnosis.recording)
    clean = sum(diagnosis.clean for diagnosis in made)
    ordered = sorted(found.items(), key=lambda item: (item[0][0], -len(item[1]), item[0][1]))
    rows = [
        [severity, code, str(len(names)), ", ".join(names[:_MOST_NAMED]) + (" …" if len(names) > _MOST_NAMED else "")]
        for (severity, code), names in ordered
    ]
    title = f"{len(made)} recordings, {clean} clean"
    if rows:
        print_table(title, ["severity", "finding", "recordings", "of them"], [rows])
    else:
        print_line(f"{title}, no {' or '.join(severities)}")


def examine(recording: Recording) -> Diagnosis:
    """Find the rests and diagnose; repeat both when units had to be corrected before rests could be found."""
    if recording.imu is None:
        return diagnose(recording, np.empty((0, 2), dtype=np.int64))
    diagnosis = diagnose(recording, find_rests_at_default(recording))
    units = [
        one.remedy for one in diagnosis.findings if one.code in ("gyro-units", "accel-units") and one.remedy is not None
    ]
    if not units:
        return diagnosis
    return diagnose(recording, find_rests_at_default(apply(recording, units)))


def select_remedies(diagnosis: Diagnosis, skip: tuple[str, ...]) -> list[Remedy]:
    """Return the remedies of all findings except those whose codes are to be skipped."""
    return [one.remedy for one in diagnosis.findings if one.remedy is not None and one.code not in skip]


def _choose_targets(sources: Sequence[Path], folder: Path) -> dict[Path, Path]:
    """Return where the repaired recordings go: never over those that were read, nor over each other."""
    targets = {source: folder / source.name for source in sources}
    for source, target in targets.items():
        if target.resolve() == source.resolve():
            raise BadParameter(f"{source}: would be overwritten; name another folder with --out")
    require_distinct(targets.values())
    return targets


def _show(console: Console, path: Path, diagnosis: Diagnosis, shown: Sequence[Severity]) -> None:
    """Print the findings of these severities, the worst first."""
    counts = Counter(finding.severity for finding in diagnosis.findings)
    words = [f"{counts[kind]} {kind}{'' if counts[kind] == 1 else 's'}" for kind in SEVERITIES]
    console.print(make_printable(f"{path}: {', '.join(words)}{': clean' if diagnosis.clean else ''}"))
    for kind in shown:
        for finding in diagnosis.findings:
            if finding.severity == kind:
                line = make_printable(f"  {kind:7} {finding.code:18} {finding.message}")
                console.print(line, style=_COLOURS[kind])
