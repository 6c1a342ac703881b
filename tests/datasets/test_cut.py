"""Parts of recordings keep their samples bit for bit."""

import numpy as np
import pytest

from stillpoint.datasets import BadRecording, Gps, Imu, Info, Mag, Recording, Truth
from stillpoint.datasets.cut import cut_recording, find_stretches
from stillpoint.datasets.recording import Series

START_NS = 5_000_000_000


@pytest.fixture
def recording():
    """100 s at 100 Hz with a gap from 40 s to 60 s; the magnetometer at 10 Hz starts 1 s earlier."""
    t_ns = START_NS + np.arange(10_000, dtype=np.int64) * 10_000_000
    t_ns = t_ns[(t_ns < START_NS + 40_000_000_000) | (t_ns >= START_NS + 60_000_000_000)]
    mag_ns = START_NS - 1_000_000_000 + np.arange(500, dtype=np.int64) * 100_000_000
    rng = np.random.default_rng(1)
    gyro, accel = rng.normal(0, 0.01, (len(t_ns), 3)), rng.normal([0, 0, 9.8], 0.01, (len(t_ns), 3))
    truth = Truth(t_ns[::10], np.tile([1.0, 0, 0, 0], (len(t_ns[::10]), 1)), np.ones(len(t_ns[::10]), np.bool_))
    gps = Gps(mag_ns[:3], *np.zeros((5, 3)), np.ones(3, np.bool_))
    mag = Mag(mag_ns, rng.normal([20, 0, -40], 1, (500, 3)))
    return Recording("run", imu=Imu(t_ns, gyro, accel), mag=mag, gps=gps, truth=truth, info=Info(notes=("old",)))


def test_a_span_keeps_its_samples_and_says_what_it_is(recording):
    part = cut_recording(recording, START_NS + 10_000_000_000, START_NS + 20_000_000_000, "part")
    keep = (recording.imu.t_ns >= START_NS + 10_000_000_000) & (recording.imu.t_ns <= START_NS + 20_000_000_000)
    assert len(part.imu.t_ns) == keep.sum() == 1001
    np.testing.assert_array_equal(part.imu.gyro_b_radps, recording.imu.gyro_b_radps[keep])
    assert len(part.mag.t_ns) == 101
    assert len(part.truth.t_ns) == len(part.truth.moving) == 101
    assert part.gps is None
    assert part.info.notes == (
        "old",
        "cut from run: 11.000 s to 21.000 s",
        "cut: no sample of gps is left",
    )


def test_stretches_end_at_gaps(recording):
    spans = [(first - START_NS, last - START_NS) for first, last in find_stretches(recording)]
    assert spans == [(0, 39_990_000_000), (60_000_000_000, 99_990_000_000)]


def test_a_span_without_a_sample_of_the_imu_is_refused(recording):
    with pytest.raises(BadRecording, match="no sample of imu from 46"):
        cut_recording(recording, START_NS + 45_000_000_000, START_NS + 55_000_000_000, "part")


def test_other_sensors_are_cut_with_the_rest():
    t_ns = np.arange(100, dtype=np.int64) * 10_000_000
    imu = Imu(t_ns, np.zeros((100, 3)), np.tile([0, 0, 9.81], (100, 1)))
    wheel = Series(t_ns[::2], np.arange(50.0), ("speed_mps",))
    part = cut_recording(Recording("run", imu, extra={"wheel": wheel}), 200_000_000, 400_000_000, "part")
    assert part.extra["wheel"].column("speed_mps").tolist() == list(range(10, 21))
