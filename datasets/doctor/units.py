"""Units by size: gravity at rest, and the field of the Earth after the hard iron is subtracted."""

import numpy as np

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.noise import find_calm_seconds
from stillpoint.datasets.plausible import FASTEST_GYRO_RADPS
from stillpoint.datasets.recording import Floats, Recording, Times
from stillpoint.datasets.times import is_inside

_UNITS_OF_FORCE = {
    "g": STANDARD_GRAVITY_MPS2,
    "milli-g": STANDARD_GRAVITY_MPS2 / 1000,
    "cm/s^2": 0.01,
    "g twice": 1 / STANDARD_GRAVITY_MPS2,
}
_UNITS_OF_FIELD = {"tesla": 1e6, "gauss": 100.0, "milligauss": 0.1, "nanotesla": 1e-3}
_GRAVITY_FACT, _GRAVITY_UNIT = 0.03, 0.15  # relative: below the first a fact, above the second another unit
_MOVING_UNIT = 1.2  # without rest: the median size in motion may be off by this (running: 0.6)
_FIELD_UNIT_UT = (12.0, 120.0)  # outside, another unit is looked for: half and twice what the Earth has


def check_gyro_size(recording: Recording) -> list[Finding]:
    """Find rates that no MEMS gyro can measure, but could if they were in deg/s."""
    fastest = float(np.abs(recording.require_imu().gyro_b_radps).max())
    if fastest <= FASTEST_GYRO_RADPS:
        return []
    factor = np.pi / 180
    message = f"gyro: reaches {fastest:.4g} rad/s, more than any MEMS gyro measures"
    if factor * fastest > FASTEST_GYRO_RADPS:
        return [Finding("gyro-units", "error", message + ", and no unit explains it; find out its unit")]
    remedy = Remedy("matrix", "gyro", f"gyro * {factor:.6g} (deg/s -> rad/s)", _make_scaling(factor))
    return [Finding("gyro-units", "error", message + f": it is in deg/s; multiply by {factor:.6g}", remedy)]


def check_gravity(recording: Recording, rests_ns: Times) -> list[Finding]:
    """Judge the size of the specific force at rest, or of its median where nothing rests."""
    imu = recording.require_imu()
    still = is_inside(imu.t_ns, rests_ns if len(rests_ns) else find_calm_seconds(imu))
    at_rest = bool(still.sum() >= 20)
    norm = np.linalg.norm(imu.accel_b_mps2[still] if at_rest else imu.accel_b_mps2, axis=1)
    size = max(float(np.median(norm)), 1e-300)
    where = "at rest" if at_rest else "in the median (nothing rests)"
    values = {"size_mps2": size}
    tolerance = _GRAVITY_UNIT if at_rest else _MOVING_UNIT
    off = size / STANDARD_GRAVITY_MPS2 - 1
    if -tolerance / (1 + tolerance) <= off <= tolerance:
        message = f"accel: {size:.4g} m/s^2 {where} ({100 * off:+.1f} % of 9.807)"
        if not at_rest or abs(off) <= _GRAVITY_FACT:
            return [Finding("gravity-size", "fact", message, values=values)]
        advice = ": a scale or a bias error; calibrate the accelerometer in six poses"
        return [Finding("gravity-size", "warning", message + advice, values=values)]
    for unit, factor in _UNITS_OF_FORCE.items():
        if abs(np.log(size * factor / STANDARD_GRAVITY_MPS2)) < np.log(1 + tolerance):
            remedy = Remedy("matrix", "accel", f"accel * {factor:.6g} ({unit} -> m/s^2)", _make_scaling(factor))
            message = f"accel: {size:.4g} {where}, not 9.8 m/s^2: it is in {unit}; multiply by {factor:.6g}"
            return [Finding("accel-units", "error", message, remedy, values)]
    message = f"accel: {size:.4g} {where}, not 9.8 m/s^2, and no unit explains it; find out its unit"
    return [Finding("accel-units", "error", message, None, values)]


def check_field_unit(recording: Recording, hard_iron_b_ut: Floats | None) -> list[Finding]:
    """Test whether the field, minus the hard iron where that is known, has the size of the Earth's."""
    assert recording.mag is not None
    known = hard_iron_b_ut is not None
    centre = np.zeros(3) if hard_iron_b_ut is None else hard_iron_b_ut
    lengths = np.linalg.norm(recording.mag.mag_b_ut - centre, axis=1)
    size, how = float(np.median(lengths)), "less its hard iron" if known else "in the median"
    values = {"size_ut": size}
    if size <= 0:
        message = "mag: every sample is zero or the same; leave the magnetometer out"
        return [Finding("mag-stuck", "error", message, Remedy("drop-stream", "mag", "magnetometer dropped: no field"))]
    if _FIELD_UNIT_UT[0] <= size <= _FIELD_UNIT_UT[1]:
        return []
    if recording.info.mag_uncalibrated and not known:
        return []
    for unit, factor in _UNITS_OF_FIELD.items():
        if _FIELD_UNIT_UT[0] <= size * factor <= _FIELD_UNIT_UT[1]:
            remedy = Remedy("matrix", "mag", f"mag * {factor:g} ({unit} -> uT)", _make_scaling(factor))
            message = f"mag: the field is {size:.4g} {how}, not 20-70 uT: it is in {unit}; multiply by {factor:g}"
            return [Finding("mag-units", "error", message, remedy, values)]
    return []


def _make_scaling(factor: float) -> tuple[float, ...]:
    """Return nine numbers of a matrix that multiplies all axes by a factor."""
    return (factor, 0.0, 0.0, 0.0, factor, 0.0, 0.0, 0.0, factor)
