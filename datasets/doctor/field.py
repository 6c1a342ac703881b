"""The magnetic field: hard iron, size, disturbances, and its dip, which shows whether gravity is inverted."""

import numpy as np

from stillpoint.datasets.doctor.axes import inverted
from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.witness import Witness
from stillpoint.datasets.frames import rotation, slerp
from stillpoint.datasets.plausible import FIELD_RANGE_UT
from stillpoint.datasets.recording import Floats, Recording, Times

IRON_SHARE = 0.3  # of the field: more turns the heading by up to 17 deg
DISTURBED, DISTURBED_SHARE = 0.2, 0.25  # a field off by so much, for so much of the time
DIP_SIDE = 0.17  # sine of the dip (10 deg) beyond which the field clearly points down or up
NEAR_GRAVITY = 0.1  # only samples whose force is this close to gravity's size say where down is
EQUATOR_DEG = 15.0  # within, the dip may have either sign


def check_field(recording: Recording, witness: Witness | None) -> list[Finding]:
    """Facts about the field as far as the motion shows them."""
    assert recording.mag is not None
    known = witness is not None and witness.choice is not None and all(witness.choice.tested)
    iron = witness.hard_iron_b_ut if known and witness is not None else None
    if iron is None and recording.info.mag_uncalibrated:
        message = "mag: not calibrated, and turned too little to find its hard iron: size and dip not tested"
        return [Finding("field-not-tested", "fact", message)]
    field = recording.mag.mag_b_ut - (iron if iron is not None else 0.0)
    size = float(np.median(np.linalg.norm(field, axis=1)))
    findings = [] if iron is None else [_hard_iron(iron, size)]
    findings.append(_size(field, size))
    return findings + _dip(recording, field)


def check_gravity_sign(recording: Recording, rests_ns: Times) -> list[Finding]:
    """The specific force in a known base pose must point up."""
    if recording.base_pose is None or len(rests_ns) == 0:
        return []
    imu = recording.require_imu()
    first, last = np.searchsorted(imu.t_ns, rests_ns[0])
    force = imu.accel_b_mps2[first : last + 1].mean(axis=0)
    up_b = rotation(recording.base_pose).inv().apply([0.0, 0.0, 1.0])
    cosine = float(force @ up_b / (np.linalg.norm(force) + 1e-300))
    angle_deg = float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    if angle_deg > 150:
        return [inverted("accel", "gravity is inverted by the known base pose", True, "gravity-inverted")]
    if angle_deg > 15:
        message = (
            f"base pose: gravity at the first rest is {angle_deg:.0f} deg off the known base pose; "
            "state the pose anew, or look at the accelerometer's axes"
        )
        return [Finding("base-pose", "warning", message, values={"angle_deg": angle_deg})]
    message = f"base pose: gravity at the first rest is {angle_deg:.1f} deg off it"
    return [Finding("base-pose", "fact", message, values={"angle_deg": angle_deg})]


def _hard_iron(iron: Floats, size: float) -> Finding:
    share = float(np.linalg.norm(iron)) / size
    message = f"mag: hard iron ({', '.join(f'{h:.1f}' for h in iron)}) uT beside a field of {size:.1f} uT"
    values = {"hard_iron_ut": float(np.linalg.norm(iron)), "field_ut": size}
    if share <= IRON_SHARE:
        return Finding("hard-iron", "fact", message, values=values)
    text = f"mag less hard iron ({', '.join(f'{h:.2f}' for h in iron)}) uT"
    remedy = Remedy("offset", "mag", text, tuple(float(h) for h in iron))
    return Finding("hard-iron", "warning", message + "; subtract it", remedy, values)


def _size(field: Floats, size: float) -> Finding:
    off = np.abs(np.linalg.norm(field, axis=1) / size - 1) > DISTURBED
    share = float(off.mean())
    message = (
        f"mag: field of {size:.1f} uT; {100 * share:.0f} % of the samples are off by more than {100 * DISTURBED:.0f} %"
    )
    values = {"field_ut": size, "disturbed_share": share}
    if not FIELD_RANGE_UT[0] <= size <= FIELD_RANGE_UT[1]:
        advice = "; the Earth has 20-70 uT: calibrate the magnetometer"
        return Finding("field-size", "warning", message + advice, values=values)
    if share > DISTURBED_SHARE:
        advice = "; iron or currents nearby: do not trust the heading from it"
        return Finding("field-disturbed", "warning", message + advice, values=values)
    return Finding("field-size", "fact", message, values=values)


def _dip(recording: Recording, field: Floats) -> list[Finding]:
    """The field dips down in the north and rises in the south; gravity's sign decides which way is down."""
    upward = _upward_by_force(recording, field)
    if upward is None:
        return []
    dip_deg = float(-np.rad2deg(np.arcsin(upward)))
    values = {"dip_deg": dip_deg}
    message = f"mag: the field dips by {dip_deg:.0f} deg below the horizon that gravity gives"
    place = recording.info.place_lat_lon_alt
    lat_deg = None if place is None else place[0]
    expected = 0.0 if lat_deg is None else float(np.sign(lat_deg)) * (abs(lat_deg) > EQUATOR_DEG)
    if abs(upward) < DIP_SIDE or (lat_deg is None and upward < 0) or (lat_deg is not None and expected * upward <= 0):
        return [Finding("field-dip", "fact", message, values=values)]
    sure = _accel_is_right(recording, field)
    if lat_deg is None and sure is None:
        why = (
            f"the field points {-dip_deg:.0f} deg up from the horizon that gravity gives: either gravity is inverted "
            "(or all axes of the magnetometer), or the recording is from the southern hemisphere: give its place"
        )
        return [inverted("accel", why, False, "gravity-inverted")]
    where = "" if lat_deg is None else f" at latitude {lat_deg:.0f} deg"
    why = f"the field dips by {dip_deg:.0f} deg{where} and should have the other sign"
    if sure:
        return [inverted("mag", why + ": all axes of the magnetometer are inverted", True, "mag-inverted")]
    return [inverted("accel", why + ": gravity is inverted", True, "gravity-inverted")]


def _upward_by_force(recording: Recording, field: Floats) -> float | None:
    """Median sine of the field's elevation where the force is about gravity."""
    assert recording.mag is not None
    imu = recording.require_imu()
    t_s, at_s = (imu.t_ns - imu.t_ns[0]) / 1e9, (recording.mag.t_ns - imu.t_ns[0]) / 1e9
    force = np.stack([np.interp(at_s, t_s, column) for column in imu.accel_b_mps2.T], axis=1)
    norm = np.linalg.norm(force, axis=1)
    calm = (np.abs(norm / np.median(norm) - 1) < NEAR_GRAVITY) & (at_s >= 0) & (at_s <= t_s[-1])
    length = np.linalg.norm(field, axis=1)
    calm &= length > 0
    if calm.sum() < 50:
        return None
    return float(np.median((force * field).sum(axis=1)[calm] / (norm * length)[calm]))


def _accel_is_right(recording: Recording, field: Floats) -> bool | None:
    """Does the truth or the base pose show that the accelerometer's sign is right? None when neither is there."""
    assert recording.mag is not None
    truth = recording.truth
    if truth is not None:
        inside = (recording.mag.t_ns >= truth.t_ns[0]) & (recording.mag.t_ns <= truth.t_ns[-1])
        if inside.sum() >= 50:
            field_n = rotation(slerp(truth.t_ns, truth.q_nb, recording.mag.t_ns[inside])).apply(field[inside])
            upward = float(np.median(field_n[:, 2] / np.linalg.norm(field_n, axis=1)))
            by_force = _upward_by_force(recording, field)
            if by_force is not None and min(abs(upward), abs(by_force)) > DIP_SIDE:
                return bool(upward * by_force > 0)
    return True if recording.base_pose is not None else None
