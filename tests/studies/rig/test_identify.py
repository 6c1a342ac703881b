"""Variances from trials with an encoder: what was planted comes back, whatever the encoder adds."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from stillpoint.datasets import BadRecording, write
from stillpoint.datasets.recording import Encoder
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.spin_sensor import CONSTANT, EncoderModel, SpinAccel
from stillpoint.studies.rig.figures import draw_variances
from stillpoint.studies.rig.identify import identify_variances

PERFECT = CONSTANT["perfect"]


def noisy(d4, d5, **changes):
    radial, tangential = (SpinAccel(noise_mps2=variance**0.5) for variance in (d4, d5))
    return replace(PERFECT, name="planted", radial=radial, tangential=tangential, **changes)


def trials(sensor, count=4, kind="spin-constant"):
    return [simulate(kind, seed, sensor=sensor) for seed in range(count)]


@pytest.mark.parametrize("kind", ["spin-constant", "spin-variable"])
@pytest.mark.parametrize(("d4", "d5"), [(0.8, 0.12), (0.05, 3.0)])
def test_planted_variances_come_back(kind, d4, d5):
    """A variance of n samples has a relative sd of sqrt(2/n) = 1.6 %; the mean of four trials 0.8 %."""
    for by_truth in (True, False):
        found = identify_variances(trials(noisy(d4, d5), kind=kind), by_truth)
        assert np.mean([one.radial.variance_m2ps4 for one in found.trials]) == pytest.approx(d4, rel=0.04)
        assert np.mean([one.tangential.variance_m2ps4 for one in found.trials]) == pytest.approx(d5, rel=0.04)
        assert found.d4_m2ps4 == max(one.radial.variance_m2ps4 for one in found.trials)
        assert found.r_rad2ps4 == pytest.approx(found.d4_m2ps4 / 0.1**2)
        assert found.q_rad2ps4 == pytest.approx(found.d5_m2ps4 / 0.5**2)


def test_ten_white_trials_give_the_papers_r_and_q():
    """R = 80 and Q = 0.5 (1/s^2)^2, eqs (29) and (31)."""
    found = identify_variances(trials("white", 10))
    assert found.r_rad2ps4 == pytest.approx(80, rel=0.05)
    assert found.q_rad2ps4 == pytest.approx(0.5, rel=0.06)


@pytest.mark.parametrize("kind", ["spin-constant", "spin-variable"])
def test_the_encoders_noise_is_told_from_the_accelerometers(kind):
    """A timer of 0.5 us adds more to (30) than F5 has: the part is found, and D5 without it comes back.

    Where the rate changes, encoder and F5 both see that; it is no noise of either.
    """
    sensor = noisy(0.8, 0.12, encoder=EncoderModel(timer_s=0.5e-6, latency_s=0.0))
    found = identify_variances(trials(sensor, kind=kind))
    assert found.d5_m2ps4 > 2 * 0.12
    alone = [one.tangential_alone_m2ps4 for one in found.trials]
    assert np.mean(alone) == pytest.approx(0.12, rel=0.08)
    assert found.q_alone_rad2ps4 < 0.6 * found.q_rad2ps4


def angle_alone(recording, counts):
    """The encoder's angle in whole counts, its rate the difference of it, as an import makes it."""
    step = 2 * np.pi / counts
    angle = np.floor(recording.roll_truth.angle_rad / step) * step
    rate = np.diff(angle) / (np.diff(recording.roll_truth.t_ns) / 1e9)
    return replace(recording, encoder=Encoder(recording.roll_truth.t_ns, angle, np.append(rate[0], rate)))


@pytest.mark.parametrize("kind", ["spin-constant", "spin-variable"])
@pytest.mark.parametrize(("counts", "within"), [(1024, 0.2), (4096, 0.04)])
def test_an_encoder_that_gives_counts_alone_tells_them_too(kind, counts, within):
    """Differences of the counts make a D5 of 1000 and more; a parabola over 0.1 to 0.2 s leaves the sensors' own."""
    found = identify_variances([angle_alone(one, counts) for one in trials(noisy(0.8, 0.12), kind=kind)])
    assert np.mean([one.radial.variance_m2ps4 for one in found.trials]) == pytest.approx(0.8, rel=0.04)
    assert np.mean([one.tangential_alone_m2ps4 for one in found.trials]) == pytest.approx(0.12, rel=within)
    assert found.tells_tangential
    assert all(0.05 < one.smoothed_s <= 0.2 for one in found.trials)


@pytest.mark.slow
def test_one_with_few_counts_says_that_it_cannot(call, tmp_path, capsys):
    write(tmp_path / "coarse.mcap", angle_alone(trials(noisy(0.8, 1e-4), 1)[0], 16))
    assert call("spin", "identify", tmp_path, "-o", tmp_path) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "the encoder's noise makes up D5" in text
    assert "tangential_var_m2ps4" not in text
    assert "by F5 alone" not in text


@pytest.mark.slow
def test_trials_whose_noise_cannot_be_one_rigs_are_named(call, tmp_path, capsys):
    for d4, name in ((0.8, "loud"), (0.05, "quiet")):
        write(tmp_path / f"{name}.mcap", replace(simulate("spin-constant", 0, sensor=noisy(d4, 0.12)), name=name))
    assert call("spin", "identify", tmp_path, "-o", tmp_path) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert re.search(
        r"the noise of F4 differs between trials, robust variance 0\.0\d+ \(quiet\) to 0\.\d+ \(loud\)", text
    )
    assert "the noise of F5 differs" not in text


@pytest.mark.parametrize("sensor", ["white", "glitch", "vibration", "adxl345"])
def test_trials_of_one_rig_are_not(sensor):
    found = identify_variances(trials(sensor, 6))
    assert found.find_differing("radial") is None
    assert found.find_differing("tangential") is None


def test_the_picture_of_one_trial_shows_all_its_markers():
    (one,) = identify_variances(trials("white", 1)).trials
    heavy = replace(one, tangential=replace(one.tangential, robust_m2ps4=3 * one.tangential.variance_m2ps4))
    ax = Figure().subplots()
    draw_variances(ax, replace(identify_variances(trials("white", 1)), trials=(heavy,)), "tangential")
    assert ax.get_xlim() == (0.5, 1.5)
    assert ax.get_ylim()[1] > heavy.tangential.robust_m2ps4


def test_glitches_are_counted_and_the_robust_variance_has_none():
    for one in identify_variances(trials(CONSTANT["glitch"], 6)).trials:
        assert one.radial.robust_m2ps4 == pytest.approx(0.13**2, rel=0.1)
        assert one.radial.glitches <= 6
    many = identify_variances(trials(CONSTANT["glitch"], 6))
    assert sum(one.radial.glitches for one in many.trials) >= 4
    assert many.d4_m2ps4 > 10 * 0.13**2


def test_a_bias_is_in_the_mean_and_not_in_the_variance():
    sensor = replace(noisy(0.01, 0.01), radial=SpinAccel(noise_mps2=0.1, offset_mps2=0.5))
    (one,) = identify_variances(trials(sensor, 1)).trials
    assert one.radial.mean_mps2 == pytest.approx(0.5, abs=0.01)
    assert one.radial.variance_m2ps4 == pytest.approx(0.01, rel=0.1)


def test_a_tilted_shaft_shows_in_what_turns_with_it():
    (one,) = identify_variances(trials(replace(noisy(0.01, 0.01), tilt_deg=30.0), 1)).trials
    assert one.radial.once_per_turn_mps2 == pytest.approx(9.80665 / 2, rel=0.01)
    assert one.tangential.once_per_turn_mps2 == pytest.approx(9.80665 / 2, rel=0.01)
    assert one.turning_share > 0.99
    assert one.encoder_m2ps4 < 0.01


def test_lost_and_saturated_samples_are_left_out_and_counted():
    recording = simulate("spin-constant", 0, sensor=noisy(0.8, 0.12))
    accel = recording.spin.accel_mps2.copy()
    accel[100:110, 0], accel[200:205, 1] = -16 * 9.80665, np.nan
    (one,) = identify_variances([replace(recording, spin=replace(recording.spin, accel_mps2=accel))]).trials
    assert (one.samples, one.left_out) == (7500 - 16, 16)
    assert one.radial.variance_m2ps4 == pytest.approx(0.8, rel=0.07)


def test_an_encoder_on_a_clock_of_its_own_does():
    recording = simulate("spin-constant", 3, sensor=noisy(0.8, 0.12))
    faster = simulate("spin-constant", 3, sensor=noisy(0.8, 0.12), rate_hz=1000.0).encoder
    (one,) = identify_variances([replace(recording, encoder=faster)]).trials
    assert one.radial.variance_m2ps4 == pytest.approx(0.8, rel=0.07)
    assert one.tangential.variance_m2ps4 == pytest.approx(0.12, rel=0.07)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: replace(r, encoder=None), "has no encoder to compare with"),
        (
            lambda r: replace(r, spin=replace(r.spin, geometry=replace(r.spin.geometry, fixed_axis=False))),
            "turns freely",
        ),
        (lambda r: replace(r, spin=replace(r.spin, accel_mps2=r.spin.accel_mps2 * np.nan)), "0 samples can be used"),
    ],
)
def test_what_does_not_do_is_refused(change, said):
    with pytest.raises(BadRecording, match=said):
        identify_variances([change(simulate("spin-constant", 0, minutes=0.05))])


def test_trials_of_two_rigs_are_refused():
    one = simulate("spin-constant", 0, minutes=0.05)
    other = replace(one.spin, geometry=replace(one.spin.geometry, accel_r_b_m=2 * one.spin.geometry.accel_r_b_m))
    with pytest.raises(BadRecording, match="has other lever arms"):
        identify_variances([one, replace(one, name="other", spin=other)])


@pytest.mark.slow
def test_the_command_says_it_draws_it_and_writes_it(call, tmp_path, capsys):
    for seed in (0, 1):
        write(tmp_path / f"{seed}.mcap", simulate("spin-constant", seed, minutes=0.1))
    assert call("spin", "identify", tmp_path, "-o", tmp_path / "out") == 0
    text = capsys.readouterr().out
    settings = re.findall(r"--set (roll-guarded\.\S+)", text)
    flags = [part for each in settings for part in ("--set", each)]
    assert len(settings) == 2
    assert call("estimate", tmp_path / "0.mcap", "-e", "roll-guarded", *flags, "-o", tmp_path / "out") == 0
    capsys.readouterr()
    assert (tmp_path / "out" / "spin-identify.png").read_bytes().startswith(b"\x89PNG")
    rows = json.loads((tmp_path / "out" / "spin-identify.json").read_text())["rows"]
    assert [row["recording"] for row in rows][2] == "maximum"
    assert rows[2]["d4_m2ps4"] == max(row["radial"]["variance_m2ps4"] for row in rows[:2])
    assert call("spin", "identify", tmp_path, "-o", tmp_path / "out", "--by-truth", "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["rows"][2]["recording"] == "maximum"
