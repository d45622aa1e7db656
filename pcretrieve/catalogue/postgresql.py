"""The store of catalogues that several computers write: a schema of a PostgreSQL database."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np

from pcretrieve.catalogue.checksums import checksum
from pcretrieve.catalogue.database import Database, Transaction
from pcretrieve.catalogue.defects import Defect
from pcretrieve.catalogue.opening import damaged
from pcretrieve.catalogue.postgresql_statements import any_of, has_path, inserting
from pcretrieve.catalogue.postgresql_tables import changed, orphans, prepare_tables, read_settings
from pcretrieve.catalogue.record import Record, free_id
from pcretrieve.catalogue.record_rows import (
    COLUMNS,
    PROVENANCE_COLUMNS,
    RECORDS,
    SHAPE_COLUMNS,
    record_of,
    row_of,
)
from pcretrieve.catalogue.rows import OWN, PAYLOADS, Entry, Listed, Origin, Payload, Revision, Rows, Status

__all__ = ["PostgresqlRows"]

# Number of signatures that are read at a time.
READ_AT_ONCE = 1000

# Locks the row that a process has locked while it writes.
LOCK = "SELECT value FROM meta WHERE key = 'revision' FOR UPDATE"

LENGTH = " + ".join(f"coalesce(octet_length(CAST({name} AS text)), 0)" for name in COLUMNS)


class PostgresqlRows(Rows):
    """Rows in a schema of a PostgreSQL database. The methods are documented in `Rows`."""

    def __init__(self, location: str, settings: Mapping[str, str], *, create: bool) -> None:
        self._database = Database(location)
        try:
            prepare_tables(self._database, settings, create=create)
        except BaseException:
            self._database.close()
            raise

    def close(self) -> None:
        self._database.close()

    # --- the store --------------------------------------------------------------------------------------

    @property
    def location(self) -> str:
        return self._database.location

    @property
    def folder(self) -> None:
        return None

    @property
    def is_writable(self) -> bool:
        query = (
            "SELECT has_table_privilege('shapes', 'INSERT, UPDATE, DELETE') AND NOT pg_is_in_recovery() "
            "AND current_setting('transaction_read_only') = 'off'"
        )
        with self._database.reading() as reading:
            return bool(reading.all(query)[0][0])

    def defects(self, *, repair: bool) -> list[Defect]:
        with self._writing() if repair else self._database.reading() as transaction:
            return orphans(transaction, repair=repair)

    def settings(self) -> Mapping[str, str]:
        with self._database.reading() as reading:
            return read_settings(reading)

    def revision(self) -> Revision:
        with self._database.reading() as reading:
            return self._revision(reading)

    def count(self, status: Status) -> int:
        with self._database.reading() as reading:
            rows = reading.all("SELECT count(*) FROM shapes WHERE status = :status", status=status)
            return int(rows[0][0])

    def failures(self) -> dict[tuple[str, str], int]:
        query = "SELECT stage, error, count(*) FROM shapes WHERE status = 'failed' GROUP BY 1, 2"
        with self._database.reading() as reading:
            return {(stage, error): int(number) for stage, error, number in reading.all(query)}

    def areas(self) -> dict[float | None, tuple[float, float]]:
        query = "SELECT metres_per_unit, min(area), max(area) FROM shapes WHERE status = 'done' GROUP BY 1"
        with self._database.reading() as reading:
            return {unit: (smallest, largest) for unit, smallest, largest in reading.all(query)}

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
        chosen = "id > :after"
        chosen += "" if status is None else " AND status = :status"
        chosen += " AND judgement <> 'sound'" if doubtful else ""
        values = {"after": after, "limit": limit, "offset": offset}
        values |= {} if status is None else {"status": status}
        with self._database.reading() as reading:
            return self._records(reading, f"{chosen} ORDER BY id LIMIT :limit OFFSET :offset", **values)

    def by_id(self, shape_ids: Collection[str]) -> list[Record]:
        with self._database.reading() as reading:
            return self._records(reading, f"{any_of('id')} ORDER BY id", values=list(shape_ids))

    def by_content(self, hashes: Collection[str]) -> list[Record]:
        with self._database.reading() as reading:
            return self._records(reading, f"{any_of('content_hash')} ORDER BY id", values=list(hashes))

    def origins(self) -> list[Origin]:
        with self._database.reading() as reading:
            rows = reading.all("SELECT id, path, content_hash, label, status, stamp FROM shapes ORDER BY id")
            return [Origin(*row) for row in rows]

    def times(self) -> dict[str, str]:
        with self._database.reading() as reading:
            rows = reading.all("SELECT id, added FROM shapes JOIN provenance ON shape = number")
            return {shape_id: added for shape_id, added in rows}

    def labelled(self, labels: Collection[str]) -> list[str]:
        query = f"SELECT id FROM shapes WHERE status = 'done' AND {any_of('label')} ORDER BY id"
        with self._database.reading() as reading:
            return [shape_id for (shape_id,) in reading.all(query, values=list(labels))]

    def put(self, record: Record, signature: bytes | None, payloads: Mapping[Payload, bytes]) -> Record:
        with self._writing() as writing:

            def is_taken(shape_id: str) -> bool:
                return bool(writing.all("SELECT 1 FROM shapes WHERE id = :id", id=shape_id))

            query = f"SELECT id, status FROM shapes WHERE {has_path('path')}"
            earlier = writing.all(query, path=record.path)
            shape_id, status = earlier[0] if earlier else (free_id(record, is_taken), None)
            if status == "done" and record.status == "failed":
                return self._one(writing, shape_id)
            signatures = {} if signature is None else {OWN: signature}
            self._store(writing, Entry(replace(record, id=shape_id), signatures, payloads))
            if "done" in (status, record.status):
                changed(writing, "revision")
            return self._one(writing, shape_id)

    def entries(self, shape_ids: Collection[str]) -> list[Entry]:
        parts = "SELECT id, {} FROM {} JOIN shapes ON shape = number WHERE " + any_of("id")
        signatures: dict[str, dict[str, bytes]] = {}
        payloads: dict[str, dict[Payload, bytes]] = {}
        with self._database.reading() as reading:
            ids = list(shape_ids)
            for shape_id, digest, value in reading.all(
                parts.format("digest, value", "signatures"), values=ids
            ):
                signatures.setdefault(shape_id, {})[digest] = bytes(value)
            for shape_id, name, arrays in reading.all(parts.format("name, arrays", "payloads"), values=ids):
                payloads.setdefault(shape_id, {})[name] = bytes(arrays)
            records = self._records(reading, f"{any_of('id')} ORDER BY id", values=ids)
        return [Entry(one, signatures.get(one.id, {}), payloads.get(one.id, {})) for one in records]

    def add(self, entries: Collection[Entry]) -> None:
        with self._writing() as writing:
            for entry in entries:
                self._store(writing, entry)
            changed(writing, "revision")

    def remove(self, shape_ids: Collection[str]) -> None:
        with self._writing() as writing:
            writing.run(f"DELETE FROM shapes WHERE {any_of('id')}", values=list(shape_ids))
            changed(writing, "revision")

    def revise(
        self,
        *,
        moved: Mapping[str, str],
        removed: Collection[str],
        labels: Mapping[str, str | None],
        stamps: Mapping[str, str],
    ) -> None:
        with self._writing() as writing:
            writing.run_each(
                f"UPDATE shapes SET path = :new, path_checksum = :checksum WHERE {has_path('old')} "
                f"AND NOT EXISTS (SELECT 1 FROM shapes WHERE {has_path('new')})",
                [{"old": old, "new": new, "checksum": checksum(new)} for old, new in moved.items()],
            )
            if removed:
                paths = [{"path": path} for path in removed]
                writing.run_each(f"DELETE FROM shapes WHERE {has_path('path')}", paths)
                changed(writing, "revision")
            if labels:
                writing.run_each(
                    f"UPDATE shapes SET label = :label, label_checksum = :checksum WHERE {has_path('path')}",
                    [
                        {"label": label, "checksum": checksum(label), "path": path}
                        for path, label in labels.items()
                    ],
                )
                changed(writing, "label_revision")
            writing.run_each(
                f"UPDATE shapes SET stamp = :stamp WHERE {has_path('path')}",
                [{"stamp": stamp, "path": path} for path, stamp in stamps.items()],
            )

    # --- arrays -----------------------------------------------------------------------------------------

    def read(self, shape_id: str, names: Collection[Payload]) -> tuple[Record, dict[Payload, bytes]] | None:
        query = (
            "SELECT name, arrays FROM payloads JOIN shapes ON shape = number "
            "WHERE id = :id AND name = ANY(CAST(:names AS text[]))"
        )
        with self._database.reading() as reading:
            found = self._records(reading, "id = :id", id=shape_id)
            stored = reading.all(query, id=shape_id, names=list(names))
            return (found[0], {name: bytes(arrays) for name, arrays in stored}) if found else None

    def sizes(self, shape_id: str) -> dict[str, int]:
        with self._database.reading() as reading:
            sizes = dict.fromkeys(("record", "signatures", *PAYLOADS), 0)
            query = "SELECT {} FROM {} JOIN shapes ON shape = number WHERE id = :id"
            for names in (
                query.format(f"'record', {LENGTH}", "provenance"),
                query.format("'signatures', octet_length(value)", "signatures"),
                query.format("name, octet_length(arrays)", "payloads"),
            ):
                for name, size in reading.all(names, id=shape_id):
                    sizes[name] += size
            return sizes

    def signatures(self, digest: str) -> Listed:
        lengths = "SELECT coalesce(min(octet_length(value)), 0), coalesce(max(octet_length(value)), 0) "
        query = (
            "SELECT id, label, value FROM shapes LEFT JOIN signatures ON shape = number AND digest = :digest "
            "WHERE status = 'done' ORDER BY id"
        )
        ids: list[str] = []
        labels: list[str | None] = []
        with self._database.reading() as reading:
            ((shortest, length),) = reading.all(
                f"{lengths} FROM signatures WHERE digest = :digest", digest=digest
            )
            if shortest != length:
                raise damaged(self.location, "signatures by the same options have several lengths")
            ((n_shapes,),) = reading.all("SELECT count(*) FROM shapes WHERE status = 'done'")
            packed, has = np.zeros((n_shapes, length), np.uint8), np.zeros(n_shapes, np.bool_)
            for page in reading.pages(query, READ_AT_ONCE, digest=digest):
                here = slice(len(ids), len(ids) + len(page))
                ids += (row[0] for row in page)
                labels += (row[1] for row in page)
                has[here] = [row[2] is not None for row in page]
                values = b"".join(row[2] or bytes(length) for row in page)
                packed[here] = np.frombuffer(values, np.uint8).reshape(len(page), length)
            return Listed(self._revision(reading), ids, labels, packed, has)

    def keep(self, digest: str, signatures: Collection[tuple[Record, bytes]]) -> None:
        with self._writing() as writing:
            writing.run_each(
                "INSERT INTO signatures SELECT :digest, number, :value FROM shapes "
                "WHERE id = :id AND content_hash = :content_hash AND status = 'done' "
                "ON CONFLICT (digest, shape) DO UPDATE SET value = excluded.value",
                [
                    {"digest": digest, "value": value, "id": record.id, "content_hash": record.content_hash}
                    for record, value in signatures
                ],
            )

    def keep_payload(self, name: Payload, record: Record, arrays: bytes) -> None:
        with self._writing() as writing:
            writing.run(
                "INSERT INTO payloads SELECT number, :name, :arrays FROM shapes "
                "WHERE id = :id AND content_hash = :content_hash AND status = 'done' "
                "ON CONFLICT (shape, name) DO UPDATE SET arrays = excluded.arrays",
                name=name,
                arrays=arrays,
                id=record.id,
                content_hash=record.content_hash,
            )

    # --- inside -----------------------------------------------------------------------------------------

    def _writing(self) -> AbstractContextManager[Transaction]:
        """One transaction that locks the catalogue for writing."""
        return self._database.writing(LOCK)

    def _revision(self, reading: Transaction) -> Revision:
        settings = read_settings(reading)
        try:
            return Revision(settings["revision"], settings["label_revision"])
        except KeyError as error:
            raise damaged(self.location, f"it has no {error.args[0]}") from error

    def _store(self, writing: Transaction, entry: Entry) -> None:
        """Insert a shape, in the place of a shape of the same path."""
        writing.run(f"DELETE FROM shapes WHERE {has_path('path')}", path=entry.record.path)
        row = row_of(entry.record)
        inserted = f"{inserting('shapes', SHAPE_COLUMNS)} RETURNING number"
        ((number,),) = writing.all(inserted, **{name: row[name] for name in SHAPE_COLUMNS})
        kept = {name: row[name] for name in PROVENANCE_COLUMNS}
        writing.run(inserting("provenance", ("shape", *PROVENANCE_COLUMNS)), shape=number, **kept)
        values = [{"digest": name, "shape": number, "value": one} for name, one in entry.signatures.items()]
        writing.run_each(inserting("signatures", ("digest", "shape", "value")), values)
        parts = [{"shape": number, "name": name, "arrays": part} for name, part in entry.payloads.items()]
        writing.run_each(inserting("payloads", ("shape", "name", "arrays")), parts)

    def _one(self, transaction: Transaction, shape_id: str) -> Record:
        (record,) = self._records(transaction, "id = :id", id=shape_id)
        return record

    def _records(self, transaction: Transaction, condition: str, **values: object) -> list[Record]:
        rows = transaction.all(f"{RECORDS} WHERE {condition}", **values)
        return [record_of(tuple(row), self.location) for row in rows]
