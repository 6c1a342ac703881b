"""A truth in another convention, of another body, held or slipping: any remedy is on the truth alone."""

from dataclasses import replace

import numpy as np
import pytest
from resting import cut
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Estimate, Recording, Truth
from stillpoint.datasets.doctor import Diagnosis, apply, diagnose
from stillpoint.datasets.frames import local_from_enu, quaternion, rotation
from stillpoint.datasets.simulate import simulate
from stillpoint.scoring import score
from stillpoint.smoother.rest import find_rests

NED = local_from_enu("ned")
HALF_X, QUARTER_X = Rotation.from_euler("x", 180, degrees=True), Rotation.from_euler("x", 90, degrees=True)
IMU_STREAMS = ("imu", "mag")


def with_truth(recording: Recording, change) -> Recording:
    truth = recording.truth
    return replace(recording, truth=replace(truth, q_nb=change(truth.q_nb.copy())))


def turn_imu(recording: Recording, turn: Rotation) -> Recording:
    """The same motion with the whole IMU mounted otherwise."""
    m, imu = turn.as_matrix().T, recording.imu
    imu = replace(imu, gyro_b_radps=imu.gyro_b_radps @ m, accel_b_mps2=imu.accel_b_mps2 @ m)
    mag = None if recording.mag is None else replace(recording.mag, mag_b_ut=recording.mag.mag_b_ut @ m)
    return replace(recording, imu=imu, mag=mag, base_pose=None)


def examine(recording: Recording) -> Diagnosis:
    return diagnose(recording, find_rests(recording.imu))


def require_untouched(before: Recording, after: Recording) -> None:
    """Every sample of the sensors is bit-equal."""
    for name in IMU_STREAMS:
        for key, value in vars(getattr(before, name)).items():
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(value, getattr(getattr(after, name), key))


CONVENTIONS = {
    "inverse": (lambda q: q * [1, -1, -1, -1], "truth-quaternion"),
    "xyzw": (lambda q: np.roll(q, -1, axis=1), "truth-quaternion"),
    "wxyz": (lambda q: np.roll(q, 1, axis=1), "truth-quaternion"),
    "ned": (lambda q: quaternion(NED * rotation(q)), "truth-world-frame"),
    "ned-frd": (lambda q: quaternion(NED * rotation(q) * HALF_X), "truth-world-frame"),
    "y up": (lambda q: quaternion(QUARTER_X.inv() * rotation(q)), "truth-world-frame"),
    "left-handed": (lambda q: q * [1, -1, 1, -1], "truth-world-frame"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CONVENTIONS)
@pytest.mark.parametrize("place", [True, False])
def test_a_truth_in_another_convention_is_mended_and_no_sensor_is_touched(phone, name, place):
    """After the remedy the truth is the right one but for a heading and a mounting, which no sensor shows."""
    change, code = CONVENTIONS[name]
    known = phone if place else replace(phone, base_pose=None, info=replace(phone.info, place_lat_lon_alt=None))
    planted = with_truth(known, change)
    diagnosis = examine(planted)
    assert diagnosis.codes("error", "warning") == (code,)
    mended = apply(planted, diagnosis.remedies)
    require_untouched(phone, mended)
    estimate = Estimate(mended.truth.t_ns, "mended", q_nb=mended.truth.q_nb)
    assert score(estimate, phone.truth, "heading+mounting").total_max_deg < 0.01
    assert examine(mended).clean


def test_without_magnetometer_a_world_upside_down_may_be_an_inverted_accelerometer(phone):
    """Nothing else tells which: the finding names both, and nothing is applied."""
    blind = replace(phone, mag=None, base_pose=None)
    diagnosis = examine(with_truth(blind, CONVENTIONS["ned"][0]))
    (finding,) = [one for one in diagnosis.findings if one.severity == "error"]
    assert finding.code == "truth-world-frame"
    assert "accelerometer" in finding.message
    assert diagnosis.remedies == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    "turn",
    [
        pytest.param(QUARTER_X, id="quarter"),
        pytest.param(Rotation.from_rotvec(np.deg2rad([20.0, -30.0, 15.0])), id="39 deg"),
    ],
)
def test_an_imu_turned_against_the_truths_body_is_no_fault(phone, turn):
    diagnosis = examine(turn_imu(phone, turn))
    assert diagnosis.clean
    (finding,) = [one for one in diagnosis.findings if one.code == "mounting"]
    assert finding.values["angle_deg"] == pytest.approx(np.rad2deg(turn.magnitude()), abs=1.0)
    assert "--align heading+mounting" in finding.message


@pytest.mark.slow
@pytest.mark.parametrize("held", ["last", "identity"])
def test_a_held_truth_is_found_and_dropped(phone, held):
    def hold(q):
        q[1000:1500] = [1, 0, 0, 0] if held == "identity" else q[1000]
        return q

    planted = with_truth(phone, hold)
    diagnosis = examine(planted)
    assert diagnosis.codes("error", "warning") == ("truth-frozen",)
    mended = apply(planted, diagnosis.remedies)
    gone = np.setdiff1d(phone.truth.t_ns, mended.truth.t_ns)
    np.testing.assert_array_equal(gone, phone.truth.t_ns[1000:1500])
    require_untouched(phone, mended)


@pytest.mark.slow
def test_a_truth_of_another_body_is_dropped_when_the_sensors_agree(phone):
    other = cut(simulate("phone-3", seed=7, minutes=1.9, rate_hz=50.0), 50, 90).truth
    n = min(len(other.t_ns), len(phone.truth.t_ns))
    planted = replace(phone, truth=Truth(phone.truth.t_ns[:n], other.q_nb[:n], phone.truth.moving[:n]))
    diagnosis = examine(planted)
    assert diagnosis.codes("error", "warning") == ("truth-mismatch",)
    mended = apply(planted, diagnosis.remedies)
    assert mended.truth is None
    require_untouched(phone, mended)


@pytest.mark.slow
def test_odometry_that_slips_is_named(phone):
    """A heading that jumps by 23 and 34 deg, as of wheels that slip twice; every other second fits."""

    def slip(q):
        heading = np.zeros(len(q))
        heading[1200:], heading[1600:] = 0.4, 1.0
        return quaternion(Rotation.from_rotvec(heading[:, None] * [0.0, 0.0, 1.0]) * rotation(q))

    diagnosis = examine(with_truth(phone, slip))
    (finding,) = [one for one in diagnosis.findings if one.severity != "fact"]
    assert finding.code == "truth-is-odometry"
    assert finding.remedy is None
    assert finding.values["worst_deg"] == pytest.approx(34, abs=2)


@pytest.mark.slow
def test_odometry_is_named_when_the_source_says_so(phone):
    noted = replace(phone, info=replace(phone.info, notes=("truth: /odom is odometry, which drifts",)))
    assert examine(noted).codes("error", "warning") == ("truth-is-odometry",)


@pytest.mark.slow
@pytest.mark.parametrize("fixes", [True, False])
def test_a_southern_field_points_up_and_nothing_is_inverted(phone, fixes):
    """Turned upside down about east, gravity and field together are those of the southern hemisphere."""
    south = replace(phone, mag=replace(phone.mag, mag_b_ut=southern_field(phone)), base_pose=None, truth=None)
    place = (-18.0, 30.0, 1400.0) if fixes else None
    diagnosis = examine(replace(south, info=replace(south.info, place_lat_lon_alt=place)))
    assert diagnosis.remedies == ()
    assert diagnosis.codes("error") == ()
    assert diagnosis.codes("warning") == (() if fixes else ("gravity-inverted",))


def southern_field(recording: Recording) -> np.ndarray:
    """The magnetometer where the field's vertical part points up: that part is turned over in n."""
    truth, mag = recording.truth, recording.mag
    at = np.clip(np.searchsorted(truth.t_ns, mag.t_ns), 0, len(truth.t_ns) - 1)
    q = rotation(truth.q_nb[at].copy())
    field_n = q.apply(mag.mag_b_ut.copy())
    return q.inv().apply(field_n * [1.0, 1.0, -1.0])


@pytest.mark.slow
def test_a_dip_that_differs_between_rests_is_no_question_of_a_sign(phone):
    """-49 deg in one rest and +76 deg in the other: no sign mends that, so nothing is inverted."""
    imu, mag = phone.imu, phone.mag
    rests = find_rests(imu)
    assert len(rests) >= 2
    field = mag.mag_b_ut.copy()
    for (first, last), dip_deg in zip(rests[:2], (-49.0, 76.0), strict=True):
        up_b = imu.accel_b_mps2[(imu.t_ns >= first) & (imu.t_ns <= last)].mean(axis=0)
        up_b = up_b / np.linalg.norm(up_b)
        level = np.cross(up_b, [0.3, 0.5, 0.8])
        level = level / np.linalg.norm(level)
        still = (mag.t_ns >= first) & (mag.t_ns <= last)
        dip = np.deg2rad(dip_deg)
        field[still] = 49.0 * (np.cos(dip) * level - np.sin(dip) * up_b)
    diagnosis = examine(replace(phone, mag=replace(mag, mag_b_ut=field), truth=None))
    assert "field-dip" in diagnosis.codes("warning")
    assert not {"gravity-inverted", "mag-inverted"} & set(diagnosis.codes())
    assert not [remedy for remedy in diagnosis.remedies if remedy.kind == "matrix"]
