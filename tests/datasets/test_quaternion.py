"""The compiled exponential and logarithm keep all digits, also where their series take over."""

from math import cos, sin

import pytest

from stillpoint.datasets.quaternion import HALF_SERIES_BELOW, LOG_SERIES_BELOW, exp, log

EXP_BORDER_RAD = HALF_SERIES_BELOW**0.5
LOG_BORDER_RAD = 2 * LOG_SERIES_BELOW**0.5
AT_BORDERS_RAD = [share * border for border in (LOG_BORDER_RAD, EXP_BORDER_RAD) for share in (0.15, 0.3, 0.999, 1.001)]
ANGLES_RAD = (1e-300, 1e-12, 1e-6, *AT_BORDERS_RAD, 1e-2, 1.0, 3.1)


@pytest.mark.parametrize("angle", ANGLES_RAD)
def test_exp_is_cosine_and_sine_of_half_the_angle(angle):
    """An hour at 200 Hz and 0.1 rad/s turns 720 000 times by 5e-4 rad: 1e-11 in each of them would be seen."""
    w, x, y, z = exp((0.0, -angle, 0.0))
    assert (w, y) == pytest.approx((cos(angle / 2), -sin(angle / 2)), rel=1e-14, abs=0)
    assert (x, z) == (0.0, 0.0)


@pytest.mark.parametrize("angle", ANGLES_RAD)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_log_gives_the_angle_back_from_either_sign(angle, sign):
    q = (sign * cos(angle / 2), 0.0, 0.0, sign * sin(angle / 2))
    assert log(q)[2] == pytest.approx(angle, rel=1e-14, abs=1e-15)
