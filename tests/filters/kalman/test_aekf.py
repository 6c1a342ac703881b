"""``aekf`` against ``ekf``: better by a fifth where its adaptation has something to act on, and no worse elsewhere."""

import numpy as np
import pytest
from matched import PARAMS, RATE_HZ, columns, matched, run

from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.scoring import score

SEEDS = range(6)  # with three, the bound on hand-translation was met by 0.5 % only


def find_error_ratio(kind: str) -> float:
    """Return the mean error of ``aekf`` over the seeds, in units of that of ``ekf``."""
    errors = {"aekf": 0.0, "ekf": 0.0}
    for seed in SEEDS:
        recording = simulate(kind, seed, rate_hz=50.0)
        assert recording.truth is not None
        for name in errors:
            errors[name] += score(estimate(recording, name), recording.truth, align="none").total_rmse_deg
    return errors["aekf"] / errors["ekf"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["hand-magnet", "hand-vibration", "hand-bias-steps", "hand-translation"])
def test_a_disturbed_scene_is_better_by_a_fifth(kind: str) -> None:
    assert find_error_ratio(kind) < 0.8


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["hand-calm", "phone-1", "phone-2", "phone-3", "phone-3-shaken"])
def test_no_other_scene_is_worse_by_a_twentieth(kind: str) -> None:
    assert find_error_ratio(kind) < 1.05


def test_a_step_of_the_bias_is_found() -> None:
    """3 deg/s about one axis from 20 s on: the gate holds ``ekf`` back, and its variance is that of a still bias."""
    step, left_radps = np.deg2rad([3.0, 0.0, 0.0]), {"ekf": 0.0, "aekf": 0.0}
    for seed in range(10):
        recording, _, bias = matched(seed, 40.0)
        log = columns(recording)
        late = np.arange(len(log.dt_s)) >= 20 * RATE_HZ
        log = log._replace(gyro_b_radps=log.gyro_b_radps + late[:, None] * step)
        for name in left_radps:
            track = run(name, log, PARAMS | {"gate_sd": 3.0}).track
            errors = track.gyro_bias_b_radps[-100:] - bias[-100:] - step
            left_radps[name] += np.linalg.norm(errors, axis=1).mean()
    assert left_radps["aekf"] < 0.7 * left_radps["ekf"]
