"""A recording too long for memory is examined by stretches; the findings say which, and are those of the stretches."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from stillpoint.datasets import BadFile, Imu, Info, Mag, Recording, write
from stillpoint.datasets.doctor import stretches
from stillpoint.datasets.doctor.finding import Diagnosis, Finding
from stillpoint.datasets.doctor.stretches import choose_stretches, merge_diagnoses
from stillpoint.datasets.mcap.indexed import Window
from stillpoint.datasets.mcap.pieces import read_window

HOUR_NS = 3_600_000_000_000


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """Two hours at 10 Hz."""
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    n = 72_000
    t_ns = np.arange(n, dtype=np.int64) * 100_000_000
    rng = np.random.default_rng(3)
    imu = Imu(t_ns, rng.normal(size=(n, 3)) * 0.01, rng.normal(size=(n, 3)) * 0.01 + np.array([0, 0, 9.81]))
    mag = Mag(t_ns[::2], rng.normal(size=(n // 2, 3)) + np.array([20, 0, -40]))
    recording = Recording("long", imu=imu, mag=mag, info=Info(source="a test"))
    write(path, recording)
    return path, recording


def test_stretches_begin_with_the_recording_and_end_with_it(long, monkeypatch):
    path, recording = long
    assert choose_stretches(path) == [], "a short recording is examined whole"
    monkeypatch.setattr(stretches, "MOST_SAMPLES", 40_000)
    monkeypatch.setattr(stretches, "STRETCH_SAMPLES", 10_000)
    chosen = choose_stretches(path)
    assert len(chosen) == stretches.COUNT
    assert chosen[0].start_ns == recording.imu.t_ns[0]
    assert chosen[-1].end_ns == recording.imu.t_ns[-1]
    assert all(one.end_ns < after.start_ns for one, after in pairwise(chosen))


def test_a_window_is_what_the_recording_holds_there(long):
    path, recording = long
    window = Window(HOUR_NS, HOUR_NS + 60_000_000_000)
    found = read_window(path, window)
    for name in ("imu", "mag"):
        whole, part = getattr(recording, name), getattr(found, name)
        inside = (whole.t_ns >= window.start_ns) & (whole.t_ns <= window.end_ns)
        assert part.t_ns.tobytes() == whole.t_ns[inside].tobytes()
    assert found.imu.accel_b_mps2.tobytes() == recording.imu.accel_b_mps2[36_000:36_601].tobytes()
    assert found.mag.mag_b_ut.tobytes() == recording.mag.mag_b_ut[18_000:18_301].tobytes()
    assert found.info == recording.info
    with pytest.raises(BadFile, match="neither gyro and accelerometer"):
        read_window(path, Window(9 * HOUR_NS, 10 * HOUR_NS))


def test_a_code_is_told_once_by_the_stretch_where_it_is_worst():
    spans = [Window(k * HOUR_NS, k * HOUR_NS + HOUR_NS // 2) for k in range(4)]
    common, warned = Finding("noise", "fact", "noise is 1"), Finding("clip", "warning", "10 samples are clipped")
    made = [Diagnosis("run", (common,)) for _ in spans]
    made[2] = Diagnosis("run", (common, replace(warned, severity="fact")))
    made[3] = Diagnosis("run", (common, warned))
    found = merge_diagnoses(list(zip(spans, made, strict=True)))
    assert found.recording == "run"
    assert found.codes() == ("part-examined", "noise", "clip")
    part, noise, clip = found.findings
    assert part.message.startswith("4 stretches of 30 minutes were examined of 3.5 h, at 0.0 h, 1.0 h, 2.0 h, 3.0 h;")
    assert noise == common
    assert clip.severity == "warning"
    assert clip.message == "10 samples are clipped (in 2 of 4 stretches, first in that at 2.0 h)"
