"""Is the solution one that a sensor can have? An optimum exists for swapped axes too: it only fits nothing.

What separates them was measured on 12 BROAD trials, 10 Tyrex phones and the simulated phones, as they are and with
swapped or turned axes. The mean square of the IMU's residuals in motion, over what the noise sizes allow, is 0.00003 to
0.005 for good recordings and 0.01 to 3 for spoiled ones; calibration and biases stay within 3.4 of their sd, or go to
5 to 100; the field fits within 4.1 uT, or is missed by more in a third of the measurements.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import H, M

from stillpoint.datasets.earth import magnetic_field_n_ut
from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats, Info
from stillpoint.datasets.trajectory import BasePoseReturn, Calibration
from stillpoint.smoother.attitude.keys import Keys
from stillpoint.smoother.attitude.magnetometer import weights
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.solve import Solution
from stillpoint.smoother.base_pose import BasePose, Returns

IMU_LIMIT = 0.025  # mean square of the IMU's residuals in motion, over what the noise sizes allow
DOUBT_SD = 2.0  # of the gyro's calibration; good sensors: 0.4 to 1.8, a phone's gyro that is 5 % off: 6.5
SURPRISE_LIMIT_SD = 3.0  # the same with the prior of a raw sensor
LEAST_LEARNT = 0.01  # share of an element's prior variance: less is lost in rounding
PRIOR_LIMIT_SD = 5.0  # calibration and biases, of their prior's sd
INLIER_SHARE = 0.75  # of the field's measurements; an attached magnet leaves 0.57, whose median is small though
MISFIT_LIMIT_SD = 0.9  # the median size of the field's residuals, of ``FieldParams.sd_ut``
RAW_MISFIT_LIMIT_SD = 0.7  # the same for a raw sensor, which bends to a disturbed field: good ones stay below 0.5
DIP_LIMIT_RAD = np.deg2rad(45.0)  # of the field's inclination against the place's
RETURN_LIMIT_SD = 3.0  # where the robust kernel of a return halves its weight
ADVICE = "run the doctor: an axis, sign, scale, unit or clock may be wrong"

KINDS = {
    gtsam.ImuFactor: "imu",
    gtsam.BetweenFactorConstantBias: "bias walk",
    gtsam.PriorFactorVector: "velocity and calibration",
    gtsam.GPSFactor: "position",
    gtsam.BetweenFactorPose3: "rests, returns and gaps",
}


class Contradiction(Unobservable):
    """Sensors contradict each other, as ``found`` says. Without the magnetometer they may not.

    ``of_field``: gyro and accelerometer agree.
    """

    def __init__(self, name: str, found: str, of_field: bool = False, advice: str = ADVICE) -> None:
        super().__init__(f"{name}: {found}; {advice}")
        self.found = found
        self.of_field = of_field


@dataclass(frozen=True)
class Fit:
    """How well a solution fits its data."""

    squares: dict[str, float]  # mean square of normalised residuals per degree of freedom, by kind of factor
    field_inlier_share: float | None  # of the magnetometer's measurements; None without one
    field_misfit_ut: float | None  # median size of their residuals


def fit_of(
    graph: gtsam.NonlinearFactorGraph, inherited: int, solution: Solution, keys: Keys, params: GraphParams
) -> Fit:
    """Residuals by kind of factor: "imu" is in motion and not clipped.

    The last ``inherited`` factors sum up the window's past: their residuals belong to the windows before.
    """
    total: dict[str, list[float]] = {}
    clipped = keys.clipped
    for i in range(graph.size() - inherited):
        factor = graph.at(i)
        if isinstance(factor, gtsam.LinearContainerFactor):
            continue  # its error without a point of linearisation is always nought
        kind = KINDS.get(type(factor), "anchors")
        if kind == "imu":
            state = gtsam.Symbol(factor.keys()[0]).index()
            kind = "imu at rest" if keys.at_rest[state] else "imu clipped" if clipped[state] else "imu"
        degrees = 9 if isinstance(factor, gtsam.ImuFactor) else factor.dim()  # gtsam names only its first part's
        total.setdefault(kind, []).append(2 * factor.error(solution.values) / degrees)
    squares = {kind: float(np.mean(values)) for kind, values in total.items()}
    residual = solution.field_residual_ut
    if residual is None:
        return Fit(squares, None, None)
    inlier = weights(residual, params.magnetic.sd_ut, params.magnetic) > 0.5
    return Fit(squares, float(inlier.mean()), float(np.median(np.linalg.norm(residual, axis=1))))


def refuse_contradictions(
    fit: Fit, solution: Solution, bias_b_radps: Floats, info: Info, name: str, params: GraphParams
) -> None:
    """Raise :class:`Contradiction` when no sensor can be as the solution says, :class:`Unobservable` for a wrong sign.

    ``bias_b_radps`` (3,) is where the gyro's bias began.
    """
    inertial = _inertial(fit, solution, bias_b_radps, params)
    found = inertial or _disturbed(fit, params)
    if found:
        raise Contradiction(name, found, of_field=not inertial)
    upside_down = _dip(fit, solution, info)
    if upside_down:
        raise Unobservable(f"{name}: {upside_down}; {ADVICE}")


def refuse_fixes(believed_share: float, name: str) -> None:
    """Raise :class:`Contradiction` when most of a window's satellite fixes are not believed."""
    if believed_share < INLIER_SHARE:
        useless = 100 * (1 - believed_share)
        raise Contradiction(name, f"the satellite fixes contradict gyro and accelerometer ({useless:.0f} % are off)")


def _inertial(fit: Fit, solution: Solution, bias_b_radps: Floats, params: GraphParams) -> str:
    p = params.inertial
    if fit.squares.get("imu", 0.0) > IMU_LIMIT:
        times = np.sqrt(fit.squares["imu"] / IMU_LIMIT)
        return f"gyro and accelerometer contradict each other ({times:.1f} times the residuals that a sensor may have)"
    vector = solution.values.atVector(M(0))
    sizes = {
        "accelerometer's scale and axes": (vector[:9], p.accel_matrix_sd, 100.0, "%"),
        "gyro's scale and axes": (vector[9:18], p.gyro_matrix_sd, 100.0, "%"),
        "accelerometer's clock": (vector[18:19], p.accel_late_sd_s, 1e3, "ms"),
    }
    biases = [key for key in solution.values.keys() if gtsam.Symbol(key).chr() == ord("b")]  # noqa: SIM118 - not a dict
    if biases:
        bias = np.array([solution.values.atConstantBias(key).vector() for key in biases])
        sizes["accelerometer's bias"] = (bias[:, :3], p.accel_bias_sd_mps2, 1.0, "m/s^2")
        moved = bias[:, 3:] - bias_b_radps
        sizes["gyro's bias"] = (moved, p.gyro_bias_sd_radps, float(np.rad2deg(1.0)), "deg/s")
    for what, (values, sd, factor, unit) in sizes.items():
        largest = float(np.abs(values).max())
        if largest > PRIOR_LIMIT_SD * sd:
            return f"to fit the data the {what} would have to be off by {largest * factor:.2g} {unit}"
    return ""


def surprise(calibration: Calibration, params: GraphParams) -> float:
    """How far an element of the gyro's matrix went from its prior, in units of how far it was to be expected to go.

    That is, squared, the prior's variance less what is left of it: an element that the data hardly show must hardly
    move. A gyro that turns about one axis only and reads a fifth too much is seen by the magnetometer alone, and moves
    by less than its prior's sd; it is this that gives it away.
    """
    assert calibration.gyro_matrix is not None
    assert calibration.gyro_matrix_sd is not None
    prior = params.inertial.gyro_matrix_sd
    moved = (calibration.gyro_matrix - np.eye(3)) / prior
    learnt = np.maximum(1 - (calibration.gyro_matrix_sd / prior) ** 2, LEAST_LEARNT)
    return float(np.max(np.abs(moved) / np.sqrt(learnt)))


def refuse_surprise(calibration: Calibration, limit_sd: float, name: str, params: GraphParams) -> None:
    """Raise :class:`Unobservable` when the data contradict the prior of the gyro's calibration."""
    found = surprise(calibration, params)
    if found > limit_sd:
        raise Unobservable(
            f"{name}: the gyro's scale or axes contradict the other sensors ({found:.1f} sd from what a gyro may "
            f"have); {ADVICE}"
        )


def raw_sensor(params: GraphParams) -> GraphParams | None:
    """The same for a sensor that nobody calibrated; None where the settings allow for one already."""
    p = params.inertial
    if p.raw_matrix_sd <= max(p.gyro_matrix_sd, p.accel_matrix_sd):
        return None
    return replace(params, inertial=replace(p, gyro_matrix_sd=p.raw_matrix_sd, accel_matrix_sd=p.raw_matrix_sd))


def _disturbed(fit: Fit, params: GraphParams) -> str:
    if fit.field_inlier_share is None or fit.field_misfit_ut is None:
        return ""
    limit_sd = MISFIT_LIMIT_SD if raw_sensor(params) is not None else RAW_MISFIT_LIMIT_SD
    if fit.field_inlier_share >= INLIER_SHARE or fit.field_misfit_ut <= limit_sd * params.magnetic.sd_ut:
        return ""
    return (
        f"the magnetometer contradicts the gyro (half of its readings are more than {fit.field_misfit_ut:.0f} uT "
        f"off, {100 * (1 - fit.field_inlier_share):.0f} % are useless)"
    )


def _dip(fit: Fit, solution: Solution, info: Info) -> str:
    if fit.field_misfit_ut is None or info.place_lat_lon_alt is None or not info.date:
        return ""
    east, north, up = solution.values.atVector(H(0))[:3]
    there = magnetic_field_n_ut(info.place_lat_lon_alt, info.date)
    found_rad = np.arctan2(-up, np.hypot(east, north))
    known_rad = np.arctan2(-there[2], np.hypot(*there[:2]))
    if abs(found_rad - known_rad) <= DIP_LIMIT_RAD:
        return ""
    return (
        f"the field dips by {np.rad2deg(found_rad):.0f} deg, at this place it does by {np.rad2deg(known_rad):.0f}; "
        "accelerometer or magnetometer has the wrong sign"
    )


def judged_again(base: BasePose, returns: Returns, q_nb: Floats, params: GraphParams) -> tuple[BasePoseReturn, ...]:
    """The verdicts with the solution's attitudes (N, 4): returns whose weight the robust kernel halved are rejected."""
    limit_rad = RETURN_LIMIT_SD * params.returns.repeat_sd_rad
    base_b = rotation(q_nb[(base.start + base.end) // 2]).inv()
    off_rad = iter([float((base_b * rotation(q_nb[sum(span) // 2])).magnitude()) for span in returns.spans])
    return tuple(_judged(each, next(off_rad) if each.accepted else 0.0, limit_rad) for each in returns.verdicts)


def _judged(verdict: BasePoseReturn, off_rad: float, limit_rad: float) -> BasePoseReturn:
    if off_rad <= limit_rad:
        return verdict
    off, limit = np.rad2deg(off_rad), np.rad2deg(limit_rad)
    reason = f"{verdict.reason}; the other data put it {off:.1f} deg off, above {limit:.1f}: not the base pose"
    return replace(verdict, accepted=False, reason=reason)


def mean_fit(fits: Sequence[Fit]) -> Fit:
    """Of several windows."""
    kinds = {kind for fit in fits for kind in fit.squares}
    squares = {k: float(np.mean([fit.squares[k] for fit in fits if k in fit.squares])) for k in sorted(kinds)}
    shares = [fit.field_inlier_share for fit in fits if fit.field_inlier_share is not None]
    misfits = [fit.field_misfit_ut for fit in fits if fit.field_misfit_ut is not None]
    return Fit(squares, float(np.mean(shares)) if shares else None, float(np.mean(misfits)) if misfits else None)
