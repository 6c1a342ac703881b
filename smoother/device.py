"""Joint calibration of one device from the references of several of its recordings.

Each reference says of its gyro's and accelerometer's matrices what its data show and what its prior adds. The part of
the data, the information matrix less that of the prior, is summed over the recordings and one prior is added: nothing
is counted twice, and a recording that shows an element well outweighs one that does not. Only the symmetric parts of
the matrices are pooled: an antisymmetric part is a turn of the sensor's axes, which no recording shows (its sd stays
at 0.35-0.4 of the prior's).

Two devices, or a device before and after a fall, must not be pooled. The scatter of the recordings about their mean is
compared with what their covariances allow; if it is too large, the split into two groups that explains it best is
named.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.trajectory import Reference

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
PARTS = tuple(f"{sensor}_{'xyz'[i]}{'xyz'[j]}" for sensor in ("gyro", "accel") for i, j in PAIRS)
DEVICE_SD = 2e-4  # by which a matrix element of one device changes from day to day
BIAS_SD_MPS2 = 0.01  # by which its accelerometer's bias does
IMPROBABLE = 1e-4  # chance at which scatter is taken for two devices


@dataclass(frozen=True, eq=False)
class DeviceCalibration:
    """What several recordings say of one device: corrected = matrix (measured - bias)."""

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
    chi_square: float  # of the scatter about the mean
    degrees: int


def calibrate_device(references: Sequence[Reference]) -> DeviceCalibration:
    """Return the joint calibration of the device that made all recordings.

    Raises :class:`BadParameter` for fewer than two references, one without a covariance of its calibration, and
    recordings that are of two devices.
    """
    if len(references) < 2:
        raise BadParameter("calibrate: needs two recordings of the device or more; one is calibrated by its reference")
    found = [_read_parts(made) for made in references]
    names = tuple(made.name for made in references)
    biases = np.array([made.calibration.accel_bias_b_mps2 for made in references])
    pooled = _pool(found)
    chi_square, degrees = _scatter(found, biases)
    if chi_square > chdtri(degrees, IMPROBABLE):
        raise BadParameter(_name_split(found, biases, names, chi_square, degrees))
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
        chi_square=chi_square,
        degrees=degrees,
    )


@dataclass(frozen=True, eq=False)
class _Parts:
    """The symmetric parts of both matrices as one recording sees them, with its prior."""

    mean: Floats  # (12,)
    covariance: Floats  # (12, 12)
    prior_var: Floats  # (12,)


def _read_parts(made: Reference) -> _Parts:
    """Return the symmetric parts (12,) of a reference.

    Raises :class:`BadParameter` where the reference has no covariance of them.
    """
    found = made.calibration
    if found.matrix_covariance is None or found.gyro_matrix is None or found.accel_matrix is None:
        raise BadParameter(f"{made.name}: its reference has no covariance of its calibration; make it anew")
    to_parts = np.zeros((12, 18))
    for k, (i, j) in enumerate(PAIRS):
        for offset, row in ((9, k), (0, 6 + k)):  # the covariance has the accelerometer first
            to_parts[row, offset + 3 * i + j] += 0.5
            to_parts[row, offset + 3 * j + i] += 0.5
    errors = np.concatenate([(found.accel_matrix - np.eye(3)).ravel(), (found.gyro_matrix - np.eye(3)).ravel()])
    prior_sd = np.repeat([made.diagnostics["accel_matrix_prior_sd"], made.diagnostics["gyro_matrix_prior_sd"]], 9)
    return _Parts(
        mean=to_parts @ errors,
        covariance=to_parts @ found.matrix_covariance @ to_parts.T,
        prior_var=np.diagonal(to_parts @ np.diag(prior_sd.astype(np.float64) ** 2) @ to_parts.T),
    )


def _pool(found: Sequence[_Parts]) -> _Parts:
    """Return the mean of one device: the information of the data of all, and once the widest prior."""
    prior = np.max([each.prior_var for each in found], axis=0)
    information, vector = np.diag(1 / prior), np.zeros(12)
    for each in found:
        own = np.linalg.inv(each.covariance)
        information = information + own - np.diag(1 / each.prior_var)
        vector = vector + own @ each.mean
    covariance = np.linalg.inv(information)
    return _Parts(covariance @ vector, covariance, prior)


def _scatter(found: Sequence[_Parts], biases: Floats) -> tuple[float, int]:
    """Return the chi-square of the recordings about their weighted mean, and its degrees of freedom.

    Each is taken with its own covariance, widened by what changes from day to day. An element that a recording does not
    show stays at its prior's mean in all of them, and adds next to nothing.
    """
    vectors, variances = _vectors(found, biases)
    mean = (vectors / variances).sum(axis=0) / (1 / variances).sum(axis=0)
    return float(((vectors - mean) ** 2 / variances).sum()), (len(vectors) - 1) * vectors.shape[1]


def _vectors(found: Sequence[_Parts], biases: Floats) -> tuple[Floats, Floats]:
    """Return the parts and biases (R, 15) of the recordings with their variances."""
    vectors = np.hstack([np.array([each.mean for each in found]), biases])
    own = np.array([np.diagonal(each.covariance) for each in found]) + DEVICE_SD**2
    return vectors, np.hstack([own, np.full_like(biases, BIAS_SD_MPS2**2)])


def _name_split(found: Sequence[_Parts], biases: Floats, names: Sequence[str], chi_square: float, degrees: int) -> str:
    """Return the message that names the two groups that explain the scatter best, and by which element they differ."""
    vectors, variances = _vectors(found, biases)
    scaled = vectors / np.sqrt(variances)
    direction = np.linalg.svd(scaled - scaled.mean(axis=0), full_matrices=False)[2][0]
    order = np.argsort(scaled @ direction)
    left: list[float] = []
    for k in range(1, len(order)):
        groups = (order[:k], order[k:])
        left.append(sum(float(((scaled[g] - scaled[g].mean(axis=0)) ** 2).sum()) for g in groups))
    cut = int(np.argmin(left)) + 1
    groups = order[:cut], order[cut:]
    apart = (vectors[groups[0]].mean(axis=0) - vectors[groups[1]].mean(axis=0)) / np.sqrt(variances.mean(axis=0))
    most = int(np.abs(apart).argmax())
    element = (*PARTS, "accel_bias_x", "accel_bias_y", "accel_bias_z")[most]
    first, second = (", ".join(names[k] for k in sorted(group)) for group in groups)
    return (
        f"calibrate: the recordings are not of one device (chi-square {chi_square:.0f} with {degrees} degrees of "
        f"freedom): {first} and {second} differ most in {element}; calibrate each group by itself"
    )


def _matrix(parts: Floats) -> Floats:
    """Return the symmetric matrix (3, 3) of its six parts."""
    matrix = np.zeros((3, 3))
    for value, (i, j) in zip(parts, PAIRS, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix
