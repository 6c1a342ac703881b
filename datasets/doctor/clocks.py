"""Clocks: rate, gaps, lost samples, bursts and jitter of each stream, overlaps, and files that were cut short."""

import numpy as np

from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.remedy import LONGEST_BURST_S
from stillpoint.datasets.recording import Floats, Info, Recording, Times
from stillpoint.datasets.times import find_longest_step_ns

_GAP_S = 0.05  # a shorter step is never a gap
_BURST_SHARE = 0.5  # in bursts the median step is below this share of the mean step
_JITTER_SHARE = 0.25  # sd of the steps, of their median, above which the stamps are not the sampling instants
_LOST_SHARE = 0.01  # of the samples
_CUT = ("the file is cut short", "the end of the file is cut off")  # how the notes begin that a reader leaves
_PLAUSIBLE_HZ, _USUAL_HZ = (2.0, 50_000.0), (10.0, 10_000.0)
_UNITS_OF_TIME = {  # what a rate is multiplied by when the unit of the stamps is put right
    1e3: "are ms that were read as s (or us as ms, ns as us)",
    1e6: "are us that were read as s (or ns as ms)",
    1e9: "are ns that were read as s",
    1e-3: "are s that were read as ms (or ms as us, us as ns)",
}
_OVERLAP_SHARE = 0.9  # of the IMU's time that a magnetometer should cover
_SAMPLED = ("imu", "mag", "spin")  # evenly sampled sensors; truth, gps and encoder may pause


def list_losses(info: Info) -> list[str]:
    """Return what was lost when the file of a recording was cut, in words."""
    return [note for note in info.notes if note.startswith(_CUT)]


def check_losses(recording: Recording) -> list[Finding]:
    """Return one finding per loss of a file that was cut."""
    return [
        Finding("file-cut", "warning", f"{note}; copy it again where you can") for note in list_losses(recording.info)
    ]


def check_clocks(recording: Recording) -> list[Finding]:
    """Return one fact per stream, and a finding for whatever is wrong with its stamps."""
    findings = []
    for name, t_ns in recording.streams():
        if len(t_ns) < 10:
            findings.append(Finding(f"{name}-short", "warning", f"{name}: has {len(t_ns)} samples, too few to test"))
            continue
        findings += _check_stream(name, t_ns)
    return findings + _check_overlap(recording)


def _check_stream(name: str, t_ns: Times) -> list[Finding]:
    """Return the findings about the stamps (N,) of one stream: rate, unit of time, gaps, bursts and regularity."""
    steps_s = np.diff(t_ns) / 1e9
    median = float(np.median(steps_s))
    mean = float(np.mean(steps_s[steps_s < LONGEST_BURST_S])) if (steps_s < LONGEST_BURST_S).any() else median
    bursts = name in _SAMPLED and median < _BURST_SHARE * mean
    limit = LONGEST_BURST_S if bursts else max(find_longest_step_ns(t_ns) / 1e9, _GAP_S)
    gaps = steps_s > limit
    findings = [_report_rate(name, t_ns, mean if bursts else median), *_check_unit(name, mean if bursts else median)]
    if gaps.any():
        findings.append(_report_gaps(name, t_ns, steps_s, gaps))
    if bursts:
        findings.append(_report_bursts(name, median, mean, float(steps_s[~gaps].max())))
    elif name in _SAMPLED:
        findings += _check_regularity(name, steps_s[~gaps], median)
    return findings


def _report_rate(name: str, t_ns: Times, step_s: float) -> Finding:
    """Return the fact about rate, samples and length of a stream with stamps (N,)."""
    seconds = float(t_ns[-1] - t_ns[0]) / 1e9
    message = f"{name}: {1 / step_s:.2f} Hz, {len(t_ns)} samples in {seconds:.1f} s"
    return Finding(f"{name}-rate", "fact", message, values={"rate_hz": 1 / step_s, "duration_s": seconds})


def _check_unit(name: str, step_s: float) -> list[Finding]:
    """Report stamps of an IMU whose unit is wrong: no IMU samples so slowly or so fast."""
    rate = 1 / step_s
    if name != "imu" or _PLAUSIBLE_HZ[0] <= rate <= _PLAUSIBLE_HZ[1]:
        return []
    message = f"imu: {rate:.4g} Hz is no rate of an IMU"
    for factor, advice in _UNITS_OF_TIME.items():
        if _USUAL_HZ[0] <= rate * factor <= _USUAL_HZ[1]:
            message += f"; {rate * factor:.4g} Hz is, if the stamps {advice}: import again with that unit of time"
            break
    else:
        message += "; find out the unit of its stamps, and import again"
    return [Finding("imu-clock-units", "error", message, values={"rate_hz": rate})]


def _report_gaps(name: str, t_ns: Times, steps_s: Floats, gaps: np.ndarray) -> Finding:
    """Return the finding about gaps: a warning for the IMU's and the other sampled streams, else a fact."""
    longest = int(np.argmax(steps_s))
    at_s = float(t_ns[longest] - t_ns[0]) / 1e9
    message = (
        f"{name}: {int(gaps.sum())} gaps, {steps_s[gaps].sum():.2f} s in all; the longest lasts "
        f"{steps_s[longest]:.3f} s, {at_s:.2f} s after the start"
    )
    values = {"gaps": float(gaps.sum()), "longest_s": float(steps_s[longest]), "at_s": at_s}
    if name not in _SAMPLED:
        return Finding(f"{name}-gap", "fact", message, values=values)
    advice = (
        "; nothing can fill it: cut the recording there (stillpoint cut --drop-gap), or trust no attitude across it"
    )
    return Finding(f"{name}-gap", "warning", message + advice, values=values)


def _report_bursts(name: str, median: float, mean: float, longest: float) -> Finding:
    """Return the finding that stamps come in bursts, with the line through them as its remedy."""
    remedy = Remedy("line", name, f"{name}: evenly spaced stamps by a line through the receipt times")
    message = (
        f"{name}: stamps come in bursts (median step {1e3 * median:.2f} ms, mean {1e3 * mean:.2f} ms, "
        f"longest {1e3 * longest:.0f} ms): they are times of receipt; put a line through them"
    )
    return Finding(f"{name}-bursts", "warning", message, remedy, {"median_s": median, "mean_s": mean})


def _check_regularity(name: str, steps_s: Floats, median: float) -> list[Finding]:
    """Return findings about lost samples, which leave steps at multiples of the median, and about jitter."""
    ratio = steps_s / median
    whole = (ratio > 1.5) & (np.abs(ratio - np.round(ratio)) < 0.2)
    jitter_s = float(steps_s[~whole].std()) if (~whole).any() else 0.0
    lost = int((np.round(ratio[whole]) - 1).sum())
    findings = []
    if jitter_s > _JITTER_SHARE * median:
        remedy = Remedy("line", name, f"{name}: evenly spaced stamps by a line through the jittered ones")
        message = (
            f"{name}: steps vary by {1e3 * jitter_s:.2f} ms (sd) about {1e3 * median:.2f} ms: the stamps are not the "
            "sampling instants; put a line through them"
        )
        return [Finding(f"{name}-jitter", "warning", message, remedy, {"jitter_s": jitter_s})]
    message = f"{name}: steps vary by {1e3 * jitter_s:.3f} ms (sd) about {1e3 * median:.3f} ms"
    findings.append(Finding(f"{name}-steps", "fact", message, values={"jitter_s": jitter_s}))
    if lost:
        many = lost > _LOST_SHARE * (len(steps_s) + lost)
        message = f"{name}: {lost} samples are missing one by one"
        advice = "; look for what loses them when recording" if many else ""
        findings.append(
            Finding(f"{name}-lost", "warning" if many else "fact", message + advice, values={"lost": float(lost)})
        )
    return findings


def _check_overlap(recording: Recording) -> list[Finding]:
    """Return findings about streams that share no time, or little time, with the IMU."""
    if recording.imu is None:
        return []
    imu_ns = recording.imu.t_ns
    findings = []
    for name, t_ns in recording.streams():
        if name == "imu" or len(t_ns) < 2:
            continue
        common = float(min(imu_ns[-1], t_ns[-1]) - max(imu_ns[0], t_ns[0])) / 1e9
        whole = float(imu_ns[-1] - imu_ns[0]) / 1e9
        values = {"common_s": max(common, 0.0), "imu_s": whole}
        if common <= 0:
            message = (
                f"{name}: shares no time with the IMU (it is {-common:.1f} s apart): the clocks have different zeros; "
                "shift one of them, or import again with one zero"
            )
            findings.append(Finding(f"{name}-apart", "error", message, values=values))
        elif name == "mag" and common < _OVERLAP_SHARE * whole:
            message = f"{name}: covers {common:.1f} of the IMU's {whole:.1f} s; outside there is no heading from it"
            findings.append(Finding(f"{name}-overlap", "warning", message, values=values))
    return findings
