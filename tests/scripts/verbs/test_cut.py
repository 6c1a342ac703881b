"""``stillpoint cut`` writes parts of recordings."""

import numpy as np
import pytest

from stillpoint.datasets import Recording, write
from stillpoint.datasets.mcap.store import read_recording


@pytest.fixture
def file(tmp_path):
    """60 s at 100 Hz without the samples from 30 s to 33 s and from 33.5 s to 35 s."""
    t_s = np.arange(6000) / 100
    t_s = t_s[(t_s < 30) | ((t_s >= 33) & (t_s < 33.5)) | (t_s >= 35)]
    rng = np.random.default_rng(2)
    gyro, accel = rng.normal(0, 0.01, (len(t_s), 3)), rng.normal([0, 0, 9.8], 0.01, (len(t_s), 3))
    path = tmp_path / "run.mcap"
    write(path, Recording.from_arrays("run", t_s + 7.0, gyro, accel))
    return path


def test_a_span_counts_seconds_from_the_first_sample(call, file, capsys):
    assert call("cut", file, "--from", "10", "--to", "20") == 0
    part = read_recording(file.with_name("run-cut.mcap"))
    assert (part.imu.t_ns[0], part.imu.t_ns[-1]) == (17_000_000_000, 27_000_000_000)
    assert "run-cut.mcap: 10.000 s of 59.990 s" in capsys.readouterr().out


def test_every_stretch_between_gaps_becomes_a_file(call, file, tmp_path, capsys):
    assert call("cut", file, "-o", tmp_path / "parts", "--drop-gap") == 0
    parts = sorted((tmp_path / "parts").glob("*.mcap"))
    assert [part.name for part in parts] == ["run-1.mcap", "run-2.mcap"]
    assert [round(read_recording(part).duration_s, 2) for part in parts] == [29.99, 24.99]
    assert "the stretch of 0.490 s at 33.000 s is left out" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        ((), "give --from S"),
        (("--from", "1", "--drop-gap"), "give --from S"),
        (("--from", "20", "--to", "10"), "is not after"),
        (("--from", "nan"), "seconds from 0"),
        (("--from", "31", "--to", "32"), "no sample of imu"),
    ],
)
def test_what_cannot_be_cut_gives_one_line_error(call, file, capsys, flags, says):
    assert call("cut", file, *flags) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1
