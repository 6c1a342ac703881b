"""Examine a recording that is too long for memory by stretches of it, spread evenly, and say which they were."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stillpoint.datasets.doctor.finding import SEVERITIES, Diagnosis, Finding
from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.files.remote import is_url
from stillpoint.datasets.mcap.indexed import Window
from stillpoint.datasets.mcap.summary import summarise

MOST_SAMPLES = 1 << 20  # of gyro and accelerometer that are examined whole: 87 minutes at 200 Hz
COUNT = 4  # stretches of a longer recording: its begin, its end, and two between
STRETCH_SAMPLES = MOST_SAMPLES // COUNT


def choose_stretches(path: Path) -> list[Window]:
    """Return the stretches by which a file is to be examined; none for one that is examined whole.

    Whole are examined short recordings, those of a spinning body alone, files behind a URL, and files without an index.
    """
    if is_url(path):
        return []
    try:
        summary = summarise(path)
    except BadFile:
        return []  # reading it whole says what is wrong with it, or what was lost
    imu = next((one for one in summary.streams if one.name == "imu"), None)
    if summary.kind != "recording" or imu is None or imu.samples <= MOST_SAMPLES:
        return []
    length_ns = round(STRETCH_SAMPLES * imu.step_ns)
    starts = np.linspace(imu.first_ns, max(imu.last_ns - length_ns, imu.first_ns), COUNT).astype(np.int64)
    return [Window(int(start), int(start) + length_ns) for start in starts]


def merge_diagnoses(diagnoses: Sequence[tuple[Window, Diagnosis]]) -> Diagnosis:
    """Return the findings of all stretches as one diagnosis: each code once, by the stretch where it is worst.

    A finding of some stretches only says how many, and when the first of them begins.
    """
    whole = Window(diagnoses[0][0].start_ns, diagnoses[-1][0].end_ns)
    spans = ", ".join(_say_time(one.start_ns - whole.start_ns) for one, _ in diagnoses)
    examined_s = sum(one.end_ns - one.start_ns for one, _ in diagnoses) / 1e9
    findings = [
        Finding(
            "part-examined",
            "fact",
            f"{len(diagnoses)} stretches of {examined_s / len(diagnoses) / 60:.0f} minutes were examined of "
            f"{(whole.end_ns - whole.start_ns) / 3.6e12:.1f} h, at {spans}; `stillpoint cut` takes out others, "
            "`stillpoint info --full` counts the gaps of all",
            values={"examined_s": examined_s, "stretches": float(len(diagnoses))},
        )
    ]
    by_code: dict[str, list[tuple[Window, Finding]]] = {}
    for stretch, diagnosis in diagnoses:
        for finding in diagnosis.findings:
            by_code.setdefault(finding.code, []).append((stretch, finding))
    for found in by_code.values():
        worst = min(found, key=lambda one: SEVERITIES.index(one[1].severity))[1]
        stretches = {one.start_ns for one, _ in found}
        if len(stretches) < len(diagnoses):
            first = _say_time(min(stretches) - whole.start_ns)
            message = f"{worst.message} (in {len(stretches)} of {len(diagnoses)} stretches, first in that at {first})"
            worst = replace(worst, message=message)
        findings.append(worst)
    return Diagnosis(diagnoses[0][1].recording, tuple(findings))


def _say_time(since_ns: int) -> str:
    return f"{since_ns / 3.6e12:.1f} h"
