"""``stillpoint import``: turn recordings of other formats into MCAP files."""

import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from cyclopts import App, Parameter
from rich.console import Console

from stillpoint.datasets.errors import BadParameter, BadRecording, BadSource, StillpointError, require_known
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.options import Options
from stillpoint.datasets.importers.table import IMPORTERS, Importer
from stillpoint.datasets.mcap.parts import split_recording
from stillpoint.datasets.mcap.store import sha256, write
from stillpoint.datasets.recording import Recording, rate_hz
from stillpoint.scripts.shared.flags import OutDir, read_span
from stillpoint.scripts.shared.inputs import output_dir
from stillpoint.scripts.shared.names import make_printable
from stillpoint.scripts.shared.output import STDOUT, JsonFile, write_json
from stillpoint.scripts.shared.tables import print_table
from stillpoint.scripts.verbs.import_flags import Flags

NO_FLAGS = Flags()
STREAMS = ("imu", "mag", "gps", "spin", "encoder", "truth")  # that importers make, in the order of the table


@dataclass(frozen=True)
class _Kept:
    """A recording and the file it went to."""

    source: Path
    file: Path
    recording: Recording
    estimates: tuple[Path, ...]  # of the device, beside the recording


def import_(
    kind: str,
    /,
    *sources: Path,
    out: OutDir,
    repair: Annotated[bool, Parameter(negative="")] = False,
    skip: Annotated[tuple[str, ...], Parameter(name="--skip", negative="")] = (),
    split: str | None = None,
    json: JsonFile = None,
    flags: Annotated[Flags, Parameter(name="*")] = NO_FLAGS,
) -> int:
    """Turn recordings of other formats into MCAP files, one NAME.mcap each, and say what was converted.

    A source that cannot be read costs no other: the error is printed, the others are imported, the exit code is 2.
    docs/importing.md has a section for each kind.

    Parameters
    ----------
    kind
        broad, tyrex, bench, csv, sensorlogger, phyphox, spin, flatball, ros, euroc, kitti, ulog, ngimu, ximu3, movella
        or sensorlog.
    sources
        Files or folders of that kind.
    out
        Folder to write into; made when it is not there.
    repair
        Apply the doctor's remedies; each is recorded in the file.
    skip
        Code of a finding whose remedy --repair leaves out; may be given several times.
    split
        Write recordings in parts of this length, for example 1h or 600s: NAME-001.mcap, NAME-002.mcap and so on;
        stillpoint join makes one of them again.
    json
        Also write what was imported as JSON to this file; - is the standard output.
    flags
        What may be set about the import.
    """
    given = {name: value for name, value in vars(flags).items() if value is not None and value is not False}
    importer, options = _importer(kind, given)
    if skip and not repair:
        raise BadParameter("--skip: leaves remedies out of --repair; give that too")
    if not sources:
        raise BadParameter(f"no source: name files or folders of kind {kind}")
    span_s = None if split is None else read_span(split, "--split").total_seconds()
    kept: dict[Path, _Kept] = {}
    failed: list[str] = []
    with Console(stderr=True).status("import") as status:
        for source, imported in _split_all(_read_sources(importer, options, sources, repair, skip, failed), span_s):
            recording = imported.recording
            status.update(f"import {recording.name}")
            file = output_dir(out) / f"{recording.name}.mcap"
            if file in kept:
                raise BadSource(
                    f"{source}: a recording {recording.name} was already imported from {kept[file].source}; "
                    "import them into different folders"
                )
            write(file, recording)
            beside = {file.with_name(f"{recording.name}.{one.name}.estimate.mcap"): one for one in imported.estimates}
            for estimate_file, estimate in beside.items():
                write(estimate_file, replace(estimate, made_from={**estimate.made_from, file.name: sha256(file)}))
            kept[file] = _Kept(source, file, recording, tuple(beside))
    if kept and json != STDOUT:
        _show(list(kept.values()))
    if failed and json != STDOUT:
        print(f"{len(failed)} not imported")
    write_json(json, [_facts(one) for one in kept.values()])
    return 2 if failed else 0


def _split_all(all_imported: Iterable[tuple[Path, Imported]], span_s: float | None) -> Iterator[tuple[Path, Imported]]:
    """Yield each recording, or its parts where a length is given."""
    for source, imported in all_imported:
        if span_s is None:
            yield source, imported
            continue
        if imported.estimates:
            print(f"stillpoint: {source}: --split leaves out the attitude of the device itself", file=sys.stderr)
        for part in split_recording(imported.recording, span_s):
            yield source, replace(imported, recording=part, estimates=())


def _importer(kind: str, given: dict[str, Any]) -> tuple[Importer, Options]:
    """The importer and its options; an option that the kind does not take is refused."""
    require_known(kind, IMPORTERS, "kind")
    importer = IMPORTERS[kind]
    known = {field.name: field.type for field in fields(importer.options)}
    for name, value in given.items():
        flag = f"--{name.replace('_', '-')}"
        if name not in known:
            taken = ", ".join(f"--{one.replace('_', '-')}" for one in known)
            raise BadParameter(f"{flag}: {kind} takes no such option; it takes {taken}")
        choices = _choices(known[name])
        if choices and value not in choices:
            raise BadParameter(f"{flag} {value}: {kind} takes {' or '.join(choices)}")
    return importer, importer.options(**given)


def _choices(annotation: Any) -> tuple[str, ...]:
    """The words of a Literal, alone or in a union with None."""
    for part in (annotation, *get_args(annotation)):
        if get_origin(part) is Literal:
            return tuple(str(word) for word in get_args(part))
    return ()


def _read_sources(
    importer: Importer,
    options: Options,
    sources: tuple[Path, ...],
    repair: bool,
    skip: tuple[str, ...],
    failed: list[str],
) -> Iterator[tuple[Path, Imported]]:
    """Yield every recording with its source; an error goes to stderr and ``failed``, that of a single one is raised."""
    items: list[tuple[Path, Path]] = []
    for source in dict.fromkeys(sources):
        with _note_failure(failed, alone=len(sources) == 1):
            items += [(source, item) for item in importer.find_items(source)]
    for source, item in items:
        with _note_failure(failed, alone=len(items) == 1 and not failed):
            if not repair:
                yield source, importer.read_one(item, options)
                continue
            # Sizes are tested after the repair: what the doctor mends need not be refused before.
            imported = importer.read_one(item, replace(options, units_unchecked=True))
            yield source, replace(imported, recording=_repair(imported.recording, item, skip, options.units_unchecked))


@contextmanager
def _note_failure(failed: list[str], alone: bool) -> Iterator[None]:
    """Print and keep the error of one source of several."""
    try:
        yield
    except StillpointError as error:
        if alone:
            raise
        print(f"stillpoint: {make_printable(str(error))}", file=sys.stderr)
        failed.append(str(error))


def _repair(recording: Recording, source: Path, skip: tuple[str, ...], units_unchecked: bool) -> Recording:
    from stillpoint.datasets.doctor import apply
    from stillpoint.scripts.verbs.doctor import examine, select_remedies

    mended = apply(recording, select_remedies(examine(recording), skip))
    try:
        return replace(mended, info=replace(mended.info, units_unchecked=units_unchecked))
    except BadRecording as error:
        raise BadSource(f"{source}: {error}") from None


def _show(kept: list[_Kept]) -> None:
    """One table of the recordings; below it what was converted, once where it holds for all, and the notes."""
    present = [name for name in STREAMS if any(getattr(one.recording, name) is not None for one in kept)]
    rows = []
    for one in kept:
        rates = {name: f"{rate_hz(t_ns):.1f}" for name, t_ns in one.recording.streams()}
        rows.append(
            [one.recording.name, f"{one.recording.duration_s:.1f}", *(rates.get(name, "-") for name in present)]
        )
    print_table("imported", ["recording", "s", *(f"{name}, Hz" for name in present)], [rows], texts=1)
    lines = Counter(line for one in kept for line in _list_lines(one.recording))
    print(f"\n{'all' if len(kept) > 1 else kept[0].recording.name}:")
    for line in (line for line, count in lines.items() if count == len(kept)):
        print(f"  {line}")
    for one in kept:
        own = [line for line in _list_lines(one.recording) if lines[line] < len(kept)]
        if own:
            print(f"{one.recording.name}:")
        for line in own:
            print(f"  {line}")
    for file in (file for one in kept for file in one.estimates):
        print(f"  {file.name}: the device's own attitude, to be scored")
    print(f"\n{len(kept)} written to {kept[0].file.parent}")


def _list_lines(recording: Recording) -> list[str]:
    """Return conversions and notes, each once."""
    notes = (f"note: {note}" for note in recording.info.notes)
    return [make_printable(line) for line in dict.fromkeys((*recording.info.conversions, *notes))]


def _facts(one: _Kept) -> dict[str, Any]:
    recording = one.recording
    return {
        "recording": recording.name,
        "file": str(one.file),
        "source": str(one.source),
        "estimates": [str(file) for file in one.estimates],
        "duration_s": recording.duration_s,
        "streams": {name: {"samples": len(t_ns), "rate_hz": rate_hz(t_ns)} for name, t_ns in recording.streams()},
        "conversions": list(recording.info.conversions),
        "notes": list(recording.info.notes),
        "sha256": dict(recording.info.sha256),
    }


app = App(name="import", help="Turn recordings of other formats into MCAP files.")
app.default(import_)
app.command(
    "stillpoint.scripts.verbs.import_trajectory:import_trajectory",
    name="trajectory",
    help="Put the attitude of another program beside its recording, to be scored.",
)
