"""The results of a query as rows, with the names that commands and the search page give their columns."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from pcretrieve.searching.answers import Answer

__all__ = ["result_rows"]


def result_rows(answer: Answer) -> list[dict[str, Any]]:
    """The results of one query."""
    known, ranges = answer.neighbors.scores, answer.rank_ranges
    scores = [None] * len(answer.records) if known is None else known.tolist()
    return [
        {
            "rank": rank,
            "id": record.id,
            "path": record.path,
            "label": record.label,
            "distance": gap,
            "score": score,
            "rank_range": None if ranges is None else ranges[rank - 1].tolist(),
            "verdict": None if record.verdict is None else asdict(record.verdict),
        }
        for rank, (record, gap, score) in enumerate(
            zip(answer.records, answer.neighbors.distances.tolist(), scores, strict=True), start=1
        )
    ]
