"""The catalogue: one SQLite file that answers queries. It is derived; :func:`fill` makes it from the objects.

The schema is documented in docs/archive.md. Readers may open the file with any SQLite program; they should use the
views ``recordings``, ``references``, ``estimates``, ``scores`` and ``provenance``, which stay as they are when the
tables change.
"""

import hashlib
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from stillpoint.datasets.archive.describe import Description
from stillpoint.datasets.archive.record import Record
from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.mcap.facts import to_json

FILE = "catalogue.sqlite"
_WAIT_S = 60.0  # for another process that is writing

DESCRIBED = (
    "version", "duration_s", "samples", "rate_hz", "sensor", "source", "licence", "citation", "date", "epoch",
    "latitude_deg", "longitude_deg", "method", "estimator", "rests", "sd_median_deg", "sd_max_deg", "heading_sd_deg",
    "ns_per_sample",
)  # fmt: skip
NUMBERS = {
    "duration_s", "samples", "rate_hz", "latitude_deg", "longitude_deg", "rests", "sd_median_deg", "sd_max_deg",
    "heading_sd_deg", "ns_per_sample", "size",
}  # fmt: skip
SCORE_FIGURES = (
    "total_rmse_deg", "heading_rmse_deg", "inclination_rmse_deg", "total_p95_deg", "total_max_deg", "angle_rmse_deg",
    "rate_rmse_degps",
)  # fmt: skip


def _choose_affinity(name: str) -> str:
    """Return the SQLite type of a column."""
    if name in ("samples", "rests"):
        return "INTEGER"
    return "REAL" if name in NUMBERS else "TEXT"


_COMMON = "o.sha256, o.name, o.file_name, o.size, o.added, o.version, o.duration_s, o.samples, o.rate_hz"
_MIGRATIONS: tuple[str, ...] = (
    f"""
    CREATE TABLE objects (
        sha256 TEXT PRIMARY KEY, kind TEXT NOT NULL, name TEXT NOT NULL, file_name TEXT NOT NULL, suffix TEXT NOT NULL,
        size INTEGER NOT NULL, added TEXT NOT NULL, removed TEXT NOT NULL DEFAULT '',
        reason TEXT NOT NULL DEFAULT '', freed TEXT NOT NULL DEFAULT '',
        problem TEXT NOT NULL, link TEXT NOT NULL DEFAULT '',
        {", ".join(f"{name} {_choose_affinity(name)}" for name in DESCRIBED)},
        facts TEXT NOT NULL
    ) WITHOUT ROWID;
    CREATE INDEX objects_by_name ON objects (name);
    CREATE INDEX objects_by_kind ON objects (kind, removed);
    CREATE TABLE streams (
        sha256 TEXT NOT NULL, stream TEXT NOT NULL, samples INTEGER NOT NULL, rate_hz REAL NOT NULL,
        start_s REAL NOT NULL, length_s REAL NOT NULL, gaps INTEGER NOT NULL, longest_gap_s REAL NOT NULL,
        PRIMARY KEY (sha256, stream)
    ) WITHOUT ROWID;
    CREATE TABLE tags (sha256 TEXT NOT NULL, tag TEXT NOT NULL, PRIMARY KEY (sha256, tag)) WITHOUT ROWID;
    CREATE INDEX tags_by_tag ON tags (tag);
    CREATE TABLE metadata (
        sha256 TEXT NOT NULL, key TEXT NOT NULL, value TEXT NOT NULL, PRIMARY KEY (sha256, key)
    ) WITHOUT ROWID;
    CREATE INDEX metadata_by_key ON metadata (key, value);
    CREATE TABLE parents (
        child TEXT NOT NULL, parent TEXT NOT NULL, name TEXT NOT NULL, PRIMARY KEY (child, name, parent)
    ) WITHOUT ROWID;
    CREATE INDEX parents_by_parent ON parents (parent);
    CREATE TABLE score_rows (
        sha256 TEXT NOT NULL, row INTEGER NOT NULL, recording TEXT, estimator TEXT, against TEXT, file TEXT,
        {", ".join(f"{name} REAL" for name in SCORE_FIGURES)}, error TEXT, PRIMARY KEY (sha256, row)
    ) WITHOUT ROWID;
    CREATE INDEX score_rows_by_recording ON score_rows (recording);
    CREATE VIEW recordings AS SELECT {_COMMON}, o.sensor, o.source, o.licence, o.citation, o.date, o.epoch,
        o.latitude_deg, o.longitude_deg FROM objects o WHERE o.kind = 'recording' AND o.removed = '';
    CREATE VIEW "references" AS SELECT {_COMMON}, o.method, o.rests, o.sd_median_deg, o.sd_max_deg, o.heading_sd_deg
        FROM objects o WHERE o.kind IN ('reference', 'roll reference') AND o.removed = '';
    CREATE VIEW estimates AS SELECT {_COMMON}, o.estimator, o.ns_per_sample
        FROM objects o WHERE o.kind = 'estimate' AND o.removed = '';
    CREATE VIEW scores AS SELECT r.*, o.file_name AS score_file FROM score_rows r JOIN objects o USING (sha256)
        WHERE o.removed = '';
    CREATE VIEW provenance AS SELECT p.child, c.kind AS child_kind, c.name AS child_name, p.parent,
        a.kind AS parent_kind, p.name AS parent_name, a.sha256 IS NOT NULL AND a.freed = '' AS parent_kept
        FROM parents p JOIN objects c ON c.sha256 = p.child LEFT JOIN objects a ON a.sha256 = p.parent;
    """,
)
_LABELLED = ("removed", "reason", "freed", "link")  # columns of `objects` that its content does not decide
DESCRIBED_TABLES = ("objects", "streams", "parents", "score_rows")
TABLES = ("objects", "streams", "tags", "metadata", "parents", "score_rows")


@dataclass(frozen=True)
class Entry:
    """One object as the catalogue has it; ``columns`` holds what queries compare."""

    sha256: str
    kind: str
    name: str
    file_name: str
    size: int
    added: str
    removed: str
    problem: str
    link: str
    columns: Mapping[str, Any]


class Catalogue:
    """An open catalogue. Changes go through :meth:`change`, one transaction each."""

    def __init__(self, path: Path) -> None:
        """Open the catalogue, and migrate it to this version; raises :class:`BadFile` for another file."""
        self.path = path
        try:
            self.connection = sqlite3.connect(path, timeout=_WAIT_S, isolation_level=None)
            self.connection.row_factory = sqlite3.Row
            self.connection.execute("PRAGMA journal_mode=WAL")
            self.connection.execute("PRAGMA synchronous=NORMAL")  # it is derived: a power cut may cost a rebuild
            self._migrate()
        except sqlite3.DatabaseError as error:
            raise BadFile(f"{path}: {error}; delete it and run stillpoint archive rebuild: nothing is lost") from error

    def close(self) -> None:
        """Close the file."""
        self.connection.close()

    @contextmanager
    def change(self) -> Iterator[sqlite3.Connection]:
        """Yield one transaction that writes; other writers wait."""
        self.connection.execute("BEGIN IMMEDIATE")
        try:
            yield self.connection
        except BaseException:
            self.connection.execute("ROLLBACK")
            raise
        self.connection.execute("COMMIT")

    def select(self, sql: str, parameters: Sequence[Any] = ()) -> list[sqlite3.Row]:
        """Return the rows of a query; raises :class:`BadFile` when the file is damaged."""
        try:
            return self.connection.execute(sql, parameters).fetchall()
        except sqlite3.DatabaseError as error:
            raise BadFile(f"{self.path}: {error}; run stillpoint archive rebuild: nothing is lost") from error

    def entries(self, where: str = "1", parameters: Sequence[Any] = ()) -> list[Entry]:
        """Return objects that meet a condition on ``objects o``, oldest first."""
        own = ("sha256", "kind", "name", "file_name", "size", "added", "removed", "problem", "link")
        names = ", ".join(f"o.{name}" for name in (*own, *DESCRIBED))
        rows = self.select(f"SELECT {names} FROM objects o WHERE {where} ORDER BY o.added, o.sha256", parameters)
        return [
            Entry(**{name: row[name] for name in own}, columns={name: row[name] for name in DESCRIBED}) for row in rows
        ]

    def dump(self) -> dict[str, list[tuple[Any, ...]]]:
        """Return every row of every table, in order: two catalogues of one archive give the same."""
        return {table: [tuple(row) for row in self.select(f"SELECT * FROM {table} ORDER BY 1, 2")] for table in TABLES}

    def _migrate(self) -> None:
        """Apply the migrations that the file lacks, each in one transaction.

        Raises :class:`BadFile` for a newer schema.
        """
        version = self.connection.execute("PRAGMA user_version").fetchone()[0]
        if version > len(_MIGRATIONS):
            raise BadFile(f"{self.path}: was written by a newer stillpoint (schema {version}); install that version")
        while version < len(_MIGRATIONS):
            with self.change() as connection:
                version = connection.execute("PRAGMA user_version").fetchone()[0]  # another process may have done it
                if version < len(_MIGRATIONS):
                    for statement in _MIGRATIONS[version].split(";"):
                        connection.execute(statement)
                    connection.execute(f"PRAGMA user_version={version + 1}")
                    version += 1


def put_object(connection: sqlite3.Connection, record: Record, described: Description, link: str) -> None:
    """Insert an object, or replace what the catalogue has about it."""
    _forget_object(connection, record.sha256)
    for table, rows in make_content_rows(record, described).items():
        _insert(connection, table, rows)
    connection.execute("UPDATE objects SET link = ? WHERE sha256 = ?", (link, record.sha256))
    put_labels(connection, record)


def make_content_rows(record: Record, described: Description) -> dict[str, list[dict[str, Any]]]:
    """Return the rows, by table, of an object's content; those of its labels are added by :func:`put_labels`."""
    columns = {
        "sha256": record.sha256,
        "kind": described.kind,
        "name": described.name,
        "file_name": record.file_name,
        "suffix": record.suffix,
        "size": record.size,
        "added": record.added,
        "problem": described.problem,
        **{name: described.columns.get(name) for name in DESCRIBED},
        "facts": to_json(described.facts),
    }
    return {
        "objects": [columns],
        "streams": [{"sha256": record.sha256, **vars(stream)} for stream in described.streams],
        "parents": [_make_parent_row(record.sha256, *parent) for parent in described.parents],
        "score_rows": [_score_row(record.sha256, k, row) for k, row in enumerate(described.scores)],
    }


def digest_rows(rows: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Return the SHA-256 of described rows; rows to be inserted and the same rows read back give the same one."""
    plain = {}
    for table in DESCRIBED_TABLES:
        own = rows.get(table, ())
        plain[table] = sorted(
            [[name, _to_text(row[name])] for name in _list_content_columns(tuple(row))] for row in own
        )
    return hashlib.sha256(json.dumps(plain, ensure_ascii=True).encode()).hexdigest()


@cache
def _list_content_columns(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the columns of a row that its content decides, in order."""
    return tuple(sorted(set(names) - set(_LABELLED)))


def _to_text(value: Any) -> str:
    """Return a value as text; SQLite gives whole numbers of a REAL column back as floats, and NaN as NULL."""
    if isinstance(value, str):  # the most of them
        return f"'{value}"
    if value is None or value != value:
        return "null"
    return repr(float(value)) if isinstance(value, int | float) else f"'{value}"


def put_labels(connection: sqlite3.Connection, record: Record) -> None:
    """Bring what a record says (tags, metadata, removal) into the catalogue."""
    connection.execute(
        "UPDATE objects SET removed = ?, reason = ?, freed = ? WHERE sha256 = ?",
        (record.removed, record.reason, record.freed, record.sha256),
    )
    for table in ("tags", "metadata"):
        connection.execute(f"DELETE FROM {table} WHERE sha256 = ?", (record.sha256,))
    _insert(connection, "tags", [{"sha256": record.sha256, "tag": tag} for tag in sorted(set(record.tags))])
    rows = [{"sha256": record.sha256, "key": key, "value": value} for key, value in sorted(record.metadata.items())]
    _insert(connection, "metadata", rows)


def _forget_object(connection: sqlite3.Connection, sha256: str) -> None:
    """Delete all rows of an object."""
    for table in TABLES:
        column = "child" if table == "parents" else "sha256"
        connection.execute(f"DELETE FROM {table} WHERE {column} = ?", (sha256,))


def read_facts(text: str) -> dict[str, Any]:
    """Return the facts in a row of the catalogue."""
    facts: dict[str, Any] = json.loads(text)
    return facts


def _make_parent_row(child: str, name: str, parent: str) -> dict[str, Any]:
    return {"child": child, "parent": parent, "name": name}


def _score_row(sha256: str, place: int, row: Mapping[str, Any]) -> dict[str, Any]:
    """Return one row of a score table or a leaderboard; what a table does not have stays empty."""
    texts = {
        "recording": row.get("recording"),
        "estimator": row.get("method", row.get("estimator")),
        "against": row.get("against"),
        "file": row.get("file", row.get("estimate_file")),
        "error": row.get("error"),
    }
    figures = {name: row.get(name) for name in SCORE_FIGURES}
    return {
        "sha256": sha256,
        "row": place,
        **{name: None if value is None else str(value) for name, value in texts.items()},
        **{name: value if isinstance(value, int | float) else None for name, value in figures.items()},
    }


def _insert(connection: sqlite3.Connection, table: str, rows: Iterable[Mapping[str, Any]]) -> None:
    """Insert rows; names of tables and columns are ours, values go as parameters."""
    for row in rows:
        names = ", ".join(row)
        marks = ", ".join("?" * len(row))
        connection.execute(f"INSERT INTO {table} ({names}) VALUES ({marks})", tuple(row.values()))
