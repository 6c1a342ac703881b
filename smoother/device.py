"""Joint calibration of one device from the references of several of its recordings.

Each reference says of its gyro's and accelerometer's matrices what its data show and what its prior adds. The part of
the data, the information matrix less that of the prior, is summed over the recordings and one prior is added: nothing
is counted twice, and a recording that shows an element well outweighs one that does not. Only the symmetric parts of
the matrices are pooled: an antisymmetric part is a turn of the sensor's axes, which no recording shows (its sd stays
at 0.35-0.4 of the prior's).

Two devices, or a device before and after a fall, must not be pooled. Every split of the recordings into two groups by
one element is tried; the best one is compared with the best splits of recordings that differ by chance alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.trajectory import Reference
from stillpoint.smoother.attitude.params import make_matrix_covariance

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
PARTS = tuple(f"{sensor}_{'xyz'[i]}{'xyz'[j]}" for sensor in ("gyro", "accel") for i, j in PAIRS)
_DEVICE_SD = 2e-4  # by which a matrix element of one device changes from day to day
BIAS_SD_MPS2 = 0.015  # by which its accelerometer's bias does, as in 12 BROAD trials of two sensors
_ELEMENTS = (*PARTS, "accel_bias_x", "accel_bias_y", "accel_bias_z")
_LEAST_LEARNT = 0.01  # share of an element's prior variance that the data of a recording must remove to tell anything
_DRAWS, _IMPROBABLE = 400, 0.005  # of recordings of one device, and the share of them that may split as clearly


@dataclass(frozen=True, eq=False)
class DeviceCalibration:
    """The calibration of one device from several recordings: corrected = matrix (measured - bias)."""

    gyro_matrix: Floats  # (3, 3) symmetric
    gyro_matrix_sd: Floats  # (3, 3)
    accel_matrix: Floats  # (3, 3) symmetric
    accel_matrix_sd: Floats  # (3, 3)
    accel_bias_b_mps2: Floats  # (3,) mean over the recordings
    accel_bias_sd_mps2: Floats  # (3,) scatter from recording to recording
    names: tuple[str, ...]
    parts: Floats  # (R, 12) of each recording alone, named by PARTS: deviation of the matrix from identity
    parts_sd: Floats  # (R, 12)
    biases_b_mps2: Floats  # (R, 3)
    split: float  # drop of chi-square by the best split into two groups
    split_of_one: float  # what it rarely exceeds when all are of one device


def require_several(recordings: int) -> None:
    """Raise :class:`BadParameter` for fewer recordings than a calibration of a device needs."""
    if recordings < 2:
        raise BadParameter("calibrate: needs two recordings of the device or more; one is calibrated by its reference")


def calibrate_device(references: Sequence[Reference]) -> DeviceCalibration:
    """Return the joint calibration of the device that made all recordings.

    Raises :class:`BadParameter` for fewer than two references, one without a covariance of its calibration, and
    recordings that are of two devices.
    """
    require_several(len(references))
    found = [_read_parts(made) for made in references]
    names = tuple(made.name for made in references)
    biases = np.array([made.calibration.accel_bias_b_mps2 for made in references])
    pooled = _pool(found)
    split = _find_split(found, biases)
    if split.drop > split.usual:
        first, second = (", ".join(names[k] for k in np.flatnonzero(group)) for group in (~split.group, split.group))
        raise BadParameter(
            f"calibrate: the recordings are not of one device (two groups explain them better by {split.drop:.0f} in "
            f"chi-square; {split.usual:.0f} may be chance): {first} and {second} differ most in {split.element}; "
            "calibrate each group by itself"
        )
    gyro, accel = _matrix(pooled.mean[:6]), _matrix(pooled.mean[6:])
    sd = np.sqrt(np.diagonal(pooled.covariance))
    return DeviceCalibration(
        gyro_matrix=np.eye(3) + gyro,
        gyro_matrix_sd=_matrix(sd[:6]),
        accel_matrix=np.eye(3) + accel,
        accel_matrix_sd=_matrix(sd[6:]),
        accel_bias_b_mps2=biases.mean(axis=0),
        accel_bias_sd_mps2=biases.std(axis=0, ddof=1),
        names=names,
        parts=np.array([each.mean for each in found]),
        parts_sd=np.array([np.sqrt(np.diagonal(each.covariance)) for each in found]),
        biases_b_mps2=biases,
        split=split.drop,
        split_of_one=split.usual,
    )


@dataclass(frozen=True, eq=False)
class _Parts:
    """The symmetric parts of both matrices as one recording sees them, with its prior."""

    mean: Floats  # (12,)
    covariance: Floats  # (12, 12)
    prior: Floats  # (12, 12)


def _read_parts(made: Reference) -> _Parts:
    """Return the symmetric parts (12,) of a reference.

    Raises :class:`BadParameter` where the reference has no covariance of them.
    """
    found = made.calibration
    if found.matrix_covariance is None or found.gyro_matrix is None or found.accel_matrix is None:
        raise BadParameter(f"{made.name}: its reference has no covariance of its calibration; make it again")
    to_parts = np.zeros((12, 18))
    for k, (i, j) in enumerate(PAIRS):
        for offset, row in ((9, k), (0, 6 + k)):  # the covariance has the accelerometer first
            to_parts[row, offset + 3 * i + j] += 0.5
            to_parts[row, offset + 3 * j + i] += 0.5
    errors = np.concatenate([(found.accel_matrix - np.eye(3)).ravel(), (found.gyro_matrix - np.eye(3)).ravel()])
    prior = np.zeros((18, 18))
    prior[:9, :9] = make_matrix_covariance(made.diagnostics["accel_matrix_prior_sd"], 0.0)
    scale_sd = made.diagnostics.get("gyro_scale_prior_sd", 0.0)  # references of earlier versions do not say
    prior[9:, 9:] = make_matrix_covariance(made.diagnostics["gyro_matrix_prior_sd"], scale_sd)
    return _Parts(
        mean=to_parts @ errors,
        covariance=to_parts @ found.matrix_covariance @ to_parts.T,
        prior=to_parts @ prior @ to_parts.T,
    )


def _pool(found: Sequence[_Parts]) -> _Parts:
    """Return the mean of one device: the information of the data of all, and once the widest prior."""
    prior = max((each.prior for each in found), key=lambda one: float(np.trace(one)))
    information, vector = np.linalg.inv(prior), np.zeros(12)
    for each in found:
        own = np.linalg.inv(each.covariance)
        information = information + own - np.linalg.inv(each.prior)
        vector = vector + own @ each.mean
    covariance = np.linalg.inv(information)
    return _Parts(covariance @ vector, covariance, prior)


@dataclass(frozen=True, eq=False)
class _Split:
    """The best split of recordings into two groups."""

    group: NDArray[np.bool_]  # (R,)
    drop: float  # of chi-square
    usual: float  # which recordings of one device exceed with the chance IMPROBABLE
    element: str  # in which the groups differ most


def _find_split(found: Sequence[_Parts], biases: Floats) -> _Split:
    """Return the split that explains the recordings best, and what chance alone gives.

    Compared are the values that the data alone show, without the pull of the prior: x / s with the variance P / s,
    where s = 1 - P / P0 is the share of the prior's variance that the data removed.
    """
    own = np.array([np.diagonal(each.covariance) for each in found])
    prior = np.array([np.diagonal(each.prior) for each in found])
    learnt = np.maximum(1 - own / prior, _LEAST_LEARNT)
    values = np.hstack([np.array([each.mean for each in found]) / learnt, biases])
    variances = np.hstack([own / learnt + _DEVICE_SD**2, np.full_like(biases, BIAS_SD_MPS2**2)])
    group, gains = _best_split(values, variances)
    draw = np.random.default_rng(0)
    chance = [
        float(_best_split(draw.normal(size=values.shape) * np.sqrt(variances), variances)[1].sum())
        for _ in range(_DRAWS)
    ]
    return _Split(
        group, float(gains.sum()), float(np.quantile(chance, 1 - _IMPROBABLE)), _ELEMENTS[int(gains.argmax())]
    )


def _best_split(values: Floats, variances: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """Return the group (R,) and by how much each element (15,) lowers chi-square, for the best split."""
    n = len(values)
    order = np.argsort(values, axis=0).T  # (15, R)
    above = np.zeros((*order.shape, n), dtype=np.bool_)
    for cut in range(1, n):
        np.put_along_axis(above[:, cut], order[:, cut:], True, axis=1)
    groups = above[:, 1:].reshape(-1, n)
    weight = 1 / variances
    total, second = weight.sum(axis=0), groups @ weight
    sums, of_second = (weight * values).sum(axis=0), groups @ (weight * values)
    first = total - second
    difference = of_second / second - (sums - of_second) / first
    gains = difference**2 * first * second / total
    best = int(gains.sum(axis=1).argmax())
    return groups[best], gains[best]


def _matrix(parts: Floats) -> Floats:
    """Return the symmetric matrix (3, 3) of its six parts."""
    matrix = np.zeros((3, 3))
    for value, (i, j) in zip(parts, PAIRS, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix
