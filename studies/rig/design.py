"""Find where on a spinning body the accelerometers should sit (Asghari et al. 2018, section 3.2 and eq (27)).

The longer the lever arms, the smaller the variances Q and R of eq (25); the range of the accelerometers and the room
there is end them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Floats, SpinGeometry
from stillpoint.datasets.spin import bench, channels, compute_specific_force, make_five_accelerometers

_GEOMETRIES: dict[str, Callable[[float, float, float], SpinGeometry]] = {
    "bench": bench,
    "five": make_five_accelerometers,
}
_LENGTH_STEP_M = 0.01  # arms are chosen in whole centimetres


@dataclass(frozen=True)
class Rig:
    """The motion to be measured, and the sensors."""

    geometry: str = "bench"  # of GEOMETRIES
    fastest_radps: float = float(np.deg2rad(2000))
    spin_up_s: float = 0.2  # from standstill to the fastest
    range_mps2: float = 16 * STANDARD_GRAVITY_MPS2
    headroom: float = 0.2  # share of the range that is left for ripple
    room_m: float = 0.5  # the longest arm there is room for
    radial_var_m2ps4: float = 0.8  # D4
    tangential_var_m2ps4: float = 0.12  # D5, and that of the accelerometers at the centre
    period_s: float = 0.004

    def __post_init__(self) -> None:
        """Check all values; raises :class:`BadParameter`."""
        if self.geometry not in _GEOMETRIES:
            raise BadParameter(f"geometry {self.geometry!r}: give one of {', '.join(_GEOMETRIES)}")
        if not 0 <= self.headroom < 1:
            raise BadParameter(f"headroom {self.headroom:g}: give a share from 0 up to below 1")
        for name, value in vars(self).items():
            if name not in ("geometry", "headroom") and not (np.isfinite(value) and value > 0):
                raise BadParameter(f"{name} {value:g}: give a positive number")

    @property
    def spin_up_radps2(self) -> float:
        """The angular acceleration to be measured, in rad/s²."""
        return self.fastest_radps / self.spin_up_s


@dataclass(frozen=True)
class Placement:
    """Two lever arms and the accuracy that they give at the fastest rate."""

    d1_m: float
    d2_m: float
    radial_share: float  # of the range that F4 uses at the fastest rate
    tangential_share: float  # that F5 uses while spinning up
    fits: bool  # both within the range less its headroom, and the arms within the room
    r_rad2ps4: float  # variance of the squared rate, eq (25)
    q_rad2ps4: float  # variance of the angular acceleration
    raw_rate_sd_radps: float  # of the square root of one sample of the squared rate
    filtered_rate_sd_radps: float  # of the Kalman filter in its steady state
    rate_per_bias: float  # rate error in rad/s for each m/s^2 of a bias of F4
    rate_per_arm: float  # rate error in rad/s for each m of an error of d1


def evaluate_placement(rig: Rig, d1_m: float, d2_m: float) -> Placement:
    """Evaluate the lever arms d1 of F4 and d2 of F5."""
    geometry = _GEOMETRIES[rig.geometry](d1_m, d2_m, rig.range_mps2)
    variance = np.full(len(geometry.accel_r_b_m), rig.tangential_var_m2ps4)
    variance[-2] = rig.radial_var_m2ps4
    by = channels(geometry, variance)
    radial, tangential = _compute_range_shares(rig, geometry)[-2:]
    slope = 1 / (2 * rig.fastest_radps)  # d(rate)/d(squared rate)
    raw_sd = float(np.sqrt(by.r_rad2ps4) * slope)
    usable = 1 - rig.headroom
    return Placement(
        d1_m=d1_m,
        d2_m=d2_m,
        radial_share=float(radial),
        tangential_share=float(tangential),
        fits=bool(radial <= usable and tangential <= usable and max(d1_m, d2_m) <= rig.room_m),
        r_rad2ps4=by.r_rad2ps4,
        q_rad2ps4=by.q_rad2ps4,
        raw_rate_sd_radps=raw_sd,
        filtered_rate_sd_radps=float(np.sqrt(compute_steady_variance(rig.period_s**2 * by.q_rad2ps4, raw_sd**2))),
        rate_per_bias=float(abs(by.omega_squared.accel[-2]) * slope),
        rate_per_arm=float(rig.fastest_radps / (2 * d1_m)),
    )


def _compute_range_shares(rig: Rig, geometry: SpinGeometry) -> Floats:
    """Return the part of its range (k,) that each accelerometer uses, at full speed or while spinning up from rest.

    Linear acceleration of the centre is not counted.
    """
    x, nothing = np.array([1.0, 0.0, 0.0]), np.zeros(3)
    full = compute_specific_force(geometry.accel_r_b_m, nothing, rig.fastest_radps * x, nothing)
    start = compute_specific_force(geometry.accel_r_b_m, nothing, nothing, rig.spin_up_radps2 * x)
    felt = [np.abs(np.sum(force * geometry.accel_axis_b, axis=1)) for force in (full, start)]
    return np.maximum(*felt) / rig.range_mps2


def compute_steady_variance(step: float, observation: float) -> float:
    """Return the variance after the update in the steady state of a random walk: p = m r/(m + r), m = p + q."""
    before = 0.5 * (step + np.sqrt(step**2 + 4 * step * observation))
    return float(before * observation / (before + observation))


def find_longest_arms(rig: Rig) -> Placement:
    """Return the placement with the longest arms that fit, in whole centimetres: by (27) the most accurate.

    Raises :class:`BadParameter` where not even one centimetre fits.
    """
    shortest = _GEOMETRIES[rig.geometry](_LENGTH_STEP_M, _LENGTH_STEP_M, rig.range_mps2)
    used = _compute_range_shares(rig, shortest)[-2:]  # in proportion to the arm
    lengths_m = np.minimum(_LENGTH_STEP_M * (1 - rig.headroom) / used, rig.room_m)
    whole = np.floor(lengths_m / _LENGTH_STEP_M + 1e-9) * _LENGTH_STEP_M
    if (whole < _LENGTH_STEP_M).any():
        raise BadParameter(
            f"at {np.rad2deg(rig.fastest_radps):.4g} deg/s an arm of 1 cm already uses {100 * used.max():.0f} % of the "
            "range, or there is no room for it: take accelerometers with a larger range"
        )
    return evaluate_placement(rig, *(round(float(one), 4) for one in whole))


def compute_limits_m(rig: Rig) -> tuple[float, float]:
    """Return the arms d1 and d2 at which F4 and F5 read the whole range."""
    used = _compute_range_shares(rig, _GEOMETRIES[rig.geometry](1.0, 1.0, rig.range_mps2))[-2:]
    return float(1 / used[0]), float(1 / used[1])
