"""Which sensor is to blame when axes, signs or scales disagree.

A vector sensor whose axes are wrong by the signed permutation P asks for the gyro to be corrected by det(P) P, always
a rotation; so a gyro mirrored in one axis is never mistaken for another sensor's fault, and where both are possible
the witnesses vote: those that agree with the gyro clear it. Without a second witness the simpler of both is taken.
"""

from collections.abc import Sequence

import numpy as np

from stillpoint.datasets.doctor.candidates import TIE_NATS, complexity, describe, index_of
from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.remedy import apply
from stillpoint.datasets.doctor.truth import ask_truth
from stillpoint.datasets.doctor.witness import Witness
from stillpoint.datasets.recording import Floats, Recording

SCALE_LIMIT = 0.1  # relative: more is no calibration error of a working gyro
ACCEL_ALONE, MAG_ALONE = 0.2, 0.6  # ... when one witness alone says so, which translation or a short turn may fool
TRUTH_GAIN = 1.0  # nats per window that another reading of the truth's quaternions must bring
AGREEMENT = 0.1  # two witnesses of the scale that differ by less agree
DEG_PER_RAD = 180 / np.pi
NAMES = {"accel": "accelerometer", "mag": "magnetometer", "truth": "truth"}
IDENTITY = np.eye(3)


def find_truth_fault(recording: Recording, witness: Witness) -> Finding | None:
    """A truth that was stored as its inverse, or with its components in another order."""
    if recording.truth is None or (witness.choice is not None and _is_identity(witness.choice.matrix)):
        return None
    needed = TRUTH_GAIN + (0.0 if witness.choice is None else witness.choice.gain)
    fix: Remedy | None = None
    turned = (
        Remedy("conjugate", "truth", "truth: q -> inverse of q"),
        Remedy("reorder", "truth", "truth: x, y, z, w -> w, x, y, z"),
    )
    for remedy in turned:
        changed = apply(recording, [remedy])
        assert changed.truth is not None
        other = ask_truth(recording.require_imu(), changed.truth)
        if other.choice is not None and _is_identity(other.choice.matrix) and other.choice.gain > needed:
            needed, fix = other.choice.gain, remedy
    if fix is None:
        return None
    what = "takes n to the body (it is the inverse)" if fix.kind == "conjugate" else "has its components as x, y, z, w"
    message = f"truth: its attitude {what}: only then does it turn as the gyro does; {fix.text.split(': ', 1)[1]}"
    return Finding("truth-quaternion", "error", message, fix)


def find_scale_fault(witnesses: Sequence[Witness]) -> Finding | None:
    """A gyro in deg/s, or one whose rates are too large or too small, or stamps on a wrong time base."""
    scales = {one.name: one.scale for one in witnesses if one.choice is not None and one.scale}
    found = _agreed_scale(scales)
    if found is None:
        return None
    scale, who = found
    said = " and ".join(f"{NAMES[name]} ({scales[name]:.4g})" for name in who)
    if abs(scale * DEG_PER_RAD - 1) < 0.15:
        factor = 1 / DEG_PER_RAD
        message = f"gyro: in deg/s by the {said}: multiply by {factor:.6g}"
        remedy = Remedy("matrix", "gyro", f"gyro * {factor:.6g} (deg/s -> rad/s)", _flat(factor * IDENTITY))
        return Finding("gyro-units", "error", message, remedy, {"scale": scale})
    message = (
        f"gyro: rates must be multiplied by {scale:.4g} to fit the {said}: a wrong range or unit of the gyro, or a "
        f"time base that is wrong by this factor; multiply by {scale:.4g}, or the steps of time if the rate is wrong"
    )
    remedy = Remedy("matrix", "gyro", f"gyro * {scale:.6g}", _flat(scale * IDENTITY))
    return Finding("gyro-scale", "error", message, remedy, {"scale": scale})


def _agreed_scale(scales: dict[str, float]) -> tuple[float, list[str]] | None:
    def off(scale: float) -> float:
        return abs(float(np.log(scale)))

    if "truth" in scales:
        others = [name for name in ("mag", "accel") if name in scales]
        denied = others and all(off(scales[name]) < AGREEMENT for name in others)
        return (scales["truth"], ["truth"]) if off(scales["truth"]) > SCALE_LIMIT and not denied else None
    if "accel" in scales and "mag" in scales:
        both = off(scales["accel"] / scales["mag"]) < AGREEMENT
        sure = min(off(scales["accel"]), off(scales["mag"])) > SCALE_LIMIT  # each by itself: one may be far off alone
        mean = float(np.sqrt(scales["accel"] * scales["mag"]))
        return (mean, ["accel", "mag"]) if both and sure else None
    for name, limit in (("accel", ACCEL_ALONE), ("mag", MAG_ALONE)):
        if name in scales and off(scales[name]) > limit:
            return scales[name], [name]
    return None


def find_axes_fault(witnesses: Sequence[Witness], accel_by_truth: Floats | None) -> Finding | None:
    """The first fault of axes: of the gyro, of the accelerometer or magnetometer, or of the truth's body."""
    said = {one.name: one.choice.matrix for one in witnesses if one.choice is not None}
    wrong = {name: matrix for name, matrix in said.items() if not _is_identity(matrix)}
    vectors = [name for name in ("accel", "mag") if name in said]
    cleared = [name for name in vectors if name not in wrong]
    if "truth" in wrong:
        return _truth_axes(wrong["truth"], cleared) if cleared else _gyro_axes(wrong["truth"], ["truth"])
    if "truth" not in said and not cleared and wrong:
        first, *rest = [name for name in vectors if name in wrong]
        agree = rest and np.array_equal(wrong[first], wrong[rest[0]])
        if agree or rest or np.linalg.det(wrong[first]) < 0:
            return _gyro_axes(wrong[first], [first, *rest] if agree else [first])
        sensor = _simplest(wrong[first])
        favour = _favour(witnesses, wrong[first])
        if favour > TIE_NATS or (favour > -TIE_NATS and complexity(wrong[first]) <= complexity(sensor)):
            return _gyro_axes(wrong[first], [first], f" (or the {NAMES[first]}'s own: {describe(first, sensor)})")
        return _sensor_axes(first, sensor, f"or the gyro's: {describe('gyro', wrong[first])}")
    if "accel" in vectors and accel_by_truth is not None and not _is_identity(accel_by_truth):
        return _accel_by_truth(accel_by_truth)
    for name in vectors:
        if name in wrong:
            if np.linalg.det(wrong[name]) < 0:
                return _mismatch(name, wrong[name])
            return _sensor_axes(name, _simplest(wrong[name]), "as the others agree with the gyro")
    if accel_by_truth is not None and not _is_identity(accel_by_truth) and "truth" in said:
        return _accel_by_truth(accel_by_truth)
    return None


def report_axes(witnesses: Sequence[Witness]) -> list[Finding]:
    """What each witness confirmed, and what could not be tested."""
    findings = []
    for one in witnesses:
        if one.choice is None:
            message = f"axes: not tested by the {NAMES[one.name]}: too little turning that it could see"
            findings.append(Finding("axes-not-tested", "fact", message))
            continue
        tested = [axis for axis, seen in zip("xyz", one.choice.tested, strict=True) if seen]
        untested = [axis for axis in "xyz" if axis not in tested]
        scale = one.scale or float("nan")
        message = f"axes: the {NAMES[one.name]} turns as gyro {', '.join(tested) or 'none'} says (scale {scale:.3f})"
        if untested:
            message += f"; not tested: {', '.join(untested)}, as there is no rotation about it that shows"
        findings.append(Finding("axes-tested", "fact", message, values={"scale": scale}))
    return findings


def inverted(sensor: str, why: str, severe: bool, code: str) -> Finding:
    """Gravity, or the field, with its sign the wrong way round."""
    remedy = Remedy("matrix", sensor, f"{sensor} -> -{sensor}", _flat(-IDENTITY))
    return Finding(code, "error" if severe else "warning", f"{sensor}: {why}; multiply all axes by -1", remedy)


def _gyro_axes(matrix: Floats, by: Sequence[str], otherwise: str = "") -> Finding:
    witnesses = " and ".join(NAMES[name] for name in by)
    if np.array_equal(matrix, -IDENTITY):
        message = (
            f"gyro: turns the other way about every axis than the {witnesses} do: left-handed rates, or left-handed "
            "axes of the whole recording; multiply all three by -1 (or mirror one axis of all sensors)"
        )
        code = "gyro-handedness"
    else:
        message = f"gyro: its axes are wrong by the {witnesses}{otherwise}; change {describe('gyro', matrix)}"
        code = "gyro-axes"
    return Finding(code, "error", message, Remedy("matrix", "gyro", describe("gyro", matrix), _flat(matrix)))


def _sensor_axes(sensor: str, correction: Floats, why: str) -> Finding:
    text = describe(sensor, correction)
    message = f"{sensor}: its axes are wrong against the gyro ({why}); change {text}"
    return Finding(f"{sensor}-axes", "error", message, Remedy("matrix", sensor, text, _flat(correction)))


def _accel_by_truth(correction: Floats) -> Finding:
    if np.array_equal(correction, -IDENTITY):
        return inverted("accel", "gravity is inverted by the truth's attitude", True, "gravity-inverted")
    text = describe("accel", correction)
    message = f"accel: its axes are wrong by the truth's gravity; change {text}"
    return Finding("accel-axes", "error", message, Remedy("matrix", "accel", text, _flat(correction)))


def _truth_axes(matrix: Floats, cleared: Sequence[str]) -> Finding:
    who = " and ".join(NAMES[name] for name in cleared)
    if np.linalg.det(matrix) < 0:
        message = f"truth: is mirrored against the gyro, which fits the {who}; mend the truth's frame and import again"
        return Finding("truth-axes", "error", message)
    text = describe("truth body", matrix.T)
    message = f"truth: its body axes are not those of the sensor, whose gyro fits the {who}; change {text}"
    return Finding("truth-axes", "error", message, Remedy("matrix", "truth", text, _flat(matrix.T)))


def _mismatch(name: str, matrix: Floats) -> Finding:
    message = (
        f"{name}: fits the gyro only with {describe('gyro', matrix)}, which the other sensors deny, and no change of "
        f"the {NAMES[name]}'s own axes does it; look at its columns one by one"
    )
    return Finding(f"{name}-mismatch", "error", message)


def _favour(witnesses: Sequence[Witness], matrix: Floats) -> float:
    """How much better a gyro corrected so fits a witness that is not sure of itself, in nats."""
    doubtful = [one.losses for one in witnesses if one.choice is None and one.losses is not None]
    explaining = [losses for losses in doubtful if min(losses[index_of(IDENTITY)], losses[index_of(matrix)]) < 0]
    return sum(float(losses[index_of(IDENTITY)] - losses[index_of(matrix)]) for losses in explaining)


def _simplest(rotation_of_gyro: Floats) -> Floats:
    """The sensor's own correction that explains det(P) P: the simpler of the two with opposite signs."""
    return min((rotation_of_gyro.T, -rotation_of_gyro.T), key=complexity)


def _is_identity(matrix: Floats) -> bool:
    return bool(np.array_equal(matrix, IDENTITY))


def _flat(matrix: Floats) -> tuple[float, ...]:
    return tuple(float(value) + 0.0 for value in matrix.ravel())
