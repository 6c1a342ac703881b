"""The findings of the doctor, each with a remedy where there is one that a program can apply."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Severity = Literal["error", "warning", "fact"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "fact")


@dataclass(frozen=True)
class Remedy:
    """A change of a recording, as data; :func:`stillpoint.datasets.doctor.apply` makes it.

    ======================  =========================  ==========================================================
    kind                    target                     values
    ======================  =========================  ==========================================================
    ``matrix``              gyro, accel, mag, truth    9 numbers, row by row: corrected = matrix @ measured
    ``offset``              gyro, accel, mag           3 numbers in the stream's unit: corrected = measured - offset
    ``shift``               gyro, accel, mag, truth    1 number, s: what was stamped t belongs at t + shift
    ``line``                imu, mag                   none: stamps become evenly spaced between gaps
    ``drop``                imu, mag, truth            pairs of first and last stamp, ns, of what goes
    ``drop-repeats``        imu, mag                   none: of equal neighbouring samples the first stays
    ``interpolate``         gyro, accel                none: held values become lines between their changes
    ``drop-stream``         mag, truth                 none
    ``conjugate``           truth                      none: q becomes its inverse
    ``reorder``             truth                      none: x, y, z, w was read as w, x, y, z
    ``reorder-back``        truth                      none: w, x, y, z was read as x, y, z, w
    ``world``               truth                      9 numbers: corrected = matrix * q_nb, positions alike
    ``mirror``              truth                      1 number: the axis (0, 1, 2) that is mirrored
    ======================  =========================  ==========================================================

    For the truth a ``matrix`` is a rotation that turns the axes of its body: corrected = q_nb * matrix^T.
    """

    kind: str
    target: str
    text: str  # "gyro x -> -x", kept in Info.conversions
    values: tuple[float, ...] = ()


@dataclass(frozen=True)
class Finding:
    """One thing that a test found, in one sentence with its numbers and what to do about it."""

    code: str  # stable: machines and docs/doctor.md refer to it
    severity: Severity
    message: str
    remedy: Remedy | None = None
    values: Mapping[str, float] = field(default_factory=dict)  # the numbers of the message, SI units in the names


@dataclass(frozen=True)
class Diagnosis:
    """All findings about one recording, in the order of the tests."""

    recording: str
    findings: tuple[Finding, ...]

    @property
    def clean(self) -> bool:
        """Whether the findings are neither errors nor warnings."""
        return all(finding.severity == "fact" for finding in self.findings)

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """Return the remedies for :func:`~stillpoint.datasets.doctor.apply`, in the order of the findings."""
        return tuple(finding.remedy for finding in self.findings if finding.remedy is not None)

    def codes(self, *severities: Severity) -> tuple[str, ...]:
        """Return the codes of the findings of these severities (of all when none is named)."""
        wanted = severities or SEVERITIES
        return tuple(finding.code for finding in self.findings if finding.severity in wanted)

    def rows(self) -> list[dict[str, Any]]:
        """Return one JSON object per finding; a number that is not finite becomes null."""
        return [
            {
                "recording": self.recording,
                "code": finding.code,
                "severity": finding.severity,
                "message": finding.message,
                "remedy": None
                if finding.remedy is None
                else {
                    "kind": finding.remedy.kind,
                    "target": finding.remedy.target,
                    "values": list(finding.remedy.values),
                    "text": finding.remedy.text,
                },
                "values": {key: value if math.isfinite(value) else None for key, value in finding.values.items()},
            }
            for finding in self.findings
        ]
