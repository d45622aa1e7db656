"""The signatures of a catalogue as vectors of a PostgreSQL server with the extension pgvector, by psycopg."""

from __future__ import annotations

from collections.abc import Sequence

from pcretrieve.catalogue.catalogue import Catalogue
from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval.distances import table_coordinates
from pcretrieve.values import FloatArray

#: Name of the table in the database, unless another is given.
VECTOR_TABLE = "pcretrieve_signatures"

# Digits that determine a number in single precision, which is the precision of a pgvector column.
DIGITS = 9


def export_vectors(
    catalogue: Catalogue,
    url: str,
    options: PipelineOptions | None = None,
    *,
    shape_ids: Sequence[str] = (),
    table: str = VECTOR_TABLE,
) -> int:
    """Write whitened log-signatures, and return their number, to a new table with the extension pgvector.

    Their Euclidean distance, the operator ``<->`` of pgvector, is the distance ``log`` of `SignatureIndex`:
    ``ORDER BY signature <-> query, id`` gives its order, except where distances are equal in single
    precision. A column without an index of pgvector is searched exactly.

    Parameters
    ----------
    catalogue : Catalogue
        The shapes.
    url : str
        The database, ``postgresql://user@host/name``.
    options : PipelineOptions, optional
        Signature and whitening. By default the options of the catalogue.
    shape_ids : sequence of str, optional
        The shapes; by default all that did not fail.
    table : str, default "pcretrieve_signatures"
        The name of the new table.

    Raises
    ------
    OptionError
        If the distance is not ``log``.
    InputError
        If psycopg is not installed, or the table cannot be made.
    """
    options = options or catalogue.options
    if (distance := options.retrieval.distance) != "log":
        raise OptionError(f"distance must be log for vectors, whose distance is Euclidean, got {distance!r}")
    whitening = catalogue.whitening(options)
    signatures = catalogue.signatures(options)
    if shape_ids:
        signatures = signatures.select(shape_ids)
    vectors = whitening.apply(table_coordinates(signatures, distance))
    write_vectors(url, table, signatures.ids, signatures.labels, vectors)
    return len(signatures)


def write_vectors(
    url: str, table: str, ids: Sequence[str], labels: Sequence[str | None], vectors: FloatArray
) -> None:
    """Create a table with id, label and signature (N, L) of each shape, in one transaction."""
    try:
        import psycopg
        from psycopg import sql
    except ImportError as error:
        raise InputError(
            "PostgreSQL needs psycopg, which is not installed: pip install 'pcretrieve[postgresql]'"
        ) from error
    name = sql.Identifier(table)
    # Ids are compared by code point, as in Python.
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
