"""``stillpoint cut``: a part of a recording as a recording of its own."""

import math
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from stillpoint.datasets.cut import cut_recording, find_start_ns, find_stretches
from stillpoint.datasets.errors import BadFile, BadParameter, BadRecording, StillpointError
from stillpoint.datasets.mcap.store import read_recording, write
from stillpoint.datasets.recording import Recording
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.flags import Inputs, Jobs, Workers
from stillpoint.scripts.shared.jobs import SHORT, choose_exit_code, run_jobs
from stillpoint.scripts.shared.output import print_line


def cut(
    paths: Inputs,
    /,
    *,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    from_: Annotated[float | None, Parameter(name="--from")] = None,
    to: float | None = None,
    drop_gap: Annotated[bool, Parameter(name="--drop-gap", negative="")] = False,
    shortest: float = 2.0,
    jobs: Jobs = None,
) -> int:
    """Write a part of recordings: NAME-cut.mcap, or NAME-1.mcap, NAME-2.mcap, ... between gaps.

    Parameters
    ----------
    paths
        Recordings: MCAP files, folders or globs.
    out
        Folder to write into; that of the recording unless given.
    from_
        Seconds after the first sample, the first to keep.
    to
        Seconds after the first sample, the last to keep.
    drop_gap
        Write every stretch between gaps of gyro and accelerometer (five lost samples and more than a second).
    shortest
        Seconds; with --drop-gap, shorter stretches are left out and reported.
    jobs
        Processes; by default one per core for many recordings, else this one alone.
    """
    if (from_ is not None or to is not None) == drop_gap:
        raise BadParameter("cut: give --from S, --to S or both, or else --drop-gap")
    for flag, value in (("--from", from_), ("--to", to), ("--shortest", shortest)):
        if value is not None and (not math.isfinite(value) or value < 0):
            raise BadParameter(f"{flag} {value:g}: give seconds from 0 on")
    if from_ is not None and to is not None and to <= from_:
        raise BadParameter(f"--to {to:g}: is not after --from {from_:g}")
    files = inputs.find_recordings(paths)
    asked = _Asked(None if out is None else inputs.make_output_dir(out), from_, to, shortest if drop_gap else None)
    outcomes = run_jobs(partial(_cut_file, asked=asked), files, Workers(jobs), "cut", here_up_to=SHORT)
    for outcome in outcomes:
        if outcome.error is not None and len(files) == 1 and not outcome.defect:
            raise StillpointError(outcome.error)
        for line in outcome.value or ():
            print_line(line)
        if outcome.error is not None:
            print_line(f"not cut: {outcome.error}", file=sys.stderr)
    return choose_exit_code(outcomes)


@dataclass(frozen=True)
class _Asked:
    """The request of the user."""

    out: Path | None
    from_s: float | None
    to_s: float | None
    shortest_s: float | None  # of a stretch between gaps; None: one span is cut


def _cut_file(file: Path, asked: _Asked) -> list[str]:
    """Write the parts of one recording; return the lines that say what was written and left out."""
    recording = read_recording(file)
    lines: list[str] = []
    try:
        if asked.shortest_s is None:
            parts = [_cut_span(recording, asked.from_s, asked.to_s)]
        else:
            parts = _find_parts(recording, asked.shortest_s, lines)
    except BadRecording as error:
        raise BadFile(f"{file}: {error}") from None
    for part in parts:
        target = inputs.choose_folder(file, asked.out) / f"{part.name}.mcap"
        write(target, part)
        lines.append(f"{target}: {part.duration_s:.3f} s of {recording.duration_s:.3f} s")
    return lines


def _cut_span(recording: Recording, from_s: float | None, to_s: float | None) -> Recording:
    """Return the recording between two times in s from its start."""
    start_ns = find_start_ns(recording)
    seconds = (0.0 if from_s is None else from_s, recording.duration_s if to_s is None else to_s)
    first_ns, last_ns = (start_ns + round(each * 1e9) for each in seconds)
    return cut_recording(recording, first_ns, last_ns, f"{recording.name}-cut")


def _find_parts(recording: Recording, shortest_s: float, lines: list[str]) -> list[Recording]:
    """Return the stretches between gaps; those that are too short are left out, and ``lines`` say it."""
    start_ns = find_start_ns(recording)
    kept = []
    for first_ns, last_ns in find_stretches(recording):
        if (last_ns - first_ns) / 1e9 >= shortest_s:
            kept.append((first_ns, last_ns))
        else:
            at_s, length_s = (first_ns - start_ns) / 1e9, (last_ns - first_ns) / 1e9
            lines.append(f"{recording.name}: the stretch of {length_s:.3f} s at {at_s:.3f} s is left out (--shortest)")
    if not kept:
        raise BadRecording(f"{recording.name}: no stretch lasts {shortest_s:g} s; give a smaller --shortest")
    return [
        cut_recording(recording, first_ns, last_ns, f"{recording.name}-{k}")
        for k, (first_ns, last_ns) in enumerate(kept, 1)
    ]
