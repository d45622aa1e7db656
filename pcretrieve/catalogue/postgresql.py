"""Schemas of PostgreSQL databases, which several computers write, by psycopg.

psycopg is installed by the extra ``postgresql`` (``pip install pcretrieve[postgresql]``).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

from pcretrieve.catalogue.records import PAYLOADS, READ_AT_ONCE, created
from pcretrieve.errors import CatalogueError

# The schema of the tables, unless the URL names another one.
SCHEMA = "pcretrieve"

# Longest time to wait for another process that is writing; seconds.
LOCK_TIMEOUT = 30.0

# The row that a process has locked while it writes.
LOCK = "SELECT value FROM meta WHERE key = 'revision' FOR UPDATE"

# The lock while there is no table to lock: a number that no other program is likely to use.
CREATION_LOCK = "SELECT pg_advisory_xact_lock(7205759403792794)"

# Text is ordered by code point, as in Python and in SQLite.
WORDS = {"text": 'text COLLATE "C"', "octets": "bytea", "ordered": ""}

FURTHER = (
    # By a hash, because an entry of other indexes must be shorter than a path may be.
    "ALTER TABLE shapes ADD CONSTRAINT shapes_by_path EXCLUDE USING hash (path WITH =)",
    # The arrays are compressed already.
    *(f'ALTER TABLE arrays ALTER COLUMN "{name}" SET STORAGE EXTERNAL' for name in PAYLOADS),
)

FORBIDDEN = (
    "cannot be used by this user of the database: grant the privileges, or give another user"
)

# Advice by the SQLSTATE of an error.
ADVICE = {
    "55P03": "is locked by another process: wait until that has finished",
    "53100": "cannot grow, the disk of the server is full: make room and run the same command again",
    "25006": "cannot be written to: the server is read-only; give another --catalogue",
    "3F000": FORBIDDEN,
    "42501": FORBIDDEN,
    "53300": "cannot be used, the server has too many connections: use fewer processes, or raise its limit",
}


class PostgresqlDatabase:
    """A schema of a PostgreSQL database, with the operations of `SqliteDatabase`."""

    is_file = False
    scanned = ""

    def __init__(self, url: str, settings: Mapping[str, str], *, create: bool) -> None:
        try:
            import psycopg  # noqa: F401
        except ImportError as error:
            raise CatalogueError(
                "a catalogue in PostgreSQL needs psycopg, which is not installed: pip install "
                "'pcretrieve[postgresql]'"
            ) from error
        self._url, self.location, self._schema = _parsed(url)
        self._connection: Any = None
        self._in_transaction = False
        try:
            if not self._is_there():
                if not create:
                    raise CatalogueError(
                        f"there is no catalogue {self.location}: make one with `pcretrieve ingest`"
                    )
                self._create(settings)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection."""
        if self._connection is not None:
            self._connection.close()

    @property
    def is_writable(self) -> bool:
        """Whether this user can write the tables."""
        query = (
            "SELECT has_table_privilege('shapes', 'INSERT, UPDATE, DELETE') AND NOT pg_is_in_recovery() "
            "AND current_setting('transaction_read_only') = 'off'"
        )
        return bool(self.execute(query)[0][0])

    def execute(self, query: str, values: Sequence[object] = ()) -> list[Any]:
        """All rows of the result of a statement."""
        with self._translated():
            cursor = self._executed(query.replace("?", "%s"), _storable(values))
            return cursor.fetchall() if cursor.description else []

    def each(self, statement: str, rows: Iterable[Sequence[object]]) -> None:
        """Execute a statement for each of several rows of parameters."""
        with self._translated(), self._connection.cursor() as cursor:
            cursor.executemany(statement.replace("?", "%s"), map(_storable, rows))

    def columns(self, query: str, values: Sequence[object] = ()) -> Iterator[list[list[Any]]]:
        """Yield the result of a query by columns, some rows at a time, within a transaction."""
        with self._translated(), self._connection.cursor(name="columns") as cursor:
            cursor.execute(query.replace("?", "%s"), _storable(values))
            while rows := cursor.fetchmany(READ_AT_ONCE):
                yield [[row[column] for row in rows] for column in range(len(rows[0]))]

    def state(self) -> str:
        """A name of what is seen: which transactions of the server have ended."""
        return str(self.execute("SELECT txid_current_snapshot()"))

    def reading(self) -> AbstractContextManager[None]:
        """One transaction, in which everything that is read belongs to one state."""
        return self._transaction("REPEATABLE READ")

    @contextmanager
    def writing(self, lock: str = LOCK) -> Iterator[None]:
        """One transaction that waits for a lock, after which no other process writes."""
        with self._transaction("READ COMMITTED"):
            self.execute(lock)
            yield

    #: PostgreSQL has no log that this program reads.
    lost = None

    def scrub(self) -> None:
        """Nothing: the server overwrites removed rows after VACUUM, which is up to its owner."""

    def faults(self) -> list[str]:
        """None that a client can see."""
        return []

    @contextmanager
    def _transaction(self, isolation: str) -> Iterator[None]:
        self.execute(f"BEGIN ISOLATION LEVEL {isolation}")
        self._in_transaction = True
        try:
            with self._translated():
                yield
            self.execute("COMMIT")
        except BaseException:
            if not self._connection.closed:
                self._connection.execute("ROLLBACK")
            raise
        finally:
            self._in_transaction = False

    def _executed(self, query: str, values: Sequence[object]) -> Any:
        import psycopg

        if self._connection is not None:
            try:
                return self._connection.execute(query, values)
            except psycopg.OperationalError:
                # The server may have been started again since the last transaction.
                if self._in_transaction or not self._connection.closed:
                    raise
        self._connection = psycopg.connect(self._url, autocommit=True)
        self._connection.execute(
            "SELECT set_config('search_path', quote_ident(%s), false), set_config('lock_timeout', %s, false)",
            [self._schema, f"{LOCK_TIMEOUT * 1000:.0f}ms"],
        )
        return self._connection.execute(query, values)

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """Convert errors of PostgreSQL to errors with advice."""
        import psycopg

        try:
            yield
        except psycopg.Error as error:
            message = (
                ADVICE.get(error.sqlstate or "")
                or f"cannot be used: {' '.join(str(error).split())}"
            )
            raise CatalogueError(f"{self.location} {message}") from error

    def _is_there(self) -> bool:
        # Not by to_regclass, which may not see a schema that was created since this transaction began.
        query = (
            "SELECT 1 FROM pg_tables WHERE tablename = 'meta' AND schemaname = ? "
            "AND has_schema_privilege(schemaname, 'USAGE')"
        )
        return bool(self.execute(query, [self._schema]))

    def _create(self, settings: Mapping[str, str]) -> None:
        from psycopg import sql

        with self.writing(CREATION_LOCK):
            if self._is_there():  # another process has created the tables in the meantime
                return
            if self.execute("SHOW server_encoding") != [("UTF8",)]:
                raise CatalogueError(
                    f"{self.location} must be a database with the encoding UTF8: create another"
                )
            # Not IF NOT EXISTS, which needs the privilege to create schemas if the schema exists too.
            if not self.execute("SELECT 1 FROM pg_namespace WHERE nspname = ?", [self._schema]):
                self._connection.execute(
                    sql.SQL("CREATE SCHEMA {}").format(sql.Identifier(self._schema))
                )
            for statement, values in created(settings, WORDS, FURTHER):
                self.execute(statement, values)


def _parsed(url: str) -> tuple[str, str, str]:
    """The URL for psycopg; the URL without the password, as messages name it; the schema."""
    try:
        parts = urlsplit(url)
        user, _, host = parts.netloc.rpartition("@")
        if "@" in user + parts.path or parts.port == 0:
            raise ValueError(url)
        query = dict(
            parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
        )
    except ValueError as error:
        raise CatalogueError(
            "the URL of a catalogue must be postgresql://user@host:port/database, got one that cannot be "
            "read: quote special characters of a password, such as @ by %40"
        ) from error
    schema = query.pop("schema", SCHEMA)
    name = user.partition(":")[0]
    shown = parts._replace(netloc=f"{name}@{host}" if name else host)
    return parts._replace(query=urlencode(query)).geturl(), shown.geturl(), schema


def _storable(values: Sequence[object]) -> list[object]:
    """Values whose texts have no character 0, which messages may have, and PostgreSQL cannot store."""
    return [
        value.replace("\0", "\N{SYMBOL FOR NULL}") if isinstance(value, str) else value
        for value in values
    ]
