"""The state of the PI filters ``cf``, ``cf-fixed`` and ``cf-lse``, and what their steps have in common.

All three move the attitude on by rate and b and turn it towards that of the fields by a proportional and an integral
gain; how the gains act is theirs. Before the first tilt, and after a gap, the attitude is taken from the fields as it
is, and b is kept.
"""

from typing import NamedTuple

from stillpoint.filters import rotation
from stillpoint.filters.compiled import compiled_inside
from stillpoint.filters.fields import Fields, Fresh, no_fields, turn_to_north, uprighting
from stillpoint.filters.rotation import Quaternion, Vector, about_up, add, multiply, normalise, rotate, scale
from stillpoint.filters.sample import GAP_S, Output, Sample


class Observer(NamedTuple):
    """What is remembered."""

    fields: Fields
    q_nb: Quaternion
    b_radps: Vector  # the integral part, in body axes: minus the gyro bias
    age_s: float  # since the start, up to the settling time
    is_level: bool  # False until the first tilt, and after a gap
    is_headed: bool  # False until the first heading, and after a gap
    n_gaps: int
    n_no_north: int  # magnetometer samples left out: no horizontal field


@compiled_inside
def unlevelled(zero: float) -> Observer:
    """Before the first sample: level, x over north."""
    half = 0.5**0.5
    return Observer(no_fields(zero), (half, zero, zero, half), (zero, zero, zero), zero, False, False, 0, 0)


@compiled_inside
def moved_on(before: Observer, fields: Fields, sample: Sample, settling_s: float) -> Observer:
    """The prediction: turned by rate and b over the interval, not yet brought to length 1; after a gap not level."""
    _, q_nb, b_radps, age_s, is_level, is_headed, n_gaps, n_no_north = before
    dt_s = sample.dt_s
    if is_level and dt_s > GAP_S:
        is_level, is_headed, n_gaps = False, False, n_gaps + 1
    age_s = min(age_s + dt_s, settling_s) if is_level else 0.0
    if is_level:
        q_nb = multiply(q_nb, rotation.exp(scale(add(sample.gyro_b_radps, b_radps), dt_s)))
    return Observer(fields, q_nb, b_radps, age_s, is_level, is_headed, n_gaps, n_no_north)


@compiled_inside
def begun(observer: Observer, fresh: Fresh, declination_rad: float) -> Observer:
    """Of an observer that is not level: the attitude of the fields; without a new field the heading that there was."""
    fields, q_nb, b_radps, age_s, is_level, is_headed, n_gaps, n_no_north = observer
    if fresh.accel:
        q_nb, is_level = normalise(multiply(uprighting(q_nb, fields.accel_b_mps2), q_nb)), True
        if fresh.mag:
            turn_rad, is_headed = turn_to_north(rotate(q_nb, fields.mag_b_ut), declination_rad)
            q_nb = multiply(about_up(turn_rad), q_nb) if is_headed else q_nb
    return Observer(fields, q_nb, b_radps, age_s, is_level, is_headed, n_gaps, n_no_north)


@compiled_inside
def corrected(observer: Observer, q_nb: Quaternion, b_radps: Vector, is_headed: bool, n_no_north: int) -> Observer:
    """With this attitude, brought to length 1, and this b; ``n_no_north``: by how much that count grows."""
    fields, _, _, age_s, is_level, _, n_gaps, n_before = observer
    return Observer(fields, normalise(q_nb), b_radps, age_s, is_level, is_headed, n_gaps, n_before + n_no_north)


@compiled_inside
def uncorrected(observer: Observer) -> Observer:
    """The prediction as it is, brought to length 1."""
    return corrected(observer, observer.q_nb, observer.b_radps, observer.is_headed, 0)


@compiled_inside
def said(observer: Observer, settling_s: float) -> Output:
    """The estimate: attitude and gyro bias, ready once the first error is forgotten."""
    is_ready = observer.is_level and observer.age_s >= settling_s
    return Output(observer.q_nb, scale(observer.b_radps, -1.0), None, None, is_ready)
