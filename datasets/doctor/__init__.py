"""Test a recording by physics, and say what to do.

:func:`diagnose` runs the tests, :func:`apply` makes the changes that they ask for. ``docs/doctor.md`` says for each
finding what it rests on, from where on it is said, and what the remedy is.
"""

from stillpoint.datasets.doctor.diagnose import diagnose
from stillpoint.datasets.doctor.finding import SEVERITIES, Diagnosis, Finding, Remedy, Severity
from stillpoint.datasets.doctor.remedy import apply

__all__ = ["SEVERITIES", "Diagnosis", "Finding", "Remedy", "Severity", "apply", "diagnose"]
