"""Vectors as a table of a PostgreSQL server with the extension pgvector, by psycopg.

psycopg is installed by the extra ``postgresql`` (``pip install pcretrieve[postgresql]``).
"""

from __future__ import annotations

from collections.abc import Sequence

from pcretrieve.errors import InputError
from pcretrieve.values import FloatArray

__all__ = ["write_vectors"]

# Digits that determine a number in single precision, which is the precision of a pgvector column.
DIGITS = 9


def write_vectors(
    url: str, table: str, ids: Sequence[str], labels: Sequence[str | None], vectors: FloatArray
) -> None:
    """Create a table with the columns ``id``, ``label`` and ``signature``, in one transaction.

    Ids are compared by code point (the collation ``C``), as in Python.

    vectors: (N, L) float64, the vectors, which are stored in single precision.
    """
    try:
        import psycopg
        from psycopg import sql
    except ImportError as error:
        raise InputError(
            "PostgreSQL needs psycopg, which is not installed: pip install 'pcretrieve[postgresql]'"
        ) from error
    name = sql.Identifier(table)
    created = sql.SQL(
        'CREATE TABLE {} (id text COLLATE "C" PRIMARY KEY, label text, signature vector({}) NOT NULL)'
    ).format(name, sql.Literal(vectors.shape[1]))
    filled = sql.SQL("COPY {} (id, label, signature) FROM STDIN").format(name)
    try:
        with psycopg.connect(url) as connection, connection.cursor() as cursor:
            cursor.execute("CREATE EXTENSION IF NOT EXISTS vector")
            cursor.execute(created)
            with cursor.copy(filled) as copy:
                for shape_id, label, vector in zip(ids, labels, vectors, strict=True):
                    numbers = ",".join(f"{value:.{DIGITS}g}" for value in vector.tolist())
                    copy.write_row((shape_id, label, f"[{numbers}]"))
    except psycopg.errors.DuplicateTable as error:
        raise InputError(
            f"the table must be new, got {table!r}, which the database has; drop it, or give another name"
        ) from error
    except psycopg.Error as error:
        raise InputError(f"cannot write to PostgreSQL: {' '.join(str(error).split())}") from error
