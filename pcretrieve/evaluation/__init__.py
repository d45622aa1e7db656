"""Rankings of labelled shapes → retrieval measures.

In come a catalogue, a table of signatures or a distance matrix, with the classes of the shapes; rankings,
measures and precision–recall curves go out.
"""

from pcretrieve.evaluation.calibration import calibrate
from pcretrieve.evaluation.catalogue import RankedCatalogue, check_known, rank_catalogue, rank_matrix
from pcretrieve.evaluation.distances import CatalogueDistances, catalogue_distances
from pcretrieve.evaluation.measures import (
    PrecisionRecall,
    RetrievalMeasures,
    evaluate_rankings,
    precision_recall,
)
from pcretrieve.evaluation.rankings import Rankings, rank
from pcretrieve.evaluation.tables import evaluate_table, rank_table, rerank_table

__all__ = [
    "CatalogueDistances",
    "PrecisionRecall",
    "RankedCatalogue",
    "Rankings",
    "RetrievalMeasures",
    "calibrate",
    "catalogue_distances",
    "check_known",
    "evaluate_rankings",
    "evaluate_table",
    "precision_recall",
    "rank",
    "rank_catalogue",
    "rank_matrix",
    "rank_table",
    "rerank_table",
]
