"""The rows of a catalogue: records, and bytes by name, in an SQLite file or a PostgreSQL database.

Each operation is one transaction: it is atomic, and isolated from operations of other processes. One that is
cut because a database went away is run again from its start.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from operator import lt
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.arrays import intact, packed, unpacked
from pcretrieve.catalogue.records import (
    PAYLOADS,
    PROVENANCE_COLUMNS,
    RECORDS,
    SHAPE_COLUMNS,
    Entry,
    Payload,
    Record,
    UnknownShape,
    check_version,
    checksum,
    damaged,
    free_id,
    inserting,
    record_of,
    repeated,
    row_of,
)
from pcretrieve.catalogue.sqlite import SqliteDatabase
from pcretrieve.errors import CatalogueError, OptionError, did_you_mean
from pcretrieve.values import FloatArray
from pcretrieve.values.base import check_type

if TYPE_CHECKING:
    from typing_extensions import Self

    from pcretrieve.catalogue.postgresql import PostgresqlDatabase

# Number of parameters of a query, of which SQLite allows 999 in early versions.
PARAMETERS = 500

# Number of records that are read at a time.
PAGE = 1000

# Number of ids that are compared with an unknown one, which takes less than 0.1 s.
N_COMPARED = 2000

SCHEME = re.compile(r"([a-z][a-z0-9+.-]*)://")


# Conditions of the states of shapes, in the words of the indexes.
STATES = {
    "": "1 = 1",
    "done": "status = 'done'",
    "failed": "status = 'failed'",
    "incomplete": "grade <> 'good'",
}


# Columns by which shapes are sorted, before their ids. From the largest error on, failed scans are the first,
# and scans whose error is not known the last.
ORDERS = {
    "id": (),
    "label": ("label IS NULL", "label"),
    "added": ("added",),
    "error": ("status = 'failed'", "expected_error IS NOT NULL", "expected_error"),
}


class Listed(NamedTuple):
    """The shapes that did not fail, in ascending order of id, in one state of the catalogue.

    has: (N,) bool, whether a signature is stored.
    packed: the bytes of the stored signatures, one after the other, which the caller may overwrite.
    """

    revision: str
    ids: list[str]
    labels: list[str | None]
    has: NDArray[np.bool_]
    packed: bytearray


def file_of(location: str | Path) -> Path | None:
    """The SQLite file at a location; None for a database."""
    check_type("a catalogue", location, str, Path)
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

    def __init__(
        self, location: str | Path, settings: Mapping[str, str], *, create: bool
    ) -> None:
        path = file_of(location)
        self.database: SqliteDatabase | PostgresqlDatabase
        if path is not None:
            self.database = SqliteDatabase(path, settings, create=create)
        else:
            from pcretrieve.catalogue.postgresql import PostgresqlDatabase

            self.database = PostgresqlDatabase(str(location), settings, create=create)
        #: The path of a file, or a URL without a password, as messages name the catalogue.
        self.location: str = self.database.location
        try:
            check_version(self.location, self.settings())
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file or the connection."""
        self.database.close()

    def answer_at_once(self) -> None:
        """Raise an error where a database is away, as a server must, instead of trying again."""
        if not isinstance(self.database, SqliteDatabase):
            self.database.patience = 0.0

    def settings(self) -> dict[str, str]:
        """The settings with which the catalogue was created, its version and the name of its state."""
        return dict(self._all("SELECT key, value FROM meta"))

    def keep_setting(self, key: str, value: str | None) -> None:
        """Store a setting, or remove it; within a transaction."""
        self.database.execute("DELETE FROM meta WHERE key = ?", [key])
        if value is not None:
            self.database.execute(inserting("meta"), [key, value])

    def revision(self) -> str:
        """A name of the state of the shapes and their labels, which no other state has."""
        for (revision,) in self._all("SELECT value FROM meta WHERE key = 'revision'"):
            return str(revision)
        raise damaged(self.location, "it has no revision")

    def state(self) -> str:
        """A name of all that this connection sees now; any change gives it another, also of a failure.

        Names of two connections cannot be compared.
        """
        return self.database.state()

    # --- records ----------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return int(self._all("SELECT count(*) FROM shapes WHERE status = 'done'")[0][0])

    def pages(self, shape_ids: Sequence[str]) -> Iterator[list[Record]]:
        """The records of some ids, in their order, in pages that are read one by one; no unknown ids."""
        for start in range(0, len(shape_ids), PAGE):
            here = shape_ids[start : start + PAGE]
            found = {record.id: record for record in self.several(here)}
            yield [found[shape_id] for shape_id in here if shape_id in found]

    def origins(self) -> list[Record]:
        """All records without their provenance, in ascending order of id, which are read much faster."""
        names = ("id", "path", "content_hash", "label", "status", "stamp", "mark", "note")
        rows = self._all(f"SELECT {', '.join(names)} FROM shapes ORDER BY id")
        return [Record(**dict(zip(names, row, strict=True))) for row in rows]

    def labels(self) -> dict[str, str | None]:
        """The class of each shape, including failed ones, by id in ascending order."""
        return dict(self._all("SELECT id, label FROM shapes ORDER BY id"))

    def classes(self, most: int) -> dict[str, int]:
        """The sizes of some classes, in no order: of all, if they are at most so many."""
        query = "SELECT label, count(*) FROM shapes WHERE label IS NOT NULL GROUP BY label LIMIT ?"
        return dict(self._all(query, [most]))

    def wanted(
        self,
        *,
        label: str = "",
        state: Literal["", "done", "incomplete", "failed"] = "",
        marked: str = "",
        days: tuple[str, str] | None = None,
        order: Literal["id", "label", "added", "error"] = "id",
        descending: bool = False,
        limit: int | None = None,
        offset: int = 0,
    ) -> tuple[int, list[str]]:
        """The number of the shapes that are wanted, and the ids of those at some places of their order.

        label: their class; any if it is empty.
        state: any, failed ones too, if it is empty.
        marked: what was decided about them, or "any"; nothing too, if it is empty.
        days: the first and the last day on which they were stored, as 2026-01-31; UTC.
        descending: whether the order is reversed; if it is not, shapes of no class are the last.
        """
        tables, conditions, values = "shapes", [STATES[state]], list[object]()
        if label:
            conditions.append("label = ?")
            values.append(label)
        if marked == "any":
            conditions.append("mark IS NOT NULL")
        elif marked:
            conditions.append("mark = ?")
            values.append(marked)
        if days is not None or order == "added":
            tables += " LEFT JOIN provenance ON shape = number"
        if days is not None:
            conditions.append("substr(added, 1, 10) BETWEEN ? AND ?")
            values += days
        columns = [*ORDERS[order], "id"]
        direction = "DESC" if descending else "ASC"
        by = ", ".join(f"{column} {direction}" for column in columns)
        chosen = f"FROM {tables} WHERE {' AND '.join(conditions)}"
        # The database counts and sorts, because rows that Python reads are slow where threads wait for
        # each other: SQLite gives up the lock of the interpreter for each row.
        with self.database.reading():
            ((total,),) = self._all(f"SELECT count(*) {chosen}", values)
            here = [*values, total if limit is None else limit, offset]
            rows = self._all(f"SELECT id {chosen} ORDER BY {by} LIMIT ? OFFSET ?", here)
        return total, [shape_id for (shape_id,) in rows]

    def several(self, shape_ids: Collection[str]) -> list[Record]:
        """The records of some ids, in ascending order of id; unknown ids are ignored."""
        return self._records("id", shape_ids)

    def record(self, shape_id: str) -> Record:
        """The record of a shape; InputError if there is no shape of this id."""
        for record in self.several([shape_id]):
            return record
        raise self.unknown(shape_id)

    def unknown(self, shape_id: str) -> UnknownShape:
        """The error for an id that the catalogue does not have."""
        return UnknownShape(
            f"{self.location} holds no shape {shape_id!r}; `pcretrieve list` names them"
            f"{self.suggested(shape_id)}"
        )

    def suggested(self, shape_id: str) -> str:
        """The question whether the id of another shape was meant; empty if no id is similar."""
        first = self._all("SELECT id FROM shapes ORDER BY id LIMIT ?", [N_COMPARED])
        return did_you_mean(shape_id, (known for (known,) in first))

    def labelled(self, labels: Collection[str]) -> list[str]:
        """The ids of the shapes of some classes that did not fail, in ascending order."""
        query = f"SELECT id, status FROM shapes{self.database.scanned}"
        return sorted(
            one for one, status in self._each(query, "label", labels) if status == "done"
        )

    def with_content(self, content_hash: str) -> list[Record]:
        """The records of files with this content, including failed ones, in ascending order of id."""
        return self._records("content_hash", [content_hash])

    def failures(self) -> dict[tuple[str, str], int]:
        """The number of failed shapes by stage and kind of error: `Record.stage` and `Record.error`."""
        query = "SELECT stage, error, count(*) FROM shapes WHERE status = 'failed' GROUP BY stage, error"
        return {(stage, error): number for stage, error, number in self._all(query)}

    def units(self) -> set[float | None]:
        """The units of the shapes that did not fail: `Record.metres_per_unit`."""
        query = "SELECT DISTINCT metres_per_unit FROM shapes WHERE status = 'done'"
        return {unit for (unit,) in self._all(query)}

    def areas(self) -> list[float]:
        """The areas of the first shapes that did not fail."""
        query = "SELECT area FROM shapes WHERE status = 'done' ORDER BY id LIMIT ?"
        return [area for (area,) in self._all(query, [N_COMPARED])]

    # --- everything of a shape --------------------------------------------------------------------------

    @repeated
    def entries(
        self,
        ids: Collection[str] | Collection[int],
        column: str = "id",
        payloads: Collection[Payload] = PAYLOADS,
    ) -> list[Entry]:
        """What is stored of shapes of some ids or numbers, with some payloads, in ascending order of id."""
        signatures: dict[int, dict[str, bytes]] = {}
        arrays: dict[int, dict[Payload, bytes]] = {}
        with self.database.reading():
            records = {
                row[0]: record_of(row, self.location)
                for row in self._each(RECORDS, column, ids)
            }
            known = "digest IN (SELECT digest FROM descriptors)"
            query = f"SELECT shape, digest, value FROM signatures WHERE {known} AND"
            for number, digest, value in self._each(query, "shape", records):
                signatures.setdefault(number, {})[digest] = value
            if payloads:
                names = ", ".join(f'"{name}"' for name in payloads)
                query = f"SELECT shape, {names} FROM arrays"
                for number, *stored in self._each(query, "shape", records):
                    given = zip(payloads, stored, strict=True)
                    arrays[number] = {
                        name: value for name, value in given if value is not None
                    }
        entries = (
            Entry(record, signatures.get(number, {}), arrays.get(number, {}))
            for number, record in records.items()
        )
        return sorted(entries, key=lambda entry: entry.record.id)

    def entry(self, shape_id: str, payloads: Collection[Payload] = PAYLOADS) -> Entry:
        """What is stored of one shape, with some payloads; InputError if there is no shape of this id."""
        for entry in self.entries([shape_id], payloads=payloads):
            return entry
        raise self.unknown(shape_id)

    def stored_bytes(self, shape_id: str) -> dict[str, int]:
        """The sizes in bytes of a shape's record, signatures and arrays; InputError if there is no shape."""
        entry = self.entry(shape_id)
        texts = (
            str(value) for value in row_of(entry.record).values() if value is not None
        )
        sizes = dict.fromkeys(("record", "signatures", *PAYLOADS), 0)
        sizes["record"] = sum(len(text.encode()) for text in texts)
        sizes["signatures"] = sum(map(len, entry.signatures.values()))
        return sizes | {name: len(arrays) for name, arrays in entry.payloads.items()}

    @repeated
    def store(self, entry: Entry) -> Record:
        """Store a shape by its path; the record that the catalogue then has for this path.

        An earlier shape of the path is replaced, and its id kept. An id that belongs to another path, which
        another process may have stored since the record was made, is replaced by one with the next free
        number. A failure never replaces a finished shape. A mark stays as long as the content of the file.
        """
        record = entry.record

        def is_taken(shape_id: str) -> bool:
            return bool(self._all("SELECT 1 FROM shapes WHERE id = ?", [shape_id]))

        with self.database.writing():
            query = (
                "SELECT id, status, content_hash, mark, note FROM shapes WHERE path = ?"
            )
            rows = self._all(query, [record.path])
            nothing = free_id(record, is_taken), None, None, None, None
            shape_id, status, content_hash, mark, note = rows[0] if rows else nothing
            if record.mark is None and content_hash == record.content_hash:
                record = replace(record, mark=mark, note=note)
            if not (status == "done" and record.status == "failed"):
                self._insert([replace(entry, record=replace(record, id=shape_id))])
                if "done" in (status, record.status):
                    self._changed()
            return self.record(shape_id)

    @repeated
    def add(self, entries: Collection[Entry]) -> None:
        """Store shapes as they are, and replace earlier shapes of the same paths."""
        with self.database.writing():
            self._insert(entries)
            self._changed()

    @repeated
    def remove(self, *shape_ids: str) -> None:
        """Remove shapes, and their bytes; InputError, without a change, if one of the ids does not exist."""
        with self.database.writing():
            known = {
                one for (one,) in self._each("SELECT id FROM shapes", "id", shape_ids)
            }
            for shape_id in shape_ids:
                if shape_id not in known:
                    raise self.unknown(shape_id)
            self._delete("id", shape_ids)
            self._changed()
        self.database.scrub()

    @repeated
    def mark(
        self, shape_ids: Collection[str], mark: str | None, note: str | None
    ) -> None:
        """Store what was decided; InputError, without a change, if one of the ids does not exist."""
        with self.database.writing():
            records = {record.id: record for record in self.several(shape_ids)}
            for shape_id in shape_ids:
                if shape_id not in records:
                    raise self.unknown(shape_id)
            rows = [
                row_of(replace(record, mark=mark, note=note))
                for record in records.values()
            ]
            self.database.each(
                "UPDATE shapes SET mark = ?, note = ?, checksum = ? WHERE id = ?",
                [(mark, note, row["checksum"], row["id"]) for row in rows],
            )

    @repeated
    def forget(self, column: str, value: str | int) -> None:
        """Remove the shape with a value in a column, such as its number; its record need not be readable."""
        with self.database.writing():
            self._delete(column, [value])
            self._changed()

    @repeated
    def revise(
        self,
        *,
        moved: Mapping[str, str] | None = None,
        removed: Collection[str] = (),
        labels: Mapping[str, str] | None = None,
        stamps: Mapping[str, str] | None = None,
    ) -> None:
        """Rename shapes (new path by old), remove, label and stamp them by new path, in one transaction.

        Unknown paths are ignored, because another process may have renamed or removed the same shapes; and a
        shape is not renamed to a path that the catalogue has already.
        """
        with self.database.writing():
            self._rewrite("path", moved or {})
            self._delete("path", removed)
            self._rewrite("label", labels or {})
            if removed or labels:
                self._changed()
            values = ((stamp, path) for path, stamp in (stamps or {}).items())
            self.database.each("UPDATE shapes SET stamp = ? WHERE path = ?", values)

    # --- signatures -------------------------------------------------------------------------------------

    @repeated
    def listed(self, digest: str) -> Listed:
        """The signatures that are stored under a digest; `OWN` for those by the options of the catalogue."""
        ids: list[str] = []
        labels: list[str | None] = []
        known: dict[str | None, str | None] = {}
        stored: list[bool] = []
        packed = bytearray()
        # In the order in which both tables are stored. A scan of the table is faster than the index of the
        # status, by which each shape is looked up.
        query = (
            f"SELECT id, label, value FROM shapes{self.database.scanned} "
            "LEFT JOIN signatures ON digest = ? AND shape = number WHERE status = 'done' ORDER BY number"
        )
        with self.database.reading():
            revision = self.revision()
            for shape_ids, classes, values in self.database.columns(query, [digest]):
                ids += shape_ids
                labels += map(known.setdefault, classes, classes)
                stored += [value is not None for value in values]
                packed += b"".join(filter(None, values))
        has = np.array(stored, np.bool_)
        if not all(map(lt, ids, islice(ids, 1, None))):
            by_id = sorted(range(len(ids)), key=ids.__getitem__)
            ids, labels = [ids[row] for row in by_id], [labels[row] for row in by_id]
            place = np.cumsum(has) - 1
            has = has[by_id]
            if packed:
                rows = np.frombuffer(packed, np.uint8).reshape(np.count_nonzero(has), -1)
                packed = bytearray(rows[place[by_id][has]].data)
        return Listed(revision, ids, labels, has, packed)

    @repeated
    def keep(self, digest: str, signatures: Collection[tuple[Record, bytes]]) -> None:
        """Store signatures, except of shapes that are gone, or have another content hash."""
        with self.database.writing():
            self._add_descriptors([digest])
            self.database.each(
                "INSERT INTO signatures SELECT ?, number, ? FROM shapes "
                "WHERE id = ? AND content_hash = ? AND status = 'done' "
                "ON CONFLICT (digest, shape) DO UPDATE SET value = excluded.value",
                (
                    (digest, value, record.id, record.content_hash)
                    for record, value in signatures
                ),
            )

    # --- pictures ---------------------------------------------------------------------------------------

    def direction_upwards(self, shape_id: str) -> FloatArray | None:
        """(3,) the direction upwards in the picture of a shape, in the frame of its file."""
        stored = self.entry(shape_id, ["up"]).payloads.get("up")
        with intact(self.location, f"the thumbnail of {shape_id!r}"):
            return (
                None if stored is None else np.asarray(unpacked(stored, 1)[0], np.float64)
            )

    def keep_thumbnail(self, record: Record, picture: bytes, up: FloatArray) -> bool:
        """Store the picture of a shape, and what is up in it, unless the shape has been replaced meanwhile.

        Returns whether it could be written. No error is raised, because a picture can be drawn again.
        """
        if not self.database.is_writable:
            return False
        drawn = packed([up]), packed([np.frombuffer(picture, np.uint8)])
        try:
            with self.database.writing():
                self.database.execute(
                    "UPDATE arrays SET up = ?, thumbnails = ? WHERE shape = "
                    "(SELECT number FROM shapes WHERE id = ? AND content_hash = ? AND status = 'done')",
                    [*drawn, record.id, record.content_hash],
                )
        except CatalogueError:  # another process has locked it, or the disk is full
            return False
        return True

    @repeated
    def keep_up(self, axis: str | None) -> None:
        """Store which axis, such as ``-y``, points upwards; with None, pictures are drawn again without."""
        if not self.database.is_writable:
            return
        with self.database.writing():
            self.keep_setting("up", axis)
            if axis is None:
                self.database.execute(
                    "UPDATE arrays SET up = NULL, thumbnails = NULL WHERE meshes IS NOT NULL"
                )

    # --- inside -----------------------------------------------------------------------------------------

    def _records(self, column: str, values: Collection[str]) -> list[Record]:
        """The records with some ids, paths or content hashes, in ascending order of id."""
        found = (
            record_of(row, self.location) for row in self._each(RECORDS, column, values)
        )
        return sorted(found, key=lambda record: record.id)

    def _changed(self) -> None:
        """Give the new state a name that no earlier state had, not even before a copy was restored."""
        self.database.execute(
            "UPDATE meta SET value = ? WHERE key = 'revision'", [uuid4().hex]
        )

    def _insert(self, entries: Collection[Entry]) -> None:
        """Insert shapes, each instead of the shape of its path, if there is one."""
        self._delete("path", [entry.record.path for entry in entries])
        ((last,),) = self._all("SELECT coalesce(max(number), 0) FROM shapes")
        numbered = list(enumerate(entries, last + 1))
        rows = [(number, row_of(entry.record)) for number, entry in numbered]
        signatures = [
            (d, number, value)
            for number, one in numbered
            for d, value in one.signatures.items()
        ]
        self._add_descriptors({digest for digest, _, _ in signatures})
        for table, stored in (
            (
                "shapes",
                [(number, *map(row.__getitem__, SHAPE_COLUMNS)) for number, row in rows],
            ),
            (
                "provenance",
                [
                    (number, *map(row.__getitem__, PROVENANCE_COLUMNS))
                    for number, row in rows
                ],
            ),
            ("signatures", signatures),
            (
                "arrays",
                [
                    (n, *map(one.payloads.get, PAYLOADS))
                    for n, one in numbered
                    if one.payloads
                ],
            ),
        ):
            if stored:
                self.database.each(inserting(table), stored)

    def _delete(self, column: str, values: Collection[object]) -> None:
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
        rows = {record.path: row_of(record) for record in self._records("path", values)}
        sums = {
            path: checksum(rows[path] | {name: values[path]})
            for path in values
            if path in rows
        }
        changes = [(values[path], total, path) for path, total in sums.items()]
        statement = f"UPDATE shapes SET {name} = ?, checksum = ? WHERE path = ?"
        if name == "path":
            taken = "SELECT 1 FROM shapes WHERE path = ?"
            self.database.each(
                f"{statement} AND NOT EXISTS ({taken})",
                [(*one, one[0]) for one in changes],
            )
        else:
            self.database.each(statement, changes)

    def _add_descriptors(self, digests: Iterable[str]) -> None:
        self.database.each(
            f"{inserting('descriptors')} ON CONFLICT DO NOTHING",
            [(one,) for one in digests],
        )

    def _each(self, query: str, column: str, values: Iterable[object]) -> Iterator[Any]:
        """Yield the result of a query for rows whose column has one of some values, a few at a time."""
        chosen = list(dict.fromkeys(values))
        word = "" if query.endswith("AND") else "WHERE"
        for start in range(0, len(chosen), PARAMETERS):
            here = chosen[start : start + PARAMETERS]
            yield from self._all(
                f"{query} {word} {column} IN ({', '.join('?' * len(here))})", here
            )

    def _all(self, query: str, values: Collection[object] = ()) -> list[Any]:
        return self.database.execute(query, list(values))
