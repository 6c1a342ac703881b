"""The magnetic field: hard iron, size, disturbances, and its dip, whose sign shows whether gravity is inverted."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.witness import Witness
from stillpoint.datasets.earth import FIELD_YEARS, compute_magnetic_field_n_ut, to_decimal_year
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.plausible import FIELD_RANGE_UT
from stillpoint.datasets.recording import Floats, Recording, Times

_IRON_SHARE = 0.3  # of the field: more turns the heading by up to 17 deg
_DISTURBED, _DISTURBED_SHARE = 0.2, 0.25  # a field off by so much, for so much of the time
_DIP_SIDE = 0.17  # sine of the dip (10 deg) beyond which the field clearly points down or up
_NEAR_GRAVITY = 0.1  # only samples whose force is this close to gravity's size say where down is
_FEWEST_SAMPLES, _FEWEST_AT_REST = 50, 5
_MOST_SAMPLES = 3000
_EVEN_DIP_DEG = 30.0  # dips of rests that differ by more are of different fields, or of wrong axes
# Nats against a sign of the dip: where the place is known, where it is not and most users live in the north, and where
# the rests contradict each other, so that no sign is right (less than a wrong sensor costs: it proves none).
_WRONG_SIGN, _SOUTHERN, _UNEVEN = 20.0, 5.0, 4.9


@dataclass(frozen=True, eq=False)
class Dips:
    """Directions of specific force and field, in groups: one per rest, or one of all calm samples."""

    force: Floats  # (n, 3) unit vectors, as measured
    field: Floats  # (n, 3) unit vectors, as measured, less the hard iron
    group: NDArray[np.intp]  # (n,)
    expected_rad: float | None  # of the World Magnetic Model at the place of the recording; None where unknown

    def compute_sines(self, accel: Floats, mag: Floats) -> Floats:
        """Return the sine of the field's elevation in each group when the sensors measure in these wrong axes."""
        up = ((self.force @ accel) * (self.field @ mag)).sum(axis=1)
        return np.array([np.median(up[rows]) for rows in self._groups])

    @cached_property
    def _groups(self) -> list[NDArray[np.bool_]]:
        """Return one mask (N,) per group of readings."""
        return [self.group == each for each in np.unique(self.group)]

    def compute_dips_deg(self) -> Floats:
        """Return the dip below the horizon in each group, as measured."""
        return np.asarray(-np.rad2deg(np.arcsin(np.clip(self.compute_sines(np.eye(3), np.eye(3)), -1, 1))))

    def compute_penalty(self, accel: Floats, mag: Floats) -> float:
        """Return the nats against these wrong axes by the sign of the dip, judged in each rest."""
        sines = self.compute_sines(accel, mag)
        up, down = bool((sines > _DIP_SIDE).any()), bool((sines < -_DIP_SIDE).any())
        if up and down:
            return _UNEVEN
        if self.expected_rad is None:
            return _SOUTHERN if up else 0.0
        expected = -np.sin(self.expected_rad)
        if abs(expected) < _DIP_SIDE:
            return 0.0
        return _WRONG_SIGN if (up and expected < 0) or (down and expected > 0) else 0.0


def find_dips(recording: Recording, rests_ns: Times, witness: Witness | None) -> Dips | None:
    """Return where force and field point in each rest, else in all calm samples; None where this cannot be found."""
    iron = _find_hard_iron(witness)
    mag, imu = recording.mag, recording.require_imu()
    if mag is None or (iron is None and recording.info.mag_uncalibrated):
        return None
    field = mag.mag_b_ut - (0.0 if iron is None else iron)
    t_s, at_s = (imu.t_ns - imu.t_ns[0]) / 1e9, (mag.t_ns - imu.t_ns[0]) / 1e9
    force = np.stack([np.interp(at_s, t_s, column) for column in imu.accel_b_mps2.T], axis=1)
    size, length = np.linalg.norm(force, axis=1), np.linalg.norm(field, axis=1)
    calm = (np.abs(size / (np.median(size) + 1e-300) - 1) < _NEAR_GRAVITY) & (at_s >= 0) & (at_s <= t_s[-1])
    calm &= (length > 0) & (size > 0)
    group = np.full(len(at_s), -1)
    for place, (first, last) in enumerate(rests_ns):
        group[(mag.t_ns >= first) & (mag.t_ns <= last)] = place
    resting = calm & (group >= 0)
    kept = resting if resting.sum() >= _FEWEST_AT_REST else calm
    if kept.sum() < _FEWEST_AT_REST or (kept is calm and kept.sum() < _FEWEST_SAMPLES):
        return None
    rows = np.flatnonzero(kept)[:: max(1, int(kept.sum()) // _MOST_SAMPLES)]
    force, field = force[rows] / size[rows, None], field[rows] / length[rows, None]
    return Dips(force, field, group[rows] if kept is resting else np.zeros(len(rows), np.intp), _predict_dip(recording))


def _predict_dip(recording: Recording) -> float | None:
    """Return the dip in rad of the World Magnetic Model at the recording's place, or its first fix; None without.

    A date outside the model, or none, is replaced by the nearest year of it: the dip moves by less than 0.2 deg a year.
    """
    place = recording.info.place_lat_lon_alt
    if place is None and recording.gps is not None and recording.gps.valid.any():
        first = int(np.flatnonzero(recording.gps.valid)[0])
        place = (float(recording.gps.lat_deg[first]), float(recording.gps.lon_deg[first]), 0.0)
    if place is None:
        return None
    try:
        year = to_decimal_year(recording.info.date) if recording.info.date else FIELD_YEARS[1]
        year = min(max(year, FIELD_YEARS[0]), FIELD_YEARS[1] - 0.1)
        east, north, up = compute_magnetic_field_n_ut(place, f"{int(year)}-06-15")
    except BadParameter:
        return None
    return float(np.arctan2(-up, np.hypot(east, north)))


def check_field(recording: Recording, witness: Witness | None, rests_ns: Times) -> list[Finding]:
    """Return facts about the field as far as the motion shows them."""
    assert recording.mag is not None
    iron = _find_hard_iron(witness)
    if iron is None and recording.info.mag_uncalibrated:
        message = "mag: not calibrated, and turned too little to find its hard iron: size and dip not tested"
        return [Finding("field-not-tested", "fact", message)]
    field = recording.mag.mag_b_ut - (iron if iron is not None else 0.0)
    size = float(np.median(np.linalg.norm(field, axis=1)))
    findings = [] if iron is None else [_report_hard_iron(iron, size)]
    findings.append(_report_size(field, size))
    return findings + _report_dip(find_dips(recording, rests_ns, witness))


def _find_hard_iron(witness: Witness | None) -> Floats | None:
    """Return the hard iron where the sensor turned about all axes."""
    known = witness is not None and witness.choice is not None and all(witness.choice.tested)
    return witness.hard_iron_b_ut if known and witness is not None else None


def _report_dip(dips: Dips | None) -> list[Finding]:
    """Return the dip of the field, and a warning where it differs between rests."""
    if dips is None:
        return []
    each = dips.compute_dips_deg()
    dip_deg, spread_deg = float(np.median(each)), float(np.ptp(each))
    values = {"dip_deg": dip_deg, "spread_deg": spread_deg}
    if spread_deg > _EVEN_DIP_DEG:
        message = (
            f"mag: the field dips by {each.min():.0f} to {each.max():.0f} deg below the horizon from rest to rest: "
            "iron or currents nearby, or wrong axes that no change of sign explains; do not trust the heading from it"
        )
        return [Finding("field-dip", "warning", message, values=values)]
    message = f"mag: the field dips by {dip_deg:.0f} deg below the horizon that gravity gives"
    if dips.expected_rad is not None:
        values["expected_deg"] = float(np.rad2deg(dips.expected_rad))
        message += f" (World Magnetic Model: {values['expected_deg']:.0f} deg)"
    return [Finding("field-dip", "fact", message, values=values)]


def compute_base_pose_cosine(recording: Recording, rests_ns: Times) -> float | None:
    """Return the cosine between the force at the first rest and up in the known base pose; None without either."""
    if recording.base_pose is None or len(rests_ns) == 0:
        return None
    imu = recording.require_imu()
    first, last = np.searchsorted(imu.t_ns, rests_ns[0])
    force = imu.accel_b_mps2[first : last + 1].mean(axis=0)
    up_b = rotation(recording.base_pose).inv().apply([0.0, 0.0, 1.0])
    return float(force @ up_b / (np.linalg.norm(force) + 1e-300))


def check_base_pose(recording: Recording, rests_ns: Times) -> list[Finding]:
    """Return how far gravity at the first rest is from a known base pose."""
    cosine = compute_base_pose_cosine(recording, rests_ns)
    if cosine is None:
        return []
    angle_deg = float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    if angle_deg > 15:
        message = (
            f"base pose: gravity at the first rest is {angle_deg:.0f} deg off the known base pose; "
            "state the pose again, or check the accelerometer's axes"
        )
        return [Finding("base-pose", "warning", message, values={"angle_deg": angle_deg})]
    message = f"base pose: gravity at the first rest is {angle_deg:.1f} deg off it"
    return [Finding("base-pose", "fact", message, values={"angle_deg": angle_deg})]


def _report_hard_iron(iron: Floats, size: float) -> Finding:
    """Return the finding about the hard iron (3,) in µT beside a field of this size, with its offset as remedy."""
    share = float(np.linalg.norm(iron)) / size
    message = f"mag: hard iron ({', '.join(f'{h:.1f}' for h in iron)}) uT beside a field of {size:.1f} uT"
    values = {"hard_iron_ut": float(np.linalg.norm(iron)), "field_ut": size}
    if share <= _IRON_SHARE:
        return Finding("hard-iron", "fact", message, values=values)
    text = f"mag less hard iron ({', '.join(f'{h:.2f}' for h in iron)}) uT"
    remedy = Remedy("offset", "mag", text, tuple(float(h) for h in iron))
    return Finding("hard-iron", "warning", message + "; subtract it", remedy, values)


def _report_size(field: Floats, size: float) -> Finding:
    """Return the finding about size and constancy of the field (N, 3) in µT, corrected for hard iron."""
    off = np.abs(np.linalg.norm(field, axis=1) / size - 1) > _DISTURBED
    share = float(off.mean())
    message = (
        f"mag: field of {size:.1f} uT; {100 * share:.0f} % of the samples are off by more than {100 * _DISTURBED:.0f} %"
    )
    values = {"field_ut": size, "disturbed_share": share}
    if not FIELD_RANGE_UT[0] <= size <= FIELD_RANGE_UT[1]:
        advice = "; the Earth has 20-70 uT: calibrate the magnetometer"
        return Finding("field-size", "warning", message + advice, values=values)
    if share > _DISTURBED_SHARE:
        advice = "; iron or currents nearby: do not trust the heading from it"
        return Finding("field-disturbed", "warning", message + advice, values=values)
    return Finding("field-size", "fact", message, values=values)
