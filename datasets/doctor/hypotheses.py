"""Compare hypotheses about wrong axes and a wrong truth over all the evidence together, the simplest first.

A hypothesis says which sensor measures in which wrong axes, and in which convention the truth was stored. Every pair of
sensors is evidence. With ``measured = M true`` for the gyro (G), accelerometer (A) and magnetometer (B), the pairs see
only products of these matrices:

- accelerometer and gyro: ``det(A) A G'``, as gravity obeys dv/dt = v x w in body axes; magnetometer and gyro alike;
- accelerometer and magnetometer: the angle between gravity and field, ``A B'``, whose sign is the dip of the field;
- truth and gyro, truth and accelerometer: see :mod:`stillpoint.datasets.doctor.conventions`.

The cost of a hypothesis is the log-likelihood, in nats, by which the pairs fit worse than they could, plus a penalty
for what it assumes. A remedy needs a winner that every pair agrees with and that is clearly better than any hypothesis
with another remedy. Otherwise the finding names the rivals and changes nothing.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stillpoint.datasets.doctor.conventions import TruthFits, TruthView
from stillpoint.datasets.doctor.field import Dips
from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.witness import CANDIDATES, Witness, describe, find_index, measure_complexity
from stillpoint.datasets.recording import Floats

# Penalties, in nats. A factor of 150 in likelihood (5 nats) is what the data must bring for one wrong sensor.
_TRUTH, _MOUNTING = 1.0, 1.0  # each convention of the truth, each turn of the whole IMU against the truth's body
_SENSOR, _PER_AXIS = 4.0, 1.0  # a wrong sensor, and each axis of it that is moved or flipped
_ALL_LEFT_HANDED = 10.0  # axes of all sensors mirrored alike: one decision of whoever wrote the driver
_CHAIN = 6.0  # a world turned by no convention, two wrong conventions of the truth, a mounting beside mirrored axes
_COINCIDENCE = 10.0  # a wrong truth and a wrong sensor at once
_CLEAR = 4.8  # the winner must be better by so much
_SCALE_LIMIT = 0.1  # relative: more is no calibration error of a working gyro
_ACCEL_ALONE, _MAG_ALONE = 0.2, 0.6  # ... when one sensor alone says so, which translation or a short turn may fool
_AGREEMENT = 0.1  # two scales that differ by less agree
_DEG_PER_RAD = 180 / np.pi
_NAMES = {"gyro": "gyro", "accel": "accelerometer", "mag": "magnetometer", "truth": "truth"}
_IDENTITY = np.eye(3)


@dataclass(frozen=True, eq=False)
class Fault:
    """Sensors in wrong axes: ``measured = matrix @ true``, each a signed permutation."""

    gyro: Floats
    accel: Floats
    mag: Floats
    penalty: float

    @cached_property
    def corrections(self) -> list[tuple[str, Floats]]:
        """Return each wrong sensor with the matrix that corrects it."""
        wrong = (("gyro", self.gyro), ("accel", self.accel), ("mag", self.mag))
        return [(name, matrix.T) for name, matrix in wrong if not np.array_equal(matrix, _IDENTITY)]


_NO_FAULT = Fault(_IDENTITY, _IDENTITY, _IDENTITY, 0.0)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A fault of sensors and a reading of the truth, with what they cost."""

    fault: Fault
    view: TruthView | None  # None without a truth, or where it shows nothing
    misfit: float  # nats by which the pairs fit worse than they could
    cost: float  # misfit and penalties

    @property
    def key(self) -> tuple[object, ...]:
        """Return the changes that this hypothesis calls for."""
        return tuple(self.part(name) for name in ("gyro", "accel", "mag", "truth"))

    def part(self, sensor: str) -> object:
        """Return what is changed about one sensor, or about the truth."""
        if sensor == "truth":
            return None if self.view is None else (self.view.reading.name, self.view.frame)
        return find_index(getattr(self.fault, sensor))

    @property
    def changes_nothing(self) -> bool:
        """Return whether nothing is wrong under this hypothesis; a mounting is no fault."""
        return not self.fault.corrections and (self.view is None or not self.view.wrong)


@dataclass(frozen=True, eq=False)
class Verdict:
    """The best hypothesis, whether it is clear, and its rivals with other remedies."""

    best: Hypothesis
    rivals: tuple[Hypothesis, ...]  # within CLEAR of the best

    def settles(self, sensor: str) -> bool:
        """Return whether every pair agrees with the best hypothesis, and every rival changes this sensor (or truth)
        alike.
        """
        return self.best.misfit <= 0.0 and all(rival.part(sensor) == self.best.part(sensor) for rival in self.rivals)


def compare_hypotheses(
    witnesses: Sequence[Witness], dips: Dips | None, accel_up: float | None, truth: TruthFits | None
) -> Verdict:
    """Return the cheapest hypothesis and its rivals.

    ``accel_up`` is the cosine between the specific force and up in a known base pose, for the accelerometer as it is.
    """
    excess = {one.name: one.choice.excess for one in witnesses if one.choice is not None}
    found: list[Hypothesis] = []
    of_signs: dict[tuple[int, int], float] = {}  # the same for every fault of the gyro
    for fault in _list_faults("mag" in {one.name for one in witnesses}):
        misfit = _compute_imu_misfit(fault, excess)
        signs = find_index(fault.accel), find_index(fault.mag)
        if signs not in of_signs:
            of_signs[signs] = _sign_penalty(fault, dips, accel_up)
        penalty = fault.penalty + of_signs[signs]
        if truth is None or not truth.informative:
            found.append(Hypothesis(fault, None, misfit, misfit + penalty))
            continue
        for view in truth.views(fault.gyro, fault.accel):
            total = misfit + view.misfit
            found.append(Hypothesis(fault, view, total, total + penalty + _compute_truth_penalty(fault, view)))
    found.sort(key=lambda one: (one.cost, len(one.fault.corrections)))
    best = found[0]
    rivals = [one for one in found[1:] if one.cost < best.cost + _CLEAR and one.key != best.key]
    return Verdict(best, tuple(rivals))


def _compute_truth_penalty(fault: Fault, view: TruthView) -> float:
    """Return the nats against a truth in these conventions beside this fault of the sensors.

    A cyclic order of the components is the inverse quaternion between two other constant rotations, and a mirrored
    axis is another one seen through a mounting: what is explained by one convention need not be by a chain of them.
    """
    penalty = _TRUTH * view.changes + _MOUNTING * view.mounted
    if view.wrong and fault.corrections:
        penalty += _COINCIDENCE
    unnamed = view.frame == "turned"
    chained = view.changes > 1 or (view.mounted and len(fault.corrections) > 1)
    return penalty + _CHAIN * (unnamed + chained)


def _list_faults(has_mag: bool) -> Iterator[Fault]:
    """Yield the faults that are compared: none, one sensor, inverted axes beside a wrong gyro, all left-handed."""
    yield _NO_FAULT
    for matrix in CANDIDATES[1:]:
        cost = _SENSOR + _PER_AXIS * _count_changed_axes(matrix)
        yield Fault(matrix, _IDENTITY, _IDENTITY, cost)
        yield Fault(_IDENTITY, matrix, _IDENTITY, cost)
        yield Fault(matrix, -_IDENTITY, _IDENTITY, cost + _SENSOR + _PER_AXIS)
        if has_mag:
            yield Fault(_IDENTITY, _IDENTITY, matrix, cost)
            yield Fault(matrix, _IDENTITY, -_IDENTITY, cost + _SENSOR + _PER_AXIS)
    for axis in range(3):
        mirror = np.eye(3)
        mirror[axis, axis] = -1.0
        yield Fault(mirror, mirror, mirror if has_mag else _IDENTITY, _ALL_LEFT_HANDED)


def _count_changed_axes(matrix: Floats) -> int:
    """Return how many axes are moved or flipped; a sign that is wrong for all three is one mistake."""
    return 1 if np.array_equal(matrix, -_IDENTITY) else measure_complexity(matrix)[0]


def _compute_imu_misfit(fault: Fault, excess: dict[str, Floats]) -> float:
    """Return the nats by which accelerometer and magnetometer fit the gyro worse than they could."""
    total = 0.0
    for name, matrix in (("accel", fault.accel), ("mag", fault.mag)):
        if name in excess:
            total += float(excess[name][find_index(np.linalg.det(matrix) * matrix @ fault.gyro.T)])
    return total


def _sign_penalty(fault: Fault, dips: Dips | None, accel_up: float | None) -> float:
    """Return the nats against the signs of gravity and field: by the dip of the field and by a known base pose."""
    penalty = 0.0 if dips is None else dips.compute_penalty(fault.accel, fault.mag)
    if accel_up is not None and np.array_equal(np.abs(fault.accel), _IDENTITY):
        sign = -1.0 if np.array_equal(fault.accel, -_IDENTITY) else 1.0
        penalty += 20.0 if sign * accel_up < -0.85 else 0.0  # more than 150 deg off: no pose is stated so badly
    return penalty


def report_axes_faults(verdict: Verdict, witnesses: Sequence[Witness]) -> list[Finding]:
    """Return the findings of a verdict: on the truth, on sensors, or that the evidence is contradictory."""
    best = verdict.best
    if best.changes_nothing and not any(rival.misfit < best.misfit for rival in verdict.rivals):
        return ([] if best.view is None else best.view.findings()) + _report_signs(verdict)
    findings = [] if best.view is None else best.view.findings()
    agreeing = _name_agreeing(best, witnesses)
    findings += [_report_sensor(name, matrix, agreeing) for name, matrix in best.fault.corrections]
    others = list(dict.fromkeys(map(_describe, verdict.rivals)))[:3]
    why = "the pairs of sensors contradict each other" if best.misfit > 0 else "the evidence does not decide"
    advice = f"; {why}" + (f": it could also be that {' or that '.join(others)}" if others else "")
    return [
        one
        if one.remedy is None or verdict.settles(one.remedy.target)
        else replace(one, message=_drop_advice(one.message) + advice + "; nothing is changed", remedy=None)
        for one in findings
    ]


def _report_signs(verdict: Verdict) -> list[Finding]:
    """Warn where nothing need be wrong but an inverted accelerometer or magnetometer would explain as much."""
    if verdict.best.cost <= 0 or not verdict.rivals:
        return []
    described = [_describe(rival) for rival in verdict.rivals if rival.fault.corrections]
    if not described:
        return []
    message = (
        "accel: the field points up from the horizon that gravity gives: the recording is from the southern "
        f"hemisphere, or {' or '.join(dict.fromkeys(described))}; give its place (--place LAT,LON)"
    )
    return [Finding("gravity-inverted", "warning", message)]


def _report_sensor(sensor: str, correction: Floats, agreeing: str) -> Finding:
    """Return the finding about one sensor in wrong axes."""
    text = describe(sensor, correction)
    remedy = Remedy("matrix", sensor, text, _flatten(correction))
    inverted = np.array_equal(correction, -_IDENTITY)
    if inverted and sensor == "gyro":
        message = (
            f"gyro: turns the other way about every axis than {agreeing}: left-handed rates, or left-handed axes of "
            "the whole recording; multiply all three by -1 (or mirror one axis of all sensors)"
        )
        return Finding("gyro-handedness", "error", message, remedy)
    if inverted:
        code = "gravity-inverted" if sensor == "accel" else "mag-inverted"
        remedy = replace(remedy, text=f"{sensor} -> -{sensor}")
        what = "gravity is inverted" if sensor == "accel" else "all axes are inverted"
        return Finding(code, "error", f"{sensor}: {what} by {agreeing}; multiply all axes by -1", remedy)
    message = f"{sensor}: its axes are wrong by {agreeing}; change {text}"
    return Finding(f"{sensor}-axes", "error", message, remedy)


def _name_agreeing(best: Hypothesis, witnesses: Sequence[Witness]) -> str:
    """Name the sensors that agree among themselves under a hypothesis."""
    wrong = {name for name, _ in best.fault.corrections}
    names = [one.name for one in witnesses if one.choice is not None and one.name not in wrong]
    names += ["truth"] if best.view is not None and best.view.frame is None and not best.view.wrong else []
    if wrong & {"accel", "mag"} and not wrong & {"gyro"}:
        names = [*names, "gyro"]
    return " and ".join(f"the {_NAMES[name]}" for name in dict.fromkeys(names)) or "the dip of the field"


def _describe(hypothesis: Hypothesis) -> str:
    """Say in a few words what is wrong under a hypothesis."""
    parts = [f"the {_NAMES[name]} is wrong ({describe(name, m)})" for name, m in hypothesis.fault.corrections]
    if hypothesis.view is not None and hypothesis.view.wrong:
        parts.append(f"the truth is wrong ({hypothesis.view.words})")
    elif hypothesis.view is not None and hypothesis.view.mounted:
        parts.append("the IMU is turned against the truth's body")
    return " and ".join(parts) or "nothing is wrong"


def _drop_advice(message: str) -> str:
    """Return a message without what follows its first semicolon, the advice."""
    return message.split("; ")[0]


def find_scale_fault(witnesses: Sequence[Witness]) -> Finding | None:
    """Find a gyro in deg/s, one whose rates are too large or too small, or stamps on a wrong time base."""
    scales = {one.name: one.scale for one in witnesses if one.choice is not None and one.scale}
    found = _find_common_scale(scales)
    if found is None:
        return None
    scale, who = found
    named = " and ".join(f"{_NAMES[name]} ({scales[name]:.4g})" for name in who)
    if abs(scale * _DEG_PER_RAD - 1) < 0.15:
        factor = 1 / _DEG_PER_RAD
        message = f"gyro: in deg/s by the {named}: multiply by {factor:.6g}"
        remedy = Remedy("matrix", "gyro", f"gyro * {factor:.6g} (deg/s -> rad/s)", _flatten(factor * _IDENTITY))
        return Finding("gyro-units", "error", message, remedy, {"scale": scale})
    message = (
        f"gyro: rates must be multiplied by {scale:.4g} to fit the {named}: a wrong range or unit of the gyro, or "
        f"a time base that is wrong by this factor; multiply by {scale:.4g}, or the steps of time if the rate is wrong"
    )
    remedy = Remedy("matrix", "gyro", f"gyro * {scale:.6g}", _flatten(scale * _IDENTITY))
    sure = len(who) > 1 or who == ["truth"]
    return Finding("gyro-scale", "error", message, remedy if sure else None, {"scale": scale})


def _find_common_scale(scales: dict[str, float]) -> tuple[float, list[str]] | None:
    """Return the factor by which the gyro is wrong and the sensors that show it; None where they do not agree."""

    def measure_log(scale: float) -> float:
        return abs(float(np.log(scale)))

    if "truth" in scales:
        others = [name for name in ("mag", "accel") if name in scales]
        denied = others and all(measure_log(scales[name]) < _AGREEMENT for name in others)
        return (scales["truth"], ["truth"]) if measure_log(scales["truth"]) > _SCALE_LIMIT and not denied else None
    if "accel" in scales and "mag" in scales:
        both = measure_log(scales["accel"] / scales["mag"]) < _AGREEMENT
        # Each by itself: one may be far off alone.
        sure = min(measure_log(scales["accel"]), measure_log(scales["mag"])) > _SCALE_LIMIT
        mean = float(np.sqrt(scales["accel"] * scales["mag"]))
        return (mean, ["accel", "mag"]) if both and sure else None
    for name, limit in (("accel", _ACCEL_ALONE), ("mag", _MAG_ALONE)):
        if name in scales and measure_log(scales[name]) > limit:
            return scales[name], [name]
    return None


def report_tested_axes(witnesses: Sequence[Witness]) -> list[Finding]:
    """Return what each witness confirmed, and what could not be tested."""
    findings = []
    for one in witnesses:
        if one.choice is None:
            message = f"axes: not tested by the {_NAMES[one.name]}: too little turning that it could see"
            findings.append(Finding("axes-not-tested", "fact", message))
            continue
        tested = [axis for axis, seen in zip("xyz", one.choice.tested, strict=True) if seen]
        untested = [axis for axis in "xyz" if axis not in tested]
        scale = one.scale or float("nan")
        message = f"axes: the {_NAMES[one.name]} turns as gyro {', '.join(tested) or 'none'} says (scale {scale:.3f})"
        if untested:
            message += f"; not tested: {', '.join(untested)}, because no rotation about it can be seen"
        findings.append(Finding("axes-tested", "fact", message, values={"scale": scale}))
    return findings


def _flatten(matrix: Floats) -> tuple[float, ...]:
    """Return a matrix row by row, without negative zeros."""
    return tuple(float(value) + 0.0 for value in matrix.ravel())
