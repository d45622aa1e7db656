"""Rankings of labelled shapes → retrieval measures.

In come a catalogue, a table of signatures or a distance matrix, with the classes of the shapes; rankings,
measures and precision–recall curves go out.
"""

from pcretrieve.evaluation.comparison import Comparison
from pcretrieve.evaluation.front import (
    Evaluation,
    Evaluations,
    calibrate,
    compare,
    evaluate,
    evaluate_methods,
    matrix,
)
from pcretrieve.evaluation.measures import RetrievalMeasures
from pcretrieve.evaluation.rankings import rank_table

__all__ = [
    "Comparison",
    "Evaluation",
    "Evaluations",
    "RetrievalMeasures",
    "calibrate",
    "compare",
    "evaluate",
    "evaluate_methods",
    "matrix",
    "rank_table",
]
