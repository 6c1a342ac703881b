"""``ekf``: error-state (multiplicative) extended Kalman filter of attitude and gyro bias.

The attitude is a quaternion, its error a small rotation d in body axes, q_true = q exp(d) (Lefferts, Markley and
Shuster 1982; Sola 2017, arXiv:1711.02508). Model, prediction and updates are those of
:mod:`stillpoint.filters.kalman.model`. That keeps the covariance in n, as R P R', where a turn of the body leaves it
alone; this file adds what makes the filter multiplicative in body axes: when the attitude is corrected, the covariance
of d stays as it is *in the body*, so in n it turns with the correction. (``iekf`` leaves it as it is in n. The two
differ by the second order of a correction.)

Output: ``cov_b_rad2`` is the covariance of d, at every sample. ``innovation`` has the velocity's two (east, north) and
the heading's, each whitened given those before it: their sum of squares, NIS, is chi-square with 3 degrees of freedom
(2 without a field) where the noise is as the parameters say. They come at the end of a window and are NaN elsewhere.

Fails: in a sustained acceleration (a long curve, a rocket) of more than ``velocity_mps_rts`` allows, which looks like
tilt; where the field is that of another place but of the same size and dip; without a field the heading drifts with
what is left of the bias about the vertical, which only a rest shows.
"""

from dataclasses import dataclass

from stillpoint.datasets.compiled import compiled_inside
from stillpoint.filters.kalman import model as error_model
from stillpoint.filters.kalman import predict as error_state
from stillpoint.filters.kalman.model import Coefficients, ErrorStateParams, FilterState
from stillpoint.filters.kalman.predict import add_sample, is_due, make_output
from stillpoint.filters.kalman.update import no_innovations, update_window
from stillpoint.filters.sample import Output, Sample

State = FilterState
coefficients = error_model.coefficients
start = error_state.start


@dataclass(frozen=True)
class Params(ErrorStateParams):
    """Parameters of ``ekf``."""


@compiled_inside
def step(state: FilterState, sample: Sample, c: Coefficients) -> tuple[FilterState, Output]:
    """Turn by the rate; at the end of a window predict the errors and update them."""
    body, innovations = add_sample(state, sample, c), no_innovations(c)
    if is_due(body.window.turning, c):
        body, innovations = update_window(body, True, c)
    return body, make_output(body, innovations, c)
