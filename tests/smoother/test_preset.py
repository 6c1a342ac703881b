"""The preset follows the evidence of the recording; where that is ambiguous nothing changes."""

from dataclasses import replace

import pytest

from stillpoint.datasets import Unobservable
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.simulate import simulate
from stillpoint.smoother import reference
from stillpoint.smoother.attitude.params import PRESETS
from stillpoint.smoother.preset import choose_preset

KINDS = {"phone-1": 2.0, "phone-3": 2.0, "servo-bench": 3.0}


@pytest.fixture(scope="module")
def car():
    return simulate("car", seed=1, minutes=2.0, rate_hz=50)


@pytest.mark.parametrize("kind", KINDS)
def test_what_hands_and_servos_move_stays_handheld(kind):
    assert choose_preset(simulate(kind, seed=1, minutes=KINDS[kind], rate_hz=50)).name == "handheld"


def test_a_tripod_that_turns_a_phone_is_a_bench():
    """Its head moves the phone by a lever arm of 12 cm, which hardly shows in the accelerometer."""
    choice = choose_preset(simulate("phone-2", seed=1, minutes=2.0, rate_hz=50))
    assert choice.name == "bench"
    assert "turned over, but pushed by" in choice.reason


def test_satellites_show_a_vehicle(car):
    choice = choose_preset(car)
    assert choice.name == "vehicle"
    assert "satellites saw it" in choice.reason


def test_a_car_without_satellites_is_known_by_its_accelerations(car):
    choice = choose_preset(replace(car, gps=None))
    assert choice.name == "vehicle"
    assert "deg/s only, but accelerates by" in choice.reason


@pytest.mark.slow
def test_the_choice_is_used_and_stated(car):
    made = reference(replace(car, mag=None))
    assert made.diagnostics["preset"] == "vehicle"
    assert made.params["motion"]["velocity_sd_mps"] == PRESETS["vehicle"].motion.velocity_sd_mps
    named = reference(replace(car, mag=None), params=PRESETS["vehicle"])
    assert "preset" not in named.diagnostics


def test_a_vehicle_with_neither_satellites_nor_magnetometer_is_refused(car):
    """Tilt and acceleration are one: answers were up to 25 deg wrong with a fourth of it in the 95 % ellipsoid."""
    with pytest.raises(Unobservable, match="cannot be told from gravity without satellites or a magnetometer"):
        reference(replace(car, gps=None, mag=None))


@pytest.mark.slow
def test_a_wrong_preset_is_named_as_the_reason(car):
    blind = replace(car, gps=None, mag=None)
    with pytest.raises(Unobservable, match=r"this looks like a vehicle .* --preset vehicle; as it is, "):
        reference(blind, params=PRESETS["handheld"])


@pytest.mark.real_data
def test_real_hands_are_handheld(data_dir):
    """12 BROAD trials and 10 phones in hands, pockets and running."""
    for source in ("broad", "tyrex"):
        for recording in IMPORTERS[source](data_dir / source):
            assert choose_preset(recording).name == "handheld", recording.name
