"""Are the Kalman filters as wrong as they say? NIS and NEES over 50 seeds of matched noise, against chi-square."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from matched import PARAMS, RATE_HZ, columns, matched, run
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats

SEEDS = 50
draw_matched = cache(matched)  # the same recordings for every filter
SECONDS = 40.0
SETTLED = 500  # samples: the first tilt and heading are told by one sample each, whose error the model only bounds


class Runs(NamedTuple):
    """Of all seeds."""

    innovations: Floats  # (k, 3) after the beginning
    attitude_nees: Floats  # (50,) at the end
    bias_nees: Floats
    attitude_trace: Floats  # (50,) of the covariance at the end


@cache
def runs(name: str) -> Runs:
    found = []
    for seed in range(SEEDS):
        recording, true, bias = draw_matched(seed, SECONDS)
        track, state = run(name, columns(recording), PARAMS)
        d = (rotation(track.q_nb[-1]).inv() * true[-1]).as_rotvec()
        off = bias[-1] - track.gyro_bias_b_radps[-1]
        cov_b, p = track.cov_b_rad2[-1].reshape(3, 3), getattr(state, "body", state).p
        assert np.linalg.norm(d) < np.deg2rad(3)
        found.append(
            (
                track.innovation[SETTLED:],
                d @ np.linalg.solve(cov_b, d),
                off @ np.linalg.solve(p[3:6, 3:6], off),
                np.trace(cov_b),
            )
        )
    innovations = np.concatenate([each[0] for each in found])
    return Runs(
        innovations[np.isfinite(innovations).all(axis=1)], *(np.array([each[k] for each in found]) for k in (1, 2, 3))
    )


def inside(total: float, degrees: int) -> bool:
    """Whether a sum of so many squares lies in its 95 % band."""
    low, high = chi2.ppf([0.025, 0.975], degrees)
    return bool(low < total < high)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf", "iekf"])
def test_innovations_have_the_variance_that_is_expected_of_them(name: str) -> None:
    seen = runs(name).innovations
    assert len(seen) > SEEDS * 100
    assert inside(np.sum(seen**2), seen.size)
    # Whitened: of two that are independent the correlation has an sd of 1 / sqrt(k).
    assert np.abs(np.corrcoef(seen.T) - np.eye(3)).max() < 3 / np.sqrt(len(seen))
    # Those of the velocity are all new information. A heading's contains the tilt's error, which it may not move.
    lagged = np.mean(seen[1:, :2] * seen[:-1, :2], axis=0)
    assert np.abs(lagged).max() < 3 / np.sqrt(len(seen))


@pytest.mark.parametrize("name", ["ekf", "iekf"])
def test_attitudes_and_biases_are_as_wrong_as_their_covariance_says(name: str) -> None:
    assert inside(runs(name).attitude_nees.sum(), 3 * SEEDS)
    assert inside(runs(name).bias_nees.sum(), 3 * SEEDS)


def test_on_matched_noise_the_adaptive_one_hardly_acts() -> None:
    """The mean of 10 squares of a normal exceeds 2 in 3 of 100 windows; only then does alpha exceed 1."""
    adaptive, plain = runs("aekf"), runs("ekf")
    assert 1.0 <= np.median(adaptive.attitude_trace / plain.attitude_trace) < 1.05
    assert inside(adaptive.attitude_nees.sum(), 3 * SEEDS)
    assert inside(adaptive.bias_nees.sum(), 3 * SEEDS)


@pytest.mark.parametrize("name", ["ekf", "aekf", "iekf"])
def test_a_turn_that_the_gyro_hid_leaves_attitude_and_bias_as_wrong_as_they_say(name: str) -> None:
    """43 deg are lost in half a second. 29 s later it is as if they had not been, if the filter was told of them."""
    nees = {told: np.zeros(2) for told in (True, False)}
    for seed in range(12):
        recording, true, bias = draw_matched(seed, SECONDS)
        log = columns(recording)
        t_s = np.arange(len(log.dt_s)) / RATE_HZ
        lost_b_radps = ((t_s >= 10) & (t_s < 10.5))[:, None] * np.roll([1.5, 0.0, 0.0], seed)
        log = log._replace(gyro_b_radps=log.gyro_b_radps - lost_b_radps)
        for told, sums in nees.items():
            hidden = (2.0 / 1.5 if told else 0.0) * lost_b_radps
            track, state = run(name, log._replace(hidden_b_radps=hidden), PARAMS)
            d = (rotation(track.q_nb[-1]).inv() * true[-1]).as_rotvec()
            off, p = bias[-1] - track.gyro_bias_b_radps[-1], getattr(state, "body", state).p
            sums += d @ np.linalg.solve(track.cov_b_rad2[-1].reshape(3, 3), d), off @ np.linalg.solve(p[3:6, 3:6], off)
    assert (nees[True] < chi2.ppf(0.975, 3 * 12)).all()
    assert (nees[False] > 5 * chi2.ppf(0.975, 3 * 12)).all()


@pytest.mark.parametrize("name", ["ekf", "aekf", "iekf"])
@pytest.mark.parametrize("lost_deg", [43.0, 86.0])
def test_a_large_turn_is_found_again_within_three_seconds_and_no_sooner_believed(name: str, lost_deg: float) -> None:
    """One linear update of 86 deg is off by several degrees; taken at its word, NEES was 30 to 50 times as expected."""
    squares, seeds = np.zeros(3), 12
    for seed in range(seeds):
        recording, true, _ = draw_matched(seed, 14.0)
        log = columns(recording)
        t_s = np.arange(len(log.dt_s)) / RATE_HZ
        lost_b_radps = ((t_s >= 10) & (t_s < 10.5))[:, None] * np.roll([np.deg2rad(lost_deg) * 2, 0.0, 0.0], seed)
        log = log._replace(gyro_b_radps=log.gyro_b_radps - lost_b_radps, hidden_b_radps=lost_b_radps * 4 / 3)
        q_nb, cov_b_rad2 = (run(name, log, PARAMS).track[i] for i in (0, 2))
        for i, at_s in enumerate((11.0, 12.0, 13.5)):
            k = int(at_s * RATE_HZ)
            d = (rotation(q_nb[k]).inv() * true[k]).as_rotvec()
            squares[i] += d @ np.linalg.solve(cov_b_rad2[k].reshape(3, 3), d)
            assert at_s < 13 or np.rad2deg(np.linalg.norm(d)) < 3
    assert (squares < chi2.ppf(0.999, 3 * seeds)).all()


def worst_deg(q_nb: Floats, true: Rotation, begin_s: float, end_s: float) -> float:
    """Largest error in these seconds."""
    part = slice(int(begin_s * RATE_HZ), int(end_s * RATE_HZ))
    return float(np.rad2deg((rotation(q_nb[part]) * true[part].inv()).magnitude().max()))


def test_the_gain_of_the_adaptive_one_has_a_floor() -> None:
    """A wrong rate makes residuals, these enlarge alpha, alpha reduces the gain, and that makes larger residuals."""
    recording, true, _ = draw_matched(4, SECONDS)
    log = columns(recording)
    from_10_s = np.arange(len(log.dt_s)) >= 10 * RATE_HZ
    faulty = log._replace(gyro_b_radps=log.gyro_b_radps + from_10_s[:, None] * np.deg2rad([3.0, 0.0, 0.0]))
    guarded = run("aekf", faulty, PARAMS | {"gate_sd": 3.0})
    assert worst_deg(guarded.track.q_nb, true, 30.0, SECONDS) < 5
    assert np.rad2deg(guarded.track.gyro_bias_b_radps[-1, 0]) > 2.5
