"""The simulated car moves as a car does, and its sensors see that."""

from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets.earth import enu_m
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.car import CAR, TOWN, Receiver


@pytest.fixture(scope="module")
def perfect():
    return simulate("car", seed=3, minutes=1.5, rate_hz=50, sensor="perfect")


def velocity_n_mps(recording):
    return np.gradient(recording.truth.position_n_m, recording.truth.t_ns / 1e9, axis=0)


def test_the_velocity_lies_along_the_body_x_axis(perfect):
    speed_b = rotation(perfect.truth.q_nb).inv().apply(velocity_n_mps(perfect))[5:-5]
    assert speed_b[:, 0].min() > -0.02
    assert speed_b[:, 0].max() > 8.0
    assert np.abs(speed_b[:, 1:]).max() < 0.05


def test_the_car_stops_and_stands(perfect):
    speed = np.linalg.norm(velocity_n_mps(perfect), axis=1)
    assert (speed < 1e-6).sum() > 5 * 50


def test_the_wheels_show_the_speed(perfect):
    wheel, t_ns = perfect.extra["wheel"], perfect.truth.t_ns
    known = np.interp(wheel.t_ns, t_ns, np.linalg.norm(velocity_n_mps(perfect), axis=1))
    assert wheel.column("speed_mps")[1:-1] == pytest.approx(known[1:-1], abs=0.05)


def test_antenna_delay_and_tunnel_are_as_asked():
    receiver = Receiver(antenna_x_m=2.0, late_s=0.4, tunnel_start_s=30.0, tunnel_s=20.0)
    perfect = replace(CAR, gps=replace(CAR.gps, position_sd_m=0.0, velocity_sd_mps=0.0), receiver=receiver)
    recording = simulate("car", seed=3, minutes=1.5, rate_hz=50, sensor=perfect)
    gps, truth = recording.gps, recording.truth
    t_s = gps.t_ns / 1e9 - TOWN.start_ns / 1e9 - 0.4
    assert np.array_equal(gps.valid, (t_s < 30) | (t_s >= 50))
    place = enu_m(gps.lat_deg[gps.valid], gps.lon_deg[gps.valid], gps.alt_m[gps.valid], TOWN.place)
    antenna = truth.position_n_m + rotation(truth.q_nb).apply([2.0, 0.0, 0.0])
    truth_s = (truth.t_ns - TOWN.start_ns) / 1e9
    known = np.stack([np.interp(t_s[gps.valid], truth_s, axis) for axis in antenna.T], axis=1)
    assert np.abs(place - known)[1:-1].max() < 0.02
