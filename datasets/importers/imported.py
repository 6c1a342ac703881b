"""The result of an import: a recording, and what the device itself made of its samples."""

from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.frames import EulerFrame, local_from_enu, quaternion, rotation
from stillpoint.datasets.importers.series import Log, Series, find_finite_rows
from stillpoint.datasets.plausible import describe_field_size
from stillpoint.datasets.recording import Floats, Mag, Recording, Times, Truth
from stillpoint.datasets.trajectory import Estimate

_DEVICE = "device"  # the name of the estimate that the device made
LEAST_NORM = 0.5  # of a quaternion; drivers write zeros where they know no attitude


@dataclass(frozen=True)
class Imported:
    """A recording and the estimates beside it, which become ``NAME.device.estimate.mcap``."""

    recording: Recording
    estimates: tuple[Estimate, ...] = ()


def make_mag(series: Series, uncalibrated: bool, log: Log) -> tuple[Mag | None, bool]:
    """Return the magnetometer, or None, and whether its size has no meaning.

    A bad magnetometer does not stop the import of the rest: without a single value it is left out, and with a size
    that is not the Earth's it is marked as uncalibrated; both are noted.
    """
    series = series.where(find_finite_rows(series.values))
    if len(series.t_ns) == 0 or not series.values.any():
        log.add_note("mag: no value other than 0 or NaN; left out")
        return None, uncalibrated
    doubt = describe_field_size(float(np.median(np.linalg.norm(series.values, axis=1))))
    if doubt and not uncalibrated:
        log.add_note(f"mag: {doubt}; marked as uncalibrated")
    return Mag(series.t_ns, series.values), uncalibrated or bool(doubt)


def turn_truth(truth: Truth, frame: EulerFrame, inverse: bool) -> Truth:
    """Return a truth that takes the body to East-North-Up.

    ``frame`` is the local frame of the poses, ``inverse`` that their quaternions take it to the body; positions of
    inverse poses are left out, since they are in the body's axes.
    """
    if frame == "enu" and not inverse:
        return truth
    to_enu = local_from_enu(frame).inv()
    turned = rotation(truth.q_nb.copy())
    q_nb = quaternion(to_enu * (turned.inv() if inverse else turned))
    position_n_m = None
    if truth.position_n_m is not None and not inverse:
        position_n_m = truth.position_n_m @ to_enu.as_matrix().T
    return Truth(truth.t_ns, q_nb, truth.moving, position_n_m)


def make_device_estimate(
    t_ns: Times, q_nb: Floats, recording: str, source: str, sha256: dict[str, str], log: Log
) -> tuple[Estimate, ...]:
    """Return the attitude (N, 4) wxyz that the device itself gave as an estimate, or nothing where it gave none.

    Rows that are no quaternion are dropped and counted. A quaternion that never changes is what drivers without an
    attitude write; it is left out.
    """
    norm = np.linalg.norm(q_nb, axis=1)
    known = np.isfinite(norm) & (norm > LEAST_NORM)
    known &= np.diff(t_ns, prepend=t_ns[:1] - 1) > 0
    if known.sum() < 2 or np.ptp(q_nb[known], axis=0).max() == 0:
        log.add_note(f"{source} never changes, or holds no attitude; not imported")
        return ()
    if not known.all():
        log.add_note(f"{source}: {int((~known).sum())} of {len(known)} samples without an attitude dropped")
    log.add_conversion(f"{source} -> estimate {_DEVICE!r}, the attitude as the device computed it")
    q_nb = q_nb[known] / norm[known, None]
    return (
        Estimate(t_ns[known], _DEVICE, q_nb=q_nb, recording=recording, params={"source": source}, made_from=sha256),
    )
