"""A point cloud, a mesh, or a table of signatures → a file."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pcretrieve.errors import InputError
from pcretrieve.formats.registry import FORMATS
from pcretrieve.values import PointCloud, SignatureTable, TriangleMesh
from pcretrieve.values.conversion import GeometryLike, as_cloud, as_mesh
from pcretrieve.values.files import check_target, csv_text, parquet_bytes, write_file

SIGNATURE_SUFFIXES = (".npz", ".parquet", ".csv")

Kind = Literal["point", "mesh"]


def write_cloud(cloud: GeometryLike, path: str | Path) -> None:
    """Write points with their normals and the positions of their sensors, in one atomic step.

    Parameters
    ----------
    cloud : GeometryLike
        The points; their unit is that of the file.
    path : str or Path
        The file. ``.ply`` (double precision) and ``.pcd`` (single precision) store the position of the sensor
        of each point in fields ``vp_x vp_y vp_z``, as PCL's PointWithViewpoint. ``.xyzn`` stores points and
        normals with nine digits. An existing file is replaced.

    Raises
    ------
    InputError
        If no format of the suffix stores point clouds, it is ``.xyzn`` and the points have no normals, or the
        file cannot be written.
    """
    _write(as_cloud(cloud), Path(path), "point")


def write_mesh(mesh: GeometryLike, path: str | Path) -> None:
    """Write a mesh, in one atomic step.

    Parameters
    ----------
    mesh : GeometryLike
        The mesh, of this package or another (see `as_mesh`); its unit is that of the file.
    path : str or Path
        The file, with one of the suffixes ``.ply .obj .off .stl .glb``. An existing file is replaced.

    Raises
    ------
    InputError
        If no format of the suffix stores meshes, or the file cannot be written.
    """
    _write(as_mesh(mesh), Path(path), "mesh")


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


def check_output(
    path: Path, sources: Sequence[Path] = (), kind: Kind | None = None
) -> None:
    """Check, before a long computation, that its result can be written."""
    if kind is not None:
        _writer(path, kind)
    check_target(path, sources)


def _write(value: PointCloud | TriangleMesh, path: Path, kind: Kind) -> None:
    suffix, write = path.suffix.lower(), _writer(path, kind)
    try:
        data = write(value)
    except (InputError, MemoryError):
        raise
    except Exception as error:
        if suffix in FORMATS.own:
            raise
        raise InputError(
            f"{FORMATS.called(suffix)} failed, {type(error).__name__}: {error}"
        ) from error
    write_file(path, data)


def _writer(path: Path, kind: Kind) -> Callable[[Any], bytes]:
    """The function that makes the content of a file; InputError if there is none."""
    suffix, name = path.suffix.lower(), "write_cloud" if kind == "point" else "write_mesh"
    write: Callable[[Any], bytes] | None = None
    if suffix in FORMATS.names.all():
        write = getattr(FORMATS[suffix], name)
    if write is None:
        known = " ".join(
            suffix for suffix, found in FORMATS.own.items() if getattr(found, name)
        )
        raise InputError(f"a {kind} file must end in one of {known}, got {path.name}")
    return write
