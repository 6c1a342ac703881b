"""``stillpoint reference``: make the reference trajectory of recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from stillpoint.datasets import Reference, write
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.nearest import require_known
from stillpoint.datasets.settings import Settings, chosen
from stillpoint.datasets.store import read_recording, sha256
from stillpoint.datasets.trajectory import total_sd_rad
from stillpoint.scripts import inputs
from stillpoint.scripts.batch import assignments, made_row, report_made, require_distinct
from stillpoint.scripts.flags import Inputs, Jobs, OutDir, SetFlag
from stillpoint.scripts.jobs import run_jobs
from stillpoint.scripts.json_file import JsonFile
from stillpoint.smoother import DEFAULT_METHOD
from stillpoint.smoother import reference as make_reference
from stillpoint.smoother.graph_params import PRESETS
from stillpoint.smoother.reference import settings_of

COLUMNS = (
    "recording",
    "method",
    "rests",
    "returns",
    "closing error, deg",
    "sd median, deg",
    "sd max, deg",
    "sd of heading, deg",
    "iterations",
    "s",
)


@dataclass(frozen=True)
class _Job:
    source: Path
    target: Path
    method: str


def reference(
    paths: Inputs,
    /,
    *,
    out: OutDir = Path(),
    method: str = DEFAULT_METHOD,
    preset: str | None = None,
    set_: SetFlag = None,
    jobs: Jobs = None,
    json: JsonFile = None,
) -> int:
    """Make the reference trajectory of recordings.

    Writes NAME.reference.mcap for each recording NAME.mcap, or NAME.METHOD.reference.mcap with several methods. A
    recording that does not fix a reference is named with the reason and what to do; the exit code is then 2, and the
    others are made.

    Parameters
    ----------
    paths
        Recordings: MCAP files, folders or globs.
    out
        Folder to write into; made when it is not there.
    method
        How: graph, redistribution (paper 002), redistribution-earth; several with commas between.
    preset
        How the sensor is moved, for the method graph: handheld (the default), phone, vehicle or bench.
    set_
        A setting of the method, NAME=VALUE, for example returns.tilt_gate_rad=0.02 (docs/method.md lists them); on top
        of the preset.
    jobs
        Processes; by default one per core, fewer for few recordings.
    json
        Also write the table's facts as JSON to this file; - is the standard output.
    """
    methods = list(dict.fromkeys(name.strip() for name in method.split(",")))
    changes = assignments(set_, "returns.tilt_gate_rad=0.02")
    settings = _settings(methods, preset, changes)
    sources = inputs.recordings(paths)
    work = _jobs(sources, methods, inputs.output_dir(out))
    outcomes = run_jobs(partial(_make, settings=settings), work, jobs, "reference")
    rows = [
        made_row({"recording": job.source.stem, "method": job.method}, job.target, outcome)
        for job, outcome in zip(work, outcomes, strict=True)
    ]
    return report_made("references", COLUMNS, rows, _cells, json)


def _settings(methods: Sequence[str], preset: str | None, changes: dict[str, str]) -> dict[str, Settings]:
    """The settings of each method; raises :class:`BadParameter` for a preset that is not there or not the method's."""
    if preset is None:
        return {name: settings_of(name, changes) for name in methods}
    require_known(preset, PRESETS, "preset")
    others = [name for name in methods if name != "graph"]
    if others:
        raise BadParameter(f"--preset {preset}: is for the method graph, not {', '.join(others)}; leave one out")
    return {"graph": chosen(PRESETS[preset], changes, "graph")}


def _jobs(sources: Sequence[Path], methods: Sequence[str], folder: Path) -> list[_Job]:
    work = [
        _Job(source, folder / f"{source.stem}{f'.{name}' if len(methods) > 1 else ''}.reference.mcap", name)
        for source in sources
        for name in methods
    ]
    require_distinct(job.target for job in work)
    return work


def _make(job: _Job, settings: dict[str, Settings]) -> dict[str, Any]:
    """Read, make, write; the facts of the table."""
    recording = read_recording(job.source)
    begun = perf_counter()
    made = replace(
        make_reference(recording, job.method, settings[job.method]), made_from={job.source.name: sha256(job.source)}
    )
    seconds = perf_counter() - begun
    write(job.target, made)
    return {**_facts(made), "seconds": seconds}


def _facts(made: Reference) -> dict[str, Any]:
    sd_deg = np.rad2deg(total_sd_rad(made.cov_b_rad2))
    return {
        "samples": len(made.t_ns),
        "rests": len(made.rests_ns),
        "returns": [
            {"start_s": (one.start_ns - int(made.t_ns[0])) / 1e9, "accepted": one.accepted, "reason": one.reason}
            for one in made.returns
        ],
        "sd_median_deg": float(np.median(sd_deg)),
        "sd_max_deg": float(sd_deg.max()),
        "heading_sd_deg": float(np.rad2deg(made.heading_sd_rad)),
        "diagnostics": dict(made.diagnostics),
    }


def _cells(row: dict[str, Any]) -> list[str]:
    if row["error"] is not None:
        return [row["recording"], row["method"], *["-"] * (len(COLUMNS) - 2)]
    accepted = sum(one["accepted"] for one in row["returns"])
    closing = row["diagnostics"].get("closing_error_deg", [])
    return [
        row["recording"],
        row["method"],
        str(row["rests"]),
        f"{accepted} of {len(row['returns'])}",
        ", ".join(f"{error:.1f}" for error in closing) or "-",
        f"{row['sd_median_deg']:.2f}",
        f"{row['sd_max_deg']:.2f}",
        f"{row['heading_sd_deg']:.2f}",
        str(row["diagnostics"].get("iterations", "-")),
        f"{row['seconds']:.1f}",
    ]
