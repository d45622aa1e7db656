"""The figures of one set under one condition with one choice of options."""

from __future__ import annotations

import csv
import io
import json
import statistics
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcretrieve.atomic import write_file
from pcretrieve.benchmarks.fidelity.examination import Signatures
from pcretrieve.benchmarks.sets import Item
from pcretrieve.benchmarks.tables import Column, Table, is_missing
from pcretrieve.errors import InputError
from pcretrieve.evaluation import evaluate_table
from pcretrieve.options import PipelineOptions, RetrievalOptions, WhiteningKind
from pcretrieve.retrieval import log_signatures, resolution_whitening
from pcretrieve.retrieval.resolution import is_measured
from pcretrieve.values import FloatArray, SignatureTable

__all__ = ["NAN", "TABLE", "Retrieval", "Row", "append", "mean", "median", "relative_spread", "retrieval"]

NAN = float("nan")


class Retrieval(NamedTuple):
    """Nearest-neighbour score and mean average precision (mAP) of some signatures.

    Attributes
    ----------
    nn, map : float
        By the options of the configuration, without whitening.
    nn_relative, map_relative : float
        Relative to the first value, without whitening.
    nn_pca, map_pca : float
        60 values, relative to the first, with PCA whitening.
    nn_within, map_within : float
        With within-class whitening by grouped folds; the only one of these whitenings that needs labels.
    nn_sized, map_sized : float
        With the size as a further value, without whitening.
    nn_resolution, map_resolution : float
        With the whitening ``resolution``.
    """

    nn: float
    map: float
    nn_relative: float
    map_relative: float
    nn_pca: float
    map_pca: float
    nn_within: float
    map_within: float
    nn_sized: float
    map_sized: float
    nn_resolution: float
    map_resolution: float


@dataclass(frozen=True, slots=True)
class Row:
    """One set under one condition with one choice of options: the columns of the CSV file.

    Fractions are relative to all scans, including scans that failed, except for `normals_right`. Distances
    are relative to the diagonal; distances and seconds are medians over the scans that did not fail. Errors
    are of log-signatures with the scale relative; the spread of rescans is of signatures by the options of
    the configuration. Values that were not or cannot be measured are NaN.
    """

    set: str
    condition: str
    name: str
    digest: str
    scans: int
    failed: int
    normals_right: float
    closed: float
    euler_right: float
    distance_mean: float
    distance_hausdorff: float
    log_error_median: float
    log_error_mean: float
    nn: float
    map: float
    nn_within: float
    map_within: float
    clean_nn: float
    clean_map: float
    clean_nn_within: float
    clean_map_within: float
    seconds: float
    stages: str
    peak_mib: float
    rescan_spread: float
    textbook_seconds: float
    textbook_ratio: float
    nn_relative: float
    map_relative: float
    nn_pca: float
    map_pca: float
    clean_nn_relative: float
    clean_map_relative: float
    clean_nn_pca: float
    clean_map_pca: float
    nn_resolution: float
    map_resolution: float
    clean_nn_resolution: float
    clean_map_resolution: float
    nn_sized: float
    map_sized: float
    clean_nn_sized: float
    clean_map_sized: float
    processor_seconds: float

    def lines(self) -> Iterator[str]:
        """A line of `TABLE`, and further lines with the values that are not in the table."""
        values = asdict(self)
        yield TABLE.row(*(values[name] for name in SHOWN))
        yield (
            f"    clean meshes: NN {self.clean_nn:.3f}, mAP {self.clean_map:.3f}, "
            f"within-class NN {self.clean_nn_within:.3f}, mAP {self.clean_map_within:.3f}"
        )
        stages = json.loads(self.stages)
        total = sum(stages.values())
        yield "    " + ", ".join(f"{stage} {s:.2f} s ({s / total:.1%})" for stage, s in stages.items())
        if not is_missing(self.processor_seconds):
            yield f"    processor time of a scan: {self.processor_seconds:.2f} s"
        if not is_missing(self.rescan_spread):
            yield f"    spread of rescans / distance to the nearest other class: {self.rescan_spread:.3f}"
        if not is_missing(self.textbook_ratio):
            ratio = f"{self.textbook_ratio:.1f} times as long as pcretrieve"
            yield f"    textbook: median {self.textbook_seconds:.1f} s, {ratio}"


# Columns that are printed.
SHOWN = {
    "condition": Column("condition", 23, align="<"),
    "name": Column("options", 12, align="<"),
    "scans": Column("scans", 8),
    "failed": Column("failed", 8),
    "normals_right": Column("normals", 8, ".2%"),
    "closed": Column("closed", 8, ".1%"),
    "euler_right": Column("Euler", 8, ".1%"),
    "distance_mean": Column("distance", 8, ".3%"),
    "distance_hausdorff": Column("Hausd.", 8, ".2%"),
    "log_error_median": Column("log err", 8, ".3f"),
    "log_error_mean": Column("(mean)", 8, ".3f"),
    "nn": Column("NN", 8, ".3f"),
    "map": Column("mAP", 8, ".3f"),
    "nn_relative": Column("rel. NN", 8, ".3f"),
    "map_relative": Column("rel. mAP", 8, ".3f"),
    "nn_pca": Column("pca NN", 8, ".3f"),
    "map_pca": Column("pca mAP", 8, ".3f"),
    "nn_within": Column("w-c NN", 8, ".3f"),
    "map_within": Column("w-c mAP", 8, ".3f"),
    "nn_resolution": Column("res. NN", 8, ".3f"),
    "map_resolution": Column("res. mAP", 8, ".3f"),
    "nn_sized": Column("size NN", 8, ".3f"),
    "map_sized": Column("size mAP", 8, ".3f"),
    "seconds": Column("time/s", 8, ".2f"),
    "peak_mib": Column("MiB", 8, ".0f"),
}
TABLE = Table(*SHOWN.values())


def append(path: Path, row: Row) -> None:
    """Append a row to a CSV file. If the file does not exist, the header is written first.

    Parameters
    ----------
    path : Path
        The file.
    row : Row
        The row.
    """
    before = path.read_bytes() if path.exists() else b""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, [field.name for field in fields(Row)], lineterminator="\n")
    if not before:
        writer.writeheader()
    writer.writerow(asdict(row))
    write_file(path, before + text.getvalue().encode())


def retrieval(
    known: Signatures, items: Sequence[Item], rows: Sequence[int], options: PipelineOptions
) -> Retrieval:
    """Retrieval measures of the items of a set.

    Parameters
    ----------
    known : Signatures
        Signatures of the items at `rows`.
    items : sequence of Item
        The whole set.
    rows : sequence of int
        Positions in `items`; the items at other positions failed, and count as misses.
    options : PipelineOptions
        Options of the signatures.

    Returns
    -------
    Retrieval
        The measures. NaN if a whitening is not defined, or needs more classes of two shapes than there are.
    """
    labels = [item.label for item in items]
    failed = {f"failed {k}": labels[k] for k in set(range(len(items))).difference(rows)}
    names, classes = tuple(items[k].name for k in rows), tuple(labels[k] for k in rows)
    ways: list[tuple[WhiteningKind, FloatArray]] = [
        ("none", known.values),
        ("none", known.relative),
        ("pca", known.longer),
        ("within-class", known.values),
        ("none", known.sized),
    ]
    form = options.changed(signature={"size_weight": 0}).signature
    if is_measured(form):
        ways.append(("resolution", known.values))
    found = []
    for whitening, values in ways:
        table = SignatureTable(names, values, kind="scan", labels=classes)
        try:
            made = resolution_whitening(form) if whitening == "resolution" else None
            chosen = RetrievalOptions(whitening=whitening)
            measures = evaluate_table(table, chosen, whitening=made, failed=failed)
            found += [measures.nn, measures.map]
        except InputError:
            found += [NAN, NAN]
    return Retrieval(*found, *[NAN] * (len(Retrieval._fields) - len(found)))


def relative_spread(repeats: list[list[FloatArray]], values: FloatArray, labels: list[str]) -> float:
    """Spread of the signatures of repeated scans, relative to the distance of the nearest other class.

    Parameters
    ----------
    repeats : list of lists of (L,) float64
        Signatures of the repeated scans of some bodies, a list for each body.
    values : (n, L) float64
        Signatures of one scan of every body.
    labels : list of str, length n
        Classes of the bodies.

    Returns
    -------
    float
        Median distance of a repeated scan's log-signature from the mean of its body, over the median
        distance from a body to the nearest body of another class.
    """
    logs = [log_signatures(np.array(own)) for own in repeats if own]  # (r, L) each
    within = [d for own in logs for d in np.linalg.norm(own - own.mean(axis=0), axis=1).tolist()]
    everybody, classes = log_signatures(values), np.array(labels)
    between = np.linalg.norm(everybody[:, None] - everybody, axis=2)  # (n, n)
    between[classes[:, None] == classes] = np.inf
    return median(within) / median(between.min(axis=1, initial=np.inf).tolist())


def mean(values: Iterable[float]) -> float:
    """Arithmetic mean.

    Parameters
    ----------
    values : iterable of float
        Any number of values.

    Returns
    -------
    float
        The mean; NaN if there are no values.
    """
    found = list(values)
    return statistics.fmean(found) if found else NAN


def median(values: Iterable[float]) -> float:
    """Median.

    Parameters
    ----------
    values : iterable of float
        Any number of values.

    Returns
    -------
    float
        The median; NaN if there are no values.
    """
    found = list(values)
    return statistics.median(found) if found else NAN
