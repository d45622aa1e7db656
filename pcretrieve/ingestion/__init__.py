"""Many scans into a catalogue.

In come files, folders, globs and manifests; out comes one row of a catalogue for every scan, computed by an
executor, by default in isolated worker processes.
"""

from pcretrieve.ingestion.cluster import DaskExecutor
from pcretrieve.ingestion.pool import Executor, Isolation, in_processes
from pcretrieve.ingestion.progress import BatchStatus

__all__ = ["BatchStatus", "DaskExecutor", "Executor", "Isolation", "in_processes"]
