"""Where the square of the rate tells no rate: no spin, a turned sign, rests, zeros of the rate; refused in one line."""

from dataclasses import replace

import numpy as np
import pytest
from quick import mark_slow_except
from spins import exact, spoilt

from stillpoint.datasets import Unobservable, write
from stillpoint.datasets.simulate import simulate
from stillpoint.smoother import reference
from stillpoint.smoother.spin.params import SpinCalibration, SpinNoise
from stillpoint.smoother.spin.samples import measure_samples
from stillpoint.smoother.spin.zero_rate import find_least_squared, find_stretches


def felt(recording, seed=0, gravity_mps2=0.0):
    """With the noise of a quiet board, and gravity on a tilted axis."""
    rng, spin = np.random.default_rng(seed), recording.spin
    noise = rng.normal(0, 1, spin.accel_mps2.shape) * [0.13, 0.08]
    gravity = gravity_mps2 * np.cos(recording.roll_truth.angle_rad)[:, None]
    return replace(recording, spin=replace(spin, accel_mps2=spin.accel_mps2 + noise + gravity))


def steady(rate_radps, seconds=10.0):
    return exact(lambda t: np.full(len(t), rate_radps), np.zeros_like, seconds)


def spun_up(rest_s, up_s, rate_radps=35.2):
    """At rest, then up smoothly."""

    def part(t):
        return np.clip((t - rest_s) / up_s, 0, 1)

    return exact(
        lambda t: rate_radps * (3 * part(t) ** 2 - 2 * part(t) ** 3),
        lambda t: rate_radps * 6 * (part(t) - part(t) ** 2) / up_s,
        rest_s + up_s + 10,
    )


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda a: a.__setitem__((slice(None), 0), -a[:, 0]), "negative throughout.*turn the sign of the radial"),
        (lambda a: a.fill(0.0), "no spin can be seen"),
        (lambda a: a.__setitem__((slice(None), 0), 0.0), "no spin can be seen"),
        (lambda a: a.__setitem__(slice(None), np.random.default_rng(0).normal(0, 0.1, a.shape)), "no spin"),
        (lambda a: a.__setitem__(slice(None), np.random.default_rng(0).normal(1, 0.1, a.shape)), "no spin"),
        pytest.param(
            lambda a: a.__setitem__(slice(3000, 7000), 0.0),
            "between 12.00 and 28.00 s the spin rests",
            marks=pytest.mark.slow,
        ),
    ],
    ids=["sign", "zeros", "radial zeros", "rest", "rest on a slope", "zeros in between"],
)
def test_what_shows_no_spin_is_refused_by_name(spoil, said):
    with pytest.raises(Unobservable, match=said) as caught:
        reference(spoilt(spoil))
    assert "\n" not in str(caught.value)


def test_the_verb_says_it_in_one_line(call, tmp_path, capsys):
    write(tmp_path / "sign.mcap", spoilt(lambda a: a.__setitem__((slice(None), 0), -a[:, 0])))
    assert call("reference", tmp_path / "sign.mcap", "-o", tmp_path) == 2
    said = capsys.readouterr().err
    assert "turn the sign" in said
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("rest_s", "up_s", "seed"),
    [
        (1, 2, 1),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((5, 0.2, 0), (5, 2, 0), (5, 2, 3), (20, 5, 1))),
    ],
)
def test_a_rest_is_refused_with_its_time(rest_s, up_s, seed):
    """There a bias of -x^2 explains a rate of x as well: without the refusal it is off by 80 deg/s of stated sd 12."""
    with pytest.raises(Unobservable, match=r"between 0\.00 and [\d.]+ s the spin rests") as caught:
        reference(felt(spun_up(rest_s, up_s), seed))
    until_s = float(str(caught.value).split(" and ")[1].split(" s ")[0])
    assert rest_s < until_s < rest_s + up_s


@pytest.mark.slow
@pytest.mark.parametrize("tilt_deg", [5, 30, 90])
def test_a_rest_on_a_tilted_axis_is_refused_too(tilt_deg):
    with pytest.raises(Unobservable, match="the spin rests"):
        reference(felt(spun_up(5, 2), gravity_mps2=9.80665 * np.sin(np.deg2rad(tilt_deg))))


def test_a_rate_through_zero_is_refused():
    recording = exact(lambda t: 30 * np.cos(t), lambda t: -30 * np.sin(t), 6.0)
    with pytest.raises(Unobservable, match="passes through zero or is slower than 199 deg/s"):
        reference(felt(recording))


@pytest.mark.slow
@pytest.mark.parametrize("recording", [spun_up(5, 2), exact(lambda t: 30 * np.cos(t), lambda t: -30 * np.sin(t), 6.0)])
def test_an_encoder_tells_what_the_square_does_not(recording):
    made = reference(replace(felt(recording), encoder=recording.roll_truth), params={"encoder.use": True})
    assert (np.abs(made.rate_radps - recording.roll_truth.rate_radps) < 5 * made.rate_sd_radps).all()


def test_a_slow_spin_is_no_spin_until_the_bias_is_known_well_enough():
    """115 deg/s is 4 rad^2/s^2, and a bias of 0.4 m/s^2 makes 4; one of 0.01 makes 0.1."""
    recording = felt(steady(2.0))
    with pytest.raises(Unobservable, match="record a spin above 199 deg/s"):
        reference(recording)
    made = reference(recording, params={"calibration.accel_bias_sd_mps2": 0.01})
    error = made.rate_radps - 2.0
    assert (np.abs(error) < 4 * made.rate_sd_radps).all()
    assert np.median(made.rate_sd_radps) == pytest.approx(0.1 / 4, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(("rate_radps", "tilt_deg"), [(2.0, 30), (4.0, 90)])
def test_a_spin_too_slow_beside_gravity_is_refused(rate_radps, tilt_deg):
    """Without the refusal off by 270 and 300 deg/s, of stated sd 4."""
    with pytest.raises(Unobservable, match="tells no rate there"):
        reference(felt(steady(rate_radps, 20.0), gravity_mps2=9.80665 * np.sin(np.deg2rad(tilt_deg))))


@pytest.mark.slow
@pytest.mark.parametrize(("rate_radps", "tilt_deg"), [(4.0, 0), (8.0, 90)])
def test_a_spin_above_the_limit_is_made_within_its_sd(rate_radps, tilt_deg):
    recording = felt(steady(rate_radps, 20.0), gravity_mps2=9.80665 * np.sin(np.deg2rad(tilt_deg)))
    made = reference(recording)
    assert (np.abs(made.rate_radps - rate_radps) < 4 * made.rate_sd_radps).all()


def turned_back(rate_radps, accel_radps2, before_s=5.0):
    """Steady, then through zero at a constant angular acceleration, then as fast the other way."""
    turn_s = 2 * rate_radps / accel_radps2
    return exact(
        lambda t: rate_radps - accel_radps2 * np.clip(t - before_s, 0, turn_s),
        lambda t: -accel_radps2 * ((t >= before_s) & (t < before_s + turn_s)).astype(float),
        before_s + turn_s + 5,
    )


@pytest.mark.parametrize("rate_radps", mark_slow_except([10.0, 20.0], "20.0"))
def test_a_turn_too_fast_to_be_slow_for_long_is_seen_by_the_acceleration(rate_radps):
    """At 300 rad/s^2 it is below the limit for six samples; the rate was made 2300 deg/s off, of stated sd 6."""
    with pytest.raises(Unobservable, match=r"differ by \d+ deg/s|tells no rate there") as caught:
        reference(felt(turned_back(rate_radps, 300.0)))
    assert "between 5.0" in str(caught.value)


def test_the_limit_is_three_sd_of_bias_and_noise():
    recording = simulate("spin-constant", seed=0, sensor="white", minutes=0.1)
    samples = measure_samples(recording, SpinNoise(source="given", squared_sd_rad2ps2=9.0))
    least = find_least_squared(samples, SpinCalibration(accel_bias_sd_mps2=0.4))
    assert least == pytest.approx(3 * np.hypot(4.0, 9.0 * np.sqrt(np.pi / 50)), rel=1e-9)


def test_stretches_that_are_near_are_one():
    t_s = np.arange(10.0) / 2
    wanted = np.array([1, 0, 1, 0, 0, 0, 1, 1, 0, 0], dtype=bool)
    assert find_stretches(t_s, wanted) == [(0.0, 1.0), (3.0, 3.5)]
