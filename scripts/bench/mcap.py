"""Times of writing and reading an hour of a phone's sensors, beside ``mcap`` with ``mcap-ros2-support``.

The peer writes and reads the three topics Imu, MagneticField and PoseStamped; stillpoint, through its public ``read``
and ``write``, does the same and the flag of the truth, the exact remainder of the field, and all checksums.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.mcap.cdr import get_definition
from stillpoint.datasets.mcap.store import read, write
from stillpoint.datasets.mcap.topics import IMU, MAG, POSE, UT_PER_TESLA
from stillpoint.datasets.recording import Floats, Imu, Mag, Recording, Truth
from stillpoint.scripts.bench.timing import Timing, time_call

HOUR = 360_000  # samples at 100 Hz
_TENTH = 10  # the peer needs about a minute for the hour: it gets a tenth of the data, and its seconds count ten times
_REPEATS = 3  # of ours per run: a short time is hit harder by what else the machine does
_TOPICS = 3

# The peak that a process has reached by its own: Linux hands ru_maxrss of a parent down to its children.
_MEASURE = """
import json, resource, sys, time
from stillpoint.datasets import read
def measure_peak():
    if sys.platform == "linux":
        with open("/proc/self/status") as status:
            return 1024 * next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
before, start = measure_peak(), time.perf_counter()
recording = read(sys.argv[1])
print(json.dumps({"seconds": time.perf_counter() - start, "bytes": measure_peak() - before}))
"""


def bench_mcap(runs: int) -> list[Timing]:
    """Return the rows of writing, reading and peak memory."""
    peer = Peer()
    hour, tenth = make_phone(HOUR), make_phone(HOUR // _TENTH)
    seconds: dict[str, list[float]] = {"peer write": [], "write": [], "peer read": [], "read": []}
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = Path(folder) / "ours.mcap", Path(folder) / "theirs.mcap"
        steps: dict[str, Callable[[], object]] = {
            "peer write": lambda: peer.write(theirs, tenth),
            "write": lambda: write(ours, hour),
            "peer read": lambda: peer.read(theirs),
            "read": lambda: read(ours),
        }
        write(ours, tenth)  # imports and tables are made once
        read(ours)
        for _ in track(range(runs), "mcap", console=Console(stderr=True), transient=True):
            for name, step in steps.items():
                if name.startswith("peer"):
                    seconds[name].append(time_call(step) * _TENTH)
                else:
                    seconds[name] += [time_call(step) for _ in range(_REPEATS)]
        peaks = [_measure(ours) for _ in range(runs)]
    n = HOUR * _TOPICS
    name = "mcap + mcap-ros2-support (a tenth, times 10)"
    peer_write = Timing(f"write, {name}", seconds["peer write"], n)
    peer_read = Timing(f"read, {name}", seconds["peer read"], n)
    size, peak = _count_bytes(hour), max(one["bytes"] for one in peaks)
    return [
        peer_write,
        Timing("write, stillpoint", seconds["write"], n, against=peer_write),
        peer_read,
        Timing("read, stillpoint", seconds["read"], n, against=peer_read),
        Timing(
            f"read, stillpoint in a new process: peak memory {peak / 1e6:.0f} MB",
            [one["seconds"] for one in peaks],
            n,
            extra={
                "against": f"the arrays, {size / 1e6:.0f} MB",
                "ratio": peak / size,
                "ratio_is": "times as large",
                "peak_bytes": peak,
                "array_bytes": size,
            },
        ),
    ]


def make_phone(n: int, seed: int = 0) -> Recording:
    """Return a recording with noise in all digits: the worst case for compression."""
    rng = np.random.default_rng(seed)
    t_ns = np.arange(n, dtype=np.int64) * 10_000_000 + 1_700_000_000_000_000_000
    q_nb = rng.normal(size=(n, 4))
    q_nb /= np.linalg.norm(q_nb, axis=1, keepdims=True)
    imu = Imu(t_ns, rng.normal(size=(n, 3)), rng.normal(size=(n, 3)) + np.array([0.0, 0.0, 9.81]))
    mag = Mag(t_ns, rng.normal(size=(n, 3)) + np.array([0.0, 20.0, -40.0]))
    return Recording("bench", imu=imu, mag=mag, truth=Truth(t_ns, q_nb, np.ones(n, np.bool_), rng.normal(size=(n, 3))))


class Peer:
    """Reads and writes as the documentation of ``mcap`` shows: one Python object per message."""

    def __init__(self) -> None:
        """Import the peer; raises :class:`BadParameter` where it is not installed."""
        try:
            from mcap.reader import make_reader
            from mcap_ros2.decoder import DecoderFactory
            from mcap_ros2.writer import Writer
        except ImportError as error:
            raise BadParameter(
                "bench mcap: mcap-ros2-support is not installed; pip install mcap-ros2-support"
            ) from error
        self.make_reader, self.decoders, self.writer = make_reader, DecoderFactory, Writer

    def write(self, path: Path, recording: Recording) -> None:
        """Write the three topics, interleaved by time."""
        imu, mag, truth = recording.require_imu(), recording.mag, recording.truth
        assert mag is not None
        assert truth is not None
        assert truth.position_n_m is not None
        gyro, accel, q_nb = imu.gyro_b_radps.tolist(), imu.accel_b_mps2.tolist(), truth.q_nb.tolist()
        tesla, position = (mag.mag_b_ut / UT_PER_TESLA).tolist(), truth.position_n_m.tolist()
        zeros, upright = [0.0] * 9, SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        with path.open("wb") as file:
            writer = self.writer(file)
            schemas = [writer.register_msgdef(name, get_definition(name)) for name in (IMU, MAG, POSE)]
            for k, t in enumerate(imu.t_ns.tolist()):
                header = {"stamp": {"sec": t // 10**9, "nanosec": t % 10**9}, "frame_id": "imu_link"}
                orientation = dict(zip("wxyz", q_nb[k], strict=True))
                messages: list[tuple[str, dict[str, Any]]] = [
                    (
                        "/imu/data_raw",
                        {
                            "orientation": vars(upright),
                            "orientation_covariance": zeros,
                            "angular_velocity": dict(zip("xyz", gyro[k], strict=True)),
                            "angular_velocity_covariance": zeros,
                            "linear_acceleration": dict(zip("xyz", accel[k], strict=True)),
                            "linear_acceleration_covariance": zeros,
                        },
                    ),
                    (
                        "/imu/mag",
                        {
                            "magnetic_field": dict(zip("xyz", tesla[k], strict=True)),
                            "magnetic_field_covariance": zeros,
                        },
                    ),
                    (
                        "/truth/pose",
                        {"pose": {"position": dict(zip("xyz", position[k], strict=True)), "orientation": orientation}},
                    ),
                ]
                for schema, (topic, message) in zip(schemas, messages, strict=True):
                    writer.write_message(topic, schema, {"header": header, **message}, log_time=t, publish_time=t)
            writer.finish()

    def read(self, path: Path) -> dict[str, Floats]:
        """Return the numbers of the three topics as arrays."""
        rows: dict[str, list[tuple[float, ...]]] = {"/imu/data_raw": [], "/imu/mag": [], "/truth/pose": []}
        with path.open("rb") as file:
            reader = self.make_reader(file, decoder_factories=[self.decoders()])
            for _, channel, message, decoded in reader.iter_decoded_messages():
                row: tuple[float, ...]
                if channel.topic == "/imu/data_raw":
                    w, f = decoded.angular_velocity, decoded.linear_acceleration
                    row = (message.log_time, w.x, w.y, w.z, f.x, f.y, f.z)
                elif channel.topic == "/imu/mag":
                    b = decoded.magnetic_field
                    row = (message.log_time, b.x, b.y, b.z)
                else:
                    q, r = decoded.pose.orientation, decoded.pose.position
                    row = (message.log_time, q.w, q.x, q.y, q.z, r.x, r.y, r.z)
                rows[channel.topic].append(row)
        return {topic: np.array(values) for topic, values in rows.items()}


def _count_bytes(recording: Recording) -> int:
    """Return the bytes of all columns, the stamps of each stream included."""
    streams = (recording.imu, recording.mag, recording.truth)
    return sum(a.nbytes for stream in streams for a in vars(stream).values() if isinstance(a, np.ndarray))


def _measure(path: Path) -> dict[str, float]:
    """Return time and memory of reading a file, measured in a process of its own."""
    done = subprocess.run([sys.executable, "-c", _MEASURE, str(path)], capture_output=True, text=True, check=True)
    result: dict[str, float] = json.loads(done.stdout)
    return result
