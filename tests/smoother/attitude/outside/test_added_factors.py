"""Factors of a user: the example of docs/own_factors.md, what it adds, and what is refused or named."""

import re
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C, H, V, X

from stillpoint.datasets import BadParameter, Unobservable, write
from stillpoint.datasets.simulate import simulate
from stillpoint.scoring import score
from stillpoint.smoother import reference
from stillpoint.smoother.attitude.outside.vehicle import drop_rests_in_curves
from stillpoint.smoother.attitude.params import HANDHELD, PRESETS
from stillpoint.smoother.rest import find_rests

PAGE = Path(__file__).parents[4] / "docs" / "own_factors.md"
UNIT3 = gtsam.noiseModel.Unit.Create(3)


def example():
    """The code of the page, without its last lines, which read a file."""
    (code,) = re.findall(r"```python\n(from collections.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    names = {}
    exec(code.partition("\nrecording = read")[0], names)
    return names["wheel_factors"]


@pytest.fixture(scope="module")
def blind():
    """A car with a wheel speed, and neither satellites nor magnetometer."""
    return replace(simulate("car", seed=2, minutes=2.0, rate_hz=50), gps=None, mag=None)


@pytest.fixture(scope="module")
def driven(blind):
    return reference(blind, params=PRESETS["vehicle"], factors=[example()])


@pytest.mark.slow
def test_the_example_makes_a_reference_where_there_was_none(blind, driven):
    """Without the wheel speed such a recording is refused; with it, acceleration is told from gravity."""
    found = score(driven, blind.truth)
    assert found.inclination_rmse_deg < 0.5
    assert found.coverage95 > 0.9
    assert 0 < driven.diagnostics["residuals"]["added wheel_factors"] < 1
    assert driven.diagnostics["contradicting_factors"] == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4])
def test_curves_driven_evenly_are_not_taken_for_rests(seed):
    """Two seconds in a curve of 6 and 8 deg/s looked like a rest, whose mean rate was taken for the gyro's bias."""
    drive = replace(simulate("car", seed=seed, minutes=2.0, rate_hz=50), gps=None, mag=None)
    assert len(find_rests(drive.imu)) == 1
    made = reference(drive, params=PRESETS["vehicle"], factors=[example()])
    assert len(made.rests_ns) == 0
    assert made.diagnostics["n_rests_under_way"] == 1
    assert score(made, drive.truth).inclination_rmse_deg < 0.5


def test_a_car_that_stands_is_at_rest():
    """Twelve seconds at a light, with the gyro's bias of 1 deg/s as mean rate."""
    imu = simulate("car", seed=8, minutes=2.0, rate_hz=50).imu
    rests_ns = find_rests(imu)
    assert len(rests_ns) == 1
    np.testing.assert_array_equal(drop_rests_in_curves(rests_ns, imu, HANDHELD.rest.bias_change_radps), rests_ns)


@pytest.mark.slow
def test_the_example_of_the_page_runs_from_a_file(tmp_path, monkeypatch, blind, capsys):
    write(tmp_path / "drive.mcap", blind)
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(from collections.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    exec(code, {})
    assert 0 < float(capsys.readouterr().out) < 1


@pytest.mark.slow
def test_a_wheel_speed_in_wrong_units_is_named():
    """km/h taken for m/s, 3.6 times too fast, beside satellites that know better."""
    drive = replace(simulate("car", seed=1, minutes=1.5, rate_hz=50), mag=None)
    wheel = drive.extra["wheel"]
    wrong = replace(drive, extra={"wheel": replace(wheel, values=3.6 * wheel.values)})
    with pytest.raises(Unobservable, match="the added factors of wheel_factors contradict the rest"):
        reference(wrong, factors=[example()])


@pytest.mark.slow
def test_added_factors_that_contradict_a_little_are_named_in_the_residuals(blind):
    """A place at which the car never was, held so loosely that the reference is made all the same."""

    def two_places(states, recording):
        for east_m in (-50.0, 50.0):
            yield gtsam.GPSFactor(X(0), np.array([east_m, 0.0, 0.0]), gtsam.noiseModel.Isotropic.Sigma(3, 10.0))

    made = reference(blind, params=PRESETS["vehicle"], factors=[example(), two_places])
    assert made.diagnostics["residuals"]["added two_places"] == pytest.approx(25.0 / 3, rel=0.1)
    assert made.diagnostics["contradicting_factors"] == ["added two_places"]


@pytest.mark.slow
def test_a_known_turn_is_kept(blind):
    """A factor between states far apart, as a turntable gives it."""

    def turned_back(states, recording):
        last = len(states.t_ns) - 1
        yield gtsam.BetweenFactorPose3(
            X(0), X(last), gtsam.Pose3(), gtsam.noiseModel.Diagonal.Sigmas([1e-3] * 3 + [1e4] * 3)
        )

    made = reference(blind, params=PRESETS["vehicle"], factors=[example(), turned_back])
    ends = [gtsam.Rot3.Quaternion(*q) for q in made.q_nb[[0, -1]]]
    assert np.linalg.norm(gtsam.Rot3.Logmap(ends[0].between(ends[1]))) < 0.02


def one(make):
    def generator(states, recording):
        yield make(states)

    return generator


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda states: gtsam.PriorFactorVector(V(len(states.t_ns)), np.zeros(3), UNIT3), r"the states are numbered"),
        (lambda states: gtsam.PriorFactorVector(H(0), np.zeros(16), gtsam.noiseModel.Unit.Create(16)), "on no state"),
        (lambda states: "X(3)", "yields a str; give factors that gtsam has built in"),
        (
            lambda states: gtsam.CustomFactor(UNIT3, [X(0)], lambda *_: np.zeros(3)),
            "yields a CustomFactor; give factors that gtsam has built in",
        ),
        (
            lambda states: gtsam.PriorFactorConstantBias(
                C(len(states.t_ns) - 1), gtsam.imuBias.ConstantBias(), gtsam.noiseModel.Unit.Create(6)
            ),
            "the states are numbered",
        ),
    ],
)
def test_what_cannot_be_added_is_refused_in_words(blind, make, message):
    with pytest.raises(BadParameter, match=message):
        reference(blind, params=PRESETS["vehicle"], factors=[one(make)])


def test_only_the_graph_takes_factors(blind):
    with pytest.raises(BadParameter, match="factors: are for the method graph, not redistribution"):
        reference(blind, "redistribution", factors=[example()])


@pytest.mark.slow
def test_long_recordings_count_each_factor_once(blind):
    """In windows the answer is the one of a single window, within its sd."""
    params = replace(PRESETS["vehicle"], keys=replace(PRESETS["vehicle"].keys, window_s=80.0, overlap_s=30.0))
    windows = reference(blind, params=params, factors=[example()])
    whole = reference(blind, params=PRESETS["vehicle"], factors=[example()])
    assert windows.diagnostics["windows"] > 1
    tilt = [score(made, blind.truth).inclination_rmse_deg for made in (windows, whole)]
    assert tilt[0] == pytest.approx(tilt[1], abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("option", ["nonholonomic", "stops"])
def test_the_options_for_vehicles_agree_with_the_drive(option):
    """That the car moves along its axis tells its heading: 0.2 instead of 0.7 deg here. Stops tell little."""
    drive = replace(simulate("car", seed=2, minutes=2.5, rate_hz=50), mag=None)
    plain = score(reference(drive), drive.truth, align="none")
    helped = reference(drive, params={f"motion.{option}": True})
    found = score(helped, drive.truth, align="none")
    assert found.heading_rmse_deg < (0.7 if option == "nonholonomic" else 1.1) * plain.heading_rmse_deg
    assert found.coverage95 > 0.9
    assert helped.diagnostics["residuals"][f"added {option}"] < 1
    assert helped.diagnostics["contradicting_factors"] == []
