"""``stillpoint doctor``: test recordings by physics and say what to do."""

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from rich.console import Console

from stillpoint.datasets.doctor import SEVERITIES, Diagnosis, Finding, Remedy, apply, diagnose
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.mcap.store import read_recording, write
from stillpoint.datasets.recording import Recording
from stillpoint.scripts.shared.batch import require_distinct
from stillpoint.scripts.shared.flags import Inputs
from stillpoint.scripts.shared.inputs import each_read, output_dir, recordings
from stillpoint.scripts.shared.output import STDOUT, JsonFile, write_json
from stillpoint.scripts.shared.recordings import find_rests_at_default

UNREADABLE = "unreadable"  # the code of a file that could not be opened
COLOURS = {"error": "red", "warning": "yellow", "fact": "default"}


def doctor(
    paths: Inputs,
    /,
    *,
    repair: Annotated[bool, Parameter(name="--apply", negative="")] = False,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    skip: Annotated[tuple[str, ...], Parameter(name="--skip", negative="")] = (),
    strict: Annotated[bool, Parameter(negative="")] = False,
    json: JsonFile = None,
) -> int:
    """Test recordings by physics and say what to do.

    Axes, signs, units, clocks, lags, clipping, the field, noise and bias. Findings do not change the exit code;
    a file that cannot be read makes it 2, and the others are tested.

    Parameters
    ----------
    paths
        Recordings: MCAP files, folders or globs.
    repair
        Write recordings with the remedies applied to the folder --out.
    out
        Folder for the repaired recordings; must not be the one they come from.
    skip
        Code of a finding whose remedy --apply leaves out; may be given several times.
    strict
        Exit with 2 when a recording has an error or a warning.
    json
        Also write the findings as JSON to this file; - is the standard output.
    """
    if repair != (out is not None):
        raise BadParameter("doctor: --apply and --out DIR belong together; give both or neither")
    sources = recordings(paths)
    targets = {} if out is None else _targets(sources, output_dir(out))
    console = Console(highlight=False, markup=False, soft_wrap=True, stderr=json == STDOUT)
    made: list[Diagnosis] = []
    for path, recording, error in each_read(sources, partial(read_recording, units_unchecked=True)):
        if recording is None:
            made.append(Diagnosis(path.stem, (Finding(UNREADABLE, "error", error),)))
            continue
        diagnosis = examine(recording)
        made.append(diagnosis)
        _show(console, path, diagnosis)
        if targets:
            remedies = chosen(diagnosis, skip)
            write(targets[path], apply(recording, remedies))
            console.print(f"  {len(remedies)} of {len(diagnosis.remedies)} remedies applied: {targets[path]}")
    codes = {code for diagnosis in made for code in diagnosis.codes()}
    for code in sorted(set(skip) - codes):
        console.print(f"--skip {code}: nothing of this name was found")
    write_json(json, [row for diagnosis in made for row in diagnosis.rows()])
    if strict and not all(diagnosis.clean for diagnosis in made):
        print("stillpoint: doctor found errors or warnings (--strict)", file=sys.stderr)
        return 2
    return 2 if UNREADABLE in codes else 0


def examine(recording: Recording) -> Diagnosis:
    """Find the rests and diagnose; once more when remedies were needed before rests could be seen."""
    if recording.imu is None:
        return diagnose(recording, np.empty((0, 2), dtype=np.int64))
    diagnosis = diagnose(recording, find_rests_at_default(recording))
    units = [
        one.remedy for one in diagnosis.findings if one.code in ("gyro-units", "accel-units") and one.remedy is not None
    ]
    if not units:
        return diagnosis
    return diagnose(recording, find_rests_at_default(apply(recording, units)))


def chosen(diagnosis: Diagnosis, skip: tuple[str, ...]) -> list[Remedy]:
    """The remedies of all findings but those whose codes are to be skipped."""
    return [one.remedy for one in diagnosis.findings if one.remedy is not None and one.code not in skip]


def _targets(sources: Sequence[Path], folder: Path) -> dict[Path, Path]:
    """Where the repaired recordings go: never over those that were read, nor over each other."""
    targets = {source: folder / source.name for source in sources}
    for source, target in targets.items():
        if target.resolve() == source.resolve():
            raise BadParameter(f"{source}: would be overwritten; name another folder with --out")
    require_distinct(targets.values())
    return targets


def _show(console: Console, path: Path, diagnosis: Diagnosis) -> None:
    sizes = [(len(diagnosis.codes(kind)), kind) for kind in SEVERITIES]
    counts = [f"{count} {kind}{'' if count == 1 else 's'}" for count, kind in sizes]
    console.print(f"{path}: {', '.join(counts)}{': clean' if diagnosis.clean else ''}")
    for kind in SEVERITIES:
        for finding in diagnosis.findings:
            if finding.severity == kind:
                console.print(f"  {kind:7} {finding.code:18} {finding.message}", style=COLOURS[kind])
