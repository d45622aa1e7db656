"""Many scans into a catalogue.

In come files, folders, globs and manifests; out comes one row of a catalogue for every scan, computed by an
executor, by default in isolated worker processes.
"""

from pcretrieve.ingestion.cluster import DaskExecutor
from pcretrieve.ingestion.pool import Executor, TemporaryFolder, alone, in_processes
from pcretrieve.ingestion.problems import report_problem
from pcretrieve.ingestion.progress import BatchStatus, status
from pcretrieve.ingestion.recomputing import Check, check
from pcretrieve.ingestion.run import Summary, ingest, retry, watch
from pcretrieve.ingestion.scans import map_scans

__all__ = [
    "BatchStatus",
    "Check",
    "DaskExecutor",
    "Executor",
    "Summary",
    "TemporaryFolder",
    "alone",
    "check",
    "in_processes",
    "ingest",
    "map_scans",
    "report_problem",
    "retry",
    "status",
    "watch",
]
