"""The settings of a search, in words for readers of a page."""

from __future__ import annotations

from collections.abc import Collection

from pcretrieve.catalogue import Catalogue
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import PipelineOptions

__all__ = ["settings_in_words"]

DISTANCES = {
    "log": "log, the Euclidean distance of the logarithms of the values",
    "d1": "d1, the dissimilarity D1 of Ye and Yu",
    "d2": "d2, the dissimilarity D2 of Ye and Yu",
}


def settings_in_words(
    catalogue: Catalogue,
    options: PipelineOptions,
    matrix: DistanceMatrix | None = None,
    labels: Collection[str] | None = None,
    min_score: float | None = None,
) -> dict[str, str]:
    """How shapes are compared, in words."""
    classes = f"the class {' or '.join(sorted(labels))} of " if labels else ""
    least = {} if min_score is None else {"least score": f"{min_score:g}"}
    if matrix is not None:
        return {"searched": f"{classes}{len(matrix)} shapes", "distance": "that of a matrix"} | least
    index = catalogue.index(options)
    compared, retrieval, scores = options.compared, options.retrieval, index.scores
    size = compared.size_weight
    return {
        "searched": f"{classes}{len(index)} shapes",
        "signature": f"{compared.method}, {len(index.whitening.mean)} values, "
        + (f"with the size, weighted by {size:g}" if size else "of the form alone"),
        "distance": DISTANCES.get(retrieval.distance, retrieval.distance),
        "whitening": catalogue.whitening(options).reason,
        "re-ranking": "none" if retrieval.rerank == "none" else f"by {retrieval.rerank} neighbours",
        "score": scores.reason if scores else "none, because labels and shapes are too few",
    } | least
