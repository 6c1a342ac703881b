"""``stillpoint info``: print what is in a recording, reference or estimate."""

import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.errors import StillpointError
from stillpoint.datasets.files.remote import is_url
from stillpoint.datasets.mcap.facts import info_from
from stillpoint.datasets.mcap.store import read
from stillpoint.datasets.mcap.summary import FileSummary, summarise
from stillpoint.datasets.recording import Floats, Info, Recording, Spin, Times, rate_hz
from stillpoint.datasets.spin import find_saturated
from stillpoint.datasets.times import find_gaps
from stillpoint.datasets.trajectory import Estimate, Reference, SpinReference, total_sd_rad
from stillpoint.scripts.shared.flags import Columns, Inputs, Jobs
from stillpoint.scripts.shared.inputs import mcap_files
from stillpoint.scripts.shared.jobs import exit_code, run_short_jobs
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.shared.recordings import find_rests_at_default
from stillpoint.scripts.shared.tables import print_table

LARGE_BYTES = 64 << 20  # a file above this is summarised: reading 64 MiB takes about a second
COLUMNS = ("stream", "samples", "Hz", "start, s", "length, s", "gaps", "longest, s")

SHOWN = ("heading", "sign_of_gravity", "gaps", "magnetometer_left_out")  # of a reference's diagnostics


def info(
    paths: Inputs,
    /,
    *,
    full: Annotated[bool, Parameter(negative="")] = False,
    units_unchecked: Annotated[bool, Parameter(negative="")] = False,
    jobs: Jobs = None,
    columns: Columns = None,
    json: JsonFile = None,
) -> int:
    """Print what is in a file: streams, rates, gaps, duration, rests, provenance.

    A file that cannot be read is named, the others are shown, and the exit code is 2.

    Parameters
    ----------
    paths
        MCAP files, folders or globs: recordings, references and estimates.
    full
        Read and check every sample of a large file too, to count gaps and find rests. Without it a file of more than
        64 MiB is summarised from its index and a few chunks.
    units_unchecked
        Open recordings whose sizes do not fit their units.
    jobs
        Processes; by default one per core for many files, else this one alone.
    columns
        Columns of the table of streams to show: names with commas between, or all. By default those that fit.
    json
        Also write the facts as JSON to this file; - is the standard output.
    """
    files = mcap_files(paths)
    outcomes = run_short_jobs(partial(_read_facts, full, units_unchecked), files, jobs, "info")
    rows: list[dict[str, Any]] = []
    for path, outcome in zip(files, outcomes, strict=True):
        if outcome.value is None:
            if len(files) == 1 and not outcome.defect:
                raise StillpointError(str(outcome.error))
            print_line(f"stillpoint: {outcome.error}", file=sys.stderr)
            rows.append({"file": str(path), "error": outcome.error})
            continue
        rows.append({**outcome.value, "error": None})
        if json != STDOUT:
            _print_facts(outcome.value, columns)
    write_json(json, rows)
    return exit_code(outcomes)


def _read_facts(full: bool, units_unchecked: bool, path: Path) -> dict[str, Any]:
    """Return the facts about one file: from its index when it is large, else from all of its samples."""
    is_large = not is_url(path) and path.is_file() and path.stat().st_size > LARGE_BYTES
    if is_url(path) or (is_large and not full):
        return _list_summary_facts(path, summarise(path))
    return _list_facts(path, read(path, units_unchecked))


def _list_summary_facts(path: Path, summary: FileSummary) -> dict[str, Any]:
    """Return the facts that the index of a file and a few of its chunks give; what was not looked for is None."""
    name = summary.facts.get("name", "")
    if summary.kind == "estimate":
        name = summary.facts.get("recording", "")
    first_ns = min((one.first_ns for one in summary.streams), default=0)
    last_ns = max((one.last_ns for one in summary.streams), default=0)
    facts: dict[str, Any] = {
        "file": str(path),
        "kind": summary.kind,
        "name": name,
        "duration_s": (last_ns - first_ns) / 1e9,
        "streams": [
            {
                "stream": one.name,
                "samples": one.samples,
                "rate_hz": 1e9 / one.step_ns if one.step_ns else 0.0,
                "start_s": one.first_ns / 1e9,
                "length_s": (one.last_ns - one.first_ns) / 1e9,
                "gaps": None,
                "longest_gap_s": None,
            }
            for one in summary.streams
        ],
        "summarised": f"from {summary.chunks_read} of {summary.chunks} chunks; --full counts gaps and finds rests",
    }
    if summary.kind == "recording":
        return facts | {"rests": None} | _list_provenance(info_from(summary.facts))
    return facts | {key: summary.facts[key] for key in ("method", "params", "made_from") if key in summary.facts}


def _list_facts(path: Path, thing: Recording | Reference | SpinReference | Estimate) -> dict[str, Any]:
    """Return the facts about the content of one file."""
    if isinstance(thing, Recording):
        return {"file": str(path), "kind": "recording", "name": thing.name, **_list_recording_facts(thing)}
    name = thing.recording if isinstance(thing, Estimate) else thing.name
    facts: dict[str, Any] = {
        "file": str(path),
        "kind": "estimate",
        "name": name,
        "streams": [_describe_clock("q_nb", thing.t_ns)],
    }
    if isinstance(thing, Reference):
        sd_deg = np.rad2deg(total_sd_rad(thing.cov_b_rad2))
        returns = [one.accepted for one in thing.returns]
        facts |= {"kind": "reference", "method": thing.method, "rests": _list_spans(thing.rests_ns, thing.t_ns)}
        facts |= {"returns": len(returns), "returns_accepted": sum(returns)}
        facts |= {"sd_median_deg": float(np.median(sd_deg)), "sd_max_deg": float(sd_deg.max())}
        facts |= {"heading_sd_deg": float(np.rad2deg(thing.heading_sd_rad))}
        facts |= {name: thing.diagnostics[name] for name in SHOWN if name in thing.diagnostics}
    elif isinstance(thing, SpinReference):
        sd_deg = np.rad2deg(thing.angle_sd_rad)
        facts |= {"kind": "roll reference", "method": thing.method, "streams": [_describe_clock("angle", thing.t_ns)]}
        facts |= {"sd_median_deg": float(np.median(sd_deg)), "sd_max_deg": float(sd_deg.max())}
    else:
        facts |= {"estimator": thing.name, "ns_per_sample": thing.ns_per_sample}
        facts["not_ready"] = 0 if thing.ready is None else int((~thing.ready).sum())
    return facts | {"params": dict(thing.params), "made_from": dict(thing.made_from)}


def _list_recording_facts(recording: Recording) -> dict[str, Any]:
    info = recording.info
    imu = recording.imu
    facts = {
        "duration_s": recording.duration_s,
        "streams": [_describe_clock(name, t_ns) for name, t_ns in recording.streams()],
        "rests": [] if imu is None else _list_spans(find_rests_at_default(recording), imu.t_ns),
        "base_pose": None if recording.base_pose is None else recording.base_pose.tolist(),
        "spin": [] if recording.spin is None else _describe_spin(recording.spin),
    }
    return facts | _list_provenance(info)


def _list_provenance(info: Info) -> dict[str, Any]:
    """Return what a recording says about its source."""
    said = {name: getattr(info, name) for name in ("source", "licence", "citation", "sensor", "date", "epoch")}
    marks = {name: getattr(info, name) for name in ("mag_uncalibrated", "units_unchecked")}
    place = None if info.place_lat_lon_alt is None else list(info.place_lat_lon_alt)
    lists = {"conversions": list(info.conversions), "notes": list(info.notes)}
    return {
        **said,
        "place_lat_lon_alt": place,
        **marks,
        "extra": dict(info.extra),
        **lists,
        "sha256": dict(info.sha256),
    }


def _describe_spin(spin: Spin) -> list[str]:
    """Return lines about the single-axis sensors: place, axis, and how many values are saturated or missing."""
    geometry, full, missing = (
        spin.geometry,
        find_saturated(spin).sum(axis=0),
        (~np.isfinite(spin.accel_mps2)).sum(axis=0),
    )
    lines = ["on a fixed axis (a motor's shaft)" if geometry.fixed_axis else "free to turn about all axes"]
    for k, (arm, axis) in enumerate(zip(geometry.accel_r_b_m, geometry.accel_axis_b, strict=True)):
        limit = (
            ""
            if geometry.accel_range_mps2 is None
            else f", range {geometry.accel_range_mps2[k] / STANDARD_GRAVITY_MPS2:.3g} g"
        )
        place = "arm not known" if np.isnan(arm).any() else f"arm {_format_vector(arm)} m"
        spoilt = f", {full[k]} saturated" * bool(full[k]) + f", {missing[k]} missing" * bool(missing[k])
        lines.append(f"accelerometer {k + 1}: {place}, axis {_format_vector(axis)}{limit}{spoilt}")
    return lines + [f"gyro {k + 1}: axis {_format_vector(axis)}" for k, axis in enumerate(geometry.gyro_axis_b)]


def _format_vector(values: Floats) -> str:
    return f"({', '.join(f'{value:.4g}' for value in values)})"


def _describe_clock(name: str, t_ns: Times) -> dict[str, Any]:
    steps_s = np.diff(t_ns) / 1e9
    gaps_s = steps_s[find_gaps(t_ns)]
    return {
        "stream": name,
        "samples": len(t_ns),
        "rate_hz": rate_hz(t_ns),
        "start_s": float(t_ns[0]) / 1e9,
        "length_s": float(t_ns[-1] - t_ns[0]) / 1e9,
        "gaps": len(gaps_s),
        "longest_gap_s": float(gaps_s.max()) if len(gaps_s) else 0.0,
    }


def _list_spans(rests_ns: Times, t_ns: Times) -> list[dict[str, float]]:
    """Return start and length of rests, in s from the first sample."""
    return [{"start_s": float(start - t_ns[0]) / 1e9, "length_s": float(end - start) / 1e9} for start, end in rests_ns]


def _print_facts(facts: dict[str, Any], wanted: str | None) -> None:
    rows = [
        [
            one["stream"],
            str(one["samples"]),
            *(f"{one[key]:.3f}" for key in ("rate_hz", "start_s", "length_s")),
            "?" if one["gaps"] is None else str(one["gaps"]),
            f"{one['longest_gap_s']:.3f}" if one["gaps"] else "-",
        ]
        for one in facts["streams"]
    ]
    print_line(f"{facts['file']}: {facts['kind']} {facts['name']}")
    print_table("streams", COLUMNS, [rows], texts=1, wanted=wanted)
    if "rests" in facts:
        print_line(f"  {'rests':17} {_describe_rests(facts['rests'])}")
    shown = {"file", "kind", "name", "streams", "rests", "duration_s"}
    for key, value in facts.items():
        if key in shown or value in (None, "", [], {}, False):
            continue
        for line in _format_lines(value):
            print_line(f"  {key:17} {line}")
            key = ""
    print_line()


def _describe_rests(rests: list[dict[str, float]] | None) -> str:
    if rests is None:
        return "not looked for"
    if not rests:
        return "none"
    total = sum(rest["length_s"] for rest in rests)
    at = ", ".join(f"{rest['start_s']:.1f}+{rest['length_s']:.1f}" for rest in rests[:6])
    return f"{len(rests)}, {total:.1f} s in all: at {at}{' ...' if len(rests) > 6 else ''} s"


def _format_lines(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [f"{name}: {item}" for name, item in value.items()]
    if isinstance(value, list) and value and isinstance(value[0], str):
        return list(value)
    return [f"{value:.4g}" if isinstance(value, float) else str(value)]
