"""The low pass of Elmi Aziz and Mohseni Araste's eq (9): each sensor by its own samples, and nothing across a gap."""

import pytest
from from_python import from_python

from stillpoint.filters import fields as module
from stillpoint.filters.fields import start_fields
from stillpoint.filters.sample import GAP_S, Sample

low_pass = from_python(module.smooth_fields)
KAPPA = 0.7
NONE = (0.0, 0.0, 0.0)
ONE_ACCEL, OTHER_ACCEL = (0.0, 0.0, 9.8), (2.0, 0.0, 9.6)
ONE_MAG, OTHER_MAG = (0.0, 20.0, -40.0), (5.0, 18.0, -40.0)


def blended(new, old):
    return tuple(KAPPA * a + (1 - KAPPA) * b for a, b in zip(new, old, strict=True))


def sample(dt_s, accel=None, mag=None):
    return Sample(dt_s, NONE, accel or NONE, mag or NONE, accel is not None, mag is not None, NONE)


@pytest.mark.parametrize(("pause_s", "follows"), [(0.99 * GAP_S, True), (1.01 * GAP_S, False)])
def test_the_first_sample_after_a_gap_stands_alone(pause_s, follows):
    """What was measured before it is of another attitude."""
    fields, _ = low_pass(start_fields(0.0), sample(0.0, ONE_ACCEL, ONE_MAG), KAPPA)
    fields, fresh = low_pass(fields, sample(pause_s, OTHER_ACCEL, OTHER_MAG), KAPPA)
    assert fresh.mag_hold_s == pause_s
    assert fields.accel_b_mps2 == pytest.approx(blended(OTHER_ACCEL, ONE_ACCEL) if follows else OTHER_ACCEL)
    assert fields.mag_b_ut == pytest.approx(blended(OTHER_MAG, ONE_MAG) if follows else OTHER_MAG)


def test_a_pause_of_one_sensor_is_not_one_of_the_other():
    fields, _ = low_pass(start_fields(0.0), sample(0.0, ONE_ACCEL, ONE_MAG), KAPPA)
    for _ in range(3):
        fields, fresh = low_pass(fields, sample(0.4, ONE_ACCEL), KAPPA)
        assert not fresh.mag
        assert fields.mag_b_ut == ONE_MAG  # held
    fields, fresh = low_pass(fields, sample(0.4, OTHER_ACCEL, OTHER_MAG), KAPPA)
    assert fresh.mag_hold_s == pytest.approx(1.6)
    assert fields.accel_b_mps2 == pytest.approx(blended(OTHER_ACCEL, ONE_ACCEL))
    assert fields.mag_b_ut == OTHER_MAG


def test_samples_without_direction_are_counted_and_take_no_part():
    """Free fall says nothing of up, and a field of zero nothing of north; the ones before stay, raw and smoothed."""
    before, _ = low_pass(start_fields(0.0), sample(0.0, ONE_ACCEL, ONE_MAG), KAPPA)
    after, fresh = low_pass(before, sample(0.1, (0.1, 0.2, 0.3), NONE), KAPPA)
    assert (after.accel_b_mps2, after.raw_accel_b_mps2) == (ONE_ACCEL, ONE_ACCEL)
    assert (after.mag_b_ut, after.raw_mag_b_ut) == (ONE_MAG, ONE_MAG)
    assert (fresh.accel, fresh.mag, after.n_free_fall, after.n_no_field) == (False, False, 1, 1)
