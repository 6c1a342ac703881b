"""``stillpoint info``: print what is in a recording, reference or estimate."""

import sys
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from stillpoint.datasets import BadFile
from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.errors import StillpointError
from stillpoint.datasets.files.remote import is_url
from stillpoint.datasets.mcap.facts import parse_info
from stillpoint.datasets.mcap.parts import join_streams
from stillpoint.datasets.mcap.pieces import AnyPiece, PieceReader
from stillpoint.datasets.mcap.summary import FileSummary, summarise
from stillpoint.datasets.recording import TRUTHS, Floats, Gps, Info, Piece, SpinGeometry, Times
from stillpoint.datasets.running import ClockFacts, RunningClock, ThinnedValues
from stillpoint.datasets.spin import find_saturated
from stillpoint.datasets.times import GAP_STEPS
from stillpoint.datasets.trajectory import Estimate, Reference, SpinReference, compute_total_sd_rad
from stillpoint.scripts.shared.flags import Columns, Inputs, Jobs, Workers
from stillpoint.scripts.shared.inputs import find_mcap_files
from stillpoint.scripts.shared.jobs import SHORT, choose_exit_code, run_jobs
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json
from stillpoint.scripts.shared.tables import print_table

_STREAM_ORDER = ("imu", "mag", "gps", "spin", "encoder", *TRUTHS)
_ROWS_AT_ONCE = 1 << 19  # samples among which rests are looked for together: 44 minutes at 200 Hz
LARGE_BYTES = 64 << 20  # a file above this is summarised: reading 64 MiB takes about a second
_COLUMNS = ("stream", "samples", "Hz", "start, s", "length, s", "gaps", "longest, s")

_SHOWN = (
    "heading",
    "sign_of_gravity",
    "gaps",
    "magnetometer_left_out",
    "field_disturbed",
)  # of a reference's diagnostics


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
        Read and check every sample of a large file too, to count gaps and find rests, in bounded memory. Without it a
        file of more than 64 MiB is summarised from its index and a few chunks.
    units_unchecked
        Open recordings whose sizes do not fit their units.
    jobs
        Processes; by default one per core for many files, else this one alone.
    columns
        Columns of the table of streams to show: names with commas between, or all. By default those that fit.
    json
        Also write the facts as JSON to this file; - is the standard output.
    """
    files = find_mcap_files(paths)
    outcomes = run_jobs(partial(_read_facts, full, units_unchecked), files, Workers(jobs), "info", here_up_to=SHORT)
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
    return choose_exit_code(outcomes)


def _read_facts(full: bool, units_unchecked: bool, path: Path) -> dict[str, Any]:
    """Return the facts about one file: from its index when it is large, else from all of its samples."""
    is_large = not is_url(path) and path.is_file() and path.stat().st_size > LARGE_BYTES
    if is_url(path) or (is_large and not full):
        return _list_summary_facts(path, summarise(path))
    return _list_all_facts(PieceReader(path, units_unchecked, _ROWS_AT_ONCE))


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
        return facts | {"rests": None} | _list_provenance(parse_info(summary.facts))
    return facts | {key: summary.facts[key] for key in ("method", "params", "made_from") if key in summary.facts}


def _list_all_facts(reader: PieceReader) -> dict[str, Any]:
    """Return the facts about the content of one file, from all of its samples."""
    content: _Recording | _Trajectory = _Recording() if reader.kind == "recording" else _Trajectory()
    clocks: dict[str, RunningClock] = {}
    for piece in reader.pieces():
        content.add(piece)
        for name, t_ns in _list_clocks(piece):
            clocks.setdefault(name, RunningClock(GAP_STEPS)).add(t_ns)
    unsure = {name: clock for name, clock in clocks.items() if not clock.has_all_gaps}
    if unsure:
        again = {name: RunningClock(GAP_STEPS, clock.median_step_ns) for name, clock in unsure.items()}
        for piece in reader.pieces():
            for name, t_ns in _list_clocks(piece):
                if name in again:
                    again[name].add(t_ns)
        clocks |= again
    found = {name: clock.facts() for name, clock in clocks.items()}
    order = [name for name in _STREAM_ORDER if name in found] + [name for name in found if name not in _STREAM_ORDER]
    streams = [_describe_clock(name, found[name]) for name in order]
    return {"file": str(reader.path), "kind": reader.kind, **content.list_facts(reader, found, streams)}


def _list_clocks(piece: AnyPiece) -> Iterator[tuple[str, Times]]:
    """Yield the stamps of each stream of a piece by its name."""
    if isinstance(piece, Piece):
        yield from piece.streams()
    else:
        yield "angle" if isinstance(piece, SpinReference) else "q_nb", piece.t_ns


class _Recording:
    """Gathers what the samples of a recording say besides their clocks."""

    def __init__(self) -> None:
        from stillpoint.smoother.rest import RestFinder

        self._rests = RestFinder()
        self._fixes: list[Gps] = []
        self._geometry: SpinGeometry | None = None
        self._saturated = self._missing = np.zeros(0, np.int64)

    def add(self, piece: AnyPiece) -> None:
        """Take the next samples."""
        assert isinstance(piece, Piece)
        if piece.imu is not None:
            self._rests.add(piece.imu)
        if piece.gps is not None:
            self._fixes.append(piece.gps)
        if piece.spin is not None:
            if self._geometry is None:
                self._geometry = piece.spin.geometry
                self._saturated = self._missing = np.zeros(piece.spin.accel_mps2.shape[1], np.int64)
            self._saturated = self._saturated + find_saturated(piece.spin).sum(axis=0)
            self._missing = self._missing + (~np.isfinite(piece.spin.accel_mps2)).sum(axis=0)

    def list_facts(
        self, reader: PieceReader, clocks: Mapping[str, ClockFacts], streams: list[dict[str, Any]]
    ) -> dict[str, Any]:
        """Return the facts in the order in which they are printed."""
        head = reader.head
        sensors = [clock for name, clock in clocks.items() if name not in TRUTHS]
        rests: list[dict[str, float]] = []
        if "imu" in clocks:
            from stillpoint.smoother.attitude.outside.satellite import drop_rests_under_way

            gps = join_streams(self._fixes) if self._fixes else None
            rests = _list_spans(drop_rests_under_way(self._rests.rests_ns(), gps), clocks["imu"].first_ns)
        geometry = self._geometry
        return {
            "name": head.name,
            "duration_s": (max(one.last_ns for one in sensors) - min(one.first_ns for one in sensors)) / 1e9,
            "streams": streams,
            "rests": rests,
            "base_pose": None if head.base_pose is None else head.base_pose.tolist(),
            "spin": [] if geometry is None else _describe_spin(geometry, self._saturated, self._missing),
            **_list_provenance(reader.info),
        }


class _Trajectory:
    """Gathers what the samples of a reference or estimate say besides their clock."""

    def __init__(self) -> None:
        self._sd_deg = ThinnedValues()
        self._sd_max_deg = 0.0
        self._unready = 0
        self._last: Reference | SpinReference | Estimate | None = None  # every piece has all facts

    def add(self, piece: AnyPiece) -> None:
        """Take the next samples."""
        assert not isinstance(piece, Piece)
        self._last = piece
        if isinstance(piece, Estimate):
            self._unready += 0 if piece.ready is None else int((~piece.ready).sum())
            return
        sd_rad = compute_total_sd_rad(piece.cov_b_rad2) if isinstance(piece, Reference) else piece.angle_sd_rad
        self._sd_deg.add(np.rad2deg(sd_rad))
        self._sd_max_deg = max(self._sd_max_deg, float(np.rad2deg(sd_rad).max()))

    def list_facts(
        self, reader: PieceReader, clocks: Mapping[str, ClockFacts], streams: list[dict[str, Any]]
    ) -> dict[str, Any]:
        """Return the facts in the order in which they are printed."""
        thing = self._last
        if thing is None:
            raise BadFile(f"{reader.path}: holds no sample; make it again")
        facts: dict[str, Any] = {"name": thing.recording if isinstance(thing, Estimate) else thing.name}
        facts["streams"] = streams
        if isinstance(thing, Estimate):
            facts |= {"estimator": thing.name, "ns_per_sample": thing.ns_per_sample, "not_ready": self._unready}
            return facts | {"params": dict(thing.params), "made_from": dict(thing.made_from)}
        facts["method"] = thing.method
        sd = {"sd_median_deg": float(np.median(self._sd_deg.values())), "sd_max_deg": self._sd_max_deg}
        if isinstance(thing, Reference):
            returns = [one.accepted for one in thing.returns]
            facts["rests"] = _list_spans(thing.rests_ns, clocks["q_nb"].first_ns)
            facts |= {"returns": len(returns), "returns_accepted": sum(returns), **sd}
            facts |= {"heading_sd_deg": float(np.rad2deg(thing.heading_sd_rad))}
            facts |= {name: thing.diagnostics[name] for name in _SHOWN if name in thing.diagnostics}
        else:
            facts |= sd
        return facts | {"params": dict(thing.params), "made_from": dict(thing.made_from)}


def _list_provenance(info: Info) -> dict[str, Any]:
    """Return what a recording says about its source."""
    origin = {name: getattr(info, name) for name in ("source", "licence", "citation", "sensor", "date", "epoch")}
    marks = {name: getattr(info, name) for name in ("mag_uncalibrated", "units_unchecked")}
    place = None if info.place_lat_lon_alt is None else list(info.place_lat_lon_alt)
    lists = {"conversions": list(info.conversions), "notes": list(info.notes)}
    return {
        **origin,
        "place_lat_lon_alt": place,
        **marks,
        "extra": dict(info.extra),
        **lists,
        "sha256": dict(info.sha256),
    }


def _describe_spin(geometry: SpinGeometry, saturated: Times, missing: Times) -> list[str]:
    """Return lines about the single-axis sensors: place, axis, and how many values are saturated or missing."""
    lines = ["on a fixed axis (a motor's shaft)" if geometry.fixed_axis else "free to turn about all axes"]
    for k, (arm, axis) in enumerate(zip(geometry.accel_r_b_m, geometry.accel_axis_b, strict=True)):
        limit = (
            ""
            if geometry.accel_range_mps2 is None
            else f", range {geometry.accel_range_mps2[k] / STANDARD_GRAVITY_MPS2:.3g} g"
        )
        place = "arm not known" if np.isnan(arm).any() else f"arm {_format_vector(arm)} m"
        spoilt = f", {saturated[k]} saturated" * bool(saturated[k]) + f", {missing[k]} missing" * bool(missing[k])
        lines.append(f"accelerometer {k + 1}: {place}, axis {_format_vector(axis)}{limit}{spoilt}")
    return lines + [f"gyro {k + 1}: axis {_format_vector(axis)}" for k, axis in enumerate(geometry.gyro_axis_b)]


def _format_vector(values: Floats) -> str:
    return f"({', '.join(f'{value:.4g}' for value in values)})"


def _describe_clock(name: str, clock: ClockFacts) -> dict[str, Any]:
    """Return rate, span and gaps of a stream for the table and for ``--json``."""
    return {
        "stream": name,
        "samples": clock.samples,
        "rate_hz": 1e9 / clock.step_ns if clock.step_ns else 0.0,
        "start_s": clock.first_ns / 1e9,
        "length_s": (clock.last_ns - clock.first_ns) / 1e9,
        "gaps": clock.gaps,
        "longest_gap_s": clock.longest_gap_ns / 1e9,
    }


def _list_spans(rests_ns: Times, first_ns: int) -> list[dict[str, float]]:
    """Return start and length of rests, in s from the first sample."""
    return [{"start_s": float(start - first_ns) / 1e9, "length_s": float(end - start) / 1e9} for start, end in rests_ns]


def _print_facts(facts: dict[str, Any], wanted: str | None) -> None:
    """Print a file's facts: the table of its streams, then a line per fact."""
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
    print_table("streams", _COLUMNS, [rows], texts=1, wanted=wanted)
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
    """Return number, total length and the first rests as text."""
    if rests is None:
        return "not looked for"
    if not rests:
        return "none"
    total = sum(rest["length_s"] for rest in rests)
    at = ", ".join(f"{rest['start_s']:.1f}+{rest['length_s']:.1f}" for rest in rests[:6])
    return f"{len(rests)}, {total:.1f} s in all: at {at}{' ...' if len(rests) > 6 else ''} s"


def _format_lines(value: Any) -> list[str]:
    """Return a fact as lines of text."""
    if isinstance(value, dict):
        return [f"{name}: {item}" for name, item in value.items()]
    if isinstance(value, list) and value and isinstance(value[0], str):
        return list(value)
    return [f"{value:.4g}" if isinstance(value, float) else str(value)]
