"""The commands of the command line as functions, with the same names, defaults and numbers.

A catalogue may be given as a `Catalogue` or as its path or URL, options as in `PipelineOptions.of`, and
a scan as a path, an array, or geometry of this package or another.
"""

from pcretrieve.catalogue import CatalogueLike, backup, merge_catalogues
from pcretrieve.evaluation import calibrate, compare, evaluate, matrix
from pcretrieve.ingestion.recomputing import check
from pcretrieve.interface.batches import retry, status, watch
from pcretrieve.interface.scans import ingest, inspect, merge_views

__all__ = [
    "CatalogueLike",
    "backup",
    "calibrate",
    "check",
    "compare",
    "evaluate",
    "ingest",
    "inspect",
    "matrix",
    "merge_catalogues",
    "merge_views",
    "retry",
    "status",
    "watch",
]
