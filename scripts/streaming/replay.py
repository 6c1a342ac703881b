"""The samples of a recording in the order of a stream, for ``stream --foxglove`` and ``export``."""

from collections.abc import Iterator

from stillpoint.datasets import Recording
from stillpoint.filters.front.sources import choose_magnetometer, newest_rows
from stillpoint.scripts.streaming.lines import Arrival


def replay_samples(recording: Recording) -> Iterator[Arrival]:
    """Yield each IMU sample with the newest field and fix since the sample before, as a batch run takes them.

    A magnetometer that is not calibrated is left out, the course of a fix that is not valid is NaN. Raises
    :class:`BadRecording` without an IMU.
    """
    imu, (mag, _, _), gps = recording.require_imu(), choose_magnetometer(recording), recording.gps
    field = None if mag is None else newest_rows(mag.t_ns, imu.t_ns)
    fix = None if gps is None else newest_rows(gps.t_ns, imu.t_ns)
    for k, t_ns in enumerate(imu.t_ns.tolist()):
        here = None if mag is None or field is None or field[k] < 0 else tuple(mag.mag_b_ut[field[k]].tolist())
        course = None
        if gps is not None and fix is not None and fix[k] >= 0:
            row = fix[k]
            course = (float(gps.course_rad[row]) if gps.valid[row] else float("nan"), float(gps.speed_mps[row]))
        yield Arrival(t_ns, tuple(imu.gyro_b_radps[k].tolist()), tuple(imu.accel_b_mps2[k].tolist()), here, course)
