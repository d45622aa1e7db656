"""The signatures of a catalogue as vectors of a database that searches nearest neighbours."""

from __future__ import annotations

from collections.abc import Sequence

from pcretrieve.catalogue.pgvector import write_vectors
from pcretrieve.catalogue.store import Catalogue
from pcretrieve.errors import OptionError
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import table_coordinates

__all__ = ["VECTOR_TABLE", "export_vectors"]

#: Name of the table in the database, unless another is given.
VECTOR_TABLE = "pcretrieve_signatures"


def export_vectors(
    catalogue: Catalogue,
    url: str,
    options: PipelineOptions | None = None,
    *,
    shape_ids: Sequence[str] = (),
    table: str = VECTOR_TABLE,
) -> int:
    """Write whitened log-signatures to a table of a PostgreSQL server with the extension pgvector.

    Their Euclidean distance, the operator ``<->`` of pgvector, is the distance ``log`` of `SignatureIndex`:
    ``ORDER BY signature <-> query, id`` gives its order, except where distances are equal in single
    precision. A column without an index of pgvector is searched exactly.
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
