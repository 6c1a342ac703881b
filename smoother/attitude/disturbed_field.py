"""When the magnetometer contradicts gyro and accelerometer: a fault to be mended, or a place full of iron?

Iron turns the field from place to place; axes that are swapped or flipped turn it with the body. The doctor's witness
tells them apart: window by window, does the field's change fit the gyro's turning best as the axes are? On 12 BROAD
trials with their own magnets and with dipoles beside or amid the path it said so 108 of 110 times, and of swapped or
flipped axes never. In the first case the reference is made without the magnetometer, and says so, if a return to the
base pose or satellites test the gyro in its stead. In the other the recording stays refused: its user can mend it.
"""

from dataclasses import replace

import numpy as np

from stillpoint.datasets.doctor.witness import ask_mag
from stillpoint.datasets.recording import Recording
from stillpoint.smoother.attitude.evidence import Evidence
from stillpoint.smoother.attitude.plausibility import INLIER_SHARE, Contradiction
from stillpoint.smoother.attitude.solve import NoOptimum

LEAVE_OUT = "--set magnetic.use=false leaves the magnetometer out all the same"


def without_magnetometer(recording: Recording, contradiction: Contradiction | NoOptimum) -> tuple[Recording, str]:
    """The recording less its magnetometer, and why; raises ``contradiction`` where its axes are to blame."""
    if recording.mag is None or not axes_fit(recording):
        raise contradiction
    why = f"with it, {_found(contradiction)}; its own axes fit the gyro, so the field is disturbed"
    return replace(recording, mag=None), why


def _found(contradiction: Contradiction | NoOptimum) -> str:
    return contradiction.found if isinstance(contradiction, Contradiction) else "no optimum is found"


def require_test_of_gyro(evidence: Evidence, contradiction: Contradiction | NoOptimum, name: str) -> None:
    """Raise :class:`Contradiction` where neither a return to the base pose nor satellites test the gyro.

    Where nothing did, phones whose gyro was 3 % off were wrong by 13 deg, 0.67 of it within the 95 % ellipsoid.
    """
    if evidence.fixes is not None or evidence.return_states()[1]:
        return
    if isinstance(contradiction, Contradiction) and not contradiction.of_field:
        raise contradiction
    found = f"{_found(contradiction)}; the field is disturbed, and no return to the base pose tests the gyro instead"
    raise Contradiction(name, found, of_field=True, advice=LEAVE_OUT)


def refuse_wrong_axes(recording: Recording, inlier_share: float | None) -> None:
    """Raise :class:`Contradiction` where readings of a sensor with wrong axes fit all the same.

    At rest any axes fit: in a recording that rests for most of its time the others are too few to be missed.
    """
    if inlier_share is not None and inlier_share < INLIER_SHARE and not axes_fit(recording):
        useless = 100 * (1 - inlier_share)
        found = f"the magnetometer's axes do not turn as the gyro's ({useless:.0f} % are useless)"
        raise Contradiction(recording.name, found, of_field=True)


def axes_fit(recording: Recording) -> bool:
    """Does the magnetometer turn as the gyro says? Also True where it shows too little to tell."""
    if recording.mag is None:
        return True
    choice = ask_mag(recording.require_imu(), recording.mag).choice
    return choice is None or bool(np.array_equal(choice.matrix, np.eye(3)))
