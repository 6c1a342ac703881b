"""Observation, EKF and AEKF of Asghari et al. 2018: by hand, in closed form, and against a plain version."""

from math import sqrt

import numpy as np
import pytest
from spins import CONSTANT, VARIABLE, exact, spoilt

from stillpoint.datasets import BadParameter, Recording
from stillpoint.datasets.recording import Spin
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.spin import BENCH
from stillpoint.filters import estimate
from stillpoint.filters.spin.stream import SpinStream
from stillpoint.scoring.spin import score_roll

T, Q, R = 0.004, 0.5, 80.0
PAPER = {**CONSTANT, "first_rate": "first"}


def bench(f4, f5, dt_s=T) -> Recording:
    t_ns = np.round(np.arange(len(f4)) * dt_s * 1e9).astype(np.int64)
    return Recording("bench", spin=Spin(t_ns, np.column_stack([f4, f5]), np.empty((len(f4), 0)), BENCH))


def plain(f4, f5, mode=None, window=5, over=5, literal=False) -> tuple[list[float], list[float]]:
    """Eqs (12), (13), (15)-(23) one by one, as a student would write them; rate and variance."""
    x = sqrt(-f4[0] / 0.1)
    p = R / (2 * x) ** 2
    rates, variances, squares = [x], [p], []
    for k in range(1, len(f4)):
        x, p = x + T * f5[k - 1] / 0.5, p + (Q if literal else T * T * Q)
        h, e = 2 * x, -f4[k] / 0.1 - x * x
        c = h * p * h + R
        squares.append(e * e)
        alpha = fade = 1.0
        if mode and len(squares) >= window:
            alpha = max(1.0, sum(squares[-window:]) / over / c)
            if mode == "system":
                fade = max(1.0, (alpha * h * p * h + (alpha - 1) * R) / (h * p * h))
        gain = fade / alpha * p * h / c
        x, p = x + gain * e, (1 - gain * h) * fade * p
        rates.append(x)
        variances.append(p)
    return rates, variances


def test_two_steps_of_the_ekf_agree_with_a_calculation_by_hand():
    """F4 = -122.5, -124 and F5 = 1: x0 = 35, P0 = 80 / 70^2; x- = 35.008, P- = P0 + 8e-6; H = 70.016."""
    found = estimate(bench([-122.5, -124.0], [1.0, 0.0]), "roll-ekf", PAPER)
    p = 80 / 4900 + 8e-6
    gain = p * 70.016 / (70.016**2 * p + 80)
    assert found.rate_radps == pytest.approx([35.0, 35.008 + gain * (1240 - 35.008**2)], rel=1e-14)
    assert found.rate_sd_radps[1] ** 2 == pytest.approx((1 - gain * 70.016) * p, rel=1e-12)
    assert found.angle_rad == pytest.approx([0.0, T * found.rate_radps.mean()], rel=1e-14)
    assert found.innovation[1, 0] == pytest.approx((1240 - 35.008**2) / sqrt(70.016**2 * p + 80), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "settings", "keywords"),
    [
        ("roll-ekf", {}, {}),
        ("roll-ekf", {"process_noise": "literal"}, {"literal": True}),
        ("roll-aekf", {"mode": "observation"}, {"mode": "observation"}),
        ("roll-aekf", {"mode": "observation", "mean": "literal"}, {"mode": "observation", "over": 4}),
        (
            "roll-aekf",
            {"mode": "system", "window": 10, "largest_lambda": 1e12},
            {"mode": "system", "window": 10, "over": 10},
        ),
        (
            "roll-aekf",
            {"mode": "system", "process_noise": "literal", "mean": "literal"},
            {"mode": "system", "literal": True, "over": 4},
        ),
    ],
)
def test_the_compiled_filters_are_the_equations(name, settings, keywords):
    spin = simulate("spin-constant", seed=4, sensor="glitch").spin
    f4, f5 = spin.accel_mps2.T
    kept = np.abs(f4) < 156  # saturated samples are not used, which the plain version does not know
    found = estimate(bench(f4[kept], f5[kept]), name, {**PAPER, **settings})
    rates, variances = plain(f4[kept], f5[kept], **keywords)
    assert found.rate_radps == pytest.approx(rates, rel=1e-9)
    assert found.rate_sd_radps**2 == pytest.approx(variances, rel=1e-6)


def test_the_steady_gain_is_that_of_the_riccati_equation():
    """At a constant rate P-^2 / (P- + R / H^2) = T^2 Q has the root below; K H = 0.022 for the paper's constants."""
    found = estimate(bench(np.full(4000, -124.3), np.zeros(4000)), "roll-ekf", CONSTANT)
    q, r = T * T * Q, R / (4 * 1243.0)
    ahead = (q + sqrt(q * q + 4 * q * r)) / 2
    assert found.rate_sd_radps[-1] ** 2 == pytest.approx(ahead - q, rel=1e-9)
    assert (1 - (ahead - q) / ahead) == pytest.approx(0.022, abs=5e-4)


def test_with_q_as_printed_the_ekf_is_the_observation():
    """K H = 0.97 at constant, 0.999 at variable speed: findings on Asghari et al. 2018, table A1."""
    recording = simulate("spin-variable", seed=1, sensor="white")
    literal = score_roll(
        estimate(recording, "roll-ekf", {**VARIABLE, "process_noise": "literal"}), recording.roll_truth
    )
    raw = score_roll(estimate(recording, "roll-obs", VARIABLE), recording.roll_truth)
    assert literal.rate_rmse_degps == pytest.approx(raw.rate_rmse_degps, rel=0.002)


def test_lambda_twice_loses_the_variance_and_is_refused_in_one_line():
    recording = simulate("spin-variable", seed=0, sensor="white")
    settings = {**VARIABLE, "mode": "system", "window": 10}
    with pytest.raises(BadParameter, match=r"variance is not positive at sample \d+ .* fading = once") as refusal:
        estimate(recording, "roll-aekf", {**settings, "fading": "literal", "first_rate": "first"})
    assert "\n" not in str(refusal.value)
    stream = SpinStream("roll-aekf", BENCH, {**settings, "fading": "literal"})
    answers = [
        stream.update(int(t), row) for t, row in zip(recording.spin.t_ns, recording.spin.accel_mps2, strict=True)
    ]
    assert stream.counts["n_variance_not_positive"] > 0
    assert not answers[-1].ready
    assert np.isfinite([answer.rate_radps for answer in answers]).all()


@pytest.mark.parametrize("mode", ["observation", "system"])
@pytest.mark.parametrize("sensor", ["white", "glitch", "adxl345"])
def test_lambda_once_never_loses_it(mode, sensor):
    for process_noise in ("per-step", "literal"):
        recording = simulate("spin-variable", seed=2, sensor=sensor)
        found = estimate(recording, "roll-aekf", {**VARIABLE, "mode": mode, "process_noise": process_noise})
        assert (found.rate_sd_radps > 0).all()
        assert np.isfinite(found.rate_radps).all()


def test_alpha_is_1_until_as_many_innovations_are_there():
    """A glitch among the first four samples after the start finds a plain EKF, one after them does not."""
    for place, same in ((3, True), (40, False)):
        recording = spoilt(lambda accel, place=place: accel.__setitem__((place, 0), accel[place, 0] + 60.0))
        ekf, aekf = (estimate(recording, name, PAPER).rate_radps for name in ("roll-ekf", "roll-aekf"))
        assert (ekf[place] == aekf[place]) == same


@pytest.mark.parametrize("name", ["roll-obs", "roll-ekf", "roll-aekf"])
def test_perfect_sensors_give_the_truth(name):
    """Spin up by 6 rad/s^2 from 10 rad/s: constant angular acceleration, which the filters integrate exactly."""
    recording = exact(lambda t: 10 + 6 * t, lambda t: np.full(len(t), 6.0))
    s = score_roll(estimate(recording, name, CONSTANT), recording.roll_truth)
    assert s.rate_max_degps < 1e-6
    assert s.angle_max_deg < 1e-3  # the truth of the test is a sum over 0.1 ms
