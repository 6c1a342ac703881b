"""Find the base pose, and the rests in which the sensor is back in it.

The base pose is the attitude of the first rest: tilt from the mean specific force, heading from the mean field and the
declination (Elmi Aziz and Mohseni Araste (2021), eqs. 4-8, in vectors: the same numbers without the singularity of the
angles). A later rest is a return if gravity has the base's direction in the body *and* the gyro, integrated since the
last return, agrees that the heading is the base's: a rest on the same table, but turned, has the same tilt.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.earth import local_declination
from stillpoint.datasets.errors import BadRecording, Unobservable
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.recording import Floats, Recording, Times
from stillpoint.datasets.settings import Settings, degrees, number
from stillpoint.datasets.trajectory import BasePoseReturn
from stillpoint.smoother.strapdown import GyroErrors, Swing, drift_covariance, swing, walk_steps

_LEVEL_FIELD_SHARE = 0.05  # level part of a field below which it shows no heading

_SHAKEN_S = 5.0  # a stretch between two rests that is shorter and turns by less is a tap or a bump
_SHAKEN_RAD = np.deg2rad(1.0)


@dataclass(frozen=True)
class ReturnParams(Settings):
    """Settings of the returns to the base pose: default, lowest, highest, meaning."""

    lead_s: float = number(2.0, 0.0, 60.0, "the first rest must begin within this time of the first sample")
    repeat_sd_rad: float = degrees(0.4, 0.001, 10.0, "how well the sensor is put back, per axis")
    heading_sd_rad: float = degrees(0.25, 0.001, 10.0, "how well its heading is put back in the graph, where it is")
    heading_kernel: float = number(1.0, 0.1, 100.0, "a return turned by so many sd has half its weight (Cauchy)")
    tilt_gate_rad: float = degrees(3.0, 0.1, 30.0, "largest difference of gravity's direction from the base's")
    heading_gate_rad: float = degrees(10.0, 0.1, 90.0, "a heading difference below this is always accepted")
    heading_gate_sd: float = number(4.0, 1.0, 20.0, "and so is one below this multiple of the gyro's drift")
    heading_limit_rad: float = degrees(45.0, 1.0, 180.0, "but none above this, however long the gyro drifted")


@dataclass(frozen=True, eq=False)
class BasePose:
    """The attitude in which the sensor rests first and to which it returns."""

    q_nb: Floats  # (4,)
    start: int  # first and last sample of the first rest
    end: int
    accel_b_mps2: Floats  # (3,) mean over it
    gyro_bias_b_radps: Floats  # (3,) mean over it
    heading: str  # what the heading refers to


@dataclass(frozen=True, eq=False)
class Returns:
    """The verdict on every rest after the first, and the accepted returns."""

    verdicts: tuple[BasePoseReturn, ...]
    spans: tuple[tuple[int, int], ...]  # first and last sample of each accepted return
    swings: tuple[Swing, ...]  # the integration that ends at each accepted return


def find_base_pose(recording: Recording, rests_ns: Times, params: ReturnParams) -> BasePose:
    """Return the base pose of a recording with these rests.

    Raises :class:`Unobservable` when the recording does not begin at rest, :class:`BadRecording` when the pose it
    carries contradicts gravity.
    """
    imu = recording.require_imu()
    if len(rests_ns) == 0:
        raise Unobservable(
            f"{recording.name}: no rest of a second or more in {recording.duration_s:.0f} s; "
            "record again with the sensor at rest in the base pose at the start and every 20-30 s"
        )
    lead_s = (rests_ns[0, 0] - imu.t_ns[0]) / 1e9
    if lead_s > params.lead_s:
        raise Unobservable(
            f"{recording.name}: is not at rest at its start, the first rest begins after {lead_s:.1f} s; "
            "cut the recording (stillpoint cut --from S) so that it starts in the base pose"
        )
    start, end = np.searchsorted(imu.t_ns, rests_ns[0])
    accel = imu.accel_b_mps2[start : end + 1].mean(axis=0)
    bias = imu.gyro_b_radps[start : end + 1].mean(axis=0)
    q_nb, heading = _attitude(recording, rests_ns[0], accel, params)
    return BasePose(q_nb, int(start), int(end), accel, bias, heading)


def find_returns(
    recording: Recording, rests_ns: Times, base: BasePose, errors: GyroErrors, params: ReturnParams
) -> Returns:
    """Judge every rest after the first by its tilt and by the heading that the gyro predicts for it."""
    imu = recording.require_imu()
    verdicts: list[BasePoseReturn] = []
    spans: list[tuple[int, int]] = []
    swings: list[Swing] = []
    left, walk_rad2 = base.end, walk_steps(imu.t_ns, errors)
    for start, end in np.searchsorted(imu.t_ns, rests_ns[1:]):
        tilt_rad = _angle(base.accel_b_mps2, imu.accel_b_mps2[start : end + 1].mean(axis=0))
        path = swing(imu, base.gyro_bias_b_radps, left, int(start), base.q_nb, walk_rad2)
        accepted, reason = _judge(tilt_rad, path, base, errors, params)
        if accepted and _is_same_rest(path, base):
            accepted, reason, left = False, f"{reason}; not moved since the rest before: no return", int(end)
        verdicts.append(BasePoseReturn(int(imu.t_ns[start]), int(imu.t_ns[end]), tilt_rad, accepted, reason))
        if accepted:
            spans.append((int(start), int(end)))
            swings.append(path)
            left = int(end)
    return Returns(tuple(verdicts), tuple(spans), tuple(swings))


def _is_same_rest(path: Swing, base: BasePose) -> bool:
    """Return whether a rest was only shaken since the one before, as by a tap: it was not put back."""
    if np.abs(path.dt_s).sum() >= _SHAKEN_S:
        return False
    turned_rad = (rotation(base.q_nb).inv() * rotation(path.q_nb)).magnitude()
    return bool(turned_rad.max(initial=0.0) < _SHAKEN_RAD)


def closure(path: Swing, base: BasePose) -> Rotation:
    """Return the earth-frame rotation from the end of a swing to the base pose."""
    return rotation(base.q_nb) * rotation(path.q_nb[-1]).inv()


def level_attitude(up_b: Floats, field_b: Floats | None) -> Rotation:
    """Return the rotation from body to East-North-Up for the directions of up and of the field in the body.

    The horizontal part of the field points to magnetic north. Without a field (None) the smallest rotation that levels
    the body is returned. Raises :class:`Unobservable` when the field is vertical.
    """
    up = up_b / np.linalg.norm(up_b)
    if field_b is None:
        return Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0]
    east = np.cross(field_b / np.linalg.norm(field_b), up)
    if np.linalg.norm(east) < _LEVEL_FIELD_SHARE:
        raise Unobservable("the magnetic field at rest is vertical and shows no heading; leave the magnetometer out")
    east /= np.linalg.norm(east)
    return Rotation.from_matrix(np.stack([east, np.cross(up, east), up]))


def _attitude(recording: Recording, rest_ns: Times, accel_b: Floats, params: ReturnParams) -> tuple[Floats, str]:
    """Return the attitude (4,) of the first rest and what its heading refers to."""
    if recording.base_pose is not None:
        tilt_rad = _angle(rotation(recording.base_pose).inv().apply([0.0, 0.0, 1.0]), accel_b)
        if tilt_rad > params.tilt_gate_rad:
            raise BadRecording(
                f"{recording.name}: base_pose is tilted by {np.rad2deg(tilt_rad):.1f} deg against gravity in the first "
                "rest; correct it, or leave it out so that it is found from the rest"
            )
        return recording.base_pose, "of the base pose that the recording carries"
    mag = recording.mag
    if mag is None:
        return quaternion(level_attitude(accel_b, None)), "arbitrary: there is no magnetometer"
    if recording.info.mag_uncalibrated:
        return quaternion(level_attitude(accel_b, None)), "arbitrary: the magnetometer is not calibrated"
    rows = (mag.t_ns >= rest_ns[0]) & (mag.t_ns <= rest_ns[1])
    if not rows.any():
        return quaternion(level_attitude(accel_b, None)), "arbitrary: the magnetometer is silent in the first rest"
    magnetic = level_attitude(accel_b, mag.mag_b_ut[rows].mean(axis=0))
    declination, heading = local_declination(recording.info)
    return quaternion(heading_rotation(-declination) * magnetic), heading


def _judge(tilt_rad: float, path: Swing, base: BasePose, errors: GyroErrors, params: ReturnParams) -> tuple[bool, str]:
    tilt = f"gravity {np.rad2deg(tilt_rad):.1f} deg off the base's"
    if tilt_rad > params.tilt_gate_rad:
        return False, f"{tilt}, above {np.rad2deg(params.tilt_gate_rad):.1f}: another pose"
    back = quaternion(closure(path, base))
    heading_rad = 2 * abs(float(np.arctan2(back[3], back[0])))
    sd_rad = float(np.sqrt(drift_covariance(path, errors)[2, 2]))
    gate_rad = min(max(params.heading_gate_rad, params.heading_gate_sd * sd_rad), params.heading_limit_rad)
    heading = f"the gyro's heading {np.rad2deg(heading_rad):.1f} deg off (drift {np.rad2deg(sd_rad):.1f} deg, 1 sd)"
    if heading_rad > gate_rad:
        return False, f"{tilt}, but {heading}, above {np.rad2deg(gate_rad):.1f}: turned against the base"
    return True, f"{tilt}, {heading}"


def _angle(a: Floats, b: Floats) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
