"""Samples in other units are reported once, on stderr, after the first calm second; good samples are not."""

import numpy as np
import pytest

from stillpoint.scripts.streaming.lines import Arrival
from stillpoint.scripts.streaming.unit_watch import UnitWatch

G = 9.80665


def feed(accel_mps2, gyro_radps=0.01, mag_ut=None, step_s=0.01, n=500, shake=0.0):
    """Samples at rest, or shaken, with the force up along z."""
    watch, rng = UnitWatch(), np.random.default_rng(3)
    for k in range(n):
        force = np.array([0.0, 0.0, accel_mps2]) * (1 + shake * rng.normal())
        mag = None if mag_ut is None else (mag_ut, 0.0, 0.0)
        watch.see(Arrival(round(k * step_s * 1e9), (gyro_radps, 0.0, 0.0), tuple(force), mag, None))


@pytest.mark.parametrize(
    ("samples", "says"),
    [
        ({"accel_mps2": 1.0}, "in g: multiply by 9.80665"),
        ({"accel_mps2": 1000.0}, "milli-g"),
        ({"accel_mps2": G, "gyro_radps": 30.0}, "looks like deg/s"),
        ({"accel_mps2": G, "mag_ut": 0.49}, "gauss: multiply by 100"),
        ({"accel_mps2": G, "step_s": 10.0}, "as if t_s were in ms"),
        ({"accel_mps2": G, "step_s": 1e-5}, "in s, not a finer unit"),
    ],
)
def test_a_wrong_unit_is_reported_once(samples, says, capsys):
    feed(**samples)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("stillpoint: ")
    assert says in line


@pytest.mark.parametrize("samples", [{}, {"mag_ut": 49.0}, {"shake": 0.3}, {"gyro_radps": 1.0}, {"step_s": 0.001}])
def test_good_samples_are_not_reported(samples, capsys):
    """Also while the body is shaken, and on a turntable at 57 deg/s."""
    feed(accel_mps2=G, **samples)
    assert capsys.readouterr().err == ""


def test_motion_is_not_judged_until_a_calm_second_comes(capsys):
    """In g and shaken: nothing says gravity's size."""
    feed(accel_mps2=1.0, shake=0.3)
    assert capsys.readouterr().err == ""
