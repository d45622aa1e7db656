"""Rankings of labelled shapes → retrieval measures.

In come a catalogue, a table of signatures or a distance matrix, with the classes of the shapes; rankings,
measures and precision–recall curves go out.
"""

from pcretrieve.evaluation.calibration import calibrate
from pcretrieve.evaluation.catalogue import RankedCatalogue, check_known, rank_catalogue, rank_matrix
from pcretrieve.evaluation.classes import ClassMeasures, Confusion, class_measures, confusion
from pcretrieve.evaluation.comparison import Change, Comparison, compare_scores
from pcretrieve.evaluation.distances import CatalogueDistances, catalogue_distances
from pcretrieve.evaluation.intervals import LEVEL, bootstrap_interval
from pcretrieve.evaluation.measures import (
    MEASURES,
    PrecisionRecall,
    QueryScores,
    RetrievalMeasures,
    evaluate_rankings,
    precision_recall,
    query_scores,
)
from pcretrieve.evaluation.published import PUBLISHED, Published
from pcretrieve.evaluation.rankings import Rankings, rank
from pcretrieve.evaluation.results import result_scores
from pcretrieve.evaluation.score_files import read_scores, write_evaluation
from pcretrieve.evaluation.tables import evaluate_table, rank_table, rerank_table
from pcretrieve.evaluation.unknown_classes import NoMatchMeasures, no_match_measures

__all__ = [
    "LEVEL",
    "MEASURES",
    "PUBLISHED",
    "CatalogueDistances",
    "Change",
    "ClassMeasures",
    "Comparison",
    "Confusion",
    "NoMatchMeasures",
    "PrecisionRecall",
    "Published",
    "QueryScores",
    "RankedCatalogue",
    "Rankings",
    "RetrievalMeasures",
    "bootstrap_interval",
    "calibrate",
    "catalogue_distances",
    "check_known",
    "class_measures",
    "compare_scores",
    "confusion",
    "evaluate_rankings",
    "evaluate_table",
    "no_match_measures",
    "precision_recall",
    "query_scores",
    "rank",
    "rank_catalogue",
    "rank_matrix",
    "rank_table",
    "read_scores",
    "rerank_table",
    "result_scores",
    "write_evaluation",
]
