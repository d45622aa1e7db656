"""The rows of a catalogue: records, and bytes by name, in an SQLite file or a PostgreSQL database.

Each operation is one transaction: it is atomic, and isolated from operations of other processes.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from operator import lt
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.records import (
    OWN,
    PROVENANCE_COLUMNS,
    RECORDS,
    SHAPE_COLUMNS,
    Entry,
    Origin,
    Record,
    Status,
    checksum,
    free_id,
    record_of,
    row_of,
)
from pcretrieve.catalogue.sqlite import SqliteDatabase
from pcretrieve.catalogue.tables import PAYLOADS, Payload, check_version, damaged, inserting
from pcretrieve.errors import OptionError

if TYPE_CHECKING:
    from pcretrieve.catalogue.postgresql import PostgresqlDatabase

# Number of parameters of a query, of which SQLite allows 999 in early versions.
PARAMETERS = 500

SCHEME = re.compile(r"([a-z][a-z0-9+.-]*)://")


@dataclass(frozen=True, slots=True)
class Revision:
    """Names of a state of a catalogue. Two states have the same names only if they have the same shapes."""

    shapes: str
    labels: str

    def state(self) -> str:
        """A name of the state of the shapes and their labels."""
        return f"{self.shapes} {self.labels}"


@dataclass(frozen=True, slots=True, eq=False)
class Listed:
    """Signatures of all shapes that did not fail, in one state of the catalogue.

    ids: identifiers of the shapes, in ascending order.
    packed: (N, b) uint8, the bytes of each signature, in the order of the ids. The caller may overwrite the
        array.
    has: (N,) bool, whether a signature by these options is stored. The bytes of signatures that are not
        stored are zero.
    """

    revision: Revision
    ids: list[str]
    labels: list[str | None]
    packed: NDArray[np.uint8]
    has: NDArray[np.bool_]


def file_of(location: str | Path) -> Path | None:
    """The SQLite file at a location; None for a database."""
    scheme = SCHEME.match(location) if isinstance(location, str) else None
    if scheme is None or scheme[1] == "sqlite":
        return Path(str(location)[scheme.end() :] if scheme else location)
    if scheme[1] != "postgresql":
        raise OptionError(
            f"a catalogue must be a file, or a database at postgresql://user@host/database; got {scheme[0]}"
        )
    return None


class Rows:
    """The rows of a catalogue.

    settings: of a new catalogue: ``options``, as JSON, and ``numbers_version``.
    """

    def __init__(self, location: str | Path, settings: Mapping[str, str], *, create: bool) -> None:
        path = file_of(location)
        self.database: SqliteDatabase | PostgresqlDatabase
        if path is not None:
            self.database = SqliteDatabase(path, settings, create=create)
        else:
            from pcretrieve.catalogue.postgresql import PostgresqlDatabase

            self.database = PostgresqlDatabase(str(location), settings, create=create)
        #: The path of a file, or a URL without a password, as messages name the catalogue.
        self.location = self.database.location
        try:
            check_version(self.location, self.settings())
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Release the database."""
        self.database.close()

    # --- the catalogue ----------------------------------------------------------------------------------

    def settings(self) -> dict[str, str]:
        """The settings with which the catalogue was created, its version and the names of its state."""
        return dict(self._all("SELECT key, value FROM meta"))

    def revision(self) -> Revision:
        """The present state of the catalogue."""
        settings = self.settings()
        try:
            return Revision(settings["revision"], settings["label_revision"])
        except KeyError as error:
            raise damaged(self.location, f"it has no {error.args[0]}") from error

    def count(self, status: Status) -> int:
        """The number of shapes with a status."""
        return int(self._all("SELECT count(*) FROM shapes WHERE status = ?", [status])[0][0])

    def failures(self) -> dict[tuple[str, str], int]:
        """The number of failed shapes by stage and kind of error."""
        query = "SELECT stage, error, count(*) FROM shapes WHERE status = 'failed' GROUP BY stage, error"
        return {(stage, error): number for stage, error, number in self._all(query)}

    def areas(self) -> dict[float | None, tuple[float, float]]:
        """The smallest and the largest area of the shapes that did not fail, by `Record.metres_per_unit`."""
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
        """Some records in ascending order of id."""
        values: list[object] = [after, *([status] if status else []), limit, offset]
        chosen = "AND status = ? " if status else ""
        # In the words of the index.
        chosen += "AND judgement <> 'sound' " if doubtful else ""
        rows = self._all(f"{RECORDS} WHERE id > ? {chosen} ORDER BY id LIMIT ? OFFSET ?", values)
        return [record_of(row, self.location) for row in rows]

    def by(self, column: str, values: Collection[str]) -> list[Record]:
        """The records with some ids, paths or content hashes, in ascending order of id."""
        found = (record_of(row, self.location) for row in self._each(RECORDS, column, values))
        return sorted(found, key=lambda record: record.id)

    def origins(self) -> list[Origin]:
        """The origins of all shapes, including failed ones, in ascending order of id."""
        rows = self._all("SELECT id, path, content_hash, label, status, stamp FROM shapes ORDER BY id")
        return [Origin(*row) for row in rows]

    def times(self) -> dict[str, str]:
        """When each shape, or its failure, was stored, by id."""
        return dict(self._all("SELECT id, added FROM shapes JOIN provenance ON shape = number"))

    def labelled(self, labels: Collection[str]) -> list[str]:
        """The ids of the shapes of some classes that did not fail, in ascending order."""
        query = f"SELECT id, status FROM shapes{self.database.dialect.scanned}"
        return sorted(one for one, status in self._each(query, "label", labels) if status == "done")

    def numbers(self) -> list[int]:
        """The numbers of all shapes, in ascending order of id."""
        return [number for (number,) in self._all("SELECT number FROM shapes ORDER BY id")]

    # --- everything of a shape --------------------------------------------------------------------------

    def entries(self, ids: Collection[str] | Collection[int], column: str = "id") -> list[Entry]:
        """Everything that is stored of shapes of some ids or numbers, in ascending order of id."""
        signatures: dict[int, dict[str, bytes]] = {}
        payloads: dict[int, dict[Payload, bytes]] = {}
        with self.database.reading():
            records = {row[0]: record_of(row, self.location) for row in self._each(RECORDS, column, ids)}
            known = "digest IN (SELECT digest FROM descriptors)"
            query = f"SELECT shape, digest, value FROM signatures WHERE {known} AND"
            for number, digest, value in self._each(query, "shape", records):
                signatures.setdefault(number, {})[digest] = value
            query = f"SELECT shape, {_listed(PAYLOADS)} FROM arrays"
            for number, *arrays in self._each(query, "shape", records):
                payloads[number] = _present(PAYLOADS, arrays)
        entries = (
            Entry(record, signatures.get(number, {}), payloads.get(number, {}))
            for number, record in records.items()
        )
        return sorted(entries, key=lambda entry: entry.record.id)

    def read(self, shape_id: str, names: Collection[Payload]) -> tuple[Record, dict[Payload, bytes]] | None:
        """A record, and those of some payloads that are stored; None if there is no shape of this id."""
        with self.database.reading():
            for row in self._each(RECORDS, "id", [shape_id]):
                query = f"SELECT {_listed(names)} FROM arrays WHERE shape = ?"
                arrays = next(iter(self._all(query, row[:1])), ())
                return record_of(row, self.location), _present(names, arrays)
        return None

    def sizes(self, shape_id: str) -> dict[str, int]:
        """The number of bytes of each payload of a shape, of its ``signatures``, and of its ``record``."""
        sizes = dict.fromkeys(("record", "signatures", *PAYLOADS), 0)
        for entry in self.entries([shape_id]):
            texts = (str(value) for value in row_of(entry.record).values() if value is not None)
            sizes["record"] = sum(len(text.encode()) for text in texts)
            sizes["signatures"] = sum(map(len, entry.signatures.values()))
            sizes |= {name: len(arrays) for name, arrays in entry.payloads.items()}
        return sizes

    def put(self, record: Record, signature: bytes | None, payloads: Mapping[Payload, bytes]) -> Record:
        """Store a shape by its path, and replace an earlier shape of this path.

        A path that the catalogue has keeps its id; an id that belongs to another path is replaced by one with
        the next free number. A failure never replaces a finished shape.
        """
        with self.database.writing():
            earlier = self._all("SELECT id, status FROM shapes WHERE path = ?", [record.path])
            shape_id, status = earlier[0] if earlier else (free_id(record, self._is_taken), None)
            if not (status == "done" and record.status == "failed"):
                signatures = {} if signature is None else {OWN: signature}
                self._store([Entry(replace(record, id=shape_id), signatures, payloads)])
                if "done" in (status, record.status):
                    self._changed("revision")
            return self.by("id", [shape_id])[0]

    def add(self, entries: Collection[Entry]) -> None:
        """Store shapes as they are, and replace earlier shapes of the same paths."""
        with self.database.writing():
            self._store(entries)
            self._changed("revision")

    def remove(self, ids: Collection[str] | Collection[int], column: str = "id") -> None:
        """Remove shapes of some ids or numbers; others are ignored."""
        with self.database.writing():
            self._forget(column, ids)
            self._changed("revision")
        self.database.shrink()

    def revise(
        self,
        *,
        moved: Mapping[str, str] | None = None,
        removed: Collection[str] = (),
        labels: Mapping[str, str] | None = None,
        stamps: Mapping[str, str] | None = None,
    ) -> None:
        """Rename, remove, label and stamp shapes by path, in this order; unknown paths are ignored."""
        with self.database.writing():
            if moved:
                self._rewrite("path", moved)
            if removed:
                self._forget("path", removed)
                self._changed("revision")
            if labels:
                self._rewrite("label", labels)
                self._changed("label_revision")
            if stamps:
                values = ((stamp, path) for path, stamp in stamps.items())
                self.database.each("UPDATE shapes SET stamp = ? WHERE path = ?", values)

    # --- signatures and pictures ------------------------------------------------------------------------

    def signatures(self, digest: str) -> Listed:
        """The signatures that are stored under a digest; `OWN` for the signatures given to `put`."""
        numbers: list[int] = []
        ids: list[str] = []
        labels: list[str | None] = []
        known: dict[str | None, str | None] = {}
        # A scan of the table is faster than the index of the status, by which each shape is looked up.
        query = (
            f"SELECT number, id, label FROM shapes{self.database.dialect.scanned} WHERE status = 'done' "
            "ORDER BY number"
        )
        with self.database.reading():
            revision = self.revision()
            for number, shape_id, label in self.database.columns(query):
                numbers += number
                ids += shape_id
                labels += map(known.setdefault, label, label)
            by_id = np.arange(len(ids))
            if not all(map(lt, ids, islice(ids, 1, None))):
                by_id = np.array(sorted(by_id.tolist(), key=ids.__getitem__), np.intp)
                ids, labels = [ids[row] for row in by_id], [labels[row] for row in by_id]
            packed, has = self._packed(digest, np.array(numbers, np.int64), np.argsort(by_id))
        return Listed(revision, ids, labels, packed, has)

    def keep(self, digest: str, signatures: Collection[tuple[Record, bytes]]) -> None:
        """Store signatures, except of shapes that have been replaced or removed since they were read.

        signatures: the record of each shape, and the bytes of its signature. A shape has been replaced if
            the content hash of its record has changed.
        """
        with self.database.writing():
            self._add_descriptors([digest])
            self.database.each(
                "INSERT INTO signatures SELECT ?, number, ? FROM shapes "
                "WHERE id = ? AND content_hash = ? AND status = 'done' "
                "ON CONFLICT (digest, shape) DO UPDATE SET value = excluded.value",
                ((digest, value, record.id, record.content_hash) for record, value in signatures),
            )

    def keep_payload(self, name: Payload, record: Record, arrays: bytes) -> None:
        """Store a payload of a shape, unless the shape has been replaced or removed since it was read."""
        with self.database.writing():
            self.database.execute(
                f"UPDATE arrays SET {_listed([name])} = ? WHERE shape = "
                "(SELECT number FROM shapes WHERE id = ? AND content_hash = ? AND status = 'done')",
                [arrays, record.id, record.content_hash],
            )

    # --- inside -----------------------------------------------------------------------------------------

    def _changed(self, revision: str) -> None:
        """Give the new state a name that no earlier state had, not even before a copy was restored."""
        self.database.execute("UPDATE meta SET value = ? WHERE key = ?", [uuid4().hex, revision])

    def _store(self, entries: Collection[Entry]) -> None:
        """Insert shapes, each instead of the shape of its path, if there is one."""
        self._forget("path", [entry.record.path for entry in entries])
        ((last,),) = self._all("SELECT coalesce(max(number), 0) FROM shapes")
        numbered = list(enumerate(entries, last + 1))
        rows = [(number, row_of(entry.record)) for number, entry in numbered]
        signatures = [(d, number, value) for number, one in numbered for d, value in one.signatures.items()]
        self._add_descriptors({digest for digest, _, _ in signatures})
        for table, stored in (
            ("shapes", [(number, *map(row.__getitem__, SHAPE_COLUMNS)) for number, row in rows]),
            ("provenance", [(number, *map(row.__getitem__, PROVENANCE_COLUMNS)) for number, row in rows]),
            ("signatures", signatures),
            ("arrays", [(n, *map(one.payloads.get, PAYLOADS)) for n, one in numbered if one.payloads]),
        ):
            if stored:
                self.database.each(inserting(table), stored)

    def _forget(self, column: str, values: Collection[str] | Collection[int]) -> None:
        chosen = list(self._each("SELECT number FROM shapes", column, values))
        if chosen:
            for name in ("provenance", "arrays"):
                self.database.each(f"DELETE FROM {name} WHERE shape = ?", chosen)
            # With a condition on both columns of the key, whose first column is the digest.
            self.database.each(
                "DELETE FROM signatures WHERE digest IN (SELECT digest FROM descriptors) AND shape = ?",
                chosen,
            )
            self.database.each("DELETE FROM shapes WHERE number = ?", chosen)

    def _rewrite(self, name: str, values: Mapping[str, str]) -> None:
        """Change the path or the label of shapes by path; a path that another shape has is not given."""
        rows = {record.path: row_of(record) for record in self.by("path", values)}
        sums = {path: checksum(rows[path] | {name: values[path]}) for path in values if path in rows}
        changes = [(values[path], total, path) for path, total in sums.items()]
        statement = f"UPDATE shapes SET {name} = ?, checksum = ? WHERE path = ?"
        if name == "path":
            taken = "SELECT 1 FROM shapes WHERE path = ?"
            self.database.each(f"{statement} AND NOT EXISTS ({taken})", [(*one, one[0]) for one in changes])
        else:
            self.database.each(statement, changes)

    def _add_descriptors(self, digests: Iterable[str]) -> None:
        self.database.each(f"{inserting('descriptors')} ON CONFLICT DO NOTHING", [(one,) for one in digests])

    def _packed(
        self, digest: str, numbers: NDArray[np.int64], rows: NDArray[np.intp]
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """The signatures of shapes with ascending numbers, one in each row, and which of them exist."""
        has = np.zeros(len(numbers), np.bool_)
        packed = np.zeros((len(numbers), 0), np.uint8)
        query = "SELECT shape, value FROM signatures WHERE digest = ? ORDER BY shape"
        for shapes, values in self.database.columns(query, [digest]):
            if len({*map(len, values)}) > 1 or packed.shape[1] not in (0, len(values[0])):
                raise damaged(self.location, "signatures by the same options have several lengths")
            if not packed.shape[1]:
                packed = np.zeros((len(numbers), len(values[0])), np.uint8)
            at = np.searchsorted(numbers, shapes)
            if not len(numbers) or (numbers.take(at, mode="clip") != shapes).any():
                raise damaged(self.location, "it has signatures of no shape")
            here = rows[at]
            packed[here] = np.frombuffer(b"".join(values), np.uint8).reshape(len(values), -1)
            has[here] = True
        return packed, has

    def _is_taken(self, shape_id: str) -> bool:
        return bool(self._all("SELECT 1 FROM shapes WHERE id = ?", [shape_id]))

    def _each(self, query: str, column: str, values: Iterable[object]) -> Iterator[Any]:
        """Yield the result of a query for rows whose column has one of some values, a few at a time."""
        chosen = list(dict.fromkeys(values))
        word = "" if query.endswith("AND") else "WHERE"
        for start in range(0, len(chosen), PARAMETERS):
            here = chosen[start : start + PARAMETERS]
            yield from self._all(f"{query} {word} {column} IN ({', '.join('?' * len(here))})", here)

    def _all(self, query: str, values: Collection[object] = ()) -> list[Any]:
        return self.database.execute(query, list(values))


def _listed(names: Iterable[Payload]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def _present(names: Iterable[Payload], arrays: Iterable[bytes | None]) -> dict[Payload, bytes]:
    """Those of some payloads that are stored."""
    return {name: stored for name, stored in zip(names, arrays, strict=False) if stored is not None}
