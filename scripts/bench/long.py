"""Time and peak memory of verbs on one recording of many hours; docs/scale.md holds the figures.

    python -m stillpoint.scripts.bench.long FOLDER --hours 24 --rate 200 'estimate -e cf' 'export --format csv'

The recording (noise in all digits: the worst case for compression) is made in FOLDER piece by piece, and stays there.
With ``--phone`` it is a simulated phone in the hand without its truth, which has a reference:

    python -m stillpoint.scripts.bench.long FOLDER --hours 24 --rate 100 --phone reference
"""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from stillpoint.datasets.mcap.store import open_recording, write
from stillpoint.datasets.recording import Gps, Head, Imu, Info, Mag, Piece, Truth
from stillpoint.datasets.simulate import simulate
from stillpoint.scripts.program import run_program
from stillpoint.scripts.shared.flags import Whole
from stillpoint.scripts.shared.output import print_line

_START_NS = 1_700_000_000_000_000_000
_PIECE_S = 600
_MAG_EVERY, _GPS_HZ = 4, 1  # a field with every fourth sample of the IMU
_REST_S, _TURN_S, _SWING_S = 60, 240, 8  # at rest, then swinging, in turn: what a reference and the doctor look for

# The peak of a process of its own and of those that it starts.
_MEASURE = """
import json, resource, sys, time
from stillpoint.scripts.main import main
begun, code = time.perf_counter(), 0
try:
    main()
except SystemExit as end:
    code = end.code
used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
with open("/proc/self/status") as status:  # ru_maxrss of a process begins with that of its parent
    own_kb = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
print(json.dumps({"wall_s": time.perf_counter() - begun, "user_s": sum(one.ru_utime + one.ru_stime for one in used),
                  "peak_mb": max(own_kb, used[1].ru_maxrss) / 1e3, "code": code}), file=sys.stderr)
"""


def write_long_recording(path: Path, hours: float, rate_hz: int, seed: int = 0, with_truth: bool = False) -> int:
    """Write a recording of an IMU, a magnetometer and satellite fixes; return the samples of its IMU.

    ``with_truth``: it also has the true attitude at each of them.
    """
    pieces = _make_pieces(hours, rate_hz, seed, with_truth)
    first = next(pieces)
    head = Head(path.stem, Info(source="made for timing", date="2026-01-01", epoch="unix"), {})
    samples = 0
    with open_recording(path, head, first) as out:
        piece: Piece | None = first
        while piece is not None:
            assert piece.imu is not None
            samples += len(piece.imu.t_ns)
            out.add(piece, int(piece.imu.t_ns[-1]) + 1)
            piece = next(pieces, None)
        out.close(head)
    return samples


def write_phone_recording(path: Path, hours: float, rate_hz: int, seed: int = 0) -> int:
    """Write a simulated phone in the hand without its truth; return the samples of its IMU."""
    recording = replace(simulate("phone-3", seed=seed, minutes=60 * hours, rate_hz=rate_hz), truth=None)
    write(path, replace(recording, name=path.stem))
    return len(recording.require_imu().t_ns)


def _make_pieces(hours: float, rate_hz: int, seed: int, with_truth: bool) -> Iterator[Piece]:
    """Yield a recording of this length in pieces: rests and turns about up, with noise of this seed."""
    rng = np.random.default_rng(seed)
    for begin_s in range(0, round(hours * 3600), _PIECE_S):
        n = _PIECE_S * rate_hz
        t_ns = _START_NS + begin_s * 1_000_000_000 + np.arange(n, dtype=np.int64) * (1_000_000_000 // rate_hz)
        t_s = begin_s + np.arange(n) / rate_hz
        # The heading swings by 60 deg and comes back; the body stays level.
        phase = np.maximum((t_s % (_REST_S + _TURN_S)) - _REST_S, 0) / _SWING_S * 2 * np.pi
        yaw = np.pi / 6 * (1 - np.cos(phase))
        rate = np.pi / 6 * np.sin(phase) * 2 * np.pi / _SWING_S
        gyro = rng.normal(size=(n, 3)) * 0.005 + rate[:, None] * np.array([0, 0, 1.0])
        accel = rng.normal(size=(n, 3)) * 0.02 + np.array([0, 0, 9.81])
        of_mag, of_gps = slice(None, None, _MAG_EVERY), slice(None, None, rate_hz // _GPS_HZ)
        field = 20 * np.stack([np.sin(yaw), np.cos(yaw), np.full(n, -2.0)], axis=1)[of_mag]
        fixes = len(t_ns[of_gps])
        zero = np.zeros(n)
        level_q_nb = np.stack([np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)], axis=1)
        yield Piece(
            imu=Imu(t_ns, gyro, accel),
            mag=Mag(t_ns[of_mag], field + rng.normal(size=field.shape) * 0.3),
            gps=Gps(
                t_ns[of_gps],
                lat_deg=np.full(fixes, 48.0),
                lon_deg=np.full(fixes, 11.0),
                alt_m=np.full(fixes, 500.0),
                course_rad=np.zeros(fixes),
                speed_mps=np.zeros(fixes),
                valid=np.ones(fixes, np.bool_),
            ),
            truth=Truth(t_ns, level_q_nb, moving=phase > 0) if with_truth else None,
        )


def _measure_verb(verb: str, path: Path) -> dict[str, float]:
    """Run a verb on a file in a process of its own; return wall and CPU seconds, peak memory in MB and exit code."""
    name, *options = verb.split()
    command = [sys.executable, "-c", _MEASURE, name, str(path), *options]
    run = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
    measured: dict[str, float] = json.loads(run.stderr.strip().splitlines()[-1])
    return measured


def main(
    folder: Path, *verbs: str, hours: float = 1.0, rate: Whole = 200, truth: bool = False, phone: bool = False
) -> None:
    """Make the recording where it is missing, and print time and memory of each verb.

    Parameters
    ----------
    folder
        Where the recording is kept.
    verbs
        A verb with its options, in quotes.
    hours
        Length of the recording.
    rate
        Samples of the IMU per second.
    truth
        With a truth, for score.
    phone
        A simulated phone in the hand, for reference.
    """
    kind = "phone" if phone else "long"
    path = folder / f"{kind}-{hours:g}h-{rate}hz{'-truth' * truth}.mcap"
    if not path.exists():
        begun = time.perf_counter()
        if phone:
            count = write_phone_recording(path, hours, rate)
        else:
            count = write_long_recording(path, hours, rate, with_truth=truth)
        seconds, size_mb = time.perf_counter() - begun, path.stat().st_size / 1e6
        print_line(f"{path.name}: {count} samples, {size_mb:.0f} MB in {seconds:.0f} s", flush=True)
    for verb in verbs:
        found = _measure_verb(verb, path)
        print_line(
            f"{verb}: {found['wall_s']:.1f} s, CPU {found['user_s']:.1f} s, peak {found['peak_mb']:.0f} MB, "
            f"exit code {found['code']:g}",
            flush=True,
        )


if __name__ == "__main__":
    run_program(main)
