"""Schemas of PostgreSQL databases, which several computers write, by psycopg.

psycopg is installed by the extra ``postgresql`` (``pip install pcretrieve[postgresql]``).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

from pcretrieve.catalogue.records import (
    PAYLOADS,
    READ_AT_ONCE,
    TABLES,
    TransactionLost,
    created,
    repeated,
)
from pcretrieve.errors import CatalogueError

logger = logging.getLogger(__name__)

# The schema of the tables, unless the URL names another one.
SCHEMA = "pcretrieve"

# Longest time to wait for another process that is writing; seconds.
LOCK_TIMEOUT = 30.0

# Longest time for which a server that is away is tried again; seconds.
PATIENCE = 300.0

# Time between two tries; seconds.
PAUSE = 1.0

# Longest time for which a server may send nothing while a statement runs; seconds. A process that is stopped
# keeps its connections, and its computer answers for it. Statements wait for locks for a shorter time, and
# those of a catalogue of a million shapes take less.
SILENCE = 120.0

# Parameters of a connection, unless the URL has others.
PARAMETERS = {
    # Time to connect; seconds.
    "connect_timeout": "10",
    # A computer that is gone is noticed after 60 s: idle time and intervals in seconds, and milliseconds.
    "keepalives_idle": "30",
    "keepalives_interval": "10",
    "keepalives_count": "3",
    "tcp_user_timeout": "60000",
    # Another one of a user, or of a database, would change texts.
    "client_encoding": "UTF8",
}

# Fewer digits, which a server or a user may have, would change numbers. The server gives up clients that are
# gone, whose locks others wait for.
SESSION = """
    SELECT pg_catalog.set_config('search_path', pg_catalog.quote_ident(%s), false),
        pg_catalog.set_config('lock_timeout', %s, false),
        pg_catalog.set_config('extra_float_digits', '3', false),
        pg_catalog.set_config('tcp_keepalives_idle', '30', false),
        pg_catalog.set_config('tcp_keepalives_interval', '10', false),
        pg_catalog.set_config('tcp_keepalives_count', '3', false)
"""

# What of the tables would run code as the user who reads or writes them, or lead elsewhere. What belongs to
# PostgreSQL itself is in no row of pg_depend.
ACTING = """
    WITH tables AS (
        SELECT c.oid, c.relname, c.relkind FROM pg_catalog.pg_class c
        JOIN pg_catalog.pg_namespace n ON n.oid = c.relnamespace
        WHERE n.nspname = current_schema AND c.relname::text = ANY (%s::text[])
    ), parts AS (
        SELECT 'pg_catalog.pg_class'::regclass AS class, indexrelid AS part, i.relname
        FROM pg_catalog.pg_index JOIN tables ON tables.oid = indrelid
        JOIN pg_catalog.pg_class i ON i.oid = indexrelid
        UNION ALL SELECT 'pg_catalog.pg_constraint'::regclass, c.oid, conname
        FROM pg_catalog.pg_constraint c JOIN tables ON tables.oid = conrelid
    )
    SELECT CASE relkind WHEN 'v' THEN 'view' ELSE 'other relation' END, relname::text
        FROM tables WHERE relkind <> 'r'
    UNION SELECT 'trigger', tgname::text
        FROM pg_catalog.pg_trigger JOIN tables ON tables.oid = tgrelid
    UNION SELECT 'rule', rulename::text
        FROM pg_catalog.pg_rewrite JOIN tables ON tables.oid = ev_class WHERE relkind = 'r'
    UNION SELECT 'policy', polname::text
        FROM pg_catalog.pg_policy JOIN tables ON tables.oid = polrelid
    UNION SELECT 'default of table', relname::text
        FROM pg_catalog.pg_attrdef JOIN tables ON tables.oid = adrelid
    UNION SELECT 'child of table', relname::text
        FROM pg_catalog.pg_inherits JOIN tables ON tables.oid = inhparent
    UNION SELECT 'column', attname::text
        FROM pg_catalog.pg_attribute JOIN tables ON tables.oid = attrelid
        WHERE relkind = 'r' AND attnum > 0 AND NOT attisdropped AND atttypid NOT IN (
            'pg_catalog.text'::regtype, 'pg_catalog.bytea'::regtype, 'pg_catalog.int4'::regtype,
            'pg_catalog.int8'::regtype, 'pg_catalog.float8'::regtype
        )
    UNION SELECT 'constraint', conname::text
        FROM pg_catalog.pg_constraint JOIN tables ON tables.oid = conrelid
        WHERE contype NOT IN ('p', 'u', 'x', 'n')
    UNION SELECT 'function of', parts.relname::text
        FROM parts JOIN pg_catalog.pg_depend ON classid = class AND objid = part
        WHERE refclassid IN (
            'pg_catalog.pg_proc'::regclass, 'pg_catalog.pg_operator'::regclass,
            'pg_catalog.pg_opclass'::regclass, 'pg_catalog.pg_opfamily'::regclass
        )
    ORDER BY 1, 2
"""

# The row that a process has locked while it writes, with the number of the transaction.
LOCK = "SELECT pg_catalog.txid_current() FROM meta WHERE key = 'revision' FOR UPDATE"

# The lock while there is no table to lock: a number that no other program is likely to use.
CREATION_LOCK = (
    "SELECT pg_catalog.txid_current(), pg_catalog.pg_advisory_xact_lock(7205759403792794)"
)

# Text is ordered by code point, as in Python and in SQLite.
WORDS = {"text": 'text COLLATE "C"', "octets": "bytea", "ordered": ""}

FURTHER = (
    # By a hash, because an entry of other indexes must be shorter than a path may be.
    "ALTER TABLE shapes ADD CONSTRAINT shapes_by_path EXCLUDE USING hash (path WITH =)",
    # The arrays are compressed already.
    *(
        f'ALTER TABLE arrays ALTER COLUMN "{name}" SET STORAGE EXTERNAL'
        for name in PAYLOADS
    ),
)

FORBIDDEN = "cannot be used by this user of the database: grant the privileges, or give another user"

FULL = (
    "cannot be used, the server has as many connections as it allows: wait until others have ended, use "
    "fewer processes at a time, or raise its limit (max_connections, or that of the user or the database)"
)

# Advice by the SQLSTATE of an error.
ADVICE = {
    "55P03": "is locked by another process: wait until that has finished",
    "53100": "cannot grow, the disk of the server is full: make room and run the same command again",
    "25006": "cannot be written to: the server is read-only; give another --catalogue",
    "3F000": FORBIDDEN,
    "42501": FORBIDDEN,
    "53300": FULL,
}

# Errors before there is a connection have no SQLSTATE: words of those of a server that is full, which are
# "too many clients" or "too many connections" too; and of one that starts, stops or recovers.
FULL_WORDS = ("too many c", "connection slots are reserved")
STARTING = "the database system is"


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
        # psycopg warns of what it cannot end on a lost connection, which nobody needs to see.
        logging.getLogger("psycopg").addHandler(logging.NullHandler())
        self._url, self.location, self._schema = _parsed(url)
        self._connection: Any = None
        self._in_transaction = False
        # The number of the transaction, if it writes.
        self._number: int | None = None
        #: Longest time for which a server that is away is tried again; seconds.
        self.patience = PATIENCE
        self._n_tries = 0
        self._away_since = 0.0
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
            "SELECT pg_catalog.has_table_privilege('shapes', 'INSERT, UPDATE, DELETE') AND NOT "
            "pg_catalog.pg_is_in_recovery() AND "
            "pg_catalog.current_setting('transaction_read_only') = 'off'"
        )
        return bool(self.execute(query)[0][0])

    def execute(self, query: str, values: Sequence[object] = ()) -> list[Any]:
        """All rows of the result of a statement."""
        with self._translated():
            cursor = self._executed(query.replace("?", "%s"), _storable(values))
            if not self._in_transaction:
                self._n_tries = 0
            return cursor.fetchall() if cursor.description else []

    def each(self, statement: str, rows: Iterable[Sequence[object]]) -> None:
        """Execute a statement for each of several rows of parameters."""
        with self._translated(), self._connection.cursor() as cursor:
            cursor.executemany(statement.replace("?", "%s"), map(_storable, rows))

    def columns(
        self, query: str, values: Sequence[object] = ()
    ) -> Iterator[list[list[Any]]]:
        """Yield the result of a query by columns, some rows at a time, within a transaction."""
        made = self._connection.cursor(name="columns")
        # Closed twice: the first time needs the server.
        with self._translated(), closing(made), made as cursor:
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
            for number, *_ in self.execute(lock):
                self._number = number
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
        import psycopg

        with self._translated():
            self._executed(f"BEGIN ISOLATION LEVEL {isolation}")
        self._in_transaction = True
        self._number = None
        try:
            with self._translated():
                yield
                self._commit()
        except BaseException:
            if not self._connection.closed:
                with suppress(psycopg.Error):
                    self._connection.execute("ROLLBACK")
            raise
        finally:
            self._in_transaction = False
        self._n_tries = 0

    def _commit(self) -> None:
        """End the transaction, exactly once: if the answer is lost, the server is asked what became of it."""
        import psycopg

        try:
            self._connection.execute("COMMIT")
        except psycopg.OperationalError as error:
            # What was read is complete.
            if self._number is None:
                return
            if not self._is_lost(error):
                raise
            self._in_transaction = False
            status = "in progress"
            while status == "in progress":
                self._pause(error)
                query = "SELECT pg_catalog.txid_status(%s::bigint)"
                (status,) = self._executed(query, [self._number]).fetchone()
            if status != "committed":
                raise TransactionLost(
                    f"{self.location} has not stored the last change"
                ) from error

    def _executed(self, query: str, values: Sequence[object] = ()) -> Any:
        """Execute a statement; outside of a transaction, try again while the server is away."""
        import psycopg

        while True:
            try:
                is_open = self._connection is not None and not self._connection.closed
                if not is_open and not self._in_transaction:
                    self._connection = self._connected()
                return self._connection.execute(query, values)
            except psycopg.OperationalError as error:
                if self._in_transaction or not self._is_lost(error):
                    raise
                self._pause(error)

    def _connected(self) -> Any:
        """A new connection to tables that run nothing as this user."""
        import psycopg

        connection: Any = psycopg.connect(self._url, autocommit=True)
        try:
            wait = connection.wait
            connection.wait = lambda steps, **limits: wait(
                _while_heard(connection, steps), **limits
            )
            connection.execute(SESSION, [self._schema, f"{LOCK_TIMEOUT * 1000:.0f}ms"])
            parts = connection.execute(ACTING, [[*TABLES]]).fetchall()
            if acting := ", ".join(f"{kind} {name!r}" for kind, name in parts):
                raise CatalogueError(
                    f"{self.location} has the {acting}, which no catalogue has, and which may act as the "
                    "user who reads or writes it: let its owner remove that, or give another --catalogue"
                )
        except BaseException:
            connection.close()
            raise
        return connection

    def _is_lost(self, error: Any) -> bool:
        """Whether an error says that the server is away, and may come back."""
        if self._connection is None:
            return STARTING in str(error)
        return bool(
            self._connection.closed or (error.sqlstate or "").startswith(("08", "57P"))
        )

    def _pause(self, error: Exception) -> None:
        """Wait before the next try; raise the error if there have been tries for long enough."""
        now = time.monotonic()
        if self._n_tries == 0:
            self._away_since = now
        # A connection that was lost since the last transaction is made again without a word.
        else:
            if now - self._away_since >= self.patience:
                raise error
            if self._n_tries == 1:
                logger.warning(
                    "%s is away (%s): it is tried again for %.0f s",
                    self.location,
                    " ".join(str(error).split()),
                    self.patience,
                )
            time.sleep(PAUSE)
        self._n_tries += 1

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """Convert errors of PostgreSQL to errors with advice."""
        import psycopg

        try:
            with self._cut():
                yield
        except psycopg.Error as error:
            text = " ".join(str(error).split())
            message = ADVICE.get(error.sqlstate or "", f"cannot be used: {text}")
            if error.sqlstate is None and any(words in text for words in FULL_WORDS):
                message = FULL
            elif self._n_tries and self._is_lost(error):
                message = (
                    f"cannot be reached ({text}): see to the server, and run the same command again, "
                    "which goes on from there"
                )
            raise CatalogueError(f"{self.location} {message}") from error

    @contextmanager
    def _cut(self) -> Iterator[None]:
        """Let a transaction be run again that was cut."""
        import psycopg

        try:
            yield
        except psycopg.OperationalError as error:
            if not self._in_transaction or not self._is_lost(error):
                raise
            self._pause(error)
            raise TransactionLost(f"{self.location} was away during a change") from error

    def _is_there(self) -> bool:
        # Not by to_regclass, which may not see a schema that was created since this transaction began.
        query = (
            "SELECT 1 FROM pg_tables WHERE tablename = 'meta' AND schemaname = ? "
            "AND pg_catalog.has_schema_privilege(schemaname, 'USAGE')"
        )
        return bool(self.execute(query, [self._schema]))

    @repeated
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
            if not self.execute(
                "SELECT 1 FROM pg_namespace WHERE nspname = ?", [self._schema]
            ):
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
            parse_qsl(
                parts.query, keep_blank_values=True, strict_parsing=bool(parts.query)
            )
        )
    except ValueError as error:
        raise CatalogueError(
            "the URL of a catalogue must be postgresql://user@host:port/database, got one that cannot be "
            "read: quote special characters of a password, such as @ by %40"
        ) from error
    schema = query.pop("schema", SCHEMA)
    name = user.partition(":")[0]
    shown = parts._replace(netloc=f"{name}@{host}" if name else host)
    whole = parts._replace(query=urlencode(PARAMETERS | query))
    return whole.geturl(), shown.geturl(), schema


def _while_heard(
    connection: Any, steps: Generator[Any, int, Any]
) -> Generator[Any, int, Any]:
    """The steps of a statement, by which psycopg waits; an error after a long time without any answer."""
    import psycopg

    heard = time.monotonic()
    try:
        wanted = next(steps)
        while True:
            # Several times a second, 0 if nothing has come and nothing can be sent.
            ready = yield wanted
            if ready:
                heard = time.monotonic()
            elif time.monotonic() - heard > SILENCE:
                connection.pgconn.finish()
                raise psycopg.OperationalError(
                    f"the server has not answered for {SILENCE:.0f} s"
                )
            wanted = steps.send(ready)
    except StopIteration as end:
        return end.value


def _storable(values: Sequence[object]) -> list[object]:
    """Values whose texts have no character 0, which messages may have, and PostgreSQL cannot store."""
    return [
        value.replace("\0", "\N{SYMBOL FOR NULL}") if isinstance(value, str) else value
        for value in values
    ]
