"""Warn when the first samples of a stream do not fit their units, because the estimates look like any others."""

import sys

import numpy as np

from stillpoint.datasets.plausible import (
    GRAVITY_IN,
    GRAVITY_RANGE_MPS2,
    STILL_ACCEL_SPREAD,
    WINDOW_S,
    describe_field_size,
)
from stillpoint.scripts.shared.output import print_line
from stillpoint.scripts.streaming.lines import Arrival, SpinArrival

_ENOUGH = 20  # samples in a window, so that a spread means something
_MOST_SAMPLES = 2000  # kept of one window; an IMU gives fewer in a second
_SPINNING_RADPS = 10.0  # 570 deg/s while the force keeps still is no rest, and hardly a spin about a sensor
_SLOWEST_HZ, _FASTEST_HZ = 2.0, 50_000.0


class UnitWatch:
    """Looks at whole seconds of samples until one of them is calm, and at the rate of the first samples."""

    def __init__(self) -> None:
        self._window: list[Arrival] = []
        self._rate_is_known = False
        self._is_done = False

    def see(self, sample: Arrival | SpinArrival) -> None:
        """Take one sample; warn once about the rate, and once after the first calm second about the sizes."""
        if self._is_done or not isinstance(sample, Arrival):
            return
        self._window.append(sample)
        if not self._rate_is_known and len(self._window) == _ENOUGH:
            self._rate_is_known = True
            self._check_rate()
        spans = sample.t_ns - self._window[0].t_ns >= WINDOW_S * 1e9
        if len(self._window) >= _MOST_SAMPLES or (spans and len(self._window) >= _ENOUGH):
            self._check_sizes()
            self._window = []

    def _check_rate(self) -> None:
        """Warn where the rate of the samples shows that ``t_s`` is in another unit."""
        step_s = float(np.median(np.diff([each.t_ns for each in self._window]))) / 1e9
        if step_s <= 0 or _SLOWEST_HZ <= 1 / step_s <= _FASTEST_HZ:
            return
        slow = 1 / step_s < _SLOWEST_HZ
        likely = "ms or us, not s" if slow else "s, not a finer unit"
        _warn(f"the samples come at {1 / step_s:.3g} Hz by their time; it looks as if t_s were in {likely}")

    def _check_sizes(self) -> None:
        """Warn once, at the first rest, where gyro, accelerometer or magnetometer look like another unit."""
        force = np.array([each.accel_b_mps2 for each in self._window])
        rate = np.array([each.gyro_b_radps for each in self._window])
        size = float(np.linalg.norm(force.mean(axis=0)))
        if not np.linalg.norm(force.std(axis=0)) < STILL_ACCEL_SPREAD * size:
            return
        self._is_done = True
        turning = float(np.linalg.norm(rate.mean(axis=0)))
        if turning > _SPINNING_RADPS:
            _warn(
                f"the gyro reads {turning:.3g} rad/s while the accelerometer is calm: it looks like deg/s: "
                "multiply by pi/180"
            )
        if not GRAVITY_RANGE_MPS2[0] <= size <= GRAVITY_RANGE_MPS2[1]:
            near = min(GRAVITY_IN, key=lambda gravity: abs(size - gravity))
            hint = f": it looks {GRAVITY_IN[near]}" if 0.9 < size / near < 1.1 else ""
            _warn(f"the accelerometer reads {size:.4g} m/s^2 at rest, not near 9.8{hint}")
        fields = [each.mag_b_ut for each in self._window if each.mag_b_ut is not None]
        if fields:
            doubt = describe_field_size(float(np.median(np.linalg.norm(np.array(fields), axis=1))))
            if doubt:
                _warn(f"the magnetometer has a {doubt}; where its unit is right, calibrate it")


def _warn(text: str) -> None:
    print_line(f"stillpoint: {text}", file=sys.stderr, flush=True)
