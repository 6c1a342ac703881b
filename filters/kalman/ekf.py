"""``ekf`` and ``iekf``: extended Kalman filter of attitude and gyro bias with a right-invariant attitude error.

The error is exp(e) = R_true R', a rotation in n (A. Barrau, S. Bonnabel, "The invariant extended Kalman filter as a
stable observer", IEEE Trans. Automatic Control 62(4), 2017). What is measured, specific force and field, are known
vectors of n seen from the body, y = R' g + noise. With a right-invariant error such a measurement has the Jacobian
[g]x, which does not depend on the estimate. The bias is appended in body axes (the "imperfect" IEKF of A. Barrau's
thesis, 2015; R. Hartley et al., Int. J. Robotics Research 39(4), 2020, eqs (48)-(52)); with it the attitude's error
still follows e' = -R (d + noise), whatever the motion.

The textbooks' multiplicative filter (Lefferts, Markley and Shuster 1982; Sola 2017, arXiv:1711.02508) keeps the error
in body axes, so each correction of the tilt turns the covariance in n. That mixes the variance of a heading that
nothing measures into the tilt: the filter then corrects the heading by the accelerometer and claims to know it. In n
the heading stays the third axis of P, however large a correction is. On the 12 BROAD trials the invariant form is the
better one, too (1.535 against 1.554 deg on the mean), so it is the only one here, under both names.

A heading that no field has shown yet is moved by the gyro alone, and its variance never falls.

Model, prediction and updates: :mod:`stillpoint.filters.kalman.model`. ``cov_b_rad2`` is the covariance of R' e, at
every sample. ``innovation`` has the velocity's two components (east, north) and the heading's, each whitened given
those before it: their sum of squares, NIS, is chi-square with 3 degrees of freedom (2 without a field) where the noise
is as the parameters say. They come at the end of a window and are NaN elsewhere.

Fails: in a sustained acceleration (a long curve, a rocket) beyond ``velocity_mps_rts``, which looks like tilt; where
the field is that of another place but of the same size and dip; without a field the heading drifts with the error of
the bias about the vertical, which only a rest shows.
"""

from dataclasses import dataclass

from stillpoint.datasets.compiled import compiled_inside
from stillpoint.filters.kalman import model, predict
from stillpoint.filters.kalman.model import Coefficients, ErrorStateParams, FilterState
from stillpoint.filters.kalman.predict import add_sample, is_due, make_output
from stillpoint.filters.kalman.update import no_innovations, update_window
from stillpoint.filters.sample import Output, Sample

State = FilterState
coefficients = model.coefficients
start = predict.start


@dataclass(frozen=True)
class Params(ErrorStateParams):
    """Parameters of ``ekf`` and ``iekf``."""


@compiled_inside
def step(state: FilterState, sample: Sample, c: Coefficients) -> tuple[FilterState, Output]:
    """Turn by the rate; at the end of a window predict the errors and update them."""
    state, innovations = add_sample(state, sample, c), no_innovations(c)
    if is_due(state.window.turning, c):
        state, innovations = update_window(state, c)
    return state, make_output(state, innovations, c)
