"""Many scans into a catalogue.

In come files, folders, globs and manifests; out comes one row of a catalogue for every scan, computed by an
executor, by default in isolated worker processes.
"""

from pcretrieve.ingestion.batch import BatchStatus
from pcretrieve.ingestion.cluster import DaskExecutor
from pcretrieve.ingestion.executors import EXECUTORS, Executor
from pcretrieve.ingestion.isolation import Isolation

__all__ = ["EXECUTORS", "BatchStatus", "DaskExecutor", "Executor", "Isolation"]
