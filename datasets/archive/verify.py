"""Check an archive against itself: bytes, records, MCAP checksums, catalogue, provenance, links."""

import hashlib
import os
import sqlite3
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from stillpoint.datasets.archive.archive import MARK, Archive
from stillpoint.datasets.archive.catalogue import DESCRIBED_TABLES, TABLES, digest_rows, make_content_rows
from stillpoint.datasets.archive.describe import Description, describe_object
from stillpoint.datasets.archive.record import Record, extract_sha256, record_key
from stillpoint.datasets.archive.storage import FolderStorage
from stillpoint.datasets.errors import BadFile

_GROUP = 16  # objects that a thread takes at a time: handing over a small one costs as much as hashing it
_MADE = ("reference", "roll reference", "estimate", "score", "leaderboard")  # kinds that are made from others


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong."""

    level: str  # object, record, content, catalogue, provenance, link, remade
    sha256: str  # of the object that it concerns, "" when it concerns none
    where: str  # a file, or what else is wrong
    what: str
    repair: str  # what to do


@dataclass(frozen=True)
class Verified:
    """The result of a check."""

    objects: int
    bytes: int
    faults: tuple[Fault, ...]


@dataclass(frozen=True)
class _Checked:
    """One object read from its first to its last byte."""

    sha256: str
    described: Description
    faults: tuple[Fault, ...]


def verify_archive(archive: Archive, thorough: bool = False) -> Verified:
    """Read everything that the archive holds and list what is wrong, by place.

    The hash of every object is computed. Its MCAP checksums were tested when it was added; they are tested again where
    that cannot be relied on: where its hash is another one, where its record does not say what was found then, where
    the catalogue says something else, and, with ``thorough``, of every object.
    """
    archive.finish_interrupted()
    faults: list[Fault] = []
    records = dict(_read_records(archive, faults))
    objects = dict(_list_objects(archive, records, faults))
    kept = {sha256: record for sha256, record in records.items() if not record.freed}
    for sha256, record in kept.items():
        if sha256 not in objects:
            where = str(archive.storage.path(record.object_key))
            faults.append(Fault("object", sha256, where, f"{record.file_name} is missing", _FETCH))
    present = [record for sha256, record in kept.items() if sha256 in objects]
    rows = _load_rows(archive, faults)
    known = {} if thorough else _read_trusted_descriptions(present, rows)
    groups = [present[start : start + _GROUP] for start in range(0, len(present), _GROUP)]
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:  # hashing and reading do not hold the interpreter's lock
        found = pool.map(lambda group: [_check_object(archive, one, known.get(one.sha256)) for one in group], groups)
        checked = [one for group in found for one in group]
    for one in checked:
        faults += one.faults
    damaged = {fault.sha256 for fault in faults}
    described = {one.sha256: one.described for one in checked if one.sha256 not in damaged}
    faults += _compare_catalogue(archive, records, described, known, rows)
    faults += _check_provenance(archive, records, described, damaged)
    faults += _check_links(archive, records)
    return Verified(len(present), sum(objects[record.sha256] for record in present), tuple(faults))


_FETCH = "fetch it from a copy: stillpoint archive repair --from OTHER"
_RESTORE = "stillpoint archive repair restores it from the catalogue, or --from OTHER from a copy"
_REBUILD = "stillpoint archive rebuild"


def _read_records(archive: Archive, faults: list[Fault]) -> Iterator[tuple[str, Record]]:
    """Yield the sound records by hash."""
    if not archive.storage.has(MARK):
        faults.append(Fault("record", "", MARK, "is missing", f"write any text to {MARK}"))
    for key, _ in archive.storage.keys("records"):
        sha256, where = extract_sha256(key), f"{archive.storage.name}/{key}"
        if not sha256 or key != record_key(sha256):
            faults.append(Fault("record", "", where, "is no record of this archive", "move it away"))
            continue
        try:
            record = archive.read_record(sha256)
        except BadFile as error:
            faults.append(Fault("record", sha256, where, str(error).partition(": ")[2].partition(";")[0], _RESTORE))
            continue
        if record.sha256 != sha256:
            faults.append(Fault("record", sha256, where, f"is the record of {record.sha256[:12]}", _RESTORE))
            continue
        yield sha256, record


def _list_objects(archive: Archive, records: Mapping[str, Record], faults: list[Fault]) -> Iterator[tuple[str, int]]:
    """Hash and size of each object that has a record; others are faults."""
    damaged = {fault.sha256 for fault in faults}
    for key, size in archive.storage.keys("objects"):
        sha256, where = extract_sha256(key), f"{archive.storage.name}/{key}"
        record = records.get(sha256)
        if record is None and sha256 in damaged:
            continue
        if record is None:
            known = f"it has no record{'' if sha256 else ', and its name is no hash'}"
            repair = "add the file to the archive, then delete this one" if sha256 else "move it away"
            faults.append(Fault("record", sha256, where, known, _RESTORE if archive.entry(sha256) else repair))
        elif key != record.object_key:
            faults.append(Fault("object", sha256, where, f"should be {record.object_key}", "rename it"))
        elif record.freed:
            faults.append(Fault("object", sha256, where, "its bytes were freed, and are there", "delete it"))
        else:
            yield sha256, size


_Rows = Mapping[str, Mapping[str, Sequence[Mapping[str, Any]]]]  # object -> table -> rows


def _load_rows(archive: Archive, faults: list[Fault]) -> _Rows:
    """Return all rows of the catalogue by object; a damaged catalogue is a fault and has none."""
    where, catalogue = str(archive.catalogue.path), archive.catalogue
    found: dict[str, dict[str, list[dict[str, Any]]]] = {}
    try:
        sound = [row[0] for row in catalogue.select("PRAGMA integrity_check")]
        if sound != ["ok"]:
            faults.append(Fault("catalogue", "", where, f"SQLite finds it damaged: {sound[0]}", _REBUILD))
            return {}
        for table in TABLES:
            for row in catalogue.select(f"SELECT * FROM {table}"):
                found.setdefault(row[0], {}).setdefault(table, []).append(dict(row))
    except BadFile as error:
        faults.append(Fault("catalogue", "", where, str(error).partition(": ")[2].partition(";")[0], _REBUILD))
        return {}
    return found


def _read_trusted_descriptions(records: Sequence[Record], rows: _Rows) -> dict[str, Description]:
    """Return what the catalogue says of those objects whose record vouches for it."""
    trusted = {}
    for record in records:
        own = rows.get(record.sha256, {})
        if record.described and own and digest_rows(own) == record.described:
            about = own["objects"][0]
            parents = [(row["name"], row["parent"]) for row in own.get("parents", ())]
            trusted[record.sha256] = Description(about["kind"], about["name"], parents=parents)
    return trusted


def _check_object(archive: Archive, record: Record, known: Description | None) -> _Checked:
    """Hash an object; where it is not ``known`` what is in it, read it: every checksum in an MCAP file is tested."""
    key = record.object_key
    try:
        with archive.storage.open(key) as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]  # any binary file will do
    except (OSError, BadFile) as error:
        fault = Fault("object", record.sha256, f"{archive.storage.name}/{key}", f"cannot be read ({error})", _FETCH)
        return _Checked(record.sha256, Description("unreadable", record.file_name), (fault,))
    if known is not None and found == record.sha256:
        return _Checked(record.sha256, known, ())
    path = archive.storage.path(key)
    described = describe_object(path, record.file_name)
    problem = described.problem.removeprefix(f"{path}: ").partition("; restore it")[0]
    if found != record.sha256:
        size = path.stat().st_size if path.exists() else record.size
        length = "" if size == record.size else f", {size} bytes where {record.size} were added"
        what = f"{record.file_name} is damaged: its hash is {found[:12]}…{length}{f'; {problem}' if problem else ''}"
        repair = f"{_FETCH}; what is readable: stillpoint recover {path}" if path.suffix == ".mcap" else _FETCH
        return _Checked(record.sha256, described, (Fault("object", record.sha256, str(path), what, repair),))
    if problem:
        what = f"{record.file_name} is as it was added, and it is damaged: {problem}"
        repair = f"stillpoint recover {path}; add the result and remove this one"
        return _Checked(record.sha256, described, (Fault("content", record.sha256, str(path), what, repair),))
    return _Checked(record.sha256, described, ())


def _compare_catalogue(
    archive: Archive,
    records: Mapping[str, Record],
    described: Mapping[str, Description],
    known: Mapping[str, Description],
    rows: _Rows,
) -> Iterator[Fault]:
    """Compare the rows of every object with what follows from its content and its record."""
    where = str(archive.catalogue.path)
    if not rows and records:
        return  # a fault already
    for sha256, record in records.items():
        if sha256 not in described and not record.freed:
            continue  # its object is damaged or missing, which is a fault already
        own = rows.get(sha256, {})
        if not own.get("objects"):
            yield Fault("catalogue", sha256, where, f"lacks {record.file_name}", _REBUILD)
            continue
        wrong = _find_wrong_labels(record, own)
        if sha256 not in known:
            expected = make_content_rows(record, described.get(sha256) or archive.describe(record))
            wrong |= {name for name in DESCRIBED_TABLES if digest_rows({name: expected.get(name, ())})
                      != digest_rows({name: own.get(name, ())})}  # fmt: skip
        if wrong:
            what = f"{record.file_name}: rows of {', '.join(sorted(wrong))} differ from the object"
            yield Fault("catalogue", sha256, where, what, _REBUILD)
    for sha256 in sorted(set(rows) - set(records)):
        if not archive.storage.has(record_key(sha256)):
            yield Fault("record", sha256, str(archive.storage.path(record_key(sha256))), "is missing", _RESTORE)


def _find_wrong_labels(record: Record, own: Mapping[str, Sequence[Mapping[str, Any]]]) -> set[str]:
    """Return the tables in which tags, metadata or the mark of removal differ from the record."""
    about = own["objects"][0]
    found = {
        "objects": {name: about[name] for name in ("removed", "reason", "freed")},
        "tags": sorted(row["tag"] for row in own.get("tags", ())),
        "metadata": {row["key"]: row["value"] for row in own.get("metadata", ())},
    }
    expected = {
        "objects": {"removed": record.removed, "reason": record.reason, "freed": record.freed},
        "tags": sorted(set(record.tags)),
        "metadata": dict(record.metadata),
    }
    return {table for table in found if found[table] != expected[table]}


def _check_provenance(
    archive: Archive, records: Mapping[str, Record], described: Mapping[str, Description], damaged: Collection[str]
) -> Iterator[Fault]:
    """Yield a fault for every object whose parents, back to a recording, are not all here.

    What is damaged is a fault already, and no second one of everything that was made from it.
    """
    for sha256, one in described.items():
        record = records[sha256]
        if one.kind not in _MADE or record.removed:
            continue
        where = f"{archive.storage.name}/{record.object_key}"
        for name, parent in one.parents:
            kept = records.get(parent)
            if parent in damaged:
                continue
            if kept is None and one.kind == "estimate" and _is_raw(name):
                continue  # an attitude that a device or another program made: its file stays outside, as a recording's
            if kept is None:
                what = f"{record.file_name} was made from {name} ({parent[:12]}…), which is not in the archive"
                yield Fault("provenance", sha256, where, what, f"stillpoint archive add {name}")
            elif kept.removed:
                what = f"{record.file_name} was made from {name}, which was removed ({kept.reason})"
                yield Fault("provenance", sha256, where, what, f"add {name} again, or remove what was made from it")
        kinds = {described[parent].kind for _, parent in one.parents if parent in described}
        is_known = all(parent in described for _, parent in one.parents)
        if one.kind in ("reference", "roll reference", "estimate") and is_known and kinds and "recording" not in kinds:
            what = f"{record.file_name} names no recording among what it was made from"
            yield Fault("provenance", sha256, where, what, "make it again from its recording")


def _is_raw(name: str) -> bool:
    """Return whether a file of this name is of another program: our estimates are made from MCAP and TOML files."""
    return not name.endswith((".mcap", ".calibration.toml"))


def _check_links(archive: Archive, records: Mapping[str, Record]) -> Iterator[Fault]:
    """Yield a fault for every link under names/ that does not lead to the object that the catalogue says."""
    if not isinstance(archive.storage, FolderStorage):
        return
    folder = archive.home / "names"
    try:
        rows = archive.catalogue.select("SELECT sha256, link FROM objects WHERE link != ''")
    except (BadFile, sqlite3.DatabaseError):
        return  # a damaged catalogue is a fault already
    expected = {row["link"]: row["sha256"] for row in rows}
    for name, sha256 in expected.items():
        link = f"{folder}/{name}"
        try:
            target = os.readlink(link)
        except OSError:  # not there, or no link
            target = None
        if sha256 in records and target != f"../{records[sha256].object_key}":
            what = "is missing" if target is None else f"leads to {target}"
            yield Fault("link", sha256, link, what, _REBUILD)
    for name in sorted(set(os.listdir(folder)) - set(expected)) if folder.is_dir() else ():
        yield Fault("link", "", f"{folder}/{name}", "leads to nothing that the catalogue has", "delete it")
