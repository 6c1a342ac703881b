"""Judge a solution: can a real sensor have produced it? Swapped axes have an optimum too, but it fits nothing.

The limits were measured on 12 BROAD trials, 10 Tyrex phones and the simulated phones, as they are and with swapped or
turned axes. The mean square of the IMU's residuals in motion, relative to the noise settings, is 0.00003 to 0.005 for
good recordings and 0.01 to 3 for spoiled ones; calibration and biases stay within 3.4 of their sd, or reach 5 to 100;
the field fits within 4.1 uT, or a third of the measurements miss it by more.

If the magnetometer contradicts gyro and accelerometer, either its axes are wrong or the place is full of iron. Iron
turns the field from place to place; wrong axes turn it with the body. The doctor's witness tells the two apart: window
by window, does the change of the field fit the gyro best with the axes as they are? On 12 BROAD trials with their own
magnets and with dipoles beside or amid the path it found the axes right 108 of 110 times, and never with swapped or
flipped axes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import H, M
from numpy.typing import NDArray

from stillpoint.datasets.doctor.witness import ask_mag
from stillpoint.datasets.earth import local_field_n_ut
from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats, Imu, Info, Mag, Recording
from stillpoint.datasets.trajectory import Calibration
from stillpoint.smoother.attitude.build import Graph
from stillpoint.smoother.attitude.chain import split_squares
from stillpoint.smoother.attitude.evidence import Evidence, with_free_priors
from stillpoint.smoother.attitude.keys import Keys
from stillpoint.smoother.attitude.magnetometer import find_inliers
from stillpoint.smoother.attitude.outside.added import ADDED, CONTRADICTS
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.solve import NoOptimum, Solution

_IMU_LIMIT = 0.025  # mean square of the IMU's residuals in motion, relative to the noise settings
_SURPRISE_LIMIT_SD = 2.0  # of the gyro's calibration; good sensors: 0.4 to 1.8, a phone's gyro 5 % off: 6.5
_LEAST_LEARNT = 0.01  # share of an element's prior variance: less is lost in rounding
_PRIOR_LIMIT_SD = 5.0  # largest deviation of calibration and biases, in sd of their priors
INLIER_SHARE = 0.75  # of the field's measurements; an attached magnet leaves 0.57, but with a small median residual
_USELESS_SHARE = 0.12  # of the field's measurements: with fewer that fit there is no field to speak of
_MISFIT_LIMIT_SD = 0.9  # largest median residual of the field, in units of ``FieldParams.sd_ut``
_RAW_MISFIT_LIMIT_SD = 0.7  # the same for a raw sensor, which bends to a disturbed field: good ones stay below 0.5
_WIDE = 1.5  # times ``FieldParams.sd_ut``: the sd of a reading from which on errors of the field are said to last
_TYPICAL = 1.1  # times ``FieldParams.sd_ut``: the median residual from which on the same is said; clean phones: 0.7
_DIP_LIMIT_RAD = np.deg2rad(45.0)  # between the dip of the field found and that of the place
_MINUTE_NS = 60 * 10**9
_APART_NS = 10 * 10**9  # a gap in a stream of any rate
_JUDGED_NS = 12 * _MINUTE_NS  # of a recording, by which the axes of its magnetometer are judged
_ADVICE = "run the doctor: an axis, sign, scale, unit or clock may be wrong"
_LEAVE_OUT = "--set magnetic.use=false leaves the magnetometer out all the same"

_KINDS = {
    gtsam.BetweenFactorConstantBias: "bias walk",
    gtsam.PriorFactorVector: "velocity and calibration",
    gtsam.GPSFactor: "position",
    gtsam.BetweenFactorPose3: "rests, returns and gaps",
}


class Contradiction(Unobservable):
    """The sensors contradict each other, as ``found`` says; without the magnetometer they may agree.

    ``of_field`` is true where gyro and accelerometer agree.
    """

    def __init__(self, name: str, found: str, of_field: bool = False, advice: str = _ADVICE) -> None:
        super().__init__(f"{name}: {found}; {advice}")
        self.found = found
        self.of_field = of_field


@dataclass(frozen=True)
class SensorPriors:
    """Settings with priors for one class of sensor, and the largest surprise of the gyro that they allow."""

    params: GraphParams
    surprise_limit_sd: float | None  # None: no limit


@dataclass(frozen=True)
class Fit:
    """How well a solution fits its data."""

    squares: dict[str, float]  # mean square of normalised residuals per degree of freedom, by kind of factor
    field_inlier_share: float | None  # of the magnetometer's measurements; None without a magnetometer
    field_misfit_ut: float | None  # median size of their residuals
    field_sd_ut: float | None  # median sd with which they count


def priors_to_try(params: GraphParams, evidence: Evidence) -> list[SensorPriors]:
    """Return the priors to try in turn: those of a good sensor, of a raw one, and of a very raw one.

    Each wider prior is used only if the data contradict the narrower ones, so that an answer never rests on slack.
    Priors that are not wider than the settings' own are left out.
    """
    params = with_free_priors(params, evidence)
    p = params.inertial
    sizes = [sd for sd in (p.raw_matrix_sd, p.rawest_matrix_sd) if sd > max(p.gyro_matrix_sd, p.accel_matrix_sd)]
    if not sizes:
        return [SensorPriors(params, None)]
    raw = replace(p, gyro_scale_sd=0.0)
    wider = [replace(params, inertial=replace(raw, gyro_matrix_sd=sd, accel_matrix_sd=sd)) for sd in sizes]
    return [SensorPriors(each, _SURPRISE_LIMIT_SD) for each in (params, *wider)]


def measure_fit(graph: Graph, added: int, solution: Solution, keys: Keys, params: GraphParams) -> Fit:
    """Return the residuals of a solution by kind of factor; "imu" is in motion and not clipped.

    The last ``added`` factors are those that users added, which have kinds of their own.
    """
    alike: dict[tuple[str, int], gtsam.NonlinearFactorGraph] = {}  # by kind and degrees of freedom
    for i in range(graph.others.size() - added):
        factor = graph.others.at(i)
        kind, degrees = _KINDS.get(type(factor), "anchors"), factor.dim()
        if (kind, degrees) not in alike:
            alike[kind, degrees] = gtsam.NonlinearFactorGraph()
        alike[kind, degrees].push_back(factor)
    total = _sum_chain(graph, solution, keys)
    for (kind, degrees), some in alike.items():
        square, count = total.get(kind, (0.0, 0))
        total[kind] = (square + 2 * some.error(solution.values) / degrees, count + some.size())
    squares = {kind: square / count for kind, (square, count) in total.items()}
    residual = solution.field_residual_ut
    if residual is None:
        return Fit(squares, None, None, None)
    inlier = find_inliers(residual, params.magnetic)
    misfit_ut = float(np.median(np.linalg.norm(residual, axis=1)))
    return Fit(squares, float(inlier.mean()), misfit_ut, solution.field_sd_ut)


def _sum_chain(graph: Graph, solution: Solution, keys: Keys) -> dict[str, tuple[float, int]]:
    """Return sum and number of the squared residuals per degree of freedom of the chain, by kind."""
    found, interval = split_squares(graph.chain, solution.rows.data), graph.chain.interval
    at_rest, clipped = keys.at_rest[interval], keys.clipped[interval]
    parts = {
        "imu at rest": found.imu[at_rest] / 9,
        "imu clipped": found.imu[clipped & ~at_rest] / 9,
        "imu": found.imu[~clipped & ~at_rest] / 9,
        "velocity and calibration": found.speed / 3,
        "position": found.place / 3,
    }
    return {kind: (float(part.sum()), len(part)) for kind, part in parts.items() if len(part)}


def average_fits(fits: Sequence[Fit]) -> Fit:
    """Return the mean of the fits of several windows."""
    kinds = {kind for fit in fits for kind in fit.squares}
    squares = {k: float(np.mean([fit.squares[k] for fit in fits if k in fit.squares])) for k in sorted(kinds)}
    shares = [fit.field_inlier_share for fit in fits if fit.field_inlier_share is not None]
    misfits = [fit.field_misfit_ut for fit in fits if fit.field_misfit_ut is not None]
    sizes = [fit.field_sd_ut for fit in fits if fit.field_sd_ut is not None]
    return Fit(squares, *(float(np.mean(found)) if found else None for found in (shares, misfits, sizes)))


def refuse_contradictions(
    fit: Fit, solution: Solution, bias_b_radps: Floats, info: Info, name: str, params: GraphParams
) -> None:
    """Raise an error when no sensor can be as the solution says.

    ``bias_b_radps`` (3,) is the start value of the gyro's bias. Raises :class:`Contradiction` when the sensors
    contradict each other, :class:`Unobservable` when one of them has the wrong sign.
    """
    useless = _find_useless_field(fit)  # comes first: such a field drags gyro and accelerometer along
    found = useless or _find_inertial_contradiction(fit, solution, bias_b_radps, params)
    if found and (doubtful := find_contradicting_factors(fit.squares)):
        found = f"{found}; {', '.join(doubtful)} contradict the rest"
    if found:
        raise Contradiction(name, found, of_field=bool(useless))
    upside_down = _find_wrong_dip(fit, solution, info)
    if upside_down:
        raise Unobservable(f"{name}: {upside_down}; {_ADVICE}")


def find_contradicting_factors(squares: Mapping[str, float]) -> list[str]:
    """Return the generators of added factors ("added NAME") whose residuals contradict the rest."""
    return [name for name, square in squares.items() if name.startswith(ADDED) and square > CONTRADICTS]


def describe_disturbed_field(fit: Fit, params: GraphParams) -> str:
    """Return how far the magnetometer contradicts the gyro, "" if it does not.

    A solution in a disturbed field stands: the readings that contradict it have lost their weight, and the covariance
    counts on how long errors of the field last.
    """
    if fit.field_inlier_share is None or fit.field_misfit_ut is None:
        return ""
    raw = params.inertial.gyro_matrix_sd >= params.inertial.raw_matrix_sd
    limit_sd = _RAW_MISFIT_LIMIT_SD if raw else _MISFIT_LIMIT_SD
    if fit.field_inlier_share >= INLIER_SHARE or fit.field_misfit_ut <= limit_sd * params.magnetic.sd_ut:
        return ""
    return (
        f"the magnetometer contradicts the gyro (half of its readings are more than {fit.field_misfit_ut:.0f} uT "
        f"off, {100 * (1 - fit.field_inlier_share):.0f} % are useless)"
    )


def describe_lasting_errors(fit: Fit, params: GraphParams) -> str:
    """Return how large the field's errors are where the magnetometer's weight shows them, "" if they are ordinary."""
    if fit.field_sd_ut is None or fit.field_misfit_ut is None:
        return ""
    if fit.field_sd_ut >= _WIDE * params.magnetic.sd_ut:
        return (
            f"errors of the field last for seconds: a reading of the magnetometer counts with an sd of "
            f"{fit.field_sd_ut:.0f} uT"
        )
    if fit.field_misfit_ut >= _TYPICAL * params.magnetic.sd_ut:
        return f"half of the magnetometer's readings are more than {fit.field_misfit_ut:.0f} uT off"
    return ""


def refuse_disturbed_field(fit: Fit, name: str, params: GraphParams) -> None:
    """Raise :class:`Contradiction` when the magnetometer contradicts the gyro."""
    found = describe_disturbed_field(fit, params)
    if found:
        raise Contradiction(name, found, of_field=True)


def refuse_fixes(believed: NDArray[np.bool_], name: str) -> None:
    """Raise :class:`Contradiction` when most of a window's satellite fixes (K,) lose their weight."""
    if len(believed) and believed.mean() < INLIER_SHARE:
        useless = 100 * (1 - believed.mean())
        raise Contradiction(name, f"the satellite fixes contradict gyro and accelerometer ({useless:.0f} % are off)")


def measure_surprise(calibration: Calibration, params: GraphParams) -> float:
    """Return the largest deviation of the gyro's matrix from its prior, in units of its expected deviation.

    Deviations of the nine elements count, and those of each scale from the mean of the three, which a common scale
    keeps closer together. The expected variance of a deviation is its prior variance less its posterior variance: an
    element that the data hardly show must hardly move. Example: a gyro that turns about one axis only and reads a fifth
    too much. Only the magnetometer sees it, and its scale moves by less than the prior's sd; this measure finds it.
    """
    assert calibration.gyro_matrix is not None
    assert calibration.matrix_covariance is not None
    scales = np.eye(9)[::4]
    parts = np.concatenate([np.eye(9), scales - scales.mean(axis=0)])
    prior = _square_along(parts, params.inertial.gyro_matrix_covariance)
    learnt = np.maximum(prior - _square_along(parts, calibration.matrix_covariance[9:, 9:]), _LEAST_LEARNT * prior)
    moved = parts @ (calibration.gyro_matrix - np.eye(3)).ravel()
    return float(np.max(np.abs(moved) / np.sqrt(learnt)))


def _square_along(directions: Floats, covariance: Floats) -> Floats:
    """Return the variances (n,) along directions (n, k)."""
    return np.einsum("ni,ij,nj->n", directions, covariance, directions)


def refuse_surprise(calibration: Calibration, limit_sd: float, name: str, params: GraphParams) -> None:
    """Raise :class:`Unobservable` when the data contradict the prior of the gyro's calibration."""
    found = measure_surprise(calibration, params)
    if found > limit_sd:
        raise Unobservable(
            f"{name}: the gyro's scale or axes contradict the other sensors ({found:.1f} sd from what a gyro may "
            f"have); {_ADVICE}"
        )


def leave_out_magnetometer(recording: Recording, contradiction: Contradiction | NoOptimum) -> tuple[Recording, str]:
    """Return the recording without its magnetometer, and why; raise ``contradiction`` if its axes are wrong."""
    if recording.mag is None or not _axes_fit(recording):
        raise contradiction
    why = f"with it, {_describe(contradiction)}; its own axes fit the gyro, so the field is disturbed"
    return replace(recording, mag=None), why


def require_gyro_test(evidence: Evidence, contradiction: Contradiction | NoOptimum, name: str) -> None:
    """Raise :class:`Contradiction` where neither a return to the base pose nor satellites test the gyro.

    Without such a test, phones whose gyro was 3 % off were wrong by 13 deg, with 0.67 within the 95 % ellipsoid.
    """
    if evidence.fixes is not None or evidence.return_states()[1]:
        return
    if isinstance(contradiction, Contradiction) and not contradiction.of_field:
        raise contradiction
    found = f"{_describe(contradiction)}; the field is disturbed, and no return to the base pose tests the gyro instead"
    raise Contradiction(name, found, of_field=True, advice=_LEAVE_OUT)


def refuse_wrong_axes(recording: Recording, inlier_share: float | None) -> None:
    """Raise :class:`Contradiction` where a magnetometer with wrong axes fits well enough to pass the other tests.

    At rest any axes fit: in a recording that mostly rests, the misfits in motion are too few to show.
    """
    if inlier_share is not None and inlier_share < INLIER_SHARE and not _axes_fit(recording):
        useless = 100 * (1 - inlier_share)
        found = f"the magnetometer's axes do not turn as the gyro's ({useless:.0f} % are useless)"
        raise Contradiction(recording.name, found, of_field=True)


def _find_inertial_contradiction(fit: Fit, solution: Solution, bias_b_radps: Floats, params: GraphParams) -> str:
    """Return what gyro and accelerometer contradict, "" if nothing."""
    p = params.inertial
    if fit.squares.get("imu", 0.0) > _IMU_LIMIT:
        times = np.sqrt(fit.squares["imu"] / _IMU_LIMIT)
        return f"gyro and accelerometer contradict each other ({times:.1f} times the residuals that a sensor may have)"
    vector = solution.values.atVector(M(0))
    gyro_sd = np.sqrt(np.diagonal(p.gyro_matrix_covariance))
    sizes: dict[str, tuple[Floats, float | Floats, float, str]] = {
        "accelerometer's scale and axes": (vector[:9], p.accel_matrix_sd, 100.0, "%"),
        "gyro's scale and axes": (vector[9:18], gyro_sd, 100.0, "%"),
        "accelerometer's clock": (vector[18:19], p.accel_late_sd_s, 1e3, "ms"),
    }
    biases = [key for key in solution.values.keys() if gtsam.Symbol(key).chr() == ord("b")]  # noqa: SIM118 - not a dict
    if biases:
        bias = np.array([solution.values.atConstantBias(key).vector() for key in biases])
        sizes["accelerometer's bias"] = (bias[:, :3], p.accel_bias_sd_mps2, 1.0, "m/s^2")
        moved = bias[:, 3:] - bias_b_radps
        sizes["gyro's bias"] = (moved, p.gyro_bias_sd_radps, float(np.rad2deg(1.0)), "deg/s")
    for what, (values, sd, factor, unit) in sizes.items():
        if (np.abs(values) > _PRIOR_LIMIT_SD * sd).any():
            largest = float(np.abs(values).max())
            return f"to fit the data the {what} would have to be off by {largest * factor:.2g} {unit}"
    return ""


def _find_useless_field(fit: Fit) -> str:
    """Return that next to no reading of the magnetometer fits, "" if enough of them do."""
    if fit.field_inlier_share is None or fit.field_inlier_share >= _USELESS_SHARE:
        return ""
    useless = 100 * (1 - fit.field_inlier_share)
    return f"the magnetometer contradicts the gyro ({useless:.0f} % of its readings are useless)"


def _find_wrong_dip(fit: Fit, solution: Solution, info: Info) -> str:
    """Return how the field's dip contradicts the place, "" if it does not or if the place is unknown."""
    there, _ = local_field_n_ut(info)
    if fit.field_misfit_ut is None or there is None:
        return ""
    east, north, up = solution.values.atVector(H(0))[:3]
    found_rad = np.arctan2(-up, np.hypot(east, north))
    known_rad = np.arctan2(-there[2], np.hypot(*there[:2]))
    if abs(found_rad - known_rad) <= _DIP_LIMIT_RAD:
        return ""
    return (
        f"the field dips by {np.rad2deg(found_rad):.0f} deg, at this place it does by {np.rad2deg(known_rad):.0f}; "
        "accelerometer or magnetometer has the wrong sign"
    )


def _axes_fit(recording: Recording) -> bool:
    """Return whether the magnetometer turns as the gyro says; True also where it shows too little to tell."""
    imu, mag = recording.require_imu(), recording.mag
    if mag is None:
        return True
    choice = ask_mag(*_choose_minutes(imu, mag)).choice or ask_mag(imu, mag).choice
    return choice is None or bool(np.array_equal(choice.matrix, np.eye(3)))


def _choose_minutes(imu: Imu, mag: Mag) -> tuple[Imu, Mag]:
    """Return the minutes of a long recording by which its axes are judged, spread evenly over it.

    Axes do not change, and all windows of an hour would take half as long as solving it. The minutes are moved
    together, with gaps of ``_APART_NS`` between them.
    """
    first_ns = imu.t_ns[0]
    every = int(np.ceil((imu.t_ns[-1] - first_ns) / _JUDGED_NS))
    (imu_turn, imu_ns), (mag_turn, mag_ns) = (
        np.divmod(t_ns - first_ns, max(every, 1) * _MINUTE_NS) for t_ns in (imu.t_ns, mag.t_ns)
    )
    of_imu, of_mag = imu_ns < _MINUTE_NS, mag_ns < _MINUTE_NS
    if every <= 1 or not of_mag.any():
        return imu, mag
    imu_ns, mag_ns = imu_ns + imu_turn * (_MINUTE_NS + _APART_NS), mag_ns + mag_turn * (_MINUTE_NS + _APART_NS)
    return (
        Imu(imu_ns[of_imu], imu.gyro_b_radps[of_imu], imu.accel_b_mps2[of_imu]),
        Mag(mag_ns[of_mag], mag.mag_b_ut[of_mag]),
    )


def _describe(contradiction: Contradiction | NoOptimum) -> str:
    return contradiction.found if isinstance(contradiction, Contradiction) else "no optimum is found"
