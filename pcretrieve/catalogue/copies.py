"""Several catalogues → one; a catalogue → a copy in one file, or vectors in a PostgreSQL database."""

from __future__ import annotations

import logging
import os
import sqlite3
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from random import SystemRandom
from secrets import token_hex
from tempfile import TemporaryDirectory

from pcretrieve.catalogue.catalogue import Catalogue, CatalogueLike
from pcretrieve.catalogue.records import (
    Entry,
    Record,
    check_options,
    settings_of,
    stored_options,
)
from pcretrieve.catalogue.rows import Rows, file_of
from pcretrieve.catalogue.sqlite import (
    check_tables,
    connect,
    create_private,
    journal,
    lost,
    translated,
)
from pcretrieve.errors import CatalogueError, InputError
from pcretrieve.options import check_many

logger = logging.getLogger(__name__)

# Number of shapes that are stored in one transaction.
STORED_AT_ONCE = 500

# Number of conflicts that a message names.
NAMED = 5


@dataclass(frozen=True, slots=True)
class MergedCatalogues:
    """Numbers of shapes that a merge has stored, and of shapes that were there already."""

    n_added: int
    n_held: int


def merge_catalogues(
    parts: Sequence[CatalogueLike], output: CatalogueLike
) -> MergedCatalogues:
    """Store the shapes of several catalogues in one, such as those of ``ingest(shard=...)``.

    Of a path that several catalogues have, the first finished shape is kept, or the first failure if none is
    finished, with the label and the decision (`mark`) that one of them has. The merge is associative, and
    continues after an interruption if it is started again.

    Parameters
    ----------
    parts : sequence of (Catalogue, str or Path)
        The catalogues, all built with the same options.
    output : Catalogue, str or Path
        The catalogue in which the shapes are stored. It is created if it does not exist.

    Returns
    -------
    MergedCatalogues
        Numbers of shapes that were stored, and of shapes that the catalogue had already.

    Raises
    ------
    InputError
        If there are no parts.
    CatalogueError
        If a part does not exist or was built with other options, or there is a conflict: a path has two
        contents or two labels, or an id belongs to two paths. Nothing is then stored.
    """
    check_many("parts", parts)
    if not parts:
        raise InputError(
            "there must be at least one catalogue to merge, got none: name the parts"
        )
    with ExitStack() as stack:
        sources = [stack.enter_context(Catalogue.opened(part)) for part in parts]
        for part in sources:
            check_options(part.location, part.options, sources[0].options)
        # Conflicts are an error before there is a new file.
        _chosen([part.rows for part in sources])
        target = stack.enter_context(
            Catalogue.opened(output, sources[0].options, create=True)
        )
        return _merge([one.rows for one in (target, *sources)])


def backup(catalogue: CatalogueLike, file: str | Path, *, names: bool = True) -> int:
    """Write a copy of a catalogue to one SQLite file, while others may read and write the catalogue.

    The copy of a file is one state of it. That of a database, or without names, has each shape as a whole;
    shapes that are stored meanwhile may be missing. Indexes are not copied: they are made again when they are
    needed. What was removed from the catalogue is not in the copy, and the copy is for its user alone (0600).

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue. Its schema and its options may be those of an earlier version.
    file : str or Path
        The file, which must not exist. It has its name when it is complete, and is a catalogue.
    names : bool, default True
        Whether the copy has names. Otherwise its ids are numbers in random order, and it has no paths or
        hashes of files, classes, times, notes, failures, or name of a whitening. It still has the bodies, by
        which people can be recognised. The catalogue must have the schema of this version.

    Returns
    -------
    int
        The size of the file; bytes.

    Raises
    ------
    CatalogueError
        If the catalogue cannot be read, or the file exists or cannot be written.
    """
    target, location = (
        Path(file),
        catalogue.location if isinstance(catalogue, Catalogue) else catalogue,
    )
    exists = CatalogueError(
        f"{target} exists: name a new file for the backup, or remove it first"
    )
    if os.path.lexists(target):
        raise exists
    copy_rows = _copy_rows if names else _copy_without_names
    source = file_of(location) if names else None
    try:
        with TemporaryDirectory(prefix=".backup-", dir=target.parent) as folder:
            unfinished = Path(folder) / target.name
            if source is not None:
                _copy_file(source, unfinished)
            elif isinstance(catalogue, Catalogue):  # whose location has no password
                copy_rows(catalogue.rows, unfinished)
            else:
                with Rows(location, {}, create=False) as rows:
                    copy_rows(rows, unfinished)
            with unfinished.open("rb") as written:
                os.fsync(written.fileno())
            _name(unfinished, target)
        return target.stat().st_size
    except FileExistsError as error:
        raise exists from error
    except OSError as error:
        raise CatalogueError(
            f"cannot write the backup {target}: {error.strerror or error}; name a file in a folder that "
            "exists and can be written"
        ) from error


def _name(file: Path, target: Path) -> None:
    """Give a file its name; FileExistsError if another file, or a link, has it."""
    try:
        os.link(file, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without links of files
        create_private(target)
        file.replace(target)


def _copy_file(source: Path, target: Path) -> None:
    """Copy an SQLite file of any schema version, with the changes of its log, in one state."""
    lost(source)
    create_private(target)
    with closing(connect(source, create=False)) as connection, translated(source):
        check_tables(source, connection)
        # By rows, not by pages, whose free space has bytes of what was removed.
        connection.execute("VACUUM INTO ?", [str(target.absolute())])
    with (
        translated(target),
        closing(sqlite3.connect(target, isolation_level=None)) as copy,
    ):
        copy.execute("PRAGMA secure_delete = ON")
        copy.execute(f"PRAGMA journal_mode = {journal(target)}")
        # No ingest counts in the copy.
        copy.execute("DELETE FROM meta WHERE key = 'batch'")


def _copy_rows(rows: Rows, target: Path) -> None:
    """Copy the shapes of a database."""
    stored = rows.settings()
    settings = {name: stored[name] for name in ("options", "numbers_version")}
    with Rows(target, settings, create=True) as copy:
        _merge([copy, rows])


def _copy_without_names(rows: Rows, target: Path) -> None:
    """Copy the shapes that did not fail, without what names a person, a file or a time."""
    stored = rows.settings()
    options = stored_options(rows.location, stored, any_numbers=True)
    options = options.changed(retrieval={"calibration": None})  # the name of a file
    settings = settings_of(options) | {"numbers_version": stored["numbers_version"]}
    ids = [origin.id for origin in rows.origins() if origin.status == "done"]
    # Ids follow names, and numbers the order in which scans came.
    SystemRandom().shuffle(ids)
    with Rows(target, settings, create=True) as copy:
        for start in range(0, len(ids), STORED_AT_ONCE):
            here = ids[start : start + STORED_AT_ONCE]
            entries = {entry.record.id: entry for entry in rows.entries(here)}
            # A shape may have been removed, or have failed, meanwhile.
            numbered = [
                _without_names(entries[shape_id], number)
                for number, shape_id in enumerate(here, start + 1)
                if shape_id in entries and entries[shape_id].record.status == "done"
            ]
            copy.add(numbered)
            logger.info("stored: %d of %d shapes", start + len(here), len(ids))
        with copy.database.writing():
            copy.keep_setting("up", stored.get("up"))


def _without_names(entry: Entry, number: int) -> Entry:
    """A shape whose id and path are a number, and which no merge takes for another one."""
    record = replace(
        entry.record,
        id=str(number),
        path=str(number),
        content_hash=token_hex(),
        label=None,
        mark=None,
        note=None,
        steps=tuple(replace(step, notes=()) for step in entry.record.steps),
        added="",
        stamp=None,
    )
    return replace(entry, record=record)


def _merge(stores: Sequence[Rows]) -> MergedCatalogues:
    """Store in the first catalogue the shapes of the others."""
    chosen = _chosen(stores)
    target, n_stored = stores[0], 0
    n_added = sum(number > 0 for number, _ in chosen.values())
    for number, store in enumerate(stores[1:], 1):
        ids = [origin.id for place, origin in chosen.values() if place == number]
        for start in range(0, len(ids), STORED_AT_ONCE):
            entries = store.entries(ids[start : start + STORED_AT_ONCE])
            target.add(entries)
            n_stored += len(entries)
            logger.info("stored: %d of %d shapes", n_stored, n_added)
    labels: dict[str, str] = {}
    for stored in target.origins():
        _, wanted = chosen.get(stored.path, (0, stored))
        if wanted.label is not None and wanted.label != stored.label:
            labels[stored.path] = wanted.label
        if wanted.mark and (wanted.mark, wanted.note) != (stored.mark, stored.note):
            target.mark([stored.id], wanted.mark, wanted.note)
    target.revise(labels=labels)
    return MergedCatalogues(n_added, len(chosen) - n_added)


def _chosen(stores: Sequence[Rows]) -> dict[str, tuple[int, Record]]:
    """By path, the number of the store whose shape is kept, and the row in it, with the label and the mark.

    Conflicts are an error, before anything is written.
    """
    chosen: dict[str, tuple[int, Record]] = {}
    labels: dict[str, str] = {}
    marks: dict[str, Record] = {}
    conflicts: list[str] = []
    for number, store in enumerate(stores):
        for origin in store.origins():
            path = origin.path
            earlier, other = chosen.setdefault(path, (number, origin))
            if origin.mark is not None:
                marks.setdefault(path, origin)
            places = f"in {stores[earlier].location} and in {store.location}"
            if (
                origin.label != labels.setdefault(path, origin.label or "")
                and origin.label
            ):
                if labels[path]:
                    conflicts.append(
                        f"{path} has the labels {labels[path]!r} and {origin.label!r} {places}"
                    )
                labels[path] = origin.label
            if {origin.status, other.status} == {
                "done"
            } and origin.content_hash != other.content_hash:
                conflicts.append(f"{path} has different contents {places}")
            if origin.status == "done" and other.status == "failed":
                chosen[path] = number, origin
    paths: dict[str, str] = {}
    for path, (number, origin) in chosen.items():
        if (other_path := paths.setdefault(origin.id, path)) != path:
            before, here = stores[chosen[other_path][0]].location, stores[number].location
            conflicts.append(
                f"{origin.id!r} is {other_path} in {before} and {path} in {here}"
            )
    if conflicts:
        more = f"; and {len(conflicts) - NAMED} more" if len(conflicts) > NAMED else ""
        raise CatalogueError(
            f"catalogues with conflicts cannot be merged: {'; '.join(conflicts[:NAMED])}{more}. Remove the "
            "shape from one of both (pcretrieve remove), or ingest its file again"
        )
    for path, (number, origin) in chosen.items():
        kept = marks.get(path, origin)
        if kept.content_hash != origin.content_hash:
            kept = origin
        label = labels[path] or None
        row = replace(origin, label=label, mark=kept.mark, note=kept.note)
        chosen[path] = number, row
    return chosen
