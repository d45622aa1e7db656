"""The store of pcretrieve: an SQLite file, which other processes can read while one process writes."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from os.path import samestat
from pathlib import Path
from typing import Any

from pcretrieve.catalogue.checksums import checksum
from pcretrieve.catalogue.defects import Defect
from pcretrieve.catalogue.entry_rows import entries_of
from pcretrieve.catalogue.migrations import prepare
from pcretrieve.catalogue.opening import connect, damaged, is_writable, shrink, translated
from pcretrieve.catalogue.record import Record, free_id
from pcretrieve.catalogue.record_rows import (
    LENGTHS,
    PROVENANCE_COLUMNS,
    RECORDS,
    SHAPE_COLUMNS,
    record_of,
    row_of,
)
from pcretrieve.catalogue.rows import OWN, PAYLOADS, Entry, Listed, Origin, Payload, Revision, Rows, Status
from pcretrieve.catalogue.schema import NEW_NAME, transaction
from pcretrieve.catalogue.signature_rows import listed
from pcretrieve.catalogue.sqlite_defects import file_defects
from pcretrieve.errors import CatalogueError

__all__ = ["SqliteRows"]


# Number of parameters of a query, of which SQLite allows 999 in early versions.
PARAMETERS = 500


class SqliteRows(Rows):
    """Rows in an SQLite file. The methods are documented in `Rows`."""

    def __init__(self, path: Path, settings: Mapping[str, str], *, create: bool) -> None:
        self._path = path
        self._connection = connect(path, create=create)
        try:
            with translated(path):
                prepare(self._connection, path, settings)
            self._file = path.stat()
        except BaseException:
            self._connection.close()
            raise

    def close(self) -> None:
        self._connection.close()

    # --- the store --------------------------------------------------------------------------------------

    @property
    def location(self) -> str:
        return str(self._path)

    @property
    def folder(self) -> Path:
        return self._path.with_name(self._path.name + ".gallery")

    @property
    def is_writable(self) -> bool:
        return is_writable(self._path)

    def defects(self, *, repair: bool) -> list[Defect]:
        with translated(self._path):
            return file_defects(self._connection, repair=repair)

    def settings(self) -> Mapping[str, str]:
        return dict(self._all("SELECT key, value FROM meta"))

    def revision(self) -> Revision:
        settings = self.settings()
        try:
            return Revision(settings["revision"], settings["label_revision"])
        except KeyError as error:
            raise damaged(self._path, f"it has no {error.args[0]}") from error

    def count(self, status: Status) -> int:
        return int(self._all("SELECT count(*) FROM shapes WHERE status = ?", (status,))[0][0])

    def failures(self) -> dict[tuple[str, str], int]:
        query = "SELECT stage, error, count(*) FROM shapes WHERE status = 'failed' GROUP BY 1, 2"
        return {(stage, error): number for stage, error, number in self._all(query)}

    def areas(self) -> dict[float | None, tuple[float, float]]:
        query = "SELECT metres_per_unit, min(area), max(area) FROM shapes WHERE status = 'done' GROUP BY 1"
        return {unit: (smallest, largest) for unit, smallest, largest in self._all(query)}

    # --- records ----------------------------------------------------------------------------------------

    def page(
        self,
        *,
        after: str = "",
        offset: int = 0,
        limit: int,
        status: Status | None = None,
        doubtful: bool = False,
    ) -> list[Record]:
        chosen = "" if status is None else "AND status = :status"
        # In the words of the index.
        chosen += " AND judgement <> 'sound'" if doubtful else ""
        query = f"{RECORDS} WHERE id > :after {chosen} ORDER BY id LIMIT :limit OFFSET :offset"
        values = {"after": after, "status": status, "limit": limit, "offset": offset}
        return [record_of(row, self.location) for row in self._all(query, values)]

    def by_id(self, shape_ids: Collection[str]) -> list[Record]:
        return self._where("id", shape_ids)

    def by_content(self, hashes: Collection[str]) -> list[Record]:
        return self._where("content_hash", hashes)

    def origins(self) -> list[Origin]:
        rows = self._all("SELECT id, path, content_hash, label, status, stamp FROM shapes ORDER BY id")
        return [Origin(*row) for row in rows]

    def times(self) -> dict[str, str]:
        return dict(self._all("SELECT id, added FROM shapes JOIN provenance ON shape = number"))

    def labelled(self, labels: Collection[str]) -> list[str]:
        # One class after the other, because there may be more classes than parameters of a query.
        query = "SELECT id FROM shapes NOT INDEXED WHERE status = 'done' AND label = ?"
        return sorted(shape_id for label in set(labels) for (shape_id,) in self._all(query, (label,)))

    def put(self, record: Record, signature: bytes | None, payloads: Mapping[Payload, bytes]) -> Record:
        with self._writing():
            earlier = self._all("SELECT id, status FROM shapes WHERE path = ?", (record.path,))
            shape_id, status = earlier[0] if earlier else (free_id(record, self._is_taken), None)
            if status == "done" and record.status == "failed":
                return self._one(shape_id)
            signatures = {} if signature is None else {OWN: signature}
            self._store([Entry(replace(record, id=shape_id), signatures, payloads)])
            if "done" in (status, record.status):
                self._changed("revision")
            return self._one(shape_id)

    def entries(self, shape_ids: Collection[str]) -> list[Entry]:
        with self._reading():
            return entries_of(self.by_id(shape_ids), self._each)

    def add(self, entries: Collection[Entry]) -> None:
        with self._writing():
            self._store(entries)
            self._changed("revision")

    def remove(self, shape_ids: Collection[str]) -> None:
        with self._writing():
            self._forget(self._numbers("id", shape_ids))
            self._changed("revision")
        shrink(self._connection, self._path)

    def revise(
        self,
        *,
        moved: Mapping[str, str],
        removed: Collection[str],
        labels: Mapping[str, str | None],
        stamps: Mapping[str, str],
    ) -> None:
        with self._writing() as connection:
            connection.executemany(
                "UPDATE OR IGNORE shapes SET path = ?, path_checksum = ? WHERE path = ?",
                [(new, checksum(new), old) for old, new in moved.items()],
            )
            if removed:
                self._forget(self._numbers("path", removed))
                self._changed("revision")
            if labels:
                connection.executemany(
                    "UPDATE shapes SET label = ?, label_checksum = ? WHERE path = ?",
                    [(label, checksum(label), path) for path, label in labels.items()],
                )
                self._changed("label_revision")
            connection.executemany(
                "UPDATE shapes SET stamp = ? WHERE path = ?",
                [(stamp, path) for path, stamp in stamps.items()],
            )

    # --- arrays -----------------------------------------------------------------------------------------

    def read(self, shape_id: str, names: Collection[Payload]) -> tuple[Record, dict[Payload, bytes]] | None:
        with self._reading():
            for number in self._numbers("id", [shape_id]):
                return self._one(shape_id), self._payloads(number, names)
        return None

    def sizes(self, shape_id: str) -> dict[str, int]:
        ((record,),) = self._all(f"SELECT sum({LENGTHS}) FROM ({RECORDS}) WHERE id = ?", (shape_id,))
        sizes = {"record": record or 0}
        for name, column in (("signatures", "value"), *((payload, "arrays") for payload in PAYLOADS)):
            query = f"SELECT sum(length({column})) FROM {name} JOIN shapes ON shape = number WHERE id = ?"
            ((size,),) = self._all(query, (shape_id,))
            sizes[name] = size or 0
        return sizes

    def signatures(self, digest: str) -> Listed:
        with self._reading():
            return listed(self._connection, self.location, self.revision(), digest)

    def keep(self, digest: str, signatures: Collection[tuple[Record, bytes]]) -> None:
        with self._writing():
            rows = [
                (number, value)
                for record, value in signatures
                for (number,) in self._all(
                    "SELECT number FROM shapes WHERE id = ? AND content_hash = ? AND status = 'done'",
                    (record.id, record.content_hash),
                )
            ]
            self._keep(digest, rows)

    def keep_payload(self, name: Payload, record: Record, arrays: bytes) -> None:
        with self._writing():
            self._connection.execute(
                f"INSERT OR REPLACE INTO {name} SELECT number, ? FROM shapes "
                "WHERE id = ? AND content_hash = ? AND status = 'done'",
                (arrays, record.id, record.content_hash),
            )

    # --- inside -----------------------------------------------------------------------------------------

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """One transaction, in which everything that is read belongs to one state."""
        with translated(self._path), transaction(self._connection, "DEFERRED"):
            yield

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """One transaction that locks the file for writing, so that what it has read does not change."""
        with translated(self._path), transaction(self._connection, "IMMEDIATE"):
            self._check_place()
            yield self._connection

    def _check_place(self) -> None:
        """Check that the path has the file that is open still: SQLite writes to a removed file too."""
        try:
            is_here = samestat(self._file, self._path.stat())
        except OSError:
            is_here = False
        if not is_here:
            raise CatalogueError(
                f"{self._path} was removed or replaced while it was in use: what would be written now would "
                "be lost; put the file back, or run the same command again"
            )

    def _changed(self, revision: str) -> None:
        """Give the new state a name that no earlier state had, not even before a copy was restored."""
        self._connection.execute(f"UPDATE meta SET value = {NEW_NAME} WHERE key = ?", (revision,))

    def _store(self, entries: Collection[Entry]) -> None:
        """Insert shapes, each instead of the shape of its path, if there is one."""
        paths = [entry.record.path for entry in entries]
        self._forget([number for (number,) in self._each("SELECT number FROM shapes", paths, "path")])
        ((last,),) = self._all("SELECT ifnull(max(number), 0) FROM shapes")
        numbered = list(enumerate(entries, last + 1))
        rows = [(number, row_of(entry.record)) for number, entry in numbered]
        for table, key, columns in (
            ("shapes", "number", SHAPE_COLUMNS),
            ("provenance", "shape", PROVENANCE_COLUMNS),
        ):
            chosen = ((number, *(row[name] for name in columns)) for number, row in rows)
            self._insert(table, (key, *columns), chosen)
        for digest in {digest for entry in entries for digest in entry.signatures}:
            self._keep(digest, [(n, e.signatures[digest]) for n, e in numbered if digest in e.signatures])
        for name in PAYLOADS:
            stored = ((number, entry.payloads[name]) for number, entry in numbered if name in entry.payloads)
            self._insert(name, ("shape", "arrays"), stored)

    def _payloads(self, number: int, names: Collection[Payload]) -> dict[Payload, bytes]:
        stored: dict[Payload, bytes] = {}
        for name in names:
            for (arrays,) in self._all(f"SELECT arrays FROM {name} WHERE shape = ?", (number,)):
                stored[name] = arrays
        return stored

    def _insert(self, table: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        marks = ", ".join("?" * len(columns))
        self._connection.executemany(f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({marks})", rows)

    def _keep(self, digest: str, rows: Collection[tuple[int, bytes]]) -> None:
        self._connection.execute("INSERT OR IGNORE INTO descriptors (digest) VALUES (?)", (digest,))
        self._connection.executemany(
            "INSERT OR REPLACE INTO signatures SELECT number, ?, ? FROM descriptors WHERE digest = ?",
            [(shape, value, digest) for shape, value in rows],
        )

    def _forget(self, numbers: Collection[int]) -> None:
        chosen = [(number,) for number in numbers]
        for name in ("provenance", *PAYLOADS):
            self._connection.executemany(f"DELETE FROM {name} WHERE shape = ?", chosen)
        # With a condition on both columns of the key, whose first column is the descriptor.
        self._connection.executemany(
            "DELETE FROM signatures WHERE descriptor IN (SELECT number FROM descriptors) AND shape = ?",
            chosen,
        )
        self._connection.executemany("DELETE FROM shapes WHERE number = ?", chosen)

    def _numbers(self, column: str, values: Collection[str]) -> list[int]:
        query = f"SELECT number FROM shapes WHERE {column} = ?"
        return [number for value in values for (number,) in self._all(query, (value,))]

    def _is_taken(self, shape_id: str) -> bool:
        return bool(self._numbers("id", [shape_id]))

    def _one(self, shape_id: str) -> Record:
        (record,) = self._where("id", [shape_id])
        return record

    def _where(self, column: str, values: Collection[str]) -> list[Record]:
        found = (record_of(row, self.location) for row in self._each(RECORDS, values, column))
        return sorted(found, key=lambda record: record.id)

    def _each(self, query: str, values: Collection[str], column: str = "id") -> Iterator[Any]:
        """Yield the result of a query for rows whose column has one of some values, a few at a time."""
        chosen = list(dict.fromkeys(values))
        for start in range(0, len(chosen), PARAMETERS):
            here = chosen[start : start + PARAMETERS]
            yield from self._all(f"{query} WHERE {column} IN ({', '.join('?' * len(here))})", here)

    def _all(self, query: str, values: Sequence[object] | Mapping[str, object] = ()) -> list[Any]:
        with translated(self._path):
            return self._connection.execute(query, values).fetchall()
