"""``stillpoint import``: turn recordings of other formats into MCAP files."""

import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from cyclopts import App, Group, Parameter
from rich.console import Console
from rich.text import Text

from stillpoint.datasets.errors import BadParameter, BadRecording, BadSource, StillpointError, require_known
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.options import Options
from stillpoint.datasets.importers.table import IMPORTERS, Importer
from stillpoint.datasets.mcap.parts import split_recording
from stillpoint.datasets.mcap.store import sha256, write
from stillpoint.datasets.names import make_printable
from stillpoint.datasets.recording import Recording, rate_hz
from stillpoint.scripts.shared.flags import OutDir, read_span
from stillpoint.scripts.shared.inputs import output_dir
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.shared.tables import print_table

_STREAMS = ("imu", "mag", "gps", "spin", "encoder", "truth")  # that importers make, in the order of the table

# The kinds that take a flag, on the help page, and the types of the flags.
_ALL = Group("All kinds", sort_key=1)
_OWN = Group("Own recordings: all kinds but broad, tyrex, bench, flatball", sort_key=2)
_PHONES = Group("Phones: tyrex, sensorlogger, sensorlog", sort_key=3)
_LOG = Group("Delimited logs: csv, spin; --rate also movella", sort_key=4)
_CSV = Group("Logs of an IMU: csv", sort_key=5)
_SPIN = Group("Logs of a spinning body: spin", sort_key=6)
_ROS = Group("Bags: ros", sort_key=7)

AnyKind = Annotated[bool, Parameter(group=_ALL, negative="")]
Own = Annotated[str | None, Parameter(group=_OWN)]
Phone = Annotated[str | None, Parameter(group=_PHONES)]
LogSetting = Annotated[str | None, Parameter(group=_LOG)]
Setting = Annotated[str | None, Parameter(group=_CSV)]
Columns = Annotated[str | None, Parameter(group=_CSV, allow_leading_hyphen=True)]
SpinSetting = Annotated[str | None, Parameter(group=_SPIN)]
SpinColumns = Annotated[str | None, Parameter(group=_SPIN, allow_leading_hyphen=True)]
SpinSize = Annotated[float | None, Parameter(group=_SPIN)]
TopicName = Annotated[str | None, Parameter(group=_ROS)]


@dataclass(frozen=True, kw_only=True)
class Flags:
    """The flags of an import; each name is that of a field of some kind's options.

    Parameters
    ----------
    units_unchecked
        Keep a recording whose sizes or rates are implausible, for the doctor to look at.
    place
        Where it was recorded, LAT,LON or LAT,LON,ALT in deg and m; south and west are negative.
    date
        When it was recorded, as 2025-08-31.
    licence
        Licence of the recording, kept in the file.
    citation
        How to cite it.
    sensor
        Model of the sensor.
    mag_uncalibrated
        The size of the field says nothing (hard iron, raw counts).
    mag
        tyrex, sensorlogger, sensorlog: raw (the default) or calibrated by the phone. csv: columns and unit,
        mx,my,mz:uT.
    platform
        sensorlogger: ios or android, where no Metadata.csv says it.
    config
        A TOML file with the settings of the kind, as gyro = "gx,gy,gz:deg/s".
    time
        The column of time and its unit, t:ms (s, ms, us, ns, or iso for dates).
    rate
        Samples per second, where the log has no time.
    gyro
        Columns and unit of the gyro, gx,gy,gz:deg/s; a leading - turns a sign, 0.061*deg/s is a unit per count.
    accel
        Columns and unit of the accelerometer, ax,ay,az:g.
    gyro_time
        The gyro's own time column and its unit, where each sensor has one.
    accel_time
        The accelerometer's own time column.
    mag_time
        The magnetometer's own time column.
    gps
        Columns of satellite fixes, lat,lon[,alt[,speed[,course]]] in deg, m, m/s and deg.
    gps_time
        Their own time column.
    truth
        Columns of a quaternion that takes the body to the local frame, qw,qx,qy,qz; or a file of its own
        (TUM, EuRoC, CSV, KITTI, a bag), {name} in it standing for the log's name.
    truth_time
        The truth's own time column and its unit.
    truth_columns
        Columns of the quaternion in the truth's own file, where its header does not tell.
    truth_euler
        Columns and unit of Euler angles instead, in the order of the turns, yaw,pitch,roll:deg.
    truth_order
        Axes of these turns: ZYX (the default) about moving axes, small letters about fixed ones.
    truth_frame
        The local frame of the truth: enu (the default), nwu or ned.
    truth_inverse
        The truth takes the local frame to the body.
    position
        Columns and unit of the truth's position, x,y,z:m.
    moving
        A column that is 0 where the truth is not to be scored.
    delimiter
        What separates the columns, where it is not found by itself.
    drop_disordered
        Sort disorder of up to a second by time and drop equal stamps, counted.
    geometry
        Where the accelerometers sit: bench (the default: F4, F5), five (F1 to F5, g1, g2), or a .toml file.
    d1_m
        Lever arm of F4 in m, 0.10 unless given.
    d2_m
        Lever arm of F5 in m, 0.50 unless given.
    range_g
        Range of the accelerometers, 16 unless given.
    accels
        Columns and unit of the accelerometers in the order of the geometry, F4,F5:g.
    gyros
        Columns and unit of the gyros, g1,g2:deg/s.
    encoder_angle
        Column and unit of the shaft's angle (rad, deg, rev), angle:deg.
    encoder_rate
        Column and unit of its rate, speed:deg/s.
    imu_topic
        The topic of gyro and accelerometer, where there are several.
    mag_topic
        The topic of the magnetometer.
    gps_topic
        The topic of the satellite fixes.
    truth_topic
        The topic of the true pose (PoseStamped, Odometry, TransformStamped, QuaternionStamped or TF).
    gyro_topic
        The topic of the gyro, where it is not that of the accelerometer.
    accel_topic
        The topic of the accelerometer.
    truth_parent
        The fixed frame of the truth, where the topic holds several.
    truth_child
        The child frame to take from a TF topic.
    frame
        The frame_id to take, where one topic holds several sensors.
    imu_frame
        The frame of gyro and accelerometer in /tf_static, where the headers name another.
    body_frame
        Turn the sensors into this frame by /tf_static.
    """

    units_unchecked: AnyKind = False
    place: Annotated[str | None, Parameter(group=_ALL, allow_leading_hyphen=True)] = None
    date: Annotated[str | None, Parameter(group=_ALL)] = None
    licence: Own = None
    citation: Own = None
    sensor: Own = None
    mag_uncalibrated: Annotated[bool, Parameter(group=_OWN, negative="")] = False
    mag: Annotated[str | None, Parameter(group=[_PHONES, _CSV], allow_leading_hyphen=True)] = None
    platform: Phone = None
    config: Annotated[Path | None, Parameter(group=_LOG)] = None
    time: LogSetting = None
    rate: Annotated[float | None, Parameter(group=_LOG)] = None
    gyro: Columns = None
    accel: Columns = None
    gyro_time: Setting = None
    accel_time: Setting = None
    mag_time: Setting = None
    gps: Setting = None
    gps_time: Setting = None
    truth: Columns = None
    truth_time: Setting = None
    truth_columns: Columns = None
    truth_euler: Columns = None
    truth_order: Setting = None
    truth_frame: Setting = None
    truth_inverse: Annotated[bool, Parameter(group=_CSV, negative="")] = False
    position: Columns = None
    moving: Setting = None
    delimiter: LogSetting = None
    drop_disordered: Annotated[bool, Parameter(group=_LOG, negative="")] = False
    geometry: SpinSetting = None
    d1_m: SpinSize = None
    d2_m: SpinSize = None
    range_g: SpinSize = None
    accels: SpinColumns = None
    gyros: SpinColumns = None
    encoder_angle: SpinColumns = None
    encoder_rate: SpinColumns = None
    imu_topic: TopicName = None
    mag_topic: TopicName = None
    gps_topic: TopicName = None
    truth_topic: TopicName = None
    gyro_topic: TopicName = None
    accel_topic: TopicName = None
    truth_parent: TopicName = None
    truth_child: TopicName = None
    frame: TopicName = None
    imu_frame: TopicName = None
    body_frame: TopicName = None


_NO_FLAGS = Flags()


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
    flags: Annotated[Flags, Parameter(name="*")] = _NO_FLAGS,
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
            status.update(Text(make_printable(f"import {recording.name}")))
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
        print_line(f"{len(failed)} not imported")
    write_json(json, [_facts(one) for one in kept.values()])
    return 2 if failed else 0


def _split_all(all_imported: Iterable[tuple[Path, Imported]], span_s: float | None) -> Iterator[tuple[Path, Imported]]:
    """Yield each recording, or its parts where a length is given."""
    for source, imported in all_imported:
        if span_s is None:
            yield source, imported
            continue
        if imported.estimates:
            print_line(f"stillpoint: {source}: --split leaves out the attitude of the device itself", file=sys.stderr)
        for part in split_recording(imported.recording, span_s):
            yield source, replace(imported, recording=part, estimates=())


def _importer(kind: str, given: dict[str, Any]) -> tuple[Importer, Options]:
    """Return the importer and its options; an option that the kind does not take is refused."""
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
    """Return the words of a Literal, alone or in a union with None."""
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
        print_line(f"stillpoint: {error}", file=sys.stderr)
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
    """Print one table of the recordings; below it what was converted, once where it holds for all, and notes."""
    present = [name for name in _STREAMS if any(getattr(one.recording, name) is not None for one in kept)]
    rows = []
    for one in kept:
        rates = {name: f"{rate_hz(t_ns):.1f}" for name, t_ns in one.recording.streams()}
        rows.append(
            [one.recording.name, f"{one.recording.duration_s:.1f}", *(rates.get(name, "-") for name in present)]
        )
    print_table("imported", ["recording", "s", *(f"{name}, Hz" for name in present)], [rows], texts=1)
    lines = Counter(line for one in kept for line in _list_lines(one.recording))
    print_line()
    print_line(f"{'all' if len(kept) > 1 else kept[0].recording.name}:")
    for line in (line for line, count in lines.items() if count == len(kept)):
        print_line(f"  {line}")
    for one in kept:
        own = [line for line in _list_lines(one.recording) if lines[line] < len(kept)]
        if own:
            print_line(f"{one.recording.name}:")
        for line in own:
            print_line(f"  {line}")
    for file in (file for one in kept for file in one.estimates):
        print_line(f"  {file.name}: the device's own attitude, to be scored")
    print_line()
    print_line(f"{len(kept)} written to {kept[0].file.parent}")


def _list_lines(recording: Recording) -> list[str]:
    """Return conversions and notes, each once."""
    notes = (f"note: {note}" for note in recording.info.notes)
    return list(dict.fromkeys((*recording.info.conversions, *notes)))


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
