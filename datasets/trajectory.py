"""The results made from a recording: :class:`Reference` (smoother), :class:`SpinReference`, :class:`Estimate`.

Frames, units and clocks as in :mod:`stillpoint.datasets.recording`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import (
    Floats,
    Times,
    check_bools,
    check_floats,
    check_quaternions,
    check_times,
    describe_times,
    freeze,
)

CONVENTION = "n = East-North-Up, b = sensor body, q_nb takes b to n, Hamilton; covariance of the rotation in b, rad^2"


@dataclass(frozen=True)
class BasePoseReturn:
    """One rest that was compared with the base pose, and the outcome."""

    start_ns: int
    end_ns: int
    tilt_difference_rad: float  # of gravity's direction against the base's
    accepted: bool
    reason: str


@dataclass(frozen=True, eq=False)
class Calibration:
    """The sensor errors that the smoother found; None where one was not estimated.

    Corrected rate = gyro_matrix @ (measured - bias), specific force likewise, field = mag_matrix @ (measured - iron).
    """

    gyro_matrix: Floats | None = None  # (3, 3)
    gyro_matrix_sd: Floats | None = None  # (3, 3)
    accel_matrix: Floats | None = None  # (3, 3)
    accel_matrix_sd: Floats | None = None  # (3, 3)
    matrix_covariance: Floats | None = None  # (18, 18) of the elements by rows, accelerometer first
    accel_bias_b_mps2: Floats | None = None  # (3,)
    mag_matrix: Floats | None = None  # (3, 3)
    hard_iron_b_ut: Floats | None = None  # (3,)
    field_n_ut: Floats | None = None  # (3,)
    clock_offset_s: Mapping[str, float] = field(default_factory=dict)  # stream -> late (+) against the gyro


@dataclass(frozen=True, eq=False)
class Reference:
    """Attitude at every IMU sample with its covariance, and how it was made.

    With satellite fixes it also has position and velocity, all four columns or none: East-North-Up from ``origin``.
    """

    t_ns: Times
    q_nb: Floats  # (N, 4) wxyz
    cov_b_rad2: Floats  # (N, 3, 3) of the small rotation d in q_true = q_nb * exp(d), d in body axes
    gyro_bias_b_radps: Floats  # (N, 3)
    method: str
    name: str = ""  # of the recording
    position_n_m: Floats | None = None  # (N, 3) of the IMU
    velocity_n_mps: Floats | None = None  # (N, 3)
    position_cov_n_m2: Floats | None = None  # (N, 3, 3)
    velocity_cov_n_m2ps2: Floats | None = None  # (N, 3, 3)
    origin_lat_lon_alt: tuple[float, float, float] | None = None  # deg, deg, m of position 0 0 0
    heading_sd_rad: float = 0.0  # of a heading error that all samples share; not contained in cov_b_rad2
    mounting_cov_b_rad2: Floats = field(default_factory=lambda: np.zeros((3, 3)))  # of a turn in body axes that all
    # samples share; not contained in cov_b_rad2
    calibration: Calibration = field(default_factory=Calibration)
    rests_ns: Times = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))  # (R, 2) first, last stamp
    returns: tuple[BasePoseReturn, ...] = ()
    params: Mapping[str, Any] = field(default_factory=dict)
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    made_from: Mapping[str, str] = field(default_factory=dict)  # file name -> sha256

    def __post_init__(self) -> None:
        """Check and freeze the arrays; raises :class:`BadRecording` for a variance that is not positive."""
        t = check_times("reference", self.t_ns)
        q_nb = check_quaternions("reference", "q_nb", self.q_nb, (len(t), 4))
        cov = check_floats("reference", "cov_b_rad2", self.cov_b_rad2, (len(t), 3, 3))
        bias = check_floats("reference", "gyro_bias_b_radps", self.gyro_bias_b_radps, (len(t), 3))
        mounting = check_floats("reference", "mounting_cov_b_rad2", self.mounting_cov_b_rad2, (3, 3))
        rests = np.asarray(self.rests_ns, dtype=np.int64).reshape(-1, 2)
        if not _has_variances(cov):
            raise BadRecording("reference.cov_b_rad2: a variance is not positive; a reference states its accuracy")
        freeze(self, t_ns=t, q_nb=q_nb, cov_b_rad2=cov, gyro_bias_b_radps=bias, rests_ns=rests)
        freeze(self, mounting_cov_b_rad2=mounting)
        shapes = {
            "position_n_m": (3,), "velocity_n_mps": (3,), "position_cov_n_m2": (3, 3), "velocity_cov_n_m2ps2": (3, 3),
        }  # fmt: skip
        given = {name: getattr(self, name) for name in shapes if getattr(self, name) is not None}
        if given and (len(given) < len(shapes) or self.origin_lat_lon_alt is None):
            raise BadRecording("reference: give position, velocity, both covariances and the origin, or none of them")
        for name, column in given.items():
            array = check_floats("reference", name, column, (len(t), *shapes[name]))
            if "cov" in name and not _has_variances(array):
                raise BadRecording(f"reference.{name}: a variance is not positive; a reference states its accuracy")
            freeze(self, **{name: array})

    def __repr__(self) -> str:
        """Return stamps, stated accuracy and returns in one line."""
        sd_deg, heading_deg = np.rad2deg([np.median(compute_total_sd_rad(self.cov_b_rad2)), self.heading_sd_rad])
        words = f"{describe_times(self.t_ns)}; sd of the attitude {sd_deg:.2g} deg (median)"
        words += f", of the heading that all share {heading_deg:.2g} deg" if self.heading_sd_rad else ""
        kept = sum(one.accepted for one in self.returns)
        returns = f", {kept} of {len(self.returns)} returns to the base pose used" if self.returns else ""
        position = "; with position and velocity" if self.position_n_m is not None else ""
        return f"<Reference of {self.name} by {self.method}: {words}; {len(self.rests_ns)} rests{returns}{position}>"

    @property
    def velocity_b_mps(self) -> Floats | None:
        """The velocity (N, 3) in body axes, as ROS states the twist of a child frame; None where there is none."""
        if self.velocity_n_mps is None:
            return None
        return np.asarray(rotation(self.q_nb).inv().apply(self.velocity_n_mps.copy()))

    @property
    def velocity_cov_b_m2ps2(self) -> Floats | None:
        """The covariance (N, 3, 3) of the velocity in body axes; None where there is none."""
        if self.velocity_cov_n_m2ps2 is None:
            return None
        turn = rotation(self.q_nb).as_matrix()
        return np.asarray(turn.transpose(0, 2, 1) @ self.velocity_cov_n_m2ps2 @ turn)


def _has_variances(cov_b_rad2: Floats) -> bool:
    """Return whether the diagonals of covariances (N, 3, 3) are positive."""
    return bool((np.diagonal(cov_b_rad2, axis1=1, axis2=2) > 0).all())


def compute_total_sd_rad(cov_b_rad2: Floats) -> Floats:
    """Return the standard deviation (N,) of the total attitude error with the covariances (N, 3, 3)."""
    return np.asarray(np.sqrt(np.trace(cov_b_rad2, axis1=-2, axis2=-1)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SpinReference:
    """Angle and rate about the spin axis with their standard deviations."""

    t_ns: Times
    angle_rad: Floats  # (N,) unwrapped
    rate_radps: Floats  # (N,)
    angle_sd_rad: Floats  # (N,)
    rate_sd_radps: Floats  # (N,)
    method: str
    name: str = ""
    params: Mapping[str, Any] = field(default_factory=dict)
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    made_from: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check and freeze the arrays; raises :class:`BadRecording`."""
        t = check_times("roll reference", self.t_ns)
        names = ("angle_rad", "rate_radps", "angle_sd_rad", "rate_sd_radps")
        columns = {name: check_floats("roll reference", name, getattr(self, name), (len(t),)) for name in names}
        freeze(self, t_ns=t, **columns)

    def __repr__(self) -> str:
        sd_deg = np.rad2deg(np.median(self.angle_sd_rad))
        words = f"{describe_times(self.t_ns)}; sd {sd_deg:.2g} deg (median of the angle)"
        return f"<SpinReference of {self.name} by {self.method}: {words}>"


@dataclass(frozen=True, eq=False)
class Estimate:
    """The output of one streaming estimator at every sample: an attitude, or an angle and a rate about one axis."""

    t_ns: Times
    name: str  # the estimator's, as in the table ESTIMATORS
    q_nb: Floats | None = None  # (N, 4) wxyz
    angle_rad: Floats | None = None  # (N,)
    rate_radps: Floats | None = None  # (N,)
    angle_sd_rad: Floats | None = None  # (N,)
    rate_sd_radps: Floats | None = None  # (N,)
    cov_b_rad2: Floats | None = None  # (N, 3, 3)
    innovation: Floats | None = None  # (N, m) normalised; NaN rows where there was no update
    gyro_bias_b_radps: Floats | None = None  # (N, 3)
    ready: NDArray[np.bool_] | None = None  # (N,) False while the estimator says that it is still starting
    recording: str = ""
    params: Mapping[str, Any] = field(default_factory=dict)
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    ns_per_sample: float = float("nan")
    made_from: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check and freeze the arrays; raises :class:`BadRecording` without attitude and angle."""
        t = check_times("estimate", self.t_ns)
        n = len(t)
        if self.q_nb is None and self.angle_rad is None:
            raise BadRecording(f"estimate {self.name}: has neither an attitude nor an angle; give q_nb or angle_rad")
        if self.q_nb is not None:
            freeze(self, q_nb=check_quaternions("estimate", "q_nb", self.q_nb, (n, 4)))
        columns = ("angle_rad", "rate_radps", "angle_sd_rad", "rate_sd_radps")
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(columns, (n,))
        shapes |= {"cov_b_rad2": (n, 3, 3), "gyro_bias_b_radps": (n, 3)}
        for name, shape in shapes.items():
            if getattr(self, name) is not None:
                freeze(self, **{name: check_floats("estimate", name, getattr(self, name), shape)})
        if self.cov_b_rad2 is not None and not _has_variances(self.cov_b_rad2):
            raise BadRecording(
                f"estimate {self.name}: a variance is not positive; leave cov_b_rad2 out where none is stated"
            )
        if self.innovation is not None:
            width = np.shape(self.innovation)[-1]
            freeze(
                self,
                innovation=check_floats("estimate", "innovation", self.innovation, (n, width), finite=False),
            )
        if self.ready is not None:
            freeze(self, ready=check_bools("estimate", "ready", self.ready, n))
        freeze(self, t_ns=t)

    def __repr__(self) -> str:
        """Return name, stamps and columns in one line."""
        names = ("q_nb", "angle_rad", "rate_radps", "cov_b_rad2", "gyro_bias_b_radps", "ready")
        columns = ", ".join(name for name in names if getattr(self, name) is not None)
        of = f" of {self.recording}" if self.recording else ""
        return f"<Estimate {self.name}{of}: {describe_times(self.t_ns)}; {columns}>"
