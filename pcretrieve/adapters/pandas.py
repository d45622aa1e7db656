"""Tables by pandas and Parquet files by pyarrow: columns in, tables out. Both are the extra ``tables``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pcretrieve.errors import InputError

__all__ = ["data_frame", "parquet_bytes"]

ADVICE = "tables need pandas and pyarrow: pip install 'pcretrieve[tables]'"


def data_frame(columns: Mapping[str, Sequence[object]], index: str | None = None) -> Any:
    """A table of named columns.

    Parameters
    ----------
    columns : mapping of str to sequence
        Columns of one length, in order.
    index : str, optional
        The column whose values are the index of the rows.

    Returns
    -------
    pandas.DataFrame
        One row for each entry of the columns.

    Raises
    ------
    InputError
        If pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise InputError(ADVICE) from error
    frame = pandas.DataFrame(dict(columns))
    return frame if index is None else frame.set_index(index)


def parquet_bytes(columns: Mapping[str, Sequence[object]], metadata: Mapping[str, str]) -> bytes:
    """A Parquet file of named columns.

    Parameters
    ----------
    columns : mapping of str to sequence
        Columns of one length, in order.
    metadata : mapping of str to str
        Key-value metadata of the schema of the file.

    Returns
    -------
    bytes
        The content of the file.

    Raises
    ------
    InputError
        If pyarrow is not installed.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise InputError(ADVICE) from error
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(dict(columns)).replace_schema_metadata(dict(metadata)), sink)
    return bytes(sink.getvalue().to_pybytes())
