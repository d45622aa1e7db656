"""Signatures, tables of them, and the neighbours that a search finds."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray
from pcretrieve.errors import InputError
from pcretrieve.values.base import SizeUnit, Value, check_type
from pcretrieve.values.files import csv_text, parquet_bytes, write_file

# How the values of two signatures are compared: by their logarithms, for positive values; as they are, for
# any; or as histograms, whose bins are not negative.
Metric = Literal["logarithms", "values", "histograms"]

# Values of a signature that its representation shows, and neighbours that a notebook shows with pictures.
N_SHOWN = 3
N_PICTURED = 10

# Suffixes of files of signatures.
SUFFIXES = (".npz", ".parquet", ".csv")

# Coordinates of a signature by its metric, of whose differences distances are functions.
COORDINATES: dict[str, Callable[..., FloatArray]]
COORDINATES = {"logarithms": np.log, "values": np.asarray, "histograms": np.sqrt}


@dataclass(frozen=True, slots=True, eq=False)
class Signature(Value):
    """A global shape descriptor: a short vector, invariant to isometric deformation of the surface.

    Attributes
    ----------
    values : (L,) float64
        Dimensionless, except for the scale ``absolute``. In the order stated by the method; the size, if it
        has a weight, is the last value.
    kind : str
        The method, such as ``r-bihdm``.
    digest : str
        Hash of the options; two signatures are comparable only if both their kinds and their digests are
        equal.
    errors : (L,) float64 or None
        Error bar: standard deviation (ddof = 1) of each value over the surfaces reconstructed from one scan;
        for the metric ``logarithms``, of its logarithm. None if there is one surface only.
    metric : {"logarithms", "values", "histograms"}, default "logarithms"
        How two signatures of this kind are compared: by the logarithms of their values, which are positive;
        by the values as they are; or as histograms, whose bins are not negative.
    unit : {"m", "unknown"} or None
        Unit of length of the values, if they depend on the size of the body (scale ``absolute``, or a weight
        of the size): metres, or that of a file whose unit is unknown. None if no value depends on the size.
        Signatures are comparable only if it is equal.
    """

    values: FloatArray
    kind: str
    digest: str = ""
    errors: FloatArray | None = None
    metric: Metric = "logarithms"
    unit: SizeUnit | None = None

    def __post_init__(self) -> None:
        _check_unit(self.unit)
        _check_metric(self._lock("values", (None,)), self.metric)
        if self.errors is not None:
            self._lock("errors", (len(self.values),))

    def __len__(self) -> int:
        return len(self.values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        error = (
            ""
            if self.errors is None
            else f", error up to {self.errors.max(initial=0):.2g}"
        )
        shown = ", ".join(f"{value:.4g}" for value in self.values[:N_SHOWN])
        more = ", ..." if len(self.values) > N_SHOWN else ""
        return f"Signature({self.kind}, {len(self.values)} values [{shown}{more}]{error})"

    def distance(self, other: Signature) -> float:
        """The distance ``log`` to a signature by the same options, without whitening; else InputError."""
        check_type("the other signature", other, Signature)
        made, others = (
            (one.kind, one.digest, one.metric, one.unit) for one in (self, other)
        )
        if made != others:
            raise InputError(
                f"signatures must be made by the same options, got {made} and {others}"
            )
        first, second = (COORDINATES[self.metric](one.values) for one in (self, other))
        return float(np.sqrt(((first - second) ** 2).sum()))

    def plot(self, axes: Any = None) -> Any:
        """Draw values and error bars by matplotlib (the extra ``plot``), into `axes` or new ones."""
        from pcretrieve.draw.plot import plot_signature

        errors = self.errors if self.metric == "logarithms" else None
        return plot_signature(self.values, self.kind, errors, axes)


@dataclass(frozen=True, slots=True, eq=False)
class SignatureTable(Value):
    """Signatures of many shapes, of one kind.

    Attributes
    ----------
    ids : tuple of str, length N
        Identifiers of the shapes, distinct.
    values : (N, L) float64
        One signature in each row, in the units of `Signature`.
    kind, digest, metric, unit
        Method, hash of the options, metric, and unit of the sizes, as in `Signature`.
    labels : tuple of (str or None), length N
        Class of each shape; None if unknown.
    """

    ids: tuple[str, ...]
    values: FloatArray
    kind: str
    digest: str = ""
    labels: tuple[str | None, ...] = ()
    metric: Metric = "logarithms"
    unit: SizeUnit | None = None

    def __post_init__(self) -> None:
        _check_unit(self.unit)
        object.__setattr__(self, "ids", tuple(self.ids))
        n = len(self.ids)
        if len(set(self.ids)) != n:
            raise InputError("ids must be distinct")
        _check_metric(self._lock("values", (n, None)), self.metric)
        object.__setattr__(self, "labels", tuple(self.labels) or (None,) * n)
        if len(self.labels) != n:
            raise InputError(
                f"labels must be as many as ids ({n}), got {len(self.labels)}"
            )

    def __len__(self) -> int:
        return len(self.ids)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        n_classes = len({label for label in self.labels if label is not None})
        return (
            f"SignatureTable({self.kind}, {len(self):,} shapes of {n_classes:,} classes, "
            f"{self.values.shape[1]} values each)"
        )

    @property
    def has_one_unit(self) -> bool:
        """Whether all coordinates have one unit, as those of fused descriptors, divided by their spreads."""
        return self.metric != "values" or "+" in self.kind

    def select(self, ids: Sequence[str]) -> SignatureTable:
        """The signatures of some shapes, in the order of `ids`; InputError if the table lacks one."""
        rows = {shape_id: row for row, shape_id in enumerate(self.ids)}
        if unknown := [shape_id for shape_id in ids if shape_id not in rows]:
            raise InputError(f"there is no signature of the shape {unknown[0]!r}")
        chosen = [rows[shape_id] for shape_id in ids]
        labels = tuple(self.labels[row] for row in chosen)
        return replace(self, ids=tuple(ids), values=self.values[chosen], labels=labels)

    def columns(self) -> dict[str, list[Any]]:
        """The table by columns: ``id``, ``label``, and one column ``v1``, ``v2``, ... for each value."""
        values = {
            f"v{number}": column.tolist()
            for number, column in enumerate(self.values.T, start=1)
        }
        return {"id": list(self.ids), "label": list(self.labels), **values}

    def to_pandas(self) -> Any:
        """A ``pandas.DataFrame`` (the extra ``tables``) with the columns of `columns`, indexed by id."""
        from pcretrieve.values.files import data_frame

        return data_frame(self.columns(), index="id")


def _check_unit(unit: SizeUnit | None) -> None:
    if unit not in (None, *get_args(SizeUnit)):
        raise InputError(
            f"the unit of sizes must be None, 'm' or 'unknown', got {unit!r}"
        )


def _check_metric(values: FloatArray, metric: Metric) -> None:
    """Refuse values of signatures that the metric cannot compare."""
    if metric not in get_args(Metric):
        raise InputError(
            f"metric must be one of {', '.join(get_args(Metric))}, got {metric!r}"
        )
    smallest = values.min(initial=np.inf)
    if metric == "logarithms" and smallest <= 0:
        raise InputError(f"signature values must be positive, got {smallest}")
    if metric == "histograms" and smallest < 0:
        raise InputError(f"the bins of a histogram must not be negative, got {smallest}")


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
    if suffix not in SUFFIXES:
        raise InputError(
            f"a file of signatures must end in one of {' '.join(SUFFIXES)}, got {path.name}"
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


@dataclass(frozen=True, slots=True, eq=False)
class Neighbors(Value):
    """The nearest neighbours of one query.

    Attributes
    ----------
    ids : tuple of str, length k
        Identifiers of the shapes, distinct, nearest first; equally near shapes in alphabetical order.
    distances : (k,) float64
        Distances to the query, not negative, ascending; dimensionless. May be infinite.
    scores : (k,) float64 or None
        Calibrated score of each distance: the share of pairs of one class among all pairs that are as near,
        or of mutual neighbours where there are no labels. After re-ranking, that of the original distance.
        None if it is not known. Two lists are equal whatever their scores.
    pictures : function or None
        Of some ids, their thumbnails for notebooks: PNG files, or None for shapes without one.
    """

    ids: tuple[str, ...]
    distances: FloatArray
    scores: FloatArray | None = field(default=None, compare=False)
    pictures: Callable[[Sequence[str]], Sequence[bytes | None]] | None = field(
        default=None, compare=False
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", tuple(self.ids))
        distances = self._lock("distances", (len(self.ids),), finite=False)
        if len(set(self.ids)) != len(self.ids):
            raise InputError("ids must be distinct")
        if not ((distances >= 0).all() and (distances[:-1] <= distances[1:]).all()):
            raise InputError(
                "distances must ascend from 0 or more, got others; sort the shapes by distance"
            )
        tied = distances[:-1] == distances[1:]
        if any(tie and self.ids[i] > self.ids[i + 1] for i, tie in enumerate(tied)):
            raise InputError(
                "ids of equally distant shapes must be in alphabetical order, got another one"
            )
        if self.scores is not None:
            self._lock("scores", (len(self.ids),))

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        found = ", ".join(
            f"{name} {gap:.4g}"
            for name, gap in zip(self.ids, self.distances, strict=True)
        )
        return f"Neighbors({found})"

    def _repr_html_(self) -> str:
        from pcretrieve.draw.pictures import picture_html

        pictures = (
            self.pictures(self.ids[:N_PICTURED]) if self.pictures else [None] * len(self)
        )
        return "".join(
            map(picture_html, pictures, map("{} {:.4g}".format, self.ids, self.distances))
        )

    def to_pandas(self) -> Any:
        """A ``pandas.DataFrame`` (extra ``tables``) indexed by rank: id, distance, and the score if known."""
        from pcretrieve.values.files import data_frame

        columns = {
            "rank": range(1, len(self) + 1),
            "id": self.ids,
            "distance": self.distances,
        }
        scores = {} if self.scores is None else {"score": self.scores}
        return data_frame(columns | scores, index="rank")
