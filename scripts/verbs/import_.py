"""``stillpoint import``: turn recordings of other formats into MCAP files."""

import sys
from collections import Counter
from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal, get_args, get_origin

from cyclopts import App, Group, Parameter

from stillpoint.datasets.errors import BadParameter, BadRecording, BadSource, StillpointError, require_known
from stillpoint.datasets.importers.csv_log import CsvOptions
from stillpoint.datasets.importers.csv_pieces import read_csv_pieces
from stillpoint.datasets.importers.imported import Imported
from stillpoint.datasets.importers.long_recording import LongRecording
from stillpoint.datasets.importers.options import Options
from stillpoint.datasets.importers.ros import RosOptions
from stillpoint.datasets.importers.ros_pieces import read_ros_pieces
from stillpoint.datasets.importers.table import IMPORTERS, Importer
from stillpoint.datasets.mcap.parts import split_recording
from stillpoint.datasets.mcap.store import sha256, write, write_pieces, write_trajectory_pieces
from stillpoint.datasets.recording import Info, Recording, rate_hz
from stillpoint.scripts.shared.flags import Jobs, OutDir, Workers, read_span
from stillpoint.scripts.shared.inputs import make_output_dir
from stillpoint.scripts.shared.jobs import ITEMS_PER_WORKER, choose_exit_code, run_jobs
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.shared.tables import print_table

LONG_BYTES = 64 << 20  # logs from this size on are read in pieces
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
        Columns of the quaternion in the truth's own file, where its header does not show them.
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
class _Item:
    """One recording of a source, and what is to be done with it; it can be pickled."""

    kind: str
    options: Options
    source: Path
    path: Path  # of the recording in the source
    out: Path  # folder that is made with its first recording
    claims: Path  # folder in which the names of this import are taken, so that no two recordings share one
    repair: bool
    skip: tuple[str, ...]
    span_s: float | None  # longest part; None: the recording whole

    def __str__(self) -> str:
        return str(self.path)


@dataclass(frozen=True)
class _Kept:
    """The facts that are printed about an imported recording, and the file it was written to."""

    source: Path
    file: Path
    name: str
    duration_s: float
    streams: dict[str, dict[str, float]]  # samples and rate_hz of each
    info: Info
    estimates: tuple[Path, ...]  # of the device, beside the recording


def import_(
    kind: str,
    /,
    *sources: Path,
    out: OutDir,
    repair: Annotated[bool, Parameter(negative="")] = False,
    skip: Annotated[tuple[str, ...], Parameter(name="--skip", negative="")] = (),
    split: str | None = None,
    jobs: Jobs = None,
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
    jobs
        Processes; by default one per core for many recordings, else this one alone.
    json
        Also write what was imported as JSON to this file; - is the standard output.
    flags
        What may be set about the import.
    """
    given = {name: value for name, value in vars(flags).items() if value is not None and value is not False}
    importer, options = _choose_importer(kind, given)
    if skip and not repair:
        raise BadParameter("--skip: leaves remedies out of --repair; give that too")
    if not sources:
        raise BadParameter(f"no source: name files or folders of kind {kind}")
    span_s = None if split is None else read_span(split, "--split").total_seconds()
    failed: list[str] = []
    found = _find_items(importer, sources, failed)
    with TemporaryDirectory(prefix="stillpoint-") as claims:
        items = [_Item(kind, options, source, path, out, Path(claims), repair, skip, span_s) for source, path in found]
        outcomes = run_jobs(_import_item, items, Workers(jobs), "import", here_up_to=ITEMS_PER_WORKER)
    failed += [outcome.error for outcome in outcomes if outcome.error is not None]
    kept = [one for outcome in outcomes for one in outcome.value or ()]
    if len(failed) == 1 and not kept and not any(outcome.defect for outcome in outcomes):
        raise BadSource(failed[0])
    for error in failed:
        print_line(f"stillpoint: {error}", file=sys.stderr)
    if kept and json != STDOUT:
        _show(kept)
    if failed and json != STDOUT:
        print_line(f"{len(failed)} not imported")
    write_json(json, [_list_facts(one) for one in kept])
    return choose_exit_code(outcomes) or (2 if failed else 0)


def _find_items(importer: Importer, sources: tuple[Path, ...], failed: list[str]) -> list[tuple[Path, Path]]:
    """Return each source with each recording in it; the error of a source is added to ``failed``."""
    items: list[tuple[Path, Path]] = []
    for source in dict.fromkeys(sources):
        try:
            items += [(source, path) for path in importer.find_items(source)]
        except StillpointError as error:
            failed.append(str(error))
    return items


def _import_item(item: _Item) -> list[_Kept]:
    """Read one recording, repair and split it as asked, and write it; raises :class:`BadSource` for a name twice."""
    long = _read_long(item)
    if long is not None:
        return [_write_long(item, long)]
    imported = _read_item(item)
    parts = [imported]
    if item.span_s is not None:
        if imported.estimates:
            print_line(f"stillpoint: {item}: --split leaves out the attitude of the device itself", file=sys.stderr)
        split = split_recording(imported.recording, item.span_s)
        parts = [replace(imported, recording=part, estimates=()) for part in split]
    return [_write_imported(item, part) for part in parts]


def _read_long(item: _Item) -> LongRecording | None:
    """Return a long log or bag in pieces, where its format allows that and it is written as it is."""
    if item.repair or item.span_s is not None or _measure_size(item.path) < LONG_BYTES:
        return None
    if isinstance(item.options, CsvOptions):
        return read_csv_pieces(item.path, item.options)
    return read_ros_pieces(item.path, item.options) if isinstance(item.options, RosOptions) else None


def _measure_size(path: Path) -> int:
    """Return the bytes of a file, or of the files in a folder."""
    files = path.iterdir() if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def _write_long(item: _Item, long: LongRecording) -> _Kept:
    """Write a long recording piece by piece, and the device's own attitude beside it."""
    name = long.head.name
    file = make_output_dir(item.out) / f"{name}.mcap"
    _claim(item, file)
    write_pieces(file, long.head, long.pieces)
    beside: tuple[Path, ...] = ()
    if (pieces := long.estimates) is not None:
        beside = (file.with_name(f"{name}.{next(pieces()).name}.estimate.mcap"),)
        made = {file.name: sha256(file)}
        named = (replace(piece, made_from={**piece.made_from, **made}) for piece in pieces())
        write_trajectory_pieces(beside[0], named, sum(len(piece.t_ns) for piece in pieces()))
    clocks = long.clocks.values()
    streams = {
        name: {"samples": one.samples, "rate_hz": 1e9 / one.step_ns if one.step_ns else 0.0}
        for name, one in long.clocks.items()
    }
    duration_s = (max(one.last_ns for one in clocks) - min(one.first_ns for one in clocks)) / 1e9
    return _Kept(item.source, file, name, duration_s, streams, long.head.info, beside)


def _read_item(item: _Item) -> Imported:
    """Read one source; with ``--repair``, what the doctor finds is repaired."""
    importer = IMPORTERS[item.kind]
    if not item.repair:
        return importer.read_one(item.path, item.options)
    # Sizes are tested after the repair: what the doctor corrects need not be refused before.
    imported = importer.read_one(item.path, replace(item.options, units_unchecked=True))
    mended = _repair_recording(imported.recording, item.path, item.skip, item.options.units_unchecked)
    return replace(imported, recording=mended)


def _write_imported(item: _Item, imported: Imported) -> _Kept:
    """Write a recording, and estimates of the device beside it."""
    recording = imported.recording
    file = make_output_dir(item.out) / f"{recording.name}.mcap"
    _claim(item, file)
    write(file, recording)
    beside = {file.with_name(f"{recording.name}.{one.name}.estimate.mcap"): one for one in imported.estimates}
    for estimate_file, estimate in beside.items():
        write(estimate_file, replace(estimate, made_from={**estimate.made_from, file.name: sha256(file)}))
    streams = {name: {"samples": len(t_ns), "rate_hz": rate_hz(t_ns)} for name, t_ns in recording.streams()}
    return _Kept(item.source, file, recording.name, recording.duration_s, streams, recording.info, tuple(beside))


def _claim(item: _Item, file: Path) -> None:
    """Take the name of a file for this recording; raises :class:`BadSource` when another one has taken it."""
    claim = item.claims / file.name
    try:
        with open(claim, "x", encoding="utf-8", errors="surrogateescape") as taken:
            taken.write(str(item.source))
    except FileExistsError:
        first = claim.read_text(encoding="utf-8", errors="surrogateescape")
        raise BadSource(
            f"{item}: a recording {file.stem} was already imported from {first or 'another source'}; "
            "import them into different folders"
        ) from None


def _choose_importer(kind: str, given: dict[str, Any]) -> tuple[Importer, Options]:
    """Return the importer and its options; an option that the kind does not take is refused."""
    require_known(kind, IMPORTERS, "kind")
    importer = IMPORTERS[kind]
    known = {field.name: field.type for field in fields(importer.options)}
    for name, value in given.items():
        flag = f"--{name.replace('_', '-')}"
        if name not in known:
            taken = ", ".join(f"--{one.replace('_', '-')}" for one in known)
            raise BadParameter(f"{flag}: {kind} takes no such option; it takes {taken}")
        choices = _list_choices(known[name])
        if choices and value not in choices:
            raise BadParameter(f"{flag} {value}: {kind} takes {' or '.join(choices)}")
    return importer, importer.options(**given)


def _list_choices(annotation: Any) -> tuple[str, ...]:
    """Return the words of a Literal, alone or in a union with None."""
    for part in (annotation, *get_args(annotation)):
        if get_origin(part) is Literal:
            return tuple(str(word) for word in get_args(part))
    return ()


def _repair_recording(recording: Recording, source: Path, skip: tuple[str, ...], units_unchecked: bool) -> Recording:
    """Return the recording with the doctor's remedies applied; raises :class:`BadSource` where the units stay wrong."""
    from stillpoint.datasets.doctor import apply
    from stillpoint.scripts.verbs.doctor import examine, select_remedies

    mended = apply(recording, select_remedies(examine(recording), skip))
    try:
        return replace(mended, info=replace(mended.info, units_unchecked=units_unchecked))
    except BadRecording as error:
        raise BadSource(f"{source}: {error}") from None


def _show(kept: list[_Kept]) -> None:
    """Print one table of the recordings; below it what was converted, once where it holds for all, and notes."""
    present = [name for name in _STREAMS if any(name in one.streams for one in kept)]
    rows = []
    for one in kept:
        rates = [f"{one.streams[name]['rate_hz']:.1f}" if name in one.streams else "-" for name in present]
        rows.append([one.name, f"{one.duration_s:.1f}", *rates])
    print_table("imported", ["recording", "s", *(f"{name}, Hz" for name in present)], [rows], texts=1)
    lines = Counter(line for one in kept for line in _list_lines(one.info))
    print_line()
    print_line(f"{'all' if len(kept) > 1 else kept[0].name}:")
    for line in (line for line, count in lines.items() if count == len(kept)):
        print_line(f"  {line}")
    for one in kept:
        own = [line for line in _list_lines(one.info) if lines[line] < len(kept)]
        if own:
            print_line(f"{one.name}:")
        for line in own:
            print_line(f"  {line}")
    for file in (file for one in kept for file in one.estimates):
        print_line(f"  {file.name}: the device's own attitude, to be scored")
    print_line()
    print_line(f"{len(kept)} written to {kept[0].file.parent}")


def _list_lines(info: Info) -> list[str]:
    """Return conversions and notes, each once."""
    notes = (f"note: {note}" for note in info.notes)
    return list(dict.fromkeys((*info.conversions, *notes)))


def _list_facts(one: _Kept) -> dict[str, Any]:
    """Return what was imported for ``--json``."""
    return {
        "recording": one.name,
        "file": str(one.file),
        "source": str(one.source),
        "estimates": [str(file) for file in one.estimates],
        "duration_s": one.duration_s,
        "streams": one.streams,
        "conversions": list(one.info.conversions),
        "notes": list(one.info.notes),
        "sha256": dict(one.info.sha256),
    }


app = App(name="import", help="Turn recordings of other formats into MCAP files.")
app.default(import_)
app.command(
    "stillpoint.scripts.verbs.import_trajectory:import_trajectory",
    name="trajectory",
    help="Put the attitude of another program beside its recording, to be scored.",
)
