"""How ``ekf``, ``aekf`` and ``iekf`` proceed from sample to sample: begin, turn, add to the window, and correct."""

from math import cos, pi, sin

import numpy as np

from stillpoint.datasets.compiled import compiled_apart, compiled_entry, compiled_inside
from stillpoint.filters import rotation
from stillpoint.filters.fields import FREE_FALL_M2PS4, north_error
from stillpoint.filters.kalman.covariance import (
    ANY_ANGLE_RAD2,
    Matrix,
    add_sd_along,
    apply_congruence,
    covariance_in_body,
    forget_state,
    identity_like,
)
from stillpoint.filters.kalman.known_field import is_alike, is_earthly, learn_field, measure_looks, start_field
from stillpoint.filters.kalman.model import (
    BIAS,
    HEADING,
    OFF_RAD2,
    OFF_SQUARE,
    SIZE,
    VELOCITY,
    Coefficients,
    Counts,
    FilterState,
    Status,
    WindowEnd,
    attitude_noise_variance,
)
from stillpoint.filters.kalman.stillness import no_rest
from stillpoint.filters.kalman.window import (
    Forces,
    Turning,
    Window,
    add_field,
    add_force,
    add_turn,
    empty_window,
    is_measured,
)
from stillpoint.filters.rotation import (
    Quaternion,
    Vector,
    add,
    dot,
    multiply,
    norm,
    normalise,
    rotate,
    rotation_about_up,
    rotation_between,
    scale,
)
from stillpoint.filters.sample import GAP_S, Output, Sample

# A body whose mean specific force, of at least that size, points that far down (cosine) is not as the estimate says.
_LEAST_FORCE_MPS2 = 5.0
_OBLIQUE = 0.5
# A tilt known to that (sd per axis, 2 deg) is no longer a beginning.
_READY_RAD2 = 2 * (pi / 90) ** 2


@compiled_entry
def start(c: Coefficients) -> FilterState:
    """Return the state before the first sample: level, with the body's x axis pointing north, and nothing known."""
    half = 0.5**0.5
    x, p = np.full(SIZE, 0.0), np.full((SIZE, SIZE), 0.0)
    for i in range(BIAS):
        p[i, i] = ANY_ANGLE_RAD2
        p[BIAS + i, BIAS + i] = c.bias_variance
    for i in range(VELOCITY, SIZE):
        p[i, i] = c.velocity_variance
    status = Status(False, False, False, 0.0, 0.0, 0.0, 0.0)
    counts = Counts(0, 0, 0, 0, 0, 0, 0)
    return FilterState((half, 0.0, 0.0, half), x, p, empty_window(0.0), no_rest(0.0), start_field(0.0), status, counts)


@compiled_inside
def add_sample(body: FilterState, sample: Sample, c: Coefficients) -> FilterState:
    """Turn by the rate and add the sample to the window; before there is an attitude, begin one."""
    q_nb, x, p, window, still, field, status, counts = body
    dt_s, gyro, accel, mag, has_accel, has_mag, _ = sample
    use_accel = has_accel and dot(accel, accel) >= FREE_FALL_M2PS4
    use_mag = has_mag and dot(mag, mag) > 0
    n_free_fall = counts.n_free_fall + (1 if has_accel and not use_accel else 0)
    n_no_field = counts.n_no_field + (1 if has_mag and not use_mag else 0)
    counts = Counts(n_free_fall, n_no_field, counts[2], counts[3], counts[4], counts[5], counts[6])
    is_gap = dt_s > GAP_S
    if status.is_level and not is_gap:
        (turning, forces, fields), before = window, q_nb
        rate = add(gyro, (-x[BIAS], -x[BIAS + 1], -x[BIAS + 2]))
        q_nb = normalise(multiply(q_nb, rotation.exp(scale(rate, dt_s))))
        turning = add_turn(turning, sample, rate, before, q_nb)
        if use_accel:
            forces = add_force(forces, rotate(q_nb, accel), accel, dt_s)
        if use_mag:
            fields = add_field(fields, rotate(q_nb, mag), mag)
        window = Window(turning, forces, fields)
    if is_gap or not status.is_level or (use_mag and not status.is_headed):
        window = empty_window(0.0)
        if is_gap:
            _forget_after_gap(x, p, dt_s, c)
            still = no_rest(0.0)
        q_nb, status, found = _begin_attitude(q_nb, x, p, sample, (use_accel, use_mag, is_gap), status, c)
        counts = Counts(
            counts[0],
            counts[1],
            counts[2] + (0 if found else 1),
            counts[3] + (1 if is_gap else 0),
            counts[4],
            counts[5],
            counts[6],
        )
    return FilterState(q_nb, x, p, window, still, field, status, counts)


@compiled_apart
def _forget_after_gap(x: Matrix, p: Matrix, gap_s: float, c: Coefficients) -> None:
    """Forget all but the bias after a gap, in which the bias has walked."""
    for i in range(BIAS):
        forget_state(p, i, ANY_ANGLE_RAD2)
        p[BIAS + i, BIAS + i] += c.bias_walk * gap_s
    _forget_velocity(x, p, c)


@compiled_inside
def _forget_velocity(x: Matrix, p: Matrix, c: Coefficients) -> None:
    """Forget the velocity: 0, with the variance that it may have."""
    for i in range(VELOCITY, SIZE):
        forget_state(p, i, c.velocity_variance)
        x[i] = 0.0


@compiled_apart
def _begin_attitude(
    q_nb: Quaternion,
    x: Matrix,
    p: Matrix,
    sample: Sample,
    use: tuple[bool, bool, bool],  # the accelerometer, the magnetometer, as the first after a gap
    status: Status,
    c: Coefficients,
) -> tuple[Quaternion, Status, bool]:
    """Take tilt and heading from a sample as far as they are missing; False for a field without north."""
    use_accel, use_mag, is_gap = use
    is_level, is_headed, is_ready, since_s, _, _, _ = status
    found = True
    if is_gap:
        is_level, is_headed, is_ready = False, False, False
    if use_accel and not is_level:
        q_nb, is_level = _reset_tilt(q_nb, rotate(q_nb, sample.accel_b_mps2), x, p, c), True
    if use_mag and is_level and not is_headed:
        turn, found = north_error(rotate(q_nb, sample.mag_b_ut), c.declination_rad)
        if found:
            q_nb, is_headed = _reset_heading(q_nb, turn, x, p, c), True
    return q_nb, Status(is_level, is_headed, is_ready, since_s, 0.0, 0.0, 0.0), found


@compiled_apart
def _reset_tilt(q_nb: Quaternion, force_n: Vector, x: Matrix, p: Matrix, c: Coefficients) -> Quaternion:
    """Return the attitude whose up is this specific force, given in n; the heading stays."""
    for i in range(HEADING):
        forget_state(p, i, c.tilt_variance)
    _forget_velocity(x, p, c)
    return normalise(multiply(rotation_between(force_n, (0.0, 0.0, 1.0)), q_nb))


@compiled_apart
def _reset_heading(q_nb: Quaternion, turn_rad: float, x: Matrix, p: Matrix, c: Coefficients) -> Quaternion:
    """Turn the attitude about up, and with it all that is known in n but the heading."""
    cosine, sine, a = cos(turn_rad), sin(turn_rad), identity_like(p)
    for i in (0, VELOCITY):
        a[i, i], a[i, i + 1], a[i + 1, i], a[i + 1, i + 1] = cosine, -sine, sine, cosine
    apply_congruence(a, p)
    forget_state(p, HEADING, c.heading_variance)
    x[VELOCITY], x[VELOCITY + 1] = (
        x[VELOCITY] * cosine - x[VELOCITY + 1] * sine,
        x[VELOCITY] * sine + x[VELOCITY + 1] * cosine,
    )
    return normalise(multiply(rotation_about_up(turn_rad), q_nb))


@compiled_inside
def is_due(turning: Turning, c: Coefficients) -> bool:
    """Return whether the window is as long as wanted, but for rounding."""
    return turning.length_s > 0 and turning.length_s >= c.window_s * (1 - 1e-5)


@compiled_inside
def _is_oblique(forces: Forces) -> bool:
    """Return whether the mean specific force points where it cannot for long if the estimate is right."""
    up, size = forces.push_n_mps[2], norm(forces.push_n_mps)
    return up < size * _OBLIQUE and size > forces.time_s * _LEAST_FORCE_MPS2


@compiled_apart
def _add_curvature(x: Matrix, p: Matrix) -> None:
    """Add to P the second order of an update that turned the attitude by e: |e|^2 / 2.

    A hundredth of a degree at 1 deg. After a large turn that the gyro hid, several windows so come to what one says.
    """
    bent = 0.5 * (x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    for i in range(BIAS):
        p[i, i] += bent * bent


@compiled_apart
def _forget_heading(p: Matrix, c: Coefficients) -> None:
    """Forget the heading, and the bias that followed it."""
    forget_state(p, HEADING, ANY_ANGLE_RAD2)
    for i in range(3):
        forget_state(p, BIAS + i, c.bias_variance)


@compiled_apart
def finish_window(
    body: FilterState, at: WindowEnd, nu_heading: float, beyond: tuple[bool, bool], c: Coefficients
) -> FilterState:
    """Move the attitude by its error, and return the state at the beginning of the next window."""
    q_nb, x, p, window, _, field, status, counts = body
    is_level, is_headed, is_ready, since_s, tilt_doubt_s, heading_doubt_s, heading_off = status
    n_free_fall, n_no_field, n_no_north, n_gaps, n_beyond, n_tilt, n_heading = counts
    length_s = window.turning.length_s
    q_nb = normalise(multiply(rotation.exp((x[0], x[1], x[2])), q_nb))
    _add_curvature(x, p)
    x[0], x[1], x[2] = 0.0, 0.0, 0.0
    is_ready = is_ready or p[0, 0] + p[1, 1] < _READY_RAD2
    n_beyond += (1 if beyond[0] else 0) + (1 if beyond[1] else 0)
    tilt_doubt_s = tilt_doubt_s + length_s if beyond[0] or _is_oblique(window.forces) else 0.0
    if tilt_doubt_s >= c.tilt_patience_s:
        q_nb = _reset_tilt(q_nb, window.forces.push_n_mps, x, p, c)
        tilt_doubt_s, n_tilt = 0.0, n_tilt + 1
    since_s += length_s
    if at.heading.is_there:
        n_heading += 1 if heading_doubt_s >= c.heading_patience_s else 0
        heading_doubt_s = min(heading_doubt_s, c.heading_patience_s) + length_s if beyond[1] else 0.0
        seen = measure_looks(scale(window.fields.sum_n_ut, 1.0 / window.fields.how_many), length_s)
        known, n_known = field.known, field.n_new_fields
        field = learn_field(field, seen, window.turning.turned_rad / length_s, c.tolerance)
        since_s = 0.0
        share = min(length_s / c.heading_patience_s, 1.0)
        if is_alike(field.known, seen, c.tolerance):
            heading_off += (nu_heading - heading_off) * share
        square = heading_off * heading_off
        is_off = square > share * OFF_SQUARE and square * at.heading.variance > OFF_RAD2
        is_away = field.n_new_fields > n_known and not is_earthly(known)  # from the iron at which it began
        if is_off or is_away:
            _forget_heading(p, c)
            heading_off, n_heading = 0.0, n_heading + 1
    elif window.fields.how_many > 0:
        n_no_north += 1
    status = Status(is_level, is_headed, is_ready, since_s, tilt_doubt_s, heading_doubt_s, heading_off)
    counts = Counts(n_free_fall, n_no_field, n_no_north, n_gaps, n_beyond, n_tilt, n_heading)
    return FilterState(q_nb, x, p, empty_window(0.0), at.still, field, status, counts)


@compiled_inside
def make_output(body: FilterState, innovations: Vector, c: Coefficients) -> Output:
    """Return the output after a sample, with the attitude's covariance there."""
    q_nb, x, p, window, _, _, status, _ = body
    cov_b = covariance_in_body(p, window.turning.spread_s, attitude_noise_variance(window.turning, c), q_nb)
    if not is_measured(window.turning):
        cov_b = add_sd_along(cov_b, window.turning.hidden_b_rad)
    return Output(q_nb, (x[BIAS], x[BIAS + 1], x[BIAS + 2]), cov_b, innovations, status.is_ready)
