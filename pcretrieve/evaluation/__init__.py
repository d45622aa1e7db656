"""Rankings of labelled shapes → retrieval measures.

In come a catalogue, a table of signatures or a distance matrix, with the classes of the shapes; rankings,
measures and precision–recall curves go out.
"""

from pcretrieve.evaluation.comparison import Comparison
from pcretrieve.evaluation.folds import evaluate_table, rank_table, rerank_table
from pcretrieve.evaluation.front import Evaluation, calibrate, compare, evaluate, matrix
from pcretrieve.evaluation.measures import RetrievalMeasures
from pcretrieve.evaluation.rankings import rank_gallery

__all__ = [
    "Comparison",
    "Evaluation",
    "RetrievalMeasures",
    "calibrate",
    "compare",
    "evaluate",
    "evaluate_table",
    "matrix",
    "rank_gallery",
    "rank_table",
    "rerank_table",
]
