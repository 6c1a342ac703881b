"""``iekf``: right-invariant extended Kalman filter on SO(3) with a gyro bias, for comparison with ``ekf``.

The error is exp(e) = R_true R', a rotation in n (A. Barrau, S. Bonnabel, "The invariant extended Kalman filter as a
stable observer", IEEE Trans. Automatic Control 62(4), 2017). Right-invariant, because what is measured, specific force
and field, are known vectors of n seen from the body, y = R' g + noise: observations of that kind have a Jacobian that
does not depend on the estimate, [g]x, with a right-invariant error. The bias is appended in body axes (the "imperfect"
IEKF of A. Barrau's thesis, 2015; R. Hartley et al., Int. J. Robotics Research 39(4), 2020, eqs (48)-(52)); with it the
attitude's error still follows e' = -R (d + noise), whatever the motion.

Model, prediction and updates are those of :mod:`stillpoint.filters.kalman.model`, which are in e already. Against
``ekf`` one thing differs: a correction leaves the covariance of e as it is in n. So what accelerometers cannot know,
the heading, stays the third axis of P exactly, however large a correction of the tilt is. Everything else is as in
``ekf``.
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
    """Parameters of ``iekf``."""


@compiled_inside
def step(state: FilterState, sample: Sample, c: Coefficients) -> tuple[FilterState, Output]:
    """Turn by the rate; at the end of a window predict the errors and update them."""
    body, innovations = add_sample(state, sample, c), no_innovations(c)
    if is_due(body.window.turning, c):
        body, innovations = update_window(body, False, c)
    return body, make_output(body, innovations, c)
