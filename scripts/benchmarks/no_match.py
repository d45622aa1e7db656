"""How good the answer "no match" is: searches in galleries that lack half of the classes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import BenchmarkError
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import pairwise, table_whitening
from pcretrieve.retrieval.distances import table_coordinates
from pcretrieve.retrieval.scores import fit_scores
from pcretrieve.values import FloatArray, SignatureTable

# Share of the shapes of a class that are queries; the others are in the gallery, if the class is.
QUERIES = 1 / 3

# Least number of shapes of a class, so that a query has two shapes in the gallery, which form a pair.
SMALLEST = 3


@dataclass(frozen=True, slots=True)
class NoMatchMeasures:
    """How good the answer "no match" is.

    right: of these matches, the share of the class of the query; NaN if there are none.
    """

    precision: float
    recall: float
    matched: float
    right: float
    whitening: str
    n_queries: int


def no_match_measures(
    table: SignatureTable,
    options: RetrievalOptions | None = None,
    *,
    min_score: float = 0.9,
    labelled: bool = True,
    prior: FloatArray | None = None,
    n_draws: int = 10,
    seed: int = 0,
) -> NoMatchMeasures:
    """Search galleries of half of the classes for shapes of all classes, with a least score.

    A third of the shapes of each class are queries, which neither the whitening nor the scores are fitted to.

    prior: (L, L) float64, optional, as in `pcretrieve.retrieval.fit_whitening`.
    """
    options = options or RetrievalOptions()
    rng = np.random.default_rng(seed)
    used: set[str] = set()
    drawn = []
    for _ in range(n_draws):
        gallery, queries = _drawn(table, rng)
        ids = [table.ids[row] for row in gallery]
        shapes = table.select(ids)
        if not labelled:
            shapes = replace(shapes, labels=(None,) * len(ids))
        whitening = table_whitening(shapes, options, prior=prior)
        used.add(whitening.kind)
        scores = fit_scores(shapes, whitening, options)
        points = whitening.apply(table_coordinates(table, options.distance))
        distances = pairwise(options.distance, points[queries], points[gallery])
        nearest = distances.argmin(axis=1)
        labels = np.array(table.labels, dtype=object)
        ours, found = labels[queries], labels[gallery[nearest]]
        known = np.isin(ours.astype(str), labels[gallery].astype(str))
        # Without scores there is no match that is certain enough.
        score = np.zeros(len(queries)) if scores is None else scores.of(distances.min(axis=1))
        drawn.append(np.stack([known, score >= min_score, ours == found]).astype(bool))
    known, matched, same = np.concatenate(drawn, axis=1)

    def share(of: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
        return float(of[among].mean()) if among.any() else float("nan")

    return NoMatchMeasures(
        precision=share(~known, ~matched),
        recall=share(~matched, ~known),
        matched=share(matched, known),
        right=share(same, known & matched),
        whitening=" or ".join(sorted(used)),
        n_queries=len(known),
    )


def _drawn(table: SignatureTable, rng: np.random.Generator) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The rows of a gallery of half of the classes, and of queries of all classes."""
    labels = np.array(["" if label is None else label for label in table.labels])
    sizes = {label: int((labels == label).sum()) for label in sorted({*labels} - {""})}
    classes = [label for label, size in sizes.items() if size >= SMALLEST]
    if len(classes) < 2:
        raise BenchmarkError(
            f"classes can be left out of two classes of {SMALLEST} shapes or more, got {len(classes)}"
        )
    known = set(rng.permutation(classes)[: len(classes) // 2].tolist())
    gallery: list[int] = []
    queries: list[int] = []
    for label in classes:
        rows = rng.permutation(np.flatnonzero(labels == label)).tolist()
        n_queries = max(1, int(len(rows) * QUERIES))
        queries += rows[:n_queries]
        if label in known:
            gallery += rows[n_queries:]
    return np.array(sorted(gallery)), np.array(queries)
