"""``python -m stillpoint.scripts.pages.planted FILES...``: print how references of changed copies are wrong.

Each copy of a recording with truth has something planted in it: a turned return, magnets, noise, a slow rate, a raw
gyro. docs/accuracy.md holds the table. An answer must lie within its covariance, or be refused.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import mean

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation, slerp
from stillpoint.datasets.mcap.store import read_recording
from stillpoint.datasets.recording import Floats, Imu, Mag, Recording, Times, Truth
from stillpoint.datasets.simulate.scenes import let_field_wander
from stillpoint.scoring import score
from stillpoint.scoring.score import Score
from stillpoint.scripts.program import run_program
from stillpoint.scripts.shared.flags import LOCAL
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.smoother import attitude_reference

_RAMP_S = 2.0  # over which a return is turned before a rest, and turned back after it
_RAW = np.diag([1.08, 0.94, 1.05])  # scales of a raw gyro
_SEED = 7
_SCORED_HZ = 50.0


def turn_last_return(recording: Recording, angle_deg: float) -> Recording:
    """Return the recording with the body turned about up by an angle in its last rest, as if put back turned."""
    imu, truth = recording.require_imu(), _require_truth(recording)
    resting = np.flatnonzero(~truth.moving)
    if not len(resting):
        raise StillpointError(f"{recording.name}: has no rest to turn; choose a recording with returns")
    first = resting[-1] - int(np.argmin(~truth.moving[: resting[-1] + 1][::-1])) + 1
    start_ns = truth.t_ns[first]

    def compute_angle_rad(t_ns: Times) -> Floats:
        """Return the planted angle (N,) about up at stamps (N,): a ramp before the rest, then constant."""
        share = np.clip((t_ns - start_ns) / 1e9 / _RAMP_S + 1, 0, 1)
        return np.asarray(np.deg2rad(angle_deg) * share)

    def turn_body(t_ns: Times, vector_b: Floats) -> Floats:
        """Return vectors (N, 3) of n as the turned body measures them."""
        q_nb = _find_attitude(truth, t_ns)
        about_up = heading_rotation(compute_angle_rad(t_ns))
        return np.asarray((q_nb.inv() * about_up.inv() * q_nb).apply(np.array(vector_b)))

    up_b = _find_attitude(truth, imu.t_ns).as_matrix()[:, 2]
    rate = np.gradient(compute_angle_rad(imu.t_ns), imu.t_ns / 1e9)
    gyro = imu.gyro_b_radps + rate[:, None] * up_b
    mag = recording.mag and Mag(recording.mag.t_ns, turn_body(recording.mag.t_ns, recording.mag.mag_b_ut))
    q_nb = quaternion(heading_rotation(compute_angle_rad(truth.t_ns)) * rotation(truth.q_nb))
    return replace(
        recording,
        imu=Imu(imu.t_ns, gyro, turn_body(imu.t_ns, imu.accel_b_mps2)),
        mag=mag,
        truth=replace(truth, q_nb=q_nb),
    )


def _add_passing_magnets(recording: Recording, size_ut: float) -> Recording:
    """Return the recording with a field that stands in n for 3 s out of 15, from changing sides."""
    mag, truth = _require_mag(recording), _require_truth(recording)
    t_s = (mag.t_ns - mag.t_ns[0]) / 1e9
    number = np.floor(t_s / 15)
    strength = size_ut * np.exp(-(((t_s - 15 * number - 7.5) / 1.5) ** 2))
    side = np.stack([np.cos(2.4 * number), np.sin(2.4 * number), 0.3 + 0 * t_s], axis=1)
    field_b = _find_attitude(truth, mag.t_ns).inv().apply(strength[:, None] * side)
    return replace(recording, mag=Mag(mag.t_ns, mag.mag_b_ut + field_b))


def _put_iron_on(recording: Recording, iron_b_ut: Sequence[float]) -> Recording:
    """Return the recording with iron on the body in its second third."""
    mag = _require_mag(recording)
    share = (mag.t_ns - mag.t_ns[0]) / (mag.t_ns[-1] - mag.t_ns[0])
    there = (share > 1 / 3) & (share < 2 / 3)
    return replace(recording, mag=Mag(mag.t_ns, mag.mag_b_ut + there[:, None] * np.asarray(iron_b_ut)))


def _wander_without_rest(recording: Recording, sd_ut: float, time_s: float) -> Recording:
    """Return the middle 60 s of the recording in a field that wanders."""
    return _keep_middle(let_field_wander(recording, sd_ut, time_s, _SEED), 60.0)


def _keep_middle(recording: Recording, seconds: float) -> Recording:
    """Return the middle of the recording, without the rests at its ends."""
    imu = recording.require_imu()
    middle_ns, half_ns = (imu.t_ns[0] + imu.t_ns[-1]) // 2, round(seconds * 5e8)
    kept = np.abs(imu.t_ns - middle_ns) <= half_ns
    return replace(recording, imu=Imu(imu.t_ns[kept], imu.gyro_b_radps[kept], imu.accel_b_mps2[kept]))


def _cut_gaps(recording: Recording, length_s: float) -> Recording:
    """Return the recording with a gap of the IMU every 20 s."""
    imu = recording.require_imu()
    kept = ((imu.t_ns - imu.t_ns[0]) / 1e9 + 10) % 20 > length_s
    return replace(recording, imu=Imu(imu.t_ns[kept], imu.gyro_b_radps[kept], imu.accel_b_mps2[kept]))


def _slow_down(recording: Recording, rate_hz: float, averaged: bool) -> Recording:
    """Return the recording at a lower rate: means of blocks, or the last sample of each."""
    imu = recording.require_imu()
    per = max(1, round(1e9 / rate_hz / float(np.median(np.diff(imu.t_ns)))))
    n = len(imu.t_ns) // per * per
    blocks = [each[:n].reshape(-1, per, 3) for each in (imu.gyro_b_radps, imu.accel_b_mps2)]
    kept = [block.mean(axis=1) if averaged else block[:, -1] for block in blocks]
    return replace(recording, imu=Imu(imu.t_ns[:n].reshape(-1, per)[:, -1], *kept))


def _add_noise(recording: Recording, gyro_radps: float, accel_mps2: float) -> Recording:
    """Return the recording with white noise on each sample."""
    imu = recording.require_imu()
    gyro, accel = np.random.default_rng(_SEED).standard_normal((2, len(imu.t_ns), 3))
    return replace(
        recording, imu=Imu(imu.t_ns, imu.gyro_b_radps + gyro_radps * gyro, imu.accel_b_mps2 + accel_mps2 * accel)
    )


def make_raw(recording: Recording) -> Recording:
    """Return the recording with the scales of a gyro that nobody calibrated."""
    imu = recording.require_imu()
    return replace(recording, imu=Imu(imu.t_ns, imu.gyro_b_radps @ _RAW, imu.accel_b_mps2))


_PLANTED: dict[str, Callable[[Recording], Recording]] = {
    "nothing": lambda recording: recording,
    "last return turned by 0.5 deg": partial(turn_last_return, angle_deg=0.5),
    "last return turned by 1.5 deg": partial(turn_last_return, angle_deg=1.5),
    "last return turned by 2.5 deg": partial(turn_last_return, angle_deg=2.5),
    "last return turned by 5 deg": partial(turn_last_return, angle_deg=5.0),
    "magnets of 30 uT pass": partial(_add_passing_magnets, size_ut=30.0),
    "iron of 20 uT on for a third": partial(_put_iron_on, iron_b_ut=(15.0, -10.0, 8.0)),
    "field wanders by 3 uT over 4 s": partial(let_field_wander, sd_ut=3.0, time_s=4.0, seed=_SEED),
    **{
        f"{sd_ut:g} uT over {time_s:g} s": partial(let_field_wander, sd_ut=sd_ut, time_s=time_s, seed=_SEED)
        for sd_ut, times_s in ((5.0, (1.0, 4.0, 15.0, 30.0)), (10.0, (1.0, 4.0, 15.0)), (20.0, (4.0,)))
        for time_s in times_s
    },
    **{
        f"the middle 60 s, {sd_ut:g} uT over {time_s:g} s": partial(_wander_without_rest, sd_ut=sd_ut, time_s=time_s)
        for sd_ut, time_s in ((5.0, 4.0), (5.0, 15.0), (10.0, 4.0))
    },
    "the middle 40 s": partial(_keep_middle, seconds=40.0),
    "a gap of 0.3 s every 20 s": partial(_cut_gaps, length_s=0.3),
    "48 Hz, averaged": partial(_slow_down, rate_hz=48.0, averaged=True),
    "24 Hz, averaged": partial(_slow_down, rate_hz=24.0, averaged=True),
    "48 Hz, samples dropped": partial(_slow_down, rate_hz=48.0, averaged=False),
    "24 Hz, samples dropped": partial(_slow_down, rate_hz=24.0, averaged=False),
    "white noise, 1 deg/s and 0.3 m/s^2": partial(_add_noise, gyro_radps=np.deg2rad(1.0), accel_mps2=0.3),
    "gyro 5 to 8 % off": make_raw,
}


def main(*files: Path) -> None:
    """Print one row for each kind of copy. Raises :class:`BadParameter` without a file."""
    if not files:
        raise BadParameter("planted: name recordings with truth")
    print(
        "| planted | mean total, deg | worst | mean in 95 % | least | warned | refused |\n|---|---|---|---|---|---|---|"
    )
    for name in _PLANTED:
        outcomes = run_jobs(partial(_score_copy, name=name), files, LOCAL, name)
        found = [outcome.value for outcome in outcomes if outcome.value is not None]
        totals, inside = [one.total_rmse_deg for one, _ in found], [one.coverage95 or 0.0 for one, _ in found]
        figures = (mean(totals), max(totals), mean(inside), min(inside)) if found else ()
        cells = [f"{figure:.2f}" for figure in figures] or ["–"] * 4
        counts = f"{sum(warned for _, warned in found)} | {len(files) - len(found)}"
        print(f"| {name} | {' | '.join(cells)} | {counts} |", flush=True)


def _score_copy(path: Path, name: str) -> tuple[Score, bool]:
    """Return the score of the reference of a copy, and whether it says that the field is disturbed."""
    changed = _PLANTED[name](read_recording(path))
    made = attitude_reference(changed)
    warned = "field_disturbed" in made.diagnostics or "magnetometer_left_out" in made.diagnostics
    return score(made, _thin_out(_require_truth(changed)), "heading+mounting+time"), warned


def _thin_out(truth: Truth) -> Truth:
    """Return the truth at about _SCORED_HZ, over which the figures are the same and sooner made."""
    step_s = float(np.median(np.diff(truth.t_ns))) / 1e9
    every = slice(None, None, max(1, round(1 / _SCORED_HZ / step_s)))
    return Truth(truth.t_ns[every], truth.q_nb[every], truth.moving[every])


def _find_attitude(truth: Truth, t_ns: Times) -> Rotation:
    """Return the true attitudes at stamps; before and after the truth those of its ends."""
    return rotation(slerp(truth.t_ns, truth.q_nb, np.clip(t_ns, truth.t_ns[0], truth.t_ns[-1])))


def _require_truth(recording: Recording) -> Truth:
    if recording.truth is None:
        raise StillpointError(f"{recording.name}: has no independent truth; choose a recording with one")
    return recording.truth


def _require_mag(recording: Recording) -> Mag:
    if recording.mag is None:
        raise StillpointError(f"{recording.name}: has no magnetometer; choose a recording with one")
    return recording.mag


if __name__ == "__main__":
    run_program(main)
