"""Rankings of labelled shapes → retrieval measures.

In come a catalogue, a table of signatures or a distance matrix, with the classes of the shapes; rankings,
measures and precision–recall curves go out.
"""

from pcretrieve.evaluation.catalogue import check_known
from pcretrieve.evaluation.comparison import (
    Comparison,
    compare_scores,
    read_scores,
    result_scores,
    write_evaluation,
)
from pcretrieve.evaluation.folds import evaluate_table, rank_table, rerank_table
from pcretrieve.evaluation.front import (
    PUBLISHED,
    Evaluation,
    Published,
    calibrate,
    compare,
    evaluate,
    matrix,
)
from pcretrieve.evaluation.measures import (
    MEASURES,
    Confusion,
    PrecisionRecall,
    QueryScores,
    RetrievalMeasures,
    confusion,
    evaluate_rankings,
    precision_recall,
    query_scores,
)
from pcretrieve.evaluation.rankings import Rankings, rank

__all__ = [
    "MEASURES",
    "PUBLISHED",
    "Comparison",
    "Confusion",
    "Evaluation",
    "PrecisionRecall",
    "Published",
    "QueryScores",
    "Rankings",
    "RetrievalMeasures",
    "calibrate",
    "check_known",
    "compare",
    "compare_scores",
    "confusion",
    "evaluate",
    "evaluate_rankings",
    "evaluate_table",
    "matrix",
    "precision_recall",
    "query_scores",
    "rank",
    "rank_table",
    "read_scores",
    "rerank_table",
    "result_scores",
    "write_evaluation",
]
