"""``stillpoint export``: what MCAP files hold as text, for other tools."""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from math import degrees
from pathlib import Path
from typing import Literal

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.exporters.kml import format_kml
from stillpoint.datasets.exporters.tables import format_csv_header, format_csv_rows, make_tables
from stillpoint.datasets.importers.trajectories import TUM_HEADER, format_tum_rows
from stillpoint.datasets.mcap.pieces import AnyPiece, PieceReader
from stillpoint.datasets.mcap.store import read
from stillpoint.datasets.recording import Piece
from stillpoint.datasets.trajectory import Reference, SpinReference
from stillpoint.filters.front.sources import plan_heading
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.batch import require_distinct
from stillpoint.scripts.shared.flags import Inputs, Jobs, OutBeside, Workers
from stillpoint.scripts.shared.jobs import choose_exit_code, run_jobs
from stillpoint.scripts.shared.output import open_text, print_line
from stillpoint.scripts.shared.recordings import print_losses
from stillpoint.scripts.streaming.lines import format_csv_header as format_samples_header
from stillpoint.scripts.streaming.lines import format_csv_lines
from stillpoint.scripts.streaming.streams import list_arrivals, make_raw_logs

Format = Literal["csv", "stream", "tum", "kml"]
_SUFFIXES: dict[Format, str] = {"csv": "csv", "stream": "csv", "tum": "tum", "kml": "kml"}


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
    files = inputs.find_mcap_files(paths)
    if not files:
        raise BadParameter("no input: name recordings, references or estimates as files, folders or globs")
    folder = None if out is None else inputs.make_output_dir(out)
    require_distinct(inputs.choose_folder(file, folder) / file.name for file in files)
    outcomes = run_jobs(partial(_export_file, folder=folder, format=format), files, Workers(jobs), "export")
    if len(files) == 1 and outcomes[0].error is not None and not outcomes[0].defect:
        raise StillpointError(outcomes[0].error)
    for outcome in outcomes:
        if outcome.value is None:
            print_line(f"stillpoint: {outcome.error}", file=sys.stderr)
        for target in outcome.value or ():
            print_line(target)
    return choose_exit_code(outcomes)


def _export_file(file: Path, folder: Path | None, format: Format) -> list[Path]:
    """Write the texts of one file, piece by piece, and return where."""
    stem = file.name.removesuffix(inputs.SUFFIX)
    with ExitStack() as files:
        puts: dict[Path, Callable[[str], object]] = {}
        for label, text in _FORMATS[format](file):
            target = inputs.choose_folder(file, folder) / f"{stem}{f'.{label}' if label else ''}.{_SUFFIXES[format]}"
            if target not in puts:
                puts[target] = files.enter_context(open_text(target))
            puts[target](text)
    return list(puts)


def _read_pieces(reader: PieceReader) -> Iterator[AnyPiece]:
    """Yield the pieces of a file of any kind; print to stderr what is lost of a recording that was cut short."""
    yield from reader.pieces()
    if reader.kind == "recording":
        print_losses(reader.path, reader.info)


def _list_csv(file: Path) -> Iterator[tuple[str, str]]:
    """Yield parts of the tables of a file, each with the label of its table."""
    begun: set[str] = set()
    for piece in _read_pieces(PieceReader(file)):
        for label, table in make_tables(piece).items():
            if label not in begun:
                begun.add(label)
                yield label, format_csv_header(table)
            for text in format_csv_rows(table):
                yield label, text


def _list_tum(file: Path) -> Iterator[tuple[str, str]]:
    """Yield the poses of a file, in parts."""
    reader = PieceReader(file)
    if reader.kind == "recording" and "truth" not in reader.head.samples:
        raise BadParameter(f"{file}: has no truth, so it has no poses; make a reference of it, or give --format csv")
    label = "truth" if reader.kind == "recording" else ""
    yield label, TUM_HEADER
    for piece in _read_pieces(reader):
        if isinstance(piece, Piece):
            if piece.truth is not None:
                for text in format_tum_rows(piece.truth.t_ns, piece.truth.q_nb, piece.truth.position_n_m):
                    yield label, text
            continue
        if isinstance(piece, SpinReference) or piece.q_nb is None:
            raise BadParameter(f"{file}: holds an angle about one axis, no attitude; use --format csv")
        position = piece.position_n_m if isinstance(piece, Reference) else None
        for text in format_tum_rows(piece.t_ns, piece.q_nb, position):
            yield label, text


def _list_kml(file: Path) -> Iterator[tuple[str, str]]:
    """Yield the path of a reference, as one text."""
    thing = read(file)
    if not isinstance(thing, Reference):
        raise BadParameter(f"{file}: is not a reference of an attitude; name one with positions, whose path KML shows")
    yield "", format_kml(thing)


def _list_samples(file: Path) -> Iterator[tuple[str, str]]:
    """Yield what ``stream`` reads of a recording; print what is left out, and options as of a batch run, to stderr."""
    reader = PieceReader(file)
    if reader.kind != "recording":
        raise BadParameter(f"{file}: holds no samples; give the recording that it was made from, or --format csv")
    head = reader.head
    if "imu" not in head.samples:
        for label, text in _list_csv(file):
            if label == "spin":
                yield "stream", text
        return
    uses_mag, declination_rad, facts = plan_heading(head)
    has_fix = "gps" in head.samples
    logs = make_raw_logs(head)
    yield "stream", f"{format_samples_header(uses_mag, has_fix)}\n"
    for piece in reader.recording():
        if piece.imu is None:
            logs.keep(piece.mag, piece.gps)
            continue
        samples = list_arrivals(logs.add(piece.imu, piece.mag, piece.gps))
        for line in format_csv_lines(samples, uses_mag, has_fix):
            yield "stream", f"{line}\n"
    print_losses(file, reader.info)
    notes = [] if uses_mag else [f"the heading is {facts['heading']}"]
    for what, name in (("fields", "n_mag_unused"), ("fixes", "n_fix_unused")):
        n_unused = logs.count_unused().get(name)
        if n_unused:
            notes.append(f"{n_unused} {what} are left out as by estimate: a newer one came before the next IMU sample")
    if facts["heading"].startswith("true north"):
        notes.append(f"for true north, stream it with --declination {degrees(declination_rad)!r}")
    for text in notes:
        print_line(f"stillpoint: {file}: {text}", file=sys.stderr)


_FORMATS: dict[Format, Callable[[Path], Iterator[tuple[str, str]]]] = {
    "csv": _list_csv, "stream": _list_samples, "tum": _list_tum, "kml": _list_kml,
}  # fmt: skip
