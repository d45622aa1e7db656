"""Rankings of labelled shapes → retrieval measures.

In come a catalogue, a table of signatures or a distance matrix, with the classes of the shapes; rankings,
measures and precision–recall curves go out.
"""

from pcretrieve.evaluation.comparison import Comparison
from pcretrieve.evaluation.front import Evaluation, calibrate, compare, evaluate, matrix
from pcretrieve.evaluation.measures import RetrievalMeasures
from pcretrieve.evaluation.rankings import rank_table

__all__ = [
    "Comparison",
    "Evaluation",
    "RetrievalMeasures",
    "calibrate",
    "compare",
    "evaluate",
    "matrix",
    "rank_table",
]
