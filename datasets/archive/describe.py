"""The facts of one object, read from its content alone: what the catalogue holds, and `rebuild` finds again."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from stillpoint.datasets.archive.record import SHA256
from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.files.remote import open_binary
from stillpoint.datasets.mcap.facts import KINDS, from_json
from stillpoint.datasets.mcap.reader import Log, read_log
from stillpoint.datasets.mcap.store import RECORD
from stillpoint.datasets.mcap.topics import TOPICS
from stillpoint.datasets.recording import Times, rate_hz
from stillpoint.datasets.times import find_gaps
from stillpoint.datasets.trajectory import compute_total_sd_rad

_LARGEST_JSON = 64 << 20  # bytes: score tables take kilobytes; a larger JSON file is kept as a source
_SPREAD_TOPIC = {"reference": "/reference/attitude", "roll reference": "/reference/roll_sd"}


@dataclass(frozen=True)
class Stream:
    """One sensor, or one trajectory, of an object on its own clock."""

    stream: str
    samples: int
    rate_hz: float
    start_s: float
    length_s: float
    gaps: int
    longest_gap_s: float


@dataclass(frozen=True)
class Description:
    """The description of an object; ``columns`` are what queries compare, ``facts`` everything it says about itself."""

    kind: str  # recording, reference, roll reference, estimate, score, leaderboard, source
    name: str
    columns: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    streams: Sequence[Stream] = ()
    parents: Sequence[tuple[str, str]] = ()  # (file name, sha256) of what it was made from
    scores: Sequence[Mapping[str, Any]] = ()  # rows of a score table
    problem: str = ""  # why its content cannot be trusted, "" when it can


def describe_object(path: Path, file_name: str) -> Description:
    """Describe a file; one that claims to be MCAP and cannot be read gives a description with a ``problem``."""
    suffix = file_name.rpartition(".")[2].lower()
    if suffix == "mcap":
        try:
            return _describe_mcap(path, file_name)
        except BadFile as error:
            return Description("source", file_name, problem=str(error))
    if suffix == "json":
        return _describe_json(path, file_name)
    return Description("source", file_name)


def _describe_mcap(path: Path, file_name: str) -> Description:
    """Describe an MCAP file; every checksum in it is tested, of the samples only times and spreads are kept."""
    columns: dict[str, dict[str, tuple[str, ...]]] = {topic.name: {} for topic in TOPICS}
    columns["/reference/attitude"] = {"cov_b_rad2": ("orientation_covariance",)}
    columns["/reference/roll_sd"] = {"angle_sd_rad": ("vector.x",)}
    log = read_log(path, [topic.name for topic in TOPICS if not topic.drawn], columns)
    record = log.metadata.get(RECORD)
    if record is None:
        if log.lost:
            raise BadFile(f"{path}: {log.lost}")
        topics = {name: {"type": log.types[name], "messages": log.counts[name]} for name in log.types}
        return Description("source", file_name, facts={"topics": topics})
    kind = record.get("kind", "")
    if kind not in KINDS:
        raise BadFile(f"{path}: holds a {kind or 'thing'} that this version does not know; install a newer stillpoint")
    try:
        facts = from_json(record["facts"])
        _check_counts(log, facts, path)
        streams = _list_streams(log, kind)
        described = (
            _make_recording_columns(facts) if kind == "recording" else _make_trajectory_columns(kind, facts, log)
        )
        parents = facts["info"]["sha256"] if kind == "recording" else facts["made_from"]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadFile(
            f"{path}: its facts cannot be read ({type(error).__name__}: {error}); restore it from a copy"
        ) from error
    name = facts["recording"] if kind == "estimate" else facts["name"]
    clock = _get_main_clock(log, kind)
    described |= {"version": record.get("version", ""), "samples": len(clock), "rate_hz": rate_hz(clock)}
    if streams:
        starts = [one.start_s for one in streams if "truth" not in one.stream]
        ends = [one.start_s + one.length_s for one in streams if "truth" not in one.stream]
        described["duration_s"] = max(ends, default=0.0) - min(starts, default=0.0)
    return Description(
        kind=kind,
        name=str(name),
        columns=described,
        facts=facts,
        streams=streams,
        parents=_list_pairs(parents),
        problem=log.lost,
    )


def _check_counts(log: Log, facts: Mapping[str, Any], path: Path) -> None:
    """Raise :class:`BadFile` when a topic has another number of messages than the facts say."""
    for topic, count in facts["samples"].items():
        if not log.lost and log.counts.get(topic, 0) != count:
            raise BadFile(f"{path}: {topic} should have {count} messages and has {log.counts.get(topic, 0)}")


def _make_recording_columns(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns of a recording in the catalogue, from the facts of its file."""
    info = facts["info"]
    place = info["place_lat_lon_alt"]
    return {
        **{name: info[name] for name in ("sensor", "source", "licence", "citation", "date", "epoch")},
        "latitude_deg": None if place is None else place[0],
        "longitude_deg": None if place is None else place[1],
    }


def _make_trajectory_columns(kind: str, facts: Mapping[str, Any], log: Log) -> dict[str, Any]:
    """Return the columns of a reference or an estimate in the catalogue; standard deviations in deg."""
    if kind == "estimate":
        return {"estimator": facts["name"], "ns_per_sample": facts["ns_per_sample"]}
    columns: dict[str, Any] = {"method": facts["method"]}
    topic = log.topics.get(_SPREAD_TOPIC[kind])
    if topic is not None and len(topic.t_ns):
        if kind == "reference":
            sd_rad = compute_total_sd_rad(topic.column("cov_b_rad2").reshape(-1, 3, 3))
            columns |= {"rests": len(facts["rests_ns"]), "heading_sd_deg": float(np.rad2deg(facts["heading_sd_rad"]))}
        else:
            sd_rad = topic.column("angle_sd_rad")
        columns |= {
            "sd_median_deg": float(np.rad2deg(np.median(sd_rad))),
            "sd_max_deg": float(np.rad2deg(sd_rad.max())),
        }
    return columns


def _list_streams(log: Log, kind: str) -> list[Stream]:
    """Return one row per stream of the object; a trajectory is one stream, named by its kind."""
    found: dict[str, Times] = {}
    for topic in TOPICS:
        if topic.kind == kind and topic.name in log.topics and topic.stream != "mag_remainder":
            found.setdefault(topic.stream or kind, log.topics[topic.name].t_ns)
    return [_describe_stream(name, t_ns) for name, t_ns in found.items() if len(t_ns)]


def _describe_stream(name: str, t_ns: Times) -> Stream:
    """Return samples, rate, length and gaps of a stream with stamps (N,) in ns."""
    gaps_s = (np.diff(t_ns) / 1e9)[find_gaps(t_ns)]
    return Stream(
        stream=name,
        samples=len(t_ns),
        rate_hz=rate_hz(t_ns),
        start_s=float(t_ns[0]) / 1e9,
        length_s=float(t_ns[-1] - t_ns[0]) / 1e9,
        gaps=len(gaps_s),
        longest_gap_s=float(gaps_s.max()) if len(gaps_s) else 0.0,
    )


def _get_main_clock(log: Log, kind: str) -> Times:
    """Return the stamps of the first stream: of a recording the IMU, or the spin where it has none."""
    for topic in TOPICS:
        if topic.kind == kind and not topic.drawn and topic.name in log.topics:
            return log.topics[topic.name].t_ns
    return np.empty(0, np.int64)


def _describe_json(path: Path, file_name: str) -> Description:
    """Return a table of scores (``score --json``), a leaderboard, or any other JSON file, which is kept as a source."""
    with open_binary(path) as file:
        data = file.read(_LARGEST_JSON + 1)
    if len(data) > _LARGEST_JSON:
        return Description("source", file_name)
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        return Description("source", file_name, problem=f"{path}: is no JSON ({error})")
    if not isinstance(content, dict):
        return Description("source", file_name)
    if _is_rows(content.get("sources")) and _is_rows(content.get("recordings")) and "tables" in content:
        parents = {str(source.get("file")): str(source.get("sha256")) for source in content["sources"]}
        return _describe_table("leaderboard", file_name, content, content["recordings"], parents)
    rows = content.get("rows")
    if _is_rows(rows) and any("total_rmse_deg" in row or "rate_rmse_degps" in row for row in rows):
        parents = {}
        for row in rows:
            parents |= row.get("made_from") or {}
        return _describe_table("score", file_name, content, rows, parents)
    return Description("source", file_name)


def _is_rows(value: Any) -> TypeGuard[list[dict[str, Any]]]:
    """Return whether a value is a list of at least one mapping."""
    return isinstance(value, list) and bool(value) and all(isinstance(row, dict) for row in value)


def _describe_table(
    kind: str, file_name: str, content: Mapping[str, Any], rows: Sequence[dict[str, Any]], parents: Mapping[str, str]
) -> Description:
    """Describe a file of scores or of a leaderboard; its rows become scores of the catalogue."""
    columns = {"samples": len(rows), "version": str(content.get("version", ""))}
    return Description(kind, file_name, columns, parents=_list_pairs(parents), scores=rows)


def _list_pairs(parents: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return names and hashes, sorted; an entry that is no SHA-256 is left to the facts."""
    return sorted((str(name), value) for name, value in parents.items() if SHA256.fullmatch(str(value)))
