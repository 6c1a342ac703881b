"""A long recording in a disturbed field: a part of it tries the priors, and the answer stays what it was."""

import json
from dataclasses import replace

import numpy as np
import pytest
from known_motion import between

from stillpoint.datasets.recording import Mag, Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.scenes import let_field_wander
from stillpoint.smoother import reference
from stillpoint.smoother.attitude import graph
from stillpoint.smoother.attitude.evidence import gather_evidence
from stillpoint.smoother.attitude.params import HANDHELD, GraphParams
from stillpoint.smoother.attitude.trial import find_trial


@pytest.fixture(scope="module")
def disturbed(swings: Recording) -> Recording:
    return let_field_wander(swings, 10.0, 4.0, seed=1)


def test_trial_lies_in_the_first_window_of_a_disturbed_recording(disturbed: Recording, windowed: GraphParams) -> None:
    trial = find_trial(gather_evidence(disturbed, windowed), windowed)
    assert trial is not None
    assert trial.keys.states.start == 0
    assert 30.0 < trial.keys.t_s[trial.keys.states.stop - 1] < 60.0


def test_a_recording_of_one_window_has_no_trial(disturbed: Recording) -> None:
    """The whole of it tries the priors, as ever."""
    assert find_trial(gather_evidence(disturbed, HANDHELD), HANDHELD) is None


@pytest.mark.parametrize("scale", [1.0, 1.08])
def test_a_gyro_that_is_off_does_not_look_like_a_disturbed_field(
    swings: Recording, windowed: GraphParams, scale: float
) -> None:
    imu = swings.require_imu()
    off = replace(swings, imu=replace(imu, gyro_b_radps=scale * imu.gyro_b_radps))
    assert find_trial(gather_evidence(off, windowed), windowed) is None


def test_a_field_disturbed_at_first_only_has_no_trial(
    swings: Recording, disturbed: Recording, windowed: GraphParams
) -> None:
    """The verdict on the first part may count for the whole only where the whole is disturbed."""
    assert swings.mag is not None
    assert disturbed.mag is not None
    early = (swings.mag.t_ns - swings.mag.t_ns[0] < 40e9)[:, None]
    mag_b_ut = np.where(early, disturbed.mag.mag_b_ut, swings.mag.mag_b_ut)
    partly = replace(swings, mag=Mag(swings.mag.t_ns, mag_b_ut))
    assert find_trial(gather_evidence(partly, windowed), windowed) is None


@pytest.mark.slow
def test_answer_is_that_of_priors_tried_on_the_whole(disturbed: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    params = {"keys.window_s": 60.0, "keys.overlap_s": 10.0}
    made = reference(disturbed, params=params)
    assert "in its first" in made.diagnostics["magnetometer_left_out"]
    monkeypatch.setattr(graph, "find_trial", lambda evidence, params: None)
    whole = reference(disturbed, params=params)
    assert "in its first" not in whole.diagnostics["magnetometer_left_out"]
    np.testing.assert_array_equal(made.q_nb, whole.q_nb)
    np.testing.assert_array_equal(made.cov_b_rad2, whole.cov_b_rad2)


@pytest.mark.slow
def test_where_no_return_tests_the_gyro_the_readings_that_fit_are_used() -> None:
    """Leaving the magnetometer out is no way out then: the whole is solved with it, by the narrowest prior."""
    disturbed = let_field_wander(simulate("phone-3", minutes=3), 10.0, 4.0, seed=1)
    second_rest_s = json.loads(disturbed.info.extra["rests_s"])[1][1]
    moving_first = between(disturbed, second_rest_s + 1.0, 180.0)
    made = reference(moving_first, params={"keys.window_s": 80.0, "keys.overlap_s": 20.0})
    assert made.diagnostics["field_disturbed"].endswith("only the readings that fit are used")
    assert made.diagnostics["windows"] > 1
    assert made.diagnostics["gyro_matrix_prior_sd"] == HANDHELD.inertial.gyro_matrix_sd
