"""The section of a page about a reference: facts, what it found about the sensor, and its returns to the base pose."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stillpoint.datasets.recording import Floats
from stillpoint.datasets.trajectory import Calibration, Reference, compute_total_sd_rad
from stillpoint.scoring.compare import name_of


def describe_reference(reference: Reference) -> dict[str, Any]:
    """Return name, facts, rows of the calibration, and one entry per rest that was compared with the base pose."""
    return {
        "name": name_of(reference),
        "facts": _list_facts(reference),
        "calibration": dict(_list_calibration(reference.calibration)),
        "returns": _list_returns(reference),
    }


def _list_facts(reference: Reference) -> dict[str, str]:
    """Return facts about a reference by their titles, as text."""
    diagnostics = reference.diagnostics
    sd_deg = np.rad2deg(compute_total_sd_rad(reference.cov_b_rad2))
    rested_s = float(np.diff(reference.rests_ns, axis=1).sum()) / 1e9
    accepted = sum(back.accepted for back in reference.returns)
    facts = {
        "heading": str(diagnostics.get("heading", "")),
        "magnetometer left out": str(diagnostics.get("magnetometer_left_out", "")),
        "sd of the attitude": f"{np.median(sd_deg):.2f} deg (median), {sd_deg.max():.2f} deg (largest)",
        "rests": f"{len(reference.rests_ns)}, {rested_s:.0f} s in all",
        "returns": f"{accepted} of {len(reference.returns)} to the base pose used",
        "gaps in the stamps": _describe_gaps(diagnostics),
        "closing squares": ", ".join(f"{square:.2f}" for square in diagnostics.get("closing_squares", ())),
        "gyro bias": _describe_bias(reference.gyro_bias_b_radps),
        "iterations": str(diagnostics.get("iterations", "")),
    }
    if reference.heading_sd_rad > 0:
        facts["sd of the mean heading"] = f"{np.rad2deg(reference.heading_sd_rad):.2f} deg, an error all samples share"
    mounting_sd_deg = np.rad2deg(np.sqrt(np.trace(reference.mounting_cov_b_rad2)))
    if mounting_sd_deg > 0:
        facts["sd of the mean mounting"] = f"{mounting_sd_deg:.2f} deg, an error all samples share in body axes"
    late = reference.calibration.clock_offset_s.items()
    facts["clocks"] = ", ".join(f"{stream} {1e3 * seconds:+.1f} ms late against the gyro" for stream, seconds in late)
    return {title: fact for title, fact in facts.items() if fact}


def _describe_gaps(diagnostics: Mapping[str, Any]) -> str:
    return f"{diagnostics['gaps']}, the longest {diagnostics['longest_gap_s']:.2f} s" if diagnostics.get("gaps") else ""


def _describe_bias(gyro_bias_b_radps: Floats) -> str:
    """Return first and last value of each axis in words."""
    first, last = np.rad2deg(gyro_bias_b_radps[[0, -1]])
    axes = (f"{axis} {a:.3f} … {b:.3f}" for axis, a, b in zip("xyz", first, last, strict=True))
    return f"{', '.join(axes)} deg/s, first … last"


def _list_calibration(found: Calibration) -> Mapping[str, Sequence[str]]:
    """Return three cells per row, by the title of the row."""
    rows: dict[str, list[str]] = {}
    for sensor in ("gyro", "accel"):
        matrix, sd = getattr(found, f"{sensor}_matrix"), getattr(found, f"{sensor}_matrix_sd")
        if matrix is None:
            continue
        spread = np.full((3, 3), np.nan) if sd is None else sd
        for axis, values, sizes in zip("xyz", matrix, spread, strict=True):
            rows[f"{sensor} matrix, {axis}"] = [
                f"{value:.4f}" + ("" if np.isnan(size) else f" ± {size:.4f}")
                for value, size in zip(values, sizes, strict=True)
            ]
    vectors = {
        "accelerometer bias, m/s²": (found.accel_bias_b_mps2, 3),
        "hard iron, µT": (found.hard_iron_b_ut, 1),
        "field (east, north, up), µT": (found.field_n_ut, 1),
    }
    for title, (vector, digits) in vectors.items():
        if vector is not None:
            rows[title] = [f"{value:.{digits}f}" for value in vector]
    return rows


def _list_returns(reference: Reference) -> list[dict[str, Any]]:
    """Return one row per return to the base pose; times in s from the start of the reference."""
    zero_ns = int(reference.t_ns[0])
    return [
        {
            "start_s": (back.start_ns - zero_ns) / 1e9,
            "length_s": (back.end_ns - back.start_ns) / 1e9,
            "tilt_deg": float(np.rad2deg(back.tilt_difference_rad)),
            "used": back.accepted,
            "reason": back.reason,
        }
        for back in reference.returns
    ]
