"""The state of the PI filters ``cf``, ``cf-fixed`` and ``cf-lse``, and what their steps have in common.

All three predict the attitude by rate and b and turn it towards that of the fields by a proportional and an integral
gain; how the gains act differs. Before the first tilt, and after a gap, the attitude is taken from the fields as it is,
and b is kept.
"""

from typing import NamedTuple

from stillpoint.datasets.compiled import compiled_inside
from stillpoint.filters import rotation
from stillpoint.filters.fields import Fields, Fresh, level_rotation, north_error, start_fields
from stillpoint.filters.rotation import Quaternion, Vector, add, multiply, normalise, rotate, rotation_about_up, scale
from stillpoint.filters.sample import GAP_S, Output, Sample


class Observer(NamedTuple):
    """The state of the three filters between two samples."""

    fields: Fields
    q_nb: Quaternion
    b_radps: Vector  # the integral part, in body axes: minus the gyro bias
    age_s: float  # since the start, up to the settling time
    is_level: bool  # False until the first tilt, and after a gap
    is_headed: bool  # False until the first heading, and after a gap
    n_gaps: int
    n_no_north: int  # magnetometer samples left out: no horizontal field


@compiled_inside
def start_observer(zero: float) -> Observer:
    """Return the observer before the first sample: level, with the body's x axis pointing north."""
    half = 0.5**0.5
    return Observer(start_fields(zero), (half, zero, zero, half), (zero, zero, zero), zero, False, False, 0, 0)


@compiled_inside
def predict_observer(before: Observer, fields: Fields, sample: Sample, settling_s: float) -> Observer:
    """Turn by the rate and b over the interval; the quaternion is not normalised yet. After a gap it is not level."""
    _, q_nb, b_radps, age_s, is_level, is_headed, n_gaps, n_no_north = before
    dt_s = sample.dt_s
    if is_level and dt_s > GAP_S:
        is_level, is_headed, n_gaps = False, False, n_gaps + 1
    age_s = min(age_s + dt_s, settling_s) if is_level else 0.0
    if is_level:
        q_nb = multiply(q_nb, rotation.exp(scale(add(sample.gyro_b_radps, b_radps), dt_s)))
    return Observer(fields, q_nb, b_radps, age_s, is_level, is_headed, n_gaps, n_no_north)


@compiled_inside
def begin_observer(observer: Observer, fresh: Fresh, declination_rad: float) -> Observer:
    """Take the attitude of the fields for an observer that is not level; keep its heading if there is no new field."""
    fields, q_nb, b_radps, age_s, is_level, is_headed, n_gaps, n_no_north = observer
    if fresh.accel:
        q_nb, is_level = normalise(multiply(level_rotation(q_nb, fields.accel_b_mps2), q_nb)), True
        if fresh.mag:
            turn_rad, is_headed = north_error(rotate(q_nb, fields.mag_b_ut), declination_rad)
            q_nb = multiply(rotation_about_up(turn_rad), q_nb) if is_headed else q_nb
    return Observer(fields, q_nb, b_radps, age_s, is_level, is_headed, n_gaps, n_no_north)


@compiled_inside
def set_attitude(observer: Observer, q_nb: Quaternion, b_radps: Vector, is_headed: bool, n_no_north: int) -> Observer:
    """Return the observer with this attitude, normalised, and this b; ``n_no_north`` is added to its count."""
    fields, _, _, age_s, is_level, _, n_gaps, n_before = observer
    return Observer(fields, normalise(q_nb), b_radps, age_s, is_level, is_headed, n_gaps, n_before + n_no_north)


@compiled_inside
def keep_prediction(observer: Observer) -> Observer:
    """Return the observer with its prediction normalised."""
    return set_attitude(observer, observer.q_nb, observer.b_radps, observer.is_headed, 0)


@compiled_inside
def make_output(observer: Observer, settling_s: float) -> Output:
    """Return the output: attitude and gyro bias, ready once the first error has decayed."""
    is_ready = observer.is_level and observer.age_s >= settling_s
    return Output(observer.q_nb, scale(observer.b_radps, -1.0), None, None, is_ready)
