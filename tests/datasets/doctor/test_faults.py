"""Faults planted in a simulated recording: the doctor names each, and its remedy leaves a recording without it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from quick import mark_slow_except

from stillpoint.datasets import Imu, Mag, Recording, Truth
from stillpoint.datasets.doctor import Diagnosis, apply, diagnose
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.simulate import simulate
from stillpoint.smoother.rest import find_rests

X, Y, Z = np.eye(3)
FLIP_X, FLIP_Y, FLIP_Z = (np.eye(3) - 2 * np.outer(axis, axis) for axis in (X, Y, Z))
SWAP_XY, SWAP_YZ, SWAP_XZ = np.eye(3)[[1, 0, 2]], np.eye(3)[[0, 2, 1]], np.eye(3)[[2, 1, 0]]
TURN_Z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

Change = Callable[[Recording], Recording]


@dataclass(frozen=True)
class Fault:
    """One fault, the finding it must give, and words that its remedy must contain ("" when nothing mends it)."""

    name: str
    plant: Change
    code: str
    remedy: str = ""
    needs_truth: bool = False


def unchecked(recording: Recording, **streams: object) -> Recording:
    return replace(recording, info=replace(recording.info, units_unchecked=True), **streams)


def gyro(change: Callable[[Floats], Floats]) -> Change:
    return lambda r: unchecked(r, imu=replace(r.imu, gyro_b_radps=change(r.imu.gyro_b_radps.copy())))


def accel(change: Callable[[Floats], Floats]) -> Change:
    return lambda r: unchecked(r, imu=replace(r.imu, accel_b_mps2=change(r.imu.accel_b_mps2.copy())))


def mag(change: Callable[[Floats], Floats]) -> Change:
    return lambda r: unchecked(r, mag=replace(r.mag, mag_b_ut=change(r.mag.mag_b_ut.copy())))


def axes(sensor: Callable[[Callable[[Floats], Floats]], Change], matrix: Floats) -> Change:
    return sensor(lambda values: values @ matrix.T)


def times(sensor: Callable[[Callable[[Floats], Floats]], Change], factor: float) -> Change:
    return sensor(lambda values: values * factor)


def chain(*changes: Change) -> Change:
    def plant(recording: Recording) -> Recording:
        for change in changes:
            recording = change(recording)
        return recording

    return plant


def late(stream: str, by_s: float) -> Change:
    """Stamps of the magnetometer or the truth are late by so much."""
    return lambda r: replace(
        r, **{stream: replace(getattr(r, stream), t_ns=getattr(r, stream).t_ns + round(by_s * 1e9))}
    )


def late_in_imu(column: str, by_s: float) -> Change:
    """One sensor of the IMU is late: its value at t is what was true at t - by_s."""

    def plant(r: Recording) -> Recording:
        t_s = (r.imu.t_ns - r.imu.t_ns[0]) / 1e9
        values = getattr(r.imu, column)
        moved = np.stack([np.interp(t_s - by_s, t_s, one) for one in values.T], axis=1)
        return replace(r, imu=replace(r.imu, **{column: moved}))

    return plant


def stamps(stream: str, change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda r: replace(r, **{stream: replace(getattr(r, stream), t_ns=change(getattr(r, stream).t_ns))})


def in_bursts(t_ns: np.ndarray) -> np.ndarray:
    """Receipt in packets of 25, 0.2 ms apart within one."""
    k = np.arange(len(t_ns))
    last = np.minimum(k // 25 * 25 + 24, len(k) - 1)
    return t_ns[last] + (k % 25) * 200_000


def jittered(t_ns: np.ndarray) -> np.ndarray:
    step = np.median(np.diff(t_ns))
    noise = np.random.default_rng(5).uniform(-0.45, 0.45, len(t_ns)) * step
    return t_ns + noise.astype(np.int64)


def rows(r: Recording, keep: np.ndarray) -> Recording:
    imu = r.imu
    return replace(r, imu=Imu(imu.t_ns[keep], imu.gyro_b_radps[keep], imu.accel_b_mps2[keep]))


def gap_of_two_seconds(r: Recording) -> Recording:
    t_s = (r.imu.t_ns - r.imu.t_ns[0]) / 1e9
    return rows(r, (t_s < 0.6 * t_s[-1]) | (t_s > 0.6 * t_s[-1] + 2.0))


def samples_lost(r: Recording) -> Recording:
    return rows(r, np.random.default_rng(6).random(len(r.imu.t_ns)) > 0.05)


def half_time(r: Recording) -> Recording:
    """A logger that took 200 Hz for 100 Hz: all clocks but the truth's run at half the time."""
    start = r.imu.t_ns[0]
    half = {
        name: replace(getattr(r, name), t_ns=start + (getattr(r, name).t_ns - start) // 2) for name in ("imu", "mag")
    }
    return replace(r, **half, truth=None)


def moving(r: Recording) -> int:
    """A sample in the middle of the fastest stretch."""
    speed = np.convolve(np.linalg.norm(r.imu.gyro_b_radps, axis=1), np.ones(300) / 300, mode="same")
    return int(speed[500:-500].argmax()) + 500


def frozen(column: str) -> Change:
    def plant(r: Recording) -> Recording:
        at = moving(r)
        values = getattr(r.imu, column).copy()
        values[at : at + 150] = values[at]
        return replace(r, imu=replace(r.imu, **{column: values}))

    return plant


def mag_frozen(r: Recording) -> Recording:
    at = int(np.searchsorted(r.mag.t_ns, r.imu.t_ns[moving(r)]))
    values = r.mag.mag_b_ut.copy()
    values[at : at + 150] = values[at]
    return replace(r, mag=replace(r.mag, mag_b_ut=values))


def doubled(r: Recording) -> Recording:
    """Every second sample of the IMU repeats the one before, in a stretch of ten seconds of motion."""
    at = moving(r)
    rate = round(1e9 / np.median(np.diff(r.imu.t_ns)))
    span = slice(max(0, at - 5 * rate), at + 5 * rate)
    columns = {}
    for name in ("gyro_b_radps", "accel_b_mps2"):
        values = getattr(r.imu, name).copy()
        part = values[span]
        part[1::2] = part[: len(part) // 2 * 2 : 2][: len(part[1::2])]
        columns[name] = values
    return replace(r, imu=replace(r.imu, **columns))


def mag_held(r: Recording) -> Recording:
    """A magnetometer of a quarter of the rate, written with every sample of the log."""
    return replace(r, mag=replace(r.mag, mag_b_ut=r.mag.mag_b_ut[np.arange(len(r.mag.t_ns)) // 4 * 4]))


def accel_held(r: Recording) -> Recording:
    held = r.imu.accel_b_mps2[np.arange(len(r.imu.t_ns)) // 4 * 4]
    return replace(r, imu=replace(r.imu, accel_b_mps2=held))


def clip(share: float) -> Callable[[Floats], Floats]:
    def change(values: Floats) -> Floats:
        limit = share * np.quantile(np.abs(values), 0.999)
        return np.clip(values, -limit, limit)

    return change


def put(axis: int, value: float) -> Callable[[Floats], Floats]:
    def change(values: Floats) -> Floats:
        values[:, axis] = value
        return values

    return change


def steps_of(step: float) -> Callable[[Floats], Floats]:
    return lambda values: np.round(values / step) * step


def noisy(sd: float) -> Callable[[Floats], Floats]:
    return lambda values: values + np.random.default_rng(7).normal(0, sd, values.shape)


def truth_q(change: Callable[[Floats], Floats]) -> Change:
    return lambda r: replace(
        r, truth=Truth(r.truth.t_ns, change(r.truth.q_nb.copy()), r.truth.moving, r.truth.position_n_m)
    )


def no_overlap(r: Recording) -> Recording:
    return replace(r, mag=Mag(r.mag.t_ns + 10**13, r.mag.mag_b_ut))


G, RAD = 9.80665, np.pi / 180
FAULTS: tuple[Fault, ...] = (
    Fault("gyro in deg/s", times(gyro, 1 / RAD), "gyro-units", "gyro * 0.0174533"),
    Fault("accelerometer in g", times(accel, 1 / G), "accel-units", "accel * 9.80665"),
    Fault("accelerometer in milli-g", times(accel, 1000 / G), "accel-units", "accel * 0.00980665"),
    Fault("magnetometer in gauss", times(mag, 1e-2), "mag-units", "mag * 100"),
    Fault("magnetometer in tesla", times(mag, 1e-6), "mag-units", "mag * 1e+06"),
    Fault("magnetometer in nanotesla", times(mag, 1e3), "mag-units", "mag * 0.001"),
    Fault("gyro x flipped", axes(gyro, FLIP_X), "gyro-axes", "gyro x -> -x"),
    Fault("gyro y flipped", axes(gyro, FLIP_Y), "gyro-axes", "gyro y -> -y"),
    Fault("gyro z flipped", axes(gyro, FLIP_Z), "gyro-axes", "gyro z -> -z"),
    Fault("gyro all flipped", axes(gyro, -np.eye(3)), "gyro-handedness", "gyro x -> -x, gyro y -> -y, gyro z -> -z"),
    Fault("gyro x and y swapped", axes(gyro, SWAP_XY), "gyro-axes", "gyro x -> y, gyro y -> x"),
    Fault("gyro y and z swapped", axes(gyro, SWAP_YZ), "gyro-axes", "gyro y -> z, gyro z -> y"),
    Fault("gyro turned by 90 deg", axes(gyro, TURN_Z), "gyro-axes", "gyro x -> y, gyro y -> -x"),
    Fault("gyro twice too large", times(gyro, 2.0), "gyro-scale", "gyro * 0."),
    Fault("gyro x and y flipped", axes(gyro, FLIP_X @ FLIP_Y), "gyro-axes", "gyro x -> -x, gyro y -> -y"),
    Fault("time base twice too fast", half_time, "gyro-scale", "gyro *"),
    Fault("accelerometer y flipped", axes(accel, FLIP_Y), "accel-axes", "accel y -> -y"),
    Fault("gravity inverted", axes(accel, -np.eye(3)), "gravity-inverted", "accel -> -accel"),
    Fault("accelerometer x and z swapped", axes(accel, SWAP_XZ), "accel-axes", "accel x -> z, accel z -> x"),
    Fault("magnetometer x flipped", axes(mag, FLIP_X), "mag-axes", "mag x -> -x"),
    Fault("magnetometer x and y swapped", axes(mag, SWAP_XY), "mag-axes", "mag x -> y, mag y -> x"),
    Fault("magnetometer all flipped", axes(mag, -np.eye(3)), "mag-inverted", "mag -> -mag"),
    Fault(
        "left-handed axes of all sensors",
        chain(axes(gyro, FLIP_Y), axes(accel, FLIP_Y), axes(mag, FLIP_Y)),
        "gyro-axes",
        "gyro y -> -y",
        needs_truth=True,
    ),
    Fault("gyro in deg/s and x flipped", chain(times(gyro, 1 / RAD), axes(gyro, FLIP_X)), "gyro-axes", "gyro x -> -x"),
    Fault(
        "gyro late by 20 ms",
        late_in_imu("gyro_b_radps", 0.02),
        "gyro-truth-lag",
        "truth shifted by +20",
        needs_truth=True,
    ),
    Fault(
        "accelerometer late by 20 ms",
        late_in_imu("accel_b_mps2", 0.02),
        "accel-gyro-lag",
        "accel shifted by -",
        needs_truth=True,
    ),
    Fault("magnetometer late by 100 ms", late("mag", 0.1), "mag-gyro-lag", "mag shifted by -"),
    Fault("truth late by 30 ms", late("truth", 0.03), "gyro-truth-lag", "truth shifted by -30", needs_truth=True),
    Fault("truth inverted", truth_q(lambda q: q * [1, -1, -1, -1]), "truth-quaternion", "inverse", needs_truth=True),
    Fault(
        "truth as x, y, z, w",
        truth_q(lambda q: np.roll(q, -1, axis=1)),
        "truth-quaternion",
        "w, x, y, z",
        needs_truth=True,
    ),
    Fault("stamps in bursts", stamps("imu", in_bursts), "imu-bursts", "line"),
    Fault("jittered stamps", stamps("imu", jittered), "imu-jitter", "line"),
    Fault("a gap of 2 s", gap_of_two_seconds, "imu-gap"),
    Fault("5 % of the samples lost", samples_lost, "imu-lost"),
    Fault("magnetometer on another clock", no_overlap, "mag-apart"),
    Fault("gyro clipped", gyro(clip(0.6)), "gyro-clipped"),
    Fault("accelerometer clipped", accel(lambda a: np.clip(a, -11.0, 11.0)), "accel-clipped"),
    Fault("gyro y stuck", gyro(put(1, 0.013)), "gyro-stuck"),
    Fault("gyro z missing", gyro(put(2, 0.0)), "gyro-stuck"),
    Fault("accelerometer x missing", accel(put(0, 0.0)), "accel-stuck"),
    Fault("magnetometer y stuck", mag(put(1, 21.0)), "mag-stuck", "dropped"),
    Fault("magnetometer all zero", times(mag, 0.0), "mag-stuck", "dropped"),
    Fault("gyro frozen", frozen("gyro_b_radps"), "gyro-frozen", "frozen samples dropped"),
    Fault("accelerometer frozen", frozen("accel_b_mps2"), "accel-frozen", "frozen samples dropped"),
    Fault("magnetometer frozen", mag_frozen, "mag-frozen", "frozen samples dropped"),
    Fault("doubled samples", doubled, "gyro-held", "first kept"),
    Fault("slow magnetometer, held", mag_held, "mag-held", "first kept"),
    Fault("slow accelerometer, held", accel_held, "accel-held", "interpolated"),
    Fault("hard iron of 60 uT", mag(lambda m: m + np.array([40.0, -30.0, 35.0])), "hard-iron", "mag less hard iron"),
    Fault("gyro bias of 5 deg/s", gyro(lambda w: w + np.array([3.0, -4.0, 0.5]) * RAD), "gyro-bias", "gyro less bias"),
    Fault("noisy accelerometer", accel(noisy(0.5)), "accel-noise"),
    Fault("noisy gyro", gyro(noisy(2 * RAD)), "gyro-noise"),
    Fault("coarse gyro", gyro(steps_of(1 * RAD)), "gyro-coarse"),
    Fault("coarse accelerometer", accel(steps_of(0.2)), "accel-coarse"),
    Fault("coarse magnetometer", mag(steps_of(2.0)), "mag-coarse"),
    Fault("accelerometer scale 8 %", times(accel, 1.08), "gravity-size"),
)


def examine(recording: Recording) -> Diagnosis:
    return diagnose(recording, find_rests(recording.imu))


def test_a_clean_recording_has_no_findings(phone: Recording) -> None:
    assert examine(phone).clean
    assert examine(replace(phone, truth=None, base_pose=None)).clean


QUICK = ("gyro x flipped", "stamps in bursts", "gyro clipped")  # of axes, stamps and values


@pytest.mark.parametrize(
    "fault", mark_slow_except(FAULTS, *QUICK, name=lambda fault: fault.name), ids=lambda fault: fault.name
)
def test_a_planted_fault_is_named_and_mended(phone: Recording, fault: Fault) -> None:
    """By the physics of the sensors alone, unless the fault shows against the truth only."""
    planted = fault.plant(phone if fault.needs_truth else replace(phone, truth=None))
    diagnosis = examine(planted)
    assert fault.code in diagnosis.codes("error", "warning")
    remedies = [finding.remedy for finding in diagnosis.findings if finding.code == fault.code and finding.remedy]
    if not fault.remedy:
        assert not remedies
        return
    assert any(fault.remedy in remedy.text for remedy in remedies)
    mended = apply(planted, diagnosis.remedies)
    assert all(any(r.text in line for line in mended.info.conversions) for r in remedies)
    assert fault.code not in examine(mended).codes("error", "warning")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["phone-1", "phone-2"])
@pytest.mark.parametrize("seed", [0, 1])
def test_slow_and_planar_motion_raises_no_alarm(kind: str, seed: int) -> None:
    assert examine(simulate(kind, seed=seed, rate_hz=50.0)).clean
