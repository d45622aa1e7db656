"""Confusion matrix → what the template of the retrieval page draws of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pcretrieve.evaluation import Confusion

__all__ = ["ConfusionPicture", "confusion_picture"]

# Largest number of letters of a class beside the matrix, and the width of a letter relative to a cell.
MOST_LETTERS = 20
LETTER = 0.36


class Cell(NamedTuple):
    """A cell that is not empty: column, row, share of the row, whether it is right, and in words."""

    x: int
    y: int
    share: float
    right: bool
    words: str


class ConfusionPicture(NamedTuple):
    """A confusion matrix whose cells have side 1."""

    cells: list[Cell]
    rows: list[str]
    columns: list[str]
    margin: float
    n_right: int
    n: int


def confusion_picture(confusion: Confusion) -> ConfusionPicture:
    """Draw a confusion matrix."""
    counts = confusion.counts
    n_columns = len(confusion.nearest) - (not counts[:, -1].any())
    nearest = ["no class" if label is None else label for label in confusion.nearest[:n_columns]]
    totals = counts.sum(axis=1)
    cells = []
    for y, x in np.argwhere(counts).tolist():
        label, n = confusion.labels[y], int(counts[y, x])
        words = f"{label}: the nearest shape of {n} of {totals[y]} is {nearest[x]}"
        cells.append(Cell(x, y, n / float(totals[y]), confusion.nearest[x] == label, words))
    right = sum(int(counts[cell.y, cell.x]) for cell in cells if cell.right)
    rows, columns = [[_short(label) for label in labels] for labels in (confusion.labels, nearest)]
    margin = 0.5 + LETTER * max(map(len, rows + columns), default=0)
    return ConfusionPicture(cells, rows, columns, margin, right, int(counts.sum()))


def _short(label: str) -> str:
    return label if len(label) <= MOST_LETTERS else label[: MOST_LETTERS - 1] + "…"
