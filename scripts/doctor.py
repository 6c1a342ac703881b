"""``stillpoint doctor``: test recordings by physics and say what to do."""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from rich.console import Console

from stillpoint.datasets.doctor import SEVERITIES, Diagnosis, Remedy, apply, diagnose
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.store import read_recording, write
from stillpoint.scripts.inputs import output_dir, recordings
from stillpoint.scripts.json_file import STDOUT, JsonFile, write_json
from stillpoint.smoother.rest import find_rests

COLOURS = {"error": "red", "warning": "yellow", "fact": "default"}


def doctor(
    *files: Path,
    repair: Annotated[bool, Parameter(name="--apply", negative="")] = False,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    skip: Annotated[tuple[str, ...], Parameter(name="--skip", negative="")] = (),
    strict: Annotated[bool, Parameter(negative="")] = False,
    json: JsonFile = None,
) -> int:
    """Test recordings by physics and say what to do.

    Axes, signs, units, clocks, lags, clipping, the field, noise and bias. Findings do not change the exit code.

    Parameters
    ----------
    files
        Recordings (NAME.mcap), folders of them, or globs.
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
    folder = None if out is None else output_dir(out)
    console = Console(highlight=False, markup=False, soft_wrap=True, stderr=json == STDOUT)
    rows, clean = [], True
    for path in recordings(files):
        recording = read_recording(path, units_unchecked=True)
        diagnosis = examine(recording)
        clean &= diagnosis.clean
        rows += diagnosis.rows()
        _show(console, path, diagnosis)
        if folder is not None:
            remedies = _chosen(diagnosis, skip)
            written = _repair(path, recording, remedies, folder)
            console.print(f"  {len(remedies)} of {len(diagnosis.remedies)} remedies applied: {written}")
    write_json(json, rows)
    if strict and not clean:
        print("stillpoint: doctor found errors or warnings (--strict)", file=sys.stderr)
        return 2
    return 0


def examine(recording: Recording) -> Diagnosis:
    """Find the rests and diagnose; once more when remedies were needed before rests could be seen."""
    if recording.imu is None:
        return diagnose(recording, np.empty((0, 2), dtype=np.int64))
    diagnosis = diagnose(recording, find_rests(recording.imu))
    units = [
        one.remedy for one in diagnosis.findings if one.code in ("gyro-units", "accel-units") and one.remedy is not None
    ]
    if not units:
        return diagnosis
    return diagnose(recording, find_rests(apply(recording, units).require_imu()))


def _chosen(diagnosis: Diagnosis, skip: tuple[str, ...]) -> list[Remedy]:
    return [one.remedy for one in diagnosis.findings if one.remedy is not None and one.code not in skip]


def _repair(path: Path, recording: Recording, remedies: list[Remedy], folder: Path) -> Path:
    target = folder / path.name
    if target.resolve() == path.resolve():
        raise BadParameter(f"{path}: would be overwritten; name another folder with --out")
    write(target, apply(recording, remedies))
    return target


def _show(console: Console, path: Path, diagnosis: Diagnosis) -> None:
    sizes = [(len(diagnosis.codes(kind)), kind) for kind in SEVERITIES]
    counts = [f"{count} {kind}{'' if count == 1 else 's'}" for count, kind in sizes]
    console.print(f"{path}: {', '.join(counts)}{': clean' if diagnosis.clean else ''}")
    for kind in SEVERITIES:
        for finding in diagnosis.findings:
            if finding.severity == kind:
                console.print(f"  {kind:7} {finding.code:18} {finding.message}", style=COLOURS[kind])
