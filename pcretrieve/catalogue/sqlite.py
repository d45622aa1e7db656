"""SQLite files, which other processes can read while one process writes.

With a write-ahead log, processes share memory, which computers cannot. On file systems of a network, SQLite
therefore uses a rollback journal, with which readers and the writer wait for each other by locks.
"""

from __future__ import annotations

import logging
import os
import sqlite3
import stat
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import (
    AbstractContextManager,
    ExitStack,
    contextmanager,
    nullcontext,
    suppress,
)
from os.path import samestat
from pathlib import Path
from typing import Any, Literal

from pcretrieve.catalogue.log import log_fault
from pcretrieve.catalogue.records import READ_AT_ONCE, changed_row, created, damaged
from pcretrieve.errors import CatalogueError
from pcretrieve.values.files import lock

logger = logging.getLogger(__name__)

# Longest time to wait for a process that writes; seconds. Tries, .01 s apart, to set the mode of a new file.
LOCK_TIMEOUT = 30.0
N_WAITS = 1000

# Largest number of defects of pages that are listed.
LISTED = 20

ADVICE = {
    "locked": "is locked by another process: wait until that has finished",
    "not a database": "is not a catalogue: give another --catalogue",
    "readonly": "cannot be written to: change its permissions, or give another --catalogue",
    "unable to open": "cannot be opened: see whether the file and its folder may be read and written",
    "disk I/O error": "cannot be read or written, the disk or the network reports an error: see to that, and "
    "run the same command again",
    "locking protocol": "cannot be locked, the file system does not allow it: name a file on a local disk",
    "disk is full": "cannot grow, the disk is full: make room and run the same command again",
}

# Files that SQLite has beside a file: its write-ahead log, the index of that, and its rollback journal.
BESIDE = ("-wal", "-shm", "-journal")

# Last bytes of a journal that names the journal of several files, which SQLite deletes, whatever it is.
# A catalogue never has one, because its transactions write one file.
JOURNAL_OF_SEVERAL = bytes.fromhex("d9d505f920a163d7")

# Rights of a new file: those of its user alone, because it may have people in it.
PRIVATE = 0o600

MOUNTS = Path("/proc/self/mountinfo")

# Types of file systems that several computers mount. Those of FUSE do not say whether they are one.
SHARED = frozenset(
    {"9p", "ceph", "cifs", "gpfs", "lustre", "nfs", "nfs4", "smb3", "virtiofs"}
)
FUSE = "fuse"


class SqliteDatabase:
    """An SQLite file."""

    is_file = True

    #: After the name of a table that is faster to read as a whole than by an index.
    scanned = " NOT INDEXED"

    def __init__(self, path: Path, settings: Mapping[str, str], *, create: bool) -> None:
        self._path = path
        self.location = str(path)
        #: What is lost with the log, if it was damaged when the file was opened.
        self.lost = lost(path)
        self._connection = connect(path, create=create)
        try:
            self._prepare(settings)
            self._file = path.stat()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Release the file."""
        self._connection.close()

    @property
    def is_writable(self) -> bool:
        """Whether the file can be written to."""
        return _is_writable(self._path)

    def execute(self, query: str, values: Sequence[object] = ()) -> list[Any]:
        """All rows of the result of a statement."""
        with translated(self._path):
            return self._connection.execute(query, values).fetchall()

    def each(self, statement: str, rows: Iterable[Sequence[object]]) -> None:
        """Execute a statement for each of several rows of parameters."""
        with translated(self._path):
            self._connection.executemany(statement, rows)

    def columns(
        self, query: str, values: Sequence[object] = ()
    ) -> Iterator[list[list[Any]]]:
        """Yield the result of a query by columns, some rows at a time."""
        cursor = self._connection.execute(query, values)
        while rows := cursor.fetchmany(READ_AT_ONCE):
            # Faster than zip(*rows), which creates an iterator of each row.
            yield [[row[column] for row in rows] for column in range(len(rows[0]))]

    def state(self) -> str:
        """A name of what is seen, which each change gives another: of others, and of this connection."""
        ((version,),) = self.execute("PRAGMA data_version")
        return f"{version} {self._connection.total_changes}"

    def reading(self) -> AbstractContextManager[None]:
        """One transaction, in which everything that is read belongs to one state."""
        return self._transaction("DEFERRED")

    @contextmanager
    def writing(self) -> Iterator[None]:
        """One transaction that locks the file for writing, so that what it has read does not change."""
        with self._transaction("IMMEDIATE"):
            # SQLite writes to a removed file too.
            is_here = False
            with suppress(OSError):
                is_here = samestat(self._file, self._path.stat())
            if not is_here:
                raise CatalogueError(
                    f"{self._path} was removed or replaced while it was in use: what would be written now "
                    "would be lost; put the file back, or run the same command again"
                )
            yield

    def scrub(self) -> None:
        """Write the file again without what was removed, and empty its log."""
        # Pages keep pieces of rows that were moved to other pages, also with secure_delete.
        for statement in ("VACUUM", "PRAGMA wal_checkpoint(TRUNCATE)"):
            try:
                with _without_checkpoints(self._path):
                    rows = self._connection.execute(statement).fetchall()
                # The first number of a checkpoint says whether it had to wait too long.
                why = "another process reads it" if rows and rows[0][0] else ""
            # Another process writes the file, or the disk is full: the rows are removed all the same.
            except sqlite3.Error as error:
                why = str(error)
            if why:
                logger.warning(
                    "%s, or its log, still has bytes of what was removed (%s): the next `remove` writes it "
                    "again, and a copy by `catalogue backup` has none",
                    self._path,
                    why,
                )

    def faults(self) -> list[str]:
        """What is wrong with the pages and the SQL indexes of the file."""
        try:
            rows = self._connection.execute(
                f"PRAGMA integrity_check({LISTED})"
            ).fetchall()
        except sqlite3.DatabaseError as error:
            return [str(error)]
        lines = [
            line
            for (text,) in rows
            for line in text.splitlines()
            if not line.startswith("***")
        ]
        return [] if lines == ["ok"] else lines

    @contextmanager
    def _transaction(self, kind: str) -> Iterator[None]:
        with translated(self._path):
            self._connection.execute(f"BEGIN {kind}")
            with (
                _without_checkpoints(self._path)
                if kind == "IMMEDIATE"
                else nullcontext(),
                self._connection,
            ):
                yield

    def _prepare(self, settings: Mapping[str, str]) -> None:
        """Create the tables of a new file; check that another one is a catalogue."""
        if not self.execute(PARTS_OF_FILE):
            # With a write-ahead log, other processes can read while one process writes.
            # SQLite does not wait where another process sets the mode of the file at the same time.
            for wait in (*[0.01] * N_WAITS, 0.0):
                with suppress(CatalogueError) if wait else nullcontext():
                    self.execute(f"PRAGMA journal_mode = {journal(self._path)}")
                    break
                time.sleep(wait)
            with self._transaction("IMMEDIATE"):
                if not self.execute(
                    PARTS_OF_FILE
                ):  # another process may have created them in the meantime
                    unique = "CREATE UNIQUE INDEX shapes_by_path ON shapes (path)"
                    words = {
                        "text": "text",
                        "octets": "blob",
                        "ordered": " WITHOUT ROWID",
                    }
                    for statement, values in created(settings, words, [unique]):
                        self.execute(statement, values)
        check_tables(self._path, self._connection)


PARTS_OF_FILE = "SELECT type, name FROM sqlite_master WHERE type <> 'index'"


def check_tables(path: Path, connection: sqlite3.Connection) -> None:
    """Check that a file has the tables that every version of a catalogue has, and nothing that acts."""
    with translated(path):
        parts = {*connection.execute(PARTS_OF_FILE)}
    if not {("table", "meta"), ("table", "shapes")} <= parts:
        raise CatalogueError(
            f"{path} is an SQLite file, but no catalogue: give another --catalogue"
        )
    if acting := ", ".join(
        sorted(f"{kind} {name!r}" for kind, name in parts if kind != "table")
    ):
        raise CatalogueError(
            f"{path} has the {acting}, which no catalogue has, and which may change others"
        )


@contextmanager
def _without_checkpoints(path: Path) -> Iterator[None]:
    """Let no other process write or end a checkpoint: https://sqlite.org/wal.html#walresetbug."""
    with ExitStack() as stack:
        # A rollback journal has no checkpoints, and not every system has locks.
        with suppress(OSError):
            log = stack.enter_context(Path(f"{os.path.realpath(path)}-wal").open("rb"))
            lock(log)
        yield


def connect(path: Path, *, create: bool) -> sqlite3.Connection:
    """Connect to a file."""
    try:
        if path.is_dir():
            raise CatalogueError(f"{path} is a folder: name a file for --catalogue")
        size = path.stat().st_size if path.exists() else 0
    except OSError as error:
        raise CatalogueError(
            f"cannot use the catalogue {path}: {error.strerror}"
        ) from error
    if size == 1:  # which SQLite takes for an empty file
        raise CatalogueError(f"{path} {ADVICE['not a database']}")
    if not size and not create:
        raise CatalogueError(
            f"there is no catalogue {path}: make one with `pcretrieve ingest`"
        )
    if not path.parent.is_dir():
        raise CatalogueError(
            f"there is no folder {path.parent} to put a catalogue into: make it first"
        )
    check_files(path)
    with translated(path):
        if create and not size:
            with suppress(OSError):  # it is there, or SQLite says more
                create_private(Path(os.path.realpath(path)))
        if not size or _is_writable(path):
            return _connected(path, "rwc" if create else "rw")
        if create:
            raise CatalogueError(f"{path} {ADVICE['readonly']}")
        try:
            return _connected(path, "ro")
        except sqlite3.OperationalError as error:
            log = Path(f"{os.path.realpath(path)}-wal")
            if log.exists() and log.stat().st_size:
                raise CatalogueError(
                    f"{path} is incomplete without its last changes in {log.name}, which cannot be applied "
                    "in a folder that cannot be written to: copy both files elsewhere, and use the copies"
                ) from error
            # SQLite cannot create its further files in this folder, and needs none if no process writes.
            return _connected(path, "ro&immutable=1")


def check_files(path: Path) -> None:
    """Check that SQLite can open the file and those beside it: it waits for pipes, and trusts journals."""
    place = os.path.realpath(path)
    for name in (place, *(f"{place}{suffix}" for suffix in BESIDE)):
        with suppress(OSError):  # of which SQLite says more
            mode = os.lstat(name).st_mode
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                raise CatalogueError(
                    f"{name} must be a file, and is a link, a pipe or a device: remove it, or give "
                    "another --catalogue"
                )
    with suppress(OSError), Path(f"{place}-journal").open("rb") as journal:
        journal.seek(max(0, os.fstat(journal.fileno()).st_size - len(JOURNAL_OF_SEVERAL)))
        if journal.read() == JOURNAL_OF_SEVERAL:
            raise CatalogueError(
                f"{journal.name} names another file, which SQLite would delete, and no catalogue does: "
                f"remove it, if {path.name} comes from somebody else"
            )


def create_private(path: Path) -> None:
    """Make an empty file for its user alone. SQLite gives its rights to the files that it has beside it."""
    os.close(os.open(path, os.O_CREAT | os.O_EXCL, PRIVATE))


def lost(path: Path) -> str | None:
    """What is lost with a damaged log, after a warning; None if the log is whole."""
    with suppress(OSError):
        check_files(path)
        log = Path(f"{os.path.realpath(path)}-wal")
        if fault := log_fault(log):
            words = f"what was stored last, and not in {path.name} yet, is lost"
            message = f"{log} is damaged ({fault}): {words}"
            logger.warning("%s", message)
            return message
    return None


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Convert errors of SQLite to errors with advice."""
    try:
        yield
    except sqlite3.Error as error:
        text = str(error)
        if "decode to UTF-8" in text:
            raise changed_row(str(path), text) from error
        if "malformed" in text:
            raise damaged(str(path), text) from error
        advice = next((advice for words, advice in ADVICE.items() if words in text), None)
        message = (
            f"{path} {advice}" if advice else f"cannot use the catalogue {path}: {text}"
        )
        raise CatalogueError(message) from error
    # Of a message of SQLite that quotes names which are damaged themselves.
    except UnicodeDecodeError as error:
        raise damaged(str(path), "a name in it is not UTF-8 text") from error


def _is_writable(path: Path) -> bool:
    """Whether SQLite can write to a file, for which it creates further files in the same folder."""
    # The user by whose rights files are opened.
    effective = os.access in os.supports_effective_ids
    return all(
        os.access(place, os.W_OK, effective_ids=effective)
        for place in (path, path.parent)
    )


def _connected(path: Path, mode: str) -> sqlite3.Connection:
    connection = sqlite3.connect(
        f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=LOCK_TIMEOUT
    )
    # A transaction that has ended is on the disk, and its journal is not; a schema calls nothing that acts.
    statements = ["PRAGMA synchronous = EXTRA", "PRAGMA trusted_schema = OFF"]
    # What is removed is overwritten. Not every SQLite is compiled to do so.
    statements.append("PRAGMA secure_delete = ON")
    if mode.startswith("rw") and journal(path) == "DELETE":
        # Also for a file that was copied from a place where it had a write-ahead log.
        statements += [
            # With an exclusive lock, SQLite reads a log without memory that is shared with other processes.
            # Python does not look for the log in the header: closing the file would release all locks.
            "PRAGMA locking_mode = EXCLUSIVE",
            "PRAGMA journal_mode = DELETE",
            "PRAGMA locking_mode = NORMAL",
        ]
    try:
        for statement in (*statements, "SELECT count(*) FROM sqlite_master"):
            connection.execute(statement)
    except (sqlite3.Error, UnicodeDecodeError):
        connection.close()
        raise
    return connection


def journal(path: Path) -> Literal["WAL", "DELETE"]:
    """The journal mode of SQLite for a file: other computers cannot share the memory of a log."""
    kind = _file_system(path)
    return "DELETE" if kind in SHARED or kind.startswith(FUSE) else "WAL"


def _file_system(path: Path) -> str:
    """The type of the file system in which a file is, or would be made; "" if that is not known."""
    with suppress(OSError):
        lines = MOUNTS.read_text("utf-8", "surrogateescape").splitlines()
        device = Path(os.path.realpath(path)).parent.stat().st_dev
        number = f"{os.major(device)}:{os.minor(device)}"
        for line in lines:
            before, _, after = line.partition(" - ")
            if before.split(" ")[2] == number:
                return after.split(" ")[0]
    return ""
