"""Tables by pandas and Parquet files by pyarrow: columns in, tables out. Both are the extra ``tables``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pcretrieve.errors import InputError

__all__ = ["data_frame", "parquet_bytes"]

ADVICE = "tables need pandas and pyarrow: pip install 'pcretrieve[tables]'"


def data_frame(columns: Mapping[str, Sequence[object]], index: str | None = None) -> Any:
    """A table of named columns.

    columns: columns of one length, in order.
    """
    try:
        import pandas
    except ImportError as error:
        raise InputError(ADVICE) from error
    frame = pandas.DataFrame(dict(columns))
    return frame if index is None else frame.set_index(index)


def parquet_bytes(columns: Mapping[str, Sequence[object]], metadata: Mapping[str, str]) -> bytes:
    """A Parquet file of named columns.

    columns: columns of one length, in order.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise InputError(ADVICE) from error
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(dict(columns)).replace_schema_metadata(dict(metadata)), sink)
    return bytes(sink.getvalue().to_pybytes())
