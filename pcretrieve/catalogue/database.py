"""Connections to a PostgreSQL database by SQLAlchemy, and errors of it → messages with advice.

SQLAlchemy and psycopg are installed by the extra ``postgresql`` (``pip install pcretrieve[postgresql]``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from pcretrieve.errors import CatalogueError

__all__ = ["Database", "Transaction"]

#: The schema of the tables, unless the URL names another one.
SCHEMA = "pcretrieve"

# Longest time to wait for another process that is writing; seconds.
LOCK_TIMEOUT = 30.0

# Advice by the SQLSTATE of an error.
ADVICE = {
    "55P03": "is locked by another process: wait until that has finished",
    "53100": "cannot grow, the disk of the server is full: make room and run the same command again",
    "25006": "cannot be written to: the server is read-only; give another --catalogue",
    "3F000": "cannot be used by this user of the database: grant the privileges, or give another user",
    "42501": "cannot be used by this user of the database: grant the privileges, or give another user",
    "53300": "cannot be used, the server has too many connections: use fewer processes, or raise its limit",
}


class Transaction:
    """A connection within a transaction."""

    def __init__(self, connection: Any) -> None:
        self._connection = connection

    def all(self, query: str, **values: object) -> list[Any]:
        """Read the result of a query."""
        return list(self._executed(query, values))

    def pages(self, query: str, size: int, **values: object) -> Iterator[list[Any]]:
        """Read a large result, a part of which is in memory at a time."""
        yield from self._executed(query, values, stream_results=True, max_row_buffer=size).partitions(size)

    def run(self, statement: str, **values: object) -> None:
        """Execute a statement without a result."""
        self._executed(statement, values)

    def run_each(self, statement: str, rows: Sequence[Mapping[str, object]]) -> None:
        """Execute a statement for each of several rows of parameters, in their order."""
        if rows:
            self._executed(statement, list(rows))

    def _executed(self, statement: str, values: Any, **options: object) -> Any:
        from sqlalchemy import text

        return self._connection.execute(text(statement), _storable(values), execution_options=options)


def _storable(value: Any) -> Any:
    """Values whose texts have no character 0, which messages may have, and PostgreSQL cannot store."""
    if isinstance(value, str):
        return value.replace("\0", "\N{SYMBOL FOR NULL}")
    if isinstance(value, Mapping):
        return {name: _storable(one) for name, one in value.items()}
    return [_storable(one) for one in value] if isinstance(value, list) else value


class Database:
    """A schema of a PostgreSQL database."""

    def __init__(self, url: str) -> None:
        try:
            from sqlalchemy import create_engine, event, make_url
            from sqlalchemy.exc import ArgumentError

            parsed = make_url(url)
            given = parsed.query.get("schema", SCHEMA)
            self.schema: str = given if isinstance(given, str) else given[-1]
            self.location: str = parsed.set(password=None).render_as_string()
            # A connection is tested before it is used, because the server may have been started again.
            self._engine = create_engine(
                parsed.difference_update_query(["schema"]).set(drivername="postgresql+psycopg"),
                pool_pre_ping=True,
            )
        except ImportError as error:
            raise CatalogueError(
                "a catalogue in PostgreSQL needs SQLAlchemy and psycopg, of which one is not installed: pip "
                "install 'pcretrieve[postgresql]'"
            ) from error
        except (ArgumentError, ValueError) as error:
            raise CatalogueError(
                "the URL of a catalogue must be postgresql://user@host:port/database, got one that cannot be "
                "read: quote special characters of a password, such as @ by %40"
            ) from error
        event.listen(self._engine, "connect", self._prepare)

    def _prepare(self, connection: Any, record: object) -> None:
        """Let a new connection find the tables of the schema, and no others."""
        connection.execute("SELECT set_config('search_path', quote_ident(%s), false)", [self.schema])
        connection.execute("SELECT set_config('lock_timeout', %s, false)", [f"{LOCK_TIMEOUT * 1000:.0f}ms"])
        connection.commit()

    @property
    def quoted_schema(self) -> str:
        """The schema as an identifier in SQL."""
        return str(self._engine.dialect.identifier_preparer.quote_identifier(self.schema))

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()

    @contextmanager
    def reading(self) -> Iterator[Transaction]:
        """One transaction, in which everything that is read belongs to one state."""
        with self._transaction("REPEATABLE READ") as transaction:
            yield transaction

    @contextmanager
    def writing(self, lock: str) -> Iterator[Transaction]:
        """One transaction that waits for a lock, after which no other process writes."""
        with self._transaction("READ COMMITTED") as transaction:
            transaction.all(lock)
            yield transaction

    @contextmanager
    def _transaction(self, isolation: str) -> Iterator[Transaction]:
        from sqlalchemy.exc import SQLAlchemyError

        try:
            connected = self._engine.connect()
            with connected.execution_options(isolation_level=isolation) as connection, connection.begin():
                yield Transaction(connection)
        except SQLAlchemyError as error:
            cause = getattr(error, "orig", None) or error
            advice = ADVICE.get(getattr(cause, "sqlstate", None) or "")
            message = advice or f"cannot be used: {' '.join(str(cause).split())}"
            raise CatalogueError(f"{self.location} {message}") from error
