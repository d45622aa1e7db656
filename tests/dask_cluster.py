"""A Dask cluster of real processes: a scheduler and workers, as its command line starts them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PATIENCE = 60  # seconds


class DaskCluster:
    """A scheduler, and workers of one thread each.

    Parameters
    ----------
    folder : Path
        An empty folder, for the scheduler file and what the processes print.
    n_workers : int
        Number of workers that are started.
    """

    def __init__(self, folder: Path, n_workers: int) -> None:
        self.file = folder / "scheduler.json"
        self._folder = folder
        # Functions of tests are unpickled by their workers.
        self._environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
        self.scheduler = self._start("dask_scheduler", "--scheduler-file", str(self.file), "--port", "0")
        deadline = time.monotonic() + PATIENCE
        while not self.file.is_file():
            assert time.monotonic() < deadline, "the scheduler has not started"
            time.sleep(0.05)
        self.workers = [self.add_worker() for _ in range(n_workers)]

    def add_worker(self) -> subprocess.Popen[bytes]:
        """Start another worker, with the nanny that restarts it."""
        limits = ("--nthreads", "1", "--memory-limit", "0", "--local-directory", str(self._folder))
        return self._start("dask_worker", "--scheduler-file", str(self.file), *limits)

    def kill(self, process: subprocess.Popen[bytes]) -> None:
        """Kill a process and its children, as a computer that loses its power."""
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(PATIENCE)

    def stop(self) -> None:
        """Kill all processes."""
        for process in (*self.workers, self.scheduler):
            if process.poll() is None:
                self.kill(process)

    def _start(self, command: str, *arguments: str) -> subprocess.Popen[bytes]:
        number = len(list(self._folder.glob("*.log")))
        with (self._folder / f"{command}{number}.log").open("wb") as log:
            return subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.{command}", "--no-dashboard", *arguments],
                env=self._environment,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )


@contextmanager
def dask_cluster(folder: Path, n_workers: int = 2) -> Iterator[DaskCluster]:
    """A cluster that is killed at the end of the context."""
    folder.mkdir(parents=True)
    cluster = DaskCluster(folder, n_workers)
    try:
        yield cluster
    finally:
        cluster.stop()
