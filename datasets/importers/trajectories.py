"""Trajectories of other tools: TUM, KITTI, EuRoC, tables with quaternions, and the pose topics of bags.

::

    read_trajectory("mine.tum")                                    # an Estimate; the format is recognised
    read_trajectory("run.bag", topic="/vio/pose")
    read_trajectory("filter.csv", time="stamp:us", quaternion="q0,q1,q2,q3", frame="ned")
    read_poses("groundtruth.csv")                                  # a Truth, with positions

=======  ====================================================================================================
tum      ``seconds x y z qx qy qz qw`` a line; lines with # are comments (evo, most SLAM tools)
kitti    twelve numbers a line, the upper three rows of the pose matrix; the stamps stand in ``times.txt``
euroc    ``ns,x,y,z,qw,qx,qy,qz,...`` a line (ASL data sets, state_groundtruth_estimate0/data.csv)
csv      any table whose header names a time and a quaternion
bag      PoseStamped, PoseWithCovarianceStamped, TransformStamped, QuaternionStamped, Odometry, TF; also MCAP
=======  ====================================================================================================

A pose takes the body to a local frame, which is East-North-Up unless ``frame`` says otherwise. Any frame with z up will
do for scores, since they align the heading.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.errors import BadParameter, BadRecording, BadSource
from stillpoint.datasets.exporters.tables import ROWS_AT_ONCE
from stillpoint.datasets.frames import (
    EULER_FRAMES,
    EulerFrame,
    from_xyzw,
    quaternion,
    to_xyzw,
)
from stillpoint.datasets.importers.clock import ISO, TIME_EXPONENT, check_rate, repair_clock
from stillpoint.datasets.importers.columns import normalise_unit, parse_quaternion, split
from stillpoint.datasets.importers.delimited import Table, parse
from stillpoint.datasets.importers.files import read_text, reading, require_existing
from stillpoint.datasets.importers.imported import turn_truth
from stillpoint.datasets.importers.ros_files import open_ros
from stillpoint.datasets.importers.ros_truth import POSES, TF, list_pose_topics, read_pose_topic
from stillpoint.datasets.importers.series import Log, find_finite_rows
from stillpoint.datasets.recording import Floats, Times, Truth
from stillpoint.datasets.trajectory import Estimate

Format = Literal["tum", "kitti", "euroc", "csv", "bag"]
_BAGS = (".bag", ".mcap", ".db3")
SUFFIXES = (".tum", ".kitti", ".csv", ".tsv", ".txt", *_BAGS)  # what read_trajectory may be asked to read
_LENGTH_OFF = 0.01  # a quaternion as written with few digits is off unit length by less
_TUM_WIDTH, _KITTI_WIDTH, _EUROC_WIDTH = 8, 12, 8
_EUROC_NS = 1e15  # EuRoC stamps are ns since 1970 or since the start of a computer; seconds never get that large
_COMPONENT = re.compile(
    r"(?:^|.*[^a-z])(?:q|quat|quaternion|rot|ori|orientation)?[ _.\-\[]*([wxyz])\]?(?:\s*[\[(].*)?$", re.I
)
_TIME_NAME = re.compile(
    r"^(?:t|time|times?tamp|stamp|seconds|sec)(?:[ _\-]?[\[(]?(s|sec|ms|us|µs|ns)?[\])]?)?$", re.IGNORECASE
)


@dataclass(frozen=True)
class _PoseOptions:
    """How to read a trajectory; None lets the file say it."""

    format: Format | None = None
    time: str | None = None  # csv: "COLUMN:UNIT" (s, ms, us, ns, iso)
    quaternion: str | None = None  # csv: columns "W,X,Y,Z"
    frame: EulerFrame = "enu"  # the local frame that the poses lead to
    inverse: bool = False  # the file holds the rotation from the local frame to the body
    topic: str | None = None  # bag
    parent: str | None = None  # bag: the fixed frame
    child: str | None = None  # bag: the moving frame of a TF topic
    times: Path | None = None  # kitti: the file of stamps; None looks for times.txt beside the poses


def read_trajectory(path: Path | str, *, name: str | None = None, **options: Any) -> Estimate:
    """Return the attitudes of a trajectory file as an estimate, called ``name`` or by the name of the file.

    ``options`` are the fields of :class:`_PoseOptions`. Raises :class:`BadSource` for a file that is no trajectory,
    :class:`BadParameter` for an option that does not fit.
    """
    poses = read_poses(path, **options)
    return Estimate(poses.t_ns, name or Path(path).stem, q_nb=poses.q_nb, params={"source": Path(path).name})


def read_poses(path: Path | str, log: Log | None = None, **options: Any) -> Truth:
    """Return the poses of a trajectory file, all of them counted as moving; see :func:`read_trajectory`.

    What was sorted or dropped goes to ``log``. Positions are NaN-free or None.
    """
    given = _PoseOptions(**options)
    if given.frame not in EULER_FRAMES:
        raise BadParameter(f"frame {given.frame!r}: is not one of {', '.join(EULER_FRAMES)}")
    log = log or Log()
    file = require_existing(Path(path))
    try:
        with np.errstate(all="ignore"):  # absurd sizes are judged afterwards
            poses = _read_bag(file, given, log) if _is_bag(file, given) else _read_text_poses(file, given, log)
    except BadRecording as error:
        raise BadSource(f"{path}: {error}") from None
    return turn_truth(poses, given.frame, given.inverse)


def _is_bag(file: Path, options: _PoseOptions) -> bool:
    return options.format == "bag" or (options.format is None and (file.is_dir() or file.suffix in _BAGS))


def _read_bag(file: Path, options: _PoseOptions, log: Log) -> Truth:
    """Read poses from a topic of a bag; raises :class:`BadParameter` where the topic has to be named."""
    with reading(file, "a bag"):
        bag = open_ros(file)
        found = sorted(topic for topic, kind in bag.types.items() if kind in POSES and topic != "/tf_static")
        listed = ", ".join(f"{topic} ({bag.types[topic].replace('/msg/', '/')})" for topic in found) or "no pose topic"
        topic = options.topic
        if topic is None:
            poses = [topic for topic in found if bag.types[topic] not in TF] or found
            if not poses:
                raise BadSource(f"{file}: has no topic of poses; name a file with a trajectory")
            if len(poses) > 1:
                raise BadParameter(f"{file}: has {listed}; name one: stillpoint import trajectory --topic TOPIC")
            topic = poses[0]
        if topic not in found:
            raise BadParameter(f"{file}: has no pose topic {topic}; it has {listed}")
        logs = bag.read(list_pose_topics(bag, topic))
        return read_pose_topic(bag, topic, logs, options.parent, options.child, log)


def _read_text_poses(file: Path, options: _PoseOptions, log: Log) -> Truth:
    """Read poses from a text file, in the format that the options name or that its columns show."""
    if file.is_dir():
        raise BadSource(f"{file}: is a folder; name the file of a trajectory")
    table = parse(_read_as_text(file), str(file))
    form = options.format or _recognise(table, file, options)
    readers = {"tum": _read_tum, "kitti": _read_kitti, "euroc": _read_euroc, "csv": _read_csv}
    with reading(file, "a trajectory"):
        return readers[form](table, file, options, log)


def _read_as_text(file: Path) -> str:
    """Return a file as text; raises :class:`BadSource` for binary content."""
    text = read_text(file)
    if "\0" in text:
        raise BadSource(f"{file}: is not text; give a trajectory as text, or an MCAP file by its name *.mcap")
    return text


def _recognise(table: Table, file: Path, options: _PoseOptions) -> Format:
    """Return the format of a text by its columns; raises :class:`BadSource` with what the columns are."""
    if options.quaternion is not None or options.time is not None:
        return "csv"
    if file.suffix == ".tum":
        return "tum"
    if file.suffix == ".kitti":
        return "kitti"
    if _find_quaternion(table) is not None and _find_time(table) is not None:
        return "csv"
    widths = {len(row) for row in table.rows}
    commas = len(table.columns) > 1 and not any(" " in cell for cell in table.rows[0]) and "," in table.delimiter
    if commas and min(widths) >= _EUROC_WIDTH and _read_size(table.rows[0][0]) >= _EUROC_NS:
        return "euroc"
    if widths == {_KITTI_WIDTH}:
        return "kitti"
    if commas:
        raise BadSource(
            f"{file}: its header names no time and quaternion; name them: time COLUMN:UNIT and quaternion W,X,Y,Z; "
            f"it has {table.listed}"
        )
    return "tum"


def _read_size(cell: str) -> float:
    """Return the absolute value of a cell, 0 for one that is no number."""
    try:
        return abs(float(cell))
    except ValueError:
        return 0.0


def _read_tum(table: Table, file: Path, options: _PoseOptions, log: Log) -> Truth:
    """Read lines of seconds, position and quaternion xyzw; raises :class:`BadSource`."""
    wanted = "a TUM pose is eight numbers: seconds x y z qx qy qz qw"
    if len(table.columns) != _TUM_WIDTH:
        raise BadSource(f"{file}: its first line has {len(table.columns)} words; {wanted}")
    for row, line in zip(table.rows, table.lines, strict=True):
        if len(row) != _TUM_WIDTH:
            raise BadSource(f"{file}, line {line}: has {len(row)} words; {wanted}")
    names = table.columns
    t_ns = table.times(names[0], "s")
    values = table.read_floats(names[1:8])
    return _make_poses(t_ns, from_xyzw(values[:, 3:]), values[:, :3], table, log, wanted)


def _read_euroc(table: Table, file: Path, options: _PoseOptions, log: Log) -> Truth:
    """Read rows of nanoseconds, position and quaternion wxyz; raises :class:`BadSource`."""
    names = table.columns
    if len(names) < _EUROC_WIDTH:
        raise BadSource(f"{file}: its header has {len(names)} names; a EuRoC pose is ns,x,y,z,qw,qx,qy,qz")
    t_ns = table.times(names[0], "ns")
    values = table.read_floats(names[1:8])
    return _make_poses(t_ns, values[:, 3:], values[:, :3], table, log, "a EuRoC pose is ns,x,y,z,qw,qx,qy,qz")


def _read_kitti(table: Table, file: Path, options: _PoseOptions, log: Log) -> Truth:
    """Read rows of 3 x 4 matrices, with the stamps of another file; raises :class:`BadSource`."""
    times = options.times or file.with_name("times.txt")
    if not times.is_file():
        raise BadSource(f"{file}: KITTI poses have no stamps, and there is no {times.name} beside them; name that file")
    stamps = parse(read_text(times), str(times))
    if len(stamps.rows) != len(table.rows):
        raise BadSource(
            f"{times}: has {len(stamps.rows)} stamps for {len(table.rows)} poses; name the file of these poses"
        )
    matrices = table.read_floats(table.columns).reshape(-1, 3, 4)
    turns = matrices[:, :, :3]
    off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    if not (off < 10 * _LENGTH_OFF).all() or (np.linalg.det(turns) < 0).any():
        line = table.lines[int(np.nanargmax(np.where(np.isfinite(off), off, np.inf)))]
        raise BadSource(f"{file}, line {line}: is not a rotation; a KITTI pose is twelve numbers, three rows of four")
    q_nb = quaternion(Rotation.from_matrix(turns))
    return _make_poses(stamps.times(stamps.columns[0], "s"), q_nb, matrices[:, :, 3], table, log, "")


def _read_csv(table: Table, file: Path, options: _PoseOptions, log: Log) -> Truth:
    """Read named columns of time and quaternion; rows without an attitude are dropped and noted."""
    time = _find_time(table) if options.time is None else split(options.time, "s")
    quaternions = _find_quaternion(table) if options.quaternion is None else options.quaternion
    if time is None:
        raise BadParameter(f"{file}: name the time column and its unit, COLUMN:UNIT; it has {table.listed}")
    if quaternions is None:
        raise BadParameter(f"{file}: name the columns of the quaternion, W,X,Y,Z; it has {table.listed}")
    if time[1] not in (*TIME_EXPONENT, ISO):
        raise BadParameter(f"{file}: no unit {time[1]!r} of time; there are {', '.join(TIME_EXPONENT)}, {ISO}")
    clock = repair_clock(table.clock(*time), log)
    q_nb = parse_quaternion(quaternions, "quaternion").values(table)
    keep = clock.known & find_finite_rows(q_nb)
    if not keep.all():
        log.add_note(f"{file.name}: {int((~keep).sum())} of {len(keep)} rows without an attitude")
    if not keep.any():
        raise BadSource(f"{file}: no row has a time and a quaternion in {quaternions}; check the columns")
    return _make_poses(clock.t_ns[keep], q_nb[keep], None, table.select(keep), log, f"{quaternions} are w, x, y, z")


def _make_poses(t_ns: Times, q_nb: Floats, position_n_m: Floats | None, table: Table, log: Log, wanted: str) -> Truth:
    """Return poses of normalised quaternions (N, 4) wxyz; raises :class:`BadSource` for rows that are none."""
    length = np.linalg.norm(q_nb, axis=1)
    wrong = np.flatnonzero(~(np.abs(length - 1) < _LENGTH_OFF))
    if len(wrong):
        raise BadSource(
            f"{table.where}, line {table.lines[int(wrong[0])]}: the quaternion has the length {length[wrong[0]]:.3g}, "
            f"not 1; {wanted or 'correct this line'}"
        )
    return Truth(t_ns, q_nb / length[:, None], np.ones(len(t_ns), dtype=np.bool_), position_n_m)


def _find_time(table: Table) -> tuple[str, str] | None:
    """Return the time column of a table and its unit, by their names and by the rate."""
    for name in table.columns:
        match = _TIME_NAME.match(name.strip())
        if not match:
            continue
        unit = normalise_unit((match[1] or "").lower().replace("sec", "s"))
        return name, unit or _guess_unit(table, name)
    return None


def _guess_unit(table: Table, column: str) -> str:
    """Return iso for dates, else the first unit, from s to ns, that gives a rate that sensors have."""
    first = next((row[table.place(column)] for row in table.rows if row), "")
    if "-" in first[1:] and ":" in first:
        return ISO
    for unit in TIME_EXPONENT:
        try:
            check_rate(table.clock(column, unit), table.where)
            return unit
        except (BadParameter, BadSource):
            continue
    return "s"


def _find_quaternion(table: Table) -> str | None:
    """Return the four columns w, x, y, z of a quaternion by their names; None where they are not clear."""
    columns: dict[str, list[str]] = {axis: [] for axis in "wxyz"}
    for name in table.columns:
        if "," not in name and (match := _COMPONENT.match(name.strip())):
            columns[match[1].lower()].append(name)
    if len(columns["w"]) != 1:
        return None
    w = columns["w"][0]
    at = max(k for k, letter in enumerate(w) if letter.lower() == "w")
    named = [w[:at] + letter + w[at + 1 :] for letter in ("wxyz" if w[at] == "w" else "WXYZ")]
    return ",".join(named) if all(name in table.columns for name in named) else None


TUM_HEADER = "# seconds x y z qx qy qz qw (body in East-North-Up)\n"


def format_tum(t_ns: Times, q_nb: Floats, position_n_m: Floats | None = None) -> str:
    """Return poses ``q_nb`` (N, 4) wxyz, ``position_n_m`` (N, 3) or None, as TUM lines; no position is 0 0 0."""
    return "".join([TUM_HEADER, *format_tum_rows(t_ns, q_nb, position_n_m)])


def format_tum_rows(t_ns: Times, q_nb: Floats, position_n_m: Floats | None = None) -> Iterator[str]:
    """Yield the lines of :func:`format_tum` without the header, some thousand at a time."""
    place = np.zeros((len(t_ns), 3)) if position_n_m is None else np.nan_to_num(position_n_m)
    poses = np.hstack([place, to_xyzw(q_nb)])
    for first in range(0, len(t_ns), ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        yield "".join(
            f"{t // 10**9}.{t % 10**9:09d} {' '.join(map(repr, pose))}\n"
            for t, pose in zip(t_ns[rows].tolist(), poses[rows].tolist(), strict=True)
        )
