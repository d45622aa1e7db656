"""Tables of signatures as files for other programs."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from pcretrieve.errors import InputError
from pcretrieve.values import SignatureTable
from pcretrieve.values.files import csv_text, parquet_bytes, write_file

__all__ = ["SIGNATURE_SUFFIXES", "write_signatures"]

SIGNATURE_SUFFIXES = (".npz", ".parquet", ".csv")


def write_signatures(table: SignatureTable, path: str | Path) -> None:
    """Write the signatures of many shapes with their ids and classes, in one atomic step.

    Parameters
    ----------
    table : SignatureTable
        The signatures.
    path : str or Path
        The file. ``.npz`` holds the arrays ``ids``, ``labels`` (empty where unknown), ``values`` (N, L),
        ``kind``, ``digest`` and ``unit`` (empty if no value depends on the size), none of them pickled.
        ``.parquet`` (the extra ``tables``) and ``.csv`` have the columns ``id``, ``label``, ``v1`` ...
        ``vL``; Parquet keeps ``kind``, ``digest`` and ``unit`` as metadata.

    Raises
    ------
    InputError
        If the suffix is not one of ``.npz .parquet .csv``, a package is missing, or the file cannot be
        written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SIGNATURE_SUFFIXES:
        raise InputError(
            f"a file of signatures must end in one of {' '.join(SIGNATURE_SUFFIXES)}, got {path.name}"
        )
    if suffix == ".parquet":
        made_by = {"kind": table.kind, "digest": table.digest, "unit": table.unit or ""}
        data = parquet_bytes(table.columns(), made_by)
    elif suffix == ".npz":
        file = io.BytesIO()
        np.savez(
            file,
            ids=np.array(table.ids, dtype=np.str_),
            labels=np.array([label or "" for label in table.labels], dtype=np.str_),
            values=table.values,
            kind=np.array(table.kind),
            digest=np.array(table.digest),
            unit=np.array(table.unit or ""),
        )
        data = file.getvalue()
    else:
        columns = table.columns()
        data = csv_text((*columns,), zip(*columns.values(), strict=True)).encode("utf-8")
    write_file(path, data)
