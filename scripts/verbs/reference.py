"""``stillpoint reference``: make the reference trajectory of recordings."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from stillpoint.datasets import SpinReference, write
from stillpoint.datasets.calibration.apply import load_calibration
from stillpoint.datasets.errors import BadParameter, Unobservable, require_known
from stillpoint.datasets.mcap.store import sha256, write_trajectory_pieces
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.datasets.trajectory import Calibration, compute_total_sd_rad
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.batch import make_row, parse_assignments, report_made, require_distinct
from stillpoint.scripts.shared.flags import LOCAL, Columns, Inputs, OutBeside, SetFlag, Workers, split_names
from stillpoint.scripts.shared.kept import REUSE, Deciding, Keeping, Task, run_kept
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line
from stillpoint.scripts.shared.recordings import open_recording
from stillpoint.scripts.shared.tables import print_refusals
from stillpoint.scripts.shared.window_folder import WindowFolder, remove_windows
from stillpoint.smoother import DEFAULT_METHOD
from stillpoint.smoother.attitude.params import PRESETS
from stillpoint.smoother.long_reference import LongReference
from stillpoint.smoother.reference import DEFAULT_SPIN_METHOD, make_reference_in_pieces, settings_of

_AUTO = "auto"  # the preset that each recording's streams speak for

_COLUMNS = (
    "recording",
    "method",
    "sd median, deg",
    "sd of heading, deg",
    "rests",
    "returns",
    "closing error, deg",
    "sd max, deg",
    "iterations",
    "s",
)


_SPIN_COLUMNS = (
    "recording",
    "method",
    "sd of rate, deg/s",
    "sd of angle, deg",
    "at the end",
    "left out",
    "glitches",
    "iterations",
    "s",
    "angle",
)


@dataclass(frozen=True)
class _Known:
    """A calibration that the user named, and the file that it is from."""

    name: str
    sha256: str
    calibration: Calibration


@dataclass(frozen=True)
class _Job:
    """A reference to make: of which recording, into which file, by which method."""

    source: Path
    target: Path
    method: str


def reference(
    paths: Inputs,
    /,
    *,
    out: OutBeside = None,
    method: str | None = None,
    preset: str | None = None,
    set_: SetFlag = None,
    calibration: Path | None = None,
    workers: Workers = LOCAL,
    keeping: Keeping = REUSE,
    columns: Columns = None,
    json: JsonFile = None,
) -> int:
    """Make the reference trajectory of recordings.

    Writes NAME.reference.mcap for each recording NAME.mcap, or NAME.METHOD.reference.mcap with several methods. A
    recording that does not fix a reference is named with the reason and what to do; the exit code is then 2, and the
    others are made.

    A recording of more than half an hour is solved in windows. Each is kept in NAME.reference.mcap.parts until the
    reference is there, so that a run that was stopped goes on with the next window.

    Parameters
    ----------
    paths
        Recordings: MCAP files, folders or globs.
    out
        Folder to write into; made when it is not there. By default beside each recording.
    method
        How: graph (the default), redistribution (Elmi Aziz and Mohseni Araste 2021) or redistribution-earth; several
        with commas between. For spinning bodies roll-graph, the default for recordings of nothing else.
    preset
        How the sensor is moved, for the method graph: auto (the default: chosen by each recording's streams, with the
        reason printed), handheld, phone, vehicle or bench.
    set_
        A setting of the method, NAME=VALUE, for example returns.tilt_gate_rad=0.02, on top of the preset;
        docs/reference-settings.md lists them.
    calibration
        A reference of the same sensor, NAME.reference.mcap, or a calibration of the device, NAME.calibration.toml or
        NAME.calibration.mcap: readings are corrected first by the calibration in it.
    columns
        Columns of the table to show: names with commas between, or all. By default those that fit the terminal.
    json
        Also write the table's facts as JSON to this file; - is the standard output.
    """
    changes = parse_assignments(set_, "returns.tilt_gate_rad=0.02")
    sources = inputs.find_recordings(paths)
    if method is None and preset is None:
        methods = _choose_methods(sources, bool(changes))
    else:
        named = split_names(method or DEFAULT_METHOD)
        methods = dict.fromkeys(sources, named)
    settings = _choose_settings(
        list(dict.fromkeys(name for names in methods.values() for name in names)), preset, changes
    )
    work = _plan_jobs(methods, None if out is None else inputs.make_output_dir(out))
    known = None
    if calibration is not None:
        known = _Known(calibration.name, calibration=_read_calibration(calibration), sha256=sha256(calibration))
    outcomes = run_kept(
        partial(_make_one, settings=settings, known=known, force=keeping.force),
        work,
        partial(_decide, settings=settings, known=known),
        workers,
        keeping,
        "reference",
        dict,
    )
    for job, outcome in zip(work, outcomes, strict=True):
        if outcome.error is None:
            remove_windows(job.target)  # of a run that was killed when the file was there
    rows = [
        make_row({"recording": job.source.stem, "method": job.method}, job.target, outcome)
        for job, outcome in zip(work, outcomes, strict=True)
    ]
    if all(row["method"] == DEFAULT_SPIN_METHOD for row in rows):
        return report_made("references", _SPIN_COLUMNS, rows, _format_spin_cells, json, columns)
    code = report_made("references", _COLUMNS, rows, _format_cells, json, columns)
    if json != STDOUT:
        made = [(row["recording"], row["diagnostics"]) for row in rows if row["error"] is None]
        for title, key in (("without magnetometer", "magnetometer_left_out"), ("field disturbed", "field_disturbed")):
            print_refusals(title, ((facts[key], name) for name, facts in made if key in facts))
        print_refusals("presets", ((_describe_preset(facts), name) for name, facts in made if "preset" in facts))
        print_refusals("satellites", ((_describe_fixes(facts), name) for name, facts in made if "fixes" in facts))
        print_refusals("left out", ((_describe_islands(facts), name) for name, facts in made if facts.get("left_out")))
    return code


def _choose_settings(
    methods: Sequence[str], preset: str | None, changes: dict[str, str]
) -> dict[str, Settings | Mapping[str, str]]:
    """Return the settings of each method; of the graph with its automatic preset, the changes to it.

    Raises :class:`BadParameter` for a preset that is not there or not the method's.
    """
    if preset in (None, _AUTO) and (preset is None or list(methods) == ["graph"]):
        checked = {name: settings_of(name, changes) for name in methods}
        return {name: changes if name == "graph" else settings for name, settings in checked.items()}
    assert preset is not None
    require_known(preset, [_AUTO, *PRESETS], "preset")
    others = [name for name in methods if name != "graph"]
    if others:
        raise BadParameter(f"--preset {preset}: is for the method graph, not {', '.join(others)}; leave one out")
    return {"graph": choose_settings(PRESETS[preset], changes, "graph")}


def _choose_methods(sources: Sequence[Path], changed: bool) -> dict[Path, list[str]]:
    """Return the method for each recording by its streams. Changed settings need one method for all recordings."""
    spins = {source: inputs.is_of_spin(source) for source in sources}
    if changed:
        spins = dict.fromkeys(sources, all(spins.values()))
    return {source: [DEFAULT_SPIN_METHOD if spin else DEFAULT_METHOD] for source, spin in spins.items()}


def _plan_jobs(methods: Mapping[Path, Sequence[str]], out: Path | None) -> list[_Job]:
    """Return one job per recording and method; raises :class:`BadParameter` where two would write one file."""
    work = []
    for source, names in methods.items():
        for name in names:
            label = f".{name}" if len(names) > 1 else ""
            target = inputs.choose_folder(source, out) / f"{source.stem}{label}.reference.mcap"
            work.append(_Job(source, target, name))
    require_distinct(job.target for job in work)
    return work


def _read_calibration(path: Path) -> Calibration:
    """Return the calibration in a reference or a calibration file; raises :class:`BadParameter` when there is none."""
    return load_calibration(path).calibration


def _decide(job: _Job, settings: Mapping[str, Settings | Mapping[str, str]], known: _Known | None) -> Deciding:
    """Return what decides a reference: recording, method, settings and calibration."""
    calibrated_by = None if known is None else [known.name, known.sha256]
    deciding = {"method": job.method, "settings": settings[job.method], "calibration": calibrated_by}
    return Deciding((job.source,), deciding, job.target)


def _make_one(
    task: Task[_Job], settings: Mapping[str, Settings | Mapping[str, str]], known: _Known | None, force: bool
) -> dict[str, Any]:
    """Read a recording, make its reference, write it, and return the facts of the table."""
    job = task.item
    recording = open_recording(job.source)
    digest = task.hash_input(job.source)
    begun = perf_counter()
    if force:
        remove_windows(job.target)
    windows = WindowFolder(job.target, task.origin["key"]) if task.origin else None
    if windows:
        _say_kept(windows, job.source.name)
    try:
        made = make_reference_in_pieces(
            recording, job.method, settings[job.method], known.calibration if known else None, kept=windows
        )
    except Unobservable:
        remove_windows(job.target)  # the refusal is kept
        raise
    seconds = perf_counter() - begun
    made_from = {job.source.name: digest} | ({known.name: known.sha256} if known else {})
    if isinstance(made, SpinReference):
        made = replace(made, made_from=made_from)
        facts = _list_spin_facts(made)
        write(job.target, made, origin=_say_origin(task, facts))
    else:
        made = made.with_facts(made_from=made_from)
        facts = _list_facts(made)
        write_trajectory_pieces(job.target, made.pieces(), made.samples, origin=_say_origin(task, facts))
    remove_windows(job.target)
    return {**facts, "seconds": seconds}


def _say_kept(windows: WindowFolder, name: str) -> None:
    """Say how many windows an earlier run left that was stopped."""
    of_all = windows.count_windows()
    found = min(len(windows), of_all)  # a recording that is solved more than once leaves more
    print_line(f"reference: {name}: {found} of {of_all} windows kept from an earlier run", sys.stderr)


def _say_origin(task: Task[_Job], facts: Mapping[str, Any]) -> Mapping[str, str]:
    """Return what the file says about its origin; without the time that it took, so that it has the same bytes."""
    return task.make_origin({**facts, "seconds": None})


def _format_seconds(row: Mapping[str, Any]) -> str:
    return "kept" if row["seconds"] is None else f"{row['seconds']:.1f}"


def _describe_preset(diagnostics: Mapping[str, Any]) -> str:
    return f"{diagnostics['preset']}: {diagnostics['preset_reason']}"


def _describe_fixes(diagnostics: Mapping[str, Any]) -> str:
    """Return in words what became of the satellite fixes."""
    fixes = diagnostics["fixes"]
    parts = [f"{fixes['used']} fixes used"]
    parts += [f"{fixes['n_jumps']} left out, as no vehicle jumps so far"] if fixes["n_jumps"] else []
    parts += [f"{fixes['n_doubtful']} with less than half of their weight"] if fixes["n_doubtful"] else []
    if fixes["n_outages"]:
        parts.append(f"{fixes['n_outages']} outages, the longest of {fixes['longest_outage_s']:.0f} s")
    if "late_s" in fixes:
        parts.append(f"their stamps are {fixes['late_s']:.2f} s late, which is corrected")
    return ", ".join(parts)


def _describe_islands(diagnostics: Mapping[str, Any]) -> str:
    """Return in words which pieces between gaps the reference leaves out."""
    pieces = [f"{one['samples']} samples at {one['start_s']:.2f} s" for one in diagnostics["left_out"]]
    return f"too short between gaps for a reference: {', '.join(pieces[:3])}" + (
        f" and {len(pieces) - 3} more" if len(pieces) > 3 else ""
    )


def _list_facts(made: LongReference) -> dict[str, Any]:
    """Return the facts of a reference for ``--json``: rests, returns, stated accuracy and diagnostics."""
    first = next(made.pieces())
    sd_deg = np.rad2deg(np.concatenate([compute_total_sd_rad(piece.cov_b_rad2) for piece in made.pieces()]))
    return {
        "samples": made.samples,
        "rests": len(first.rests_ns),
        "returns": [
            {"start_s": (one.start_ns - int(first.t_ns[0])) / 1e9, "accepted": one.accepted, "reason": one.reason}
            for one in first.returns
        ],
        "sd_median_deg": float(np.median(sd_deg)),
        "sd_max_deg": float(sd_deg.max()),
        "heading_sd_deg": float(np.rad2deg(first.heading_sd_rad)),
        "mounting_sd_deg": float(np.rad2deg(np.sqrt(np.trace(first.mounting_cov_b_rad2)))),
        "diagnostics": dict(first.diagnostics),
    }


def _list_spin_facts(made: SpinReference) -> dict[str, Any]:
    """Return the facts of a spin reference for ``--json``: stated accuracy and diagnostics."""
    angle_sd_deg, rate_sd_degps = np.rad2deg(made.angle_sd_rad), np.rad2deg(made.rate_sd_radps)
    return {
        "method": made.method,
        "samples": len(made.t_ns),
        "rate_sd_median_degps": float(np.median(rate_sd_degps)),
        "angle_sd_median_deg": float(np.median(angle_sd_deg)),
        "angle_sd_last_deg": float(angle_sd_deg[-1]),
        "diagnostics": dict(made.diagnostics),
    }


def _format_cells(row: dict[str, Any]) -> list[str]:
    """Return the row of a reference of the attitude as text."""
    if row["error"] is not None:
        return [row["recording"], row["method"], *["-"] * (len(_COLUMNS) - 2)]
    if row["method"] == DEFAULT_SPIN_METHOD:
        return _format_spin_among_attitudes(row)
    accepted = sum(one["accepted"] for one in row["returns"])
    closing = row["diagnostics"].get("closing_error_deg", [])
    return [
        row["recording"],
        row["method"],
        f"{row['sd_median_deg']:.2f}",
        f"{row['heading_sd_deg']:.2f}",
        str(row["rests"]),
        f"{accepted} of {len(row['returns'])}",
        ", ".join(f"{error:.1f}" for error in closing) or "-",
        f"{row['sd_max_deg']:.2f}",
        str(row["diagnostics"].get("iterations", "-")),
        _format_seconds(row),
    ]


def _format_spin_among_attitudes(row: dict[str, Any]) -> list[str]:
    """Return the cells of a reference of an angle in a table of attitudes: its sd, and "-" for what it lacks."""
    sd = f"{row['angle_sd_median_deg']:.2f}"
    last = f"{row['angle_sd_last_deg']:.2f}"
    iterations = str(row["diagnostics"]["iterations"])
    return [row["recording"], row["method"], sd, "-", "-", "-", "-", last, iterations, _format_seconds(row)]


def _format_spin_cells(row: dict[str, Any]) -> list[str]:
    """Return the row of a spin reference as text."""
    if row["error"] is not None:
        return [row["recording"], row["method"], *["-"] * (len(_SPIN_COLUMNS) - 2)]
    found = row["diagnostics"]
    return [
        row["recording"],
        row["method"],
        f"{row['rate_sd_median_degps']:.2f}",
        f"{row['angle_sd_median_deg']:.2f}",
        f"{row['angle_sd_last_deg']:.2f}",
        str(found["n_squared_missing"] + found["n_accel_missing"]),
        str(found["n_squared_glitches"] + found["n_accel_glitches"]),
        str(found["iterations"]),
        _format_seconds(row),
        found["angle"],
    ]
