"""The recordings of a leaderboard: what their files say about device, motion, tags, licence and truth."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.files.result_store import ResultStore, make_key
from stillpoint.datasets.mcap.store import read_provenance, sha256
from stillpoint.studies.leaderboard.board import Source

_NO_MOTION = ("all_trials", "no_breaks", "with_breaks")  # groups of BROAD that do not tell one motion from another
_MAG, _TRUTH = "/imu/mag", "/truth/pose"


def survey_sources(files: Sequence[Path], store: ResultStore) -> list[Source]:
    """Return what each file says about its recording; a file that cannot be read keeps the reason.

    Raises :class:`BadParameter` when two recordings have the same name.
    """
    names = [file.stem for file in files]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise BadParameter(f"{twice}: two recordings have this name; rename one, or compare them separately")
    return [_survey_one(file, store) for file in files]


def _survey_one(file: Path, store: ResultStore) -> Source:
    """Return what a file says about its recording, kept by its SHA-256; an unreadable file keeps the reason."""
    try:
        digest = sha256(file)
        key = make_key(what="source", input=digest, name=file.stem)
        facts = store.facts(key)
        if facts is None:
            facts = _describe_file(file)
            store.put(key, facts)
    except StillpointError as error:
        return Source(file.stem, str(file), "", "", "", "", "", "", (), "none", False, error=str(error))
    return Source(file.stem, str(file), digest, **{**facts, "tags": tuple(facts["tags"])})


def _describe_file(file: Path) -> dict[str, Any]:
    """Return the facts of a recording that a leaderboard needs. Raises :class:`BadParameter` for another kind."""
    found = read_provenance(file)
    if found.kind != "recording":
        raise BadParameter(f"{file}: holds one {found.kind}; give recordings")
    info = found.facts["info"]
    topics = {name for name, (_, count) in found.topics.items() if count}
    magnetometer = "uncalibrated" if info["mag_uncalibrated"] else "calibrated"
    return {
        "source": info["source"],
        "licence": info["licence"],
        "citation": info["citation"],
        "device": info["sensor"].partition(" (")[0],
        "motion": _name_motion(info["extra"]),
        "tags": _find_tags(info["extra"]),
        "magnetometer": magnetometer if _MAG in topics else "none",
        "truth": _TRUTH in topics,
        "lost": found.lost,
    }


def _find_tags(extra: Mapping[str, str]) -> list[str]:
    """Return the free ``tags`` of a recording, and the groups of BROAD; words between spaces or commas."""
    words = f"{extra.get('tags', '')} {extra.get('groups', '')}".replace(",", " ").split()
    return [word for word in dict.fromkeys(words) if word != "all_trials"]


def _name_motion(extra: Mapping[str, str]) -> str:
    """Return the name of the motion, so that repetitions of one motion by one device count once; "" when unknown."""
    if extra.get("motion"):
        return extra["motion"]
    return " ".join(word for word in extra.get("groups", "").split() if word not in _NO_MOTION)


def number_rows(sources: Sequence[Source]) -> list[int]:
    """Return for each recording the number of its row: those of one device and one motion share one."""
    numbers: dict[tuple[str, ...], int] = {}
    rows = []
    for source in sources:
        known = bool(source.motion)
        identity = (source.device, source.motion) if known else (source.recording,)
        rows.append(numbers.setdefault(identity, len(numbers)))
    return rows
