"""The Allan deviation against allantools, and its figures against processes whose parameters are known."""

import json
import tomllib

import numpy as np
import pytest

from stillpoint.datasets import Imu, Info, Recording, Unobservable, write
from stillpoint.datasets.calibration.allan import FLOOR, compute_overlapping_deviation, find_allan_deviation

RATE_HZ = 50.0


def stamps(n):
    return np.round(np.arange(n) / RATE_HZ * 1e9).astype(np.int64)


def test_it_is_the_overlapping_deviation_of_allantools():
    allantools = pytest.importorskip("allantools")
    values = np.random.default_rng(1).normal(size=(5000, 3)).cumsum(axis=0) * 0.01
    values += np.random.default_rng(2).normal(size=values.shape)
    tau_s, deviation = compute_overlapping_deviation(values, 1 / RATE_HZ)
    for axis in range(3):
        known_s, known, _, _ = allantools.oadev(values[:, axis], rate=RATE_HZ, data_type="freq", taus=tau_s)
        assert known_s == pytest.approx(tau_s)
        assert deviation[:, axis] == pytest.approx(known, rel=1e-9)


def test_white_noise_and_random_walk_are_found():
    """An hour: the noise density to 3 %, the walk to a third, as few clusters are that long."""
    draw, n, density, walk = np.random.default_rng(3), int(3600 * RATE_HZ), 2e-3, 1e-4
    white = draw.normal(size=(n, 3)) * density * np.sqrt(RATE_HZ)
    wander = np.cumsum(draw.normal(size=(n, 3)), axis=0) * walk / np.sqrt(RATE_HZ)
    found = find_allan_deviation(stamps(n), white + wander)
    assert found.noise_density == pytest.approx(density, rel=0.03)
    assert found.bias_walk == pytest.approx(walk, rel=0.4)


def test_a_floor_is_the_bias_instability():
    """Where white noise meets the walk the deviation is lowest: sqrt(N K 2 / sqrt(3)) for the sum of both."""
    draw, n, density, walk = np.random.default_rng(4), int(3600 * RATE_HZ), 2e-3, 1e-3
    white = draw.normal(size=(n, 3)) * density * np.sqrt(RATE_HZ)
    wander = np.cumsum(draw.normal(size=(n, 3)), axis=0) * walk / np.sqrt(RATE_HZ)
    found = find_allan_deviation(stamps(n), white + wander)
    assert found.bias_instability == pytest.approx(np.sqrt(density * walk * 2 / np.sqrt(3)) / FLOOR, rel=0.15)
    assert found.bias_instability_s == pytest.approx(np.sqrt(3) * density / walk, rel=0.8)


@pytest.mark.parametrize(
    ("t_ns", "message"),
    [
        (stamps(500), "a rest of 10 s is too short"),
        (np.delete(stamps(8000), range(2000, 3000)), "stamps of the rest are not even"),
        (np.sort(stamps(8000) + np.random.default_rng(1).integers(0, 15_000_000, 8000)), "stamps of the rest are not"),
    ],
)
def test_what_gives_no_deviation_is_refused(t_ns, message):
    with pytest.raises(Unobservable, match=message):
        find_allan_deviation(t_ns, np.zeros((len(t_ns), 3)))


@pytest.fixture
def resting(tmp_path):
    draw, n = np.random.default_rng(5), int(120 * RATE_HZ)
    gyro = draw.normal(size=(n, 3)) * 1e-3 * np.sqrt(RATE_HZ)
    accel = draw.normal(size=(n, 3)) * 5e-3 * np.sqrt(RATE_HZ) + np.array([0.0, 0.0, 9.81])
    path = tmp_path / "rest.mcap"
    write(path, Recording("rest", Imu(stamps(n), gyro, accel), info=Info()))
    return path


@pytest.mark.slow
def test_the_command_fills_the_settings(call, tmp_path, resting, capsys):
    out, plot = tmp_path / "rest.allan.toml", tmp_path / "rest.png"
    assert call("allan", resting, "-o", out, "--plot", plot, "--json", "-") == 0
    facts = json.loads(capsys.readouterr().out)
    gyro, accel = facts["sensors"]
    assert gyro["noise_density"] == pytest.approx([1e-3] * 3, rel=0.1)
    assert accel["noise_density"] == pytest.approx([5e-3] * 3, rel=0.1)
    settings = tomllib.loads(out.read_text())
    assert settings["params"]["gyro_noise_rad_rts"] == max(gyro["noise_density"])
    assert settings["reference"]["inertial.accel_rest_mps2_rthz"] == max(accel["noise_density"])
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_its_settings_are_those_of_smoother_and_ekf(call, tmp_path, resting):
    from stillpoint.datasets.settings import choose_settings
    from stillpoint.filters import ESTIMATORS
    from stillpoint.smoother.attitude.params import HANDHELD

    out = tmp_path / "rest.allan.toml"
    assert call("allan", resting, "-o", out) == 0
    settings = tomllib.loads(out.read_text())
    choose_settings(HANDHELD, settings["reference"], "graph")
    choose_settings(ESTIMATORS[settings["estimator"]].params(), settings["params"], "ekf")
