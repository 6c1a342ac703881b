"""``stillpoint export``: what MCAP files hold as text, for other tools."""

import sys
from collections.abc import Sequence
from functools import partial
from math import degrees
from pathlib import Path
from typing import Literal

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.importers.trajectories import format_tum
from stillpoint.datasets.kml import kml_text
from stillpoint.datasets.mcap.store import Kept, read
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.tables import csv_text, tables_of
from stillpoint.datasets.trajectory import Reference, SpinReference
from stillpoint.filters.front.sources import choose_magnetometer, newest_rows
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.batch import require_distinct
from stillpoint.scripts.shared.flags import Inputs, Jobs, OutBeside
from stillpoint.scripts.shared.jobs import exit_code, run_jobs
from stillpoint.scripts.shared.output import print_line, write_text
from stillpoint.scripts.streaming.lines import format_csv_lines
from stillpoint.scripts.streaming.streams import replay_samples

Format = Literal["csv", "stream", "tum", "kml"]
SUFFIXES: dict[Format, str] = {"csv": "csv", "stream": "csv", "tum": "tum", "kml": "kml"}


def export(
    paths: Inputs,
    /,
    *,
    out: OutBeside = None,
    format: Format = "csv",
    jobs: Jobs = None,
) -> int:
    """Write what MCAP files hold as text: CSV tables, the samples that stream reads, TUM trajectories, or KML.

    csv: NAME.imu.csv, NAME.mag.csv, ... of a recording NAME.mcap, a table per sensor and clock; NAME.reference.csv of
    NAME.reference.mcap; NAME.ESTIMATOR.estimate.csv of an estimate. Columns are in SI units (field: uT), every number
    in all its digits. stream: NAME.stream.csv of a recording, the samples of all sensors in one table, for the standard
    input of stillpoint stream. tum: NAME.truth.tum, NAME.reference.tum and NAME.ESTIMATOR.estimate.tum, as evo reads
    them. kml: NAME.reference.kml, the path of a reference with positions, for maps.

    Parameters
    ----------
    paths
        MCAP files, folders or globs: recordings, references and estimates.
    out
        Folder to write into; made when it is not there. By default beside each file.
    format
        csv: tables of everything; stream: what stillpoint stream reads, and prints the options to give it to stderr;
        tum: attitudes (and positions, 0 where not known), one pose a line; kml: a path for maps.
    jobs
        Processes; by default one per core, fewer for few files.
    """
    files = inputs.mcap_files(paths)
    if not files:
        raise BadParameter("no input: name recordings, references or estimates as files, folders or globs")
    folder = None if out is None else inputs.output_dir(out)
    require_distinct(inputs.folder_for(file, folder) / file.name for file in files)
    outcomes = run_jobs(partial(_export_file, folder=folder, format=format), files, jobs, "export")
    if len(files) == 1 and outcomes[0].error is not None and not outcomes[0].defect:
        raise StillpointError(outcomes[0].error)
    for outcome in outcomes:
        if outcome.value is None:
            print_line(f"stillpoint: {outcome.error}", file=sys.stderr)
        for target in outcome.value or ():
            print_line(target)
    return exit_code(outcomes)


def _export_file(file: Path, folder: Path | None, format: Format) -> list[Path]:
    """Write the texts of one file, and return where."""
    thing, stem = read(file), file.name.removesuffix(inputs.SUFFIX)
    written = []
    for label, text in _format_texts(file, thing, format):
        target = inputs.folder_for(file, folder) / f"{stem}{f'.{label}' if label else ''}.{SUFFIXES[format]}"
        write_text(target, text)
        written.append(target)
    return written


def _format_texts(file: Path, thing: Kept, format: Format) -> Sequence[tuple[str, str]]:
    """Return what to write of a file, as pairs of a label and a text."""
    if format == "csv":
        return [(label, csv_text(table)) for label, table in tables_of(thing).items()]
    if format == "stream":
        return [("stream", _format_samples(file, thing))]
    if format == "kml":
        if not isinstance(thing, Reference):
            raise BadParameter(f"{file}: is no reference of an attitude; KML shows the path of one with positions")
        return [("", kml_text(thing))]
    if isinstance(thing, Recording):
        if thing.truth is None:
            raise BadParameter(f"{file}: has no truth, and so no poses; make a reference of it, or --format csv")
        return [("truth", format_tum(thing.truth.t_ns, thing.truth.q_nb, thing.truth.position_n_m))]
    if isinstance(thing, SpinReference) or thing.q_nb is None:
        raise BadParameter(f"{file}: holds an angle about one axis, no attitude; use --format csv")
    position = thing.position_n_m if isinstance(thing, Reference) else None
    return [("", format_tum(thing.t_ns, thing.q_nb, position))]


def _format_samples(file: Path, thing: Kept) -> str:
    """Return what ``stream`` reads of a recording; print what is left out, and options as of a batch run, to stderr."""
    if not isinstance(thing, Recording):
        raise BadParameter(f"{file}: holds no samples; give the recording that it was made from, or --format csv")
    if thing.imu is None:
        return csv_text(tables_of(thing)["spin"])
    mag, declination_rad, facts = choose_magnetometer(thing)
    notes = []
    if mag is None:
        notes.append(f"the heading is {facts['heading']}")
    for what, sensor in (("fields", mag), ("fixes", thing.gps)):
        n_unused = (
            0 if sensor is None else len(sensor.t_ns) - int((newest_rows(sensor.t_ns, thing.imu.t_ns) >= 0).sum())
        )
        if n_unused:
            notes.append(f"{n_unused} {what} are left out as by estimate: a newer one came before the next IMU sample")
    if facts["heading"].startswith("true north"):
        notes.append(f"for true north, stream it with --declination {degrees(declination_rad)!r}")
    for text in notes:
        print_line(f"stillpoint: {file}: {text}", file=sys.stderr)
    return "\n".join([*format_csv_lines(replay_samples(thing), mag is not None, thing.gps is not None), ""])
