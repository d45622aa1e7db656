"""The measures of two results for the same queries → their differences, with confidence intervals.

A result is how a catalogue, a distance matrix or other settings rank the shapes. The differences of each
query are resampled, so that what makes a query easy or hard for both results does not widen the intervals.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcretrieve.catalogue import CatalogueLike
from pcretrieve.errors import InputError
from pcretrieve.evaluation import measures
from pcretrieve.evaluation.rankings import Rankings, rank_shapes
from pcretrieve.options import OptionsLike
from pcretrieve.retrieval import DistanceMatrix, ids_path, read_matrix
from pcretrieve.values import FloatArray
from pcretrieve.values.base import Value
from pcretrieve.values.files import check_no_links, csv_text, make_folder, write_file

# Columns of the file of queries, and the attributes of `QueryScores` in the same order.
SCORES = (*measures.MEASURES[:-1], "ap")
# The first bytes of the file of a catalogue.
SQLITE = b"SQLite format 3"


class Change(NamedTuple):
    """The average precision of one query in both results."""

    shape_id: str
    label: str
    first: float
    second: float


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Value):
    """Two results for the same queries. The six measures are in the order of `MEASURES`.

    first, second: (6,) float64, means over the queries that both results have.
    difference: (6,) float64, second minus first.
    interval: (2, 6) float64, lower and upper ends of the confidence intervals of the differences.
    """

    first: FloatArray
    second: FloatArray
    difference: FloatArray
    interval: FloatArray
    level: float
    changes: tuple[Change, ...]
    only_first: tuple[str, ...]
    only_second: tuple[str, ...]


def compare_scores(
    first: measures.QueryScores, second: measures.QueryScores
) -> Comparison:
    """Compare two results query by query."""
    row = {shape_id: number for number, shape_id in enumerate(second.ids)}
    pairs = [
        (a, row[shape_id]) for a, shape_id in enumerate(first.ids) if shape_id in row
    ]
    if not pairs:
        raise InputError(
            f"two results must have queries in common, got none of {len(first.ids)} and {len(second.ids)}: "
            "compare results of the same shapes"
        )
    if differing := [
        first.ids[a] for a, b in pairs if first.labels[a] != second.labels[b]
    ]:
        raise InputError(
            f"a query must have the same class in both results, {len(differing)} have another, such as "
            f"{', '.join(differing[:3])}: give both the same labels"
        )
    changes = [
        Change(first.ids[a], first.labels[a], float(first.ap[a]), float(second.ap[b]))
        for a, b in pairs
    ]
    changes.sort(key=lambda change: (-abs(change.second - change.first), change.shape_id))
    rows, others = map(list, zip(*pairs, strict=True))
    common = {first.ids[a] for a in rows}
    one, two = first.columns[rows], second.columns[others]  # (Q, 6)
    return Comparison(
        first=one.mean(axis=0),
        second=two.mean(axis=0),
        difference=(two - one).mean(axis=0),
        interval=measures.bootstrap_interval(two - one),
        level=measures.LEVEL,
        changes=tuple(changes),
        only_first=tuple(shape_id for shape_id in first.ids if shape_id not in common),
        only_second=tuple(shape_id for shape_id in second.ids if shape_id not in common),
    )


def write_evaluation(
    ranked: Rankings, folder: str | Path, points: Sequence[measures.CurvePoint]
) -> tuple[Path, ...]:
    """Write the measures of an evaluation, and the points of its curve, as CSV files."""
    folder = make_folder(Path(folder))
    scores, confused, curve = (
        measures.query_scores(ranked),
        measures.confusion(ranked),
        measures.precision_recall(ranked),
    )
    near = ranked.nearest, ranked.nearest_labels
    files: dict[str, tuple[Sequence[object], Iterable[Sequence[object]]]] = {
        "queries.csv": (
            ("id", "label", *SCORES, "nearest", "nearest_label"),
            zip(
                scores.ids, scores.labels, *scores.columns.T.tolist(), *near, strict=True
            ),
        ),
        "classes.csv": (
            ("label", "n_queries", *measures.MEASURES),
            (
                (one.label, one.n_queries, *one.means.tolist())
                for one in measures.class_measures(ranked)
            ),
        ),
        "confusion.csv": (
            ("label", *(label or "" for label in confused.nearest)),
            zip(confused.labels, *confused.counts.T.tolist(), strict=True),
        ),
        "precision_recall.csv": (
            curve._fields,
            zip(*(column.tolist() for column in curve), strict=True),
        ),
    }
    if rates := measures.verification(ranked.genuine, ranked.impostor):
        files["det.csv"] = (
            rates._fields,
            zip(*(column.tolist() for column in rates), strict=True),
        )
    names = [part.name for part in fields(measures.CurvePoint)]
    files["curve.csv"] = names, map(astuple, points)
    paths = tuple(folder / name for name in files)
    check_no_links(paths)
    for path, (header, rows) in zip(paths, files.values(), strict=True):
        write_file(path, csv_text(header, rows).encode("utf-8", errors="surrogateescape"))
    return paths


def read_scores(path: str | Path) -> measures.QueryScores:
    """Read the measures of each query."""
    try:
        text = Path(path).read_bytes().decode("utf-8", errors="surrogateescape")
        rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
        ids = tuple(row["id"] for row in rows)
        labels = tuple(row["label"] for row in rows)
        columns = [np.array([float(row[name]) for row in rows]) for name in SCORES]
    except OSError as error:
        raise InputError(f"cannot read the measures {path}: {error.strerror}") from error
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(
            f"{path} must have the columns id, label, {', '.join(SCORES)}, as queries.csv of `pcretrieve "
            f"evaluate --csv` ({error!r})"
        ) from error
    if not ids or len(set(ids)) != len(ids):
        raise InputError(
            f"{path} must have each query once, got {len(ids)} rows of {len(set(ids))} queries"
        )
    if not all(((column >= 0) & (column <= 1)).all() for column in columns):
        raise InputError(f"the measures in {path} must lie between 0 and 1, got others")
    return measures.QueryScores(ids, labels, *columns)


def result_scores(
    result: CatalogueLike | DistanceMatrix,
    options: OptionsLike = None,
    labels: str | Path | None = None,
) -> measures.QueryScores:
    """The measures of each query of a catalogue, a distance matrix or a file."""
    if isinstance(result, (str, Path)) and Path(result).suffix.lower() == ".csv":
        return read_scores(result)
    if isinstance(result, (str, Path)) and _is_matrix(Path(result)):
        result = read_matrix(result)
    return measures.query_scores(rank_shapes(result, options, labels).rankings)


def _is_matrix(path: Path) -> bool:
    """Whether a file is a distance matrix: its ids are beside it, and it is no SQLite file."""
    if not path.is_file() or not ids_path(path).is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(SQLITE)) != SQLITE
