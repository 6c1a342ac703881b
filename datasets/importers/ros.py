"""ROS 1 bags, ROS 2 bags and MCAP files of others: Imu, MagneticField, NavSatFix, and an attitude as truth.

Stamps are those of the headers. Vectors are as ROS defines them (REP 103, REP 145): rad/s, m/s^2 with +g up at rest,
tesla; the attitude takes the body to a local East-North-Up frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.importers.bundle import digests, existing
from stillpoint.datasets.importers.clock import Log, Series, finite, rising
from stillpoint.datasets.importers.gps import fixes
from stillpoint.datasets.importers.options import OwnOptions
from stillpoint.datasets.importers.provenance import own_info
from stillpoint.datasets.importers.ros_messages import LEAVES, TF, Source, open_source
from stillpoint.datasets.importers.units import FIELD
from stillpoint.datasets.recording import Gps, Imu, Mag, Recording, Truth


@dataclass(frozen=True)
class RosOptions(OwnOptions):
    """Which topics to take, where there is more than one of a type."""

    imu_topic: str | None = None
    mag_topic: str | None = None
    gps_topic: str | None = None
    truth_topic: str | None = None
    truth_child: str | None = None  # the child frame to take from a TF topic


def read_ros(source: Path, options: RosOptions) -> Iterator[Recording]:
    """The one recording of a ``.bag``, a ROS 2 bag (folder), or an ``.mcap``. Raises :class:`BadSource`."""
    existing(source)
    log = Log()
    series: dict[str, Series] = {}
    with open_source(source) as bag:
        for stream, leaves in LEAVES.items():
            topic = _topic(source, bag, stream, options)
            if topic is not None:
                kind = bag.types[topic]
                log.converted(f"{stream} from {topic} ({kind.replace('/msg/', '/')}), stamps of its headers")
                series[stream] = bag.read(topic, leaves[kind], options.truth_child, log)
    streams = {
        stream: rising(one if stream == "gps" else finite(one, stream, log), stream, log)
        for stream, one in series.items()
    }
    yield _recording(source, streams, options, log)


def _topic(source: Path, bag: Source, stream: str, options: RosOptions) -> str | None:
    """The topic of a stream: the one that was named, or the only one of its types."""
    named = getattr(options, f"{stream}_topic")
    listed = ", ".join(f"{topic} ({kind.replace('/msg/', '/')})" for topic, kind in bag.types.items()) or "no topic"
    found = sorted(topic for topic, kind in bag.types.items() if kind in LEAVES[stream])
    if named is not None:
        if named not in found:
            raise BadParameter(f"--{stream}-topic {named}: {source} has no such topic for {stream}; it has {listed}")
        return str(named)
    if stream == "truth":
        # TF holds whatever moves: it is taken for the truth only when nothing says more.
        found = [topic for topic in found if bag.types[topic] not in TF] or [t for t in found if t != "/tf_static"]
    if stream == "imu" and not found:
        raise BadSource(f"{source}: has no topic of sensor_msgs/Imu; it has {listed}")
    if len(found) > 1:
        raise BadParameter(
            f"{source}: has {len(found)} {stream} topics, {', '.join(found)}; name one: --{stream}-topic"
        )
    return found[0] if found else None


def _recording(source: Path, series: dict[str, Series], options: RosOptions, log: Log) -> Recording:
    imu = series["imu"]
    files = [source] if source.is_file() else sorted(file for file in source.rglob("*") if file.is_file())
    mag = _mag(series["mag"], log) if "mag" in series else None
    gps = _gps(series["gps"], log) if "gps" in series else None
    truth = _truth(source, series["truth"], log) if "truth" in series else None
    sha256 = digests(files, source.parent if source.is_file() else source)
    info = own_info(f"ROS bag {source.name}", options, imu.t_ns, sha256, log)
    stream = Imu(imu.t_ns, imu.values[:, :3], imu.values[:, 3:])
    return Recording(source.stem, imu=stream, mag=mag, gps=gps, truth=truth, info=info)


def _mag(series: Series, log: Log) -> Mag:
    log.converted("mag T -> uT")
    return Mag(series.t_ns, FIELD["T"] * series.values)


def _gps(series: Series, log: Log) -> Gps:
    """Fixes without course and speed, which NavSatFix does not have; a status below 0 is no fix."""
    values = np.full((len(series.t_ns), 5), np.nan)
    values[:, :3] = series.values[:, :3]
    values[series.values[:, 3] < 0, :2] = np.nan
    return fixes(Series(series.t_ns, values), log)


def _truth(source: Path, series: Series, log: Log) -> Truth:
    norm = np.linalg.norm(series.values[:, :4], axis=1)
    known = norm > 0.5
    if not known.all():
        log.noted(f"truth: {int((~known).sum())} samples without an attitude dropped")
        series = series.where(known)
    if not known.any():
        raise BadSource(f"{source}: the truth topic holds no attitude; name another by --truth-topic")
    log.converted("truth x, y, z, w -> w, x, y, z; its local frame is taken as East-North-Up (REP 103)")
    q_nb = series.values[:, :4] / norm[known, None]
    position = series.values[:, 4:] if series.values.shape[1] == 7 else None
    return Truth(series.t_ns, q_nb, np.ones(len(q_nb), dtype=np.bool_), position)
