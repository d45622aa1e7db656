"""Rankings → CSV files: measures of queries and classes, confusions, and the precision–recall curve."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from pcretrieve.atomic import write_file
from pcretrieve.csv_text import csv_text
from pcretrieve.errors import InputError
from pcretrieve.evaluation.classes import class_measures, confusion
from pcretrieve.evaluation.measures import MEASURES, QueryScores, precision_recall, query_scores
from pcretrieve.evaluation.rankings import Rankings

__all__ = ["read_scores", "write_evaluation"]

# Columns of the file of queries, and the attributes of `QueryScores` in the same order.
SCORES = (*MEASURES[:-1], "ap")

# What the column of shapes without a class is named in the file of confusions.
NO_CLASS = ""


def write_evaluation(ranked: Rankings, folder: str | Path) -> tuple[Path, ...]:
    """Write the measures of an evaluation as CSV files."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}") from error
    scores = query_scores(ranked)
    confused = confusion(ranked)
    queries = zip(
        scores.ids,
        scores.labels,
        *scores.columns.T.tolist(),
        ranked.nearest,
        ranked.nearest_labels,
        strict=True,
    )
    files: dict[str, tuple[Sequence[object], Iterable[Sequence[object]]]] = {
        "queries.csv": (("id", "label", *SCORES, "nearest", "nearest_label"), queries),
        "classes.csv": (
            ("label", "n_queries", *MEASURES),
            ((one.label, one.n_queries, *one.means.tolist()) for one in class_measures(ranked)),
        ),
        "confusion.csv": (
            ("label", *(NO_CLASS if label is None else label for label in confused.nearest)),
            (
                (label, *counts)
                for label, counts in zip(confused.labels, confused.counts.tolist(), strict=True)
            ),
        ),
        "precision_recall.csv": (
            ("recall", "precision"),
            zip(*(column.tolist() for column in precision_recall(ranked)), strict=True),
        ),
    }
    paths = []
    for name, (header, rows) in files.items():
        paths.append(folder / name)
        write_file(folder / name, csv_text(header, rows).encode("utf-8", errors="surrogateescape"))
    return tuple(paths)


def read_scores(path: str | Path) -> QueryScores:
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
        raise InputError(f"{path} must have each query once, got {len(ids)} rows of {len(set(ids))} queries")
    if not all(((column >= 0) & (column <= 1)).all() for column in columns):
        raise InputError(f"the measures in {path} must lie between 0 and 1, got others")
    return QueryScores(ids, labels, *columns)
