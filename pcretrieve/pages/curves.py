"""Rows of numbers → curves in the unit square of an SVG, whose y axis points down."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pcretrieve.values import FloatArray

__all__ = ["Curves", "curves"]


class Curves(NamedTuple):
    """Curves with common axes."""

    lines: list[str]
    lowest: float
    highest: float
    n: int


def curves(rows: Sequence[FloatArray]) -> Curves:
    """Draw rows of numbers as curves with common axes.

    rows: sequence of (n,) float64, at least one row, of finite values; rows may have different lengths.
    """
    every = np.concatenate([np.asarray(row, dtype=np.float64) for row in rows])
    lowest, highest = float(every.min()), float(every.max())
    n, height = max(len(row) for row in rows), (highest - lowest) or 1.0

    def line(row: FloatArray) -> str:
        across = (np.arange(len(row)) + 0.5) / n
        return " ".join(f"{x:.4f},{y:.4f}" for x, y in zip(across, (highest - row) / height, strict=True))

    return Curves([line(row) for row in rows], lowest, highest, n)
