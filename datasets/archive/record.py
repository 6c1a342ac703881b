"""The record of an object beside its content: names, tags, when it was added, why it was removed.

One JSON file per object, ``records/ab/cdef….json``. It ends with a checksum of its own, so that damage is found.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime

from stillpoint.datasets.errors import BadFile

SHA256 = re.compile(r"[0-9a-f]{64}")
_SUFFIX = re.compile(r"\.[a-z0-9]{1,10}")
_FORMAT = 1


@dataclass(frozen=True)
class Record:
    """One object of the archive; times are ISO 8601 in UTC, "" for what did not happen."""

    sha256: str
    suffix: str  # of the object's file, ".mcap"
    file_name: str  # that the file had when it was added
    size: int  # bytes
    added: str
    tags: tuple[str, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)
    removed: str = ""  # when it was marked as removed
    reason: str = ""  # why
    freed: str = ""  # when its bytes were deleted
    described: str = ""  # SHA-256 of its rows in the catalogue, made when every checksum in it was tested

    @property
    def object_key(self) -> str:
        """Return the key of its bytes in the archive."""
        return f"objects/{self.sha256[:2]}/{self.sha256[2:]}{self.suffix}"

    @property
    def record_key(self) -> str:
        """Return the key of this record in the archive."""
        return record_key(self.sha256)


def record_key(sha256: str) -> str:
    """Return the key of the record of an object in the archive."""
    return f"records/{sha256[:2]}/{sha256[2:]}.json"


def extract_sha256(key: str) -> str:
    """Return the hash that the place of an object or a record stands for; "" when the place has another form."""
    parts = key.split("/")
    if len(parts) != 3:
        return ""
    sha256 = parts[1] + parts[2].split(".")[0]
    return sha256 if SHA256.fullmatch(sha256) else ""


def choose_suffix(file_name: str) -> str:
    """Return the suffix under which an object with this name is kept; ".bin" when the name has no plain one."""
    suffix = "." + file_name.rpartition(".")[2].lower() if "." in file_name.strip(".") else ""
    return suffix if _SUFFIX.fullmatch(suffix) else ".bin"


def now() -> str:
    """Return the current time, UTC, to the microsecond."""
    return datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def record_to_bytes(record: Record) -> bytes:
    """Return the JSON of a record, with its checksum."""
    plain = {"format": _FORMAT, **asdict(record), "tags": sorted(record.tags), "metadata": dict(record.metadata)}
    return (json.dumps({**plain, "check": _hash_plain(plain)}, indent=1, ensure_ascii=True) + "\n").encode()


def record_from_bytes(data: bytes, where: str) -> Record:
    """Return the record in these bytes; raises :class:`BadFile` when they are damaged."""
    try:
        plain = json.loads(data)
        check, written_format = plain.pop("check"), plain["format"]
        if written_format != _FORMAT:
            raise BadFile(f"{where}: is a record of format {written_format}; install a newer stillpoint")
        if check != _hash_plain(plain):
            raise ValueError("its checksum differs")
        del plain["format"]
        record = Record(**{**plain, "tags": tuple(plain["tags"])})
        if not SHA256.fullmatch(record.sha256) or not _SUFFIX.fullmatch(record.suffix):
            raise ValueError("it names no object")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadFile(f"{where}: this record is damaged ({error}); run stillpoint archive repair") from error
    return record


def _hash_plain(plain: Mapping[str, object]) -> str:
    """Return the SHA-256 of the JSON of plain values with sorted keys."""
    return hashlib.sha256(json.dumps(plain, sort_keys=True, ensure_ascii=True).encode()).hexdigest()
